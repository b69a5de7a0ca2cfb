"""From a recording and a rig's model to what the model gets wrong, why, and what mending it gains."""

import os
import time
from collections.abc import Mapping

from ehls_ros.diagnosis.evidence import Evidence, noise_of
from ehls_ros.diagnosis.hypotheses import candidates, extended
from ehls_ros.diagnosis.judged import Judged
from ehls_ros.diagnosis.record import Record, prepare
from ehls_ros.diagnosis.result import ChannelTrace, Diagnosis, StageResult, Verdict
from ehls_ros.diagnosis.search import CLOSED, search
from ehls_ros.diagnosis.stages import CHANNELS, STAGES, UNITS, Channel, Comparison, Stage, setup
from ehls_ros.diagnosis.starts import LINES, Progress, lines_of, main_channel
from ehls_ros.diagnosis.structure import signals_of, structure
from ehls_ros.diagnosis.verdict import KEY, Left, causes, excited, gain, leaves_much, left_in_stages, sensitivities
from ehls_ros.physics.rig import Rig
from ehls_ros.trajectory import Trajectory

MISSING: Mapping[Stage, str] = {
    "valve": "valve_command_m and spool_m, several samples within the valve's lag",
    "flow": "position_m (or velocity_m_s), load_pressure_pa (or force_n), and spool_m (or valve_command_m)",
    "force_balance": "position_m (velocity_m_s for a rig without spring) and load_pressure_pa (or force_n), at 400 Hz or more",
    "sensors": "two sensors of one quantity: load_pressure_pa and force_n, or position_m and velocity_m_s",
}
"""The signals that each stage needs."""

WANTED: Mapping[Stage, str] = {
    "valve": "the command has to move the spool by many times its sensor's noise",
    "flow": "oil has to flow: the piston has to move or the pressure to change by many times their noise",
    "force_balance": "the piston has to slide, to and fro, by more than its presliding travel",
    "sensors": "the signals have to change by many times their noise",
}
"""What the data have to do to tell something of a stage."""


def diagnose(
    trajectory: Trajectory,
    rig: Rig,
    name: str = "recording",
    *,
    seed: int = 0,
    threads: int | None = None,
    progress: Progress = lambda doing, part: None,
) -> Diagnosis:
    """Find what a rig's model gets wrong.

    Args:
        trajectory: the recording, any subset of the data contract's signals.
        rig: the model as it was given.
        name: what the recording is called in errors.
        seed: of the noise that is added to find the noise floor, and of resampling.
        threads: hypotheses tried at once; as many as there are processors where nothing is said.
        progress: called with what is being done, and the part of it that is done.

    Returns:
        The diagnosis.

    Raises:
        BadInput: the recording cannot be read as one of such a rig.
    """
    began = time.perf_counter()
    progress("reading the recording", 0.0)
    record = prepare(trajectory, rig, name)
    used = setup(record, rig)
    if not used.channels:
        return _nothing(record, rig, seed, began)
    evidence = Evidence(record, rig, used, seed)
    if not evidence.channels:
        return _nothing(record, rig, seed, began)
    main = main_channel(evidence)
    lines = lines_of(evidence.base.values[main], evidence.times(main), LINES)
    tried, not_judged = candidates(record, rig, lines)
    found = search(evidence, tried, threads or os.cpu_count() or 1, progress)
    best = found.best
    sizes = sensitivities(evidence, found.screened)
    comparison = evidence.comparison()
    model = extended(rig, best.hypothesis, best.fit.values)
    lefts = left_in_stages(evidence, found)
    stages = {
        stage: _stage(evidence, comparison, model, best, stage, lefts[stage], excited(evidence, sizes, stage))
        for stage in STAGES
    }
    named = causes(evidence, found, seed)
    quiet = any(c.stage in KEY and not excited(evidence, sizes, c.stage) for c in named)
    unknown = _unknown_stage(lefts)
    verdict: Verdict
    if quiet:
        verdict = "insufficient"
    elif unknown is not None:
        verdict = "unknown"
    elif named:
        verdict = "effect"
    elif _judged_enough(evidence, stages):
        verdict = "consistent"
    else:
        verdict = "insufficient"
    return Diagnosis(
        verdict=verdict,
        missing=tuple(f"{stage}: {result.why_not}" for stage, result in stages.items() if not result.judged),
        stages=stages,
        causes=named if verdict == "effect" else (),
        unknown_stage=unknown,
        depends_on=stages[unknown].depends_on if unknown is not None else (),
        partial=tuple(c.name for c in named) if verdict == "unknown" else (),
        gain=gain(evidence, best, seed) if verdict == "effect" else None,
        rig=rig,
        extended=model if verdict == "effect" else rig,
        traces={c: _trace(evidence, comparison, model, best, c) for c in evidence.channels},
        sensitivities=sizes,
        not_judged=not_judged,
        remarks=(*record.remarks, *_incidents(lefts)),
        seed=seed,
        wall_s=time.perf_counter() - began,
    )


