"""Check for contradictions between a rig file and a recording, made before anything is fitted.

Quantities known from both are compared in size: a ratio that no rig has means a wrong unit, sign or column. The error is found
by trial: each value and signal is read in every other unit of its quantity, with the sign reversed, or exchanged with another.
The reading that best resolves the contradictions is reported. No key is treated specially.
"""

import math
from collections.abc import Iterator, Mapping
from itertools import accumulate, combinations
from typing import Any, NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.loss import rms
from ehls_ros.errors import BadInput
from ehls_ros.physics.plausibility import RANGES, RELATIONS, largest_force, mistaken_for
from ehls_ros.physics.rig import Rig
from ehls_ros.schema import notes
from ehls_ros.trajectory import MEASURED, OF_CHAMBERS, PRESSURE_A, READABLE, Trajectory, has_both_chambers

SIZE_READINGS = 3
"""Most values and signals that are taken to be wrong at once."""

SIZE_BLOCKS = 2000
"""Most blocks that signals are averaged over before they are compared by size."""

SIZE_BLOCK = 0.02
"""Shortest of these blocks [s]."""

SIZE_FEWEST = 50
"""Fewest blocks that determine a factor."""


BALANCED = "inertia, spring and load"
"""Forces that balance the driving force, apart from friction."""


class Ratio(NamedTuple):
    """Ratio of a measured quantity to the value implied by the rig file.

    Attributes:
        what: description of both quantities.
        value: the ratio, negative if the signs differ.
        low, high: bounds for any rig.
        usual: usual value; NaN if there is none.
    """

    what: str
    value: float
    low: float
    high: float
    usual: float = math.nan

    def __str__(self) -> str:
        """Return the ratio as the beginning of a sentence."""
        within = f"at most {self.high:.2g}" if self.low == -math.inf else f"{self.low:.2g} to {self.high:.2g}"
        return f"{self.what} is {self.value:.2g}, where rigs have {within}"

    @property
    def impossible(self) -> bool:
        """Whether no rig has this ratio."""
        return self.value < self.low or self.value > self.high

    @property
    def doubtful(self) -> bool:
        """Whether few rigs have this ratio."""
        return self.value < rules.SIZE_DOUBT * self.low or self.value > self.high / rules.SIZE_DOUBT


class Seen(NamedTuple):
    """A recording reduced to block means and magnitudes.

    Attributes:
        signals: means over blocks, shape (n,) each.
        reach: magnitude that each signal reaches.
        period: of the blocks [s].
    """

    signals: Mapping[str, Array]
    reach: Mapping[str, float]
    period: float

    def times(self, signal: str, factor: float) -> "Seen":
        """Return the recording with a signal multiplied by a factor."""
        signals = {**self.signals, signal: self.signals[signal] * factor}
        return self._replace(signals=signals, reach={**self.reach, signal: self.reach[signal] * abs(factor)})

    def exchanged(self, one: str, other: str) -> "Seen":
        """Return the recording with two columns exchanged."""
        swap = {one: other, other: one}
        return self._replace(
            signals={name: self.signals[swap.get(name, name)] for name in self.signals},
            reach={name: self.reach[swap.get(name, name)] for name in self.reach},
        )


class Reading(NamedTuple):
    """An alternative interpretation of a rig file and a recording.

    Attributes:
        rig: the rig.
        seen: the recording.
        doubted: the value or signal interpreted differently.
        meant: the alternative interpretation.
    """

    rig: Rig
    seen: Seen
    doubted: str
    meant: str


