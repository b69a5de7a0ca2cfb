"""What is needed of a hypothesis, with effects that are linear in their parameters."""

import numpy as np
import pytest
from plain_evidence import MASS, VISCOUS, candidate, evidence_of, linear_fit, nothing

from ehls_ros.diagnosis.pruning import assessed_again, pruned
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


class LinearWorker:
    """A worker whose fits are linear least squares."""

    def __init__(self, evidence):
        self.evidence = evidence

    def linearise(self, hypothesis, values, steps):
        if not hypothesis:
            return nothing(self.evidence).fit
        columns = np.column_stack([SHAPES[c.name] for c in hypothesis]) / self.evidence.floor["force"][:, None]
        return linear_fit(self.evidence, hypothesis, columns).fit

    def fit(self, fit):
        return fit


def found(evidence, hypothesis, *rivals):
    """Return a search's result of which the last cause was sought."""
    worker = LinearWorker(evidence)
    best, without, *others = (
        linear_fit(evidence, h, worker.linearise(h, None, None).jacobian) for h in (hypothesis, hypothesis[:-1], *rivals)
    )
    return worker, Searched(best, (Place(without, tuple(others)),), (), {"force": 1.0})


@pytest.fixture
def noise():
    return np.random.default_rng(5).standard_normal(WINDOWS)


ALL = ("viscous_shift", "stribeck_shift", "mass_shift")


@pytest.mark.parametrize(("size", "needed"), [(0.5, ("viscous_shift", "mass_shift")), (5.0, ALL)])
def test_what_hardly_closes_anything_is_left_out(noise, size, needed):
    # The remainder of 3 is in no effect's shape.
    rest = 3.0 * np.sign(np.sin(np.arange(WINDOWS) / 40.0)) + noise
    given = 8.0 * SHAPES["mass_shift"] + 6.0 * SHAPES["viscous_shift"] + size * SHAPES["stribeck_shift"] + rest
    worker, searched = found(evidence_of({"force": given}), (VISCOUS, STRIBECK, MASS))
    kept = pruned(worker, searched)
    assert kept.best.names == needed
    assert [j.names for j in kept.without] == [tuple(n for n in needed if n != name) for name in needed]


def test_fewer_parameters_that_do_nearly_as_well_are_taken(noise):
    rest = 3.0 * np.sign(np.sin(np.arange(WINDOWS) / 40.0)) + noise
    given = 8.0 * SHAPES["mass_shift"] + 6.0 * SHAPES["viscous_shift"] + 0.5 * SHAPES["flexible_mode"][:, 1] + rest
    worker, searched = found(evidence_of({"force": given}), (MASS, MODE), (MASS, VISCOUS))
    kept = pruned(worker, searched)
    assert kept.best.names == ("mass_shift", "viscous_shift")
    again = assessed_again(worker, searched, kept)
    assert [[r.names[-1] for r in place.rivals] for place in again.places] == [[], []]
    assert [place.without.names for place in again.places] == [("viscous_shift",), ("mass_shift",)]
