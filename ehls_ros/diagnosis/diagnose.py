"""Diagnosis of a rig's model from a recording: errors, their causes, and the gain from correcting them."""

import os
import time
from collections.abc import Container, Mapping, Sequence
from contextlib import closing
from functools import cache, partial

from ehls_ros.arrays import Array
from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.causes import causes, gain
from ehls_ros.diagnosis.dependence import depends_on, signals_along
from ehls_ros.diagnosis.empirical import described, leaves_less
from ehls_ros.diagnosis.evidence import Evidence, Standard, gather
from ehls_ros.diagnosis.excitation import KEYS, excited, mass_observable, sensitivities, sliding
from ehls_ros.diagnosis.held_out import Assessment
from ehls_ros.diagnosis.hypotheses import candidates, extended
from ehls_ros.diagnosis.measurement import BEYOND_MEASUREMENT, allowed_for
from ehls_ros.diagnosis.partial import partial_answer
from ehls_ros.diagnosis.periods import period_left
from ehls_ros.diagnosis.pool import Pool, Progress
from ehls_ros.diagnosis.record import Record, prepare
from ehls_ros.diagnosis.remainder import Remainder, remainders, with_allowances
from ehls_ros.diagnosis.result import NAMING, Cause, Diagnosis, Sensitivity, StageResult, trace
from ehls_ros.diagnosis.search import search
from ehls_ros.diagnosis.stages import CHANNELS, STAGES, Channel, Setup, Stage, setup
from ehls_ros.diagnosis.starts import Starts, lines_left, main_channel, try_starts
from ehls_ros.diagnosis.verdict import Finding, Nrmse, decide, not_recorded, stage_result
from ehls_ros.physics.rig import Rig
from ehls_ros.trajectory import Trajectory


def diagnose(
    trajectory: Trajectory,
    rig: Rig,
    name: str = "recording",
    *,
    seed: int = 0,
    threads: int | None = None,
    progress: Progress = lambda doing, part: None,
    standard: Standard = BEYOND_MEASUREMENT,
) -> Diagnosis:
    """Diagnose the errors of a rig's model.

    Args:
        trajectory: the recording, with any subset of the data contract's signals.
        rig: the given model.
        name: name of the recording in errors.
        seed: of the noise added to find the noise floor, and of resampling.
        threads: number of hypotheses tried in parallel; by default one per processor.
        progress: called with the current activity and the completed fraction of the diagnosis.
        standard: the standard by which residuals are judged; by default noise and errors of the measurement.

    Returns:
        The diagnosis.

    Raises:
        BadInput: the recording cannot be one of such a rig.
    """
    began = time.perf_counter()
    progress("reading the recording", 0.0)
    record = prepare(trajectory, rig, name)
    compared = setup(record, rig)
    every = gather(record, rig, compared, seed) if compared.channels else None
    evidence = None if every is None else standard.judged(every)
    if every is None or evidence is None or not evidence.channels:
        return _nothing_recorded(record, rig, compared if evidence is None else evidence.setup, seed, began)
    main = main_channel(evidence.channels)
    lines = lines_left(evidence, evidence.base.values[main])
    tried, not_tried = candidates(record, rig, lines, cache(partial(period_left, evidence)))
    if not mass_observable(evidence):
        everything, tried = {c.name for c in tried}, [c for c in tried if not c.parts_mass]
        not_tried |= dict.fromkeys(
            everything - {c.name for c in tried}, "the piston hardly accelerates: masses are not observable"
        )
    with closing(Pool(evidence, threads or os.cpu_count() or 1)) as pool:
        starts = Starts(pool, try_starts(pool, tried, progress))
        found = search(starts, progress)
        sizes = sensitivities(evidence, found.screened, found.inflation)
        # An effect hidden in the healthy spread is no deficiency of the data.
        keys = [fit for fit in found.screened if fit.hypothesis[0].name in {name for name, _ in KEYS.values()}]
        shown = sensitivities(evidence, keys, evidence.correlation, beside_form=False)
        full, found_in_full = with_allowances(evidence, found)
        recorded = {CHANNELS[c] for c in every.channels}
        findings = _findings(full, recorded, shown, remainders(full, found_in_full))
        named = causes(full, found_in_full, seed)
        needed = evidence.standard.excitation_needed
        verdict, unknown = decide(findings, [cause.stage for cause in named], excitation_needed=needed)
        answer = partial_answer(found, starts, progress, seed) if verdict == "unknown" else None
        told = () if answer is None else causes(answer.evidence, answer.found, seed, rules.RIGHT_BESIDE_FORM, answer.refitted)
        if not any(cause.probability >= rules.MIN_PROBABILITY or cause.equivalent_to for cause in told):
            answer = None
        term = described(pool, found, answer, unknown) if verdict == "unknown" and unknown is not None else None
        if term is not None and answer is not None and not set(answer.found.best.names) <= set(term.without.names):
            answer, term = (None, term) if leaves_less(evidence, term, answer) else (answer, None)
    if answer is not None:
        verdict, named = "partial", told
    known, best = (full, found_in_full.best) if answer is None else (answer.evidence, answer.found.best)
    if term is not None:
        known, with_term = with_allowances(evidence, found._replace(best=term.best, places=()))
        best = with_term.best
    model = extended(rig, best.hypothesis, best.values)
    names, more = verdict in NAMING, verdict in NAMING or term is not None
    signals = signals_along(evidence.comparison(), model)
    allowances = allowed_for(known, best.held_out.residuals.values)
    # The remainder that a partial answer counts as noise is not noise.
    noise = {c: full.noise_nrmse(c) for c in full.channels}
    stages = _stage_results(known, best, findings, noise, signals)
    return Diagnosis(
        verdict=verdict,
        missing=_missing(stages),
        stages=stages,
        causes=named if names else (),
        unknown_stage=unknown,
        depends_on=stages[unknown].depends_on if unknown is not None else (),
        partial=tuple(c.name for c in named) if verdict == "unknown" else (),
        gain=gain(known, best, noise, seed) if more else None,
        term=None if term is None else term.term,
        term_rivals={} if term is None else {n: extended(rig, j.hypothesis, j.fit.values) for n, j in term.rivals.items()},
        rig=rig,
        extended=model if more else rig,
        traces={c: trace(full, c, known.floor[c] * best.held_out.residuals.values[c], signals) for c in evidence.channels},
        sensitivities=sizes,
        not_judged=not_tried,
        remarks=(
            *record.remarks,
            allowances,
            *remarks_on_baselines(found.always),
            *_incidents(findings),
            *(_deciding_signals(named) if names else ()),
            *(f"{name} would describe the error as well" for name in (() if term is None else term.rivals)),
        ),
        seed=seed,
        wall_s=time.perf_counter() - began,
    )


