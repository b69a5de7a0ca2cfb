"""Verdict from the remainders, the excitation and the named causes, and the result of each stage."""

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

from ehls_ros.diagnosis.excitation import KEYS
from ehls_ros.diagnosis.remainder import Remainder
from ehls_ros.diagnosis.result import StageResult, Verdict
from ehls_ros.diagnosis.stages import Channel, Stage

NEEDED_SIGNALS: Mapping[Stage, str] = {
    "valve": "valve_command_m and spool_m, several samples within the valve's lag",
    "flow": "position_m (or velocity_m_s), load_pressure_pa (or force_n; of a cylinder with two chambers, two of pressure_a_pa,"
    " pressure_b_pa and force_n), and spool_m (or valve_command_m)",
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


class Finding(NamedTuple):
    """Findings for one stage.

    Attributes:
        remainders: remainder of each of its channels that the standard can judge.
        excited: whether the data could show an error.
        recorded: whether its signals were recorded.
    """

    remainders: tuple[Remainder, ...]
    excited: bool
    recorded: bool = True

    @property
    def judged(self) -> bool:
        """Whether the stage can be judged."""
        return bool(self.remainders) and self.excited


class Decision(NamedTuple):
    """The verdict, and for ``unknown`` the stage with the largest unexplained remainder."""

    verdict: Verdict
    unknown_stage: Stage | None


def decide(findings: Mapping[Stage, Finding], causes: Sequence[Stage], *, excitation_needed: bool = True) -> Decision:
    """Decide the verdict.

    Args:
        findings: findings for each stage.
        causes: the stage of each accepted cause.
        excitation_needed: whether a cause counts only in a stage that was excited.

    Returns:
        ``insufficient`` if a cause lies in a stage that was not excited; ``unknown`` if there is an unexplained remainder;
        ``effect`` if there are causes; ``consistent`` if the excitation suffices to show an error, else ``insufficient``.
    """
    unknown = unknown_stage(findings)
    if excitation_needed and not all(findings[stage].excited for stage in causes):
        return Decision("insufficient", unknown)
    if unknown is not None:
        return Decision("unknown", unknown)
    if causes:
        return Decision("effect", None)
    return Decision("consistent" if enough_excited(findings) else "insufficient", None)


def unknown_stage(findings: Mapping[Stage, Finding]) -> Stage | None:
    """Return the stage with the largest unexplained remainder; None if there is none."""
    # Two sensors that disagree need no model.
    left = [(s == "sensors", item.excess, s) for s, found in findings.items() for item in found.remainders if item.unexplained]
    return max(left, key=lambda item: item[:2])[2] if left else None


def enough_excited(findings: Mapping[Stage, Finding]) -> bool:
    """Return whether enough recorded stages were excited to distinguish a correct model from a wrong one.

    Half of the recorded stages must be, and among them the force balance or the flow; the valve alone is enough if the forces
    were not recorded.
    """
    recorded = [stage for stage in KEYS if findings[stage].recorded]
    judged = [stage for stage in recorded if findings[stage].judged]
    balance = findings["force_balance"]
    enough = balance.judged or findings["flow"].judged or (findings["valve"].judged and not balance.recorded)
    return 2 * len(judged) >= len(recorded) and enough


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
        why_not: why the stage cannot be judged although its signals are there; empty if signals or motion are missing.
    """
    items = finding.remainders
    if not items:
        return StageResult(judged=False, why_not=why_not or f"needs {NEEDED_SIGNALS[stage]}")
    if not finding.excited:
        return StageResult(judged=False, why_not=why_not or NEEDED_MOTION[stage])
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
    return stage_result(stage, Finding((), excited=False, recorded=False), {}, lambda channel: (), why_not)
