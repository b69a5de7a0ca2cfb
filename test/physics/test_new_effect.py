"""One new file is enough: an effect dropped into the folder is found, and each of its hooks acts where it says."""

import itertools
import sys
from dataclasses import replace

import numpy as np
import pytest
from reference_solver import Constants, solve
from rig_runs import PERIOD, run

from ehls_ros.physics import effects
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.effects.base import HOOKS
from ehls_ros.physics.plant import PL
from ehls_ros.physics.rig import SENSED
from ehls_ros.physics.simulator import Simulator

PROBE = '''"""Every hook at once, each with a parameter of its own; and the position, found again by integration."""

from typing import Annotated, NamedTuple

from ehls_ros.arrays import Array, kernel
from ehls_ros.physics.effects.base import Form
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.plant import PL, V
from ehls_ros.physics.rig import Rig
from ehls_ros.schema import quantity

GROUP = "mechanics"
EQUATION = "see the hooks"
SOURCE = "a test"
STATES = 1
REACH = 0.0


class Parameters(NamedTuple):
    """One a hook."""

    received: Annotated[float, quantity("1", "part that arrives", minimum=0.0, maximum=2.0)] = 1.0
    command: Annotated[float, quantity("1", "gain of the command", minimum=0.0, maximum=2.0)] = 1.0
    opening: Annotated[float, quantity("1", "gain of the opening", minimum=0.0, maximum=2.0)] = 1.0
    supply_pressure: Annotated[float, quantity("1", "part of the supply", minimum=0.0, maximum=2.0)] = 1.0
    bulk_modulus: Annotated[float, quantity("1", "part of the stiffness", minimum=0.0, maximum=2.0)] = 1.0
    leakage: Annotated[float, quantity("m^5/(N s)", "more leakage", minimum=0.0, maximum=1e-10)] = 0.0
    friction_level: Annotated[float, quantity("1", "part of the friction", minimum=0.0, maximum=2.0)] = 1.0
    force: Annotated[float, quantity("N/m", "a spring", minimum=0.0, maximum=1e6)] = 0.0
    piston_position: Annotated[float, quantity("1", "travel of the piston for one of the mass", minimum=0.0, maximum=2.0)] = 1.0
    piston_velocity: Annotated[float, quantity("1", "the same of its velocity", minimum=0.0, maximum=2.0)] = 1.0


@kernel
def received(value: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant) -> float:
    return value * p.received


@kernel
def jump(t: float, w: Array, p: Parameters) -> float:
    return t + 0.31e-3


@kernel
def command(value: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant) -> float:
    return value * p.command


@kernel
def opening(value: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant) -> float:
    return value * p.opening


@kernel
def supply_pressure(value: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant) -> float:
    return value * p.supply_pressure


@kernel
def bulk_modulus(value: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant) -> float:
    return value * p.bulk_modulus


@kernel
def leakage(value: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant) -> float:
    return value + p.leakage * y[PL]


@kernel
def friction_level(value: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant) -> float:
    return value * p.friction_level


@kernel
def force(value: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant) -> float:
    return value - p.force * z[0]


@kernel
def piston_position(value: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant) -> float:
    return value * p.piston_position


@kernel
def piston_velocity(value: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant) -> float:
    return value * p.piston_velocity


@kernel
def derivatives(u: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant, dz: Array) -> None:
    dz[0] = y[V]


def forms(rig: Rig) -> tuple[Form, ...]:
    return (Form({"force": ()}),)
'''

PAPER = Constants()
SWEPT = 0.8
# Each hook's parameter, and the constants of the paper that do the same.
SAME = {
    "received": (0.6, replace(PAPER, Kv=0.6)),
    "command": (0.7, replace(PAPER, Kv=0.7)),
    "opening": (1.3, replace(PAPER, w=1.3 * PAPER.w)),
    "supply_pressure": (0.8, replace(PAPER, ps=0.8 * PAPER.ps)),
    "bulk_modulus": (0.5, replace(PAPER, beta_e=0.5 * PAPER.beta_e)),
    "leakage": (3e-11, replace(PAPER, Ctc=PAPER.Ctc + 3e-11)),
    "friction_level": (1.6, replace(PAPER, Fc=1.6 * PAPER.Fc, Fs=1.6 * PAPER.Fs)),
    "force": (6e4, replace(PAPER, ks=PAPER.ks + 6e4)),
    # What the piston sweeps is 0.8 of what the area gives; so does an area of 0.8, with every pressure 1/0.8 of what it was.
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
"""What the pressures of those constants have to be multiplied with."""

ADDED = ("leakage", "force")
_numbers = itertools.count()


@pytest.fixture(scope="module")
def probe(tmp_path_factory):
    """A new effect's name; its file lies in a folder of its own that the family's package looks into."""
    folder = tmp_path_factory.mktemp("effects")
    name = f"probe_{next(_numbers)}"
    (folder / f"{name}.py").write_text(PROBE, encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(effects, "__path__", [*effects.__path__, str(folder)])
        yield name
    sys.modules.pop(f"ehls_ros.physics.effects.{name}", None)


def test_every_hook_is_tried():
    assert {*SAME, "piston_position"} == set(HOOKS)


def test_the_sensor_sees_where_the_piston_is(probe, make_rig):
    simulator = Simulator(make_rig(effects=[{"name": probe, "piston_position": 0.5}]), PERIOD, 5e-5, position=0.02)
    assert simulator.measure(np.zeros(len(SENSED)))[SENSED.index("position")] == pytest.approx(0.01)
    assert simulator.y[0] == 0.02


def test_the_file_is_found(probe):
    assert probe in EFFECTS.names()


@pytest.mark.parametrize("hook", SAME)
def test_a_hook_acts_where_it_says(hook, probe, make_rig):
    value, constants = SAME[hook]
    t = np.arange(150) * PERIOD
    inputs = np.column_stack([3e-4 * np.sin(25.0 * t), 2e3 * np.sin(30.0 * t), 6e4 * np.cos(30.0 * t)])
    # Half of it twice: effects act one after the other, each on states of its own.
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
