"""Scope of slow recordings: motions that are small within a sample can be judged, at any rate."""

import math

import numpy as np
import pytest

from ehls_ros.diagnosis import rules, stages
from ehls_ros.diagnosis.diagnose import diagnose
from ehls_ros.diagnosis.record import prepare
from ehls_ros.diagnosis.resolution import coarseness, command_seen, friction_known, presliding_travel
from ehls_ros.diagnosis.stages import formed_of
from ehls_ros.errors import BadInput
from ehls_ros.physics.rig import rig_from_mapping
from ehls_ros.trajectory import Own, Preparation, Trajectory

SLOW = 0.01


def strokes(period, speed, turn, duration=25.0, travel=0.03):
    """Return times and positions of even strokes to and fro whose turns take a given time [s]."""
    fine = np.arange(0.0, duration, 1e-4)
    stroke = travel / speed
    velocity = speed * np.clip(4.0 * stroke / turn * (np.abs((fine / stroke / 2.0) % 1.0 - 0.5) - 0.25), -1.0, 1.0)
    position = np.cumsum(velocity) * 1e-4
    every = round(period / 1e-4)
    return fine[::every], position[::every]


def slow_loop(rig, *, period=SLOW, speed=0.01, turn=0.2, excess=0.0, seed=0):
    """Return a recording of slow strokes of a rig with its Coulomb friction plus an excess [N]."""
    rng = np.random.default_rng(seed)
    t, x = strokes(period, speed, turn)
    v = np.gradient(x, period)
    plant = rig.plant
    # A contact without memory is enough where presliding is passed within a few samples.
    rub = rig.friction_level(math.inf) + excess + rig.friction.viscous_coefficient * np.abs(v)
    force = plant.spring_stiffness * x + plant.viscous_damping * v + rub * np.tanh(v / 1e-3)
    force += plant.moving_mass * (plant.gravity + np.gradient(v, period))
    signals = {
        "position_m": x + 1e-6 * rng.standard_normal(len(t)),
        "load_pressure_pa": force / plant.piston_area + 200.0 * rng.standard_normal(len(t)),
    }
    return Trajectory(t, signals)


@pytest.fixture(scope="module")
def smooth_rig(rig_file):
    """The rig with stiff friction that is constant below the strokes' speed, as such strokes show it."""
    friction = {
        "model": "gms", "coulomb_force": 600.0, "static_force": 600.0, "stribeck_velocity": 2e-3, "stribeck_exponent": 1.0,
        "viscous_coefficient": 2000.0, "element_stiffness": [2e6, 2e6, 2e6], "element_weight": [0.4, 0.3, 0.3],
        "attraction_rate": 1e5,
    }  # fmt: skip
    return rig_from_mapping({**rig_file, "friction": friction}, "smooth")


@pytest.mark.long
def test_a_slow_friction_loop_at_100_hz_is_judged_and_its_error_found(smooth_rig):
    right = diagnose(slow_loop(smooth_rig), smooth_rig, "right", threads=1)
    assert right.stages["force_balance"].judged
    wrong = diagnose(slow_loop(smooth_rig, excess=150.0), smooth_rig, "wrong", threads=1)
    assert wrong.stages["force_balance"].judged
    assert wrong.stages["force_balance"].exceeds
    before, after = (d.stages["force_balance"].nrmse_before for d in (wrong, right))
    assert before > 3.0 * after
    assert wrong.causes
    assert {wrong.causes[0].name, *wrong.causes[0].equivalent_to} & {"coulomb_shift"}
    assert wrong.causes[0].parameters["offset"].value == pytest.approx(150.0, rel=0.1)


def known(period, speed, turn, travel=2e-4, noise=0.0):
    t, x = strokes(period, speed, turn)
    v = np.gradient(x, period)
    n = len(t)
    record = prepare_plain(t, x)
    return friction_known(record, x, v, travel, noise), x, v, n


def prepare_plain(t, x):
    from ehls_ros.diagnosis.record import Record

    return Record("it", float(t[1] - t[0]), t, {"position_m": x}, {}, {"position_m": 0.0}, np.zeros(len(t), bool), t[-1], ())


def test_a_slow_turn_is_resolved_and_a_fast_one_is_not():
    slow, *_ = known(SLOW, speed=0.01, turn=2.0)
    assert slow.all()
    fast, x, v, n = known(SLOW, speed=0.3, turn=0.02)
    assert 0.2 < np.mean(fast) < 1.0
    # Around each turn, until the presliding travel has been covered several times.
    for turn in np.flatnonzero(v[1:] * v[:-1] < 0.0):
        assert not fast[turn : turn + 2].any()
        later = np.flatnonzero(np.abs(x[turn:] - x[turn]) > (rules.SLIDING + 20) * 2e-4)
        if later.size and turn + later[0] < n:
            assert fast[turn + later[0]]


def test_noise_at_rest_is_no_turn():
    rng = np.random.default_rng(0)
    t = SLOW * np.arange(2000)
    v = 1e-3 * rng.standard_normal(len(t))
    record = prepare_plain(t, np.zeros(len(t)))
    assert friction_known(record, np.zeros(len(t)), v, 1e-6, 1e-3).all()
    assert not friction_known(record, np.zeros(len(t)), v, 1e-6, 0.0).all()


