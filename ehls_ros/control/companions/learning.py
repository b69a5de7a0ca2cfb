"""Learn from load cycle to load cycle: correct the reference, and foresee the external force for laws with preview.

The family of learning methods is :mod:`ehls_ros.control.learning`. A reference that never repeats is not changed.
"""

import math
from collections.abc import Mapping
from typing import Annotated, Literal, NamedTuple, cast

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.control.companions.base import Companion, Kept, Past, Setting, Upcoming
from ehls_ros.control.controllers.base import FORESEEN, Model
from ehls_ros.control.learning import repetition
from ehls_ros.control.learning.corrector import Harmonics, Learner, Waveform
from ehls_ros.control.learning.force_prediction import MAX_CHANGE, ForcePrediction
from ehls_ros.control.learning.learnt_arrays import check_block, force_bounds, largest_correction, out_of_bounds
from ehls_ros.control.learning.learnt_block import CHECK_INTERVAL, Errors, Learners, LearntBlock, errors_of, recent_errors
from ehls_ros.control.learning.peak_valley import FADE, Bumpless, PeakValley
from ehls_ros.control.learning.repetition import LoadCycle, Places, Recorder, Turn
from ehls_ros.control.learning.robustness import Design, design, force_loop
from ehls_ros.control.learning.smoothing import PreviewLaw, Smoother
from ehls_ros.declared_arrays import Arrays
from ehls_ros.errors import BadInput
from ehls_ros.physics import sensors
from ehls_ros.schema import quantity, text

ACTUATOR = False

FOREIGN = "was learnt on another programme: it is neither used nor written"
"""Message about a file from another programme."""

WHOLE = 1e-6
"""Tolerance of a load cycle's length, in control cycles, for a whole number of them."""


class Parameters(NamedTuple):
    """Period, method and limits of the learning."""

    method: Annotated[
        Literal["waveform", "harmonics", "peak_valley"],
        text("waveform: sample by sample; harmonics: some numbers for each harmonic; peak_valley: mean, amplitude, time shift"),
    ] = "waveform"
    period: Annotated[
        float,
        quantity(
            "s", "after which reference and disturbance both repeat; 0: the programme's load cycle", minimum=0.0, maximum=1e3
        ),
    ] = 0.0
    harmonics: Annotated[int, quantity("1", "harmonics that are cancelled by that method", minimum=1, maximum=10_000)] = 50
    gain: Annotated[
        float,
        quantity(
            "1", "part of the error corrected in a load cycle; 0: designed from the uncertainty", minimum=0.0, maximum=2.0
        ),
    ] = 0.0
    reach: Annotated[
        float,
        quantity(
            "1",
            "largest change of the reference's mean and amplitude, over its amplitude, and of its phase in rad, by peak_valley",
            above=0.0,
            maximum=1.0,
        ),
    ] = 0.5
    uncertainty: Annotated[
        float, quantity("1", "relative error of the valve's gain and bandwidth and of the delay", minimum=0.01, maximum=1.0)
    ] = 0.2
    force_bandwidth: Annotated[float, quantity("Hz", "to which the external force is foreseen", minimum=0.1, maximum=1e3)] = (
        80.0
    )
    forgetting: Annotated[
        float, quantity("1", "part of what is known that a load cycle makes doubtful", minimum=0.0, maximum=0.5)
    ] = 0.02
    freeze: Annotated[
        float,
        quantity("1", "error, over the largest usual one, at which nothing is corrected any more", minimum=1.5, maximum=1e3),
    ] = 4.0
    file: Annotated[str, text("file to go on from, and to leave what is learnt in; empty: none")] = ""


