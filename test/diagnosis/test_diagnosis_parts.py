"""The model along a recording: its kernels against the simulator, and the residuals of its stages."""

import numpy as np
import pytest
import scipy
from tiers import tiered

from ehls_ros.diagnosis import stages
from ehls_ros.diagnosis.record import prepare
from ehls_ros.diagnosis.stages import CHANNELS, Comparison
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.parameters import Sensor
from ehls_ros.physics.plant import FRICTION, PL, XV, V
from ehls_ros.physics.rig import EffectUse, rig_from_mapping, rig_to_mapping
from ehls_ros.physics.sensors import LOAD_PRESSURE, POSITION, VELOCITY
from ehls_ros.physics.simulator import Simulator
from ehls_ros.trajectory import Trajectory

PERIOD = 1e-3


def use(name, **values):
    return EffectUse(name, EFFECTS.load(name).Parameters(**values))


# ------------------------------------------------------------------------------------------------------------- kernels


def perfect(rig):
    return rig._replace(sensors=dict.fromkeys(rig.sensors, Sensor()))


def simulated(rig, seconds=6.0, added=0.0):
    """Run the product's simulator open loop, with an added command [m], and return trajectory and friction force [N]."""
    simulator = Simulator(rig, PERIOD)
    cycles = round(seconds / PERIOD)
    rows, friction = np.empty((cycles, 6)), np.empty(cycles)
    elements = len(simulator.mode) - 1
    t = PERIOD * np.arange(cycles)
    command = 6e-5 * np.sin(2 * np.pi * 0.7 * t) + 3e-5 * np.sin(2 * np.pi * 2.3 * t) + added
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
    return Comparison(r, stages.setup(r, rig)), r


@pytest.mark.parametrize("model", tiered(["gms", "lugre"], "gms"))
def test_friction_along_a_motion_is_the_simulators(rig, model):
    mapping = rig_to_mapping(perfect(rig))
    ours = rig_from_mapping({**mapping, "friction": {**mapping["friction"], "model": model}}, "rig")
    trajectory, friction = simulated(ours)
    comparison, _ = compared(trajectory, ours)
    found = comparison.friction(ours.effective())[:, 0]
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
    # Only the integrator's error remains; (4) is followed exactly here.
    assert np.max(np.abs(comparison.simulated_spool(ours.effective()) - trajectory["spool_m"])) < 1e-9


@pytest.mark.parametrize("name", tiered(["valve_second_order", "valve_hysteresis"], "valve_hysteresis"))
def test_spools_with_a_memory_are_the_simulators(rig, name):
    values = {"valve_second_order": {"natural_frequency": 90.0}, "valve_hysteresis": {"width": 2e-5}}[name]
    ours = perfect(rig).with_effects((use(name, **values),))
    trajectory, _ = simulated(ours, 2.0)
    comparison, _ = compared(trajectory, ours)
    found = comparison.simulated_spool(ours.effective())
    moved = np.max(np.abs(found - comparison.simulated_spool(perfect(rig).effective())))
    assert moved > 1e-6
    assert np.max(np.abs(found - trajectory["spool_m"])) < 0.05 * moved


@pytest.mark.parametrize("effects", [(), (use("command_delay", delay=0.001),)], ids=["plain", "late"])
def test_the_volume_balance_knows_the_spool_between_samples(rig, effects):
    bandwidth = 700.0
    ours = perfect(rig).with_plant(valve_bandwidth=bandwidth).with_effects(effects)
    steps = np.repeat(np.random.default_rng(3).choice([-3e-5, 3e-5], 667), 6)[:4000]
    comparison, r = compared(simulated(ours, 4.0, steps)[0], ours)
    blind = Comparison(r, comparison.setup._replace(valve=None))
    left, lagging = (c.residuals(ours, ("volume",))["volume"][40:-40] for c in (comparison, blind))
    # Euler and Maclaurin: where the slope jumps at samples, their mean lags by bandwidth * period^2 / 12.
    flow, spool = comparison.flow_terms(ours.effective())[:, 0], r.signals["spool_m"]
    turned = flow @ spool / (spool @ spool) * comparison.setup.window.rate(r.signals["valve_command_m"])[40:-40]
    assert turned @ lagging / (turned @ turned) == pytest.approx(bandwidth * PERIOD**2 / 12.0, rel=0.05)
    assert np.std(left) < 0.05 * np.std(lagging)


# -------------------------------------------------------------------------------------------------------------- stages


@pytest.mark.parametrize(("noise", "smooth", "fit"), [(2e-7, True, 13), (2e-7, False, 7), (2e-6, False, 13)])
def test_the_local_fit_is_as_short_as_noise_allows(rig, noise, smooth, fit):
    t = PERIOD * np.arange(6000)
    # A smooth motion, or one whose velocity has kinks as where a piston sticks and slips.
    moved = np.sin(2.0 * np.pi * 0.5 * t) if smooth else np.cumsum(np.abs((50.0 * t) % 2.0 - 1.0) - 0.5) * PERIOD
    position = 0.02 * moved + noise * np.random.default_rng(0).standard_normal(len(t))
    r = prepare(Trajectory(t, {"position_m": position, "load_pressure_pa": 1e6 * np.cos(3.0 * t)}), perfect(rig), "it")
    assert stages.setup(r, rig).fit == fit


