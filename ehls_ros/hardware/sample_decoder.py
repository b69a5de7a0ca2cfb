"""Decode the raw values of a sample into a rig's readings.

The load pressure of two chambers follows from theirs, or else from the load cell; without sensors in the chambers, laws take
the pressures of steady motion under that force.
"""

import math
from collections.abc import Sequence

from ehls_ros.hardware.calibration import Calibration
from ehls_ros.physics import sensors
from ehls_ros.physics.rig import CHAMBER_SENSED, Rig

DERIVED, FORCE = "load_pressure", "force"


def measured_signals(rig: Rig, wired: Sequence[str]) -> tuple[str, ...]:
    """Return the signals known from those that have a channel.

    Args:
        rig: the rig.
        wired: the signals that have a channel.
    """
    known = rig.cylinder.law.CHAMBERS and (set(CHAMBER_SENSED) <= set(wired) or FORCE in wired)
    return (*wired, DERIVED) if known and DERIVED not in wired else tuple(wired)


class SampleDecoder:
    """Decodes samples into readings.

    Attributes:
        sensed: signals of a sample, in the order of its readings.
        measured: those that are known.
    """

    def __init__(self, calibration: Calibration, rig: Rig) -> None:
        """Take the calibration of the channels, and the rig whose areas are known."""
        self.sensed = calibration.sensed
        self.measured = measured_signals(rig, calibration.wired)
        self._calibration = calibration
        # Load pressure per reading, by the place of the reading; empty: it has a channel, or is not known.
        self._shares: tuple[tuple[int, float], ...] = ()
        if DERIVED in self.measured and DERIVED not in calibration.wired:
            areas, mean = rig.cylinder.parameters, rig.plant.piston_area
            both = (sensors.PRESSURE_A, areas.area_a / mean), (sensors.PRESSURE_B, -areas.area_b / mean)
            self._shares = both if set(CHAMBER_SENSED) <= set(calibration.wired) else ((sensors.FORCE, 1.0 / mean),)

    def decode(self, values: Sequence[float]) -> tuple[tuple[float, ...], tuple[str, ...]]:
        """Decode the raw values of one sample.

        Args:
            values: raw values in the order of the wiring's inputs.

        Returns:
            The readings [SI], NaN where a signal is not known or its converter is saturated, and the saturated signals.
        """
        saturated, signals = self._calibration.saturated(values), list(self._calibration.signals(values))
        for name in saturated:
            signals[self.sensed.index(name)] = math.nan
        if self._shares:
            signals[sensors.LOAD_PRESSURE] = sum(share * signals[place] for place, share in self._shares)
        return tuple(signals), saturated
