"""Monitor that determines the rig's health from its samples.

It learns the scatter of a healthy rig's blocks, tests each further block for a change, and has detected changes diagnosed. The
causes are then included in the model, so that the test continues with them. Each diagnosis starts from the healthy rig again,
so that a growing cause remains the same change, and a cause that disappears is cleared.
"""

import math
from collections import deque
from collections.abc import Mapping, Sequence

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.coverage import Range, covered, ranges
from ehls_ros.diagnosis.evidence import Evidence, gather
from ehls_ros.diagnosis.monitoring.blocks import Scores, scores, telling
from ehls_ros.diagnosis.monitoring.change_test import Change, ChangeTest
from ehls_ros.diagnosis.monitoring.directions import Direction, directions, remainders
from ehls_ros.diagnosis.monitoring.healthy import Healthy, learn, scattering
from ehls_ros.diagnosis.monitoring.tracking import COEFFICIENTS, WANTED, Reading, readings, tracked
from ehls_ros.diagnosis.record import prepare
from ehls_ros.diagnosis.stages import CHANNELS, setup
from ehls_ros.errors import BadInput
from ehls_ros.experiments.monitoring.examination import Examiner, Finding, Task
from ehls_ros.experiments.monitoring.health import Event, FoundChange, Health, State
from ehls_ros.experiments.monitoring.parameters import Parameters
from ehls_ros.experiments.monitoring.rates import RATES, rates
from ehls_ros.experiments.monitoring.remembered import Learnt, Past, Remembered
from ehls_ros.experiments.monitoring.samples import Samples
from ehls_ros.physics.rig import Rig
from ehls_ros.trajectory import Trajectory

AT_ONCE = rules.MONITOR_AT_ONCE * rules.MONITOR_BLOCK
"""Duration of samples compared with the model at once [s]."""

GAP = 0.05
"""Longest time between two samples of one stretch [s]."""

RIG_FILE, OWN_RECORDING, RECORDINGS = "the rig file", "the first minutes", "healthy recordings"
"""Kinds of baseline."""

LOOKED_AT = 20.0
"""Duration of a healthy recording from which the sizes of the departures are chosen [s]."""

MORE = 1.5
"""Factor by which the samples since an onset must have grown before they are diagnosed again."""

AGAIN = 60.0
"""Time after which they are diagnosed again in any case [s]: a drift is larger in the latest samples."""

DRIFTING = 0.75
"""Minimum exponent of the growth of a drift's sums with the time since its onset; those of a steady change grow as its root."""

CONFIRMATION_TIME = 60.0
"""Time after detection at which a change that no diagnosis confirms is taken for a new operating point [s]."""

LEARNT_ON = 24
"""Number of blocks without a change after which their scatter is learnt as well."""

MOST_LEARNT = 720
"""Maximum number of blocks from which the scatter is learnt."""

UNSURE_UNTIL = 30.0
"""Duration of samples after which an uncertain cause is named, or a change that no effect of the list explains [s]."""


