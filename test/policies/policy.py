"""What a policy is."""

from typing import NamedTuple

from policies.temporal import Formula


class Policy(NamedTuple):
    """A promise, as a formula.

    Attributes:
        name: by which tables name it.
        formula: what must hold always.
        page: page of the documentation that promises it, below ``docs/``.
        promise: words of that page.
        weight: robustness at which a run counts as close, in the formula's unit; makes policies comparable.
    """

    name: str
    formula: Formula
    page: str
    promise: str
    weight: float
