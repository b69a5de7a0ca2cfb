"""Choose the integration step that resolves a rig.

The simulator takes steps of constant length, short enough for the fastest part of the rig: oil column, valve, friction, or an
effect.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

from ehls_ros.errors import BadInput
from ehls_ros.physics.composition import effects_in_kernel
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.plausibility import units_of
from ehls_ros.physics.rig import EffectiveRig, Rig
from ehls_ros.physics.servo import Servo

LONGEST_STEP = 2.5e-4
"""Default integration step [s], unless the rig needs a shorter one; justified by benchmarks/physics_convergence.py."""

SHORTEST_STEP = 5e-5
"""Shortest default step [s]: a rig that needs shorter ones more likely has a value in a wrong unit."""

DECAY = 2.0
"""Largest product of integration step and decay rate; the scheme is stable up to 3.3."""

OSCILLATION = 1.0
"""Largest product of integration step and natural frequency, even undamped: the amplitude error is then 2e-6 per step."""

_RATES: Mapping[str, tuple[Callable[[float, float], float], float]] = MappingProxyType(
    {
        "N/m": (lambda value, mass: math.sqrt(abs(value) / mass), OSCILLATION),
        "N s/m": (lambda value, mass: abs(value) / mass, DECAY),
        "rad/s": (lambda value, mass: value, OSCILLATION),
        "Hz": (lambda value, mass: 2.0 * math.pi * value, OSCILLATION),
    }
)
"""By unit of a coefficient: its natural rate on a mass [kg], and the largest product of this rate and the step."""


class Rate(NamedTuple):
    """Natural rate of a part of the plant.

    Attributes:
        what: name of the part.
        rate: inverse time constant or natural frequency [1/s].
        most: largest product of integration step and rate.
        keys: coefficients of plant and friction that the rate depends on.
        further: its other dependencies, as text.
    """

    what: str
    rate: float
    most: float
    keys: tuple[str, ...]
    further: str = ""

    @property
    def step(self) -> float:
        """Longest step that resolves the part [s]."""
        return self.most / self.rate if self.rate > 0.0 else math.inf


def rates(rig: Rig, servo: Servo | None = None) -> Iterator[Rate]:
    """Yield the natural rate of each part of a plant.

    Args:
        rig: the rig with its effects; stiffness and damping of an effect count as if always active.
        servo: position servo that is simulated with the rig.

    Yields:
        The rates. Springs and dampers act on the smaller of piston and load; those of the coupling to the servo act on the
        reduced mass of both pistons.
    """
    far = math.inf if servo is None else servo.rig.plant.moving_mass
    effective = rig.effective()
    p, f, law, limits = effective.plant, effective.friction, effective.friction_law, effective.limits
    piston = effective.piston_mass()
    mass = min(p.moving_mass, piston) if piston > 0.0 else p.moving_mass
    on_mass = f"on {mass:g} kg"
    # The piston's largest velocity limits the flow; the spool's limit may allow far more.
    gradient = p.discharge_coefficient * p.valve_area_gradient * math.sqrt(p.supply_pressure / p.oil_density)
    flow = min(gradient * p.valve_gain * limits.spool, p.piston_area * limits.velocity)
    yield Rate("valve", p.valve_bandwidth, DECAY, ("valve_bandwidth",))
    oil = effective.cylinder.law.oil_rates(effective, flow)
    yield Rate("oil column", math.sqrt(oil.column / mass), OSCILLATION, oil.keys, on_mass)
    yield Rate("leakage", oil.leakage, DECAY, ("leakage_coefficient", *oil.keys))
    yield Rate("valve's flow", oil.orifice, DECAY, ("supply_pressure", *oil.keys), f"at {flow:g} m^3/s")
    if math.isfinite(stiffness := law.stiffness(f)):
        springs = tuple(key for key, unit in units_of(type(f)).items() if unit == "N/m")
        yield Rate("presliding friction", math.sqrt(stiffness / mass), OSCILLATION, springs, on_mass)
    damping = (p.viscous_damping + f.viscous_coefficient) / mass
    yield Rate("damping", damping, DECAY, ("viscous_damping", "viscous_coefficient"), on_mass)
    yield Rate("spring", math.sqrt(p.spring_stiffness / mass), OSCILLATION, ("spring_stiffness",), on_mass)
    slipping = tuple(key for key in f._fields if key != "viscous_coefficient")
    relaxation = law.relaxation_rate(f, limits.velocity)
    yield Rate("slipping friction", relaxation, DECAY, slipping, f"at {limits.velocity:g} m/s")
    for use in effects_in_kernel(rig):
        for key, unit in units_of(EFFECTS.load(use.name).Parameters).items():
            if unit in _RATES:
                value, (rate, most) = getattr(use.parameters, key), _RATES[unit]
                couples = getattr(EFFECTS.load(use.name), "COUPLES", False)
                swinging = 1.0 / (1.0 / mass + 1.0 / far) if couples else mass
                further = f"{key} {value:g} {unit} on {swinging:g} kg"
                yield Rate(f"effect {use.name}", rate(value, swinging), most, (), further)
    if servo is not None:
        shown = _shown(servo.rig.effective())
        for part in rates(servo.rig):
            basis = " ".join([", ".join(shown[key] for key in part.keys), part.further]).strip()
            yield Rate(f"position servo's {part.what}", part.rate, part.most, (), basis)


def steps_per_period(rig: Rig, period: float, step: float | None = None, servo: Servo | None = None) -> int:
    """Return the number of equal integration steps in a control period.

    Args:
        rig: the rig.
        period: control period [s].
        step: largest integration step [s]; by default :data:`LONGEST_STEP`, or a shorter one if the rig needs it, down to
            :data:`SHORTEST_STEP`.
        servo: position servo that is simulated with the rig.
    """
    if step is None:
        step = min(LONGEST_STEP, max(min(part.step for part in rates(rig, servo)), SHORTEST_STEP))
    return max(1, math.ceil(period / step - 1e-9))


def check_step(rig: Rig, step: float, where: str, servo: Servo | None = None) -> None:
    """Check that an integration step resolves all parts of a plant.

    Args:
        rig: the rig.
        step: integration step [s].
        where: the file, for error messages.
        servo: position servo that is simulated with the rig.

    Raises:
        BadInput: the fastest part is too fast for the step.
    """
    fastest = min(rates(rig, servo), key=lambda part: part.step)
    if step > fastest.step:
        shown = _shown(rig.effective())
        basis = " ".join([", ".join(shown[key] for key in fastest.keys), fastest.further]).strip()
        what = f"the rate of the {fastest.what}, {fastest.rate:.3g} 1/s, is too fast for steps of {step:g} s ({basis})"
        raise BadInput(what, where, f"integration_step of at most {fastest.step:.2g} s, or other parameters, all in SI units")


def _shown(rig: EffectiveRig) -> dict[str, str]:
    """Return each coefficient of plant and friction as text for messages."""
    return _described(rig.plant) | _described(rig.friction)


def _described(parameters: Any) -> dict[str, str]:
    """Return each field as text for messages: name, value or values, unit."""

    def formatted(value: float | tuple[float, ...]) -> str:
        return ", ".join(f"{one:g}" for one in value) if isinstance(value, tuple) else f"{value:g}"

    units = units_of(type(parameters))
    return {
        key: f"{key} {formatted(value)}{'' if units[key] == '1' else f' {units[key]}'}"
        for key, value in parameters._asdict().items()
    }
