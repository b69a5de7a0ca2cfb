"""One experiment as arrays: the common form of simulations, bags and CSV files, and the input of all analyses."""

import math
from collections.abc import Container, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ehls_ros.errors import BadInput


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
    # measured beside these where the cylinder has two chambers
    "pressure_a_pa": Signal("pressure in chamber A, which pushes towards +x", "Pa"),
    "pressure_b_pa": Signal("pressure in chamber B, which pushes towards -x", "Pa"),
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
    "actuator_force_reference_n": Signal("force reference of the actuator under test", "N"),
    "actuator_force_reference_rate_n_s": Signal("rate of the force reference of the actuator under test", "N/s"),
    "actuator_force_reference_acceleration_n_s2": Signal("second derivative of that reference", "N/s²"),
    "actuator_position_reference_m": Signal("position reference of the actuator under test", "m"),
    "actuator_position_reference_rate_m_s": Signal("rate of the position reference of the actuator under test", "m/s"),
    "actuator_position_reference_acceleration_m_s2": Signal("second derivative of that reference", "m/s²"),
    "programme_block": Signal("running block of the test programme, in the order of its file", "1"),
    "programme_repetition": Signal("load cycles completed in the pass of the block", "1"),
    "programme_load_cycles": Signal("load cycles completed in the programme", "1"),
    "programme_phase": Signal("phase within the load cycle", "1"),
    "programme_state": Signal("state of the test programme", "1"),
    # estimated
    "friction_gms_n": Signal("force of the friction elements", "N"),
    "friction_viscous_n": Signal("viscous friction", "N"),
    "friction_elements_n": Signal("force of each friction element", "N"),
    "friction_slipping": Signal("friction element slips", "1"),
    # inside the controller
    "e3_pa": Signal("load pressure error e3", "Pa"),
    "s_pa_s": Signal("sliding variable s", "Pa/s"),
    "alpha": Signal("scale of the identified friction α̂", "1"),
    "beta": Signal("scale of the viscous friction β̂", "1"),
    "delta_n": Signal("remaining disturbance D̂", "N"),
    "u1_kg_pa_s2": Signal("adaptive term u1", "kg·Pa/s²"),
    "u2_kg_pa_s2": Signal("model term u2", "kg·Pa/s²"),
    "u3_kg_pa_s2": Signal("robust term u3", "kg·Pa/s²"),
    "force_error_n": Signal("force error", "N"),
    "force_bound_n": Signal("bound (44) of the force error", "N"),
    "saturated": Signal("valve command at its limit", "1"),
    "at_bound": Signal("estimate of the controller at its bound", "1"),
    "friction_fallback": Signal("static friction used instead", "1"),
    # timing of the loop
    "response_s": Signal("snapshot to command", "s"),
}
"""All signals defined in the software."""


AS_RIGS_GIVE: dict[str, Signal] = {
    "tank_pressure_pa": Signal("tank pressure", "Pa"),
    "load_cell_n": Signal("load cell between piston and load, positive against the piston", "N"),
    "angle_rad": Signal("angle of a rotary actuator", "rad"),
    "angular_velocity_rad_s": Signal("angular velocity of a rotary actuator", "rad/s"),
    "torque_n_m": Signal("driving torque of a rotary actuator", "N m"),
    "load_torque_n_m": Signal("torque of the load, positive against the actuator", "N m"),
}
"""Alternative measurements of other rigs; converted into signals of :data:`MEASURED` on reading, and in no bag."""

PRESSURE_A, PRESSURE_B = OF_CHAMBERS = "pressure_a_pa", "pressure_b_pa"
"""Pressures of both chambers, of which a rig file with one pressure uses the load pressure only."""

READABLE: dict[str, Signal] = {**SIGNALS, **AS_RIGS_GIVE}
"""All signals that a table can contain; the names are its column names."""


