"""The diagnosis piece by piece: windows, reading of the data, kernels, stages, evidence, fits, verdict."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.signal import lfilter

from ehls_ros.diagnosis import fit as fits
from ehls_ros.diagnosis import record as records
from ehls_ros.diagnosis import verdict
from ehls_ros.diagnosis.evidence import Errors, Evidence, loss, weights
from ehls_ros.diagnosis.fit import Fit, Worker
from ehls_ros.diagnosis.hypotheses import at_lines, candidates, extended
from ehls_ros.diagnosis.judged import Judged, held_out
from ehls_ros.diagnosis.pool import Pool
from ehls_ros.diagnosis.record import prepare
from ehls_ros.diagnosis.search import RELEVANT, SHOWN, Searched, mends_form, shows
from ehls_ros.diagnosis.stages import CHANNELS, Comparison, setup
from ehls_ros.diagnosis.starts import Starts, _promise, lines_of
from ehls_ros.diagnosis.windows import smooth_window
from ehls_ros.errors import BadInput
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.parameters import Sensor
from ehls_ros.physics.plant import FRICTION, PL, XV, V
from ehls_ros.physics.rig import EffectUse, rig_from_mapping, rig_to_mapping
from ehls_ros.physics.sensors import POSITION, VELOCITY
from ehls_ros.physics.simulator import Simulator
from ehls_ros.trajectory import Trajectory

PERIOD = 1e-3


def use(name, **values):
    return EffectUse(name, EFFECTS.load(name).Parameters(**values))


# ------------------------------------------------------------------------------------------------------------- windows


@pytest.mark.parametrize("samples", [8, 40, 41])
def test_derivatives_by_parts_are_exact_for_parabolas(samples):
    w = smooth_window(samples, PERIOD)
    t = PERIOD * np.arange(200)
    middle = t[w.starts(len(t))] + 0.5 * samples * PERIOD
    x = 3.0 - 2.0 * t + 5.0 * t**2
    assert w.mean(np.ones_like(t)) == pytest.approx(1.0, abs=1e-12)
    # What is off here is off in every balance: it has to stay well below what is taken for relevant.
    np.testing.assert_allclose(w.rate(x), -2.0 + 10.0 * middle, rtol=RELEVANT)
    np.testing.assert_allclose(w.acceleration(x), 10.0, rtol=RELEVANT)


def test_derivatives_by_parts_are_those_of_the_window_mean():
    w = smooth_window(40, PERIOD)
    t = PERIOD * np.arange(1000)
    for frequency in (0.5, 5.0, 15.0):
        rate = 2.0 * np.pi * frequency
        # The derivative of the mean is the mean of the derivative: no error of differences, which would be (rate T)^2 / 24.
        np.testing.assert_allclose(w.rate(np.sin(rate * t)), w.mean(rate * np.cos(rate * t)), atol=2e-5 * rate)
        np.testing.assert_allclose(w.acceleration(np.sin(rate * t)), w.mean(-(rate**2) * np.sin(rate * t)), atol=5e-4 * rate**2)


def test_noise_of_a_window_is_that_of_its_weights():
    w = smooth_window(40, PERIOD, hop=1)
    noise = np.random.default_rng(0).standard_normal(400_000)
    assert np.std(w.mean(noise)) == pytest.approx(np.linalg.norm(w.weights), rel=0.05)
    assert np.std(w.rate(noise)) == pytest.approx(np.linalg.norm(w.slopes), rel=0.05)
    assert np.std(w.acceleration(noise)) == pytest.approx(np.linalg.norm(w.curvatures), rel=0.05)


def test_a_signal_shorter_than_a_window_has_no_windows():
    w = smooth_window(40, PERIOD)
    assert w.starts(40).size == w.mean(np.zeros(40)).size == 0
    assert w.starts(41).size == w.mean(np.zeros(41)).size == 1
    assert w.starts(500).size == w.mean(np.zeros(500)).size


# -------------------------------------------------------------------------------------------------------------- record


def plain(n=4000, period=PERIOD, seed=0):
    """Return a plausible recording of sines, with noise."""
    rng = np.random.default_rng(seed)
    t = period * np.arange(n)
    return t, {
        "position_m": 0.02 * np.sin(3.0 * t) + 2e-6 * rng.standard_normal(n),
        "load_pressure_pa": 1e6 * np.cos(3.0 * t) + 1e3 * rng.standard_normal(n),
        "valve_command_m": 1e-4 * np.sign(np.sin(5.0 * t)),
    }


def test_a_clean_recording_is_taken_as_it_is(rig):
    t, signals = plain()
    r = prepare(Trajectory(t, signals), rig, "it")
    np.testing.assert_array_equal(r.signals["valve_command_m"], signals["valve_command_m"])
    assert all(np.mean(good) > 0.99 for good in r.good.values())
    assert r.period == pytest.approx(PERIOD)
    assert list(np.flatnonzero(r.fresh)) == [0]
    assert r.noise["position_m"] == pytest.approx(2e-6, rel=0.1)
    assert r.noise["load_pressure_pa"] == pytest.approx(1e3, rel=0.1)
    assert "spool_m" not in r
    np.testing.assert_array_equal(r.values("spool_m"), 0.0)


def test_quantisation_counts_as_noise(rig):
    t, signals = plain(8000)
    for step in (5e-6, 1e-4):
        coarse = signals | {"position_m": np.round(signals["position_m"] / step) * step}
        found = prepare(Trajectory(t, coarse), rig, "it").noise["position_m"]
        assert found == pytest.approx(math.hypot(2e-6, step / math.sqrt(12.0)), rel=0.35)


def test_uneven_time_comes_onto_even_time(rig):
    t, signals = plain()
    at = t + 2e-4 * np.sin(np.arange(len(t)))
    signals["position_m"] = 0.02 * np.sin(3.0 * at)
    r = prepare(Trajectory(at, signals), rig, "it")
    np.testing.assert_allclose(np.diff(r.time), r.period, rtol=1e-9)
    np.testing.assert_allclose(r.signals["position_m"], 0.02 * np.sin(3.0 * r.time), atol=1e-7)
    assert any("uneven" in remark for remark in r.remarks)


def test_lost_samples_are_filled_in_and_longer_gaps_marked(rig):
    t, signals = plain()
    keep = np.random.default_rng(1).random(len(t)) > 0.01
    keep[1000:1100] = False
    keep[0] = keep[-1] = True
    r = prepare(Trajectory(t[keep], {n: a[keep] for n, a in signals.items()}), rig, "it")
    assert len(r.time) == len(t)
    np.testing.assert_allclose(r.signals["position_m"][keep], signals["position_m"][keep], atol=1e-7)
    assert not r.good["position_m"][1010:1090].any()
    assert np.mean(r.good["position_m"]) > 0.97
    assert any("missing" in remark for remark in r.remarks)
    # A held command stays what it was, and changes nowhere between its two values.
    assert set(np.unique(r.signals["valve_command_m"])) <= {-1e-4, 0.0, 1e-4}


def test_nan_and_outliers_are_left_out(rig):
    t, signals = plain()
    signals["load_pressure_pa"][500:530] = np.nan
    signals["position_m"][[700, 1500, 2500]] += 0.01
    r = prepare(Trajectory(t, signals), rig, "it")
    assert all(np.isfinite(a).all() for a in r.signals.values())
    assert not r.good["load_pressure_pa"][503:527].any()
    np.testing.assert_allclose(r.signals["position_m"], 0.02 * np.sin(3.0 * t), atol=2e-5)


def test_a_short_oscillation_is_no_outlier(rig):
    t, signals = plain()
    spool = 1e-7 * np.random.default_rng(3).standard_normal(len(t))
    ringing = slice(2000, 2060)
    # As fast as a valve turns round: every sample is far from its neighbours' median.
    spool[ringing] += 8e-4 * np.sin(2.0 * np.pi * 60.0 * (t[ringing] - t[2000]))
    spool[[800, 2030]] += (4e-4, 5e-3)
    r = prepare(Trajectory(t, signals | {"spool_m": spool}), rig, "it")
    out = np.flatnonzero(np.abs(r.signals["spool_m"] - spool) > 1e-6)
    # A wrong sample amid fast ones may take one beside it along.
    assert {800, 2030} <= set(out) <= {800, *range(2025, 2036)}
    assert len(out) <= 4


def test_lone_spikes_of_a_command_go_and_its_steps_stay(rig):
    t, signals = plain()
    command = np.repeat(1e-4 * np.random.default_rng(2).integers(-3, 4, 40), 100).astype(float)
    spiked = command.copy()
    spiked[[150, 950, 2550]] += 5e-3
    r = prepare(Trajectory(t, signals | {"valve_command_m": spiked}), rig, "it")
    np.testing.assert_array_equal(r.signals["valve_command_m"], command)


def test_a_lone_command_that_the_spool_answers_was_sent(rig):
    t, signals = plain()
    command = 1e-6 * np.sin(20.0 * t)
    command[[900, 1900, 2900]] = 1e-3
    # The last two were not sent: the spool stands, or was read wrong together with the command.
    sent = np.where(np.isin(np.arange(len(t)), [1900, 2900]), 0.0, command)
    keeps = math.exp(-rig.plant.valve_bandwidth * PERIOD)
    spool = lfilter([0.0, rig.plant.valve_gain * (1.0 - keeps)], [1.0, -keeps], sent)
    spool += 5e-7 * np.random.default_rng(4).standard_normal(len(t))
    spool[2900] += 1e-3
    r = prepare(Trajectory(t, signals | {"valve_command_m": command, "spool_m": spool}), rig, "it")
    left = r.signals["valve_command_m"]
    np.testing.assert_array_equal(np.flatnonzero(left > 1e-4), [900])


def test_a_signal_without_a_finite_sample_is_left_out(rig):
    t, signals = plain()
    r = prepare(Trajectory(t, signals | {"spool_m": np.full(len(t), np.nan)}), rig, "it")
    assert "spool_m" not in r
    assert any("spool_m" in remark for remark in r.remarks)


@pytest.mark.parametrize(
    ("name", "factor"),
    [("position_m", 1e3), ("load_pressure_pa", 1e3), ("force_n", 1e3), ("velocity_m_s", 1e3), ("supply_pressure_pa", 1e3)],
)
def test_a_wrong_unit_is_refused(rig, recorded, name, factor):
    c = recorded({}, "rich", seed=1, duration=3.0).columns
    t = PERIOD * np.arange(len(c[name]))
    prepare(Trajectory(t, c), rig, "it")
    with pytest.raises(BadInput, match=name):
        prepare(Trajectory(t, c | {name: factor * c[name]}), rig, "it")


@pytest.mark.parametrize("spoil", ["backwards", "twice", "nan", "short", "mostly nan"])
def test_what_cannot_be_read_is_refused(rig, spoil):
    t, signals = plain(1000)
    if spoil == "backwards":
        t = t[::-1].copy()
    elif spoil == "twice":
        t[500] = t[499]
    elif spoil == "nan":
        t[500] = np.nan
    elif spoil == "short":
        t, signals = t[:50], {n: a[:50] for n, a in signals.items()}
    else:
        signals["position_m"][:400] = np.nan
    with pytest.raises(BadInput, match="it"):
        prepare(Trajectory(t, signals), rig, "it")


def test_of_a_long_recording_stretches_are_taken(rig):
    t, signals = plain(40_000, period=0.01)
    r = prepare(Trajectory(t, signals), rig, "it")
    assert len(r.time) * r.period == pytest.approx(records.LONGEST_WHOLE, rel=0.02)
    assert np.sum(r.fresh) == records.STRETCHES
    assert r.duration == pytest.approx(400.0, rel=0.01)
    begins = np.flatnonzero(r.fresh)
    assert np.all(np.diff(r.time) > 0.0)
    assert np.all(np.diff(r.time)[begins[1:] - 1] > 0.1)
    good = r.good["position_m"]
    assert np.mean(good) > 0.99
    np.testing.assert_allclose(r.signals["position_m"][good], 0.02 * np.sin(3.0 * r.time)[good], atol=1e-4)


# ------------------------------------------------------------------------------------------------------------- kernels


def perfect(rig):
    return rig._replace(sensors=dict.fromkeys(rig.sensors, Sensor()))


def simulated(rig, seconds=6.0):
    """Run the product's simulator open loop, and return trajectory and friction force [N]."""
    simulator = Simulator(rig, PERIOD)
    cycles = round(seconds / PERIOD)
    rows, friction = np.empty((cycles, 6)), np.empty(cycles)
    elements = len(simulator.mode) - 1
    t = PERIOD * np.arange(cycles)
    command = 6e-5 * np.sin(2 * np.pi * 0.7 * t) + 3e-5 * np.sin(2 * np.pi * 2.3 * t)
    load = 2e3 * np.sin(2 * np.pi * 0.4 * t)
    rate = np.append(np.diff(load), 0.0) / PERIOD
    for k in range(cycles):
        y, read = simulator.y, simulator.measure(np.zeros(7))
        rows[k] = read[POSITION], read[VELOCITY], y[PL], y[XV], command[k], load[k]
        friction[k] = y[FRICTION : FRICTION + elements].sum() + rig.friction.viscous_coefficient * y[V]
        simulator.advance(command[k], load[k], rate[k], 0.0, 0.0)
    names = ("position_m", "velocity_m_s", "load_pressure_pa", "spool_m", "valve_command_m", "disturbance_force_n")
    signals = {n: rows[:, i].copy() for i, n in enumerate(names)}
    signals |= {"force_n": rig.plant.piston_area * signals["load_pressure_pa"]}
    signals |= {"supply_pressure_pa": np.full(cycles, rig.plant.supply_pressure)}
    return Trajectory(t, signals), friction


