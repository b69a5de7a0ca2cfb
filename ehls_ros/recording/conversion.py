"""Conversion of measurements to the data contract: chamber pressures, load cell, angle and torque, raw counts."""

import math
from collections.abc import Callable, Collection, Mapping
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from ehls_ros.errors import BadInput
from ehls_ros.recording.columns import FITTED, ColumnMap, Cylinder
from ehls_ros.samples import filled
from ehls_ros.trajectory import EQUAL_AREAS_ASSUMED, READABLE, Own, Preparation, Trajectory

Signal = NDArray[np.float64]

EQUAL_AREAS = 0.01
"""Relative area difference up to which the flow of a symmetric cylinder holds; as small as the error of a coefficient."""

MIN_CORRELATION = 0.98
"""Minimum correlation of a fitted signal with the one that determines its scale; below it the two measure different
quantities."""

MIN_SAMPLES = 100
"""Minimum number of samples to determine a scale."""

MAX_INTERVALS, MIN_IN_INTERVAL, MIN_INTERVALS = 200, 5, 10
"""Intervals over which both signals are compared, for independent errors: maximum number, minimum samples in one, minimum
number."""

ZERO_CHANGE = 1e-9
"""Change of a signal, relative to its size, that is taken as zero."""

TURNED: Mapping[str, tuple[str, int]] = {
    "angle_rad": ("position_m", 1),
    "angular_velocity_rad_s": ("velocity_m_s", 1),
    "torque_n_m": ("force_n", -1),
    "load_torque_n_m": ("disturbance_force_n", -1),
}
"""Linear signal equivalent to a rotary one, and the exponent of the lever arm in the conversion."""

FLOW_OF_UNEQUAL_AREAS = (
    "the volume balance is that of a symmetric cylinder; with unequal areas the valve's pressure drop differs by direction"
)
"""Reason why the flow is not judged."""


def given_by(signals: Collection[str]) -> set[str]:
    """Return the names of the signals available after conversion."""
    out = {*signals, *(linear for rotary, (linear, _) in TURNED.items() if rotary in signals)}
    if {"pressure_a_pa", "pressure_b_pa"} <= out:
        out.add("load_pressure_pa")
    if "load_cell_n" in out:
        out.add("disturbance_force_n")
    return out


class _State(NamedTuple):
    signals: dict[str, Signal]
    preparation: Preparation


def converted(trajectory: Trajectory, given: ColumnMap, where: str) -> Trajectory:
    """Add the signals derived from a rig's measurements.

    Args:
        trajectory: trajectory as read.
        given: the user's map, with areas and lever arm.
        where: the recording, for errors.

    Returns:
        The trajectory with the measured and the derived signals, and remarks on the derivations.

    Raises:
        BadInput: an area or lever arm is missing, a signal is given twice, or a scale cannot be fitted.
    """
    state = _State(dict(trajectory.signals), trajectory.preparation)
    # Counts of a rotary sensor are fitted before their conversion to a position, all others after that of the chamber
    # pressures.
    rotary = [name for name, column in given.columns.items() if column.fit_to and name in TURNED]
    others = [name for name, column in given.columns.items() if column.fit_to and name not in TURNED]
    for name in rotary:
        state = _fitted(state, name, trajectory.time_s, given, where)
    for step in _STEPS:
        state = step(state, given, where)
    for name in others:
        state = _fitted(state, name, trajectory.time_s, given, where)
    return Trajectory(trajectory.time_s, state.signals, trajectory.metadata, state.preparation)


def _added(state: _State, name: str, terms: Mapping[str, float], where: str, remark: str) -> _State:
    """Add a signal that is a weighted sum of others; their noise adds in squares."""
    if name in state.signals:
        what = f"{name} is given, and follows from {' and '.join(terms)} as well"
        raise BadInput(what, where, "one of the two; leave the other out")
    values = sum((factor * state.signals[source] for source, factor in terms.items()), start=np.zeros(1))
    return _State({**state.signals, name: values}, _preparation(state.preparation, name, terms).adding(remark))


def _preparation(preparation: Preparation, name: str, terms: Mapping[str, float]) -> Preparation:
    own = {source: preparation.interpolated[source] for source in terms if source in preparation.interpolated}
    if not own:
        return preparation
    noise = math.hypot(*(terms[source] * o.noise for source, o in own.items()))
    sampled = Own(max(o.period for o in own.values()), noise)
    return preparation._replace(interpolated={**preparation.interpolated, name: sampled})


def _measured(state: _State, name: str) -> _State:
    return state._replace(preparation=state.preparation._replace(measured=(*state.preparation.measured, name)))