def check_suits(trajectory: Trajectory, rig: Rig, name: str, *, fitted: bool = False) -> tuple[str, ...]:
    """Check that a rig file and a recording can belong to one rig.

    Args:
        trajectory: the recording, any subset of the data contract's signals.
        rig: the rig; its unknown values are not compared.
        name: name of the recording.
        fitted: whether the rig comes from a fit instead of a file; its undetermined values may be anything and are not checked.

    Returns:
        Doubtful ratios, one sentence each.

    Raises:
        BadInput: they contradict each other; the error names the value or signal whose unit, sign or column is probably wrong.
    """
    seen = _seen(trajectory, rig)
    _check_mid_stroke(seen, rig, name)
    _check_chambers(seen, rig, name)
    wrong = [ratio for ratio in _ratios(rig, seen, fitted=fitted) if ratio.impossible]
    if not wrong:
        doubtful = [ratio for ratio in _ratios(rig, seen, fitted=True) if ratio.doubtful]
        doubts = tuple(f"{ratio}: are rig file and recording of one rig, in SI units?" for ratio in doubtful)
        return (*doubts, *_doubtful_zero(seen, rig))
    # A ratio that involves the recording is more informative than a range.
    summary = "; ".join(map(str, wrong[:-3:-1]))
    readings = _resolving(rig, seen)
    if not readings:
        raise BadInput(summary, name, "a rig file and a recording of one rig, both in SI units (see --columns)")
    doubted = "; ".join(reading.doubted for reading in readings)
    raise BadInput(f"{doubted} ({summary})", name, "; ".join(reading.meant for reading in readings))


def _check_mid_stroke(seen: Seen, rig: Rig, name: str) -> None:
    """Reject positions that fit into the stroke but lie outside it: they are counted from another place than mid-stroke."""
    position, (least, most) = seen.signals.get("position_m"), rig.limits.position
    if position is None or not math.isfinite(most - least):
        return
    low, high, room = float(position.min()), float(position.max()), most - least
    if high - low > room or max(least - low, high - most) <= rules.SIZE_OUTSIDE * room:
        return
    counted_from_an_end = low >= 0.0 and high <= room
    offset = float(f"{least if counted_from_an_end else 0.5 * (least + most - low - high):.4g}")
    force = abs(rig.plant.spring_stiffness * offset)
    effect = f"; the spring's force would be {force:.3g} N off" if force > 0.0 else ""
    guess = "if the sensor counts from the end of the stroke" if counted_from_an_end else "if this recording is centred"
    what = (
        f"position_m runs from {1e3 * low:.4g} to {1e3 * high:.4g} mm, limits.position of the rig file from {1e3 * least:.4g}"
        f" to {1e3 * most:.4g} mm: an absolute scale{effect}"
    )
    expected = (
        f"0 at mid-stroke: `offset: {offset:g}` for position_m in the map of columns (--columns) {guess}, else minus the"
        " reading at mid-stroke in m; or limits.position in the scale of the recording, if the spring is relaxed at its 0"
    )
    raise BadInput(what, name, expected)


def _check_chambers(seen: Seen, rig: Rig, name: str) -> None:
    """Reject pressures of both chambers whose force is far from the other forces, and near them if they are exchanged."""
    s = seen.signals
    if not rig.cylinder.law.CHAMBERS or not has_both_chambers(s):
        return
    if "force_n" in s:
        other, of = s["force_n"], "force_n"
    elif "position_m" in s:
        other, of = _balanced(rig, seen, s["position_m"]), BALANCED
    else:
        return
    area_a, area_b = rig.cylinder.parameters.area_a, rig.cylinder.parameters.area_b
    a, b = (s[signal] for signal in OF_CHAMBERS)
    given, exchanged = (rms(area_a * p - area_b * q - other) for p, q in ((a, b), (b, a)))
    if exchanged * rules.SIZE_DOUBT < given:
        what = f"the force of pressure_a_pa and pressure_b_pa is {given:.3g} N off {of}, {exchanged:.3g} N if they are swapped"
        raise BadInput(what, name, "the two columns exchanged (their sensors or lines are swapped), or area_a and area_b")


