"""One new file is enough: an effect of another distribution is found, and each of its hooks acts as documented."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from reference_solver import Constants, solve
from rig_runs import PERIOD, run
from third_party import install

from ehls_ros.families import offered
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.effects.base import HOOKS
from ehls_ros.physics.plant import PL
from ehls_ros.physics.rig import SENSED
from ehls_ros.physics.simulator import Simulator

PROBE = Path(__file__).with_name("probe_effect.py")

PAPER = Constants()
SWEPT = 0.8
# Each hook's parameter, and the equivalent constants of the paper.
SAME = {
    "received": (0.6, replace(PAPER, Kv=0.6)),
    "command": (0.7, replace(PAPER, Kv=0.7)),
    "opening": (1.3, replace(PAPER, w=1.3 * PAPER.w)),
    "supply_pressure": (0.8, replace(PAPER, ps=0.8 * PAPER.ps)),
    "bulk_modulus": (0.5, replace(PAPER, beta_e=0.5 * PAPER.beta_e)),
    "leakage": (3e-11, replace(PAPER, Ctc=PAPER.Ctc + 3e-11)),
    "friction_level": (1.6, replace(PAPER, Fc=1.6 * PAPER.Fc, Fs=1.6 * PAPER.Fs)),
    "force": (6e4, replace(PAPER, ks=PAPER.ks + 6e4)),
    # The swept flow is 0.8 of the area's; so it is with an area of 0.8, with every pressure 1/0.8 of its value.
    "piston_velocity": (
        0.8,
        replace(
            PAPER,
            Ac=SWEPT * PAPER.Ac,
            ps=PAPER.ps / SWEPT,
            beta_e=PAPER.beta_e / SWEPT,
            Ctc=SWEPT * PAPER.Ctc,
            w=SWEPT**0.5 * PAPER.w,
        ),
    ),
}
PRESSURES = {"piston_velocity": SWEPT}
"""Factor for the pressures of those constants."""

ADDED = ("leakage", "force")

READINGS = {"position_reading": "position", "pressure_reading": "load_pressure", "force_reading": "force"}
"""Sensor of each hook that adds to a reading."""


@pytest.fixture(scope="module")
def probe(tmp_path_factory):
    """Return the name of a new effect, whose file is another distribution's."""
    site = tmp_path_factory.mktemp("site")
    install(site, {"acme_ehls.probe": PROBE.read_text(encoding="utf-8")}, {EFFECTS.group: {"probe": "acme_ehls.probe"}})
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(site)
        offered.cache_clear()
        yield "probe"
    offered.cache_clear()
    EFFECTS._loaded.pop("probe", None)
    for name in ("acme_ehls.probe", "acme_ehls"):
        sys.modules.pop(name, None)


def test_every_hook_is_tried():
    assert {*SAME, "piston_position", *READINGS} == set(HOOKS)


def test_the_sensor_sees_where_the_piston_is(probe, make_rig):
    simulator = Simulator(make_rig(effects=[{"name": probe, "piston_position": 0.5}]), PERIOD, 5e-5, position=0.02)
    assert simulator.measure(np.zeros(len(SENSED)))[SENSED.index("position")] == pytest.approx(0.01)
    assert simulator.y[0] == 0.02


@pytest.mark.parametrize("hook", READINGS)
def test_an_error_of_a_reading_is_in_the_measurement_and_not_in_the_state(hook, probe, make_rig):
    simulator = Simulator(make_rig(effects=[{"name": probe, hook: 0.25}]), PERIOD, 5e-5, position=0.02)
    state, clean = simulator.y.copy(), Simulator(make_rig(), PERIOD, 5e-5, position=0.02)
    noise = np.zeros(len(SENSED))
    seen = simulator.measure(noise) - clean.measure(noise)
    assert seen == pytest.approx(np.eye(len(SENSED))[SENSED.index(READINGS[hook])] * 0.25)
    np.testing.assert_array_equal(simulator.y, state)


def test_the_file_is_found(probe):
    assert probe in EFFECTS.names()


@pytest.mark.parametrize("hook", SAME)
def test_a_hook_acts_where_it_says(hook, probe, make_rig):
    value, constants = SAME[hook]
    t = np.arange(150) * PERIOD
    inputs = np.column_stack([3e-4 * np.sin(25.0 * t), 2e3 * np.sin(30.0 * t), 6e4 * np.cos(30.0 * t)])
    # Half of it twice: effects act one after the other, each on separate states.
    part = value / 2.0 if hook in ADDED else value**0.5
    rig = make_rig(effects=[{"name": probe, hook: part}, {"name": probe, hook: part}])
    states = run(Simulator(rig, PERIOD, 5e-5), inputs)
    expected = solve(constants, "gms", inputs, PERIOD).y
    expected[:, PL] *= PRESSURES.get(hook, 1.0)
    unchanged = solve(PAPER, "gms", inputs, PERIOD).y
    scale = np.abs(expected).max(axis=0)
    assert np.max(np.abs(states[:, :7] - expected) / scale) < 1e-6
    assert np.max(np.abs(expected - unchanged) / scale) > 1e-2
    np.testing.assert_allclose(states[:, 7], states[:, 0], rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(states[:, 7], states[:, 8])
