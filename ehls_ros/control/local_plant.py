"""Laws on a cylinder of two chambers: in each cycle, a law is given the double rod that such a cylinder is at that moment.

A law has the equations of the paper, with one pressure and one flow. The double rod given to it has the same stiffness of the
oil at the present position, and the same rate of the force per opening at the present pressures, both from the volume balances
of both chambers. It lacks the constant force that unequal areas add: readings and reference are without it, and the weight has
it. So every law works on both cylinders, with the same tuning rule: its defaults are those for the double rod at position 0.
"""

import math
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

from ehls_ros.arrays import Array, in_python, kernel
from ehls_ros.control.controllers.base import MIN_DROP, ROW, Model
from ehls_ros.physics import sensors
from ehls_ros.physics.lane_memory import stack
from ehls_ros.physics.rig import SENSED, CylinderUse, Rig, ValveUse


class DoubleRod(NamedTuple):
    """The double rod that stands for a rig's cylinder.

    Attributes:
        rig: the rig with it.
        offset: constant force by which its driving force is smaller [N].
    """

    rig: Rig
    offset: float


def double_rod_of(rig: Rig) -> DoubleRod:
    """Return the double rod that stands for a rig's cylinder at position 0 and zero load pressure, with an open valve."""
    cylinder, valve = rig.cylinder, rig.valve
    if not cylinder.law.CHAMBERS:
        return DoubleRod(rig, 0.0)
    plain = SimpleNamespace(**{name: in_python(getattr(valve.law, name)) for name in ("gains", "drop_ratio")})
    # In the middle of the range of the double rod's load pressure.
    middle = np.zeros(len(SENSED))
    area_a, area_b = cylinder.parameters.area_a, cylinder.parameters.area_b
    supply, tank = rig.plant.supply_pressure, cylinder.parameters.tank_pressure
    middle[sensors.LOAD_PRESSURE] = 0.5 * (area_a - area_b) * (supply + tank) / rig.plant.piston_area
    middle[sensors.SUPPLY_PRESSURE] = supply
    equivalent = in_python(cylinder.law.equivalent(plain))
    plant, _, offset = equivalent(middle, 0.0, MIN_DROP, rig.plant, cylinder.parameters, valve.parameters)
    return DoubleRod(rig._replace(plant=plant, cylinder=CylinderUse(), valve=ValveUse()), offset)


NULL = 1e-12
"""Spool displacement that a law is given while the spool passes null [m]: only its sign counts."""

LAST = -1
"""Index of the last command in the memory of a law on such a cylinder, after the law's own."""


def memory_on(law: Any, cylinder: Any, parameters: Any) -> Array:
    """Return a law's memory before the first cycle, for a cylinder.

    Args:
        law: module of the controller.
        cylinder: module of the cylinder that the law is to know.
        parameters: those of the law.
    """
    own: Array = law.memory(parameters)
    return np.append(own, 0.0) if cylinder.CHAMBERS else own


def law_on(law: Any, cylinder: Any, valve: Any) -> Any:
    """Return a law's functions for a cylinder and its valve.

    Args:
        law: module of the controller.
        cylinder: module of the cylinder that the law is to know.
        valve: module of its valve.
    """
    own = {name: getattr(law, name) for name in ("follow",) if hasattr(law, name)}
    return SimpleNamespace(step=step_on(law, cylinder, valve), **own)


def step_on(law: Any, cylinder: Any, valve: Any) -> Callable[..., float]:
    """Return a law's compiled ``step`` for a cylinder and its valve; the arguments are those of :func:`law_on`."""
    step: Callable[..., float] = law.step
    if not cylinder.CHAMBERS:
        return step
    equivalent, signals, follows_force = cylinder.equivalent(valve), len(SENSED), law.FOLLOWS == "force"
    readings, row = stack(signals), stack(ROW)
    # A law with a filter foresees the spool itself.
    crosses = not hasattr(law, "assumptions")

    @kernel
    def local_step(m: Array, r: Array, f: Array, p: Any, model: Model, memory: Array, status: Array) -> float:
        seen, wanted = readings(), row()
        for i in range(signals):
            seen[i] = m[i]
        last = memory[memory.size + LAST]
        if crosses:
            # While the spool passes null, the gain of the edges that open next counts; it may be several times as large.
            lag = min(0.5 * model.period * model.plant.valve_bandwidth, 1.0)
            ahead = m[sensors.SPOOL] + lag * (model.plant.valve_gain * last - m[sensors.SPOOL])
            if ahead * m[sensors.SPOOL] < 0.0:
                seen[sensors.SPOOL] = math.copysign(NULL, ahead)
        plant, supply, offset = equivalent(m, seen[sensors.SPOOL], MIN_DROP, model.plant, model.cylinder, model.valve)
        local = Model(
            plant,
            model.friction,
            model.period,
            model.spool_limit,
            model.noise,
            model.command_delay,
            model.coupling_stiffness,
            model.coupling_damping,
            model.cylinder,
            model.valve,
        )
        for i in range(ROW):
            wanted[i] = r[i]
        seen[sensors.LOAD_PRESSURE] -= offset / plant.piston_area
        seen[sensors.FORCE] -= offset
        seen[sensors.SUPPLY_PRESSURE] = supply
        if follows_force:
            wanted[0] -= offset
        command = step(seen, wanted, f, p, local, memory[: memory.size + LAST], status)
        memory[memory.size + LAST] = command
        return command

    return local_step
