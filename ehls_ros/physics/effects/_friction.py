"""Shifts of the coefficients of a rig's friction model."""

from typing import Any

from ehls_ros.physics.rig import Rig


def has(rig: Rig, *keys: str) -> bool:
    """Return whether a rig's friction model has at least one of the coefficients."""
    return bool(set(keys) & set(rig.friction._fields))


def shifted(rig: Rig, **values: Any) -> Rig:
    """Return a rig with new values of coefficients; those that its friction model lacks are ignored."""
    return rig._replace(friction=rig.friction._replace(**{key: value for key, value in values.items() if has(rig, key)}))