def _incidents(lefts: Mapping[Stage, Mapping[Channel, Left]]) -> list[str]:
    """Say where a stage stands out of the noise once."""
    return [
        f"between {item.incident[0]:.1f} and {item.incident[1]:.1f} s more than noise is left in the {stage.replace('_', ' ')},"
        " and at no other time: nothing is concluded from that, look at what happened there"
        for stage, channels in lefts.items()
        for item in channels.values()
        if item.incident is not None
    ]


def _judged_enough(evidence: Evidence, stages: Mapping[Stage, StageResult]) -> bool:
    """Tell whether enough of what could be wrong was excited to say that nothing is: half of the stages that were recorded."""
    recorded = [stage for stage in KEY if any(CHANNELS[channel] == stage for channel in evidence.channels)]
    judged = [stage for stage in recorded if stages[stage].judged]
    balanced = stages["force_balance"].judged or stages["flow"].judged
    return 2 * len(judged) >= len(recorded) and (balanced or (stages["valve"].judged and "force" not in evidence.channels))


def _nothing(record: Record, rig: Rig, seed: int, began: float) -> Diagnosis:
    stages = {stage: StageResult(judged=False, why_not=f"needs {MISSING[stage]}") for stage in STAGES}
    return Diagnosis(
        verdict="insufficient",
        missing=tuple(f"{stage}: {result.why_not}" for stage, result in stages.items()),
        stages=stages,
        causes=(),
        unknown_stage=None,
        depends_on=(),
        partial=(),
        gain=None,
        rig=rig,
        extended=rig,
        traces={},
        sensitivities=(),
        not_judged={},
        remarks=record.remarks,
        seed=seed,
        wall_s=time.perf_counter() - began,
    )


def _stage(
    evidence: Evidence,
    comparison: Comparison,
    model: Rig,
    best: Judged,
    stage: Stage,
    lefts: Mapping[Channel, Left],
    moved: bool,
) -> StageResult:
    if not lefts:
        return StageResult(judged=False, why_not=f"needs {MISSING[stage]}")
    if not moved:
        return StageResult(judged=False, why_not=WANTED[stage])
    worst = max(lefts, key=lambda c: lefts[c].before / max(lefts[c].noise, 1e-12))
    unexplained = max(lefts, key=lambda c: lefts[c].after / max(lefts[c].noise, 1e-12))
    remains = any(item.remains for item in lefts.values())
    depends: tuple[str, ...] = ()
    if remains:
        depends = structure(evidence, comparison, model, unexplained, best.held.errors.values[unexplained]).depends_on
    return StageResult(
        judged=True,
        why_not="",
        nrmse_before=evidence.nrmse(worst, evidence.base.values[worst]),
        nrmse_after=evidence.nrmse(worst, best.held.errors.values[worst]),
        noise_floor=evidence.nrmse(worst, noise_of(evidence, worst)),
        exceeds=any(item.exceeded for item in lefts.values()),
        unexplained=any(not item.mended or (item.remains and item.closed < CLOSED) for item in lefts.values()),
        leaves_much=any(item.exceeded and leaves_much(item) for item in lefts.values()),
        incident=next((item.incident for item in lefts.values() if item.incident is not None), None),
        depends_on=depends,
    )


def _unknown_stage(lefts: Mapping[Stage, Mapping[Channel, Left]]) -> Stage | None:
    """Return the stage in which most is left that no cause explains."""
    worst, stage = 0.0, None
    for name, channels in lefts.items():
        for item in channels.values():
            if item.mended and (not item.remains or item.closed >= CLOSED):
                continue
            # Two sensors that disagree need no model to be wrong.
            excess = item.after / max(item.noise, 1e-12) * (1e6 if name == "sensors" else 1.0)
            if excess > worst:
                worst, stage = excess, name
    return stage


def _trace(evidence: Evidence, comparison: Comparison, model: Rig, best: Judged, channel: Channel) -> ChannelTrace:
    floor = evidence.floor[channel]
    against = {n: evidence.means(channel, v) for n, v in signals_of(evidence, comparison, model).items() if n != "time_s"}
    return ChannelTrace(
        channel=channel,
        unit=UNITS[channel],
        time=evidence.times(channel),
        before=evidence.base.values[channel] * floor,
        after=best.held.errors.values[channel] * floor,
        floor=floor,
        noise=noise_of(evidence, channel) * floor,
        against=against,
    )
