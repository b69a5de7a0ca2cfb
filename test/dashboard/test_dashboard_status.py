"""The page's status line for a snapshot."""

import pytest

from ehls_ros.dashboard.graph import GraphSnapshot, NodeHealth, StartProgress
from ehls_ros.dashboard.status import BAD, GOOD, WARNING, Remedy, explained, programme_line, programme_requests, status_of
from ehls_ros.experiments.files import config_folder
from ehls_ros.experiments.spec import load_rig
from ehls_ros.hardware.safety_gate import LEFT, STOP, Cause, Gate


def plant(level=0, message="active", **figures):
    return NodeHealth("plant_sim_node", level, message, {"state": "active", "owner": "nobody", **figures})


def said(*health, rate=1000.0, graph_seen=True, **more):
    return status_of(GraphSnapshot(rate=rate, period=1e-3, health=health, **more), graph_seen=graph_seen)


TRIP = {"state": "cut", "cause_1": "velocity: 1.23457 m/s, limit 0.9 m/s at 3.2 s, cut"}


def test_a_trip_says_what_happened_why_and_what_to_press_and_nothing_else_is_said():
    slow = NodeHealth("fasmc_node", 1, "too slow: 500 of 1000 cycles/s", {})
    status = said(plant(2, "cut, tripped by velocity; reset_trips and enable to go on", **TRIP), slow)
    assert status.text == "tripped, valve closed, 1000 cycles/s"
    assert status.remedy is Remedy.RESET
    assert status.trouble == (
        "Tripped: velocity beyond its limit: 1235 mm/s, allowed 900 mm/s, at 3.200 s. The valve is closed."
        " To go on: Reset and enable."
    )


LOST = "specimen: 0.2, limit 0.5 at 3 s, position"


@pytest.mark.parametrize(
    ("state", "text", "trouble", "remedy"),
    [
        (
            "position control",
            "tripped, piston held",
            "The gate holds the piston in its position. To go on: Unload, then Reset and enable.",
            Remedy.UNLOAD,
        ),
        (
            "unloading",
            "tripped, unloading",
            "The gate unloads the rig, and then closes the valve. To go on: Reset and enable.",
            Remedy.RESET,
        ),
    ],
)
def test_a_take_over_is_not_called_a_closed_valve(state, text, trouble, remedy):
    status = said(plant(2, f"{state}, tripped", state=state, cause_1=LOST))
    assert (status.text, status.remedy) == (f"{text}, 1000 cycles/s", remedy)
    assert status.trouble.endswith(trouble)
    assert status.trouble.startswith("Tripped: failed specimen or load cell: 0.2, allowed 0.5, at 3.000 s.")


def test_an_unloading_on_request_is_neither_running_nor_a_trip():
    status = said(plant(0, "unloading", state="unloading"))
    assert (status.text, status.level, status.trouble, status.remedy) == ("unloading, 1000 cycles/s", WARNING, "", None)


def test_an_emergency_stop_is_acknowledged_first():
    status = said(plant(2, "stopped", state="stopped", stop="stop-1", cause_1="emergency stop at 1 s, cut"))
    assert status.text.startswith("stopped")
    assert status.remedy is Remedy.ACKNOWLEDGE


@pytest.mark.parametrize(
    ("cause", "sentence"),
    [
        (
            Cause("load_pressure", "cut", 1.0, 6.5e6, 6.3e6, "Pa"),
            "Tripped: load pressure beyond its limit: 6.5 MPa, allowed 6.3 MPa, at 1.000 s.",
        ),
        (
            Cause("force", "cut", 1.0, -16440.0, 16380.0, "N"),
            "Tripped: force beyond its limit: -16.44 kN, allowed 16.38 kN, at 1.000 s.",
        ),
        (
            Cause("sensor_jump", "ramp", 1.0, 2e5, 1e5, "Pa/s", "load_pressure_pa"),
            "Tripped: reading changes faster than the rig can (load_pressure_pa): 2e+05 Pa/s, allowed 1e+05 Pa/s, at 1.000 s.",
        ),
        (
            Cause("supply_mismatch", "ramp", 1.0, 8e5, 7e5, "Pa"),
            "Tripped: readings that contradict each other: 0.8 MPa, allowed 0.7 MPa, at 1.000 s.",
        ),
        (Cause("device_null", "cut", 1.0), "Tripped: the device itself keeps the valve closed, at 1.000 s."),
        (Cause(STOP, "cut", 1.0), "Tripped: emergency stop requested, at 1.000 s."),
        (Cause(LEFT, "cut", 1.0), "Tripped: the plant node ended its loop while commands reached the valve, at 1.000 s."),
    ],
)
def test_a_cause_is_a_sentence_with_value_and_limit_in_one_unit(cause, sentence):
    assert explained(f"{cause} at {cause.time:.6f} s, {cause.reaction}") == sentence


