"""One experiment as arrays: the common form of simulations, bags and CSV files, and the input of all analyses."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray


class Signal(NamedTuple):
    """Label and unit of a signal."""

    label: str
    unit: str


MEASURED: dict[str, Signal] = {
    "valve_command_m": Signal("valve command u", "m"),
    "spool_m": Signal("spool displacement xv", "m"),
    "load_pressure_pa": Signal("load pressure pL", "Pa"),
    "supply_pressure_pa": Signal("supply pressure ps", "Pa"),
    "position_m": Signal("piston position x", "m"),
    "velocity_m_s": Signal("piston velocity", "m/s"),
    "force_n": Signal("driving force Ac·pL", "N"),
    "disturbance_force_n": Signal("disturbance force fd", "N"),
    "oil_temperature_k": Signal("oil temperature", "K"),
}
"""Measured signals of the data contract; a value is finite or missing."""

SIGNALS: dict[str, Signal] = {
    **MEASURED,
    # known to the experiment
    "disturbance_force_rate_n_s": Signal("rate of the disturbance force", "N/s"),
    "disturbance_displacement_m": Signal("displacement of the position servo", "m"),
    "disturbance_velocity_m_s": Signal("velocity of the position servo", "m/s"),
    "force_reference_n": Signal("force reference", "N"),
    "force_reference_rate_n_s": Signal("rate of the force reference", "N/s"),
    "force_reference_acceleration_n_s2": Signal("second derivative of the force reference", "N/s²"),
    "position_reference_m": Signal("position reference", "m"),
    "position_reference_rate_m_s": Signal("rate of the position reference", "m/s"),
    "position_reference_acceleration_m_s2": Signal("second derivative of the position reference", "m/s²"),
    # estimated
    "friction_gms_n": Signal("force of the friction elements", "N"),
    "friction_viscous_n": Signal("viscous friction", "N"),
    "friction_elements_n": Signal("force of each friction element", "N"),
    "friction_slipping": Signal("friction element slips", "1"),
    # inside the controller
    "e3_mpa": Signal("load pressure error e3", "MPa"),
    "s_mpa_s": Signal("sliding variable s", "MPa/s"),
    "alpha": Signal("scale of the identified friction α̂", "1"),
    "beta": Signal("scale of the viscous friction β̂", "1"),
    "delta_n": Signal("remaining disturbance D̂", "N"),
    "u1": Signal("adaptive term u1", "t·MPa/s²"),
    "u2": Signal("model term u2", "t·MPa/s²"),
    "u3": Signal("robust term u3", "t·MPa/s²"),
    "force_error_n": Signal("force error", "N"),
    "force_bound_n": Signal("bound (44) of the force error", "N"),
    "saturated": Signal("valve command at its limit", "1"),
    "friction_fallback": Signal("static friction used instead", "1"),
    # timing of the loop
    "response_s": Signal("snapshot to command", "s"),
}
"""Every signal a trajectory can hold. Column names of CSV files are these names."""


@dataclass(frozen=True)
class Trajectory:
    """Signals over a common time base.

    Attributes:
        time_s: sample times, shape (n,), strictly increasing [s].
        signals: arrays by the names in :data:`SIGNALS`, shape (n,), or (n, elements) for the friction elements; NaN
            where a cycle has no sample.
        metadata: configuration of the run: rig, spec, versions, seed.
    """

    time_s: NDArray[np.float64]
    signals: Mapping[str, NDArray[np.float64]]
    metadata: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check names and lengths of the signals.

        Raises:
            ValueError: a signal has an unknown name, or its length differs from that of the time base.
        """
        for name, values in self.signals.items():
            if name not in SIGNALS:
                raise ValueError(f"signal '{name}' is unknown; expected one of {', '.join(SIGNALS)}")
            if len(values) != len(self.time_s):
                raise ValueError(f"signal '{name}' has {len(values)} samples; expected {len(self.time_s)} as time_s")

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.time_s)

    def __contains__(self, name: str) -> bool:
        """Return whether a signal was recorded."""
        return name in self.signals

    def __getitem__(self, name: str) -> NDArray[np.float64]:
        """Return one signal.

        Raises:
            KeyError: the signal was not recorded.
        """
        return self.signals[name]


def steady_error(run: Trajectory, signal: str, reference: str) -> NDArray[np.float64]:
    """Return the tracking error over the second half of a run, its steady part.

    Args:
        run: the run.
        signal: name of the controlled signal.
        reference: name of its reference.

    Returns:
        Absolute errors where both are finite, shape (m,); empty if they never are or were not recorded.
    """
    if signal not in run or reference not in run or not len(run):
        return np.empty(0)
    time = run.time_s
    late = time >= time[0] + 0.5 * (time[-1] - time[0])
    with np.errstate(invalid="ignore"):
        error = np.abs(run[signal] - run[reference])[late]
    known: NDArray[np.float64] = error[np.isfinite(error)]
    return known