def _doubtful_zero(seen: Seen, rig: Rig) -> Iterator[str]:
    """Yield a remark on a position at whose middle the spring would exert more than all recorded forces."""
    position, reach = seen.signals.get("position_m"), seen.reach
    if position is None:
        return
    low, high = float(position.min()), float(position.max())
    middle = 0.5 * (low + high)
    spring = rig.plant.spring_stiffness * abs(middle)
    recorded = _largest_driving(rig, seen)
    recorded += reach.get("disturbance_force_n", 0.0)
    # At rest, friction may hold the spring.
    if abs(middle) > high - low and recorded > 0.0 and spring > recorded + rig.friction_level(0.0):
        yield (
            f"position_m runs from {1e3 * low:.4g} to {1e3 * high:.4g} mm, where the spring of the rig file exerts {spring:.3g}"
            f" N, more than the recorded {recorded:.3g} N: is its 0 at mid-stroke? If this recording is centred, `offset:"
            f" {-middle:.4g}` in the map of columns puts it there"
        )


def _resolving(rig: Rig, seen: Seen) -> list[Reading]:
    """Return few alternative readings, chosen greedily, that resolve all contradictions; empty if too many are needed."""
    chosen = list[Reading]()
    while any(ratio.impossible for ratio in _ratios(rig, seen)):
        best = _best_reading(rig, seen) if len(chosen) < SIZE_READINGS else None
        if best is None:
            return []
        chosen.append(best)
        rig, seen = best.rig, best.seen
    return chosen


def _best_reading(rig: Rig, seen: Seen) -> Reading | None:
    """Return the reading with the fewest contradictions, of these the most usual; None if none resolves any."""
    before = list(_ratios(rig, seen))
    wrong, compared = sum(ratio.impossible for ratio in before), len(before)
    rated = list[tuple[int, int, float, int, Reading]]()
    for reading in _readings(rig, seen):
        ratios = list(_ratios(reading.rig, reading.seen))
        left = sum(ratio.impossible for ratio in ratios)
        # A reading in which quantities are no longer correlated explains nothing.
        if left < wrong:
            rated.append((left, max(0, compared - len(ratios)), _unusual(ratios), len(rated), reading))
    return min(rated)[-1] if rated else None


def _unusual(ratios: list[Ratio]) -> float:
    """Return the mean squared deviation of ratios from their usual values, in decades."""
    away = [math.log10(max(abs(r.value), 1e-30) / r.usual) ** 2 for r in ratios if math.isfinite(r.usual)]
    return float(np.mean(away)) if away else 0.0


def _readings(rig: Rig, seen: Seen) -> Iterator[Reading]:
    for section in ("plant", "friction", "limits"):
        values = getattr(rig, section)
        for key, note in notes(type(values)).items():
            value = getattr(values, key)
            for unit, size in mistaken_for(note.unit).items():
                scaled = tuple(size * v for v in value) if isinstance(value, tuple) else size * value
                other = rig._replace(**{section: values._replace(**{key: scaled})})
                doubted = f"{section}.{key} of the rig file is {_with_unit(value, note.unit)}: {unit}?"
                yield Reading(other, seen, doubted, f"{_with_unit(scaled, note.unit)}, if {_with_unit(value, unit)} was meant")
    for signal in seen.signals:
        unit = READABLE[signal].unit
        doubted = f"{signal} reaches {seen.reach[signal]:.3g} {unit}"
        for other_unit, size in mistaken_for(unit).items():
            reached = seen.reach[signal]
            meant = f"{reached * size:.3g} {unit}, if its column is in {other_unit} (see --columns)"
            yield Reading(rig, seen.times(signal, size), f"{doubted}: {other_unit}?", meant)
            meant = f"{reached / size:.3g} {unit}, if its column is not in {other_unit} but in {unit} already"
            yield Reading(rig, seen.times(signal, 1.0 / size), f"{doubted}: {unit} already?", meant)
        meant = f"its column with the other sign (scale: -1, see --columns): positive {signal} has to act towards +x"
        yield Reading(rig, seen.times(signal, -1.0), f"{signal} goes the wrong way", meant)
    for first, second in combinations(seen.signals, 2):
        turned = seen.times(first, -1.0).times(second, -1.0)
        yield Reading(rig, turned, f"{first} and {second} go the wrong way", "both columns with the other sign (scale: -1)")
        yield Reading(rig, seen.exchanged(first, second), f"{first} and {second} do not fit", "the two columns exchanged")


