"""Load cycles of a block: selection of complete, settled and similar cycles, and measurement of each cycle."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from ehls_ros.arrays import Array
from ehls_ros.experiments.verification.blocks import Block
from ehls_ros.experiments.verification.sine_fit import Columns, Complex, basis
from ehls_ros.samples import Mask
from ehls_ros.trajectory import Trajectory

MAX_HARMONICS = 10
"""Maximum number of harmonics fitted to a cycle, given enough samples."""

MIN_SAMPLES = 16
"""Minimum number of samples of a cycle."""

MAX_GAP = 0.05
"""Largest gap in a complete cycle, beyond the usual sample spacing, as a fraction of the cycle."""

LENGTH_TOLERANCE = 0.2
"""Relative difference from the usual number of samples beyond which a cycle was interrupted or has another frequency."""

REFERENCE_TOLERANCE = 0.01
"""Difference of a cycle's reference from the usual one beyond which it is another cycle, as a fraction of its amplitude."""

SETTLED_DEVIATIONS = 3.0
"""Deviation from the median cycle of the later half up to which a cycle is settled, in median deviations of that half."""

SETTLED_FRACTION = 1e-4
"""Deviation that counts as settled in any case, as a fraction of the reference's amplitude."""

MIN_SETTLING_CYCLES = 4
"""Number of cycles of a stretch below which settling cannot be determined, and the first one is left out."""


@dataclass(frozen=True)
class Cycles:
    """Measurements of each complete cycle of a block. Arrays have one row per cycle, in order of time.

    Attributes:
        harmonics: number of harmonics fitted.
        stretch: index of the stretch.
        begin_s: time of the first sample [s].
        first, stop: samples of the recording.
        frequency: frequency [Hz].
        samples: number of samples.
        force_mean, reference_mean: constant parts of the fits [N].
        force, reference: coefficients of the harmonics, shape (cycles, harmonics) [N].
        position: coefficients of the measured position, likewise [m]; NaN for a cycle without it.
        peak, valley: extremes of the measured waveform [N].
        reference_peak, reference_valley: extremes of the reference [N].
        peak_residual, valley_residual: mean residual of the fit before, at and after them, shape (cycles, 3) [N].
        variance: variance of a sample's force residual [N^2].
        position_variance: variance of the components of the position's fundamental [m^2], by the fit.
        mean_leverage, harmonic_leverage, peak_leverage, valley_leverage: variance of these results per variance of a sample.
        offered: number of cycles in the block, complete or not.
    """

    harmonics: int
    stretch: Array
    begin_s: Array
    first: Array
    stop: Array
    frequency: Array
    samples: Array
    force_mean: Array
    reference_mean: Array
    force: Complex
    reference: Complex
    position: Complex
    peak: Array
    valley: Array
    reference_peak: Array
    reference_valley: Array
    peak_residual: Array
    valley_residual: Array
    variance: Array
    position_variance: Array
    mean_leverage: Array
    harmonic_leverage: Array
    peak_leverage: Array
    valley_leverage: Array
    offered: int

    def __len__(self) -> int:
        """Return the number of cycles."""
        return len(self.begin_s)

    def only(self, kept: Mask) -> "Cycles":
        """Return some of the cycles."""
        chosen = {f.name: getattr(self, f.name)[kept] for f in fields(self) if f.name not in {"harmonics", "offered"}}
        return replace(self, **chosen)


