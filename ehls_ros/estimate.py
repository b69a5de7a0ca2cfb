"""A coefficient estimated from data."""

from typing import NamedTuple


class Estimate(NamedTuple):
    """An estimated coefficient.

    Attributes:
        value: estimated value.
        std: standard error.
        unit: unit of both.
    """

    value: float
    std: float
    unit: str