def compared(trajectory, rig):
    r = prepare(trajectory, rig, "simulated")
    return Comparison(r, setup(r, rig)), r


@pytest.mark.parametrize("model", ["gms", "lugre"])
def test_friction_along_a_motion_is_the_simulators(rig, model):
    mapping = rig_to_mapping(perfect(rig))
    ours = rig_from_mapping({**mapping, "friction": {**mapping["friction"], "model": model}}, "rig")
    trajectory, friction = simulated(ours)
    comparison, _ = compared(trajectory, ours)
    found = comparison.friction(ours)[:, 0]
    late = trajectory.time_s > 0.5
    assert np.ptp(friction[late]) > 1500.0
    assert np.sqrt(np.mean((found - friction)[late] ** 2)) < 1.0


@pytest.mark.parametrize(
    ("mode", "hinge"), [({"piston_share": 0.25, "frequency": 20.0, "damping": 0.1}, {}), ({}, {"load_gap": 2e-4})]
)
def test_a_load_parted_from_the_piston_moves_as_in_the_simulator(rig, mode, hinge):
    ours = perfect(rig).with_effects((use("flexible_mode", **mode), use("hinge_backlash", **hinge)))
    trajectory, friction = simulated(ours, 4.0)
    comparison, _ = compared(trajectory, ours)
    late = trajectory.time_s > 0.5
    assert np.ptp(friction[late]) > 1500.0
    found = comparison.load(ours.effective())[:, 2]
    assert np.sqrt(np.mean((found - friction)[late] ** 2)) < 1.0
    left, as_one = (comparison.residuals(r, ("force",))["force"][40:-40] for r in (ours, perfect(rig)))
    assert np.sqrt(np.mean(left**2)) < min(1.0, 0.02 * np.sqrt(np.mean(as_one**2)))


