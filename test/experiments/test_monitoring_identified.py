"""The monitor's start from the identified rig, and the agreement of its headline with its table."""

import math
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import yaml

from ehls_ros.diagnosis.monitoring.tracking import COEFFICIENTS, Reading
from ehls_ros.estimate import Estimate
from ehls_ros.experiments import baseline
from ehls_ros.experiments.monitoring import examination
from ehls_ros.experiments.monitoring.examination import Finding, FoundCause, Task
from ehls_ros.experiments.monitoring.health import FoundChange, agreed
from ehls_ros.experiments.monitoring.identified import identify, with_shifts_included, written
from ehls_ros.experiments.monitoring.monitor import Monitor, Parameters
from ehls_ros.experiments.monitoring.saved_state import state_of, state_record
from ehls_ros.experiments.state_files.kinds import MonitorState
from ehls_ros.experiments.state_files.state_file import Origin
from ehls_ros.physics.rig import effects_from_list, rig_from_mapping
from ehls_ros.schema import parse
from ehls_ros.trajectory import Trajectory
from truth_generator import record

RIG_FILE = Path(__file__).parents[2] / "config" / "rig_paper_measured.yaml"
DETUNED = {"leakage_coefficient": 0.6, "bulk_modulus": 1.4, "discharge_coefficient": 0.7, "moving_mass": 1.3}


