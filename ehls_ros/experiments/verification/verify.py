"""Dynamic force verification of a recording.

Based on ASTM E467 and ISO 4965: end levels, span, amplitude and phase of a cyclic force compared with the reference. Further
results are the errors relative to the span, the repeatability over cycles, and the inertia of the mass between load cell and
specimen. The standards compare an independent dynamometer in place of the specimen; here the rig's force signal is compared
with its command.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.errors import BadInput
from ehls_ros.experiments.verification.blocks import BLOCK, Block, blocks_of
from ehls_ros.experiments.verification.cycles import (
    INTERPOLATION_ERROR,
    Cycles,
    cycles_of,
    has_fundamental,
    has_usual_reference,
    settled,
)
from ehls_ros.experiments.verification.response import response_of
from ehls_ros.experiments.verification.results import (
    Cyclic,
    Distortion,
    Harmonic,
    Inertia,
    JudgedBlock,
    NonCyclic,
    OneCycle,
    Quantity,
    Refused,
    Repeatability,
    Trend,
    Verification,
)
from ehls_ros.experiments.verification.uncertainty import COVERAGE, TypeB, Uncertainty, std_of_mean, std_of_resolution, student
from ehls_ros.physics.parameters import Sensor
from ehls_ros.physics.rig import Rig, rig_from_mapping
from ehls_ros.recording.events import Pause, time_closed
from ehls_ros.samples import Mask
from ehls_ros.trajectory import Trajectory

MAX_DRIFT = 1e-3
"""Drift over the judged cycles beyond which a significantly drifting force has not settled, as a fraction of the range."""

MAX_OTHER_CYCLES = 0.2
"""Fraction of cycles with another reference above which a block is not judged by its cycles."""


class Given(NamedTuple):
    """Inputs of a verification beside the recording.

    Attributes:
        rig: the rig, for resolution, noise and lag of its sensors; None: that of the recording's metadata.
        inertia_mass: mass between load cell and specimen [kg]; None: no correction.
        cell_uncertainty: expanded uncertainty (k = 2) of the load cell's calibration [% of reading]; None: unknown.
        settling: number of cycles to leave out at the start of each stretch; None: determined from the data.
        begin, end: the time to verify, since the start of the recording [s]; None: all of it.
        pauses: intervals in which no command reached the valve, which are left out.
    """

    rig: Rig | None = None
    inertia_mass: float | None = None
    cell_uncertainty: float | None = None
    settling: int | None = None
    begin: float | None = None
    end: float | None = None
    pauses: Sequence[Pause] = ()


def verify_recording(run: Trajectory, given: Given, name: str) -> Verification:
    """Verify the force of a recording, block by block.

    Args:
        run: the recording.
        given: further inputs.
        name: name of the recording in errors.

    Raises:
        BadInput: force or reference was not recorded, a value is out of range, inertia is to be corrected without a position,
            or no command reached the valve between begin and end.
    """
    start = float(run.time_s[0]) if len(run) else 0.0
    if given.begin is not None or given.end is not None:
        run = run.between(given.begin or 0.0, math.inf if given.end is None else given.end, name)
    if given.pauses:
        run = _commanded(run, given.pauses, name)
    _check(run, given, name)
    rig = given.rig or _recorded_rig(run.metadata)
    blocks = blocks_of(run)
    return Verification(
        blocks=tuple(_judged(run, block, given, rig, start) for block in blocks),
        remarks=tuple(_remarks(run, given, rig, blocks, start)),
        inertia_mass_kg=given.inertia_mass,
        cell_uncertainty_percent=given.cell_uncertainty,
    )


def _commanded(run: Trajectory, pauses: Sequence[Pause], name: str) -> Trajectory:
    """Return the time of a recording in which the safety gate did not keep the valve closed."""
    kept = np.ones(len(run), dtype=np.bool_)
    for pause in pauses:
        kept &= (run.time_s <= pause.begin) | (run.time_s > pause.end)
    if not kept.sum() > 1:
        raise BadInput("the safety gate kept the valve closed throughout", name, "a time in which commands reached the valve")
    return replace(run, time_s=run.time_s[kept], signals={signal: values[kept] for signal, values in run.signals.items()})


def _check(run: Trajectory, given: Given, name: str) -> None:
    for signal, why in (("force_n", "the measured force"), ("force_reference_n", "its reference")):
        if signal not in run or not np.isfinite(run[signal]).any():
            raise BadInput(f"there is no {signal}, {why}", name, "a recording of a force-controlled test with both")
    for value, what in ((given.inertia_mass, "the inertia mass"), (given.cell_uncertainty, "the cell's uncertainty")):
        if value is not None and not (math.isfinite(value) and value >= 0.0):
            raise BadInput(f"{what} is {value:g}", name, "a number, 0 or more")
    if given.settling is not None and given.settling < 0:
        raise BadInput(f"the number of settling cycles is {given.settling}", name, "0 or more")
    if given.inertia_mass is not None and ("position_m" not in run or not np.isfinite(run["position_m"]).any()):
        what = "the inertia of a mass cannot be corrected: no position_m was recorded, and without it there is no acceleration"
        raise BadInput(what, name, "a recording with the position, or no inertia mass")


def _recorded_rig(metadata: Mapping[str, Any]) -> Rig | None:
    """Return the rig in a recording's metadata; None if there is no readable one."""
    try:
        return rig_from_mapping(metadata["rig"], "metadata") if "rig" in metadata else None
    except BadInput:
        return None