@pytest.mark.parametrize(
    "effects",
    [
        (),
        (use("command_delay", delay=0.0037),),
        (use("command_delay", delay=0.001),),
        (use("valve_bandwidth_shift", factor=0.5), use("command_delay", delay=0.00025)),
    ],
    ids=["plain", "fractional delay", "whole delay", "slower and late"],
)
def test_the_spool_along_a_command_is_the_simulators(rig, effects):
    ours = perfect(rig).with_effects(effects)
    trajectory, _ = simulated(ours, 2.0)
    comparison, r = compared(trajectory, ours)
    assert np.array_equal(r.signals["valve_command_m"], trajectory["valve_command_m"])
    # The integrator's error is what is left; (4) is followed exactly here.
    assert np.max(np.abs(comparison.simulated_spool(ours.effective()) - trajectory["spool_m"])) < 1e-9


@pytest.mark.parametrize("name", ["valve_second_order", "valve_hysteresis"])
def test_spools_with_a_memory_are_the_simulators(rig, name):
    values = {"valve_second_order": {"natural_frequency": 90.0}, "valve_hysteresis": {"width": 2e-5}}[name]
    ours = perfect(rig).with_effects((use(name, **values),))
    trajectory, _ = simulated(ours, 2.0)
    comparison, _ = compared(trajectory, ours)
    found = comparison.simulated_spool(ours)
    moved = np.max(np.abs(found - comparison.simulated_spool(perfect(rig))))
    assert moved > 1e-6
    assert np.max(np.abs(found - trajectory["spool_m"])) < 0.05 * moved