def _linear(state: _State, given: ColumnMap, where: str) -> _State:
    """Convert angles and torques to positions and forces at the lever arm."""
    for rotary, (linear, power) in TURNED.items():
        if rotary not in state.signals:
            continue
        if given.rotary is None:
            raise BadInput(f"{rotary} is given without an arm", where, "rotary: {radius: ...} in the map of columns, in m")
        arm = given.rotary.radius
        remark = f"{linear} is {rotary} {'times' if power > 0 else 'divided by'} the arm of {arm:g} m"
        state = _added(state, linear, {rotary: arm**power}, where, remark)
        if linear == "disturbance_force_n":
            state = _measured(state, linear)
    return state


def _chambers(state: _State, given: ColumnMap, where: str) -> _State:
    """Convert the pressures of both chambers to the load pressure of a symmetric cylinder with the same force."""
    a, b = "pressure_a_pa", "pressure_b_pa"
    present = [name for name in (a, b) if name in state.signals]
    if not present:
        return state
    if len(present) > 1 and given.cylinder is None and "load_pressure_pa" in state.signals:
        # A simulated single rod has the load pressure beside those of its chambers.
        load, difference = state.signals["load_pressure_pa"], state.signals[a] - state.signals[b]
        if np.nanmax(np.abs(load - difference)) <= EQUAL_AREAS * np.nanmax(np.abs(load)):
            return state
        return state._replace(preparation=_flow_not_judged(state.preparation))
    if len(present) == 1:
        if given.cylinder is None:
            # A single chamber is read and shown; the opposing pressure is unknown.
            return state._replace(preparation=state.preparation.adding(f"{present[0]} alone gives no load pressure"))
        raise BadInput(f"{present[0]} is there without the other chamber's pressure", where, f"both {a} and {b}")
    areas = given.cylinder or Cylinder(1.0, 1.0)
    mean = areas.mean
    terms = {a: areas.area_a / mean, b: -areas.area_b / mean}
    if given.cylinder is None:
        return _added(state, "load_pressure_pa", terms, where, EQUAL_AREAS_ASSUMED)
    remark = (
        f"load_pressure_pa is the force of both chambers over their mean area of {mean:.6g} m²,"
        " which has to be piston_area in the rig file"
    )
    state = _added(state, "load_pressure_pa", terms, where, remark)
    preparation = state.preparation._replace(equivalent_area=mean)
    if abs(areas.area_a - areas.area_b) > EQUAL_AREAS * mean:
        preparation = _flow_not_judged(preparation)
    return state._replace(preparation=preparation)


def _flow_not_judged(preparation: Preparation) -> Preparation:
    return preparation._replace(not_judged={**preparation.not_judged, "flow": FLOW_OF_UNEQUAL_AREAS})


def _supply(state: _State, given: ColumnMap, where: str) -> _State:
    """Refer the supply pressure to the tank pressure, as in the flow equation of the valve."""
    tank, supply = "tank_pressure_pa", "supply_pressure_pa"
    if tank not in state.signals or supply not in state.signals:
        return state
    rest = {name: values for name, values in state.signals.items() if name != supply}
    with_source = _State({**rest, "supply": state.signals[supply]}, _preparation(state.preparation, "supply", {supply: 1.0}))
    terms = {"supply": 1.0, tank: -1.0}
    out = _added(with_source, supply, terms, where, "supply_pressure_pa is the supply pressure above the tank pressure")
    kept = {name: own for name, own in out.preparation.interpolated.items() if name != "supply"}
    signals = {name: values for name, values in out.signals.items() if name != "supply"}
    return _State(signals, out.preparation._replace(interpolated=kept))


def _cell(state: _State, given: ColumnMap, where: str) -> _State:
    """Use a load cell between piston and load as the external force."""
    if "load_cell_n" not in state.signals:
        return state
    remark = (
        "disturbance_force_n is the reading of the load cell between piston and load; the moving mass is that before the cell"
    )
    return _measured(_added(state, "disturbance_force_n", {"load_cell_n": 1.0}, where, remark), "disturbance_force_n")


_STEPS: tuple[Callable[[_State, ColumnMap, str], _State], ...] = (_linear, _chambers, _supply, _cell)


# --- raw counts --------------------------------------------------------------------------------


class Scale(NamedTuple):
    """Linear calibration from raw counts to a signal, with standard error.

    Attributes:
        factor: signal per count.
        error: its standard error.
        offset: signal at zero counts; None if the second signal does not determine it.
        correlation: correlation of the line with the data.
    """

    factor: float
    error: float
    offset: float | None
    correlation: float


