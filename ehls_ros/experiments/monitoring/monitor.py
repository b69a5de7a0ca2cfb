"""Monitor that determines the rig's health from its samples.

It has the rig identified from recordings of the healthy rig or from the first minutes, learns the scatter of a healthy rig's
blocks, tests each further block for a change, and has detected changes diagnosed. The causes are then included in the model, so
that the test continues with them. Each diagnosis starts from the healthy rig again, so that a growing cause remains the same
change, and a cause that disappears is cleared.

Coefficients are read around the model. Where that is not valid, the rig is identified again from the latest samples, and they
are read around the result until the model changes. The test continues with the model, so that no change is lost.
"""

import math
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from typing import Annotated, NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.evidence import Evidence, gather
from ehls_ros.diagnosis.monitoring.blocks import Scores, informative
from ehls_ros.diagnosis.monitoring.change_test import BlockStatistics, Change, ChangeTest
from ehls_ros.diagnosis.monitoring.tracking import (
    COEFFICIENTS,
    MOVED,
    IdentifiedRig,
    PastReadings,
    Reading,
    identified_readings,
)
from ehls_ros.diagnosis.record import prepare
from ehls_ros.diagnosis.stages import setup
from ehls_ros.errors import BadInput
from ehls_ros.experiments.monitoring import modes
from ehls_ros.experiments.monitoring.baseline import OWN_RECORDING, RECORDINGS, RIG_FILE, Baseline
from ehls_ros.experiments.monitoring.examination import Examiner, Finding, Task
from ehls_ros.experiments.monitoring.health import Event, FoundChange, Health, agreed
from ehls_ros.experiments.monitoring.identified import Identification, written
from ehls_ros.experiments.monitoring.samples import Samples
from ehls_ros.experiments.monitoring.saved_state import SavedState
from ehls_ros.experiments.monitoring.trends import RATE_READINGS, rates
from ehls_ros.physics.rig import Rig
from ehls_ros.schema import quantity
from ehls_ros.trajectory import Trajectory

COMPARED_TIME = rules.MONITOR_AT_ONCE * rules.BLOCK
"""Duration of samples compared with the model at once [s]."""

MAX_GAP = 0.05
"""Longest time between two samples of one stretch [s]."""

DEPARTURE_TIME = 20.0
"""Duration of a healthy recording from which the sizes of the departures are chosen [s]."""

MIN_DRIFT_EXPONENT = 0.75
"""Minimum exponent of the growth of a drift's sums with the time since its onset; those of a steady change grow as its root."""

CONFIRMATION_TIME = 60.0
"""Time after detection at which a change that no diagnosis confirms is accepted as a new operating point [s]."""

MIN_UNCERTAIN_TIME = 30.0
"""Duration of samples after which an uncertain cause is named, or a change that no effect of the list explains [s]."""


MIN_READING_BLOCKS = 8
"""Number of blocks of the present model from which its coefficients are read, after a change."""

IDENTIFICATION_INTERVAL = 300.0
"""Shortest time between two identifications of the same model [s]."""


class Linearisation:
    """A rig around which the coefficients are read, other than the model.

    Attributes:
        rig: the rig as identified from the latest samples.
        recent: its last blocks.
    """

    def __init__(self, identification: Identification, averaged: int) -> None:
        """Start without blocks.

        Args:
            identification: the identification.
            averaged: number of blocks over which coefficients are averaged.
        """
        self.rig = identification.tracked(identification.rig)
        self.recent = deque[Scores](maxlen=averaged)
        self._first = identified_readings(self.rig, identification.readings())

    def readings(self, baseline: Baseline, statistics: BlockStatistics) -> tuple[Reading, ...]:
        """Return the readings of the identification; those of its blocks as soon as they are enough."""
        return baseline.readings(self.rig, self.recent, statistics) if len(self.recent) >= MIN_READING_BLOCKS else self._first


