"""Learning from load cycle to load cycle, on plants with a known response."""

import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ehls_ros.control.companions import learning
from ehls_ros.control.companions.base import PLACE, Kept, Past, Setting, Upcoming
from ehls_ros.control.controllers import CONTROLLERS, fasmc_output_feedback
from ehls_ros.control.controllers.base import FORESEEN, ROW, STATUS_SIZE, model_of
from ehls_ros.control.learning.corrector import Harmonics, Waveform
from ehls_ros.control.learning.force_prediction import ForcePrediction
from ehls_ros.control.learning.robustness import MARGIN, Loop, design, remaining
from ehls_ros.control.learning.smoothing import BLOCK, Smoother
from ehls_ros.errors import BadInput
from ehls_ros.experiments.loop import run_in_process
from ehls_ros.experiments.spec import Spec, spec_from_mapping
from ehls_ros.physics import sensors
from ehls_ros.recording.topics import LOADER_STATE

CONFIG = Path(__file__).parents[2] / "config"

PERIOD, SIZE = 1e-3, 500
TURN = np.arange(SIZE) / SIZE


def lag(omega: np.ndarray) -> Loop:
    return Loop(1.0 / (1.0 + 1j * omega / 300.0), 0.3 + omega / 600.0)


FILTERS = design(lag, SIZE, SIZE * PERIOD)
WAYS = {
    "waveform": lambda: Waveform(FILTERS, SIZE, SIZE * PERIOD, 0.02),
    "harmonics": lambda: Harmonics(FILTERS, SIZE, SIZE * PERIOD, 0.02, 60),
}


