"""Which observers and controllers serve which friction model."""

from typing import Any

from ehls_ros.errors import BadInput
from ehls_ros.families import Family
from ehls_ros.physics.rig import Rig


def serves(member: Any, rig: Rig) -> bool:
    """Tell whether an observer or controller serves the friction model of a rig."""
    return getattr(member, "FRICTION_MODEL", rig.friction_model) == rig.friction_model


def check_serves(family: Family[Any], name: str, rig: Rig, where: str) -> None:
    """Look whether an observer or controller serves the friction model of a rig.

    Args:
        family: observers or controllers.
        name: which.
        rig: the rig as the controller believes it to be.
        where: file and section, for errors.

    Raises:
        BadInput: it serves another model.
    """
    if not serves(family.load(name, where), rig):
        what = f"{family.noun} {name!r} does not serve friction model {rig.friction_model!r}"
        alike = getattr(family.load(name), "FOLLOWS", None)
        others = {other: family.load(other) for other in family.names()}
        able = [other for other, member in others.items() if serves(member, rig) and getattr(member, "FOLLOWS", None) == alike]
        only = others[name].FRICTION_MODEL
        raise BadInput(what, where, f"one of {', '.join(able)}; or a rig whose friction model is {only}")