def cycles_of(run: Trajectory, block: Block) -> Cycles | str:
    """Return the complete cycles of a block, or the reason why it has none.

    Args:
        run: the recording, with ``force_n`` and ``force_reference_n``.
        block: the block.
    """
    cut = [
        (index, begin, stop)
        for index, stretch in enumerate(block.stretches)
        for begin, stop in _edges(stretch.position, stretch.samples.start)
    ]
    if not cut:
        return "its reference does not repeat"
    known = np.isfinite(run["force_n"]) & np.isfinite(run["force_reference_n"])
    counts = np.array([stop - begin for _, begin, stop in cut])
    usual = float(np.median(counts))
    if usual < MIN_SAMPLES:
        return f"a cycle has {usual:.0f} samples, and {MIN_SAMPLES} are needed"
    harmonics = min(MAX_HARMONICS, (int(usual) // 2 - 1) // 2)
    rows = [
        _cycle(run, index, (begin, stop), place, kept, harmonics)
        for index, begin, stop in cut
        if abs(stop - begin - usual) <= LENGTH_TOLERANCE * usual
        for place, kept in [_complete(block, index, (begin, stop), known)]
        if kept is not None
    ]
    if 2 * len(rows) < len(cut):
        return f"{len(cut) - len(rows)} of its {len(cut)} cycles are incomplete, were held up, or differ in length"
    columns = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    return Cycles(harmonics=harmonics, offered=len(cut), **columns)


def _edges(position: Array, start: int) -> Iterator[tuple[int, int]]:
    """Yield the first sample and the one after the last of every cycle between the ends of a stretch."""
    known = np.flatnonzero(np.isfinite(position))
    if len(known) < 2:
        return
    turn = np.floor(position[known] + 1e-9).astype(np.int64)
    steps = np.flatnonzero(np.diff(turn)) + 1
    # The first and last cycle are complete only if the stretch begins and ends at an edge.
    spacing = float(np.median(np.diff(position[known])))
    edges = steps.tolist()
    if position[known[0]] - turn[0] <= 1.5 * spacing:
        edges.insert(0, 0)
    if turn[-1] + 1 - position[known[-1]] <= 1.5 * spacing:
        edges.append(len(known))
    for low, high in pairwise(edges):
        yield start + int(known[low]), start + int(known[high - 1]) + 1


def _complete(block: Block, index: int, ends: tuple[int, int], known: Mask) -> tuple[Array, Mask | None]:
    """Return a cycle's positions and the mask of its known samples; None in place of the mask for a cycle with a gap."""
    begin, stop = ends
    stretch = block.stretches[index]
    place = stretch.position[begin - stretch.samples.start : stop - stretch.samples.start]
    kept = known[begin:stop] & np.isfinite(place)
    if int(kept.sum()) < MIN_SAMPLES:
        return place, None
    inside = place[kept] - np.floor(place[kept][0] + 1e-9)
    spacing = 1.0 / len(place)
    steps = np.diff(inside, prepend=0.0, append=1.0)
    whole = float(steps.max()) <= MAX_GAP + 2.0 * spacing and bool(np.all(steps[1:-1] > 0.0))
    return place, kept if whole else None


def _cycle(run: Trajectory, index: int, ends: tuple[int, int], place: Array, kept: Mask, harmonics: int) -> dict[str, object]:
    """Measure one cycle."""
    here = slice(*ends)
    at = place[kept]
    force, reference = run["force_n"][here][kept], run["force_reference_n"][here][kept]
    columns = Columns.at(at, harmonics)
    fit = columns.fit(np.column_stack([force, reference]))
    followed = Waveform.of(at, reference)
    measured, values = followed.following(at, force, fit.coefficient[0, 0], fit.coefficient[1, 0], float(fit.mean[1]), columns)
    residual = force - values
    (top, peak), (bottom, valley) = measured.extreme(at, values, 1.0), measured.extreme(at, values, -1.0)
    spread = basis(np.array([top, bottom]), harmonics)
    leverage = np.einsum("ij,jk,ik->i", spread, columns.inverse, spread)
    position, position_variance = _position(run, here, place, harmonics)
    time = run.time_s[here][kept]
    return {
        "stretch": index,
        "begin_s": time[0],
        "first": ends[0],
        "stop": ends[1],
        "frequency": (at[-1] - at[0]) / (time[-1] - time[0]),
        "samples": len(at),
        "force_mean": fit.mean[0],
        "reference_mean": fit.mean[1],
        "force": fit.coefficient[0],
        "reference": fit.coefficient[1],
        "position": position,
        "peak": peak,
        "valley": valley,
        "reference_peak": followed.extreme(at, reference, 1.0)[1],
        "reference_valley": followed.extreme(at, reference, -1.0)[1],
        "peak_residual": _residuals_around(at, residual, top, harmonics),
        "valley_residual": _residuals_around(at, residual, bottom, harmonics),
        "variance": measured.variance,
        "position_variance": position_variance,
        "mean_leverage": columns.inverse[0, 0],
        "harmonic_leverage": np.diag(columns.inverse)[1:].max(),
        "peak_leverage": leverage[0],
        "valley_leverage": leverage[1],
    }


def _residuals_around(at: Array, residual: Array, place: float, harmonics: int) -> Array:
    """Return the mean residual before, at and after a phase, over half a period of the highest harmonic in total.

    Returns:
        Shape (3,); 0 if there is no sample.
    """
    third = 0.5 / harmonics / 3.0
    away = (at - place + 0.5) % 1.0 - 0.5
    parts = [residual[np.abs(away - shift * third) <= 0.5 * third] for shift in (-1, 0, 1)]
    return np.array([part.mean() if part.size else 0.0 for part in parts])


def _position(run: Trajectory, here: slice, place: Array, harmonics: int) -> tuple[Complex, float]:
    none = np.full(harmonics, np.nan + 0j), np.nan
    if "position_m" not in run:
        return none
    values = run["position_m"][here]
    kept = np.isfinite(values) & np.isfinite(place)
    if 2 * int(kept.sum()) < len(values) or int(kept.sum()) < MIN_SAMPLES:
        return none
    columns = Columns.at(place[kept], harmonics, drifting=True)
    fit = columns.fit(values[kept][:, None])
    return fit.coefficient[0], float(fit.variance[0] * np.diag(columns.inverse)[1:3].max())


# --- selection of cycles ------------------------------------------------------------------------


def has_fundamental(cycles: Cycles) -> bool:
    """Return whether the reference has a fundamental at the cycle's frequency."""
    return float(np.median(np.abs(cycles.reference[:, 0]))) > REFERENCE_TOLERANCE * float(
        np.median(cycles.reference_peak - cycles.reference_valley)
    )


def has_usual_reference(cycles: Cycles) -> Mask:
    """Return which cycles have the usual reference."""
    usual = _median(cycles.reference[:, 0])
    tolerance = REFERENCE_TOLERANCE * abs(usual)
    same: Mask = (np.abs(cycles.reference[:, 0] - usual) <= tolerance) & (
        np.abs(cycles.reference_mean - np.median(cycles.reference_mean)) <= tolerance
    )
    return same


def _median(values: Complex) -> complex:
    return complex(np.median(values.real), np.median(values.imag))


def settled(cycles: Cycles, skipped: int | None = None) -> tuple[Mask, bool]:
    """Return which cycles come after the transient at the start of their stretch.

    Args:
        cycles: the cycles of a block.
        skipped: number of cycles to leave out at the start of each stretch; None: those that differ from the later half, at
            most half of them.

    Returns:
        Which cycles have settled, and whether the transients ended by the middle of every stretch.
    """
    mask = np.ones(len(cycles), dtype=bool)
    in_time = True
    for index in np.unique(cycles.stretch):
        rows = np.flatnonzero(cycles.stretch == index)
        transient = _transient(cycles, rows) if skipped is None else skipped
        mask[rows[:transient]] = False
        in_time = in_time and (skipped is not None or len(rows) < MIN_SETTLING_CYCLES or transient < len(rows) // 2)
    return mask, in_time


def _transient(cycles: Cycles, rows: NDArray[np.intp]) -> int:
    """Return the number of unsettled cycles at the start of a stretch."""
    if len(rows) < MIN_SETTLING_CYCLES:
        return 1 if len(rows) > 1 else 0
    half = len(rows) // 2
    error = (cycles.force - cycles.reference)[rows, 0]
    mean = (cycles.force_mean - cycles.reference_mean)[rows]
    late = _median(error[half:])
    off = np.hypot(np.abs(error - late), mean - np.median(mean[half:]))
    size = abs(_median(cycles.reference[rows, 0]))
    inside = off <= max(SETTLED_DEVIATIONS * float(np.median(off[half:])), SETTLED_FRACTION * size)
    return int(np.argmax(inside)) if inside[:half].any() else half


# --- waveform ----------------------------------------------------------------------------------

WRAPPED = 3
"""Number of samples by which the interpolation is continued periodically at each end."""

SEARCH_SAMPLES, STEPS_PER_SAMPLE = 2, 8
"""Number of samples on either side of the largest one between which the extreme is searched, and steps per sample."""

INTERPOLATION_ERROR = 0.041
"""Largest error of Akima's interpolation at the top of a sine, relative to its amplitude and the fourth power of the sample
spacing in radians; determined with 16 to 100 samples per cycle."""


class Waveform(NamedTuple):
    """Waveform of one cycle, reconstructed from its noisy samples.

    A force that follows a reference equals the delayed and scaled reference up to smooth differences. The waveform is therefore
    the reference, delayed and scaled according to its fundamental, plus the harmonics of the residual. The corners of a
    triangle stay sharp, and noise causes no peaks.

    Attributes:
        curve: the reference over the position in the cycle.
        delay: delay of the curve [cycles].
        gain, offset: factor on the curve, and offset added then.
        harmonics: added terms: constant, then cosine and sine of each harmonic; shape (terms,).
        variance: variance of a sample's residual.
    """

    curve: "scipy.interpolate.Akima1DInterpolator"
    delay: float = 0.0
    gain: float = 1.0
    offset: float = 0.0
    harmonics: Array = np.zeros(1)
    variance: float = 0.0

    @classmethod
    def of(cls, at: Array, values: Array) -> "Waveform":
        """Return the curve through the samples of one cycle.

        Args:
            at: positions in the cycle, increasing over one cycle at most, shape (n,) [cycles].
            values: shape (n,).
        """
        place = at - math.floor(at[0] + 1e-9)
        x = np.concatenate([place[-WRAPPED:] - 1.0, place, place[:WRAPPED] + 1.0])
        # Akima's interpolation does not overshoot beside a step, unlike a cubic spline.
        return cls(scipy.interpolate.Akima1DInterpolator(x, np.concatenate([values[-WRAPPED:], values, values[:WRAPPED]])))

    def following(
        self, at: Array, force: Array, own: complex, followed: complex, mean: float, columns: Columns
    ) -> tuple["Waveform", Array]:
        """Return the waveform of a force that follows this waveform, and its values at the samples.

        Args:
            at: place in the cycle, shape (n,) [cycles].
            force: shape (n,).
            own: coefficient of the force's fundamental.
            followed: coefficient of this waveform's fundamental.
            mean: mean of this waveform.
            columns: columns of the fit at these positions.
        """
        ratio = own / followed if followed else 1.0
        gain, delay = abs(ratio), -float(np.angle(ratio)) / (2.0 * math.pi)
        bare = self._replace(delay=delay, gain=gain, offset=(1.0 - gain) * mean)
        base = bare.value(at)
        fit = columns.fit((force - base)[:, None])
        terms = np.concatenate([fit.mean, np.column_stack([fit.coefficient[0].real, -fit.coefficient[0].imag]).ravel()])
        return bare._replace(harmonics=terms, variance=float(fit.variance[0])), base + fit.fitted[:, 0]

    def value(self, at: Array) -> Array:
        """Return the values at positions in the cycle, shape (n,) [cycles]."""
        curve: Array = self.curve((at - self.delay) % 1.0)
        return self.offset + self.gain * curve + basis(at, len(self.harmonics) // 2) @ self.harmonics

    def extreme(self, at: Array, values: Array, sign: float) -> tuple[float, float]:
        """Return position [cycles] and value of the maximum, or of the minimum for a negative sign.

        Args:
            at: positions of the samples, shape (n,) [cycles].
            values: values of the waveform there, shape (n,).
            sign: 1 or -1.
        """
        best = at[int(np.argmax(sign * values))]
        reach = SEARCH_SAMPLES / len(at)
        near = best + np.linspace(-reach, reach, 2 * SEARCH_SAMPLES * STEPS_PER_SAMPLE + 1)
        fine = self.value(near)
        index = int(np.argmax(sign * fine))
        return float(near[index]), float(fine[index])
