"""Assumptions for a law on a real rig: of numbers that its rig file lacks, and adaptation to those that are wrong.

None is worse than a usual one: a filter without the cycle by which a command acts late loses the force as soon as the piston
rests, one without a coupling takes the piston's own motion for the actuator's, and one with exact sensors takes their noise and
rounding for motion.
"""

from typing import NamedTuple

from ehls_ros.control.companions import adaptation
from ehls_ros.control.controllers import CONTROLLERS
from ehls_ros.control.rig_scale import PAPER_COUPLING, PAPER_COUPLING_DAMPING, PAPER_SENSORS, ratios, tuned_for
from ehls_ros.experiments.adaptation_result import NAME as ADAPTATION
from ehls_ros.experiments.spec import COMMAND_DELAY, COUPLING, Spec, Use
from ehls_ros.physics.parameters import Sensor
from ehls_ros.physics.rig import EffectUse, Rig, effects_from_list

ADAPTING = (Use(ADAPTATION, adaptation.Parameters()),)
"""The companion that adapts a law to a rig."""

FOUND_BY = "`ehls commission` measures it"


class RealRig(NamedTuple):
    """An experiment for a real rig.

    Attributes:
        spec: the experiment with the assumptions.
        remarks: a sentence on each assumption, with the way to replace it.
    """

    spec: Spec
    remarks: tuple[str, ...]


def for_real_rig(spec: Spec, *, adapt: bool = True) -> RealRig:
    """Return an experiment whose law assumes usual numbers where the rig file has none, and adapts.

    Args:
        spec: the experiment; its companions are kept if it names any.
        adapt: whether to add the companion ``adaptation``.
    """
    law, remarks = CONTROLLERS.load(spec.controller.name), list[str]()
    rig = spec.controller_rig
    told = {use.name for use in rig.effects}
    # A law takes both from its model, or has them as parameters of the same names.
    knows = {*getattr(law, "KNOWS", ()), *law.Parameters._fields}
    usual = usual_effects(rig, spec.settings.control_period)
    assumed = [use for use in usual if use.name in knows - told]
    for use in assumed:
        sizes = ", ".join(f"{name} {value:.3g}" for name, value in use.parameters._asdict().items())
        lacking = f"the controller's rig file has no effect {use.name}"
        remarks.append(f"{lacking}: {spec.controller.name} assumes a usual one ({sizes}); {FOUND_BY}")
    filters = any(use.name in knows for use in usual)
    exact = {signal: sensor for signal, sensor in usual_sensors(rig).items() if filters and signal in law.NEEDS}
    if exact:
        readings = f"the controller's rig file has no noise_std of {', '.join(exact)}"
        remarks.append(f"{readings}: {spec.controller.name} assumes that of usual sensors of the rig's size; {FOUND_BY}")
        rig = rig._replace(sensors={**rig.sensors, **exact})
    if filters:
        spec = _with_controller_rig(spec, rig.with_effects(tuple(assumed)))
    if law.FOLLOWS == "force" and not spec.companions and (filters or law.FRICTION):
        if adapt:
            spec = spec._replace(companions=ADAPTING)
            remarks.append("adaptation corrects wrong numbers of the rig file within bounds while it runs, and names them")
        else:
            remarks.append("adaptation is off: wrong numbers of the rig file are neither corrected nor named while it runs")
    return RealRig(spec, tuple(remarks))


def usual_effects(rig: Rig, period: float) -> tuple[EffectUse, ...]:
    """Return the usual delay and coupling of a rig: a cycle, and the paper's coupling on the rig's scale.

    Args:
        rig: the rig.
        period: control period [s].
    """
    scale = ratios(rig._replace(effects=()))
    coupling = {"stiffness": PAPER_COUPLING * scale.coupling, "damping": PAPER_COUPLING_DAMPING * scale.coupling_damping}
    return effects_from_list([{"name": COMMAND_DELAY, "delay": period}, {"name": COUPLING, **coupling}], "usual effects")


def usual_sensors(rig: Rig) -> dict[str, Sensor]:
    """Return sensors with the noise of the paper's on the rig's scale, for the readings without noise in the rig file."""
    scale, described = ratios(rig), rig.effective().sensors
    sizes = zip(PAPER_SENSORS, (scale.position_noise, scale.pressure_noise, scale.spool_noise, scale.force_noise), strict=True)
    found = dict[str, Sensor]()
    for signal, size in sizes:
        given, usual = described.get(signal, Sensor()), PAPER_SENSORS[signal]
        if given.reading_std == 0.0:
            found[signal] = given._replace(noise_std=size * usual.noise_std, resolution=size * usual.resolution)
    return found


def _with_controller_rig(spec: Spec, rig: Rig) -> Spec:
    """Return an experiment with another rig of the controller; numbers of the law that are defaults follow it."""
    given = spec.controller.parameters
    before, after = (tuned_for(type(given), known) for known in (spec.controller_rig, rig))
    following = [new if value == old else value for value, old, new in zip(given, before, after, strict=True)]
    return spec._replace(controller_rig=rig, controller=spec.controller._replace(parameters=type(given)(*following)))
