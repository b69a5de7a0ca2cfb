"""Peaks, valleys and phase brought to their targets: on a lag with a known response, and in the loop with simple laws."""

import itertools
import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ehls_ros.control.companions import learning
from ehls_ros.control.companions.base import PLACE, Past, Setting, Upcoming
from ehls_ros.control.controllers.base import FORESEEN, ROW, STATUS_SIZE, model_of
from ehls_ros.control.learning.peak_valley import Bumpless, PeakValley
from ehls_ros.errors import BadInput
from ehls_ros.experiments.loop import ClosedLoop, sampled
from ehls_ros.experiments.spec import Spec, spec_from_mapping
from ehls_ros.experiments.stepped_run import stepped_run
from ehls_ros.physics import sensors

PERIOD, SIZE = 1e-3, 500
CONFIG = Path(__file__).parents[2] / "config"
HELD = {"name": "position_servo", "signal": {"name": "constant", "value": 0.0}}
PI = {"name": "sic", "compensation": 0.0, "proportional": 100.0, "integral": 100.0}


PROGRAMME = """
title: two levels
blocks:
  - repeat: 2
    blocks:
      - {block: cycles, name: service, mean: 4.0e+3, amplitude: 2.0e+3, frequency: 2.0, count: 6}
      - {block: cycles, name: overload, waveform: triangle, mean: 5.0e+3, amplitude: 5.0e+3, frequency: 1.0, count: 6}
"""


class Lag:
    """A force that lags its reference, with a companion; by cycles or in stretches."""

    def __init__(self, rig: Any, *, gain: float = 0.8, corner: float = 60.0, stretch: int = 125, **parameters: Any) -> None:
        self.model = model_of(rig, PERIOD)
        law = SimpleNamespace(__name__="controllers.stub", PREVIEW=True)
        p = learning.Parameters(**{"method": "peak_valley", "period": SIZE * PERIOD, **parameters})
        self.companion = learning.build(p, Setting(law, None, self.model, "position"))
        self.gain, self.share, self.stretch = gain, 1.0 - math.exp(-corner * PERIOD), stretch
        self.cycle, self.force = 0, 0.0
        self.random = np.random.default_rng(3)
        self.added: list[np.ndarray] = []

    def run(self, cycles: float, size: float = 1e3, mean: float = 0.0, place: Any = None, start: float = 0.0) -> np.ndarray:
        """Return the true force over some load cycles of a sine, shape (cycles, SIZE)."""
        out, end = [], self.cycle + round(cycles * SIZE)
        while self.cycle < end:
            n = min(self.stretch, end - self.cycle)
            k = np.arange(self.cycle, self.cycle + n)
            where = np.full((n, PLACE), np.nan) if place is None else place(k)
            n = self.companion.room(self.cycle, where)
            k, where = k[:n], where[:n]
            omega = 2.0 * math.pi / (SIZE * PERIOD)
            angle = 2.0 * math.pi * (k / SIZE + start)
            sine = size * np.sin(angle)
            rows = np.full((n, ROW), np.nan)
            rows[:, :FORESEEN] = np.column_stack([mean + sine, omega * size * np.cos(angle), -(omega**2) * sine])
            wanted = rows[:, :FORESEEN].copy()
            self.companion.ahead(Upcoming(self.cycle, rows, where, np.full((n, 3), np.nan)))
            self.added.append(rows[:, :FORESEEN] - wanted)
            assert np.all(np.isnan(rows[:, FORESEEN:]))
            force = np.empty(n)
            for i, row in enumerate(rows[:, 0]):
                self.force += self.share * (self.gain * row - self.force)
                force[i] = self.force
            measured = np.zeros((n, 7))
            measured[:, sensors.FORCE] = force + 2.0 * self.random.standard_normal(n)
            past = Past(self.cycle, rows, wanted, where, measured, np.zeros(n), np.zeros((n, STATUS_SIZE)))
            self.companion.done(past, self.model)
            out.append(force)
            self.cycle += n
        return np.concatenate(out)

    @property
    def correction(self) -> np.ndarray:
        return np.concatenate(self.added)


