"""Results of the individual stages of the model."""

from collections.abc import Callable, Mapping
from typing import NamedTuple

from ehls_ros.diagnosis.result import StageResult
from ehls_ros.diagnosis.stages import Channel, Stage
from ehls_ros.diagnosis.verdict import Finding

NEEDED_SIGNALS: Mapping[Stage, str] = {
    "valve": "valve_command_m and spool_m, several samples within the valve's lag",
    "flow": "position_m (or velocity_m_s), load_pressure_pa (or force_n), and spool_m (or valve_command_m)",
    "force_balance": "position_m (velocity_m_s for a rig without spring) and load_pressure_pa (or force_n)",
    "sensors": "two sensors of one quantity: load_pressure_pa and force_n, or position_m and velocity_m_s",
}
"""Signals required by each stage."""

NEEDED_MOTION: Mapping[Stage, str] = {
    "valve": "the command has to move the spool by many times its sensor's noise",
    "flow": "oil has to flow: the piston has to move or the pressure to change by many times their noise",
    "force_balance": "the piston has to slide, to and fro, by more than its presliding travel",
    "sensors": "the signals have to change by many times their noise",
}
"""Excitation required for a recording to show an error of each stage."""


class Nrmse(NamedTuple):
    """Rms residuals of a channel as fractions of its balance's largest term: given model, with the causes, noise alone."""

    before: float
    after: float
    noise: float


def stage_result(
    stage: Stage,
    finding: Finding,
    nrmse: Mapping[Channel, Nrmse],
    depends_on: Callable[[Channel], tuple[str, ...]],
    why_not: str = "",
) -> StageResult:
    """Describe one stage.

    Args:
        stage: the stage.
        finding: its remainders and excitation.
        nrmse: rms residuals of its channels.
        depends_on: returns the signals on which a channel's remaining residual depends; called only if something remains.
        why_not: why the stage cannot be compared although its signals are there; empty if signals are missing.
    """
    items = finding.remainders
    if not items:
        return StageResult(judged=False, why_not=why_not or f"needs {NEEDED_SIGNALS[stage]}")
    if not finding.excited:
        return StageResult(judged=False, why_not=NEEDED_MOTION[stage])
    worst = nrmse[max(items, key=lambda item: item.before / max(item.noise, 1e-12)).channel]
    remaining = max(items, key=lambda item: item.excess)
    return StageResult(
        judged=True,
        why_not="",
        nrmse_before=worst.before,
        nrmse_after=worst.after,
        noise_floor=worst.noise,
        exceeds=any(item.exceeded for item in items),
        unexplained=any(item.unexplained for item in items),
        leaves_much=any(item.exceeded and item.doubtful for item in items),
        incident=next((item.incident for item in items if item.incident is not None), None),
        depends_on=depends_on(remaining.channel) if any(item.remains for item in items) else (),
    )


def not_recorded(stage: Stage, why_not: str = "") -> StageResult:
    """Return the result of a stage that was not recorded, or that cannot be compared for the given reason."""
    return stage_result(stage, Finding((), excited=False), {}, lambda channel: (), why_not)
