"""What a verification finds, and the document it is written as."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from ehls_ros.arrays import Array
from ehls_ros.experiments.json_document import json_document
from ehls_ros.experiments.verification.uncertainty import COVERAGE, Uncertainty
from ehls_ros.samples import Mask

CERTIFIES_NOTHING = (
    "This report certifies nothing: no traceable reference transducer was in the load train. It compares the rig's own force "
    "signal with the command, in substance as ASTM E467 and ISO 4965 compare an independent dynamometer, and is neither a "
    "calibration nor a verification after either."
)


class Quantity(NamedTuple):
    """One quantity of a block: what the reference asks for and what was measured, each as the mean over its cycles.

    Attributes:
        name: what it is.
        unit: ``n`` or ``deg``, as keys of JSON end.
        reference, measured: mean values; the phase of the reference is 0.
        relative_to: what the error is given in percent of; None for a phase.
        uncertainty: of the measured value, and so of the error.
    """

    name: str
    unit: str
    reference: float
    measured: float
    relative_to: float | None
    uncertainty: Uncertainty

    @property
    def error(self) -> float:
        """Measured less reference."""
        return self.measured - self.reference

    @property
    def percent(self) -> float:
        """The error in percent of ``relative_to``; NaN where that says nothing."""
        return 100.0 * self.error / self.relative_to if self.relative_to else math.nan

    @property
    def expanded_percent(self) -> float:
        """The expanded uncertainty in percent of ``relative_to``."""
        return 100.0 * self.uncertainty.expanded / self.relative_to if self.relative_to else math.nan


class Harmonic(NamedTuple):
    """One harmonic of the force.

    Attributes:
        order: 1 for the fundamental.
        reference_n, measured_n: amplitudes [N], the measured one without what noise adds to it.
        expanded_n: expanded uncertainty [N].
        percent, reference_percent: amplitudes in percent of the fundamental's.
    """

    order: int
    reference_n: float
    measured_n: float
    expanded_n: float
    percent: float
    reference_percent: float


class Distortion(NamedTuple):
    """Total harmonic distortion: root of the sum of squares of all harmonics but the first, over the first [%]."""

    measured_percent: float
    reference_percent: float
    expanded_percent: float


class Repeatability(NamedTuple):
    """Scatter over the cycles, and its trend.

    Attributes:
        peak_std_n, valley_std_n, range_std_n: standard deviations [N]; NaN for a single cycle.
        peak_drift_n_per_cycle, valley_drift_n_per_cycle: slopes of the straight lines through peaks and valleys [N/cycle].
        peak_drift_expanded_n_per_cycle, valley_drift_expanded_n_per_cycle: their expanded uncertainties.
    """

    peak_std_n: float
    valley_std_n: float
    range_std_n: float
    peak_drift_n_per_cycle: float
    peak_drift_expanded_n_per_cycle: float
    valley_drift_n_per_cycle: float
    valley_drift_expanded_n_per_cycle: float


class Inertia(NamedTuple):
    """Force that accelerates the mass between load cell and specimen, at the fundamental.

    Attributes:
        mass_kg: the mass.
        force_n: its amplitude [N].
        force_expanded_n: expanded uncertainty, from the measured position [N].
        percent: its part of the measured amplitude.
        phase_deg: its phase over the measured force; 0 where the cell shows too much by all of it.
        amplitude: that of the force on the specimen, against the reference.
        phase: likewise.
    """

    mass_kg: float
    force_n: float
    force_expanded_n: float
    percent: float
    phase_deg: float
    amplitude: Quantity
    phase: Quantity


class Refused(NamedTuple):
    """What could not be judged, and why."""

    reason: str


@dataclass(frozen=True)
class Trend:
    """Every complete cycle of a block, for pictures: one entry each.

    Attributes:
        cycle: its number, from 1 over all stretches.
        judged: whether it counts.
        peak_n, valley_n: measured [N].
        reference_peak_n, reference_valley_n: of the reference [N].
    """

    cycle: Array
    judged: Mask
    peak_n: Array
    valley_n: Array
    reference_peak_n: Array
    reference_valley_n: Array


@dataclass(frozen=True)
class OneCycle:
    """The samples of the last judged cycle, for a picture: time since its start [s], force and reference [N]."""

    time_s: Array
    force_n: Array
    reference_n: Array


class Cyclic(NamedTuple):
    """A block whose reference repeats.

    Attributes:
        frequency_hz: of the load cycle [Hz].
        cycles_judged: those that everything here is of.
        cycles_settling: left out at the start of each stretch.
        cycles_incomplete: left out for gaps, holds or another length.
        cycles_unlike: left out for another reference.
        passes: stretches of the recording in which the block ran.
        settled: whether the transients ended in the first half of each stretch, and peaks and valleys drift no further.
        peak, valley, mean, range, amplitude, phase: mean, amplitude and phase are those of the fitted sine.
        delay_s: phase error as a delay [s].
        sensor_phase_deg: part of the phase error that lag and delay of the rig file's force sensor make; NaN without a rig.
        distortion: total harmonic distortion.
        harmonics: one by one.
        repeatability: scatter over the cycles.
        inertia: correction of the load cell; None where none was asked for.
        trend, last: for pictures.
    """

    frequency_hz: float
    cycles_judged: int
    cycles_settling: int
    cycles_incomplete: int
    cycles_unlike: int
    passes: int
    settled: bool
    peak: Quantity
    valley: Quantity
    mean: Quantity
    range: Quantity
    amplitude: Quantity
    phase: Quantity
    delay_s: float
    sensor_phase_deg: float
    distortion: Distortion
    harmonics: tuple[Harmonic, ...]
    repeatability: Repeatability
    inertia: Inertia | Refused | None
    trend: Trend
    last: OneCycle

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        """All quantities, as tables have them."""
        return self.peak, self.valley, self.mean, self.range, self.amplitude, self.phase


class NonCyclic(NamedTuple):
    """A block that is judged by its error over time.

    Attributes:
        reason: why it is not judged by its cycles.
        samples: with force and reference.
        mean_error_n, rms_error_n, max_error_n: over all of them [N].
        last_half_rms_error_n, last_half_max_error_n: over the last half of each stretch [N].
    """

    reason: str
    samples: int
    mean_error_n: float
    rms_error_n: float
    max_error_n: float
    last_half_rms_error_n: float
    last_half_max_error_n: float


class JudgedBlock(NamedTuple):
    """One block.

    Attributes:
        name: what it is called.
        number: that of the programme; None for a whole recording.
        begin_s, duration_s: since the start of the recording, and its length without what lies between its stretches [s].
        missing_percent: samples without force or reference.
        found: the result; Refused where there is none.
    """

    name: str
    number: int | None
    begin_s: float
    duration_s: float
    missing_percent: float
    found: Cyclic | NonCyclic | Refused


@dataclass(frozen=True, kw_only=True)
class Verification:
    """A recording, block by block.

    Attributes:
        blocks: in the order of time.
        remarks: what to know of the recording and of the uncertainties, a sentence each.
        inertia_mass_kg: mass between load cell and specimen [kg]; None without correction.
        cell_uncertainty_percent: expanded uncertainty of the load cell's calibration [% of reading]; None where not told.
    """

    blocks: tuple[JudgedBlock, ...]
    remarks: tuple[str, ...]
    inertia_mass_kg: float | None
    cell_uncertainty_percent: float | None


# --- document ---------------------------------------------------------------------------------------


def verification_document(found: Verification, recording: str, version: str) -> Any:
    """Return what ``verification.json`` holds.

    Args:
        found: the verification.
        recording: what was verified.
        version: of the package.
    """
    return json_document(
        {
            "certifies_nothing": CERTIFIES_NOTHING,
            "recording": recording,
            "coverage_factor": COVERAGE,
            "inertia_mass_kg": found.inertia_mass_kg,
            "cell_uncertainty_percent": found.cell_uncertainty_percent,
            "blocks": [_block(block) for block in found.blocks],
            "remarks": found.remarks,
            "version": version,
        }
    )


def _block(block: JudgedBlock) -> Mapping[str, Any]:
    kinds = {Cyclic: "cyclic", NonCyclic: "not cyclic", Refused: "not judged"}
    own = {key: value for key, value in block._asdict().items() if key != "found"}
    return {**own, "judged_as": kinds[type(block.found)], **_plain(block.found)}


def _plain(found: Cyclic | NonCyclic | Refused | Inertia) -> Mapping[str, Any]:
    """Return a record with its quantities written out and without what only pictures show."""
    return {
        key: _quantity(value)
        if isinstance(value, Quantity)
        else {"refused": value.reason}
        if isinstance(value, Refused)
        else _plain(value)
        if isinstance(value, Inertia)
        else value
        for key, value in found._asdict().items()
        if not isinstance(value, Trend | OneCycle)
    }


def _quantity(value: Quantity) -> Mapping[str, float]:
    unit = value.unit
    out = {
        f"reference_{unit}": value.reference,
        f"measured_{unit}": value.measured,
        f"error_{unit}": value.error,
        f"expanded_uncertainty_{unit}": value.uncertainty.expanded,
    }
    if value.relative_to is not None:
        out |= {"error_percent": value.percent, "expanded_uncertainty_percent": value.expanded_percent}
    kinds = {"repeatability": "type_a", "fit": "type_a"}
    return out | {f"{kinds.get(k, 'type_b')}_{k}_{unit}": v for k, v in value.uncertainty._asdict().items()}
