"""Several recordings of a rig in one condition, judged together: a pause between them leaves no residual."""

import numpy as np
import pytest

from ehls_ros.diagnosis.evidence import gather
from ehls_ros.diagnosis.loss import rms
from ehls_ros.diagnosis.record import prepare, successive
from ehls_ros.diagnosis.stages import setup
from ehls_ros.errors import BadInput
from ehls_ros.trajectory import Trajectory


@pytest.fixture(scope="module")
def strokes(recorded):
    made = [recorded({}, "rich", seed=seed, duration=2.0) for seed in (1, 2, 3)]
    return {f"stroke {i}": Trajectory(r.time, r.columns) for i, r in enumerate(made)}


def evidence(trajectory, rig):
    record = prepare(trajectory, rig, "it")
    return gather(record, rig, setup(record, rig), 0)


def test_each_stroke_is_a_stretch_of_its_own(strokes, rig):
    one, all_of_them = prepare(strokes["stroke 0"], rig, "it"), prepare(successive(strokes), rig, "it")
    n = len(one.time)
    assert np.flatnonzero(all_of_them.fresh).tolist() == [0, n, 2 * n]
    assert np.sum(np.diff(all_of_them.time) > 1.5 * all_of_them.period) == 2
    np.testing.assert_allclose(all_of_them.signals["position_m"][:n], one.signals["position_m"], rtol=1e-9)
    # Neither jitter nor an uneven clock is taken from the pauses.
    assert all_of_them.remarks == one.remarks


def test_pauses_raise_neither_the_noise_floor_nor_the_residuals(strokes, rig):
    alone, together = evidence(strokes["stroke 0"], rig), evidence(successive(strokes), rig)
    assert together.channels == alone.channels
    for c in together.channels:
        assert np.median(together.floor[c]) == pytest.approx(np.median(alone.floor[c]), rel=0.2)
        assert len(together.floor[c]) > 2.5 * len(alone.floor[c])
        assert rms(together.base.values[c]) < 1.3


def test_only_signals_of_all_strokes_are_kept(strokes):
    first, second, third = strokes.values()
    less = {name: values for name, values in second.signals.items() if name != "spool_m"}
    found = successive({"a": first, "b": Trajectory(second.time_s, less), "c": third})
    assert "spool_m" not in found
    assert "position_m" in found
    assert "spool_m is not in all recordings and is left out" in found.preparation.remarks


def test_strokes_of_different_rates_are_refused(strokes):
    first, second, _ = strokes.values()
    slower = Trajectory(second.time_s[::2], {name: values[::2] for name, values in second.signals.items()})
    with pytest.raises(BadInput, match=r"b: it has a sample every 0\.002 s, and a one every 0\.001 s"):
        successive({"a": first, "b": slower})
