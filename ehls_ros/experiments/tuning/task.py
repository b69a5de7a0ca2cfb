"""The experiment for which a law is tuned: the rig's file, a reference, and the actuator under test."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from ehls_ros.control.controllers import CONTROLLERS
from ehls_ros.control.disturbances.position_servo import steady_gain
from ehls_ros.control.local_plant import speed_of
from ehls_ros.control.references import constant, sine
from ehls_ros.errors import BadInput
from ehls_ros.experiments.catalogue import largest_force, room_of
from ehls_ros.experiments.metrics import MIN_LOST_ERROR
from ehls_ros.experiments.spec import COUPLING, Spec, Use, check_spec, reference_extremes, spec_from_mapping
from ehls_ros.physics.rig import Rig, rig_to_mapping

SERVO = "position_servo"
"""Disturbance that stands for the actuator under test."""

FORCE_PART, FREQUENCY = 0.5, 0.5
"""Amplitude of the reference by default, over the largest force, and its frequency [Hz]."""

SPEED_PART, STROKE_PART, MOTION_FREQUENCY = 0.3, 0.5, 1.0
"""Motion of the actuator under test by default: velocity over the loader's, travel over half the stroke, frequency [Hz]."""

OTHERS = ((0.6, 1.3), (0.9, 0.4), (1.3, 2.0), (2.0, 0.6), (3.0, 0.9))
"""Frequencies of reference and motion over the usual ones for rigs within the uncertainty, where no experiment is given."""

HELD_PART, HELD_FREQUENCY, HELD_DURATION = 0.05, 0.5, 3.0
"""Sine of the force against an actuator that holds: amplitude over the largest force, frequency [Hz], duration [s]."""

DURATION = 5.0
"""Longest duration of a run [s], the last half of which is judged."""

UNTOLD = (
    f"the rig file does not tell the coupling to the actuator under test (effect {COUPLING}): {{:.3g}} N/m is assumed; measure"
    " it with the rod connected: force over displacement"
)
"""Remark on a missing coupling."""


class Task(NamedTuple):
    """An experiment to tune for.

    Attributes:
        spec: the experiment.
        remarks: sentences on assumptions made.
        others: the experiment with other frequencies, where none is given; numbers that follow one sine may follow no other.
    """

    spec: Spec
    remarks: tuple[str, ...]
    others: tuple[Spec, ...] = ()


def task_of(
    rig: Rig,
    law: str,
    given: Mapping[str, Any] | None = None,
    where: str = "tune",
    folder: Path = Path(),
    period: float | None = None,
) -> Task:
    """Return the experiment to tune for.

    The simulated rig is the one that the controller knows, including delay and coupling.

    Args:
        rig: the rig; its effect ``coupling_stiffness`` is the coupling to the actuator under test.
        law: name of the control law.
        given: content of an experiment file, of which reference, disturbance, control period and the law's numbers are used;
            None: sines of force and motion within the rig's reach.
        where: the file, for errors.
        folder: folder of its files.
        period: control period without an experiment [s]; None: the usual one.

    Raises:
        BadInput: a key of the experiment is wrong, or the law does not control a force.
    """
    if given is None:
        task = task_of(rig, law, usual(rig, period), where)
        return task._replace(others=tuple(task_of(rig, law, usual(rig, period, *other), where).spec for other in OTHERS))
    content: dict[str, Any] = {"title": f"tuning of {law}", **given}
    stated = content.get("controller")
    stated = dict(stated) if isinstance(stated, Mapping) else {"name": stated or law}
    for name in (law, stated.get("name")):
        if (follows := CONTROLLERS.load(name, where).FOLLOWS) != "force":
            raise BadInput(f"{name} follows a {follows}", where, "a law and an experiment that follow a force")
    content |= {"rig": rig_to_mapping(rig), "controller_rig": None, "effects": [], "companions": []}
    coupled = isinstance(content.get("disturbance"), Mapping) and content["disturbance"].get("name") == SERVO
    told = any(use.name == COUPLING for use in rig.effects)
    content["known_effects"] = [COUPLING] if coupled and not told else []
    content["controller"] = stated if stated["name"] == law else {"name": law}
    content["duration"] = min(float(content.get("duration", DURATION)), DURATION)
    spec = spec_from_mapping(content, where, folder)
    check_spec(spec, where)
    assumed = (UNTOLD.format(spec.disturbance.parameters.stiffness),) if coupled and not told else ()
    return Task(spec, assumed)


def still(spec: Spec) -> Spec:
    """Return an experiment whose actuator under test, or disturbance force, stays at zero."""
    return spec._replace(disturbance=spec.disturbance._replace(signal=Use("constant", constant.Parameters(0.0))))


def loses(spec: Spec, error: float) -> bool:
    """Return whether with such a largest error [N] the force of an experiment counts as lost.

    The error is compared with the largest reference, or with the rig's largest force where the reference is zero throughout.
    """
    wanted = max(map(abs, reference_extremes(spec))) or largest_force(spec.rig)
    return not error < MIN_LOST_ERROR * wanted


def held(spec: Spec) -> Spec | None:
    """Return an experiment with a small force against an actuator under test that holds; None without such an actuator.

    There a loop may oscillate that follows a moving actuator: its filter is calm, and the coupling and both oil columns are
    hardly damped.
    """
    if spec.disturbance.name != SERVO:
        return None
    amplitude = HELD_PART * largest_force(spec.rig)
    reference = Use("sine", sine.Parameters(amplitude=amplitude, frequency=HELD_FREQUENCY))
    settings = spec.settings._replace(duration=min(spec.settings.duration, HELD_DURATION))
    return still(spec)._replace(reference=reference, settings=settings)


def usual(rig: Rig, period: float | None = None, faster: float = 1.0, moving_faster: float = 1.0) -> dict[str, Any]:
    """Return reference and disturbance within the reach of a rig, for two periods of the usual force.

    Args:
        rig: the rig.
        period: control period [s]; None: the usual one.
        faster: frequency of the force over the usual one.
        moving_faster: frequency of the motion over the usual one.
    """
    plant, frequency = rig.plant, moving_faster * MOTION_FREQUENCY
    travel = min(SPEED_PART * speed_of(rig) / (2.0 * math.pi * frequency), STROKE_PART * room_of(rig))
    amplitude = FORCE_PART * (largest_force(rig) - abs(plant.moving_mass * plant.gravity))
    return {
        **({} if period is None else {"control_period": period}),
        "duration": 2.0 / FREQUENCY,
        "reference": {"name": "sine", "amplitude": float(f"{amplitude:.3g}"), "frequency": faster * FREQUENCY},
        "disturbance": servo_of(rig, {"name": "sine", "amplitude": float(f"{travel:.3g}"), "frequency": frequency}),
    }


def servo_of(rig: Rig, signal: Mapping[str, Any]) -> dict[str, Any]:
    """Return the actuator under test as a servo like the loader, which follows a signal and does not swing by itself."""
    return {"name": SERVO, "position_gain": float(f"{steady_gain(rig):.3g}"), "signal": {**signal}}