# -------------------------------------------------------------------------------------------------------------- stages


@pytest.fixture(scope="module")
def quiet(rig):
    ours = perfect(rig)
    trajectory, _ = simulated(ours)
    return ours, *compared(trajectory, ours)


def test_the_models_own_experiment_leaves_no_residual(quiet, rig):
    ours, comparison, _ = quiet
    assert set(comparison.setup.channels) == set(CHANNELS)
    left = comparison.residuals(ours)
    # rms against the noise that the rig's sensors would make of it, and against the terms that cancel
    most = {"spool": 1e-9, "volume": 5e-8, "supply": 1e-6, "force": 2.0, "cell": 1e-6, "velocity": 5e-6}
    for channel, values in left.items():
        rms = float(np.sqrt(np.mean(values[20:-20] ** 2)))
        assert rms < most[channel], (channel, rms)
    # and a wrong model does
    wrong = comparison.residuals(ours.with_effects((use("mass_shift", factor=1.3), use("bulk_modulus_shift", factor=0.5))))
    for channel in ("force", "volume"):
        assert np.std(wrong[channel][20:-20]) > 5.0 * np.std(left[channel][20:-20]), channel
    for channel in ("spool", "supply", "cell", "velocity"):
        np.testing.assert_array_equal(wrong[channel], left[channel])


def test_residuals_that_are_said_to_be_equal_are(quiet):
    ours, comparison, r = quiet
    before, known = comparison.relevant(ours), comparison.residuals(ours)
    for name in EFFECTS.names():
        forms = EFFECTS.load(name).forms(ours)
        for form in forms:
            values = dict(form.fixed)
            for parameter, starts in form.free.items():
                neutral = EFFECTS.load(name).Parameters._field_defaults[parameter]
                number = next((s for s in starts if isinstance(s, float)), None)
                values[parameter] = number if number is not None else 1.1 * neutral if neutral else 1e-4
            other = ours.with_effects((use(name, **values),))
            key = comparison.relevant(other)
            again = comparison.residuals(other)
            for channel, residual in Comparison(r, comparison.setup).residuals(other).items():
                # Whatever was looked at before, or on another thread.
                np.testing.assert_array_equal(residual, again[channel], err_msg=f"{name} {values} {channel}, remembered")
                if key[channel] == before[channel]:
                    np.testing.assert_array_equal(residual, known[channel], err_msg=f"{name} {values} {channel}")


@pytest.mark.parametrize(
    ("left_out", "channels"),
    [
        ((), {"spool", "volume", "supply", "force", "cell", "velocity"}),
        (("spool_m",), {"volume", "supply", "force", "cell", "velocity"}),
        (("valve_command_m",), {"volume", "supply", "force", "cell", "velocity"}),
        (("spool_m", "valve_command_m"), {"force", "cell", "velocity"}),
        (("position_m",), {"spool", "volume", "supply", "cell"}),
        (("position_m", "velocity_m_s"), {"spool", "cell"}),
        (("load_pressure_pa",), {"spool", "volume", "supply", "force", "velocity"}),
        (("load_pressure_pa", "force_n"), {"spool", "velocity"}),
        (("supply_pressure_pa",), {"spool", "volume", "force", "cell", "velocity"}),
    ],
)
def test_missing_signals_narrow_what_is_compared(quiet, left_out, channels):
    ours, _, r = quiet
    some = r._replace(signals={n: a for n, a in r.signals.items() if n not in left_out})
    used = setup(some, ours)
    assert set(used.channels) == channels
    left = Comparison(some, used).residuals(ours)
    assert all(np.all(np.isfinite(values)) for values in left.values())


# ------------------------------------------------------------------------------------------------------------ evidence


@pytest.fixture(scope="module")
def noisy(rig, recorded):
    r = recorded({}, "rich", seed=11, duration=20.0)
    return prepare(Trajectory(r.time, r.columns), rig, "noisy")


@pytest.fixture(scope="module")
def evidence(noisy, rig):
    return Evidence(noisy, rig, setup(noisy, rig), 0)


def test_what_is_consistent_is_as_large_as_its_noise(evidence):
    assert set(evidence.channels) == set(CHANNELS)
    for channel, e in evidence.base.values.items():
        # The floor holds a tolerance beside the noise: against the noise alone it is as large as that.
        e_noise = evidence.noisy_base.values[channel] - e
        assert 0.8 < np.sqrt(np.mean(e * e) / np.mean(e_noise**2)) < 1.2, channel
        assert 0.5 < np.sqrt(np.mean(e * e)) < 1.2, channel
        assert len(e) == len(evidence.block[channel]) == len(evidence.times(channel)) == len(evidence.floor[channel])
        assert set(evidence.block[channel]) == set(range(evidence.blocks)), channel


