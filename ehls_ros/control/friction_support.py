"""Compatibility of observers and controllers with friction models."""

from typing import Any

from ehls_ros.errors import BadInput
from ehls_ros.families import Family
from ehls_ros.physics.rig import Rig


def supports(member: Any, rig: Rig) -> bool:
    """Return whether an observer or controller supports the friction model of a rig."""
    return getattr(member, "FRICTION_MODEL", rig.friction_model) == rig.friction_model


def check_friction_support(family: Family[Any], name: str, rig: Rig, where: str) -> None:
    """Check that an observer or controller supports the friction model of a rig.

    Args:
        family: observers or controllers.
        name: name of the observer or controller.
        rig: the rig as described to the controller.
        where: file and section, for error messages.

    Raises:
        BadInput: it supports only another model.
    """
    if not supports(family.load(name, where), rig):
        what = f"{family.noun} {name!r} does not support friction model {rig.friction_model!r}"
        followed = getattr(family.load(name), "FOLLOWS", None)
        others = {other: family.load(other) for other in family.names()}
        able = [
            other for other, member in others.items() if supports(member, rig) and getattr(member, "FOLLOWS", None) == followed
        ]
        only = others[name].FRICTION_MODEL
        raise BadInput(what, where, f"one of {', '.join(able)}; or a rig whose friction model is {only}")