def errors(force: np.ndarray, size: float = 1e3, mean: float = 0.0) -> tuple[float, float, float]:
    """Return the errors of peak and valley [N] and of the phase [deg] in the last load cycle of a sine from phase 0."""
    last = force[-SIZE:]
    first = np.fft.rfft(last)[1]
    return last.max() - mean - size, last.min() - mean + size, math.degrees(np.angle(first * 1j))


def test_after_three_corrections_peaks_valleys_and_phase_are_those_wanted_and_in_stretches_alike(rig):
    single, stretches = Lag(rig, stretch=1), Lag(rig, stretch=170)
    force = single.run(9, mean=500.0)
    assert np.array_equal(stretches.run(9, mean=500.0), force)
    peak, valley, phase = errors(force[: 2 * SIZE], mean=500.0)
    # A gain of 0.8 and a lag of 60 rad/s at 2 Hz.
    assert (peak, valley, phase) == pytest.approx((-317.0, 117.0, -11.8), abs=3.0)
    peak, valley, phase = errors(force[: 6 * SIZE], mean=500.0)
    assert max(abs(peak), abs(valley)) < 20.0
    assert abs(phase) < 0.5
    peak, valley, phase = errors(force, mean=500.0)
    assert max(abs(peak), abs(valley)) < 5.0
    assert abs(phase) < 0.2
    report = single.companion.report()
    assert report["state"] == "correcting"
    assert report["amplitude_added_n"] == pytest.approx(1e3 / 0.8 / math.cos(math.radians(11.8)) - 1e3, abs=6.0)
    assert report["mean_added_n"] == pytest.approx(125.0, abs=6.0)
    assert report["lead_s"] == pytest.approx(math.radians(11.8) / (4.0 * math.pi), rel=0.03)
    assert "limits" not in report


def test_what_is_added_has_no_step_and_its_derivatives_are_its_own(rig):
    lag = Lag(rig)
    lag.run(5)
    value, rate, bend = lag.correction[2 * SIZE :].T
    assert np.abs(value).max() > 200.0
    assert np.allclose(np.gradient(value, PERIOD)[2:-2], rate[2:-2], atol=0.02 * np.abs(rate).max())
    # The second derivative jumps where a change begins.
    assert np.abs(np.gradient(rate, PERIOD) - bend).max() < np.abs(np.diff(bend)).max() + 0.02 * np.abs(bend).max()
    assert np.abs(np.diff(value)).max() < 1.2 * np.abs(rate).max() * PERIOD


@pytest.mark.parametrize(
    ("gain", "entry", "reason"),
    [(-0.6, "state", "larger than without a correction"), (0.0, "limits", "does not follow the amplitude")],
)
def test_a_force_that_does_not_follow_never_gets_more_than_the_reach(rig, gain, entry, reason):
    lag = Lag(rig, gain=gain, reach=0.3, freeze=1e3)
    lag.run(30)
    assert np.abs(lag.correction[:, 0]).max() <= 1e3 * (0.3 + 2.0 * math.sin(0.15) * 1.3 + 0.3)
    report = lag.companion.report()
    assert reason in str(report[entry])
    assert abs(float(report["amplitude_added_n"])) <= 300.0


def test_what_cannot_be_reached_stops_at_the_reach(rig):
    lag = Lag(rig, gain=0.5, reach=0.2)
    peak, valley, _ = errors(lag.run(15))
    assert (peak, valley) == pytest.approx((-413.0, 413.0), abs=10.0)
    assert "amplitude at its reach" in str(lag.companion.report()["limits"])


def test_a_short_load_cycle_is_judged_once_the_force_has_followed():
    """A force whose amplitude reaches half of the requested one, with 10 Hz."""
    wanted = 1e3 * np.sin(2.0 * math.pi * np.arange(100) / 100)
    way = PeakValley(wanted, 0.1, 0.0, 0.5)
    errors = []
    for _ in range(25):
        error = (0.5 * way.numbers[1] / 1e3 - 0.2) * wanted
        errors.append(float(np.max(wanted + error)) - 1e3)
        way.observe(error)
        way.correct()
    # Each change is followed by two load cycles in which the force may still move.
    assert errors[1] == errors[2] == errors[3] == pytest.approx(-120.0, abs=1.0)
    assert errors[4] != errors[3]
    assert abs(errors[-1]) < 5.0


