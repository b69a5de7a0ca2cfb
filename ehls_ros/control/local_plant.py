"""Laws on a cylinder of two chambers: in each cycle, a law is given the double rod that such a cylinder is at that moment.

A law has the equations of the paper, with one pressure and one flow. The double rod given to it has the same stiffness of the
oil at the present position, and the same rate of the force per opening at the present pressures, both from the volume balances
of both chambers. It lacks the constant force that unequal areas add: readings and reference are without it, and the weight has
it. So every law works on both cylinders, with the same tuning rule: its numbers are those for the double rod at position 0. A
disturbance changes the force in proportion to the stiffness of the oil, so a law is told how stiff it is beside that position.
"""

import math
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

from ehls_ros.arrays import Array, in_python, kernel
from ehls_ros.control.controllers.base import MIN_DROP, ROW, Model, saturate
from ehls_ros.control.rig_scale import largest_speed
from ehls_ros.physics import sensors
from ehls_ros.physics.cylinder.base import Equivalent
from ehls_ros.physics.lane_memory import stack
from ehls_ros.physics.parameters import Plant
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
    alike = equivalent(middle, 0.0, MIN_DROP, rig.plant, cylinder.parameters, valve.parameters)
    return DoubleRod(rig._replace(plant=alike.plant, cylinder=CylinderUse(), valve=ValveUse()), alike.offset)


def speed_of(rig: Rig) -> float:
    """Return the loader's largest velocity, by its valve or by its limit [m/s]."""
    plant = double_rod_of(rig).rig.plant
    return min(in_python(largest_speed)(plant, rig.limits.spool * plant.valve_gain), rig.limits.velocity)


@kernel
def with_discharge(plant: Plant, coefficient: float) -> Plant:
    """Return a plant with another discharge coefficient."""
    return Plant(
        plant.supply_pressure,
        plant.oil_density,
        plant.bulk_modulus,
        coefficient,
        plant.valve_area_gradient,
        plant.leakage_coefficient,
        plant.total_volume,
        plant.moving_mass,
        plant.piston_area,
        plant.arm_length,
        plant.spring_stiffness,
        plant.viscous_damping,
        plant.valve_bandwidth,
        plant.valve_gain,
        plant.gravity,
    )


def memory_on(law: Any, cylinder: Any, parameters: Any) -> Array:
    """Return a law's memory before the first cycle, for a cylinder.

    Args:
        law: module of the controller.
        cylinder: module of the cylinder that the law is to know.
        parameters: those of the law.
    """
    own: Array = law.memory(parameters)
    return np.concatenate([own, own]) if cylinder.CHAMBERS else own


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
    inverts = getattr(law, "INVERTS_VALVE", False)

    @kernel
    def gain(plant: Plant, supply: float, pressure: float, side: float) -> float:
        """Return the flow per opening (1) [m^2/s] at a load pressure [Pa], for an opening of a sign."""
        drop = max(supply - side * pressure, MIN_DROP * plant.supply_pressure)
        return plant.discharge_coefficient * plant.valve_area_gradient * math.sqrt(drop / plant.oil_density)

    @kernel
    def answer(
        spool: float,
        plant: Plant,
        rod: Equivalent,
        gain_positive: float,
        gain_negative: float,
        m: Array,
        r: Array,
        f: Array,
        p: Any,
        model: Model,
        own: Array,
        status: Array,
    ) -> float:
        """Return the command of the law for a double rod with these coefficients, and a spool displacement [m].

        Both gains are those of :class:`~ehls_ros.control.controllers.base.Model`.
        """
        seen, wanted = readings(), row()
        for i in range(signals):
            seen[i] = m[i]
        for i in range(ROW):
            wanted[i] = r[i]
        seen[sensors.SPOOL] = spool
        seen[sensors.LOAD_PRESSURE] -= rod.offset / plant.piston_area
        seen[sensors.FORCE] -= rod.offset
        seen[sensors.SUPPLY_PRESSURE] = rod.supply_pressure
        if follows_force:
            wanted[0] -= rod.offset
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
            rod.stiffness,
            gain_positive,
            gain_negative,
        )
        return step(seen, wanted, f, p, local, own, status)

    @kernel
    def local_step(m: Array, r: Array, f: Array, p: Any, model: Model, memory: Array, status: Array) -> float:
        size, spool = memory.size // 2, m[sensors.SPOOL]
        own, before = memory[:size], memory[size:]
        for i in range(size):
            before[i] = own[i]
        side = -1.0 if spool < 0.0 else 1.0
        near = equivalent(m, side, MIN_DROP, model.plant, model.cylinder, model.valve)
        beyond = equivalent(m, -side, MIN_DROP, model.plant, model.cylinder, model.valve)
        other = beyond.plant.discharge_coefficient / near.plant.discharge_coefficient
        positive, negative = (1.0, other) if side > 0.0 else (other, 1.0)
        command = answer(spool, near.plant, near, positive, negative, m, r, f, p, model, own, status)
        valve_gain, followed = model.plant.valve_gain, -math.expm1(-model.period * model.plant.valve_bandwidth)
        if inverts and (spool + followed * (valve_gain * command - spool)) * side < 0.0:
            # The spool passes null, beyond which an opening has another gain. The law is given the opening on the other side
            # with the present flow.
            pressure = m[sensors.LOAD_PRESSURE] - near.offset / near.plant.piston_area
            opened = gain(beyond.plant, beyond.supply_pressure, pressure, -side)
            moved = spool * gain(near.plant, near.supply_pressure, pressure, side) / opened
            # By the sign of the opening, the law would take the pressure drop of this side.
            seen_as = opened / gain(beyond.plant, beyond.supply_pressure, pressure, side)
            for i in range(size):
                own[i] = before[i]
            scaled = with_discharge(beyond.plant, seen_as * beyond.plant.discharge_coefficient)
            command = answer(moved, scaled, beyond, 1.0, 1.0, m, r, f, p, model, own, status)
            end = side * min(side * (moved + followed * (valve_gain * command - moved)), 0.0)
            # The mean flow of the cycle is to be that of the openings moved and end. A spool that moves steadily to x has it if
            # x^2 - (moved + end) x + spool end = 0; at end, it would have been on this side of null for too long or too short.
            mean = 0.5 * (moved + end)
            reached = mean - side * math.sqrt(mean * mean - spool * end)
            command = saturate((spool + (reached - spool) / followed) / valve_gain, model.spool_limit)
        return command

    return local_step