def test_every_detector_of_the_gate_has_words():
    for detector in Gate(load_rig(config_folder() / "rig_paper.yaml"), 1e-3).detectors.values():
        cause = Cause(detector.name, "cut", 1.0, 2.0, 1.0, detector.unit or "m")
        # Otherwise its name would replace the words.
        assert not explained(f"{cause} at 1 s, cut").startswith(f"Tripped: {detector.name.replace('_', ' ')}:")


def test_what_cannot_be_understood_is_shown_as_it_is():
    assert explained("<b>no") == "Tripped by <b>no."


@pytest.mark.parametrize(
    ("status", "text", "level", "trouble"),
    [
        (said(plant()), "running, 1000 cycles/s", GOOD, ""),
        (said(plant(), rate=500.0), "running, 500 cycles/s, 0.5 times real time", GOOD, ""),
        # The last report of a plant that is gone or not yet there is not shown beside that.
        (said(plant(**TRIP), rate=0.0, complaint="plant_sim_node died: oil"), "graph gone", BAD, "plant_sim_node died: oil"),
        (said(plant(**TRIP), rate=0.0, starting=StartProgress(3.0, {})), "starting, 3 s", WARNING, ""),
        (said(plant(), rate=0.0, graph_seen=False), "no graph", WARNING, ""),
        (said(plant(), complaint="fasmc_node died: oil"), "a node died, 1000 cycles/s", BAD, "fasmc_node died: oil"),
        (
            said(plant(1, "too slow: 5 of 9 cycles/s")),
            "too slow, 1000 cycles/s",
            WARNING,
            "plant_sim_node: too slow: 5 of 9 cycles/s",
        ),
        (said(NodeHealth("x", 2, "broken", {}), plant()), "running, 1000 cycles/s", BAD, "x: broken"),
    ],
)
def test_one_thing_is_said_at_a_time(status, text, level, trouble):
    assert (status.text, status.level, status.trouble, status.remedy) == (text, level, trouble, None)


def test_a_closed_gate_is_not_called_running_and_can_be_enabled():
    status = said(plant(state="disabled"))
    assert (status.text, status.remedy) == ("valve closed, 1000 cycles/s", Remedy.ENABLE)


PROGRAMME = {
    "programme": "bracket", "programme_state": "running", "block": "1", "block_name": "service", "load_cycles": "17",
    "of_load_cycles": "60", "peak": "12534.2", "valley": "468.75", "unit": "N",
}  # fmt: skip


def test_the_programmes_line_has_units():
    assert programme_line({}) == ""
    assert programme_line(PROGRAMME) == (
        "bracket · block 1 service · 17 of 60 load cycles · peak 12.53 kN, valley 0.4688 kN · running"
    )
    stopped = {**PROGRAMME, "programme_state": "stopped", "peak": "nan"}
    assert programme_line(stopped).endswith("17 of 60 load cycles · stopped")
    waiting = {**PROGRAMME, "programme_state": "waiting", "pacing": "waits for the peak 12600: 65.8 short"}
    assert programme_line(waiting).endswith(" · waiting · waits for the peak 12600: 65.8 short")
    assert programme_requests(waiting) == {"stop", "skip"}
    position = {**PROGRAMME, "peak": "0.0125", "valley": "-0.003", "unit": "m"}
    assert "peak 12.5 mm, valley -3 mm" in programme_line(position)


STOPPED = "Tripped: emergency stop requested, at 1.000 s. The valve is closed."

HELD = NodeHealth(
    "programme_node",
    WARNING,
    "stopped: the error is 700, its limit 600; programme_resume continues",
    {**PROGRAMME, "programme_state": "stopped", "stopped_because": "the error is 700, its limit 600"},
)


@pytest.mark.parametrize(
    ("status", "trouble", "remedy"),
    [
        (said(plant(), HELD), "The programme is stopped: the error is 700, its limit 600. To go on: Resume programme.", None),
        (
            said(plant(1, "late"), HELD),
            "plant_sim_node: late. The programme is stopped: the error is 700, its limit 600. To go on: Resume programme.",
            None,
        ),
        (
            said(plant(state="disabled"), HELD),
            "The programme is stopped: the error is 700, its limit 600. To go on: Enable, then Resume programme.",
            Remedy.ENABLE,
        ),
        (
            said(plant(2, "stopped", state="stopped", stop="stop-1", cause_1="emergency stop at 1 s, cut"), HELD),
            f"{STOPPED} To go on: Acknowledge stop, then Reset and enable, then Resume programme.",
            Remedy.ACKNOWLEDGE,
        ),
    ],
)
def test_a_stopped_programme_has_its_reason_and_the_buttons_to_press(status, trouble, remedy):
    assert (status.trouble, status.remedy) == (trouble, remedy)


@pytest.mark.parametrize(
    ("figures", "requests"),
    [
        ({}, set()),
        ({**PROGRAMME, "programme_state": "finished"}, set()),
        (PROGRAMME, {"stop", "skip"}),
        ({**PROGRAMME, "programme_state": "stopped", "stopped_because": "on request"}, {"resume", "skip"}),
    ],
)
def test_the_programmes_buttons_follow_its_state(figures, requests):
    assert programme_requests(figures) == requests
