"""Results of a verification, and their JSON document."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from ehls_ros.arrays import Array
from ehls_ros.experiments.json_document import json_document
from ehls_ros.experiments.verification.response import Band, Response
from ehls_ros.experiments.verification.uncertainty import COVERAGE, Uncertainty
from ehls_ros.samples import Mask

CERTIFIES_NOTHING = (
    "This report certifies nothing: no traceable reference transducer was in the load train. It compares the rig's own force "
    "signal with the command, in substance as ASTM E467 and ISO 4965 compare an independent dynamometer, and is neither a "
    "calibration nor a verification after either."
)


class Quantity(NamedTuple):
    """One quantity of a block: reference and measured value, each as the mean over its cycles.

    Attributes:
        name: name of the quantity.
        unit: ``n`` or ``deg``, as in the suffixes of JSON keys.
        reference, measured: mean values; the phase of the reference is 0.
        relative_to: reference of the error in percent; None for a phase.
        uncertainty: uncertainty of the measured value, and so of the error.
    """

    name: str
    unit: str
    reference: float
    measured: float
    relative_to: float | None
    uncertainty: Uncertainty

    @property
    def error(self) -> float:
        """Measured value minus reference."""
        return self.measured - self.reference

    @property
    def percent(self) -> float:
        """The error in percent of ``relative_to``; NaN if undefined."""
        return 100.0 * self.error / self.relative_to if self.relative_to else math.nan

    @property
    def expanded_percent(self) -> float:
        """The expanded uncertainty in percent of ``relative_to``."""
        return 100.0 * self.uncertainty.expanded / self.relative_to if self.relative_to else math.nan


class Harmonic(NamedTuple):
    """One harmonic of the force.

    Attributes:
        order: 1 for the fundamental.
        reference_n, measured_n: amplitudes [N], the measured one without the contribution of noise.
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
    """Total harmonic distortion: root of the sum of squares of all higher harmonics over the fundamental [%]."""

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
    """Inertia force of the mass between load cell and specimen, at the fundamental.

    Attributes:
        mass_kg: the mass.
        force_n: amplitude of the inertia force [N].
        force_expanded_n: expanded uncertainty, from the measured position [N].
        percent: its ratio to the measured amplitude [%].
        phase_deg: its phase relative to the measured force [°]; at 0, the cell reading is too high by all of it.
        amplitude: amplitude of the force on the specimen, compared with the reference.
        phase: phase of the force on the specimen, likewise.
    """

    mass_kg: float
    force_n: float
    force_expanded_n: float
    percent: float
    phase_deg: float
    amplitude: Quantity
    phase: Quantity


class Refused(NamedTuple):
    """Reason why something could not be judged."""

    reason: str


@dataclass(frozen=True)
class Trend:
    """Values of every complete cycle of a block for plots, one entry each.

    Attributes:
        cycle: number of the cycle, from 1 over all stretches.
        judged: whether it is judged.
        peak_n, valley_n: measured peak and valley [N].
        reference_peak_n, reference_valley_n: peak and valley of the reference [N].
    """

    cycle: Array
    judged: Mask
    peak_n: Array
    valley_n: Array
    reference_peak_n: Array
    reference_valley_n: Array


@dataclass(frozen=True)
class OneCycle:
    """Samples of the last judged cycle for a plot: time since its start [s], force and reference [N]."""

    time_s: Array
    force_n: Array
    reference_n: Array


class Cyclic(NamedTuple):
    """Result of a block with a periodic reference.

    Attributes:
        frequency_hz: frequency of the load cycle [Hz].
        cycles_judged: number of cycles in the results.
        cycles_settling: number left out at the start of each stretch.
        cycles_incomplete: number left out for gaps, holds or another length.
        cycles_unlike: number left out for another reference.
        passes: number of stretches of the recording in which the block ran.
        settled: whether the transients ended in the first half of each stretch, and peaks and valleys no longer drift.
        peak, valley, mean, range, amplitude, phase: the quantities; mean, amplitude and phase are those of the fitted sine.
        delay_s: phase error as a delay [s].
        sensor_phase_deg: part of the phase error due to lag and delay of the rig file's force sensor; NaN without a rig.
        distortion: total harmonic distortion.
        harmonics: individual harmonics.
        repeatability: scatter over the cycles.
        inertia: correction of the load cell; None if not requested.
        trend, last: data for plots.
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
        """All quantities, in the order of tables."""
        return self.peak, self.valley, self.mean, self.range, self.amplitude, self.phase


class NonCyclic(NamedTuple):
    """Result of a block judged by its error over time.

    Attributes:
        reason: reason why it is not judged by its cycles.
        samples: number of samples with force and reference.
        mean_error_n, rms_error_n, max_error_n: errors over all of them [N].
        last_half_rms_error_n, last_half_max_error_n: errors over the last half of each stretch [N].
        bands: response of the force to the reference in bands of frequency; none for a reference that does not move.
        response: the same over frequency, for plots; None likewise.
    """

    reason: str
    samples: int
    mean_error_n: float
    rms_error_n: float
    max_error_n: float
    last_half_rms_error_n: float
    last_half_max_error_n: float
    bands: tuple[Band, ...] = ()
    response: Response | None = None


class JudgedBlock(NamedTuple):
    """Result of one block.

    Attributes:
        name: name of the block.
        number: number in the programme; None for a whole recording.
        begin_s, duration_s: start since that of the recording, and duration without the gaps between its stretches [s].
        missing_percent: fraction of samples without force or reference [%].
        found: the result; Refused if there is none.
    """

    name: str
    number: int | None
    begin_s: float
    duration_s: float
    missing_percent: float
    found: Cyclic | NonCyclic | Refused


@dataclass(frozen=True, kw_only=True)
class Verification:
    """Verification of a recording, block by block.

    Attributes:
        blocks: results of the blocks in order of time.
        remarks: remarks on the recording and the uncertainties, one sentence each.
        inertia_mass_kg: mass between load cell and specimen [kg]; None without correction.
        cell_uncertainty_percent: expanded uncertainty of the load cell's calibration [% of reading]; None if not given.
    """

    blocks: tuple[JudgedBlock, ...]
    remarks: tuple[str, ...]
    inertia_mass_kg: float | None
    cell_uncertainty_percent: float | None


# --- document ---------------------------------------------------------------------------------------


def verification_document(found: Verification, recording: str, version: str) -> Any:
    """Return the content of ``verification.json``.

    Args:
        found: the verification.
        recording: name of the recording.
        version: version of the package.
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
    """Return a record with its quantities as mappings, without the data for plots."""
    return {
        key: _quantity(value)
        if isinstance(value, Quantity)
        else {"refused": value.reason}
        if isinstance(value, Refused)
        else _plain(value)
        if isinstance(value, Inertia)
        else value
        for key, value in found._asdict().items()
        if key not in ("trend", "last", "response")
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