def test_windows_with_a_gap_do_not_count(noisy, rig, evidence):
    bad = {name: good.copy() for name, good in noisy.good.items()}
    bad["load_pressure_pa"][9000:9200] = False
    gapped = Evidence(noisy._replace(good=bad), rig, setup(noisy, rig), 0)
    for channel in ("force", "volume"):
        inside = np.abs(gapped.times(channel) - 9.1) < 0.1
        assert not inside.any(), channel
        assert np.any(np.abs(evidence.times(channel) - 9.1) < 0.1), channel
    assert len(gapped.times("spool")) == len(evidence.times("spool"))


def test_hubers_loss_and_its_weights_agree():
    e = np.linspace(-20.0, 20.0, 4001)
    slope = np.gradient(loss(e), e)
    np.testing.assert_allclose(slope, weights(e) * e, atol=0.02)
    assert loss(np.array([2.0]))[0] == 2.0


# ----------------------------------------------------------------------------------------------------------------- fit


def worker_of(recorded, rig, hidden, seed=12, duration=12.0):
    r = recorded(hidden, "rich", seed=seed, duration=duration)
    kept = prepare(Trajectory(r.time, r.columns), rig, "it")
    found, _ = candidates(kept, rig, [])
    return Worker(Evidence(kept, rig, setup(kept, rig), 0)), {(c.name, c.number): c for c in found}


def test_gauss_newton_finds_what_enters_linearly(recorded, rig):
    worker, found = worker_of(recorded, rig, {"spring_rate_shift": {"factor": 1.2}})
    spring = found["spring_rate_shift", 0]
    done = worker.fit(worker.start((spring,), spring.neutral))
    assert done.settled
    assert done.channels == ("force",)
    assert done.values[spring.free.index("added")] == pytest.approx(8000.0, rel=0.01)
    assert done.loss < 0.01 * float(np.sum(loss(worker.evidence.base.values["force"])))


def test_gauss_newton_finds_a_kink(recorded, rig):
    worker, found = worker_of(recorded, rig, {"valve_dead_zone": {"positive": 4e-5, "negative": 3e-5, "site": "ports"}})
    overlap = found["valve_dead_zone", 0]
    reached = [worker.fit(worker.start((overlap,), start)) for start in overlap.starts]
    best = min(reached, key=lambda f: f.loss)
    np.testing.assert_allclose(best.values, [4e-5, 3e-5], rtol=0.05)
    assert np.all(best.values >= overlap.lower)


def test_what_does_not_depend_on_a_change_is_taken_over(recorded, rig, monkeypatch):
    worker, found = worker_of(recorded, rig, {"spring_rate_shift": {"factor": 1.2}, "valve_hysteresis": {"width": 2e-5}})
    spring, valve = found["spring_rate_shift", 0], found["valve_hysteresis", 0]
    alone = worker.fit(worker.start((spring,), spring.neutral))
    both = np.concatenate([alone.values, valve.starts[-1]])
    begin = worker.start((spring, valve), both)
    moved = both * np.where(np.arange(len(both)) < len(alone.values), 1.0, 1.1)
    fresh = worker.start((spring, valve), moved, begin.steps)

    def unasked(self, rig):
        raise AssertionError

    with monkeypatch.context() as patch:
        patch.setattr(Comparison, "_force", unasked)
        again = worker.again(begin, moved)
        done = worker.fit(again)
    np.testing.assert_allclose(again.jacobian, fresh.jacobian, rtol=1e-6, atol=1e-6 * np.max(np.abs(fresh.jacobian)))
    # What has settled stays, while the other goes its way.
    np.testing.assert_array_equal(done.values[: len(alone.values)], alone.values)
    assert done.values[-1] == pytest.approx(2e-5, rel=0.1)


def test_a_fit_that_starts_where_its_causes_do_nothing_stays_there(recorded, rig):
    worker, found = worker_of(recorded, rig, {"spring_hardening": {"cubic": -2e5}})
    never = next(c for c in found.values() if c.name == "end_stop" and len(c.free) > 1)
    begin = worker.start((never,), never.neutral)
    assert begin.channels == ()
    done = worker.fit(begin)
    assert done.settled
    np.testing.assert_array_equal(done.values, never.neutral)
    assert sum(gain.sum() for gain in held_out(worker.evidence, done, worker).gain.values()) == 0.0


def test_causes_that_all_but_cancel_are_fitted_from_where_they_do(recorded, rig):
    worker, found = worker_of(recorded, rig, {"mass_shift": {"factor": 0.94}, "constant_load": {"force": -45.0}})
    load, mass = found["constant_load", 0], found["mass_shift", 0]
    alone = worker.fit(worker.start((load,), load.neutral))
    gain, begin = _promise(worker.evidence, alone, worker.start((mass,), mass.neutral))
    assert gain > 100.0
    # What is promised is there at the first step, not only after the fit.
    assert alone.loss - worker.first(begin).loss > 0.8 * gain


def test_a_cause_starts_otherwise_beside_what_hid_it(recorded, rig):
    hidden = {"presliding_stiffness_shift": {"factor": 4.7}, "pressure_sensor_lag": {"time_constant": 0.012}}
    worker, found = worker_of(recorded, rig, hidden)
    few = [found["presliding_stiffness_shift", 0], found["pressure_sensor_lag", 0]]
    pool = Pool(worker.evidence, 1)
    try:
        starts = Starts(worker.evidence, pool, few, lambda what, part: None)
        lag = worker.fit(next(f for f in starts.alone if f.hypothesis == (few[1],)))
        beside = starts.beside(Judged(lag, held_out(worker.evidence, lag)))
    finally:
        pool.close()
    alone, after = (next(f.values[0] for f in fits if f.hypothesis == (few[0],)) for fits in (starts.alone, beside))
    # The start nearest to the truth, which the lag's error had covered.
    assert after == max(few[0].starts) == 3.0
    assert alone < after