def _remarks(run: Trajectory, given: Given, rig: Rig | None, blocks: Sequence[Block], start: float) -> Iterator[str]:
    yield from run.preparation.remarks
    if closed := time_closed(given.pauses, run.time_s[0], run.time_s[-1]):
        yield f"The safety gate kept the valve closed for {closed:.3g} s; that time is left out."
    if BLOCK not in run:
        yield "The recording has no programme: it is judged as one block with the cycle of its reference."
    for block in blocks if BLOCK not in run else ():
        parts = [run.time_s[[stretch.samples.start, stretch.samples.stop - 1]] - start for stretch in block.stretches]
        left = float(run.time_s[-1] - run.time_s[0] - sum(float(np.ptp(part)) for part in parts))
        if sum(part.stop - part.start for part, _ in block.stretches) < len(run):
            spans = ", ".join(f"{begin:.4g} to {end:.4g} s" for begin, end in parts)
            yield f"The reference repeats from {spans}; the other {left:.3g} s (hold, taper or other cycles) are left out."
    if rig is None:
        yield "No rig file was given: resolution, noise and lag of the sensors are not in the uncertainty."
    elif "force" not in rig.sensors:
        yield "The rig file does not describe the force sensor: its resolution and noise count as zero."
    if given.cell_uncertainty is None:
        yield "The load cell's calibration uncertainty is not given and counts as zero: uncertainties here are too small by it."
    if given.inertia_mass is None:
        yield "The inertia of the mass between load cell and specimen is not corrected: no mass is given."


def _judged(run: Trajectory, block: Block, given: Given, rig: Rig | None, start: float) -> JudgedBlock:
    parts = [stretch.samples for stretch in block.stretches]
    known = [np.isfinite(run["force_n"][part]) & np.isfinite(run["force_reference_n"][part]) for part in parts]
    total = sum(len(part) for part in known)
    present = sum(int(part.sum()) for part in known)
    return JudgedBlock(
        name=block.name,
        number=block.number,
        begin_s=float(run.time_s[parts[0].start] - start),
        duration_s=float(sum(run.time_s[part.stop - 1] - run.time_s[part.start] for part in parts)),
        missing_percent=100.0 * (1.0 - present / total),
        found=_found(run, block, given, rig) if present else Refused("no sample has both force and reference"),
    )