def _findings(
    evidence: Evidence, recorded: Container[Stage], sizes: Sequence[Sensitivity], left: Sequence[Remainder]
) -> dict[Stage, Finding]:
    slid = sliding(evidence)
    largest = evidence.standard.largest_undetected
    return {
        stage: Finding(
            tuple(item for item in left if CHANNELS[item.channel] == stage),
            excited(stage, sizes, slid, largest),
            stage in recorded,
        )
        for stage in STAGES
    }


def _stage_results(
    evidence: Evidence,
    best: Assessment,
    findings: Mapping[Stage, Finding],
    noise: Mapping[Channel, float],
    signals: Mapping[str, Array],
) -> dict[Stage, StageResult]:
    held_out = best.held_out.residuals.values

    def dependence(channel: Channel) -> tuple[str, ...]:
        means = {name: evidence.means(channel, values) for name, values in signals.items()}
        return depends_on(held_out[channel], means, evidence.half(channel))

    nrmse = {
        c: Nrmse(evidence.nrmse(c, evidence.base.values[c]), evidence.nrmse(c, held_out[c]), noise[c])
        for c in evidence.channels
    }
    why_not = evidence.setup.why_not
    return {
        stage: stage_result(stage, finding, nrmse, dependence, why_not.get(stage, "")) for stage, finding in findings.items()
    }


def _missing(stages: Mapping[Stage, StageResult]) -> tuple[str, ...]:
    return tuple(f"{stage}: {result.why_not}" for stage, result in stages.items() if not result.judged)


def _incidents(findings: Mapping[Stage, Finding]) -> list[str]:
    """Return a remark for each stage that exceeds the noise only once."""
    return [
        f"between {item.incident[0]:.1f} and {item.incident[1]:.1f} s more than noise is left in the {stage.replace('_', ' ')},"
        " and at no other time: no conclusion is drawn; check the rig's log at that time"
        for stage, finding in findings.items()
        for item in finding.remainders
        if item.incident is not None
    ]


def remarks_on_baselines(allowed: Assessment | None) -> list[str]:
    """Return a remark for each cause that is no change because the baselines allow it as well."""
    return [
        f"{name} would explain the recording, but the baselines allow it as well, so it may be no change;"
        " to decide, add a baseline in which it would show"
        for name in (() if allowed is None else allowed.names)
    ]


def _deciding_signals(named: Sequence[Cause]) -> list[str]:
    """Return a remark for each cause that missing signals would separate from its equivalents."""
    return [
        f"without {' and '.join(cause.deciding)}, {cause.name} cannot be distinguished from {', '.join(cause.equivalent_to)}"
        for cause in named
        if cause.deciding
    ]


def _nothing_recorded(record: Record, rig: Rig, compared: Setup, seed: int, began: float) -> Diagnosis:
    """Return the diagnosis of a recording in which no residual can be formed."""
    stages = {stage: not_recorded(stage, compared.why_not.get(stage, "")) for stage in STAGES}
    return Diagnosis(
        verdict="insufficient",
        missing=_missing(stages),
        stages=stages,
        rig=rig,
        extended=rig,
        remarks=record.remarks,
        seed=seed,
        wall_s=time.perf_counter() - began,
    )