@pytest.fixture(scope="module")
def quiet(rig):
    ours = perfect(rig)
    trajectory, _ = simulated(ours)
    return ours, *compared(trajectory, ours)


def test_the_models_own_experiment_leaves_no_residual(quiet, rig):
    ours, comparison, _ = quiet
    assert set(comparison.setup.channels) == set(CHANNELS) - {"volume_a", "volume_b"}
    left = comparison.residuals(ours)
    # rms against the noise that the rig's sensors would make of it, and against the terms that cancel
    most = {"spool": 1e-9, "volume": 5e-8, "supply": 1e-6, "force": 2.0, "cell": 1e-6, "velocity": 5e-6}
    for channel, values in left.items():
        rms = float(np.sqrt(np.mean(values[20:-20] ** 2)))
        assert rms < most[channel], (channel, rms)
    # and a wrong model leaves a remainder
    wrong = comparison.residuals(ours.with_effects((use("mass_shift", factor=1.3), use("bulk_modulus_shift", factor=0.5))))
    for channel in ("force", "volume"):
        assert np.std(wrong[channel][20:-20]) > 5.0 * np.std(left[channel][20:-20]), channel
    for channel in ("spool", "supply", "cell", "velocity"):
        np.testing.assert_array_equal(wrong[channel], left[channel])


def test_an_offset_of_the_velocity_sensor_shows_there_and_leaves_friction_alone(quiet):
    ours, comparison, r = quiet
    off = r._replace(signals={**r.signals, "velocity_m_s": r.signals["velocity_m_s"] + 3e-3})
    left, plain = (Comparison(record, comparison.setup).residuals(ours) for record in (off, r))
    assert np.mean(left["velocity"] - plain["velocity"]) == pytest.approx(3e-3, rel=1e-3)
    for channel in ("force", "volume"):
        assert np.std(left[channel][20:-20]) < 1.1 * np.std(plain[channel][20:-20]), channel


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
                # Independent of earlier queries, or of another thread.
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
    used = stages.setup(some, ours)
    assert set(used.channels) == channels
    left = Comparison(some, used).residuals(ours)
    assert all(np.all(np.isfinite(values)) for values in left.values())


def test_an_error_of_a_reading_is_subtracted_from_it(rig):
    ours = perfect(rig)
    trajectory, _ = simulated(ours, seconds=2.0)
    bent = use(
        "empirical_pressure_reading",
        per_pressure=1e-6,
        power=4e4,
        exponent=2.0,
        even=1.0,
        knots=0.0,
        lowest=-10.0,
        highest=10.0,
    )
    shifted = use("empirical_position_reading", per_pressure=1e-6, power=1e-4, knots=0.0, lowest=-10.0, highest=10.0)
    pressure = trajectory["load_pressure_pa"]
    read = {
        "load_pressure_pa": pressure + 4e4 * (1e-6 * pressure) ** 2,
        "position_m": trajectory["position_m"] + 1e-4 * 1e-6 * pressure,
    }
    comparison, _ = compared(Trajectory(trajectory.time_s, {**trajectory.signals, **read}), ours)
    wrong = ours.with_effects((bent, shifted)).effective()
    for sensor, signal in (("load_pressure", "load_pressure_pa"), ("position", "position_m"), ("force", "force_n")):
        size = np.ptp(trajectory[signal])
        assert comparison.corrected(wrong, sensor) == pytest.approx(trajectory[signal], abs=1e-5 * size), sensor
    # The simulator's sensors have the same errors.
    simulator = Simulator(ours.with_effects((bent, shifted)), PERIOD, position=0.02)
    simulator.y[PL] = 2e6
    seen = simulator.measure(np.zeros(7))
    assert seen[POSITION] == pytest.approx(0.02 + 2e-4)
    assert seen[LOAD_PRESSURE] == pytest.approx(2e6 + 1.6e5)


def test_a_lag_that_is_corrected_for_leaves_no_more_noise_in_the_cells_residual_than_there_was(rig):
    """The load pressure reads behind 5 ms: five times as long as a sample, the correction multiplies its noise as much."""
    lag = 5e-3
    ours = perfect(rig)
    trajectory, _ = simulated(ours)
    rng = np.random.default_rng(8)
    true = trajectory.signals["load_pressure_pa"]
    read = true[0] + scipy.signal.lsim(([1.0], [lag, 1.0]), true - true[0], trajectory.time_s)[1]
    noise = 2e3 * rng.standard_normal(len(true))
    slow = ours.with_sensors(["load_pressure"], lambda sensor: sensor._replace(bandwidth=1.0 / lag))
    before, after = (
        compared(Trajectory(trajectory.time_s, trajectory.signals | {"load_pressure_pa": values + noise}), known)[0].residuals(
            known, ("cell",)
        )["cell"][40:-40]
        for values, known in ((true, ours), (read, slow))
    )
    assert np.std(after) < 1.1 * np.std(before)
