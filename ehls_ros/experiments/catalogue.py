"""Catalogue of experiments that can be proposed next, scaled to a rig.

Each is a spec for ``ehls experiment`` without ``rig``, five to ten seconds long. Forces, strokes and velocities are fractions
of the rig's limits; creeping velocities and presliding displacements are multiples of those at which its friction changes.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from ehls_ros.control.references import steps, velocity_sweep
from ehls_ros.errors import BadInput, one_of
from ehls_ros.physics.rig import EffectiveRig, Rig

SLOW = 1e-3
"""Velocity taken as slow if friction does not depend on it, as a fraction of the rig's limit."""

MIN_YIELDING = 1e-5
"""Presliding travel assumed for stiffer contacts [m]: the resolution of sensors."""


class Reach(NamedTuple):
    """Ranges of a rig to which the experiments are scaled.

    Attributes:
        home: centre position of the experiments [m].
        stroke: travel to either side allowed by stroke and spring [m].
        speed: velocity allowed by valve and damping [m/s].
        force: force to either side of ``weight`` allowed by the cylinder and by the stroke against the spring [N].
        load: disturbance that the rig can withstand [N].
        weight: driving force at rest at home [N].
        slow: velocity at which friction changes from static to sliding [m/s].
        yielding: presliding displacement [m].
    """

    home: float
    stroke: float
    speed: float
    force: float
    load: float
    weight: float
    slow: float
    yielding: float


def home_of(rig: Rig | EffectiveRig) -> float:
    """Return the initial position of a run [m]: the spring's rest position, or mid-stroke if that is too near an end."""
    low, high = rig.limits.position
    return 0.0 if min(-low, high) > 0.25 * (high - low) else 0.5 * (low + high)


def room_of(rig: Rig | EffectiveRig) -> float:
    """Return the distance from the initial position to the nearer end of the stroke [m]."""
    low, high = rig.limits.position
    return min(home_of(rig) - low, high - home_of(rig))


def largest_force(rig: Rig | EffectiveRig) -> float:
    """Return the largest force in both directions allowed by limits and supply pressure [N]."""
    low, high = rig.forces()
    return min(rig.limits.force, rig.limits.load_pressure * rig.plant.piston_area, -low, high)


def reach(rig: EffectiveRig) -> Reach:
    """Return the ranges of a rig."""
    plant, friction, limits = rig.plant, rig.friction, rig.limits
    area, home, half, largest = plant.piston_area, home_of(rig), room_of(rig), largest_force(rig)
    weight = plant.spring_stiffness * home + plant.moving_mass * plant.gravity
    usable = max(0.7 * largest - abs(weight) - rig.friction_level(0.0), 0.05 * largest)
    flow = plant.discharge_coefficient * plant.valve_area_gradient * limits.spool * plant.valve_gain
    fastest = min(0.25 * limits.velocity, 0.5 * flow * math.sqrt(0.5 * plant.supply_pressure / plant.oil_density) / area)
    damping = plant.viscous_damping + friction.viscous_coefficient
    stiffness = plant.spring_stiffness
    return Reach(
        home=home,
        stroke=min(0.8 * half, usable / stiffness) if stiffness > 0.0 else 0.8 * half,
        speed=min(fastest, 0.25 * largest / damping) if damping > 0.0 else fastest,
        force=min(usable, max(0.8 * half * stiffness, 0.5 * rig.friction_level(math.inf))),
        load=0.8 * usable,
        weight=weight,
        slow=getattr(friction, "stribeck_velocity", SLOW * limits.velocity),
        yielding=max(rig.friction_level(0.0) / rig.friction_law.stiffness(friction), MIN_YIELDING),
    )


class Entry(NamedTuple):
    """One experiment of the catalogue.

    Attributes:
        purpose: short description.
        build: makes the spec's mapping, without ``rig``, from the ranges of a rig.
    """

    purpose: str
    build: Callable[[Reach], dict[str, Any]]


def _following_position(reference: dict[str, Any], duration: float, r: Reach, **sections: Any) -> dict[str, Any]:
    return {
        "duration": duration,
        "initial_position": r.home,
        "reference": reference,
        "controller": {"name": "pid"},
        **sections,
    }