def test_derivatives_follow_steps_without_being_worked_out_anew(recorded, rig):
    worker, found = worker_of(recorded, rig, {"hinge_backlash": {"gap": 3e-4}})
    play = next(c for c in found.values() if c.name == "hinge_backlash" and c.parts_load)
    begin = worker.start((play,), play.starts[-1])
    moved = np.clip(begin.values * 1.02, play.lower, play.upper)
    errors = worker.errors(extended(worker.evidence.rig, (play,), moved), begin.errors)
    after = worker._secant(begin, moved, errors, 0.0)
    change = errors.together(begin.channels) - begin.errors.together(begin.channels)
    assert np.linalg.norm(change - begin.jacobian @ (moved - begin.values)) > 0.05 * np.linalg.norm(change)
    np.testing.assert_allclose(after.jacobian @ (moved - begin.values), change, rtol=1e-6, atol=1e-6)


def test_a_step_stays_within_the_ranges():
    j, e = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]]), np.array([1.0, -2.0, 0.0])
    lower, upper = np.zeros(2), np.full(2, 10.0)
    step = fits.gauss_newton(j, e, 0.0, np.zeros(2), lower, upper)
    # Unbounded it would go to negative values of the first; held at 0, the second alone is least squares.
    np.testing.assert_allclose(step, [0.0, 1.0], atol=1e-9)


def linear_case(seed=3, blocks=6, rows=20):
    """Return evidence-like data and the fit of a linear model to them, all within the quadratic part of the loss."""
    rng = np.random.default_rng(seed)
    n = blocks * rows
    j = rng.standard_normal((n, 2)) * [1.0, 50.0]
    base = 0.4 * rng.standard_normal(n) + j @ [0.5, -0.01]
    values = -np.linalg.lstsq(j, base, rcond=None)[0]
    e = base + j @ values
    assert np.max(np.abs(e)) < 2.0
    data = SimpleNamespace(
        block={"force": np.repeat(np.arange(blocks), rows)}, blocks=blocks, base=Errors({"force": base}), channels=("force",)
    )
    fit = Fit((), values, ("force",), Errors({"force": e}), j, float(np.sum(loss(e))), np.ones(2))
    return data, fit, base


@pytest.mark.parametrize("spoilt", [np.nan, np.inf, 1e200])
def test_a_model_that_has_diverged_has_no_way_on(spoilt):
    rng = np.random.default_rng(3)
    j, e = rng.standard_normal((50, 2)), rng.standard_normal(50)
    j[7, 1] = spoilt
    wide = np.full(2, 1e6)
    np.testing.assert_array_equal(fits.gauss_newton(j, e, 0.0, np.zeros(2), -wide, wide), [0.0, 0.0])


def test_held_out_blocks_are_those_of_fits_without_them():
    data, fit, base = linear_case()
    held = held_out(data, fit)
    block, j = data.block["force"], fit.jacobian
    for b in range(data.blocks):
        inside = block == b
        others = minimize(lambda v, out=~inside: float(np.sum(loss((base + j @ v)[out]))), fit.values, tol=1e-14).x
        expected = base[inside] + j[inside] @ others
        np.testing.assert_allclose(held.errors.values["force"][inside], expected, atol=1e-4)
        assert held.gain["force"][b] == pytest.approx(np.sum(loss(base[inside]) - loss(expected)), abs=1e-3)
    assert np.all(held.disagreement >= 1.0)


def test_parameters_scatter_as_their_covariance_says():
    found, said = [], []
    for seed in range(300):
        data, fit, _ = linear_case(seed, blocks=12)
        found.append(fit.values)
        said.append(np.sqrt(np.diag(held_out(data, fit).covariance)))
    # Noise of the case is 0.4, and a covariance never claims less than noise of 1: it may be wide, not narrow.
    ratio = np.std(found, axis=0) / np.mean(said, axis=0)
    assert np.all(ratio < 1.1)
    assert np.all(ratio > 0.2)


def test_lines_of_a_residual_are_found():
    t = 0.0133 * np.arange(1500)
    e = 3.0 * np.sin(2 * np.pi * 7.3 * t) + np.sin(2 * np.pi * 2.1 * t) + np.random.default_rng(4).standard_normal(len(t))
    first, second = lines_of(e, t, 2)
    assert first == pytest.approx(7.3, abs=0.02)
    assert second == pytest.approx(2.1, abs=0.03)


# ---------------------------------------------------------------------------------------------------------- hypotheses


def test_every_form_of_every_effect_is_asked_about(noisy, rig):
    signals = noisy.signals | {"disturbance_displacement_m": np.zeros(len(noisy.time))}
    found, out = candidates(noisy._replace(signals=signals), rig, [3.0, 5.0, 7.0])
    assert not out
    asked = {(c.name, c.number) for c in found}
    assert asked == {(n, i) for n in EFFECTS.names() for i in range(len(EFFECTS.load(n).forms(rig)))}
    for c in found:
        assert len(c.free) >= 1
        assert c.starts.shape[1] == len(c.free) == len(c.units) == len(c.neutral)
        assert np.all(c.starts >= c.lower)
        assert np.all(c.starts <= c.upper)
        # Beyond its range a value is held at its end.
        for beyond in (c.lower - 1.0, c.upper + 1.0):
            extended(rig, (c,), np.nan_to_num(beyond, posinf=1e30, neginf=-1e30))


