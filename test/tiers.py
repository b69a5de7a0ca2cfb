"""Cases of a parametrised test in the quick and the long tier."""

from collections.abc import Iterable
from typing import Any

import pytest


def tiered(cases: Iterable[Any], *quick: Any, unpack: bool = False) -> list[Any]:
    """Return the parameters of a test: the ``quick`` cases run in ``make test``, all others in ``make test-long``.

    Args:
        cases: all cases.
        quick: those of the quick tier.
        unpack: a case is a tuple with a value for each of several parameters.

    Raises:
        ValueError: a quick case is none of the cases.
    """
    listed = list(cases)
    unknown = [case for case in quick if case not in listed]
    if unknown:
        raise ValueError(f"{unknown} are none of the cases {listed}")
    return [pytest.param(*(case if unpack else (case,)), marks=[] if case in quick else [pytest.mark.long]) for case in listed]