def _following_force(reference: dict[str, Any], duration: float, r: Reach) -> dict[str, Any]:
    return {**_following_position(reference, duration, r), "controller": {"name": "fasmc"}}


def _load(signal: dict[str, Any]) -> dict[str, Any]:
    return {"name": "force", "signal": signal}


def _staircase(top: float, each: int) -> list[float]:
    """Return levels from 0 up to ``top``, down to -``top`` and back, ``each`` of them on a flank."""
    up = [top * k / each for k in range(each + 1)]
    return [*up, *up[-2::-1], *(-level for level in up[1:]), *(-level for level in up[-2::-1])]


def _stepped(levels: Sequence[float], hold: float, rise: float) -> tuple[dict[str, Any], float]:
    p = steps.Parameters(levels=tuple(levels), hold=hold, rise=rise)
    return {"name": "steps", "levels": list(p.levels), "hold": hold, "rise": rise}, steps.duration(p)


def _velocity_sweep(r: Reach) -> dict[str, Any]:
    fastest = max(min(0.4 * r.speed, r.stroke / 0.4), 4.0 * r.slow)
    velocities = tuple(float(v) for v in np.geomspace(r.slow, fastest, 5))
    values: dict[str, Any] = {"repeats": 1, "travel": 2.0 * r.stroke, "longest": 0.4, "rest": 0.1, "centre": r.home}
    # Strokes at the highest velocity accelerate and decelerate for a quarter of their time each.
    p = velocity_sweep.Parameters(velocities=velocities, acceleration=10.0 * fastest, **values)
    reference = {"name": "velocity_sweep", "velocities": list(velocities), "acceleration": p.acceleration, **values}
    return _following_position(reference, math.ceil(10.0 * velocity_sweep.duration(p)) / 10.0, r)


def _warm_velocity_sweep(r: Reach) -> dict[str, Any]:
    return {**_velocity_sweep(r), "oil_temperature": 333.15}


def _presliding(r: Reach) -> dict[str, Any]:
    largest = min(4.0 * r.yielding, r.stroke)
    values = {"start_amplitude": largest, "end_amplitude": 0.1 * largest, "frequency": 0.5, "sweep": 8.0, "offset": r.home}
    return _following_position({"name": "amplitude_sweep", **values}, 8.0, r)


def _break_away(r: Reach) -> dict[str, Any]:
    way = min(12.0 * r.yielding, 0.5 * r.stroke)
    reference, duration = _stepped([r.home + way * k for k in (0.0, 1.0, 2.0, 1.0, 0.0, -1.0, 0.0)], hold=0.8, rise=0.5)
    return _following_position(reference, duration, r)


def _small_and_large(r: Reach) -> dict[str, Any]:
    frequency = 0.5
    largest = min(0.8 * r.stroke, r.speed / (2.0 * math.pi * frequency))
    values = {"end_amplitude": largest, "frequency": frequency, "sweep": 8.0, "offset": r.home}
    return _following_position({"name": "amplitude_sweep", **values}, 8.0, r)


def _large_sine(r: Reach) -> dict[str, Any]:
    frequency = min(0.4, r.speed / (2.0 * math.pi * 0.9 * r.stroke))
    values = {"amplitude": 0.9 * r.stroke, "start_frequency": 0.0, "end_frequency": frequency, "sweep": 4.0, "offset": r.home}
    return _following_position({"name": "chirp", **values}, 9.0, r)


def _full_stroke(r: Reach) -> dict[str, Any]:
    rise = max(1.2, 2.0 * 1.15 * r.stroke / r.speed)
    reference, duration = _stepped([r.home + 1.15 * r.stroke * k for k in (0.0, 1.0, 0.0, -1.0, 0.0)], hold=0.4, rise=rise)
    return _following_position(reference, duration, r)


def _fast_chirp(r: Reach) -> dict[str, Any]:
    highest = 10.0
    amplitude = min(0.5 * r.speed / (2.0 * math.pi * highest), 0.1 * r.stroke)
    values = {"amplitude": amplitude, "start_frequency": 0.0, "end_frequency": highest, "sweep": 8.0, "offset": r.home}
    return _following_position({"name": "chirp", **values}, 8.0, r)