def test_what_the_data_do_not_hold_is_not_asked_about(noisy, rig):
    found, out = candidates(noisy, rig, [])
    assert set(out) == {"coupling_stiffness"}
    assert "disturbance_displacement_m" in out["coupling_stiffness"]
    fewer = {n: a for n, a in noisy.signals.items() if n != "oil_temperature_k"}
    found, out = candidates(noisy._replace(signals=fewer), rig, [])
    assert set(out) == {"coupling_stiffness", "temperature_dependent_friction"}
    assert not {c.name for c in found} & set(out)
    found, out = candidates(noisy, rig.with_effects((use("coulomb_shift", offset=10.0),)), [])
    assert "coulomb_shift" in out
    assert "coulomb_shift" not in {c.name for c in found}


def test_only_what_starts_at_lines_is_asked_about_at_other_lines(noisy, rig):
    found, _ = candidates(noisy, rig, [11.0, 12.0, 13.0])
    again = at_lines(found, noisy, rig, [3.5, 7.5, 0.5])
    assert {c.name for c in again} == {"periodic_disturbance", "flexible_mode"}
    for c in again:
        assert set(c.starts[:, c.free.index("frequency")]) == {3.5, 7.5}
    assert at_lines(found, noisy, rig, []) == []


# ------------------------------------------------------------------------------------------------------------- verdict


def judged(data, name, fit, noisy, rig):
    found, _ = candidates(noisy, rig, [])
    candidate = next(c for c in found if c.name == name and len(c.free) == 1)
    whole = fit._replace(hypothesis=(candidate,))
    return Judged(whole, held_out(data, whole))


def verdict_case(noisy, rig, spoil):
    """Return data, and what a search would find: a cause, and another that explains the same but for what is spoilt."""
    rng = np.random.default_rng(5)
    blocks, rows = 12, 60
    n = blocks * rows
    j = rng.standard_normal((n, 1))
    noise = rng.standard_normal(n)
    base = noise + 3.0 * j[:, 0]
    data = SimpleNamespace(
        block={"force": np.repeat(np.arange(blocks), rows)},
        blocks=blocks,
        base=Errors({"force": base}),
        noisy_base=Errors({"force": base + rng.standard_normal(n)}),
        channels=("force",),
        floor={"force": np.ones(n)},
        sizes={"force": 100.0},
        nrmse=lambda channel, e: float(np.sqrt(np.mean(e**2))) / 100.0,
    )

    def fitted(name, column):
        value = -np.linalg.lstsq(column, base, rcond=None)[0]
        e = base + column @ value
        return judged(data, name, Fit((), value, ("force",), Errors({"force": e}), column, 0.0, np.ones(1)), noisy, rig)

    best = fitted("mass_shift", j)
    rival = fitted("viscous_shift", j + spoil * rng.standard_normal((n, 1)))
    nothing = Fit((), np.empty(0), (), data.base, np.empty((0, 0)), 0.0, np.empty(0))
    found = Searched(best, (Judged(nothing, held_out(data, nothing)),), ((rival,),), (best, rival), (), {"force": 1.0})
    return data, found


def test_what_explains_the_same_is_equivalent(noisy, rig):
    data, found = verdict_case(noisy, rig, 0.0)
    (cause,) = verdict.causes(data, found, 0)
    assert cause.name == "mass_shift"
    assert cause.equivalent_to == ("viscous_shift",)
    assert 0.4 < cause.probability < 0.6
    assert cause.stage == "force_balance"
    assert cause.rivals[0].behind == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(("second", "sure"), [("viscous_shift", 0.7), ("valve_gain_shift", 1.0)])
def test_two_causes_in_one_stage_may_be_one_that_nobody_described(noisy, rig, second, sure):
    data, found = verdict_case(noisy, rig, 0.3)
    (nothing,) = found.rests
    columns = np.hstack(
        [found.best.fit.jacobian, np.random.default_rng(6).standard_normal((len(data.base.values["force"]), 1))]
    )
    known, _ = candidates(noisy, rig, [])
    both = tuple(next(c for c in known if c.name == name and len(c.free) == 1) for name in ("mass_shift", second))
    fit = found.best.fit._replace(
        hypothesis=both, values=np.append(found.best.fit.values, 0.0), jacobian=columns, steps=np.ones(2)
    )
    best = Judged(fit, held_out(data, fit))
    named = verdict.causes(data, found._replace(best=best, rests=(nothing, nothing), rivals=((), ())), 0)
    assert sure - 0.15 < next(cause.probability for cause in named if cause.name == "mass_shift") <= sure


@pytest.mark.parametrize(("leaves", "most"), [(0.02, 1.0), (0.2, 0.5)])
def test_a_cause_that_leaves_much_is_less_sure(noisy, rig, leaves, most):
    data, found = verdict_case(noisy, rig, 0.3)
    # What is left has the size of a part of what was there, and no noise would make as much.
    column = 100.0 * found.best.fit.jacobian
    form = 300.0 * leaves * np.random.default_rng(8).standard_normal(len(column))
    data.base = Errors({"force": data.base.values["force"] + 297.0 * found.best.fit.jacobian[:, 0] + form})
    data.noisy_base = Errors({"force": data.base.values["force"] + np.random.default_rng(9).standard_normal(len(column))})
    value = -np.linalg.lstsq(column, data.base.values["force"], rcond=None)[0]
    after = Errors({"force": data.base.values["force"] + column @ value})
    best = judged(data, "mass_shift", Fit((), value, ("force",), after, column, 0.0, np.ones(1)), noisy, rig)
    nothing = Fit((), np.empty(0), (), data.base, np.empty((0, 0)), 0.0, np.empty(0))
    alone = found._replace(best=best, rests=(Judged(nothing, held_out(data, nothing)),), rivals=((),))
    (cause,) = verdict.causes(data, alone, 0)
    assert cause.probability == pytest.approx(most, abs=0.01)


