"""Detection of changes of a rig: a recording judged against earlier recordings of the healthy rig."""

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ehls_ros.diagnosis.coverage import covered, ranges, remarks
from ehls_ros.diagnosis.dependence import signals_along
from ehls_ros.diagnosis.diagnose import diagnose
from ehls_ros.diagnosis.discrepancy import Expected
from ehls_ros.diagnosis.evidence import Evidence, gather
from ehls_ros.diagnosis.healthy_variation import HealthyVariation, describe, learn_healthy_variation
from ehls_ros.diagnosis.pool import Progress
from ehls_ros.diagnosis.record import prepare
from ehls_ros.diagnosis.result import BaselineSummary, ChannelTrace, Diagnosis, Fitted, Healthy, trace
from ehls_ros.diagnosis.stages import CHANNELS, Channel, setup
from ehls_ros.errors import BadInput
from ehls_ros.experiments.first_draft import is_first_draft, wrong_numbers
from ehls_ros.identification.rig_coefficients import read
from ehls_ros.identification.rig_result import RigIdentification
from ehls_ros.identification.whole_rig import identify_rig
from ehls_ros.physics.rig import Rig
from ehls_ros.trajectory import Trajectory

LEARNING = 0.35
"""Fraction of the work for learning the baselines."""

NEW_PROGRAMME = (
    "no baseline is of this recording's programme: the model's errors of form may be larger in it, so that small changes are"
    " not seen; add a healthy recording of the programme"
)
"""Remark on a recording unlike any baseline."""


def diagnose_against(
    new: Trajectory,
    baselines: Sequence[Trajectory],
    rig: Rig,
    name: str,
    *,
    seed: int = 0,
    threads: int | None = None,
    progress: Progress = lambda doing, part: None,
    names: Sequence[str] | None = None,
    identified: RigIdentification | None = None,
) -> Diagnosis:
    """Find the changes of a rig since its baselines were recorded.

    Args:
        new: the recording to be judged.
        baselines: recordings of the healthy rig.
        rig: the rig as described in its file.
        name: name of the new recording in errors.
        seed: seed of the noise added to find the noise floor, and of resampling.
        threads: number of hypotheses tried in parallel; by default one per processor.
        progress: called with a description of the current step and the completed fraction of the work.
        names: names of the baselines in errors and in the result.
        identified: the rig identified from the baselines, if that is known.

    Returns:
        The diagnosis; ``consistent`` means that nothing has changed.

    Raises:
        BadInput: there is no baseline, one allows no comparison with the model, or a recording does not match the rig.
    """
    began = time.perf_counter()
    if not baselines:
        raise BadInput("no baseline is given", name, "at least one recording of the healthy rig")
    called = tuple(names or (f"baseline {i}" for i in range(1, len(baselines) + 1)))
    progress("learning the baselines", 0.0)
    if identified is None:
        identified = identify_rig(dict(zip(called, baselines, strict=True)), rig, seed=seed)
    wrong = wrong_numbers(rig, identified)
    named = list(zip(baselines, called, strict=True))
    progress("learning the baselines", 0.5 * LEARNING)
    healthy = [describe(_evidence(recording, identified.rig, what, seed)) for recording, what in named]
    variation = learn_healthy_variation(healthy, identified.errors)
    found = diagnose(
        new,
        identified.rig,
        name,
        seed=seed,
        threads=threads,
        progress=lambda doing, part: progress(doing, LEARNING + (1.0 - LEARNING) * part),
        standard=variation,
    )
    evidence, expected, new_programme = variation.judgements[0] if variation.judgements else (None, {}, False)
    coverage = () if evidence is None else covered(ranges([b.evidence for b in healthy]), evidence)
    not_compared = () if evidence is None else tuple(c for c in evidence.channels if c not in variation.channels)
    summary = BaselineSummary(
        recordings=called,
        coefficients=_coefficients(rig, identified, variation),
        channels=_channels(variation, expected),
        coverage=coverage,
        not_compared=not_compared,
        old=_traces(healthy[0].evidence, variation.expected(healthy[0]), variation),
        new={} if evidence is None else _traces(evidence, expected, variation),
    )
    unknown = (NEW_PROGRAMME,) if new_programme else ()
    all_remarks = (*found.remarks, *identified.remarks, *unknown, *remarks(coverage))
    corrected = wrong if is_first_draft(wrong) else {}
    return replace(found, baseline=summary, corrected=corrected, remarks=all_remarks, wall_s=time.perf_counter() - began)


def _evidence(recording: Trajectory, rig: Rig, name: str, seed: int) -> Evidence:
    record = prepare(recording, rig, name)
    compared = setup(record, rig)
    if not compared.channels:
        raise BadInput("no stage of the model can be compared with it", name, "a baseline with the new recording's signals")
    return gather(record, rig, compared, seed)


def _coefficient(path: str) -> str:
    """Return the name of an identified coefficient among the terms of a balance."""
    return path.rpartition(".")[2]


def _coefficients(given: Rig, found: RigIdentification, variation: HealthyVariation) -> dict[str, Fitted]:
    """Return the identified coefficients, with their spread between the baselines where it is a coefficient of a balance."""
    spread = dict[str, float]()
    for own in variation.channels.values():
        for name, varies in zip(own.terms.spreads, own.learnt.spread, strict=False):
            spread[name] = max(spread.get(name, 0.0), float(varies))
    out = {}
    for path, estimate in found.estimates.items():
        name = path.removeprefix("plant.").removeprefix("friction.")
        out[name] = Fitted(read(given, path), estimate, spread.get(_coefficient(path)))
    return out


def _channels(variation: HealthyVariation, expected: Mapping[Channel, Expected]) -> dict[Channel, Healthy]:
    out = {}
    for c, own in variation.channels.items():
        allowed = expected[c].deviation or None if c in expected else None
        before, after = own.learnt.power
        noise = float(np.sqrt(np.mean(own.learnt.windows.noise**2)))
        out[c] = Healthy(CHANNELS[c], math.sqrt(before), math.sqrt(after), noise, allowed, own.learnt.together)
    return out


def _traces(
    evidence: Evidence, expected: Mapping[Channel, Expected], variation: HealthyVariation
) -> dict[Channel, ChannelTrace]:
    """Return the residuals of the fitted model, before and after subtraction of their expectation."""
    signals = signals_along(evidence.comparison(), evidence.rig)
    out = {}
    for c, healthy in expected.items():
        before = evidence.base.values[c] * evidence.floor[c]
        out[c] = trace(evidence, c, before - healthy.mean * variation.channels[c].terms.size, signals)
    return out