def test_turns_that_are_never_resolved_leave_the_force_balance_unjudged(smooth_rig):
    t = SLOW * np.arange(4000)
    x = 0.5 * presliding_travel(smooth_rig) * np.sin(2.0 * np.pi * 21.0 * t)
    found = stages.setup(
        prepare(Trajectory(t, {"position_m": x, "load_pressure_pa": 1e6 * np.sin(t)}), smooth_rig, "it"), smooth_rig
    )
    assert "force" not in found.channels
    assert found.why_not["force_balance"].startswith("needs slower motion or faster samples: at 100 Hz")


@pytest.mark.parametrize(("frequency", "seen"), [(0.5, True), (2.0, True), (20.0, False)])
def test_a_command_slow_in_itself_is_seen_at_a_low_rate(rig, frequency, seen):
    t = SLOW * np.arange(4000)
    u = 1e-4 * np.sin(2.0 * np.pi * frequency * t)
    record = prepare(Trajectory(t, {"valve_command_m": u, "spool_m": u}), rig, "it")
    assert command_seen(record, rig) is seen
    assert ("valve" in stages.setup(record, rig).why_not) is not seen


def test_straight_lines_are_worse_only_where_signals_bend(rig):
    t = SLOW * np.arange(4000)
    for frequency, expected in ((0.1, 1.0), (1.0, 7.0), (5.0, 173.0)):
        signals = {"position_m": 0.02 * np.sin(2.0 * np.pi * frequency * t)}
        # At its peaks (2 pi f T)² / 8 of the amplitude, relative to the rms, in units of 10⁻⁴.
        assert np.max(coarseness(prepare(Trajectory(t, signals), rig, "it"), signals)) == pytest.approx(expected, rel=0.05)
    assert np.all(coarseness(prepare(Trajectory(0.1 * t, signals), rig, "it"), signals) == 1.0)


def test_a_kink_is_uncertain_where_it_is(rig):
    t = SLOW * np.arange(1000)
    noise = 100.0 * np.random.default_rng(0).standard_normal(len(t))
    signals = {"load_pressure_pa": 1e6 * np.abs((0.5 * t) % 2.0 - 1.0) + noise}
    worse = coarseness(prepare(Trajectory(t, signals), rig, "it"), signals)
    kinks = np.abs(t % 2.0 - 1.0) > 0.985
    assert np.all(worse[5:-5][kinks[5:-5]] > 10.0)
    assert np.mean(worse == 1.0) > 0.95


def test_a_slow_signal_makes_only_the_balances_that_it_is_part_of_coarser(rig):
    t = 1e-3 * np.arange(8000)
    names = ("spool_m", "load_pressure_pa", "position_m", "force_n")
    sizes = dict(zip(names, (1e-4, 1e6, 0.02, 2e3), strict=True))
    slow = {"position_m": 0.5, "force_n": 5.0}
    signals = {name: sizes[name] * np.sin(2.0 * np.pi * slow.get(name, 5.0) * t) for name in names}
    own = {name: Own(SLOW, 0.0) for name in slow}
    record = prepare(Trajectory(t, signals, preparation=Preparation(interpolated=own)), rig, "it")
    bent = {c: np.max(coarseness(record, formed_of(record, c))) for c in ("spool", "volume", "force", "cell")}
    assert bent["spool"] == 1.0
    # The load cell does not enter a balance that has a pressure.
    assert bent["volume"] == bent["force"] == pytest.approx(1.74, rel=0.05)
    assert bent["cell"] == pytest.approx(173.0, rel=0.05)


def test_an_interpolated_signal_keeps_the_power_of_its_noise_and_its_own_windows(rig):
    rng = np.random.default_rng(0)
    t = 1e-3 * np.arange(8000)
    signals = {"position_m": 0.02 * np.sin(t), "load_pressure_pa": 1e6 * np.cos(t) + 1e3 * rng.standard_normal(len(t))}
    slow = Preparation(interpolated={"position_m": Own(0.01, 2e-6)})
    record = prepare(Trajectory(t, signals, preparation=slow), rig, "it")
    assert record.noise["position_m"] == pytest.approx(2e-6 * math.sqrt(10.0))
    assert record.sampled("position_m", "load_pressure_pa") == 0.01
    assert record.sampled("load_pressure_pa") == pytest.approx(1e-3)
    used = stages.setup(record, rig)
    assert used.window.weights.size == rules.MIN_WINDOW * 10 + 1
    assert used.fit == 41


def test_chambers_of_another_area_than_the_rigs_are_refused(rig):
    t = 1e-3 * np.arange(500)
    for area, fits in ((rig.plant.piston_area, True), (1.01 * rig.plant.piston_area, False)):
        signals = Trajectory(t, {"load_pressure_pa": 1e6 * np.sin(t)}, preparation=Preparation(equivalent_area=area))
        if fits:
            prepare(signals, rig, "it")
        else:
            with pytest.raises(BadInput, match=r"its chambers have a mean area of .*; expected piston_area: "):
                prepare(signals, rig, "it")


def test_what_the_reading_cannot_judge_is_not_judged_with_its_reason(rig, recorded):
    r = recorded({}, "rich", seed=3, duration=4.0)
    given = Trajectory(r.time, r.columns, preparation=Preparation(("as read",), not_judged={"flow": "for a reason"}))
    record = prepare(given, rig, "it")
    found = stages.setup(record, rig)
    assert not {"volume", "supply"} & set(found.channels)
    assert {"force", "spool"} <= set(found.channels)
    assert found.why_not == {"flow": "for a reason"}
    assert "as read" in record.remarks