def test_what_explains_less_is_a_rival(noisy, rig):
    data, found = verdict_case(noisy, rig, 0.3)
    (cause,) = verdict.causes(data, found, 0)
    assert cause.equivalent_to == ()
    assert cause.probability > 0.99
    assert cause.sigmas > 10.0
    (rival,) = cause.rivals
    assert rival.name == "viscous_shift"
    assert rival.behind > verdict.EQUAL
    assert 0.3 < rival.closed_fraction < 0.999


def test_the_gain_lies_in_its_interval_and_holds_what_is_known(noisy, rig):
    data, found = verdict_case(noisy, rig, 0.3)
    gain = verdict.gain(data, found.best, 0)
    assert gain.channel == "force"
    # 9 of the 10 parts of the power can be removed, and are.
    assert gain.closed_fraction == pytest.approx(1.0, abs=0.03)
    assert gain.ci95[0] <= gain.closed_fraction <= gain.ci95[1] + 1e-9
    assert gain.ci95[1] - gain.ci95[0] < 0.1
    assert gain.heldout_nrmse_before == pytest.approx(math.sqrt(10.0) / 100.0, rel=0.1)
    assert gain.heldout_nrmse_after == pytest.approx(gain.noise_floor, rel=0.15)
    assert verdict.gain(data, found.rests[0], 0) is None


def test_what_is_left_is_told_from_noise(noisy, rig):
    data, found = verdict_case(noisy, rig, 0.3)
    left = verdict.left(data, found.best, "force")
    assert left.exceeded
    assert not left.remains
    assert left.closed == pytest.approx(1.0, abs=0.05)
    still = verdict.left(data, found.rests[0], "force")
    assert still.exceeded
    assert still.remains
    assert still.closed == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(("times", "remains"), [(1, False), (2, True)])
def test_what_shows_once_is_an_incident(noisy, rig, times, remains):
    data, found = verdict_case(noisy, rig, 0.3)
    data.times = lambda channel: 2.5 * data.block[channel]
    spoilt = found.best.held.errors.values["force"] + np.where(np.isin(data.block["force"], [4, 9][:times]), 20.0, 0.0)
    best = found.best._replace(held=found.best.held._replace(errors=Errors({"force": spoilt})))
    left = verdict.left(data, best, "force")
    assert left.remains is remains
    assert left.mended is not remains
    assert left.incident == (None if remains else (10.0, 10.0))


def two_causes(noisy, rig, closes, values=(3.0, 3.0), first=40.0):
    """Return data, and a search's two causes, of which the second closes a part of the amplitude that the first leaves."""
    rng = np.random.default_rng(6)
    n = 2000
    noise, second = rng.standard_normal(n), 4.0 * rng.standard_normal(n)
    base = noise + second + first * rng.standard_normal(n)
    data = SimpleNamespace(
        base=Errors({"force": base}),
        noisy_base=Errors({"force": base + rng.standard_normal(n)}),
        channels=("force",),
        block={"force": np.repeat(np.arange(20), n // 20)},
        blocks=20,
    )
    found, _ = candidates(noisy, rig, [])
    hypothesis = tuple(next(c for c in found if c.name == name) for name in ("stribeck_shift", "pressure_sensor_lag"))

    def left(e):
        errors = Errors({"force": e})
        fit = SimpleNamespace(hypothesis=hypothesis, values=np.array(values), errors=errors, channels=("force",))
        return Judged(fit, SimpleNamespace(errors=errors))

    without_first, without_second = left(base - closes * second), left(noise + second)
    best = left(noise + (1.0 - closes) * second)
    return data, Searched(best, (without_first, without_second), ((), ()), (), (), {"force": 1.0})


@pytest.mark.parametrize(("closes", "believed"), [(1.0, True), (0.85, True), (0.6, False)])
def test_a_cause_has_to_close_most_of_what_the_others_leave(noisy, rig, closes, believed):
    data, found = two_causes(noisy, rig, closes)
    # Together they close more than 99 % either way.
    assert verdict.patched(data, found) == (frozenset() if believed else {"force"})


@pytest.mark.parametrize(("first", "closes", "form"), [(400.0, 0.6, True), (400.0, 1.0, False), (40.0, 0.6, False)])
def test_what_mends_the_form_of_another_is_no_cause(noisy, rig, first, closes, form):
    data, found = two_causes(noisy, rig, closes, first=first)
    # The first leaves the ten-thousandth part of what there was, or the hundredth.
    assert mends_form(data, found.best, found.rests[1]) is form


def test_a_difference_below_the_noise_is_not_shown(noisy, rig):
    data, found = two_causes(noisy, rig, 1.0)
    best = found.best.fit.errors.values["force"]
    for size, shown in ((0.9 * SHOWN, False), (1.1 * SHOWN, True)):
        fit = SimpleNamespace(errors=Errors({"force": best + size}))
        assert shows(data, Judged(fit, None), found.best) is shown