def fitted_scale(counts: Signal, other: Signal, time: Signal, kind: str) -> Scale | None:
    """Fit the scale of raw counts to a second signal.

    Args:
        counts: the raw signal, shape (n,).
        other: the second signal, shape (n,).
        time: sample times, shape (n,) [s].
        kind: ``same`` quantity, ``integral`` if the counts are the other's integral, ``derivative`` if they are its derivative.

    Returns:
        The scale; None if fewer than :data:`MIN_SAMPLES` samples have both, or one does not vary.
    """
    both = np.isfinite(counts) & np.isfinite(other)
    if np.count_nonzero(both) < MIN_SAMPLES:
        return None
    edges = np.unique(np.linspace(0, len(time) - 1, min(MAX_INTERVALS, len(time) // MIN_IN_INTERVAL) + 1).astype(np.intp))
    whole = np.add.reduceat(~both, edges[:-1]) == 0
    lasts = np.diff(time[edges])
    # Per interval: the change of one signal and the integral of the other.
    change = {"same": _integral, "integral": _change, "derivative": _integral}[kind](counts, time, edges)
    wanted = {"same": _integral, "integral": _integral, "derivative": _change}[kind](other, time, edges)
    rate, target = (change / lasts)[whole], (wanted / lasts)[whole]
    spread = rate - np.mean(rate) if rate.size else rate
    size = float(spread @ spread)
    if rate.size < MIN_INTERVALS or np.ptp(rate) <= ZERO_CHANGE * np.max(np.abs(rate)) or np.ptp(target) == 0.0:
        return None
    factor = float(spread @ target) / size
    offset = float(np.mean(target) - factor * np.mean(rate))
    residual = target - factor * rate - offset
    error = math.sqrt(float(residual @ residual) / (rate.size - 2) / size)
    correlation = abs(float(np.corrcoef(rate, target)[0, 1]))
    # The rate of a position does not contain its zero.
    return Scale(factor, error, None if kind == "integral" else offset, correlation)


def _integral(values: Signal, time: Signal, edges: NDArray[np.intp]) -> Signal:
    out: Signal = np.diff(np.concatenate([[0.0], scipy.integrate.cumulative_trapezoid(filled(values), time)])[edges])
    return out


def _change(values: Signal, time: Signal, edges: NDArray[np.intp]) -> Signal:
    out: Signal = np.diff(filled(values)[edges])
    return out


_KINDS: Mapping[str, str] = {
    "position_m": "integral",
    "angle_rad": "integral",
    "velocity_m_s": "derivative",
    "angular_velocity_rad_s": "derivative",
    "force_n": "same",
    "load_pressure_pa": "same",
}


def _fitted(state: _State, name: str, time: Signal, given: ColumnMap, where: str) -> _State:
    other = FITTED[name]
    if name not in state.signals or other not in state.signals:
        raise BadInput(f"{name} is to be fitted to {other}, which is not there", where, f"{other} in its unit")
    target = state.signals[other]
    if {name, other} == {"force_n", "load_pressure_pa"}:
        if given.cylinder is None:
            raise BadInput(
                f"{name} is to be fitted to {other} without an area", where, "cylinder: {area_a: ..., area_b: ...} in m²"
            )
        target = target * given.cylinder.mean ** (1 if name == "force_n" else -1)
    scale = fitted_scale(state.signals[name], target, time, _KINDS[name])
    if scale is None:
        raise BadInput(
            f"{name} cannot be fitted to {other}: one of them is too short or does not change", where, "data that move"
        )
    if scale.correlation < MIN_CORRELATION:
        what = f"{name} follows {other} with a correlation of {scale.correlation:.3f} only: its scale is not fixed by it"
        raise BadInput(
            what, where, f"{MIN_CORRELATION} or more, or the scale of {given.columns[name].name} from its data sheet"
        )
    values = scale.factor * state.signals[name] + (scale.offset or 0.0)
    unit = READABLE[name].unit
    zero = "its zero stays that of the counts" if scale.offset is None else f"zero at {scale.offset:.4g} {unit}"
    remark = f"{name}: {scale.factor:.6g} ± {scale.error:.2g} {unit} per count, fitted to {other}; {zero}"
    preparation = state.preparation.adding(remark)
    if name in preparation.interpolated:
        own = preparation.interpolated[name]
        scaled = own._replace(noise=abs(scale.factor) * own.noise)
        preparation = preparation._replace(interpolated={**preparation.interpolated, name: scaled})
    return _State({**state.signals, name: values}, preparation)
