"""Recordings monitored as if the rig ran."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
import yaml

from ehls_ros.diagnosis.monitoring.tracking import Reading
from ehls_ros.experiments.monitoring import offer as offers
from ehls_ros.experiments.monitoring import replay as replaying
from ehls_ros.experiments.monitoring.examination import FoundCause
from ehls_ros.experiments.monitoring.health import FoundChange, State
from ehls_ros.experiments.monitoring.monitor import Parameters
from ehls_ros.experiments.monitoring.offer import offer
from ehls_ros.experiments.monitoring.replay import MonitoredRecording, MonitoringResult, invalidate_equivalent, replay
from ehls_ros.experiments.spec import load_rig
from ehls_ros.trajectory import Trajectory
from truth_generator import record

RIG = Path(__file__).parents[2] / "config" / "rig_paper_measured.yaml"
SECONDS, LEARNT, ONSET = 60.0, 20.0, 35.0
EFFECT, PARAMETER, SIZE = "valve_gain_shift", "gain", 0.75
IN_TIME = LEARNT
"""Time after the onset within which a change must be named [s]: as long as the healthy rig took."""


class Made(NamedTuple):
    """A recording whose valve changes in its middle, and the results of its replay."""

    trajectory: Trajectory
    watched: MonitoringResult
    told: list


def watch(parts, **options):
    told = []
    rig = load_rig(RIG)
    parameters = Parameters(learning_time=LEARNT, reading_time=10.0)
    chosen = {"baselines": {}, "limits": {}, "progress": lambda *_: None, "on_event": told.append} | options
    return replay(parts, rig, parameters, **chosen), told


@pytest.fixture(scope="module")
def made() -> Made:
    mapping = yaml.safe_load(RIG.read_text())
    well, worn = (record(mapping, effects, "rich", seed=4, duration=SECONDS) for effects in ({}, {EFFECT: {PARAMETER: SIZE}}))
    first = int(np.searchsorted(well.time, ONSET))
    signals = {name: np.concatenate([values[:first], worn.columns[name][first:]]) for name, values in well.columns.items()}
    trajectory = Trajectory(well.time, signals)
    return Made(trajectory, *watch([MonitoredRecording("axis", trajectory)], limits={"valve_gain": 0.5}))


@pytest.mark.long
def test_a_hidden_change_is_named_in_time_with_its_size_and_onset(made):
    [change] = made.watched.health.changes
    assert change.name == EFFECT
    assert ONSET < change.noticed <= change.named < ONSET + IN_TIME
    assert abs(change.since - ONSET) < 5.0
    found = change.causes[0].parameters[PARAMETER]
    assert found.value == pytest.approx(SIZE, abs=5.0 * found.std)
    assert found.std < 0.05 * abs(SIZE)


@pytest.mark.long
def test_nothing_is_noticed_while_the_rig_is_healthy(made):
    assert [event.kind for event in made.told if event.time < ONSET] == ["learnt", "watching"]
    assert made.told == list(made.watched.events)
    assert made.watched.health.state == State.WATCHING


@pytest.mark.long
def test_the_coefficients_are_tracked_with_intervals(made):
    before = [past for past in made.watched.history if past.time < ONSET]
    assert len(before) >= 1
    friction = load_rig(RIG).friction
    for past in before:
        [reading] = [one for one in past.readings if one.name == "coulomb_force"]
        assert reading.identified
        assert reading.value == pytest.approx(friction.coulomb_force, abs=6.0 * reading.deviation + 2.0)
    assert set(made.watched.limits) == {"valve_gain"}


class Listening:
    """Stand-in for the monitor that records its inputs."""

    def __init__(self, rig, *_):
        self.reference = rig
        self.given, self.interrupts, self.history = [], [], ()
        Listening.last = self

    def add(self, time_s, signals):
        assert all(len(values) == len(time_s) for values in signals.values())
        self.given.append(time_s)
        return []

    def interrupt(self):
        self.interrupts.append(sum(map(len, self.given)))

    def close(self):
        pass

    def health(self):
        return replaying.Health(0.0, State.IDLE, "", (), (), 0.0, "", 0.0, {})


@pytest.mark.long
def test_what_was_not_driven_is_not_given_and_begins_a_new_stretch(made, monkeypatch):
    monkeypatch.setattr(replaying, "Monitor", Listening)
    whole = made.trajectory
    short = Trajectory(whole.time_s[:3000] + 100.0, {name: values[:3000] for name, values in whole.signals.items()})
    watched, _ = watch([MonitoredRecording("one", short, ((100.9995, 101.9995),)), MonitoredRecording("two", short)])
    times = np.concatenate(Listening.last.given)
    assert len(times) == 2000 + 3000
    assert np.all(np.diff(times) > 0.0)
    # At the begin of each recording, and where driving ended.
    assert Listening.last.interrupts == [0, 1000, 2000]
    one, two = watched.stretches
    assert (one.begin, one.end, one.not_driven) == pytest.approx((0.0, 2.999, 1.0))
    assert two.begin == times[2000] > one.end
    assert two.not_driven == 0.0


@pytest.mark.parametrize(("name", "told"), [("external_leakage", False), ("internal_leakage_shift", True)])
def test_a_coefficient_that_a_look_alike_has_taken_over_is_not_told(name, told):
    alike = ({"external_leakage", "internal_leakage_shift"} - {name}).pop()
    cause = FoundCause(name, "flow", 0.5, (alike,), {})
    change = FoundChange(1, (cause,), "flow", (), 1.0, 1.0, 1.0, 2.0, 2.0)
    given = [Reading("leakage_coefficient", 4.7e-12, 1e-14, "m^5/(N s)"), Reading("valve_gain", 1.0, 1e-4, "1")]
    leakage, gain = invalidate_equivalent(given, [change])
    assert leakage.identified is told
    assert ("a leakage to the outside, which is indistinguishable" in leakage.why_not) is not told
    assert gain == given[1]


def test_the_shortest_experiment_that_tells_the_rest_is_offered(monkeypatch):
    few = ("pressure_staircase", "velocity_sweep")
    monkeypatch.setattr(offers, "CATALOGUE", {name: offers.CATALOGUE[name] for name in few})
    rig = load_rig(RIG)
    found = offer(["coulomb_force"], rig)
    assert (found.name, found.tells) == ("velocity_sweep", ("coulomb_force",))
    assert found.seconds == found.repeats * found.spec["duration"]
    assert offer([], rig) is None
    # Without the force no experiment determines the friction.
    assert offer(["coulomb_force"], rig, ["position_m", "valve_command_m", "spool_m"]) is None


@pytest.mark.long
def test_a_leak_of_one_chamber_is_named_on_a_single_rod():
    path = RIG.with_name("rig_single_rod.yaml")
    sizes = {"external_leakage": {"coefficient": 1e-12, "side": "a"}}
    made = record(yaml.safe_load(path.read_text()), {}, "rich", seed=4, duration=SECONDS, growth=[(ONSET, sizes)])
    watched = replay(
        [MonitoredRecording("rod", Trajectory(made.time, made.columns))],
        load_rig(path),
        Parameters(learning_time=LEARNT, reading_time=10.0),
        baselines={},
        limits={},
        progress=lambda *_: None,
        on_event=lambda _: None,
    )
    [change] = watched.health.changes
    assert change.name == "external_leakage"
    assert ONSET < change.noticed <= change.named < ONSET + IN_TIME
    [cause] = change.causes
    assert cause.parameters.keys() == {"first"}
    # What a rig with two chambers does not have is not missing.
    assert {"discharge_coefficient", "orifice_null"}.isdisjoint(watched.missing)
