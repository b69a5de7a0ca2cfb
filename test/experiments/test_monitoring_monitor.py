"""The monitor as a whole: its reports on samples, with diagnoses supplied by the test."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from ehls_ros.errors import BadInput
from ehls_ros.estimate import Estimate
from ehls_ros.experiments.monitoring.baseline import RECORDINGS
from ehls_ros.experiments.monitoring.examination import Finding, FoundCause
from ehls_ros.experiments.monitoring.health import State
from ehls_ros.experiments.monitoring.modes import Examining, Learning, Watching
from ehls_ros.experiments.monitoring.monitor import Monitor, Parameters
from ehls_ros.physics.rig import effects_from_list, rig_from_mapping
from ehls_ros.trajectory import Trajectory
from truth_generator import record

RIG_FILE = Path(__file__).parents[2] / "config" / "rig_paper_measured.yaml"
ONSET, END = 52.0, 75.0
LEAK = {"internal_leakage_shift": {"factor": 1.6}}


@pytest.fixture(scope="module")
def rig_file():
    return yaml.safe_load(RIG_FILE.read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def rig(rig_file):
    return rig_from_mapping(rig_file, RIG_FILE.name)


@pytest.fixture(scope="module")
def streams(rig_file):
    """A healthy rig, and one that begins to leak in the middle, driven identically."""
    well, leaking = (record(rig_file, effects, "rich", seed=9, duration=END) for effects in ({}, LEAK))
    here = well.time < ONSET
    return well.time, dict(well.columns), {n: np.where(here, well.columns[n], leaking.columns[n]) for n in well.columns}


class Scripted:
    """Examiner with the expected diagnoses of a test, which records its tasks."""

    def __init__(self, *findings):
        self.findings, self.tasks, self.ready, self.held = list(findings), [], False, False

    def begin(self, task):
        self.tasks.append(task)
        self.ready = True

    def finding(self):
        if not self.ready or self.held:
            return None
        self.ready = False
        return self.findings.pop(0)

    def close(self):
        self.ready = False


def consistent(rig):
    return Finding("consistent", (), rig)


def leaking(rig, probability=0.99):
    size = 0.6 * rig.plant.leakage_coefficient
    use = effects_from_list([{"name": "internal_leakage_shift", "added": size}], "test")
    cause = FoundCause("internal_leakage_shift", "flow", probability, (), {"added": Estimate(size, 0.01 * size, "m^5/(N s)")})
    return Finding("effect", (cause,), rig.with_effects(use))


def watched(rig, time, signals, *findings, pieces=75):
    examiner = Scripted(*findings)
    monitor = Monitor(rig, Parameters(learning_time=30.0), examiner)
    events = []
    for part in np.array_split(np.arange(len(time)), pieces):
        events += monitor.add(time[part], {name: values[part] for name, values in signals.items()})
    return monitor, examiner, events


def kinds(events):
    return [event.kind for event in events]


def test_a_change_is_noticed_named_and_in_the_model_from_then_on(rig, streams):
    time, _, signals = streams
    monitor, examiner, events = watched(rig, time, signals, consistent(rig), leaking(rig))
    assert kinds(events) == ["learnt", "watching", "noticed", "named"]
    [change] = monitor.changes
    assert change.name == "internal_leakage_shift"
    assert change.earliest <= ONSET <= change.latest + 5.0
    # The diagnosed samples are those after the onset.
    assert examiner.tasks[1].recording.time_s[-1] <= END - ONSET
    assert [use.name for use in monitor.model.effects] == ["internal_leakage_shift"]
    identified = {reading.name: reading for reading in monitor.health().readings}
    leakage = identified["leakage_coefficient"]
    assert abs(leakage.value - 1.6 * rig.plant.leakage_coefficient) < 4.0 * leakage.deviation


@pytest.mark.long
def test_the_onset_is_that_of_the_detection_however_long_the_diagnosis_takes(rig, streams):
    time, _, signals = streams
    examiner, events = Scripted(consistent(rig), leaking(rig)), []
    monitor = Monitor(rig, Parameters(learning_time=30.0), examiner)
    for part in np.array_split(np.arange(len(time)), 75):
        examiner.held = 40.0 < time[part[0]] < 72.0
        events += monitor.add(time[part], {name: values[part] for name, values in signals.items()})
    assert kinds(events) == ["learnt", "watching", "noticed", "named"]
    assert monitor.changes[0].named > 72.0
    assert monitor.changes[0].earliest <= ONSET <= monitor.changes[0].latest + 5.0


@pytest.mark.long
def test_a_healthy_rig_gives_no_word_over_gaps_and_a_restart_of_its_time(rig, streams):
    time, signals, _ = streams
    late = np.where(time > 45.0, time + 10.0, time)
    monitor, _, events = watched(rig, late, signals, consistent(rig))
    assert kinds(events) == ["learnt", "watching"]
    health = monitor.health()
    assert health.state == State.WATCHING
    assert not health.changes


@pytest.mark.long
def test_a_cause_in_doubt_waits_for_more_samples(rig, streams):
    time, _, signals = streams
    findings = [consistent(rig), *[leaking(rig, 0.6)] * 4]
    monitor, examiner, events = watched(rig, time, signals, *findings)
    assert "named" not in kinds(events)
    assert not monitor.changes
    # Each time with more samples.
    lengths = [task.recording.time_s[-1] for task in examiner.tasks[1:]]
    assert lengths == sorted(lengths)
    assert len(lengths) >= 2


@pytest.mark.long
def test_samples_that_cannot_be_judged_teach_nothing(rig, streams):
    time, signals, _ = streams
    refused = Finding("insufficient", (), rig, reason="the piston hardly moves")
    monitor, _, events = watched(rig, time, signals, refused, consistent(rig))
    assert kinds(events) == ["learnt", "insufficient", "learnt", "watching"]
    assert not monitor.changes


@pytest.mark.long
def test_what_no_diagnosis_confirms_is_an_operating_point_only_after_a_minute(rig, rig_file):
    healthy, leaking = (record(rig_file, effects, "rich", seed=11, duration=165.0) for effects in ({}, LEAK))
    here = healthy.time < ONSET
    signals = {n: np.where(here, healthy.columns[n], leaking.columns[n]) for n in healthy.columns}
    _, examiner, events = watched(rig, healthy.time, signals, *[consistent(rig)] * 12, pieces=165)
    noticed = next(event for event in events if event.kind == "noticed")
    [accepted] = [event for event in events if event.kind == "unconfirmed"]
    assert accepted.time >= noticed.time + 60.0
    assert kinds(events).index("unconfirmed") > kinds(events).index("noticed") + 1
    assert examiner.findings


@pytest.mark.long
def test_what_differs_from_the_beginning_is_part_of_the_baseline(rig, rig_file):
    r = record(rig_file, LEAK, "rich", seed=10, duration=45.0)
    monitor, _, events = watched(rig, r.time, dict(r.columns), leaking(rig))
    assert kinds(events) == ["learnt", "differs", "watching"]
    assert monitor.healthy_rig is monitor.model
    assert monitor.changes[0].before
    assert monitor.accept() is None
    [leakage] = [reading for reading in monitor.health().readings if reading.name == "leakage_coefficient"]
    assert leakage.identified
    assert abs(leakage.value - 1.6 * rig.plant.leakage_coefficient) < 4.0 * leakage.deviation


@pytest.mark.long
def test_an_accepted_change_is_the_healthy_rig(rig, streams):
    time, _, signals = streams
    monitor, _, _ = watched(rig, time, signals, consistent(rig), leaking(rig))
    assert monitor.accept() is monitor.model
    assert monitor.healthy_rig is monitor.model
    assert monitor.changes[0].before
    assert monitor.accept() is None
    assert monitor.acknowledge() == 0


@pytest.mark.long
def test_a_change_that_no_diagnosis_names_any_more_has_cleared(rig, streams):
    time, healthy, signals = streams
    monitor, examiner, _ = watched(rig, time, signals, consistent(rig), leaking(rig), consistent(rig))
    assert monitor.changes[0].active
    begin = time[-1] + 0.001
    for part in np.array_split(np.arange(30000), 30):
        monitor.add(begin + time[part], {name: values[part] for name, values in healthy.items()})
    assert not examiner.findings
    assert not monitor.changes[0].active
    assert monitor.model is monitor.healthy_rig


@pytest.mark.long
def test_recordings_of_the_healthy_rig_are_the_baseline_and_one_that_is_too_short_is_refused(rig, streams):
    time, healthy, leak = streams
    recording = Trajectory(time, healthy)
    monitor = Monitor(rig, Parameters(), Scripted(consistent(rig), leaking(rig)), {"old": recording})
    assert monitor.health().baseline == RECORDINGS
    later = time >= ONSET
    events = monitor.add(time[later], {name: values[later] for name, values in leak.items()})
    assert kinds(events) == ["noticed", "named"]
    short = Trajectory(time[:4000], {name: values[:4000] for name, values in healthy.items()})
    with pytest.raises(BadInput, match="in which the piston moves"):
        Monitor(rig, Parameters(), Scripted(), {"short": short})


@pytest.mark.long
def test_acceptance_aborts_a_diagnosis_against_the_previous_healthy_rig(rig, streams):
    time, _, signals = streams
    monitor, examiner, _ = watched(rig, time, signals, consistent(rig), leaking(rig))
    begin, events = time[-1] + 0.001, []
    with_offset = dict(signals) | {"position_m": 1.1 * signals["position_m"], "velocity_m_s": 1.1 * signals["velocity_m_s"]}
    examiner.held = True
    for first in range(52000, 75000, 1000):
        part = slice(first, first + 1000)
        events += monitor.add(begin + time[part], {name: values[part] for name, values in with_offset.items()})
        if isinstance(monitor.mode, Examining):
            break
    assert kinds(events) == ["noticed"]
    assert monitor.accept() is monitor.healthy_rig
    assert isinstance(monitor.mode, Watching)
    assert not examiner.ready
    assert monitor.add(begin + time[75000:], {}) == []


@pytest.mark.long
def test_a_reset_while_an_unknown_rig_is_learnt_returns_to_the_recordings(rig, streams):
    time, healthy, leak = streams
    recording = Trajectory(time[:20000], {name: values[:20000] for name, values in healthy.items()})
    unknown = Finding("unknown", (), rig, "flow")
    monitor = Monitor(rig, Parameters(), Scripted(consistent(rig), *[unknown] * 3), {"old": recording})
    repeated = np.concatenate([time[52000:], time[52000:] + 23.0])
    monitor.add(repeated, {name: np.tile(values[52000:], 2) for name, values in leak.items()})
    assert isinstance(monitor.mode, Learning)
    assert monitor.health().baseline == RECORDINGS
    monitor.reset()
    assert isinstance(monitor.mode, Watching)
    assert monitor.saved_state().learnt.sections
