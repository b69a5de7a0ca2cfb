"""Definition of a policy."""

from typing import NamedTuple

from policies.temporal import Formula


class Policy(NamedTuple):
    """A guarantee, as a formula.

    Attributes:
        name: in tables.
        formula: temporal formula that must always hold.
        page: page of the documentation that states it, below ``docs/``.
        promise: words of that page.
        weight: robustness at which a run counts as close, in the formula's unit; makes policies comparable.
    """

    name: str
    formula: Formula
    page: str
    promise: str
    weight: float