EQUAL_AREAS_ASSUMED = "both chambers are taken to have equal areas (no cylinder: in the map)"
"""Remark on a load pressure from those of both chambers; void with a rig file that has their areas."""

SAME_AREA = 1e-3
"""Relative difference below which two areas are considered equal."""


def has_both_chambers(signals: Container[str]) -> bool:
    """Return whether both pressures of a cylinder with two chambers are among the signals."""
    return all(signal in signals for signal in OF_CHAMBERS)


class Own(NamedTuple):
    """Sampling of a signal before it was resampled to a faster clock.

    Attributes:
        period: sampling period [s].
        noise: standard deviation of the white noise of its samples, in the signal's unit.
    """

    period: float
    noise: float


class Preparation(NamedTuple):
    """Processing of a recording's signals on reading.

    Attributes:
        remarks: one sentence each.
        interpolated: the sampling of the signals that are slower than the time base.
        measured: commanded signals that were measured by a sensor instead.
        not_judged: stages of a model that cannot be judged from these data, with the reason.
        equivalent_area: piston area to which load pressure and force refer [m^2]; None for any.
    """

    remarks: tuple[str, ...] = ()
    interpolated: Mapping[str, Own] = {}
    measured: tuple[str, ...] = ()
    not_judged: Mapping[str, str] = {}
    equivalent_area: float | None = None

    def adding(self, *remarks: str) -> "Preparation":
        """Return a copy with further remarks."""
        return self._replace(remarks=(*self.remarks, *remarks))

    def check_area(self, area: float, name: str) -> None:
        """Reject a rig whose piston area differs from that of the load pressure.

        Args:
            area: piston area of the rig [m^2].
            name: name of the recording, for the error.

        Raises:
            BadInput: the areas differ by more than the rounding of a data sheet's four digits.
        """
        meant = self.equivalent_area
        if meant is not None and abs(area - meant) > SAME_AREA * meant:
            what = f"its chambers have a mean area of {meant:.6g} m², piston_area of the rig is {area:.6g} m²"
            raise BadInput(what, name, f"piston_area: {meant:.6g} in the rig file, or other areas in the map of columns")


AS_READ = Preparation()
"""No processing."""


@dataclass(frozen=True)
class Trajectory:
    """Signals over a common time base.

    Attributes:
        time_s: sample times, shape (n,), strictly increasing [s].
        signals: arrays by the names in :data:`READABLE`, shape (n,), or (n, elements) for the friction elements; NaN
            where a cycle has no sample.
        metadata: configuration of the run: rig, spec, versions, seed.
        preparation: processing of the signals on reading.
    """

    time_s: NDArray[np.float64]
    signals: Mapping[str, NDArray[np.float64]]
    metadata: Mapping[str, Any] = field(default_factory=dict)
    preparation: Preparation = AS_READ

    def __post_init__(self) -> None:
        """Check names and lengths of the signals.

        Raises:
            ValueError: a signal has an unknown name, or its length differs from that of the time base.
        """
        for name, values in self.signals.items():
            if name not in READABLE:
                raise ValueError(f"signal '{name}' is unknown; expected one of {', '.join(READABLE)}")
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

    def between(self, begin: float, end: float, name: str) -> "Trajectory":
        """Return a part of the recording.

        Args:
            begin: start of the part, since the start of the recording [s].
            end: its end [s].
            name: name of the recording, for the error.

        Raises:
            BadInput: fewer than two samples lie between.
        """
        if begin <= 0.0 and end == math.inf:
            return self
        since = self.time_s - self.time_s[0]
        kept = (since >= begin) & (since <= end)
        if not kept.sum() > 1:
            what = f"no two samples lie from {begin:g} to {end:g} s"
            raise BadInput(what, name, f"--from and --to within 0 to {since[-1]:.6g} s, since the start of the recording")
        return replace(self, time_s=self.time_s[kept], signals={key: values[kept] for key, values in self.signals.items()})


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
