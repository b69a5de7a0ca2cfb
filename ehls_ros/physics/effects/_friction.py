"""Coefficients of a rig's friction model, of which an effect shifts those it finds."""

from typing import Any

from ehls_ros.physics.rig import Rig


def has(rig: Rig, *keys: str) -> bool:
    """Tell whether a rig's friction model has one of some coefficients."""
    return bool(set(keys) & set(rig.friction._fields))


def shifted(rig: Rig, **values: Any) -> Rig:
    """Return a rig with other values of those of some coefficients that its friction model has."""
    return rig._replace(friction=rig.friction._replace(**{key: value for key, value in values.items() if has(rig, key)}))
