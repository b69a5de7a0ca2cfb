"""Pruning of a hypothesis, with effects that are linear in their parameters."""

from types import SimpleNamespace

import numpy as np
import pytest
from plain_evidence import MASS, VISCOUS, candidate, evidence_of, linear_fit, nothing

from ehls_ros.diagnosis.partial import needed
from ehls_ros.diagnosis.search import Place, Searched

WINDOWS = 2000
SHAPES = {
    "mass_shift": np.sin(np.arange(WINDOWS) / 9.0),
    "viscous_shift": np.sin(np.arange(WINDOWS) / 2.0),
    "stribeck_shift": np.sin(np.arange(WINDOWS) / 5.0),
    "flexible_mode": np.column_stack([np.sin(np.arange(WINDOWS) / 2.0), np.sin(np.arange(WINDOWS) / 3.0)]),
}
STRIBECK = candidate("stribeck_shift", "static_offset")
MODE = candidate("flexible_mode", "mass", "frequency")
REST = 3.0 * np.sign(np.sin(np.arange(WINDOWS) / 40.0))
"""A remainder with the shape of no effect."""


class LinearWorker:
    """A worker whose fits are linear least squares."""

    def __init__(self, evidence):
        self.evidence = evidence

    def linearise(self, hypothesis, values=None, steps=None):
        if not hypothesis:
            return nothing(self.evidence).fit
        columns = np.column_stack([SHAPES[c.name] for c in hypothesis]) / self.evidence.floor["force"][:, None]
        return linear_fit(self.evidence, hypothesis, columns).fit

    def fit(self, fit):
        return fit


class LinearPool:
    """A pool of linear workers, as many as requested."""

    def __init__(self, evidence):
        self.evidence = evidence

    def map(self, work, items):
        return [work(LinearWorker(self.evidence), item) for item in items]

    def beside(self, evidence):
        return LinearPool(evidence)

    def close(self):
        pass


@pytest.fixture
def noise():
    return np.random.default_rng(5).standard_normal(WINDOWS)


def pruned(given, hypothesis, offered=()):
    """Return the pruned form of a hypothesis whose last cause was searched for, with candidates to replace it."""
    evidence = evidence_of({"force": given})
    best, without, *others = (
        linear_fit(evidence, h, LinearWorker(evidence).linearise(h).jacobian)
        for h in (hypothesis, hypothesis[:-1], *((*hypothesis[:-1], c) for c in offered))
    )

    def extensions(member, most):
        assert member is without
        return [other for other in others if len(other.hypothesis[-1].free) <= most]

    starts = SimpleNamespace(pool=LinearPool(evidence), extensions=extensions)
    return needed(starts, Searched(best, (Place(without, ()),), (), {"force": 1.0}), 0)[1]


ALL = ("viscous_shift", "stribeck_shift", "mass_shift")


@pytest.mark.parametrize(("size", "left"), [(0.5, ("viscous_shift", "mass_shift")), (5.0, ALL)])
def test_what_is_improbable_beside_the_remainder_is_left_out(noise, size, left):
    given = 8.0 * SHAPES["mass_shift"] + 6.0 * SHAPES["viscous_shift"] + size * SHAPES["stribeck_shift"] + REST + noise
    kept = pruned(given, (VISCOUS, STRIBECK, MASS))
    assert kept.best.names == left
    assert [place.without.names for place in kept.places] == [tuple(n for n in left if n != name) for name in left]


@pytest.mark.parametrize(("second", "name"), [(0.5, "viscous_shift"), (12.0, "flexible_mode")])
def test_fewer_parameters_that_do_nearly_as_well_are_taken(noise, second, name):
    given = 8.0 * SHAPES["mass_shift"] + SHAPES["flexible_mode"] @ [6.0, second] + REST + noise
    kept = pruned(given, (MASS, MODE), [VISCOUS])
    assert kept.best.names == ("mass_shift", name)
    (other,) = kept.places[1].rivals
    assert other.names == ("mass_shift", *({"viscous_shift", "flexible_mode"} - {name}))