class Monitor:
    """Monitor of one rig.

    Attributes:
        changes: detected changes, oldest first.
        history: the coefficients, one entry per ``reading_time``.
        well: model of the healthy rig: the rig file with the differences found at the start of the monitor.
        model: the same with the changes since.
    """

    def __init__(
        self, rig: Rig, parameters: Parameters, examiner: Examiner, baselines: Mapping[str, Trajectory] | None = None
    ) -> None:
        """Start learning, from recordings of the healthy rig or from the first samples.

        Args:
            rig: the rig as described in its file.
            parameters: monitoring parameters.
            examiner: executor of the diagnoses.
            baselines: recordings of the healthy rig, by name.

        Raises:
            BadInput: a baseline does not match the rig.
        """
        self.rig = self.well = self.model = rig
        self.parameters = parameters
        self.changes = list[FoundChange]()
        self.history = list[Past]()
        self._examiner = examiner
        self._baselines = dict(baselines or {})
        self._samples = Samples(max(parameters.kept_time, parameters.learning_time + 3.0 * AT_ONCE))
        self._begin = math.nan
        self._segment = math.nan
        self._watched = 0.0
        self._state = State.LEARNING
        self._reason = ""
        self._kind = RIG_FILE
        self._learning = list[float]()
        self._directions: tuple[Direction, ...] = ()
        self._numbers: dict[str, int] = {}
        self._test: ChangeTest | None = None
        self._sections = list[list[Scores]]()
        self._since = list[Scores]()
        self._seen: dict[str, Range] = {}
        self._remainder: Array = np.zeros(0)
        self._begins = deque[float](maxlen=rules.LONGEST_WATCH)
        self._recent = deque[Scores](maxlen=max(1, round(parameters.reading_time / rules.MONITOR_BLOCK)))
        self._read = 0
        self._outside = deque[bool](maxlen=24)
        self._under_way: Change | None = None
        self._examined = 0
        self._unsettled = self._noticed = self._asked = math.nan
        self._first: Change | None = None
        self._readings: tuple[Reading, ...] = ()
        if self._baselines:
            self._learn_from_baselines()

    # --- samples ----------------------------------------------------------------------------------

    def add(self, time_s: Array, signals: Mapping[str, Array]) -> list[Event]:
        """Add samples, and judge the completed blocks.

        Args:
            time_s: increasing times after those before, shape (n,) [s]. A jump starts a new stretch.
            signals: values by the names of the data contract, NaN where missing, shape (n,).

        Returns:
            The events.
        """
        events = list[Event]()
        if len(time_s):
            jumps = np.flatnonzero(np.diff(time_s) > GAP) + 1
            if len(self._samples) and time_s[0] - self._samples.times[-1] > GAP:
                jumps = np.concatenate([[0], jumps])
            for part in np.split(np.arange(len(time_s)), jumps):
                if part.size:
                    self._add_stretch(time_s[part], {name: values[part] for name, values in signals.items()}, events)
        self._follow_examination(events)
        return events

    def interrupt(self) -> None:
        """Start a new stretch with the next sample, as the recorded command did not drive the rig in between."""
        self._begin = math.nan

    def recording(self, seconds: float) -> Trajectory:
        """Return the samples of the last ``seconds`` [s]."""
        end = float(self._samples.times[-1]) if len(self._samples) else 0.0
        return self._samples.between(end - seconds, math.inf)

    def _add_stretch(self, time_s: Array, signals: Mapping[str, Array], events: list[Event]) -> None:
        follows = bool(len(self._samples)) and time_s[0] - self._samples.times[-1] <= GAP and not math.isnan(self._begin)
        self._samples.add(time_s, signals)
        if not follows:
            self._segment = float(time_s[0])
            self._begin = self._segment + rules.MONITOR_LEAD
        while float(time_s[-1]) >= self._begin + AT_ONCE:
            if self._state == State.LEARNING and self._under_way_learning:
                break
            begin, self._begin = self._begin, self._begin + AT_ONCE
            self._judge(begin, events)
            self._follow_examination(events)

    # --- blocks -----------------------------------------------------------------------------------

    def _blocks(self, begin: float, samples: Trajectory | None = None) -> tuple[Evidence | None, list[Scores]]:
        """Compare blocks with the model, and return the evidence and the score of each; none if they cannot be judged.

        Args:
            begin: begin of the first block [s].
            samples: samples of a recording that begins with their lead; by default those of the rig.
        """
        if samples is None:
            samples = self._samples.between(begin - rules.MONITOR_LEAD, begin + AT_ONCE)
        evidence = self._compared(samples, self.model)
        if evidence is None:
            return None, []
        begins = rules.MONITOR_LEAD + rules.MONITOR_BLOCK * np.arange(rules.MONITOR_AT_ONCE)
        return evidence, scores(evidence, self._directions, self._tracked, begins.tolist())

    def _compared(self, recording: Trajectory, rig: Rig) -> Evidence | None:
        try:
            record = prepare(recording, rig, "the rig")
            compared = setup(record, rig)
            evidence = gather(record, rig, compared, 0, rules.MONITOR_REALISATIONS) if compared.channels else None
        except BadInput as error:
            self._reason = str(error)
            return None
        if evidence is None or not evidence.channels:
            self._reason = "; ".join(compared.why_not.values()) or "the signals tell nothing of the model"
            return None
        told = telling(evidence)
        if not told.channels:
            self._reason = "the piston hardly moves"
            return None
        return told

    def _judge(self, begin: float, events: list[Event]) -> None:
        if self._state == State.LEARNING:
            if self._compared(self._samples.between(begin - rules.MONITOR_LEAD, begin + AT_ONCE), self.model) is None:
                # A rig at rest or hardly in motion provides no information.
                return
            oldest = float(self._samples.times[0]) + rules.MONITOR_LEAD
            self._learning = [*(kept for kept in self._learning if kept >= oldest), begin]
            if self._under_way_learning:
                self._end_learning(events)
            return
        evidence, found = self._blocks(begin)
        if evidence is None:
            self._state = State.IDLE if self._under_way is None else self._state
            return
        if self._state == State.IDLE:
            self._state, self._reason = State.WATCHING, ""
        self._watched += AT_ONCE
        if self._is_outside(evidence):
            return
        for number, block in enumerate(found):
            self._take(begin + number * rules.MONITOR_BLOCK, block, events)

    def _is_outside(self, evidence: Evidence) -> bool:
        """Return whether a block lies outside the range of the healthy recordings; the rig file's model is valid everywhere."""
        outside = self._kind != RIG_FILE and any(item.beyond > rules.MENTIONED_UNSEEN for item in covered(self._seen, evidence))
        self._outside.append(outside)
        return outside

    def _take(self, begin: float, found: Scores, events: list[Event]) -> None:
        if self._test is None:
            return
        self._begins.append(begin)
        self._test.add(found.score, found.information, found.share)
        self._recent.append(found)
        self._readings = self._read_off()
        self._read += 1
        if self._read >= (self._recent.maxlen or 1):
            self._read = 0
            self.history.append(Past(begin + rules.MONITOR_BLOCK, self._readings))
        if self._under_way is not None:
            return
        change = self._test.change()
        if change is None:
            self._examined = 0
            self._learn_on(found)
        elif change.blocks >= MORE * self._examined or begin + rules.MONITOR_BLOCK - self._asked >= AGAIN:
            self._examine(change, begin + rules.MONITOR_BLOCK, events)

    def _read_off(self) -> tuple[Reading, ...]:
        if self._test is None or not self._numbers:
            return ()
        rows = np.array(list(self._numbers.values()), dtype=np.intp)
        score = np.sum([s.score[rows] for s in self._recent], axis=0)
        normal = np.sum([s.normal for s in self._recent], axis=0)
        return readings(self._directions, self._numbers, self.model, score, normal, self._test.healthy.scatter[rows])

    @property
    def _tracked(self) -> tuple[int, ...]:
        return tuple(self._numbers.values())

    # --- learning ---------------------------------------------------------------------------------

    @property
    def _under_way_learning(self) -> bool:
        return len(self._learning) * AT_ONCE >= self.parameters.learning_time

    def _end_learning(self, events: list[Event]) -> None:
        begin, end = self._learning[0] - rules.MONITOR_LEAD, self._learning[-1] + AT_ONCE
        self._examiner.begin(Task(self._samples.between(begin, end), self.well, preferred=self._preferred()))
        events.append(Event(end, "learnt", f"{self.parameters.learning_time:g} s learnt; compared with the rig file"))

    def _learn_from_baselines(self) -> None:
        seen = list[Evidence | None]()
        for name, recording in self._baselines.items():
            evidence = self._compared(recording, self.rig)
            if evidence is None:
                raise BadInput(self._reason, name, "a recording of the healthy rig")
            if not self._directions:
                self._directions = directions(evidence, WANTED)
                self._numbers = tracked(self._directions)
            seen.append(evidence)
            time, section = recording.time_s, list[Scores]()
            for begin in np.arange(time[0], time[-1] - AT_ONCE - rules.MONITOR_LEAD, AT_ONCE):
                part = slice(*np.searchsorted(time, [begin, begin + rules.MONITOR_LEAD + AT_ONCE]))
                samples = Trajectory(time[part] - time[part][0], {n: v[part] for n, v in recording.signals.items()})
                section += self._blocks(begin, samples)[1]
            if section:
                self._sections.append(section)
        if not self._sections:
            what = f"no recording of the healthy rig has {AT_ONCE + rules.MONITOR_LEAD:g} s in which the piston moves"
            raise BadInput(what, ", ".join(self._baselines), "longer recordings of the rig at work")
        self._kind = RECORDINGS
        self._learn_remainder(seen)
        self._begin_watching()

    def _learn_remainder(self, recordings: Sequence[Evidence | None]) -> None:
        """Learn the remaining residuals of the model and the ranges of the signals from recordings of the healthy rig."""
        compared = [evidence for evidence in recordings if evidence is not None]
        left = [remainders(evidence, self._directions) for evidence in compared]
        self._remainder = np.max(left, axis=0) if left else np.zeros(len(self._directions))
        self._seen = ranges(compared)

    def _begin_watching(self) -> None:
        healthy = self._healthy()
        if self._test is None:
            rising = np.arange(len(healthy.level)) >= len(self._directions)
            self._test = ChangeTest(healthy, self.parameters.mean_time_between_false_alarms, rising)
        else:
            self._test.learn(healthy)
        self._state, self._reason = State.WATCHING, ""

    def _learn_on(self, found: Scores) -> None:
        """Continue learning the scatter from blocks without a change."""
        if len(self._since) >= MOST_LEARNT:
            return
        self._since.append(found._replace(normal=np.zeros((0, 0))))
        if self._test is not None and len(self._since) % LEARNT_ON == 0:
            self._test.learn(self._healthy())

    def _healthy(self) -> Healthy:
        """Return the scatter of the healthy blocks.

        Departures from a valid rig file are measured from the file itself. A departure that seems present in the healthy rig
        already is not tested: a delay, for example, averages noise and slightly improves the fit even if there is none.
        """
        found = _learnt(self._sections)
        if len(self._since) >= LEARNT_ON:
            found = scattering(found, _learnt([*self._sections, self._since]))
        # A noise floor is never exact, and a residual below the noise is not a fault.
        power = np.arange(len(found.level)) >= len(self._directions)
        found = found._replace(level=np.where(power, np.maximum(found.level, 0.0) + rules.POWER_TOLERATED, found.level))
        if self._kind != RIG_FILE:
            # The remaining residual grows with the motion, so its power is not informative.
            unknown = power & (found.level > 2.0 * rules.POWER_TOLERATED)
            remainder = np.concatenate([self._remainder, np.zeros(len(CHANNELS))])
            return found._replace(certainty=np.where(unknown, 0.0, found.certainty), remainder=remainder)
        direction = ~power
        biased = np.abs(found.level) * np.sqrt(found.certainty) > rules.BIASED * found.scatter * np.sqrt(found.dependence)
        return found._replace(
            level=np.where(direction, 0.0, found.level),
            certainty=np.where(direction, np.where(biased, 0.0, np.inf), found.certainty),
        )

    # --- examination ------------------------------------------------------------------------------

    def _examine(self, change: Change, now: float, events: list[Event]) -> None:
        if not self._examined:
            self._noticed, self._first = now, change
        self._asked = now
        self._under_way, self._examined, self._state = change, change.blocks, State.EXAMINING
        begins = list(self._begins)
        # The block of the onset is only partly changed.
        first = begins[1 - change.blocks]
        if change.blocks >= len(begins) - 1 and not math.isnan(self._unsettled):
            # The last named cause does not explain all samples since: use more samples.
            first = self._unsettled
        begin = self._unsettled = max(first, now - self.parameters.kept_time)
        events.append(Event(now, "noticed", f"{self._quantity(change.quantity)} since {begins[-change.blocks]:.1f} s"))
        baselines = tuple(self._baselines.values())
        self._examiner.begin(Task(self._samples.between(begin, now), self.well, baselines, self._preferred()))

    def _preferred(self) -> tuple[str, ...]:
        """Return the effects preferred to equivalent ones: those named before, and those of the coefficients."""
        known = (change.name for change in self.changes if change.active and change.causes)
        return tuple(dict.fromkeys([*known, *(coefficient.effect for coefficient in COEFFICIENTS.values())]))

    def _quantity(self, number: int) -> str:
        if number < len(self._directions):
            return f"{self._directions[number].name} changed"
        return f"the residual of the channel {list(CHANNELS)[number - len(self._directions)]} changed"

    def _follow_examination(self, events: list[Event]) -> None:
        found = self._examiner.finding()
        if found is None:
            return
        now = float(self._samples.times[-1])
        if self._state == State.LEARNING:
            self._learnt(found, now, events)
            return
        change, self._under_way = self._under_way, None
        self._state = State.WATCHING
        if change is None or self._test is None:
            return
        begins = list(self._begins)
        onset, earliest, latest = (begins[-min(n, len(begins))] for n in (change.blocks, change.earliest, change.latest))
        enough = now - self._unsettled >= UNSURE_UNTIL
        if found.sure or (found.names and enough):
            self._name(found, (onset, earliest, latest), now, events)
        elif found.verdict == "unknown" and enough:
            new = self._new_change(found, (onset, earliest, latest), now)
            events.append(Event(now, "named", new.sentence()))
            self._learn_anew()
        elif found.verdict == "consistent" and self.model is not self.well:
            self._clear(self.changes, now, events)
            self.model = self.well
            self._restart()
        elif now - self._noticed >= CONFIRMATION_TIME and not self._drifts(change):
            events.append(
                Event(now, "unconfirmed", "no diagnosis confirms the change: taken for an operating point of its own")
            )
            self._accept(change.blocks)

    def _drifts(self, change: Change) -> bool:
        """Return whether a change has grown since it was first noticed."""
        first = change if self._first is None else self._first
        return change.ratio > first.ratio * math.pow(change.blocks / first.blocks, DRIFTING)

    def _learnt(self, found: Finding, now: float, events: list[Event]) -> None:
        begin, end = self._learning[0] - rules.MONITOR_LEAD, self._learning[-1] + AT_ONCE
        recording = self._samples.between(begin, end)
        if found.verdict == "insufficient":
            self._learning.clear()
            self._reason = found.reason
            events.append(Event(now, "insufficient", f"learnt from further samples: {found.reason}"))
            return
        if found.verdict == "consistent":
            self._kind = RIG_FILE
        elif found.verdict == "effect" and found.names:
            self._kind = RIG_FILE
            for cause in found.causes:
                new = self._new_change(found._replace(causes=(cause,)), (begin, -math.inf, begin), now, before=True)
                events.append(Event(now, "differs", f"from the rig file from the beginning: {new.sentence()}"))
            self.well = self.model = found.rig
        else:
            self._kind, self._baselines = OWN_RECORDING, {OWN_RECORDING: recording}
            events.append(
                Event(now, "differs", f"the rig is not the rig file's: {found.verdict}; {self._kind} are the baseline")
            )
        evidence = self._compared(self._samples.between(begin, begin + LOOKED_AT), self.model)
        if evidence is None:
            self._learning.clear()
            return
        self._directions = directions(evidence, WANTED)
        self._numbers = tracked(self._directions)
        self._learn_remainder([self._compared(recording, self.model)])
        section = list[Scores]()
        for learnt in self._learning:
            section += self._blocks(learnt)[1]
        self._learning.clear()
        if not section:
            return
        self._sections = [section]
        self._begin_watching()
        events.append(Event(now, "watching", f"watched against {self._kind}"))

    def _learn_anew(self) -> None:
        """Restart learning from the present rig, as an unknown change cannot be included in the model."""
        self._state, self._test, self._sections = State.LEARNING, None, []
        self._begins.clear()
        self._recent.clear()
        self._since.clear()

    def _accept(self, blocks: int) -> None:
        """Accept the last blocks as a further condition of the healthy rig."""
        if self._test is None:
            return
        score, information, share = self._test.rows()[:, -blocks:]
        none = np.zeros((0, 0))
        self._sections.append([Scores(*row, none) for row in zip(score, information, share, strict=True)])
        self._test.learn(self._healthy())
        self._restart()

    def _restart(self) -> None:
        """Restart the sums, which referred to another model."""
        if self._test is not None:
            self._test.restart()
        self._begins.clear()
        self._recent.clear()
        self._since.clear()
        self._examined = 0

    def _name(self, found: Finding, times: tuple[float, float, float], now: float, events: list[Event]) -> None:
        """Apply the causes of a diagnosis: update known changes, add new ones, and clear those not named."""
        named = list(found.causes)
        for index, change in enumerate(self.changes):
            if not change.active or change.before or not change.causes:
                continue
            cause = next((cause for cause in named if change.may_be(cause)), None)
            if cause is not None:
                named.remove(cause)
                self.changes[index] = change._replace(causes=(cause,))
                events.append(Event(now, "moved", self.changes[index].sentence()))
            else:
                self._clear([change], now, events)
        for cause in named:
            new = self._new_change(found._replace(causes=(cause,)), times, now)
            events.append(Event(now, "named", new.sentence()))
        self.model = found.rig
        self._restart()

    def _new_change(self, found: Finding, times: tuple[float, float, float], now: float, before: bool = False) -> FoundChange:
        stage = found.causes[0].stage if found.causes else found.unknown_stage
        new = FoundChange(len(self.changes) + 1, found.causes, stage, found.depends_on, *times, now, now, before=before)
        self.changes.append(new)
        return new

    def _clear(self, gone: Sequence[FoundChange], now: float, events: list[Event]) -> None:
        for index, change in enumerate(self.changes):
            if change.active and not change.before and change in gone:
                self.changes[index] = change._replace(cleared=now)
                events.append(Event(now, "cleared", f"{change.name} shows no more"))

    # --- current state ------------------------------------------------------------------------------

    def acknowledge(self) -> int:
        """Register that an operator has seen all changes, and return the number of new ones."""
        new = [i for i, change in enumerate(self.changes) if not change.acknowledged]
        for index in new:
            self.changes[index] = self.changes[index]._replace(acknowledged=True)
        return len(new)

    def accept(self) -> Rig | None:
        """Accept the rig with its changes as the healthy one from now on, and return it; None if there is none to accept.

        If the baseline consists of recordings, the healthy rig is learnt again.
        """
        new = [i for i, change in enumerate(self.changes) if change.active and change.causes and not change.before]
        if not new:
            return None
        for index in new:
            self.changes[index] = self.changes[index]._replace(before=True, acknowledged=True)
        self.well = self.model
        if self._kind == RIG_FILE:
            self._restart()
        else:
            self._kind, self._baselines = RIG_FILE, {}
            self._learning.clear()
            self._learn_anew()
        return self.well

    def reset(self) -> None:
        """Restart after a repair: clear all changes, and learn the healthy rig again.

        Given recordings of the healthy rig remain the baseline.
        """
        self._examiner.close()
        self._under_way, self._examined, self._unsettled = None, 0, math.nan
        self.well = self.model = self.rig
        self._clear(self.changes, float(self._samples.times[-1]) if len(self._samples) else 0.0, [])
        if self._kind == RECORDINGS:
            self._restart()
            self._state = State.WATCHING
            return
        self._kind, self._baselines = RIG_FILE, {}
        self._learning.clear()
        self._learn_anew()
        self._reason = ""

    def remembered(self) -> Remembered:
        """Return the state from which another monitor of this rig can continue."""
        learnt = None
        if self._test is not None:
            sections = tuple(map(tuple, self._sections))
            learnt = Learnt(self._kind, self._directions, sections, self._baselines.get(OWN_RECORDING))
        return Remembered(
            learnt,
            self.well,
            self.model,
            tuple(self.changes),
            tuple(self.history[-RATES:]),
            self._readings,
            self._watched,
            tuple(self._begins),
            np.zeros((3, 0, 0)) if self._test is None else self._test.rows(),
        )

    def restore(self, past: Remembered) -> None:
        """Restore the state of another monitor of this rig; called before the first sample.

        Args:
            past: state of that monitor, with times on the axis that is continued.
        """
        self.well, self.model = past.well, past.model
        self.changes, self.history = list(past.changes), list(past.history)
        self._readings, self._watched = past.readings, past.watched
        if past.learnt is None or bool(self._baselines) != (past.learnt.kind == RECORDINGS):
            return
        self._kind = past.learnt.kind
        if [d.key for d in self._directions] != [d.key for d in past.learnt.directions]:
            self._directions, self._remainder = past.learnt.directions, np.zeros(len(past.learnt.directions))
        self._numbers = tracked(self._directions)
        self._sections = [list(section) for section in past.learnt.sections]
        if past.learnt.recording is not None:
            self._baselines = {OWN_RECORDING: past.learnt.recording}
            self._learn_remainder([self._compared(past.learnt.recording, self.model)])
        self._begin_watching()
        if self._test is None or len(past.begins) != past.rows.shape[1]:
            return
        self._begins.extend(past.begins)
        for row in past.rows.swapaxes(0, 1):
            self._test.add(*row)
        if self._test.change() is not None:
            # The samples for its diagnosis are lost; a change that persists is detected again.
            self._restart()

    def health(self) -> Health:
        """Return the current health of the rig."""
        time = float(self._samples.times[-1]) if len(self._samples) else math.nan
        outside = float(np.mean(self._outside)) if self._outside else 0.0
        return Health(
            time,
            self._state,
            self._reason,
            tuple(self.changes),
            self._readings,
            self._watched,
            self._kind,
            outside,
            rates(self.history),
        )

    def close(self) -> None:
        """Abort a running diagnosis."""
        self._examiner.close()


def _learnt(sections: Sequence[Sequence[Scores]]) -> Healthy:
    blocks = [block for section in sections for block in section]
    section = np.repeat(np.arange(len(sections)), [len(s) for s in sections])
    return learn(np.array([b.score for b in blocks]), np.array([b.information for b in blocks]), section)
