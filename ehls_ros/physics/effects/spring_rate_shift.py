"""The spring device is stiffer or softer than in the rig file."""

from typing import Annotated, NamedTuple

from ehls_ros.physics.effects.base import Form, Group, Words
from ehls_ros.physics.rig import EffectUse, Rig
from ehls_ros.schema import quantity

GROUP: Group = "mechanics"
FIXED = ("zero",)
EQUATION = "ks -> ks + added, at least 0; `constant_load`, the preload of a mounted spring, grows by the change of ks × zero"
SOURCE = "Kang et al. 2018, (3)"
WORDS = Words(
    "the stiffness of the spring",
    lacking=False,
    inspect="inspect which spring is mounted, and its fixtures",
    measure="measure the spring's force at rest at two positions",
    change="add the fitted value to `spring_stiffness` in the rig file",
)


class Parameters(NamedTuple):
    """Change of the stiffness."""

    added: Annotated[float, quantity("N/m", "added to the spring's stiffness", minimum=-1e8, maximum=1e8)] = 0.0
    zero: Annotated[float, quantity("m", "position at which the spring is free", minimum=-10.0, maximum=10.0)] = 0.0


def shift(rig: Rig, parameters: Parameters) -> Rig:
    """Return the rig with the stiffness shifted."""
    before = rig.plant.spring_stiffness
    stiffness = max(before + parameters.added, 0.0)
    rig = rig.with_plant(spring_stiffness=stiffness)
    preload = _preload_of(rig)
    if parameters.zero == 0.0 or preload is None:
        return rig
    force = preload.parameters.force + (stiffness - before) * parameters.zero
    more = preload._replace(parameters=preload.parameters._replace(force=force))
    return rig._replace(effects=tuple(more if use is preload else use for use in rig.effects))


def _preload_of(rig: Rig) -> EffectUse | None:
    """Return the constant load of a rig, which holds the force of its spring at zero; None if it has none."""
    return next((use for use in rig.effects if use.name == "constant_load"), None)


def forms(rig: Rig) -> tuple[Form, ...]:
    """The added stiffness about the middle, and about the zero of a spring whose preload is the rig's constant load."""
    about_middle = Form({"added": ()})
    stiffness, preload = rig.plant.spring_stiffness, _preload_of(rig)
    if preload is None or not stiffness > 0.0:
        return (about_middle,)
    return (about_middle, Form({"added": ()}, {"zero": preload.parameters.force / stiffness}))