def _with_unit(value: Any, unit: str) -> str:
    return f"[{', '.join(f'{v:g}' for v in value)}] {unit}" if isinstance(value, tuple) else f"{value:g} {unit}"


# --- ratios ------------------------------------------------------------------------------------


def _ratios(rig: Rig, seen: Seen, *, fitted: bool = False) -> Iterator[Ratio]:
    """Yield every known ratio: those of the rig file alone, unless it is fitted, then those of recording to rig file."""
    long = all(len(values) >= SIZE_FEWEST for values in seen.signals.values())
    with np.errstate(all="ignore"):
        for ratio in (
            *(() if fitted else _of_rig(rig)),
            *_of_sizes(rig, seen),
            *(_of_slopes(rig, seen) if long else ()),
            *(_of_forces(rig, seen) if long else ()),
        ):
            if math.isfinite(ratio.value):
                yield ratio


def _of_rig(rig: Rig) -> Iterator[Ratio]:
    """Yield the ratios of the rig file alone."""
    for (section, key), (low, high) in RANGES.items():
        value = getattr(getattr(rig, section), key, math.nan)
        yield Ratio(f"{section}.{key}", value, low, high)
    for relation in RELATIONS:
        yield Ratio(relation.what, relation.value(rig), relation.low, relation.high)


def _of_sizes(rig: Rig, seen: Seen) -> Iterator[Ratio]:
    plant, limits, reach = rig.plant, rig.limits, seen.reach
    room = limits.position[1] - limits.position[0]
    inf = math.inf
    for signal, known, what, low, high, usual in (
        ("load_pressure_pa", plant.supply_pressure, "supply_pressure", -inf, 3.0, 0.3),
        *((s, plant.supply_pressure, "supply_pressure", -inf, 3.0, 0.5) for s in OF_CHAMBERS),
        ("supply_pressure_pa", plant.supply_pressure, "supply_pressure", 0.1, 10.0, 1.0),
        ("force_n", largest_force(rig), "supply_pressure times piston_area", -inf, rules.SIZE_FACTOR, 0.3),
        ("velocity_m_s", limits.velocity, "limits.velocity", -inf, rules.SIZE_FACTOR, 0.1),
        ("spool_m", limits.spool * max(1.0, plant.valve_gain), "limits.spool", -inf, rules.SIZE_FACTOR, 0.3),
        ("valve_command_m", limits.spool, "limits.spool", -inf, rules.SIZE_FACTOR, 0.3),
    ):
        if reach.get(signal, 0.0) > 0.0:
            unit = READABLE[signal].unit
            description = f"the recorded {signal}, which reaches {reach[signal]:.3g} {unit}, over {what}"
            yield Ratio(description, reach[signal] / known, low, high, usual)
    if "position_m" in seen.signals and (travel := float(np.ptp(seen.signals["position_m"]))) > 0.0:
        yield Ratio(f"the recorded travel of {travel:.3g} m over limits.position", travel / room, -inf, 5.0, 0.3)


