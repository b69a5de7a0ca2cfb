"""Properties of the references for the diagnosis's experiments beyond the family's contract."""

from typing import Any

import numpy as np
import pytest

from ehls_ros.control.references import REFERENCES, steps
from ehls_ros.errors import BadInput
from ehls_ros.schema import parse


def sample(name: str, t: Any, **values: Any) -> np.ndarray:
    signal = REFERENCES.load(name)
    return signal.sample(np.asarray(t, dtype=float), parse(signal.Parameters, values, name))


def test_steps_hold_each_level_and_the_last_for_good():
    levels = [1e3, 6e3, -4e3, -2e3]
    for index, level in enumerate(levels):
        start = index * 1.5
        held = sample("steps", np.linspace(start, start + 1.0, 11), levels=levels, hold=1.0, rise=0.5)
        assert np.allclose(held, [level, 0.0, 0.0], atol=1e-9)
    assert np.allclose(sample("steps", [50.0, 1e6], levels=levels), [[-2e3, 0.0, 0.0]] * 2)


def test_a_step_is_the_quintic_from_rest_to_rest():
    x = np.linspace(0.0, 1.0, 21)
    rows = sample("steps", 1.0 + 0.4 * x, levels=[2.0, -3.0], hold=1.0, rise=0.4)
    assert np.allclose(rows[:, 0], 2.0 - 5.0 * (10.0 * x**3 - 15.0 * x**4 + 6.0 * x**5), atol=1e-12)
    # Fastest in the middle: 15/8 of the mean speed.
    assert rows[10, 1] == pytest.approx(-5.0 / 0.4 * 15.0 / 8.0)
    assert np.max(np.abs(rows[:, 1])) == pytest.approx(np.abs(rows[10, 1]))


def test_steps_without_a_hold_join_and_one_level_is_a_constant():
    rows = sample("steps", [0.0, 0.5, 1.0, 1.5], levels=[0.0, 1.0, 0.0], hold=0.0, rise=1.0)
    assert np.allclose(rows[:, 0], [0.0, 0.5, 1.0, 0.5])
    assert np.allclose(sample("steps", [0.0, 3.0], levels=[7.0]), [[7.0, 0.0, 0.0]] * 2)


def test_steps_know_how_long_they_take():
    p = steps.Parameters(levels=(0.0, 1.0, 2.0), hold=0.5, rise=0.25)
    assert steps.duration(p) == pytest.approx(2.0)
    arrival = steps.sample(np.array([steps.duration(p) - p.hold - 1e-3, steps.duration(p) - p.hold]), p)
    assert arrival[0, 0] < 2.0 == arrival[1, 0]


@pytest.mark.parametrize(
    ("levels", "what"),
    [([], "levels is empty"), ([0.0, float("nan")], "levels[1] is nan"), ([float("inf")], "levels[0] is inf")],
)
def test_levels_that_are_none_or_not_finite_are_bad_input(levels, what):
    with pytest.raises(BadInput, match="steps") as caught:
        sample("steps", [0.0], levels=levels)
    assert what in caught.value.what


def test_amplitude_sweep_starts_at_rest_and_ends_as_the_sine():
    values = {"end_amplitude": 3e3, "frequency": 0.7, "sweep": 4.0, "offset": 500.0}
    assert np.allclose(sample("amplitude_sweep", [0.0], **values), [[500.0, 0.0, 0.0]])
    t = np.linspace(4.0, 9.0, 501)
    sine = sample("sine", t, amplitude=3e3, frequency=0.7, offset=500.0)
    assert np.allclose(sample("amplitude_sweep", t, **values), sine, rtol=1e-12, atol=1e-9)


def test_amplitude_sweep_goes_through_every_amplitude_between():
    t = np.linspace(0.0, 10.0, 10001)
    wave = sample("amplitude_sweep", t, start_amplitude=1.0, end_amplitude=5.0, frequency=1.0, sweep=10.0)[:, 0]
    peaks = np.array([np.max(np.abs(part)) for part in np.split(wave[:-1], 10)])
    assert np.all(np.diff(peaks) > 0.0)
    assert peaks[0] == pytest.approx(1.0, abs=0.05)
    assert peaks[-1] == pytest.approx(5.0, abs=0.05)