@pytest.fixture(scope="module")
def content():
    return yaml.safe_load(RIG_FILE.read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def rig(content):
    return rig_from_mapping(content, RIG_FILE.name)


@pytest.fixture(scope="module")
def draft(rig):
    return rig.with_plant(**{name: factor * getattr(rig.plant, name) for name, factor in DETUNED.items()})


@pytest.fixture(scope="module")
def healthy(content):
    r = record(content, {}, "rich", seed=31, duration=25.0)
    return Trajectory(r.time, dict(r.columns))


class Identifying:
    """Examiner that identifies the rig and finds no change."""

    def __init__(self):
        self.tasks, self.found = [], None

    def begin(self, task):
        self.tasks.append(task)
        self.found = Finding("consistent", (), task.rig, identification=identify(task.identify, task.rig))

    def finding(self):
        found, self.found = self.found, None
        return found

    def close(self):
        self.found = None


@pytest.fixture(scope="module")
def started(draft, healthy):
    """A monitor with a first-draft rig file, after the first samples."""
    monitor = Monitor(draft, Parameters(), Identifying(), {"old": healthy})
    time = healthy.time_s[:12000]
    events = monitor.add(time, {name: values[:12000] for name, values in healthy.signals.items()})
    return monitor, events


@pytest.mark.long
def test_the_readings_start_from_the_identified_rig(rig, started):
    monitor, events = started
    assert [event.kind for event in events] == ["differs"]
    assert "bulk_modulus 9.66e+08, the recordings say 6." in events[0].text
    assert set(monitor.health().rig_values) == {f"plant.{name}" for name in DETUNED}
    told = {reading.name: reading for reading in monitor.health().readings if reading.identified}
    assert set(DETUNED) <= set(told)
    for name in DETUNED:
        assert abs(told[name].value - COEFFICIENTS[name].given(rig)) < 4.0 * told[name].deviation, name


@pytest.mark.long
def test_the_numbers_of_a_right_file_stay(rig, healthy):
    found = identify({"healthy": healthy}, rig)
    assert found.wrong == {}
    assert written(found.wrong) == ""


@pytest.mark.long
def test_the_identified_rig_is_in_the_memory(draft, started):
    monitor, _ = started
    origin = Origin.of(draft, 1e-3)
    recorded = {"baselines": [], "end": 12.0, "anchors": [], **state_record(monitor.saved_state())}
    state = parse(MonitorState, recorded, "memory")
    kept = state_of(state, origin, None, (), np.zeros((3, 0, 0)))
    assert kept.healthy_rig == monitor.healthy_rig != draft
    assert kept.identification == monitor.identification._replace(whole=None)


@pytest.mark.long
def test_a_change_is_judged_against_the_rig_that_was_identified_first(draft, healthy, started, monkeypatch):
    monitor, _ = started

    def again(*_, **__):
        raise AssertionError("the baselines were identified again")

    monkeypatch.setattr(baseline, "identify_rig", again)
    task = Task(healthy, draft, (healthy,), identified=monitor.identification)
    assert examination._diagnosed(task, healthy).verdict == "consistent"


def test_a_null_that_the_rig_has_may_change_further(rig, monkeypatch):
    [null] = effects_from_list([{"name": "valve_null_bias", "command": -6e-6, "opening": 2e-6}], "test")
    size = {"command": Estimate(3e-6, 1e-7, "m")}
    cause = SimpleNamespace(
        name="valve_null_bias", stage="valve", probability=1.0, equivalent_to=(), parameters=size, fixed={}, rivals=()
    )

    def diagnosed(recording, given, *_, **__):
        assert given.effects == (null,)
        return SimpleNamespace(
            verdict="effect", causes=(cause,), rig=given, unknown_stage=None, depends_on=(), missing=(), wall_s=0.0
        )

    monkeypatch.setattr(examination, "diagnose", diagnosed)
    recording = Trajectory(np.arange(100) * 1e-3, {"valve_command_m": np.zeros(100)})
    found = examination._diagnosed(Task(recording, rig.with_effects((null,))), recording)
    assert found.causes[0].parameters == size
    assert [use.parameters for use in found.rig.effects] == [pytest.approx((-3e-6, 2e-6))]


def test_shifts_are_included_in_the_coefficients(rig):
    uses = effects_from_list([{"name": "mass_shift", "factor": 1.2}, {"name": "constant_load", "force": 50.0}], "test")
    whole = with_shifts_included(rig.with_effects(uses))
    assert whole.plant.moving_mass == pytest.approx(1.2 * rig.plant.moving_mass)
    assert [use.name for use in whole.effects] == ["constant_load"]


def test_a_total_is_set_by_the_last_use_of_an_effect(rig):
    leak = effects_from_list([{"name": "internal_leakage_shift", "added": 1e-12}], "test")
    leakage = COEFFICIENTS["leakage_coefficient"]
    total = examination._with_total(rig.with_effects(leak), leakage, 9e-12)
    assert leakage.given(total) == pytest.approx(9e-12)
    mass = COEFFICIENTS["moving_mass"]
    heavier = rig.with_effects(effects_from_list([{"name": "mass_shift", "factor": 1.2}], "t"))
    assert mass.given(examination._with_total(heavier, mass, 91.0)) == pytest.approx(91.0)


@pytest.mark.parametrize("anew", [True, False])
def test_headline_and_table_have_the_same_number(rig, anew):
    cause = FoundCause("internal_leakage_shift", "flow", 0.9, (), {"added": Estimate(2e-12, 1e-13, "m^5/(N s)")})
    change = FoundChange(1, (cause,), "flow", (), 1.0, 1.0, 1.0, 2.0, 2.0)
    before = rig.plant.leakage_coefficient
    read = (Reading("leakage_coefficient", before + 3e-12, 2e-13, "m^5/(N s)"), Reading("valve_gain", 1.0, 1e-3, "1"))
    [now], readings = agreed((change,), read, rig, anew, {})
    size = now.causes[0].parameters["added"]
    assert readings[0].value - before == pytest.approx(size.value)
    assert readings[0].deviation == pytest.approx(size.std)
    assert size.value == pytest.approx(3e-12 if anew else 2e-12)
    assert readings[1] == read[1]


def test_the_size_of_a_change_has_the_errors_of_both_identifications(rig):
    cause = FoundCause("mass_shift", "force_balance", 0.9, (), {"factor": Estimate(1.2, 0.01, "1")})
    change = FoundChange(1, (cause,), "force_balance", (), 1.0, 1.0, 1.0, 2.0, 2.0)
    before = rig.plant.moving_mass
    read = (Reading("moving_mass", 1.1 * before, 0.003 * before, "kg"),)
    [now], _ = agreed((change,), read, rig, True, {"moving_mass": 0.004 / 1.1 * before})
    assert now.causes[0].parameters["factor"] == (pytest.approx(1.1), pytest.approx(0.005), "1")


def test_what_is_not_identified_gives_no_size(rig):
    cause = FoundCause("mass_shift", "force_balance", 0.9, (), {"factor": Estimate(1.2, 0.01, "1")})
    change = FoundChange(1, (cause,), "force_balance", (), 1.0, 1.0, 1.0, 2.0, 2.0)
    read = (Reading("moving_mass", 70.0, math.inf, "kg", "not excited by the programme"),)
    assert agreed((change,), read, rig, True, {}) == ((change,), read)