def _loaded_motion(r: Reach) -> dict[str, Any]:
    amplitude = min(0.02 * r.speed, 0.1 * r.stroke)
    reference = {"name": "amplitude_sweep", "end_amplitude": amplitude, "frequency": 1.0, "sweep": 1.0, "offset": r.home}
    signal, duration = _stepped(_staircase(r.load, 2), hold=0.8, rise=0.2)
    return _following_position(reference, duration, r, disturbance=_load(signal))


def _pressure_staircase(r: Reach) -> dict[str, Any]:
    # A motion first, so that friction does not depend on its history; then the load.
    way = min(12.0 * r.yielding, 0.5 * r.stroke)
    reference, _ = _stepped([r.home, r.home + way, r.home], hold=0.2, rise=0.5)
    signal, duration = _stepped([0.0, *_staircase(r.load, 2)], hold=0.8, rise=0.2)
    return _following_position(reference, duration, r, disturbance=_load(signal))


def _force_staircase(r: Reach) -> dict[str, Any]:
    reference, duration = _stepped([r.weight + level for level in _staircase(r.force, 2)], hold=0.6, rise=0.4)
    return _following_force(reference, duration, r)


def _force_steps(r: Reach) -> dict[str, Any]:
    levels = [r.weight + r.force * k for k in (0.0, 0.5, -0.25, 1.0, 0.25, -1.0, 0.0)]
    reference, duration = _stepped(levels, hold=0.6, rise=0.5)
    return _following_force(reference, duration, r)


def _force_chirp(r: Reach) -> dict[str, Any]:
    values = {"amplitude": 0.3 * r.force, "start_frequency": 0.0, "end_frequency": 5.0, "sweep": 8.0, "offset": r.weight}
    return _following_force({"name": "chirp", **values}, 8.0, r)


CATALOGUE: Mapping[str, Entry] = MappingProxyType(
    {
        "velocity_sweep": Entry("friction over velocity, creeping to fast", _velocity_sweep),
        "warm_velocity_sweep": Entry("the velocity sweep with oil of 60 °C", _warm_velocity_sweep),
        "presliding": Entry("reversals from sliding down to within presliding", _presliding),
        "break_away": Entry("slow moves with rests between them", _break_away),
        "small_and_large": Entry("a sine from small to large amplitude", _small_and_large),
        "large_sine": Entry("a large, slow sine of position", _large_sine),
        "full_stroke": Entry("moves to both ends of the stroke", _full_stroke),
        "fast_chirp": Entry("position up to high frequency", _fast_chirp),
        "loaded_motion": Entry("one motion to and fro under a staircase of load", _loaded_motion),
        "pressure_staircase": Entry("the piston held against a staircase of load", _pressure_staircase),
        "force_staircase": Entry("a slow staircase of force", _force_staircase),
        "force_steps": Entry("quick steps of force of several sizes", _force_steps),
        "force_chirp": Entry("force up to high frequency", _force_chirp),
    }
)
"""The experiments by name."""


def catalogue_spec(name: str, rig: Rig) -> dict[str, Any]:
    """Return an experiment of the catalogue, scaled to a rig.

    Args:
        name: its name in :data:`CATALOGUE`.
        rig: the rig it will run on.

    Returns:
        The mapping of a spec file, without ``rig``.

    Raises:
        BadInput: there is no such experiment.
    """
    if name not in CATALOGUE:
        raise BadInput(f"experiment {name!r} is unknown", "catalogue", one_of(name, CATALOGUE))
    entry = CATALOGUE[name]
    mapping: dict[str, Any] = _rounded({"title": f"next experiment: {entry.purpose}", **entry.build(reach(rig.effective()))})
    return mapping


def _rounded(value: Any) -> Any:
    """Return numbers rounded to five digits."""
    if isinstance(value, float):
        return float(f"{value:.5g}") + 0.0  # no -0.0
    if isinstance(value, dict):
        return {key: _rounded(item) for key, item in value.items()}
    return [_rounded(item) for item in value] if isinstance(value, list) else value
