"""Modify a rig's sensors."""

from collections.abc import Callable, Iterable

from ehls_ros.physics.parameters import Sensor
from ehls_ros.physics.rig import Rig


def with_sensors(rig: Rig, signals: Iterable[str], change: Callable[[Sensor], Sensor]) -> Rig:
    """Return the rig with the sensors of the given signals changed; a missing sensor starts as a perfect one."""
    return rig._replace(sensors={**rig.sensors, **{name: change(rig.sensors.get(name, Sensor())) for name in signals}})