def _of_slopes(rig: Rig, seen: Seen) -> Iterator[Ratio]:
    """Yield the slopes between two measurements of one quantity, one of them converted by the rig file."""
    s, plant = seen.signals, rig.plant
    command, spool = s.get("valve_command_m"), s.get("spool_m")
    force, position, velocity = (s.get(k) for k in ("force_n", "position_m", "velocity_m_s"))
    pressure, source = _load_pressure(rig, seen)
    if pressure is not None and force is not None:
        yield from _slope(f"force_n over {source}", force, plant.piston_area * pressure)
    if rig.cylinder.law.CHAMBERS and pressure is not None and position is not None and "disturbance_force_n" in s:
        # Friction is in the driving force besides.
        within = rules.SIZE_DOUBT * rules.SIZE_FACTOR
        balanced = _balanced(rig, seen, position)
        yield from _slope(f"{source} over {BALANCED}", plant.piston_area * pressure, balanced, within)
    rate = None if position is None else np.gradient(position, seen.period)
    if rate is not None and velocity is not None:
        yield from _slope("velocity_m_s over the rate of position_m", velocity, rate)
    if command is not None:
        lag = math.exp(-plant.valve_bandwidth * seen.period)
        filtered = plant.valve_gain * _lagged(command, lag)
        if spool is not None:
            yield from _slope("spool_m over valve_gain times valve_command_m", spool, filtered)
        spool = filtered if spool is None else spool
    moves = rate if velocity is None else velocity
    if rig.cylinder.law.CHAMBERS:
        yield from _flow_of_chamber(rig, s, spool, moves)
    elif spool is not None and pressure is not None and moves is not None:
        drop = np.maximum(plant.supply_pressure - np.sign(spool) * pressure, 0.0)
        flow = plant.discharge_coefficient * plant.valve_area_gradient * spool * np.sqrt(drop / plant.oil_density)
        stored = plant.total_volume / (4.0 * plant.bulk_modulus) * np.gradient(pressure, seen.period)
        used = plant.piston_area * moves + stored + plant.leakage_coefficient * pressure
        # The flow depends on more coefficients, and on the compressed oil.
        within = rules.SIZE_DOUBT * rules.SIZE_FACTOR
        yield from _slope("the flow that moves the piston over the valve's by the orifice law", used, flow, within)


def _balanced(rig: Rig, seen: Seen, position: Array) -> Array:
    """Return the force of inertia, spring and, where recorded, the load, shape (n,) [N]."""
    inertia = rig.plant.moving_mass * np.gradient(np.gradient(position, seen.period), seen.period)
    return inertia + rig.plant.spring_stiffness * position + seen.signals.get("disturbance_force_n", 0.0)


def _load_pressure(rig: Rig, seen: Seen) -> tuple[Array | None, str]:
    """Return the load pressure, from those of both chambers if they are there, and the description of its force."""
    if not has_both_chambers(seen.signals):
        return seen.signals.get("load_pressure_pa"), "piston_area times load_pressure_pa"
    p, (a, b) = rig.cylinder.parameters, (seen.signals[signal] for signal in OF_CHAMBERS)
    return (p.area_a * a - p.area_b * b) / rig.plant.piston_area, "area_a times pressure_a_pa less area_b times pressure_b_pa"


def _largest_driving(rig: Rig, seen: Seen) -> float:
    """Return the largest driving force of the recording [N]; 0 if it was not recorded."""
    pressure = seen.reach.get("load_pressure_pa", 0.0)
    if (derived := _load_pressure(rig, seen)[0]) is not None and not pressure:
        pressure = float(np.nanquantile(np.abs(derived), rules.RARE_QUANTILE))
    return max(seen.reach.get("force_n", 0.0), rig.plant.piston_area * pressure)


def _flow_of_chamber(rig: Rig, s: Mapping[str, Array], spool: Array | None, moves: Array | None) -> Iterator[Ratio]:
    """Yield the ratio of the flow that moves the piston to that through the edges of chamber A."""
    pressure = s.get(PRESSURE_A)
    if spool is None or moves is None or pressure is None:
        return
    plant, p, valve = rig.plant, rig.cylinder.parameters, rig.valve.parameters
    drop = np.where(spool > 0.0, plant.supply_pressure - pressure, pressure - p.tank_pressure)
    gain = np.where(spool > 0.0, valve.gain_pa, valve.gain_at) * np.sqrt(2.0 * np.maximum(drop, 0.0) / plant.oil_density)
    flow = plant.discharge_coefficient * plant.valve_area_gradient * gain * spool
    within = rules.SIZE_DOUBT * rules.SIZE_FACTOR
    yield from _slope("area_a times the velocity over the flow of the edges of A", p.area_a * moves, flow, within)


