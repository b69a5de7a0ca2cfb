"""The monitor: evaluates all policies that apply to a log."""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from policies.of_gate import POLICIES as OF_GATE
from policies.of_graph import POLICIES as OF_GRAPH
from policies.policy import Policy
from policies.temporal import Margins
from policies.trace import ROUNDING, Trace

POLICIES: Sequence[Policy] = (*OF_GATE, *OF_GRAPH)
"""All declared policies."""


class Verdict(NamedTuple):
    """A policy's evaluation of one log.

    Attributes:
        policy: the policy.
        margins: robustness at each instant at which the policy applies.
    """

    policy: Policy
    margins: Margins

    @property
    def evaluated(self) -> int:
        """Number of instants at which the policy applies."""
        return len(self.margins.margin)

    @property
    def robustness(self) -> float:
        """Smallest robustness; infinite if the policy never applies."""
        return float(np.min(self.margins.margin, initial=np.inf))

    @property
    def violations(self) -> int:
        """Number of instants at which it is violated."""
        return int(np.sum(self.margins.margin < -ROUNDING))

    @property
    def worst_time(self) -> float:
        """Time of the smallest robustness [s]."""
        return float(self.margins.time[np.argmin(self.margins.margin)]) if self.evaluated else np.nan

    def __str__(self) -> str:
        """Summarise the smallest robustness."""
        return (
            f"{self.policy.name}: {self.policy.formula.text}; robustness {self.robustness:.6g} {self.policy.formula.unit}"
            f" at {self.worst_time:.6f} s, {self.violations} of {self.evaluated} instants violated"
        )


def judge(trace: Trace, policies: Iterable[Policy] = POLICIES) -> dict[str, Verdict]:
    """Return the verdict of each policy, by name."""
    return {policy.name: Verdict(policy, policy.formula.margins(trace)) for policy in policies}


def check(trace: Trace) -> dict[str, Verdict]:
    """Return the verdicts.

    Raises:
        AssertionError: a policy is violated.
    """
    verdicts = judge(trace)
    violated = [str(verdict) for verdict in verdicts.values() if verdict.violations]
    assert not violated, "policies are violated:\n" + "\n".join(violated)
    return verdicts


def listed() -> str:
    """Return the list of all policies in the form of the documentation."""
    lines = ["| policy | formula | unit | promised in |", "|---|---|---|---|"]
    for policy in POLICIES:
        text = (
            policy.formula.text.replace("|", "\\|").replace("*", "\\*").replace("->", "→").replace("<=", "≤").replace(">=", "≥")
        )
        lines.append(f"| `{policy.name}` | {text} | {policy.formula.unit} | [{policy.page}]({policy.page}) |")
    return "\n".join(lines)
