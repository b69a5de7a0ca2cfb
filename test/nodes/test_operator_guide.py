"""The operator of a run gets the commands that resume operation, once for each stop."""

import pytest

pytest.importorskip("ehls_msgs.msg._loader_state", reason="needs ehls_msgs built, as `make setup` does")

from ehls_ros.hardware.safety_gate import ACTIVE, CUT, DISABLED, POSITION_CONTROL, STOPPED, UNLOADING, steps_to_drive
from ehls_ros.nodes.operator_guide import OperatorGuide

STOP = {"state": "stopped", "stop": "stop-1", "cause_1": "emergency stop at 2.500000 s, cut"}
TRIP = {"state": "cut", "stop": "", "cause_1": "force: 17000 N, limit 16380 N at 3.000000 s, cut"}


@pytest.mark.parametrize(
    ("state", "stop", "steps"),
    [
        (STOPPED, "stop-2", ("acknowledge stop-2", "reset", "enable")),
        (CUT, "", ("reset", "enable")),
        (POSITION_CONTROL, "", ("unload", "reset", "enable")),
        (UNLOADING, "", ("reset", "enable")),
        (DISABLED, "", ("enable",)),
        (ACTIVE, "", ()),
    ],
)
def test_the_steps_follow_from_the_state(state, stop, steps):
    assert steps_to_drive(state, stop) == steps


def test_each_stop_is_told_once_with_the_commands_and_the_domain(monkeypatch):
    monkeypatch.setenv("ROS_DOMAIN_ID", "37")
    lines = []
    guide = OperatorGuide(lines.append, has_programme=True)
    guide.follow({"state": "active", "stop": ""})
    assert not lines
    assert not guide.has_tripped
    for _ in range(3):
        guide.follow(STOP)
    assert lines[0].startswith("Tripped: emergency stop requested, at 2.500 s.")
    commands = ["rig acknowledge stop-1", "rig reset", "rig enable", "programme resume"]
    assert [line.strip() for line in lines[1:-1]] == [f"ROS_DOMAIN_ID=37 ehls {command}" for command in commands]
    lines.clear()
    # Acknowledged, reset, enabled.
    guide.follow({**STOP, "state": "cut", "stop": ""})
    guide.follow({"state": "disabled", "stop": ""})
    assert not lines
    guide.follow({"state": "enabling", "stop": ""})
    guide.follow({"state": "active", "stop": ""})
    assert lines == ["The rig is enabled again; ROS_DOMAIN_ID=37 ehls programme resume continues the programme."]
    assert guide.has_tripped
    assert not guide.tripped


def test_a_held_piston_is_told_with_unload_first():
    lines = []
    guide = OperatorGuide(lines.append)
    guide.follow({"state": "position control", "stop": "", "cause_1": "specimen: 0.2, limit 0.5 at 3.000000 s, position"})
    assert "The gate holds the piston in its position." in lines[0]
    assert [line.split("ehls ")[-1] for line in lines[1:-1]] == ["rig unload", "rig reset", "rig enable"]


def test_the_end_of_a_run_is_no_trip():
    lines = []
    guide = OperatorGuide(lines.append)
    guide.follow({"state": "cut", "stop": "", "cause_1": "left active at 5.000000 s, cut"})
    assert not lines
    assert not guide.has_tripped


def test_another_trip_is_told_again():
    lines = []
    guide = OperatorGuide(lines.append)
    guide.follow(TRIP)
    guide.follow({**TRIP, "cause_1": "velocity: 2 m/s, limit 1.8 m/s at 4.000000 s, ramp"})
    assert sum(line.startswith("Tripped: ") for line in lines) == 2
    assert not any("programme" in line for line in lines)


@pytest.mark.parametrize(
    ("options", "after", "ends"),
    [
        ({}, TRIP, False),
        ({"attended": False}, TRIP, True),
        ({"attended": False}, STOP, False),
        ({"end_on_trip": True}, STOP, True),
    ],
)
def test_only_a_trip_that_nobody_would_clear_ends_a_run_unasked(options, after, ends):
    lines = []
    guide = OperatorGuide(lines.append, **options)
    guide.follow(after)
    assert guide.ends_run is ends
    assert bool(lines) is not ends