def _lagged(values: Array, kept: float) -> Array:
    """Return values behind a first-order lag with a given pole; scipy's filters take half a second to import."""
    states = accumulate(values.tolist(), lambda state, value: kept * state + (1.0 - kept) * value, initial=0.0)
    return np.array(list(states)[1:])


def _slope(what: str, measured: Array, modelled: Array, within: float = rules.SIZE_FACTOR) -> Iterator[Ratio]:
    """Yield the slope of a measurement over a model if they are correlated."""
    good = np.isfinite(measured) & np.isfinite(modelled)
    if not np.any(good):
        return
    y, x = (values[good] - np.mean(values[good]) for values in (measured, modelled))
    product, of_x, of_y = float(x @ y), float(x @ x), float(y @ y)
    if of_x > 0.0 and of_y > 0.0 and abs(product) > rules.SIZE_RELATED * math.sqrt(of_x * of_y):
        yield Ratio(what, product / of_x, 1.0 / within, within, 1.0)


def _of_forces(rig: Rig, seen: Seen) -> Iterator[Ratio]:
    """Yield each term of the force balance relative to the recorded forces."""
    plant, reach, position = rig.plant, seen.reach, seen.signals.get("position_m")
    driving = _largest_driving(rig, seen)
    if position is None or not driving > 0.0:
        return
    available = driving + reach.get("disturbance_force_n", 0.0)
    rate = np.gradient(position, seen.period)
    travel, fastest = float(np.ptp(position)), float(np.nanquantile(np.abs(rate), rules.RARE_QUANTILE))
    acceleration = float(np.nanquantile(np.abs(np.gradient(rate, seen.period)), rules.RARE_QUANTILE))
    viscous = plant.viscous_damping + rig.friction.viscous_coefficient
    terms = {
        "moving_mass times the recorded acceleration": plant.moving_mass * acceleration,
        "spring_stiffness times the recorded travel": plant.spring_stiffness * 0.5 * travel,
        "viscous friction at the recorded velocity": viscous * fastest,
    }
    if travel > rules.SIZE_FACTOR * rig.friction_law.break_away(rig.friction):
        terms["the friction of sliding"] = rig.friction_level(math.inf)
    for what, term in terms.items():
        yield Ratio(f"{what} over the recorded forces", term / available, -math.inf, rules.SIZE_FACTOR)


def _seen(trajectory: Trajectory, rig: Rig) -> Seen:
    if len(trajectory) < 2 or not np.all(np.diff(trajectory.time_s) > 0.0):
        return Seen({}, {}, SIZE_BLOCK)  # reported when the recording is prepared
    time = trajectory.time_s - trajectory.time_s[0]
    names = [s for s in MEASURED if s in trajectory and s != "oil_temperature_k"]
    if rig.cylinder.law.CHAMBERS:
        chambers = [s for s in OF_CHAMBERS if s in trajectory]
        # From both, the load pressure follows.
        names = [s for s in names if s != "load_pressure_pa" or len(chambers) < len(OF_CHAMBERS)] + chambers
    signals = {s: np.asarray(trajectory[s], dtype=np.float64) for s in names}
    signals = {s: values for s, values in signals.items() if np.any(np.isfinite(values)) and np.nanmax(np.abs(values)) > 0.0}
    period = max(SIZE_BLOCK, float(time[-1]) / SIZE_BLOCKS, float(np.median(np.diff(time))))
    index = (time / period).astype(np.intp)
    return Seen(
        signals={s: _means(values, index) for s, values in signals.items()},
        reach={
            s: float(np.nanquantile(np.abs(values[np.isfinite(values)]), rules.RARE_QUANTILE)) for s, values in signals.items()
        },
        period=period,
    )


def _means(values: Array, index: Any) -> Array:
    """Return the block means; a block without a finite sample is interpolated from its neighbours."""
    good = np.isfinite(values)
    count = np.bincount(index[good], minlength=int(index[-1]) + 1)
    total = np.bincount(index[good], weights=values[good], minlength=int(index[-1]) + 1)
    full = np.flatnonzero(count)
    return np.interp(np.arange(len(count)), full, total[full] / count[full])
