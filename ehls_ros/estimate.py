"""A coefficient that was found from data."""

from typing import NamedTuple


class Estimate(NamedTuple):
    """One coefficient.

    Attributes:
        value: its value.
        std: its standard error.
        unit: unit of both.
    """

    value: float
    std: float
    unit: str
