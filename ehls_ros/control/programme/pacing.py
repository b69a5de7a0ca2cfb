"""Null pacing: let a programme wait for the measured peaks and valleys, or run slower while they fall short.

A decision is a further motion of the :class:`~ehls_ros.control.programme.motion.Runner`, and depends on the last motion and on
the samples since: nothing else needs to be stored.
"""

import math

from ehls_ros.control.programme.counting import LoadCycle, Sample
from ehls_ros.control.programme.expansion import CLOSE, Programme
from ehls_ros.control.programme.motion import Motion, Runner

AIM = 0.75
"""Shortfall aimed at by a change of speed, as a fraction of the tolerance."""

FAST_ENOUGH = 0.5
"""Shortfall below which the speed rises again, as a fraction of the tolerance."""

LARGEST_STEPS = 0.25, 1.1
"""Smallest and largest factor by which one decision changes the speed."""

LONG_WAIT = 1.0
"""Time after which a wait is reported [s]."""

REMEDY = "raise tolerance or timeout of the pacing or the controller's gain, or lower the load"


class Pacer:
    """Paces a programme.

    Attributes:
        remark: reason for a long wait or for a lower speed, for the operator; empty if there is none.
    """

    def __init__(self, programme: Programme, period: float) -> None:
        """Start without samples.

        Args:
            programme: the programme.
            period: control period [s].
        """
        self._programme = programme
        self._period = period
        self._samples: list[Sample] = []
        self._finished: list[LoadCycle] = []
        self.remark = ""

    def add(self, sample: Sample, finished: list[LoadCycle]) -> None:
        """Add the next control cycle, and the load cycles that it completes."""
        self._samples.append(sample)
        self._finished += finished

    def follow(self, runner: Runner, cycle: int) -> str:
        """Wait, go on or change the speed from a control cycle on; return the reason for which the programme has to stop.

        Args:
            runner: the programme in execution.
            cycle: first control cycle that is not published yet.
        """
        samples, finished = self._samples, self._finished
        self._samples, self._finished = [], []
        motion = runner.motions[-1]
        if not self._programme.is_paced and motion.speed == 1.0:
            return ""
        since, _ = runner.at(cycle)
        if motion.rests is not None or since >= self._programme.duration - CLOSE:
            self.remark = ""
        elif cycle > runner.arrival():
            mode = self._programme.leaf(since).pacing.mode
            if mode == "static" and not motion.speed:
                return self._wait(runner, cycle, samples)
            if mode == "dynamic" and motion.speed:
                return self._adapt(runner, cycle, finished)
            # It comes from a block with other pacing, or had other pacing at its last start.
            if mode == "static":
                runner.run_to_reversal(cycle)
            elif motion.speed != 1.0:
                runner.pace(cycle, 1.0)
            self.remark = ""
        return ""

    def _wait(self, runner: Runner, cycle: int, samples: list[Sample]) -> str:
        """Go on to the next reversal once the measured value has reached this one."""
        motion, arrival = runner.motions[-1], runner.arrival()
        segment, target = self._programme.spot(motion.since).segment, self._programme.value(motion.since)
        leaf = segment.leaf
        begin = self._programme.value(motion.legs[0].since) if motion.kind == "pace" else target
        waiting = [sample for sample in samples if sample.cycle >= arrival]
        if not waiting:
            return ""
        missing = [_missing(sample.measured, target, target - begin) for sample in waiting]
        if any(away <= (leaf.pacing.tolerance or 0.0) for away in missing):
            self.remark = ""
            runner.run_to_reversal(cycle)
            return ""
        waited = (waiting[-1].cycle - arrival) * self._period
        name = "value" if target == begin else "peak" if target > begin else "valley"
        away = f"{missing[-1]:.4g} short" if math.isfinite(missing[-1]) else "the measured value is missing"
        where = f"{leaf.name}, load cycle {waiting[-1].load_cycles + 1}" if segment.load_cycles else leaf.name
        if waited > leaf.pacing.timeout:
            return f"the {name} {target:g} is not reached within {leaf.pacing.timeout:g} s: {away} ({where}); {REMEDY}"
        self.remark = f"waits for the {name} {target:g} ({where}): {away}" if waited > LONG_WAIT else ""
        return ""

    def _adapt(self, runner: Runner, cycle: int, finished: list[LoadCycle]) -> str:
        """Change the speed by the shortfall of the newest load cycle that has run at the present one and was measured."""
        motion, arrival = runner.motions[-1], runner.arrival()
        for found in reversed(finished):
            paced = self._programme.leaves[found.block].pacing.mode == "dynamic"
            if paced and found.first >= arrival and math.isfinite(found.peak):
                if complaint := self._judge(runner, cycle, motion, found):
                    return complaint
                break
        reason = runner.motions[-1].reason
        self.remark = f"runs at {100.0 * runner.motions[-1].speed:.3g} % of its speed: {reason}" if reason else ""
        return ""

    def _judge(self, runner: Runner, cycle: int, motion: Motion, found: LoadCycle) -> str:
        leaf = self._programme.leaves[found.block]
        pacing = leaf.pacing
        tolerance = pacing.tolerance or math.inf
        missing, name, target = max(
            (found.reference_peak - found.peak, "peak", found.reference_peak),
            (found.valley - found.reference_valley, "valley", found.reference_valley),
        )
        if missing > tolerance:
            factor = max(math.sqrt(AIM * tolerance / missing), LARGEST_STEPS[0])
            speed = max(pacing.slowest, motion.speed * factor)
            where = f"({leaf.name}, load cycle {found.load_cycle})"
            if speed < motion.speed or not motion.reason:
                runner.pace(cycle, speed, f"the {name} {target:g} was {missing:.4g} short {where}")
            elif (found.last - motion.first) * self._period > pacing.timeout:
                return (
                    f"the {name} {target:g} is not reached within {pacing.timeout:g} s at {100.0 * speed:g} % of the speed:"
                    f" {missing:.4g} short {where}; {REMEDY}, or lower slowest"
                )
        elif missing < FAST_ENOUGH * tolerance and motion.speed < 1.0:
            speed = min(motion.speed * LARGEST_STEPS[1], 1.0)
            runner.pace(cycle, speed, motion.reason if speed < 1.0 else "")
        elif motion.speed <= pacing.slowest and motion.reason:
            # The timeout begins again with the next shortfall.
            runner.pace(cycle, motion.speed)
        return ""


def _missing(measured: float, target: float, way: float) -> float:
    """Return by how much a measured value has not reached another; ``way``: direction in which it is approached, 0: both."""
    away = target - measured
    return abs(away) if way == 0.0 else math.copysign(1.0, way) * away