class Parameters(NamedTuple):
    """Parameters of the monitoring of a rig."""

    mean_time_between_false_alarms: Annotated[
        float, quantity("h", "mean time between two false alarms, at least", minimum=1.0, maximum=1e6)
    ] = 1000.0
    learning_time: Annotated[
        float, quantity("s", "time from which the scatter of a healthy rig is learnt, without a baseline", minimum=30.0)
    ] = 60.0
    reading_time: Annotated[float, quantity("s", "time over which coefficients are averaged", minimum=10.0, maximum=3600.0)] = (
        60.0
    )
    kept_time: Annotated[
        float,
        quantity("s", "time for which samples are kept, for a diagnosis and the flight recorder", minimum=30.0, maximum=600.0),
    ] = 120.0


class Monitor:
    """Monitor of one rig.

    Attributes:
        rig: the rig as described in its file.
        identification: the identification of the healthy rig; None while it is unknown.
        healthy_rig: model of the healthy rig: the rig file, or the identified rig if its numbers are wrong, with the effects
            found at the start of the monitor.
        model: the same with the changes since.
        parameters: monitoring parameters.
        changes: detected changes, oldest first.
        history: the coefficients, one entry per ``reading_time``.
        mode: present mode.
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
        self.rig = self.healthy_rig = self.model = rig
        self.identification: Identification | None = None
        self.parameters = parameters
        self.changes = list[FoundChange]()
        self.history = list[PastReadings]()
        self.mode: modes.Mode = modes.Learning()
        self._examiner = examiner
        self._baseline = Baseline(baselines or {})
        self._samples = Samples(max(parameters.kept_time, parameters.learning_time + 3.0 * COMPARED_TIME))
        self._interrupted = True
        self._next_begin = 0.0
        self._watched = 0.0
        self._reason = ""
        self._outside = deque[bool](maxlen=24)
        self._readings: tuple[Reading, ...] = ()
        self._averaged = max(1, round(parameters.reading_time / rules.BLOCK))
        self._unrecorded = 0
        self._examined_from: float | None = None
        self._onset = (math.nan, math.nan, math.nan)
        self._linearisation: Linearisation | None = None
        self._first_readings: tuple[Reading, ...] = ()
        self._known = IdentifiedRig(rig)
        self._identified_at = -math.inf
        self._identifying = False
        self._invalid = 0
        self._pending: Task | None = None
        if baselines:
            self._check_baselines()
            self._identify_baselines()

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
        if self._pending is not None and len(time_s):
            self._examiner.begin(self._pending)
            self._pending = None
            self._follow_examination(events, float(time_s[0]))
        if len(time_s):
            jumps = np.flatnonzero(np.diff(time_s) > MAX_GAP) + 1
            if len(self._samples) and time_s[0] - self._samples.times[-1] > MAX_GAP:
                jumps = np.concatenate([[0], jumps])
            for part in np.split(np.arange(len(time_s)), jumps):
                if part.size:
                    self._add_stretch(time_s[part], {name: values[part] for name, values in signals.items()}, events)
        self._follow_examination(events)
        return events

    def interrupt(self) -> None:
        """Start a new stretch with the next sample, as the recorded command did not drive the rig in between."""
        self._interrupted = True

    def recording(self, seconds: float) -> Trajectory:
        """Return the samples of the last ``seconds`` [s]."""
        end = float(self._samples.times[-1]) if len(self._samples) else 0.0
        return self._samples.between(end - seconds, math.inf)

    def _add_stretch(self, time_s: Array, signals: Mapping[str, Array], events: list[Event]) -> None:
        if self._interrupted or not len(self._samples) or time_s[0] - self._samples.times[-1] > MAX_GAP:
            self._next_begin = float(time_s[0]) + rules.MONITOR_LEAD
        self._interrupted = False
        self._samples.add(time_s, signals)
        # While the healthy rig is compared with its file, the samples wait.
        while float(time_s[-1]) >= self._next_begin + COMPARED_TIME and not isinstance(self.mode, modes.Comparing):
            begin, self._next_begin = self._next_begin, self._next_begin + COMPARED_TIME
            if isinstance(self.mode, modes.Learning):
                self._learn_block(self.mode, begin, events)
            else:
                self._judge(self.mode, begin, events)
            self._follow_examination(events)

    # --- blocks -----------------------------------------------------------------------------------

    def _compare(self, recording: Trajectory, rig: Rig) -> Evidence | None:
        """Compare a recording with a model; None, with the reason, if it contains no information."""
        try:
            record = prepare(recording, rig, "the rig")
            compared = setup(record, rig)
            evidence = gather(record, rig, compared, 0, rules.MONITOR_REALISATIONS) if compared.channels else None
        except BadInput as error:
            self._reason = str(error)
            return None
        if evidence is None or not evidence.channels:
            self._reason = "; ".join(compared.why_not.values()) or "the signals contain no information on the model"
            return None
        evidence = informative(evidence)
        if not evidence.channels:
            self._reason = "the piston hardly moves"
            return None
        return evidence

    def _samples_of(self, begin: float) -> Trajectory:
        """Return the samples of the blocks compared at once from a time [s] on, with the lead before them."""
        return self._samples.between(begin - rules.MONITOR_LEAD, begin + COMPARED_TIME)

    def _scores(self, samples: Trajectory) -> list[Scores]:
        """Return the scores of blocks with their lead; none if they contain no information."""
        evidence = self._compare(samples, self.model)
        return [] if evidence is None else self._baseline.scores(evidence)

    def _judge(self, mode: modes.Testing, begin: float, events: list[Event]) -> None:
        samples = self._samples_of(begin)
        evidence = self._compare(samples, self.model)
        if evidence is None:
            self.mode = modes.unjudged(mode)
            return
        found = self._baseline.scores(evidence)
        self.mode = modes.judged(mode)
        if self.mode is not mode:
            self._reason = ""
        self._watched += COMPARED_TIME
        self._outside.append(self._baseline.is_outside(evidence))
        if self._outside[-1]:
            return
        if self._linearisation is not None:
            around = self._compare(samples, self._linearisation.rig.rig)
            self._linearisation.recent.extend([] if around is None else self._baseline.tracked_scores(around))
        for number, block in enumerate(found):
            self._test(begin + number * rules.BLOCK, block, events)

    def _test(self, begin: float, found: Scores, events: list[Event]) -> None:
        """Test for a change with one more block."""
        mode, end = self.mode, begin + rules.BLOCK
        if isinstance(mode, modes.Learning | modes.Comparing):
            return
        blocks = mode.blocks
        blocks.add(begin, found)
        self._readings = self._read(blocks)
        self._unrecorded += 1
        if self._unrecorded >= self._averaged:
            self._unrecorded = 0
            self.history.append(PastReadings(end, self.health().readings))
        if not isinstance(mode, modes.Watching | modes.Suspecting):
            return
        change = blocks.test.change()
        self.mode = mode.tested(change, end)
        if change is None and self._baseline.learn_unchanged(found):
            blocks.test.learn(self._baseline.statistics())
        if isinstance(self.mode, modes.Examining):
            self._identifying = False
            self._examine(self.mode, end, events)
        elif isinstance(self.mode, modes.Watching):
            self._identify_if_invalid(blocks, end)

    def _read(self, blocks: modes.ScoredBlocks) -> tuple[Reading, ...]:
        if self._linearisation is not None:
            return self._linearisation.readings(self._baseline, blocks.test.healthy)
        if self._first_readings and len(blocks.recent) < MIN_READING_BLOCKS:
            return self._first_readings
        if self._known.rig is not self.model:
            found = self.identification
            self._known = IdentifiedRig(self.model) if found is None else found.tracked(self.model)
        return self._baseline.readings(self._known, blocks.recent, blocks.test.healthy)

    def _identify_if_invalid(self, blocks: modes.ScoredBlocks, end: float) -> None:
        """Identify the rig again if the model is not valid for the readings, or if the programme excites more coefficients.

        The samples are of the blocks since then: a change that begins is noticed before there are enough.
        """
        doubtful = {MOVED, *(self.identification.why_not.values() if self.identification else ())}
        invalid = any(reading.why_not in doubtful for reading in self._readings if not reading.identified)
        self._invalid = min(self._invalid + 1, self._averaged) if invalid else 0
        if self._invalid < MIN_READING_BLOCKS or end - self._identified_at < IDENTIFICATION_INTERVAL:
            return
        self._identified_at, self._identifying = end, True
        recording = self._samples.between(blocks.begins[-min(self._invalid, len(blocks.begins))] - rules.MONITOR_LEAD, end)
        self._examiner.begin(Task(None, self.model, identify={"the latest samples": recording}))

    # --- learning ---------------------------------------------------------------------------------

    def _learn_block(self, mode: modes.Learning, begin: float, events: list[Event]) -> None:
        if self._compare(self._samples_of(begin), self.model) is None:
            # A rig at rest or hardly in motion provides no information.
            return
        oldest = float(self._samples.times[0]) + rules.MONITOR_LEAD
        self.mode = mode.add(begin, oldest, math.ceil(self.parameters.learning_time / COMPARED_TIME))
        if isinstance(self.mode, modes.Comparing):
            recording = self._learnt_samples(self.mode)
            identify = {OWN_RECORDING: recording}
            self._examiner.begin(Task(recording, self.healthy_rig, preferred=self._preferred(), identify=identify))
            text = f"{self.parameters.learning_time:g} s learnt; compared with the rig file"
            events.append(Event(begin + COMPARED_TIME, "learnt", text))

    def _learnt_samples(self, mode: modes.Comparing) -> Trajectory:
        return self._samples.between(mode.begins[0] - rules.MONITOR_LEAD, mode.begins[-1] + COMPARED_TIME)

    def _check_baselines(self) -> None:
        """Check that the healthy rig can be learnt from the recordings.

        Raises:
            BadInput: one cannot be compared with the rig, or they are too short.
        """
        recordings = self._baseline.recordings
        for name, recording in recordings.items():
            if self._compare(recording, self.rig) is None:
                raise BadInput(self._reason, name, "a recording of the healthy rig")
        parts = (part for recording in recordings.values() for part in _blocks_of(recording))
        if all(self._compare(part, self.rig) is None for part in parts):
            problem = f"no recording of the healthy rig has {COMPARED_TIME + rules.MONITOR_LEAD:g} s in which the piston moves"
            raise BadInput(problem, ", ".join(recordings), "longer recordings of the rig at work")

    def _identify_baselines(self) -> None:
        """Have the rig identified from the recordings of the healthy rig; meanwhile, samples wait."""
        self._pending = Task(None, self.rig, identify=self._baseline.recordings)
        self.mode = modes.Comparing(())

    def _learn_from_baselines(self) -> None:
        self._baseline.forget()
        compared = list[Evidence]()
        for recording in self._baseline.recordings.values():
            evidence = self._compare(recording, self.healthy_rig)
            if evidence is None:
                continue
            if not compared:
                self._baseline.choose_directions(evidence)
            compared.append(evidence)
            section = [block for samples in _blocks_of(recording) for block in self._scores(samples)]
            if section:
                self._baseline.sections.append(section)
        if not self._baseline.sections:
            # The identified rig cannot be compared with any block: the file's could.
            self.healthy_rig = self.model = self.rig
            self.identification = None
            self._learn_from_baselines()
            return
        self._baseline.learn_residuals(compared)
        self._begin_watching()

    def _begin_watching(self) -> None:
        hours = self.parameters.mean_time_between_false_alarms
        test = ChangeTest(self._baseline.statistics(), hours, self._baseline.powers)
        self.mode, self._reason = modes.Watching(modes.ScoredBlocks(test, self._averaged)), ""

    def _learn_anew(self) -> None:
        """Restart learning from the present rig."""
        self.mode = modes.Learning()
        self._forget_linearisation()
        self._baseline.forget()

    # --- examination ------------------------------------------------------------------------------

    def _examine(self, mode: modes.Examining, now: float, events: list[Event]) -> None:
        change, begins = mode.change, list(mode.blocks.begins)
        onset, earliest, latest = (begins[-min(n, len(begins))] for n in (change.blocks, change.earliest, change.latest))
        self._onset = onset, earliest, latest
        # The block of the onset is only partly changed.
        first = begins[1 - change.blocks]
        if change.blocks >= len(begins) - 1 and self._examined_from is not None:
            # The last named cause does not explain all samples since: use more samples.
            first = self._examined_from
        self._examined_from = max(first, now - self.parameters.kept_time)
        text = f"{self._baseline.quantity(change.quantity)} changed since {onset:.1f} s"
        events.append(Event(now, "noticed", text))
        recording, baselines = self._samples.between(self._examined_from, now), tuple(self._baseline.recordings.values())
        self._examiner.begin(Task(recording, self.healthy_rig, baselines, self._preferred(), identified=self.identification))

    def _preferred(self) -> tuple[str, ...]:
        """Return the effects preferred to equivalent ones: those named before, and those of the coefficients."""
        known = (change.name for change in self.changes if change.active and change.causes)
        return tuple(dict.fromkeys([*known, *(coefficient.effect for coefficient in COEFFICIENTS.values())]))

    def _follow_examination(self, events: list[Event], now: float | None = None) -> None:
        found = self._examiner.finding()
        if found is None:
            return
        now = float(self._samples.times[-1]) if now is None else now
        if isinstance(self.mode, modes.Comparing):
            if not self.mode.begins:
                self._identified(found.identification, now, events)
                self._learn_from_baselines()
            else:
                self._end_learning(self.mode, found, now, events)
        elif isinstance(self.mode, modes.Examining):
            self._end_examination(self.mode, found, now, events)
        elif self._identifying and found.identification is not None and not isinstance(self.mode, modes.Learning):
            self._linearisation = Linearisation(found.identification, self._averaged)
            self._readings = self._read(self.mode.blocks)

    def _identified(self, found: Identification | None, now: float, events: list[Event]) -> None:
        """Continue with the identified rig if numbers of the given one are wrong."""
        self.identification = found
        self._known = IdentifiedRig(self.healthy_rig) if found is None else found.tracked(self.healthy_rig)
        if found is not None and found.wrong:
            name = "rig file" if self.healthy_rig is self.rig else "healthy rig"
            events.append(Event(now, "differs", f"{name}: {written(found.wrong)}"))
            self.healthy_rig = self.model = found.rig

    def _end_examination(self, mode: modes.Examining, found: Finding, now: float, events: list[Event]) -> None:
        self.mode = mode.examined()
        change = mode.change
        enough = self._examined_from is not None and now - self._examined_from >= MIN_UNCERTAIN_TIME
        if found.is_certain or (found.names_causes and enough):
            self._name(found, self._onset, now, events)
        elif found.verdict == "unknown" and enough:
            new = self._add_change(found, self._onset, now)
            events.append(Event(now, "named", new.sentence()))
            # An unknown change cannot be included in the model.
            self._learn_anew()
        elif found.verdict == "consistent" and self.model is not self.healthy_rig:
            self._clear(self.changes, now, events)
            self.model = self.healthy_rig
            self._clear_blocks()
        elif now - mode.suspicion.noticed >= CONFIRMATION_TIME and not _drifts(change, mode.suspicion):
            text = "no diagnosis confirms the change: accepted as a new operating point"
            events.append(Event(now, "unconfirmed", text))
            self._baseline.learn_condition(mode.blocks.test.rows()[:, -change.blocks :])
            mode.blocks.test.learn(self._baseline.statistics())
            self._clear_blocks()

    def _end_learning(self, mode: modes.Comparing, found: Finding, now: float, events: list[Event]) -> None:
        self.mode = modes.Learning()
        recording, begin = self._learnt_samples(mode), mode.begins[0] - rules.MONITOR_LEAD
        if found.verdict == "insufficient":
            self._reason = found.reason
            events.append(Event(now, "insufficient", f"learning continues with further samples: {found.reason}"))
            return
        self._identified(found.identification, now, events)
        if found.identification is not None and found.identification.wrong:
            # Also where the first minutes do not identify them, the numbers of the file are in doubt.
            self._baseline.use(OWN_RECORDING, {OWN_RECORDING: recording})
        elif found.verdict == "consistent":
            self._baseline.kind = RIG_FILE
        elif found.verdict == "effect" and found.names_causes:
            self._baseline.kind = RIG_FILE
            for cause in found.causes:
                new = self._add_change(found._replace(causes=(cause,)), (begin, -math.inf, begin), now, before=True)
                events.append(Event(now, "differs", f"from the rig file from the beginning: {new.sentence()}"))
            self.healthy_rig = self.model = found.rig
        else:
            self._baseline.use(OWN_RECORDING, {OWN_RECORDING: recording})
            text = f"the rig is not the rig file's: {found.verdict}; {OWN_RECORDING} are the baseline"
            events.append(Event(now, "differs", text))
        evidence = self._compare(self._samples.between(begin, begin + DEPARTURE_TIME), self.model)
        if evidence is None:
            return
        self._baseline.choose_directions(evidence)
        self._baseline.learn_residuals([self._compare(recording, self.model)])
        section = list[Scores]()
        for block in mode.begins:
            section += self._scores(self._samples_of(block))
        if not section:
            return
        self._baseline.sections = [section]
        self._begin_watching()
        self._read_first(found.identification)
        events.append(Event(now, "watching", f"watched against {self._baseline.kind}"))

    def _clear_blocks(self) -> None:
        """Discard the tested blocks, which refer to another model."""
        if not isinstance(self.mode, modes.Learning | modes.Comparing):
            self.mode = modes.cleared(self.mode)
        self._baseline.forget_unchanged()
        self._forget_linearisation()

    def _forget_linearisation(self) -> None:
        """Read the coefficients around the model again."""
        self._linearisation, self._first_readings, self._identified_at = None, (), -math.inf
        self._identifying, self._invalid = False, 0

    # --- changes ----------------------------------------------------------------------------------

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
            new = self._add_change(found._replace(causes=(cause,)), times, now)
            events.append(Event(now, "named", new.sentence()))
        self.model = found.rig
        self._clear_blocks()
        self._read_first(found.identification)

    def _read_first(self, found: Identification | None) -> None:
        """Read the coefficients of an identification from samples of the present rig, until there are enough blocks."""
        if found is not None:
            self._first_readings = self._readings = identified_readings(found.tracked(found.rig), found.readings())

    def _add_change(self, found: Finding, times: tuple[float, float, float], now: float, before: bool = False) -> FoundChange:
        stage = found.causes[0].stage if found.causes else found.unknown_stage
        new = FoundChange(len(self.changes) + 1, found.causes, stage, found.depends_on, *times, now, now, before=before)
        self.changes.append(new)
        return new

    def _clear(self, gone: Sequence[FoundChange], now: float, events: list[Event]) -> None:
        for index, change in enumerate(self.changes):
            if change.active and not change.before and change in gone:
                self.changes[index] = change._replace(cleared=now)
                events.append(Event(now, "cleared", f"{change.name} is no longer detected"))

    # --- requests and results ---------------------------------------------------------------------

    def acknowledge(self) -> int:
        """Register that an operator has seen all changes, and return the number of new ones."""
        new = [i for i, change in enumerate(self.changes) if not change.acknowledged]
        for index in new:
            self.changes[index] = self.changes[index]._replace(acknowledged=True)
        return len(new)

    def accept(self) -> Rig | None:
        """Accept the rig with its changes as the healthy one from now on, and return it; None if there is none to accept.

        A running diagnosis of a change is aborted, as it refers to the previous healthy rig. If the baseline consists of
        recordings, the healthy rig is learnt again.
        """
        new = [i for i, change in enumerate(self.changes) if change.active and change.causes and not change.before]
        if not new:
            return None
        for index in new:
            self.changes[index] = self.changes[index]._replace(before=True, acknowledged=True)
        self.healthy_rig = self.model
        if self._baseline.kind == RIG_FILE:
            if isinstance(self.mode, modes.Examining):
                self._examiner.close()
            self._clear_blocks()
        else:
            self._examiner.close()
            self._baseline.use(RIG_FILE)
            self._learn_anew()
        return self.healthy_rig

    def reset(self) -> None:
        """Restart after a repair: clear all changes, and learn the healthy rig again.

        Given recordings of the healthy rig remain the baseline.
        """
        self._examiner.close()
        self._examined_from = None
        self.healthy_rig = self.model = self.rig
        if self.identification is not None and self.identification.wrong and self._baseline.kind == RECORDINGS:
            self.healthy_rig = self.model = self.identification.rig
        self._clear(self.changes, float(self._samples.times[-1]) if len(self._samples) else 0.0, [])
        if self._baseline.kind != RECORDINGS:
            self._baseline.use(RIG_FILE)
            self._learn_anew()
            self._reason = ""
        elif isinstance(self.mode, modes.Comparing) and not self.mode.begins:
            self._identify_baselines()
        elif isinstance(self.mode, modes.Learning | modes.Comparing):
            self._learn_from_baselines()
        else:
            self._clear_blocks()
            self.mode = modes.Watching(self.mode.blocks)

    def saved_state(self) -> SavedState:
        """Return the state from which another monitor of this rig can continue."""
        blocks = None if isinstance(self.mode, modes.Learning | modes.Comparing) else self.mode.blocks
        return SavedState(
            None if blocks is None else self._baseline.learnt(),
            self.healthy_rig,
            self.model,
            tuple(self.changes),
            tuple(self.history[-RATE_READINGS:]),
            self._readings,
            self._watched,
            () if blocks is None else tuple(blocks.begins),
            np.zeros((3, 0, 0)) if blocks is None else blocks.test.rows(),
            self.identification,
        )

    def restore(self, past: SavedState) -> None:
        """Restore the state of another monitor of this rig; called before the first sample.

        Args:
            past: state of that monitor, with times on the axis that is continued.
        """
        self.healthy_rig, self.model, self.identification = past.healthy_rig, past.model, past.identification
        self.changes, self.history = list(past.changes), list(past.history)
        self._readings, self._watched = past.readings, past.watched
        if past.learnt is None or bool(self._baseline.recordings) != (past.learnt.kind == RECORDINGS):
            return
        self._pending = None
        self._baseline.restore(past.learnt)
        if self._baseline.recordings:
            healthy = self._baseline.recordings.values()
            self._baseline.learn_residuals([self._compare(recording, self.healthy_rig) for recording in healthy])
        self._begin_watching()
        if isinstance(self.mode, modes.Watching) and len(past.begins) == past.rows.shape[1]:
            self.mode.blocks.restore(past.begins, past.rows)

    @property
    def reference(self) -> Rig:
        """The rig to whose values changes are relative: the rig file's, or the identified one if its numbers are wrong."""
        return self.identification.rig if self.identification is not None and self.identification.wrong else self.rig

    def health(self) -> Health:
        """Return the current health of the rig."""
        blocks = 0 if isinstance(self.mode, modes.Learning | modes.Comparing) else len(self.mode.blocks.recent)
        read_anew = bool(self._first_readings or self._linearisation) or blocks >= min(MIN_READING_BLOCKS, self._averaged)
        errors = {} if self.identification is None else self.identification.errors()
        changes, current = agreed(self.changes, self._readings, self.healthy_rig, read_anew, errors)
        return Health(
            float(self._samples.times[-1]) if len(self._samples) else math.nan,
            self.mode.state,
            self._reason,
            changes,
            current,
            self._watched,
            self._baseline.kind,
            float(np.mean(self._outside)) if self._outside else 0.0,
            rates(self.history),
            self.identification.wrong if self.identification is not None else {},
        )

    def close(self) -> None:
        """Abort a running diagnosis."""
        self._examiner.close()


def _blocks_of(recording: Trajectory) -> Iterator[Trajectory]:
    """Yield the parts of a recording that are compared at once, each with its lead."""
    time = recording.time_s
    for begin in np.arange(time[0], time[-1] - COMPARED_TIME - rules.MONITOR_LEAD, COMPARED_TIME):
        part = slice(*np.searchsorted(time, [begin, begin + rules.MONITOR_LEAD + COMPARED_TIME]))
        yield Trajectory(time[part] - time[part][0], {n: v[part] for n, v in recording.signals.items()})


def _drifts(change: Change, suspicion: modes.Suspicion) -> bool:
    """Return whether a change has grown since it was first noticed."""
    first = suspicion.first
    return change.ratio > first.ratio * math.pow(change.blocks / first.blocks, MIN_DRIFT_EXPONENT)