class Learning(Companion):
    """Learning as a companion."""

    def __init__(self, p: Parameters, setting: Setting) -> None:
        """Set up learning from the parameters and the controller's setting."""
        model = setting.model
        self._p, self._period = p, model.period
        self._bounds = force_bounds(setting)
        self._bumpless = Bumpless(model.period) if p.method == "peak_valley" else None
        foresees = p.method != "peak_valley" and getattr(setting.law, "PREVIEW", False) and hasattr(setting.law, "assumptions")
        if foresees and model.cylinder:
            expected = "method: peak_valley, or a controller without preview, for a cylinder with two chambers"
            raise BadInput("its smoother has a single pressure", "companion learning", expected)
        self._smoother = Smoother(cast(PreviewLaw, setting.law), setting.tuning, model) if foresees else None
        self._loop = force_loop(setting.law, setting.tuning, model, p.uncertainty)
        self._about = {
            "controller": str(getattr(setting.law, "__name__", "")).rpartition(".")[2],
            "control_period": f"{model.period:g} s",
            "method": p.method,
            "period": f"{p.period:g} s",
        }
        self._places = Places(_whole_cycles(p.period, model.period))
        self._recorder = Recorder()
        self._blocks: dict[int, LearntBlock] = {}
        self._unproven: set[int] = set()
        self._foreign = False
        self._turn: Turn | None = None
        self._usual: Turn | None = None
        self._settling, self._interrupted = True, False
        self._added = self._predicted = 0
        self._squares = 0.0
        self._previewed = np.empty(0)
        self._why = "no load cycle is complete"
        if p.period > 0.0:
            # Reject an impossible gain before anything runs.
            self._learners(np.zeros(_whole_cycles(p.period, model.period)), p.period)

    def prepare(self) -> None:
        """Compile or load the smoother, if a force is foreseen."""
        if self._smoother is not None:
            self._smoother.prepare()

    def room(self, first: int, place: Array) -> int:
        """Return the cycles that may run before :meth:`done`: to the next check of the error or the end of the load cycle."""
        count = self._places.together(first, place)
        turn = self._places.turn(first, place[0])
        learnt = None if turn is None else self._blocks.get(turn.block)
        if learnt is None or not (learnt.applied or learnt.foresees):
            return count
        return min(count, CHECK_INTERVAL - (first % CHECK_INTERVAL))

    def ahead(self, upcoming: Upcoming) -> None:
        """Add the learnt correction to the rows, while the reference is the one it was learnt on."""
        if self._bumpless is None:
            self._add_to(upcoming)
            return
        bare = upcoming.rows[:, :FORESEEN].copy()
        self._add_to(upcoming)
        turn = self._turn
        learnt = None if turn is None else self._blocks.get(turn.block)
        source = None if turn is None or learnt is None else (turn.block, learnt.cycles)
        length = 0 if learnt is None else math.ceil(FADE * learnt.period)
        self._bumpless.smooth(upcoming.first, upcoming.rows, bare, source, length)

    def _add_to(self, upcoming: Upcoming) -> None:
        turn = self._places.turn(upcoming.first, upcoming.place[0])
        if turn != self._turn:
            self._begin(turn)
        self._previewed = upcoming.rows[:, FORESEEN].copy()
        learnt = None if turn is None else self._blocks.get(turn.block)
        if turn is None or learnt is None or self._interrupted or not (learnt.applied or learnt.foresees):
            return
        rows = upcoming.rows
        at = self._places.phases(upcoming.first, upcoming.place, turn) * learnt.size
        if len(rows) == 1:
            # In a node, called for each cycle.
            low = int(at[0])
            self._add(rows[0], learnt, turn, low, float(at[0]) - low)
            return
        for row, low, part in zip(rows, at.astype(np.int64), at % 1.0, strict=True):
            self._add(row, learnt, turn, int(low), float(part))

    def _add(self, row: Array, learnt: LearntBlock, turn: Turn, low: int, part: float) -> None:
        """Add the learnt correction to one row, interpolated by ``part`` from sample ``low`` to the next."""
        if not learnt.stale:
            wanted = learnt.wanted[low] + part * (learnt.wanted[low + 1] - learnt.wanted[low])
            if abs(row[0] - wanted) > learnt.tolerance:
                learnt.stale = True
                self._why = f"the reference of block {turn.block} is another one than was learnt"
                self._refuse_file(turn.block)
        table = learnt.table[low]
        if part != 0.0:
            table = table + part * (learnt.table[low + 1] - table)
        if not learnt.stale:
            row[:FORESEEN] += table[:FORESEEN]
            self._added += 1
        if learnt.foresees:
            if math.isnan(row[FORESEEN]):
                row[FORESEEN:] = 0.0
            row[FORESEEN:] += table[FORESEEN:]
            self._predicted += 1

    def done(self, past: Past, model: Model) -> Model:
        """Record the past cycles; learn from a load cycle once it is complete."""
        turn, smoother = self._turn, self._smoother
        if turn is None:
            return model
        recorder, measured = self._recorder, past.measured
        rows = recorder.add(past.first, len(past.rows))
        rows[:, repetition.PHASE] = self._places.phases(past.first, past.place, turn)
        rows[:, repetition.WANTED] = past.wanted[:, 0]
        rows[:, repetition.ERROR] = measured[:, sensors.FORCE] - past.wanted[:, 0]
        rows[:, repetition.EXTERNAL :] = 0.0
        if smoother is not None:
            forces = smoother.take(past.first, measured, past.command, model)
            rows[:, repetition.EXTERNAL] = forces.now
            rows[:, repetition.FORESEEN] = past.rows[:, FORESEEN]
            rows[:, repetition.PREVIEWED] = self._previewed
            rows[:, repetition.SMOOTHED] = math.nan
            recorder.smoothed(forces.first, forces.smoothed)
        learnt = self._blocks.get(turn.block)
        self._squares += float(rows[:, repetition.ERROR] @ rows[:, repetition.ERROR])
        if learnt is not None and (learnt.applied or learnt.foresees) and (past.first + len(rows)) % CHECK_INTERVAL == 0:
            self._check_error(turn, learnt, int((float(rows[-1, repetition.PHASE]) % 1.0) * learnt.size) + 1)
        if recorder.full():
            self._end(turn)
        return model

    def interrupt(self) -> None:
        """Exclude this load cycle and the next whole one from learning and correction, until the law has settled."""
        self._interrupted = self._turn is not None
        if self._bumpless is not None:
            self._bumpless.reset()
        self._recorder.invalidate()
        if self._smoother is not None:
            self._smoother.reset()
        self._settling, self._usual = True, None

    def report(self) -> Mapping[str, float | str]:
        """Return the state of learning in the present block, with the reason if nothing is corrected."""
        learnt = None if self._turn is None else self._blocks.get(self._turn.block)
        file: dict[str, float | str] = {"file": FOREIGN} if self._foreign else {}
        if learnt is None:
            why = "nothing repeats: neither a period nor a place in a programme" if self._turn is None else self._why
            return {"repetitions": 0.0, "state": why, **file}
        return {
            "repetitions": float(learnt.cycles),
            "state": "; ".join(filter(None, ("correcting" if learnt.applied else self._why, _out_of_step(learnt)))),
            "error_before_n": learnt.first_error,
            "error_now_n": learnt.last_error,
            "convergence": learnt.last_error / learnt.first_error if learnt.first_error > 0.0 else math.nan,
            **learnt.learners.reference.report(),
            **({} if learnt.learners.force is None else {"force_change": learnt.learners.force.change}),
            **file,
        }

    def kept(self) -> Kept:
        """Return the learnt arrays by block; none if the file is from another programme."""
        parts = {} if self._foreign else {block: learnt.stored() for block, learnt in self._blocks.items() if learnt.active}
        return Kept(self._about, parts)

    def recall(self, kept: Kept) -> None:
        """Restore the learnt arrays of an earlier run.

        Raises:
            ValueError: they cannot have been learnt with these parameters on this rig.
        """
        for block, stored in kept.parts.items():
            check_block(stored, self._p.method, self._bounds, foresees=self._smoother is not None)
            self._restore(block, stored)

    def _begin(self, turn: Turn | None) -> None:
        """Start a load cycle."""
        before, self._turn, self._added, self._predicted, self._squares = self._turn, turn, 0, 0, 0.0
        self._recorder.begin(follows=turn is not None and before == turn._replace(number=turn.number - 1))
        if turn is not None and turn.block in self._blocks:
            self._blocks[turn.block].begin_cycle()

    def _check_error(self, turn: Turn, learnt: LearntBlock, samples: int) -> None:
        """Stop correcting if the error has grown, in a load cycle that follows a usual one without a gap.

        Args:
            turn: the load cycle.
            learnt: its block.
            samples: samples of the load cycle so far.
        """
        # A start from rest causes an additional error.
        if not (learnt.stale or self._settling) and learnt.withdrawal.exceeds(self._squares, samples):
            self._withdraw(learnt)
            return
        recent = self._recorder.latest(CHECK_INTERVAL)
        if recent is None or self._usual != turn._replace(number=turn.number - 1):
            return
        limits = (math.inf, learnt.limits[1]) if learnt.stale else learnt.limits
        grown = [rms > limit for rms, limit in zip(recent_errors(recent), limits, strict=True)]
        if any(grown):
            learnt.paused = True
            what = "the force error" if grown[0] else "the external force"
            self._why = f"{what} is no longer what it was in the load cycles before"

    def _end(self, turn: Turn) -> None:
        """Learn from the load cycle that has ended."""
        cycle, settling = self._recorder.complete(), self._settling
        self._usual = None if cycle is None or settling else turn
        if cycle is None:
            return
        self._settling = self._interrupted = False
        learnt = self._blocks.get(turn.block)
        if learnt is None or not learnt.matches(cycle):
            self._restart(turn, cycle)
            self._blocks[turn.block].observe_transition(errors_of(cycle))
            return
        self._unproven.discard(turn.block)
        if settling:
            return
        errors = errors_of(cycle)
        if not learnt.applied and math.sqrt(float(np.mean(errors.force**2))) > largest_correction(learnt.wanted, self._bounds):
            self._restart(turn, cycle)
            self._why = "the force is lost: the error is larger than any correction may be"
            return
        if self._added == 0 and self._predicted == 0:
            learnt.withdrawal.observe(errors.force)
        elif learnt.applied and learnt.withdrawal.is_worse(errors.force):
            self._withdraw(learnt)
        if learnt.stale or learnt.paused:
            self._judge(learnt, turn, cycle, errors)
        elif self._p.method == "peak_valley" and not learnt.withdrawal.repeats:
            # Three numbers cannot distinguish a transient from an error that repeats.
            learnt.observe_transition(errors)
        elif self._added == (len(cycle.columns) if learnt.active else 0):
            learnt.learn(errors, self._p.freeze)
            self._why = "nothing that repeats stands out from the noise"
            if reason := out_of_bounds(learnt, self._p.method, self._bounds):
                # Discard all of it, including the foreseen force.
                del self._blocks[turn.block]
                self._restart(turn, cycle)
                self._why = reason

    def _judge(self, learnt: LearntBlock, turn: Turn, cycle: LoadCycle, errors: Errors) -> None:
        """Resume a correction, or restart learning, after a load cycle without it."""
        if self._added > 0 or self._predicted > 0 or learnt.withdrawal.waiting > 0:
            return
        if learnt.stale or learnt.is_valid(errors):
            learnt.stale = learnt.paused = False
        else:
            self._restart(turn, cycle)
            self._blocks[turn.block].withdrawal = learnt.withdrawal

    def _withdraw(self, learnt: LearntBlock) -> None:
        """Withdraw the correction, as the error is larger than without it."""
        learnt.paused = True
        learnt.withdrawal.withdraw()
        self._why = "the force error is larger than without a correction"

    def _restart(self, turn: Turn, cycle: LoadCycle) -> None:
        """Restart learning a block's load cycle. The one that shows the reference contains a transition and is not used."""
        self._refuse_file(turn.block)
        size, before = len(cycle.columns), self._blocks.get(turn.block)
        learners = self._learners(cycle.columns[:, repetition.WANTED], cycle.period * self._period)
        learnt = LearntBlock(cycle, learners, self._period)
        if before is not None and before.foresees and before.size == size and before.period == cycle.period:
            # The actuator under test continues its motion whatever the reference is.
            learnt = LearntBlock(cycle, learners._replace(force=before.learners.force), self._period)
            learnt.limits[1] = before.limits[1]
        self._blocks[turn.block] = learnt
        self._why = "the load cycle has not been seen often enough"

    def _refuse_file(self, block: int) -> None:
        """Neither use nor write the file if it is from another programme."""
        if block in self._unproven:
            self._foreign = True

    def _learners(self, wanted: Array, period: float) -> Learners:
        size = len(wanted)
        if self._p.method == "peak_valley":
            return Learners(PeakValley(wanted, period, self._p.gain, self._p.reach), None)
        reference = self._learner(design(self._loop, size, period, self._p.gain), size, period)
        if self._smoother is None:
            return Learners(reference, None)
        return Learners(reference, ForcePrediction(size, period, self._p.force_bandwidth, self._p.forgetting))

    def _learner(self, filters: Design, size: int, period: float) -> Learner:
        if self._p.method == "harmonics":
            return Harmonics(filters, size, period, self._p.forgetting, self._p.harmonics)
        return Waveform(filters, size, period, self._p.forgetting)

    def _restore(self, block: int, stored: Arrays) -> None:
        wanted, period = stored["wanted"], float(stored["period"])
        columns = np.zeros((len(wanted), repetition.COLUMNS))
        columns[:, repetition.WANTED] = wanted
        learnt = LearntBlock(LoadCycle(period, columns), self._learners(wanted, period * self._period), self._period)
        if not learnt.restore(stored):
            raise ValueError(f"block {block} was learnt with other parameters")
        if reason := out_of_bounds(learnt, self._p.method, self._bounds):
            raise ValueError(f"block {block}: {reason}")
        self._blocks[block] = learnt
        self._unproven.add(block)


def _out_of_step(learnt: LearntBlock) -> str:
    """Return the message that the external force is not foreseen, as it does not repeat; empty if it repeats."""
    force = learnt.learners.force
    if force is None or force.change <= MAX_CHANGE:
        return ""
    share = 100.0 * force.change
    return f"the external force is not in step with the load cycle: it changes by {share:.0f} % from one to the next"


def _whole_cycles(period: float, control_period: float) -> int:
    cycles = period / control_period
    if abs(cycles - round(cycles)) > WHOLE * max(cycles, 1.0) or 0.0 < cycles < 8.0 or cycles > repetition.MAX_SAMPLES:
        expected = f"a multiple of the control_period, {control_period:g} s, of 8 to {repetition.MAX_SAMPLES}"
        raise BadInput(f"period is {period:g} s", "companion learning", f"{expected}, or 0")
    return round(cycles)


def check(p: Parameters, setting: Setting) -> None:
    """Reject a period that is not a whole number of control cycles, and filters for which learning may not converge.

    Raises:
        BadInput: either is the case.
    """
    Learning(p, setting)


def build(p: Parameters, setting: Setting) -> Learning:
    """Return a new learning companion."""
    return Learning(p, setting)
