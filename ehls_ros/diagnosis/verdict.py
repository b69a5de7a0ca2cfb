"""Verdict from the remainders, the excitation and the named causes."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.excitation import KEYS
from ehls_ros.diagnosis.remainder import Remainder
from ehls_ros.diagnosis.result import Verdict
from ehls_ros.diagnosis.stages import Stage


class Finding(NamedTuple):
    """Findings for one stage.

    Attributes:
        remainders: remainder of each of its channels; empty if none was recorded.
        excited: whether the data could show an error.
    """

    remainders: tuple[Remainder, ...]
    excited: bool

    @property
    def judged(self) -> bool:
        """Whether the stage can be judged."""
        return bool(self.remainders) and self.excited


class Decision(NamedTuple):
    """The verdict, and for ``unknown`` the stage with the largest unexplained remainder."""

    verdict: Verdict
    unknown_stage: Stage | None


def decide(findings: Mapping[Stage, Finding], causes: Sequence[Stage], *, against_baselines: bool = False) -> Decision:
    """Decide the verdict.

    Args:
        findings: findings for each stage.
        causes: the stage of each accepted cause.
        against_baselines: whether causes are changes since baselines; a change detected against these needs no other evidence
            of excitation.

    Returns:
        ``insufficient`` if a cause lies in a stage that was not excited; ``unknown`` if there is an unexplained remainder;
        ``effect`` if there are causes; ``consistent`` if the excitation suffices to show an error, else ``insufficient``.
    """
    unknown = unknown_stage(findings)
    if not (against_baselines or all(findings[stage].excited for stage in causes)):
        return Decision("insufficient", unknown)
    if unknown is not None:
        return Decision("unknown", unknown)
    if causes:
        return Decision("effect", None)
    return Decision("consistent" if enough_excited(findings) else "insufficient", None)


def unknown_stage(findings: Mapping[Stage, Finding]) -> Stage | None:
    """Return the stage with the largest unexplained remainder; None if there is none."""
    worst, found = 0.0, None
    for stage, finding in findings.items():
        for item in finding.remainders:
            excess = item.excess * (rules.SENSORS_FIRST if stage == "sensors" else 1.0)
            if item.unexplained and excess > worst:
                worst, found = excess, stage
    return found


def enough_excited(findings: Mapping[Stage, Finding]) -> bool:
    """Return whether enough recorded stages were excited to distinguish a correct model from a wrong one.

    Half of the recorded stages must be, and among them the force balance or the flow; the valve alone is enough if the forces
    were not recorded.
    """
    recorded = [stage for stage in KEYS if findings[stage].remainders]
    judged = [stage for stage in recorded if findings[stage].judged]
    balance = findings["force_balance"]
    enough = balance.judged or findings["flow"].judged or (findings["valve"].judged and not balance.remainders)
    return len(judged) >= rules.ENOUGH_STAGES * len(recorded) and enough