def repeated(random: np.random.Generator) -> np.ndarray:
    """Return an error with all harmonics to 100 Hz."""
    spectrum = np.zeros(SIZE // 2 + 1, dtype=complex)
    spectrum[1:50] = random.standard_normal((49, 2)) @ [100.0, 100.0j] * 10.0
    return np.fft.irfft(spectrum, SIZE)


@pytest.mark.parametrize("turned", [0.0, 0.9, 2.5, -1.3])
@pytest.mark.parametrize("way", WAYS)
def test_every_harmonic_falls_at_least_as_fast_as_designed(way, turned):
    """The plant is at the largest permitted distance from the nominal one, in an arbitrary direction; there is no noise."""
    learner, first = WAYS[way](), repeated(np.random.default_rng(1))
    truth = FILTERS.response * (1.0 + 0.99 * FILTERS.uncertainty * np.exp(1j * turned))
    error = first
    sizes = []
    for _ in range(7):
        learner.observe(error)
        learner.correct()
        sizes.append(np.abs(np.fft.rfft(error))[1:50])
        error = first + np.fft.irfft(truth * learner.spectrum, SIZE)
    # Once on the observed error, and once on the correction.
    q = FILTERS.robustness**2
    exact = np.abs(1.0 - q * FILTERS.learning * truth)[1:50]
    most = (1.0 - q + remaining(Loop(FILTERS.response, FILTERS.uncertainty), FILTERS.learning, q))[1:50]
    assert np.allclose(sizes[2], exact * sizes[1], rtol=1e-6, atol=1e-6)
    assert np.all(sizes[2] <= most * sizes[1] + 1e-6)
    # The effect of a correction has revealed the plant: from then on it falls faster still.
    full = q[1:50] == 1.0
    assert full.sum() >= 5
    assert np.all(sizes[6][full] < 0.02 * sizes[0][full])


def test_the_condition_holds_at_all_frequencies_and_uncertainty_costs_bandwidth():
    bandwidths = []
    for doubt in (0.1, 0.2, 0.4):

        def loop(omega: np.ndarray, doubt: float = doubt) -> Loop:
            return Loop(np.exp(-1e-3j * omega), doubt * (1.0 + omega / 300.0))

        found = design(loop, SIZE, SIZE * PERIOD)
        omega = 2.0 * math.pi * np.arange(SIZE // 2 + 1) / (SIZE * PERIOD)
        off = np.outer(loop(omega).uncertainty, np.exp(1j * np.linspace(0.0, 6.0, 13)))
        truth = found.response[:, np.newaxis] * (1.0 + off)
        left = np.abs(found.robustness[:, np.newaxis] * (1.0 - found.learning[:, np.newaxis] * truth))
        assert left.max() <= found.worst <= 1.0 - MARGIN
        assert found.rate < found.worst
        bandwidths.append(found.bandwidth)
    assert bandwidths == sorted(bandwidths, reverse=True)
    assert bandwidths[0] > 2.0 * bandwidths[2]


@pytest.mark.parametrize(("gain", "doubt"), [(1.9, 0.2), (0.0, 1.5)])
def test_what_does_not_converge_is_refused(gain, doubt):
    with pytest.raises(BadInput, match="first harmonic"):
        design(lambda omega: Loop(np.ones(omega.shape, dtype=complex), np.full(omega.shape, doubt)), SIZE, SIZE * PERIOD, gain)


def test_a_law_says_how_the_force_follows(rig):
    """Against the difference equation that the law's commands fulfil, of a sine that is extrapolated."""
    p, model = fasmc_output_feedback.Parameters(), model_of(rig, PERIOD)
    omega = np.array([20.0, 150.0, 600.0])
    slope, kept = p.k * p.g / 4.0, 1.0 / (1.0 + p.reaching_rate * PERIOD)
    found = fasmc_output_feedback.tracking(omega, p, model)
    for w, response in zip(omega, found, strict=True):
        k = np.arange(4000)
        r = np.exp(1j * w * PERIOD * k)

        def wanted(ahead: float, r: np.ndarray = r, w: float = w) -> np.ndarray:
            rate = 1j * w * r - ahead * w**2 * r
            return rate + slope * (r + ahead * 1j * w * r - 0.5 * (ahead * w) ** 2 * r)

        surface = np.zeros(len(k) + 2, dtype=complex)
        for i in k:
            surface[i + 2] = wanted(2.0 * PERIOD)[i] + kept * (surface[i + 1] - wanted(PERIOD)[i])
        force = surface[3000] / (1j * w + slope)
        assert force / np.exp(1j * w * PERIOD * 3000) == pytest.approx(response, rel=1e-6)


@pytest.mark.parametrize("way", WAYS)
def test_the_noise_that_is_learnt_falls_with_the_root_of_the_cycles(way):
    random = np.random.default_rng(2)
    first = repeated(random)
    left = {}
    for cycles in (4, 36):
        squares = []
        for _ in range(6):
            learner, error = WAYS[way](), first
            learner._forgetting = 0.0
            for _ in range(cycles):
                learner.observe(error + 3.0 * random.standard_normal(SIZE))
                learner.correct()
                error = first + np.fft.irfft(FILTERS.response * learner.spectrum, SIZE)
            squares.append(np.mean(np.abs(np.fft.rfft(error)[FILTERS.robustness == 1.0]) ** 2))
        left[cycles] = math.sqrt(np.mean(squares))
    assert 2.0 < left[4] / left[36] < 5.0


def at_once(omega: np.ndarray, tuning: Any, model: Any) -> np.ndarray:
    """Return the response of a law whose force is its reference."""
    return np.ones(omega.shape, dtype=complex)


class Plant:
    """A force that follows its reference at once, with a repeating error, and a companion; by cycles or in stretches."""

    def __init__(
        self, rig: Any, *, law: Any = None, stretch: int = 1, noise: float = 0.5, limits: Any = None, **parameters: Any
    ) -> None:
        self.model = model_of(rig, PERIOD)
        self.law = SimpleNamespace(__name__="controllers.stub", tracking=at_once) if law is None else law
        p = learning.Parameters(**{"period": SIZE * PERIOD, "uncertainty": 0.02, **parameters})
        self.companion = learning.build(p, Setting(self.law, None, self.model, "position", limits))
        self.stretch, self.noise, self.cycle = stretch, noise, 0
        self.random = np.random.default_rng(3)
        self.added: list[np.ndarray] = []

    def run(self, cycles: int, size: float = 1e3, swing: float = 40.0, place: Any = None) -> np.ndarray:
        """Return the true force error of some load cycles."""
        out, end = [], self.cycle + round(cycles * SIZE)
        while self.cycle < end:
            n = min(self.stretch, end - self.cycle)
            k = np.arange(self.cycle, self.cycle + n)
            where = np.full((n, PLACE), np.nan) if place is None else place(k)
            n = self.companion.room(self.cycle, where)
            k, where = k[:n], where[:n]
            angle = 2.0 * math.pi * k / SIZE
            rows = np.full((n, ROW), np.nan)
            rows[:, :FORESEEN] = np.column_stack([size * np.sin(angle), np.zeros((n, 2))])
            wanted = rows[:, :FORESEEN].copy()
            self.companion.ahead(Upcoming(self.cycle, rows, where, np.full((n, 3), np.nan)))
            self.added.append(rows - np.column_stack([wanted, np.zeros((n, 3))]))
            error = rows[:, 0] - wanted[:, 0] + swing * np.cos(2.0 * angle) ** 3
            measured, status = np.zeros((n, 7)), np.zeros((n, STATUS_SIZE))
            measured[:, sensors.FORCE] = wanted[:, 0] + error + self.noise * self.random.standard_normal(n)
            self.companion.done(Past(self.cycle, rows, wanted, where, measured, np.zeros(n), status), self.model)
            out.append(error)
            self.cycle += n
        return np.concatenate(out)

    @property
    def correction(self) -> np.ndarray:
        return np.concatenate(self.added)


@pytest.mark.parametrize("method", ["waveform", "harmonics"])
def test_beside_a_law_the_error_falls_and_it_is_the_same_in_stretches(rig, method):
    single, stretches = Plant(rig, method=method), Plant(rig, method=method, stretch=170)
    before, error = single.run(2), single.run(6)
    assert np.abs(before).max() > 39.0
    assert np.abs(error[-SIZE:]).max() < 2.0
    assert np.array_equal(np.concatenate([stretches.run(2), stretches.run(6)]), np.concatenate([before, error]))
    report = single.companion.report()
    assert report["repetitions"] == 7.0
    assert report["convergence"] < 0.1
    assert report["state"] == "correcting"


PULL, TURN_TIME = 2e3, 0.5
SWAY = 2.0 * math.pi * 4.0 / TURN_TIME


def pulled(*companions: str) -> Spec:
    """Return an experiment of 3 s with a sinusoidal force, the sensors of a rig, and companions."""
    data: dict[str, Any] = {
        "rig": str(CONFIG / "rig_paper_measured.yaml"),
        "effects": [{"name": "command_delay", "delay": 1e-3}],
        "known_effects": ["command_delay"],
        "duration": 6.0 * TURN_TIME,
        "seed": 7,
        "reference": {"name": "constant", "value": 5e3},
        "disturbance": {"name": "force", "signal": {"name": "sine", "amplitude": PULL, "frequency": SWAY / (2.0 * math.pi)}},
        "controller": {"name": "fasmc_predictive"},
        "companions": [{"name": name, "period": TURN_TIME} for name in companions],
    }
    return spec_from_mapping(data, "pulled", CONFIG)


@pytest.mark.long
def test_a_force_is_found_later_without_the_lag_and_most_of_the_noise():
    spec = pulled()
    run, law = run_in_process(spec), CONTROLLERS.load("fasmc_predictive")
    measured = np.column_stack([run.signals[name] for name in LOADER_STATE.signals.values()])
    command, model = run.signals["valve_command_m"], model_of(spec.controller_rig, PERIOD)
    at_once, by_ones = (Smoother(law, spec.controller.parameters, model) for _ in range(2))
    all_of_it = at_once.take(0, measured, command, model)
    singles = [by_ones.take(k, measured[k : k + 1], command[k : k + 1], model) for k in range(len(command))]
    assert np.array_equal(np.concatenate([forces.smoothed for forces in singles]), all_of_it.smoothed)
    assert [forces.first for forces in singles if len(forces.smoothed)] == list(range(0, len(all_of_it.smoothed), BLOCK))
    late = slice(500, len(all_of_it.smoothed))
    time = PERIOD * np.arange(len(command))[late]
    truth = PULL * np.sin(SWAY * time)
    off = np.std(all_of_it.smoothed[late] - truth), np.std(all_of_it.now[late] - truth)
    assert off[0] < 3.0
    assert off[0] < 0.25 * off[1]
    # A force of this rate is 100 N off for every millisecond.
    rate = PULL * SWAY * np.cos(SWAY * time)
    slip = (all_of_it.smoothed[late] - truth) @ rate / (rate @ rate)
    assert abs(slip) < 1e-4


def test_a_force_that_repeats_is_foreseen_after_one_load_cycle_beside_it():
    size = round(TURN_TIME / PERIOD)
    runs = run_in_process(pulled()), run_in_process(pulled("learning"))
    error = [np.reshape(run.signals["force_error_n"][: 6 * size], (-1, size)) for run in runs]
    bare, learnt = (np.sqrt(np.mean(one**2, axis=1)) for one in error)
    assert np.array_equal(error[0][:2], error[1][:2])
    assert learnt[2] < 0.3 * bare[2]
    # What the sensors' noise leaves, in N rms.
    assert np.all(learnt[4:] < 4.0)


def test_what_is_foreseen_is_the_part_that_repeats_and_has_its_derivatives():
    random, angle = np.random.default_rng(4), 2.0 * math.pi * TURN
    force = 500.0 * np.sin(angle) + 40.0 * np.cos(7.0 * angle)
    known, wandering = (ForcePrediction(SIZE, SIZE * PERIOD, 80.0, 0.02) for _ in range(2))
    for cycle in range(6):
        for learner, seen in ((known, force), (wandering, np.zeros(SIZE))):
            learner.observe(seen + 5.0 * random.standard_normal(SIZE), settled=cycle > 0)
            learner.correct()
        if cycle == 1:
            assert np.max(np.abs(known.table[:-1, 0] - force)) < 10.0
    slow = SIZE * PERIOD / (2.0 * math.pi)
    rate = 500.0 * np.cos(angle) - 280.0 * np.sin(7.0 * angle)
    assert np.std(known.table[:-1, 0] - force) < 2.0
    assert np.std(slow * known.table[:-1, 1] - rate) < 25.0
    assert np.std(wandering.table[:-1, 0]) < 0.8 * np.std(known.table[:-1, 0] - force)


def test_missed_cycles_keep_the_phase_and_do_not_count(rig):
    plant = Plant(rig)
    plant.run(5)
    counted = plant.companion.report()["repetitions"]
    plant.run(0.5)
    plant.cycle += 5
    plant.run(0.5 - 5 / SIZE)
    assert plant.companion.report()["repetitions"] == counted
    assert np.abs(plant.run(1)).max() < 4.0
    assert plant.companion.report()["repetitions"] == counted + 1


def test_after_a_trip_the_cycle_and_the_next_do_not_count_but_what_is_learnt_stays(rig):
    plant = Plant(rig)
    plant.run(5.3)
    counted = plant.companion.report()["repetitions"]
    plant.companion.interrupt()
    plant.added.clear()
    plant.run(1.7)
    # No correction is applied until a whole load cycle has run without it.
    assert np.all(plant.correction[:, :FORESEEN] == 0.0)
    assert plant.companion.report()["repetitions"] == counted
    assert np.abs(plant.run(1)).max() < 4.0
    assert plant.companion.report()["repetitions"] == counted + 1


def test_a_changed_programme_is_left_alone_until_it_is_learnt_and_other_blocks_are_kept(rig):
    def block(number: int) -> Any:
        return lambda k: np.column_stack([np.full(len(k), float(number)), k / SIZE])

    plant = Plant(rig, period=0.0)
    plant.run(5, place=block(1))
    plant.added.clear()
    plant.run(1.4, size=1.1e3, place=block(1))
    # Differs by more than 2 % of the size from where the sine exceeds a fifth.
    assert np.all(plant.correction[SIZE // 8 :, :FORESEEN] == 0.0)
    plant.run(3.6, size=1.1e3, place=block(2))
    assert np.abs(plant.run(1, size=1.1e3, place=block(2))).max() < 4.0
    plant.run(3, size=1.1e3, place=block(1))
    assert np.abs(plant.run(1, size=1.1e3, place=block(1))).max() < 4.0
    assert np.abs(plant.run(1, size=1.1e3, place=block(2))).max() < 4.0


def test_an_error_that_grows_stops_the_correction_at_once(rig):
    plant = Plant(rig)
    plant.run(6)
    plant.run(0.5)
    plant.added.clear()
    plant.run(0.5, swing=200.0)
    assert np.all(plant.correction[20:, :FORESEEN] == 0.0)
    assert "the force error is no longer what it was" in str(plant.companion.report()["state"])
    plant.run(5, swing=200.0)
    assert np.abs(plant.run(1, swing=200.0)).max() < 20.0


def test_what_never_repeats_is_not_corrected(rig):
    plant = Plant(rig)
    plant.run(12, swing=0.0)
    assert np.abs(plant.correction[:, 0]).max() < 1.0
    wandering = Plant(rig)
    for turn in range(8):
        wandering.run(1, size=1e3 + 50.0 * turn)
    assert np.all(wandering.correction[:, :FORESEEN] == 0.0)


def test_what_is_learnt_holds_the_next_day_and_only_for_its_programme(rig):
    plant = Plant(rig)
    plant.run(6)
    last = np.abs(plant.run(1)).max()
    kept = plant.companion.kept()
    assert kept.about["method"] == "waveform"
    again, other = Plant(rig), Plant(rig)
    again.companion.recall(kept)
    assert np.abs(again.run(1)).max() < 1.2 * last
    other.companion.recall(kept)
    assert np.abs(other.run(6, size=2e3)[: SIZE // 8]).max() < 45.0
    assert "another programme" in str(other.companion.report()["file"])
    assert not other.companion.kept().parts
    with pytest.raises(ValueError, match=r"reference\.estimate"):
        Plant(rig, method="harmonics").companion.recall(kept)


@pytest.mark.parametrize(
    ("name", "spoil", "said"),
    [
        ("reference.spectrum", lambda array: 1e3 * array, "would be corrected by"),
        ("reference.spectrum", lambda array: array + np.nan, "not a number"),
        ("reference.spectrum", lambda array: array.real.copy(), "has the type float64"),
        ("reference.estimate", lambda array: array[:-1], "has the shape"),
        ("reference.estimate", lambda array: array + 1e6, "exceeds the rig's force"),
        ("reference.variance", lambda array: -array, "out of 0"),
        ("limits", lambda array: array + np.nan, "not a number"),
        ("period", lambda array: array + 2.0, "has 500 samples"),
        ("wanted", lambda array: array[:3], "a load cycle has 3 samples"),
        ("wanted", lambda _: None, "a load cycle has 0 samples"),
        ("other", lambda _: np.zeros(3), "'other' is unknown"),
    ],
)
def test_what_cannot_have_been_learnt_on_the_rig_is_refused(rig, name, spoil, said):
    plant = Plant(rig, limits=rig.limits)
    plant.run(6)
    block = dict(plant.companion.kept().parts[0])
    spoilt = spoil(block.get(name))
    block = {**block, name: spoilt} if spoilt is not None else {key: array for key, array in block.items() if key != name}
    with pytest.raises(ValueError, match=said):
        Plant(rig, limits=rig.limits).companion.recall(Kept({}, {0: block}))


@pytest.mark.parametrize(("swing", "said"), [(1.7e3, "would be corrected by"), (4e3, "the force is lost")])
def test_a_correction_beyond_the_bounds_of_the_rig_is_given_up(rig, swing, said):
    """The error is several times the reference: no loop needs that much, so it is not the repeating part."""
    plant = Plant(rig, limits=rig.limits._replace(force=2e4))
    plant.run(8, size=300.0, swing=swing)
    assert np.abs(plant.correction[:, 0]).max() < 0.06 * 2e4
    assert said in str(plant.companion.report()["state"])


@pytest.mark.parametrize("period", [0.0123456, 5e-3])
def test_a_period_is_a_whole_number_of_cycles(rig, period):
    with pytest.raises(BadInput, match="multiple of the control_period"):
        Plant(rig, period=period)