def test_an_error_that_alternates_is_not_made_larger(rig):
    """As caused by an actuator whose motion takes two load cycles."""
    alone, lag = Lag(rig, reach=1e-9), Lag(rig)
    found = []
    for one in (alone, lag):
        one.run(2)
        peaks = [one.run(1, mean=8.0 * (-1) ** turn).max() for turn in range(24)]
        found.append(np.ptp(peaks[-8:]))
    assert found[1] < 1.5 * found[0]


def test_a_reference_that_never_repeats_and_one_that_has_changed_are_left_alone(rig):
    wandering = Lag(rig)
    for turn in range(6):
        wandering.run(1, size=1e3 + 50.0 * turn)
    assert not np.any(wandering.correction)

    def block(number: int) -> Any:
        return lambda k: np.column_stack([np.full(len(k), float(number)), k / SIZE])

    lag = Lag(rig, period=0.0)
    lag.run(8, place=block(1))
    numbers = lag.companion.report()["amplitude_added_n"]
    lag.added.clear()
    lag.run(2, size=1.5e3, place=block(2))
    # The old correction fades within a tenth of a load cycle.
    assert not np.any(lag.correction[SIZE // 10 :])
    peak, valley, _ = errors(lag.run(8, size=1.5e3, place=block(2)), size=1.5e3)
    assert max(abs(peak), abs(valley)) < 10.0
    peak, valley, _ = errors(lag.run(1, place=block(1)))
    assert max(abs(peak), abs(valley)) < 10.0
    assert lag.companion.report()["amplitude_added_n"] == pytest.approx(numbers, abs=10.0)


def test_after_a_trip_nothing_is_added_for_a_load_cycle_and_an_error_that_grows_ends_it(rig):
    lag = Lag(rig)
    lag.run(6.3)
    lag.companion.interrupt()
    lag.added.clear()
    lag.run(1.7)
    assert not np.any(lag.correction)
    peak, _, _ = errors(lag.run(1))
    assert abs(peak) < 10.0
    # Without the fade of the first one in the usual errors.
    lag.run(3.25)
    lag.gain = 0.2
    lag.added.clear()
    lag.run(0.7)
    assert not np.any(lag.correction[SIZE // 5 :])
    assert "no longer" in str(lag.companion.report()["state"])


def test_what_was_learnt_holds_from_the_first_load_cycle_of_the_next_day(rig):
    lag = Lag(rig)
    before = errors(lag.run(8))
    again = Lag(rig)
    again.companion.recall(lag.companion.kept())
    after = errors(again.run(1))
    assert np.abs(np.subtract(after, before)[:2]).max() < 5.0
    # From rest, and with the fade.
    assert after[2] == pytest.approx(0.0, abs=1.5)
    assert again.companion.report()["amplitude_added_n"] > 200.0


@pytest.mark.parametrize("gain", [0.2, 1.5])
def test_a_gain_with_which_errors_need_not_fall_is_refused(rig, gain):
    with pytest.raises(BadInput, match="0\\.4 to 1\\.2"):
        learning.build(
            learning.Parameters(method="peak_valley", period=0.5, gain=gain),
            Setting(SimpleNamespace(__name__="stub"), None, model_of(rig, PERIOD), "position"),
        )


def test_one_correction_goes_over_into_the_next():
    bumpless, bare = Bumpless(PERIOD), np.zeros((200, 3))
    rows = np.tile([5.0, 0.0, 0.0], (200, 1))
    rows[100:] = 0.0
    for k in range(200):
        bumpless.smooth(k, rows[k : k + 1], bare[k : k + 1], 1 if k < 100 else None, 50 if k < 100 else 0)
    value, rate, bend = rows.T
    assert value[50:100] == pytest.approx(5.0)
    assert not np.any(value[150:])
    assert np.abs(np.diff(value)).max() < 5.0 * 1.9 / 50.0
    assert np.allclose(np.cumsum(rate)[:-1] * PERIOD, value[:-1], atol=0.1)
    assert np.allclose(np.cumsum(bend) * PERIOD, rate, atol=0.1 * np.abs(rate).max())


def spec_of(duration: float, *, emulated: bool, gain: float = 1.0, learns: bool = True, **parts: Any) -> Spec:
    """Return an experiment of the PI force loop against a servo at standstill; the valve's gain is unknown."""
    effects = [{"name": "valve_gain_shift", "gain": gain}, *([{"name": "command_delay", "delay": 1e-3}] if emulated else [])]
    data = {
        "title": "peaks",
        "rig": "rig_paper_measured.yaml" if emulated else "rig_paper.yaml",
        "effects": effects,
        "known_effects": [],
        "duration": duration,
        "disturbance": HELD,
        "controller": PI,
        "companions": [{"name": "learning", "method": "peak_valley"}] if learns else [],
        **parts,
    }
    return spec_from_mapping(data, "test", CONFIG)


def extremes(spec: Spec) -> tuple[np.ndarray, np.ndarray]:
    """Return the errors of peak and valley of each load cycle [N], shape (n, 2), and the number of its block, shape (n,)."""
    reference = sampled(spec.reference, PERIOD)
    wanted, place = reference.rows(0, spec.cycles)[:, 0], reference.place(0, spec.cycles)
    force = wanted + stepped_run(spec).error
    turns = np.column_stack([place[:, 0], np.floor(place[:, 1] + 1e-6)])
    ends = np.flatnonzero(np.any(np.diff(np.nan_to_num(turns, nan=-1.0), axis=0), axis=1)) + 1
    cycles = [(k, slice(k, end)) for k, end in itertools.pairwise(ends) if np.isfinite(turns[k, 1])]
    errors = [[np.max(force[at]) - np.max(wanted[at]), np.min(force[at]) - np.min(wanted[at])] for _, at in cycles]
    return np.array(errors), np.array([turns[k, 0] for k, _ in cycles])


@pytest.mark.long
@pytest.mark.parametrize("gain", [0.8, 1.2])
def test_with_a_valve_gain_off_by_a_fifth_a_simple_law_has_its_peaks_after_eight_load_cycles(gain):
    parts: dict[str, Any] = {"emulated": True, "gain": gain, "reference": {"name": "sine", "amplitude": 1e4, "frequency": 1.0}}
    alone, beside = (extremes(spec_of(10.5, learns=learns, **parts))[0][7:] for learns in (False, True))
    assert np.all(np.abs(alone) > 80.0)
    assert np.all(np.abs(beside) < 40.0)


@pytest.mark.long
def test_each_block_of_a_programme_has_its_own_numbers_from_its_next_pass_on(tmp_path):
    (tmp_path / "blocks.yaml").write_text(PROGRAMME, encoding="utf-8")
    parts: dict[str, Any] = {"emulated": True, "reference": {"name": "programme", "file": str(tmp_path / "blocks.yaml")}}
    (alone, blocks), (beside, _) = (extremes(spec_of(21.0, learns=learns, **parts)) for learns in (False, True))
    for block in np.unique(blocks):
        # The first load cycle of a pass begins with the residue of the ramp.
        later = np.flatnonzero(blocks == block)[7:12]
        assert np.all(np.abs(alone[later]) > 200.0)
        assert np.all(np.abs(beside[later]) < 0.3 * np.abs(alone[later]))


def test_in_the_compiled_loop_it_does_the_same_as_beside_a_controller():
    spec = spec_of(5.0, emulated=True, reference={"name": "sine", "amplitude": 1e4, "frequency": 1.0})
    stepped = stepped_run(spec).command
    loop = ClosedLoop(spec)
    commands = np.concatenate([block.record[:, loop.columns.command].copy() for block in loop.blocks()])
    assert np.allclose(commands, stepped, rtol=1e-9, atol=1e-12)
    assert loop.company.report()["learning.lead_s"] > 0.01