def _found(run: Trajectory, block: Block, given: Given, rig: Rig | None) -> Cyclic | NonCyclic:
    cycles = cycles_of(run, block)
    if isinstance(cycles, str):
        return _over_time(run, block, cycles)
    if not has_fundamental(cycles):
        return _over_time(run, block, "its reference has no part at the frequency of the cycle")
    usual = has_usual_reference(cycles)
    if np.mean(~usual) > MAX_OTHER_CYCLES:
        reason = f"the reference of {int(np.sum(~usual))} of its {len(cycles)} cycles differs from the usual one"
        return _over_time(run, block, reason)
    late, in_time = settled(cycles.only(usual), given.settling)
    judged = usual.copy()
    judged[np.flatnonzero(usual)[~late]] = False
    if not judged.any():
        return _over_time(run, block, f"none of its {len(cycles)} cycles is left after those in which it settles")
    return _over_cycles(run, cycles, judged, int(np.sum(usual)), in_time, given, rig)


def _over_time(run: Trajectory, block: Block, reason: str) -> NonCyclic:
    parts = [run["force_n"][stretch.samples] - run["force_reference_n"][stretch.samples] for stretch in block.stretches]
    error, half = np.concatenate(parts), np.concatenate([part[len(part) // 2 :] for part in parts])
    error, half = error[np.isfinite(error)], half[np.isfinite(half)]
    half = half if half.size else error
    longest = max((stretch.samples for stretch in block.stretches), key=lambda samples: samples.stop - samples.start)
    response = response_of(run.time_s[longest], run["force_reference_n"][longest], run["force_n"][longest])
    return NonCyclic(
        reason=reason,
        samples=int(error.size),
        mean_error_n=float(error.mean()),
        rms_error_n=float(np.sqrt(np.mean(error**2))),
        max_error_n=float(np.abs(error).max()),
        last_half_rms_error_n=float(np.sqrt(np.mean(half**2))),
        last_half_max_error_n=float(np.abs(half).max()),
        bands=() if response is None else response.bands,
        response=response,
    )


# --- a block by its cycles -----------------------------------------------------------------------


def _over_cycles(
    run: Trajectory, every: Cycles, judged: Mask, usual: int, in_time: bool, given: Given, rig: Rig | None
) -> Cyclic:
    cycles = every.only(judged)
    sensor = rig.sensors.get("force", Sensor()) if rig is not None else Sensor()
    known = TypeB(sensor.noise_std, std_of_resolution(sensor.resolution), (given.cell_uncertainty or 0.0) / 100.0 / COVERAGE)
    frequency = float(cycles.frequency.mean())
    amplitude, phase = _fundamental(cycles, known)
    harmonics, distortion = _harmonics(cycles, known)
    position = rig.sensors.get("position", Sensor()) if rig is not None else Sensor()
    mass, repeated = given.inertia_mass, _repeatability(cycles)
    return Cyclic(
        frequency_hz=frequency,
        cycles_judged=len(cycles),
        cycles_settling=usual - len(cycles),
        cycles_incomplete=every.offered - len(every),
        cycles_unlike=len(every) - usual,
        passes=len(np.unique(every.stretch)),
        settled=in_time and _steady(cycles, repeated),
        **_levels(cycles, known),
        amplitude=amplitude,
        phase=phase,
        delay_s=-phase.error / 360.0 / frequency,
        sensor_phase_deg=math.nan if rig is None else _sensor_phase(sensor, frequency),
        distortion=distortion,
        harmonics=harmonics,
        repeatability=repeated,
        inertia=None if mass is None else _inertia(cycles, mass, std_of_resolution(position.resolution), amplitude, phase),
        trend=Trend(
            np.arange(1.0, len(every) + 1.0), judged, every.peak, every.valley, every.reference_peak, every.reference_valley
        ),
        last=_last(run, cycles),
    )


def _span(cycles: Cycles) -> float:
    return float(np.mean(cycles.reference_peak - cycles.reference_valley))


def _of_fit(cycles: Cycles, leverage: Array) -> float:
    return math.sqrt(float(np.mean(cycles.variance * leverage)) / len(cycles))


def _of_noise(cycles: Cycles, known: TypeB, leverage: Array) -> float:
    return known.noise * math.sqrt(float(np.mean(leverage)) / len(cycles))


def _uncertainty(
    cycles: Cycles, values: Array, leverage: Array, known: TypeB, reading: float, waveform: float = 0.0
) -> Uncertainty:
    """Combine the uncertainty components of a mean over cycles.

    Args:
        cycles: the cycles.
        values: the quantity minus its reference in each cycle, shape (cycles,) [N].
        leverage: its variance per variance of a sample in each cycle, shape (cycles,).
        known: type B information.
        reading: reading to which the calibration's relative uncertainty refers [N].
        waveform: error of the fitted waveform at the quantity [N].
    """
    return Uncertainty(
        repeatability=std_of_mean(values),
        fit=_of_fit(cycles, leverage),
        noise=_of_noise(cycles, known, leverage),
        resolution=known.resolution,
        cell=known.cell * abs(reading),
        waveform=abs(waveform),
    )


def _levels(cycles: Cycles, known: TypeB) -> dict[str, Quantity]:
    """Return peak, valley, mean and range of the force, by name."""
    # Possible interpolation error of an extreme between two samples.
    step = 2.0 * math.pi / float(cycles.samples.mean())
    between = INTERPOLATION_ERROR * step**4 * float(np.abs(cycles.force[:, 0]).mean())
    peak, valley = _waveform_error(cycles, cycles.peak_residual), _waveform_error(cycles, cycles.valley_residual)

    def level(name: str, value: Array, reference: Array, leverage: Array, known: TypeB = known, error: float = 0.0) -> Quantity:
        measured = float(value.mean())
        uncertainty = _uncertainty(cycles, value - reference, leverage, known, measured, error)
        return Quantity(name, "n", float(reference.mean()), measured, _span(cycles), uncertainty)

    ranges, reference = cycles.peak - cycles.valley, cycles.reference_peak - cycles.reference_valley
    both = known._replace(resolution=math.sqrt(2.0) * known.resolution)
    error = math.hypot(peak, valley, 2.0 * between)
    quantities = (
        level("peak", cycles.peak, cycles.reference_peak, cycles.peak_leverage, error=math.hypot(peak, between)),
        level("valley", cycles.valley, cycles.reference_valley, cycles.valley_leverage, error=math.hypot(valley, between)),
        level("mean", cycles.force_mean, cycles.reference_mean, cycles.mean_leverage),
        level("range", ranges, reference, cycles.peak_leverage + cycles.valley_leverage, both, error),
    )
    return {quantity.name: quantity for quantity in quantities}


def _waveform_error(cycles: Cycles, residuals: Array) -> float:
    """Return the error of the fitted waveform around an extreme, without the contribution of noise [N].

    Args:
        cycles: the cycles.
        residuals: mean residuals around the extreme of each cycle, shape (cycles, 3) [N].
    """
    noise = float(np.mean(cycles.variance * 6.0 * cycles.harmonics / cycles.samples)) / len(cycles)
    return math.sqrt(max(float(np.max(residuals.mean(axis=0) ** 2)) - 4.0 * noise, 0.0))


def _fundamental(cycles: Cycles, known: TypeB) -> tuple[Quantity, Quantity]:
    """Return amplitude and phase of the fitted sine."""
    force, reference = cycles.force[:, 0], cycles.reference[:, 0]
    # Each cycle's force is rotated so that its reference has phase zero: amplitude and phase error remain.
    turned = force * np.conj(reference) / np.abs(reference)
    mean = complex(turned.mean())
    size, asked = abs(mean), float(np.abs(reference).mean())
    along = turned * (np.conj(mean) / size if size else 1.0)
    amplitude = Quantity(
        "amplitude",
        "n",
        asked,
        size,
        asked,
        _uncertainty(cycles, along.real - np.abs(reference), cycles.harmonic_leverage, known, size),
    )
    across = _uncertainty(cycles, along.imag, cycles.harmonic_leverage, known, 0.0)
    if not size:
        nothing = Uncertainty(math.nan, math.nan)
        return amplitude, Quantity("phase", "deg", 0.0, math.nan, None, nothing)
    in_degrees = Uncertainty(*(math.degrees(part / size) for part in across))
    return amplitude, Quantity("phase", "deg", 0.0, math.degrees(np.angle(mean)), None, in_degrees)


def _harmonics(cycles: Cycles, known: TypeB) -> tuple[tuple[Harmonic, ...], Distortion]:
    """Return the harmonics and the total distortion; the contribution of noise to every amplitude is subtracted."""
    force, reference = cycles.force.mean(axis=0), np.abs(cycles.reference.mean(axis=0))
    fit = max(_of_fit(cycles, cycles.harmonic_leverage), _of_noise(cycles, known, cycles.harmonic_leverage))
    error = cycles.force - cycles.reference
    std = np.array([np.nanmax([std_of_mean(column, 2), fit]) for column in error.T])
    size = np.sqrt(np.maximum(np.abs(force) ** 2 - 2.0 * std**2, 0.0))
    expanded = COVERAGE * np.hypot(std, known.resolution)
    first, asked = size[0], reference[0]
    rows = tuple(
        Harmonic(
            order=k + 1,
            reference_n=float(reference[k]),
            measured_n=float(size[k]),
            expanded_n=float(expanded[k]),
            percent=100.0 * float(size[k] / first) if first else math.nan,
            reference_percent=100.0 * float(reference[k] / asked),
        )
        for k in range(cycles.harmonics)
    )
    if not first:
        return rows, Distortion(math.nan, math.nan, math.nan)
    # The sum of squares has a variance of 4 A^2 u^2 + 4 u^4 per harmonic.
    total = float(np.sum(np.abs(force[1:]) ** 2 - 2.0 * std[1:] ** 2))
    spread = COVERAGE * math.sqrt(float(np.sum(4.0 * size[1:] ** 2 * std[1:] ** 2 + 4.0 * std[1:] ** 4)))
    thd = math.sqrt(max(total, 0.0))
    above = math.sqrt(max(total + spread, 0.0)) - thd
    below = thd - math.sqrt(max(total - spread, 0.0))
    # Quantisation of the converter causes harmonics of up to the square root of two times its rms in total.
    uncertain = math.hypot(max(above, below), COVERAGE * math.sqrt(2.0) * known.resolution)
    reference_distortion = float(np.sqrt(np.sum(reference[1:] ** 2)) / asked)
    return rows, Distortion(100.0 * thd / first, 100.0 * reference_distortion, 100.0 * uncertain / first)


def _repeatability(cycles: Cycles) -> Repeatability:
    peak, valley = cycles.peak - cycles.reference_peak, cycles.valley - cycles.reference_valley
    of_peak, of_valley, of_range = (
        float(np.std(values, ddof=1)) if len(cycles) > 1 else math.nan for values in (peak, valley, peak - valley)
    )
    return Repeatability(of_peak, of_valley, of_range, *_drift(peak), *_drift(valley))


def _steady(cycles: Cycles, found: Repeatability) -> bool:
    """Return whether peaks and valleys do not drift over the cycles; True for too few cycles."""
    least = MAX_DRIFT * _span(cycles) / len(cycles)
    return not any(
        abs(drift) > max(expanded, least)
        for drift, expanded in (
            (found.peak_drift_n_per_cycle, found.peak_drift_expanded_n_per_cycle),
            (found.valley_drift_n_per_cycle, found.valley_drift_expanded_n_per_cycle),
        )
    )


def _drift(values: Array) -> tuple[float, float]:
    """Return the slope of the straight line through the cycles, and its expanded uncertainty [N/cycle]."""
    if len(values) < 3:
        return math.nan, math.nan
    centred = np.arange(len(values)) - 0.5 * (len(values) - 1)
    squares = float(centred @ centred)
    slope = float(centred @ values) / squares
    residual = values - values.mean() - slope * centred
    freedom = len(values) - 2
    return slope, COVERAGE * student(freedom) * math.sqrt(float(residual @ residual) / freedom / squares)


def _sensor_phase(sensor: Sensor, frequency: float) -> float:
    """Return the phase due to lag and delay of a sensor at a frequency [°]."""
    lag = math.atan(2.0 * math.pi * frequency / sensor.bandwidth) if sensor.bandwidth > 0.0 else 0.0
    return -math.degrees(lag) - 360.0 * frequency * sensor.delay


def _last(run: Trajectory, cycles: Cycles) -> OneCycle:
    here = slice(int(cycles.first[-1]), int(cycles.stop[-1]))
    time = run.time_s[here]
    return OneCycle(time - time[0], run["force_n"][here].copy(), run["force_reference_n"][here].copy())


def _inertia(cycles: Cycles, mass: float, resolution: float, amplitude: Quantity, phase: Quantity) -> Inertia | Refused:
    """Correct amplitude and phase of a block for the inertia of the mass between load cell and specimen.

    The cell measures the force on the specimen plus the inertia force of that mass: F_cell = F_specimen + m a, with force and
    position positive in the same direction. The acceleration is that of the measured position's fundamental, -(2 pi f)^2 x, so
    that no sample is differentiated.

    Args:
        cycles: the judged cycles.
        mass: mass between load cell and specimen [kg].
        resolution: standard uncertainty of the position sensor's resolution [m].
        amplitude: amplitude of the measured force.
        phase: phase of the measured force.

    Returns:
        The correction; Refused if the acceleration is not available.
    """
    measured = np.isfinite(cycles.position[:, 0])
    if not measured.any():
        return Refused("the position was not measured over whole cycles, and without it there is no acceleration")
    kept = cycles.only(measured)
    motion = complex(kept.position[:, 0].mean())
    fit = math.sqrt(float(np.mean(kept.position_variance)) / len(kept))
    scatter = std_of_mean(kept.position[:, 0], 2)
    motion_std = math.hypot(float(np.nanmax([fit, scatter, 0.0])), resolution)
    per_metre = mass * (2.0 * math.pi * float(kept.frequency.mean())) ** 2
    if abs(motion) <= COVERAGE * motion_std:
        return Refused(
            f"the motion, {abs(motion):.2g} m at the cycle's frequency, is not above its uncertainty of "
            f"{COVERAGE * motion_std:.2g} m; the force that it takes is at most {per_metre * 2.0 * COVERAGE * motion_std:.2g} N"
        )
    force, reference = complex(cycles.force[:, 0].mean()), complex(cycles.reference[:, 0].mean())
    inertia, std = -per_metre * motion, per_metre * motion_std
    specimen = force - inertia
    size = abs(specimen)
    in_degrees = math.degrees(std / size) if size else math.nan

    def wider(given: Uncertainty, std: float) -> Uncertainty:
        """Add the independent uncertainty of the position to the random part."""
        return given._replace(repeatability=math.hypot(given.random, std))

    return Inertia(
        mass_kg=mass,
        force_n=abs(inertia),
        force_expanded_n=COVERAGE * std,
        percent=100.0 * abs(inertia) / abs(force) if force else math.nan,
        phase_deg=math.degrees(np.angle(inertia / force)) if force else math.nan,
        amplitude=amplitude._replace(measured=size, uncertainty=wider(amplitude.uncertainty, std)),
        phase=phase._replace(
            measured=math.degrees(np.angle(specimen / reference)), uncertainty=wider(phase.uncertainty, in_degrees)
        ),
    )
