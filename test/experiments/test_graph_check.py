"""Combinations that do not fit are refused before any node starts, with the cause and a remedy that works."""

import pytest
import yaml

from ehls_ros.errors import BadInput
from ehls_ros.experiments.files import config_folder
from ehls_ros.experiments.graph_check import Graph, bridge_at, check_fit, laws_for
from ehls_ros.experiments.spec import spec_from_mapping
from ehls_ros.hardware.backends import BACKENDS
from ehls_ros.hardware.bridge_file import bridge_from_mapping

CONFIG = config_folder()
UDP = yaml.safe_load((CONFIG / "bridge_udp.yaml").read_text(encoding="utf-8"))
ALL = {**UDP["channels"], "velocity": {"channel": 6, "scale": 0.3}}
FORCE = {"name": "sine", "amplitude": 5e3, "frequency": 1.0}
CYCLES = {"block": "cycles", "name": "service", "mean": 1e3, "amplitude": 5e2, "frequency": 2.0, "count": 4}
OUTPUT_FEEDBACK = "fasmc_output_feedback"


def spec(controller="fasmc", reference=FORCE, **more):
    content = {"rig": "rig_paper_measured.yaml", "duration": 4.0, "controller": controller, "reference": reference, **more}
    return spec_from_mapping(content, "spec", CONFIG)


def programme(controller=OUTPUT_FEEDBACK, block=CYCLES, **more):
    return spec(controller, {"name": "programme", "blocks": [block], **more})


def bridge(without=(), channels=ALL, command=UDP["command"], **backend):
    wired = {signal: channel for signal, channel in channels.items() if signal not in without}
    return bridge_from_mapping({"backend": {**UDP["backend"], **backend}, "channels": wired, "command": command}, "bridge")


COMEDI = {"name": "comedi"}


def card(without=()):
    wired = {signal: channel for signal, channel in ALL.items() if signal not in without}
    return bridge_from_mapping({"backend": COMEDI, "channels": wired, "command": UDP["command"]}, "bridge")


REFUSED = {
    "fasmc without velocity": (spec(), Graph(bridge=bridge(["velocity"])), ("fasmc needs velocity", OUTPUT_FEEDBACK)),
    "sic without velocity": (spec("sic"), Graph(bridge=bridge(["velocity"])), ("sic needs velocity", "fasmc_predictive")),
    "fasmc without supply": (spec(), Graph(bridge=bridge(["supply_pressure"])), ("supply_pressure", OUTPUT_FEEDBACK)),
    "output feedback without pressure": (
        spec(OUTPUT_FEEDBACK),
        Graph(bridge=bridge(["load_pressure"])),
        ("needs load_pressure", "a channel for load_pressure"),
    ),
    "predictive without spool": (
        spec("fasmc_predictive"),
        Graph(bridge=bridge(["spool_position"])),
        ("needs spool_position", "a channel for spool_position"),
    ),
    "pid without position": (
        spec("pid", {"name": "sine", "amplitude": 0.01, "frequency": 1.0}),
        Graph(bridge=bridge(["position"])),
        ("pid needs position", "a channel for position"),
    ),
    "programme without velocity": (programme("fasmc"), Graph(bridge=bridge(["velocity"])), ("velocity", OUTPUT_FEEDBACK)),
    "the package's programme": (
        spec("fasmc", {"name": "programme", "file": "programmes/fatigue.yaml"}),
        Graph(bridge=bridge_at(None)),
        ("fasmc needs velocity", OUTPUT_FEEDBACK),
    ),
    "switched law": (spec(OUTPUT_FEEDBACK), Graph("fasmc", bridge(["velocity"])), ("fasmc needs velocity", OUTPUT_FEEDBACK)),
    "law of a position": (spec(), Graph("pid"), ("reference is a force for fasmc", "follows a position")),
    "law of a position on a bridge": (spec(), Graph("pid", bridge()), ("reference is a force for fasmc", "follows a position")),
    "preview on a bridge": (
        spec("fasmc_predictive", companions=["disturbance_preview"]),
        Graph(bridge=bridge()),
        ("disturbance_preview needs the setpoint", "no disturbance_preview"),
    ),
    "card in lockstep": (spec(), Graph(bridge=card()), ("comedi samples by its own clock", "timing realtime")),
    "slow cycles": (spec(control_period=0.02), Graph(), ("control_period is 0.02 s", "below 0.02 s")),
    "slow cycles on a bridge": (spec(control_period=0.05), Graph(bridge=bridge()), ("0.05 s", "command_timeout", "below")),
    "watchdog": (spec(control_period=0.004), Graph(bridge=bridge(watchdog=0.003)), ("0.003 s after", "longer watchdog")),
    "force beyond the gate": (spec(reference={**FORCE, "amplitude": 1.7e4}), Graph(), ("16380", "trip_level")),
    "force beyond the gate on a bridge": (
        spec(OUTPUT_FEEDBACK, {**FORCE, "amplitude": 1.7e4}),
        Graph(bridge=bridge()),
        ("16380", "trip_level"),
    ),
    "position beyond the gate": (
        spec("pid", {"name": "sine", "amplitude": 0.29, "frequency": 0.1}, duration=20.0),
        Graph(bridge=bridge()),
        ("0.285", "position_margin"),
    ),
    "programme beyond the gate": (programme(block={**CYCLES, "amplitude": 1.6e4}), Graph(), ("trips outside", "16380")),
    "hold beyond the gate": (programme(hold=1.7e4), Graph(), ("the programme holds 17000 N", "16380")),
    "peak limit beyond the gate": (
        programme(block={**CYCLES, "limits": {"peak": [0.0, 1.8e4]}}),
        Graph(),
        ("peak of block service", "within -16380"),
    ),
    "valley limit beyond the gate": (
        programme(block={**CYCLES, "limits": {"valley": [-2e4, 0.0]}}),
        Graph(bridge=bridge()),
        ("valley of block service", "within -16380"),
    ),
    "position limit beyond the gate": (
        programme(block={**CYCLES, "limits": {"position": [-0.3, 0.3]}}),
        Graph(bridge=bridge()),
        ("position of block service", "-0.285 to 0.285 m"),
    ),
    "position limit for all blocks": (
        programme(limits={"position": [-0.1, 0.4]}),
        Graph(bridge=bridge()),
        ("position of block service", "-0.285 to 0.285 m"),
    ),
    "load cell too small": (
        spec(OUTPUT_FEEDBACK),
        Graph(bridge=bridge(channels={**ALL, "force": {"channel": 3, "scale": 400.0}})),
        ("channel of force ends at -4000 and 4000 N", "wider range"),
    ),
    "valve hardly opens": (
        spec(OUTPUT_FEEDBACK),
        Graph(bridge=bridge(command={"channel": 0, "scale": 2e-4})),
        ("opens the valve by 0.001 m", "limits.spool"),
    ),
    "valve opens to one side": (
        spec(OUTPUT_FEEDBACK),
        Graph(bridge=bridge(command={"channel": 0, "scale": 2e-3, "offset": 4.9, "range": [0.0, 5.0]})),
        ("opens the valve by 0.0002 m", "limits.spool"),
    ),
    "sic on the paper's rig": (
        spec("sic", rig={**yaml.safe_load((CONFIG / "rig_paper.yaml").read_text()), "effects": []}, compensation="stribeck"),
        Graph(bridge=bridge(["velocity"])),
        ("velocity", OUTPUT_FEEDBACK),
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_it_is_refused_with_the_cause_and_a_remedy(name):
    refused, graph, words = REFUSED[name]
    with pytest.raises(BadInput) as error:
        check_fit(refused, graph, "spec")
    assert all(word in str(error.value) for word in words), str(error.value)


ACCEPTED = {
    "simulated": (spec(), Graph()),
    "programme": (programme(hold=0.0, limits={"position": [-0.1, 0.1]}), Graph()),
    "all signals": (spec(), Graph(bridge=bridge())),
    "output feedback on the example": (spec(OUTPUT_FEEDBACK), Graph(bridge=bridge_at(None))),
    "programme on the example": (programme(), Graph(bridge=bridge_at(None))),
    "card in real time": (spec(OUTPUT_FEEDBACK), Graph(bridge=card(["velocity"]), lockstep=False)),
    "preview in simulation": (spec("fasmc_predictive", companions=["disturbance_preview"]), Graph()),
    "pid on the example": (spec("pid", {"name": "sine", "amplitude": 0.1, "frequency": 0.1}), Graph(bridge=bridge_at(None))),
}


@pytest.mark.parametrize("name", ACCEPTED)
def test_fitting_combinations_are_accepted(name):
    accepted, graph = ACCEPTED[name]
    check_fit(accepted, graph, "spec")


@pytest.mark.parametrize("file", sorted(path.stem for path in (CONFIG / "experiments").glob("*.yaml")))
def test_the_experiments_of_the_package_fit_the_simulated_rig(file):
    from ehls_ros.experiments.spec import load_spec

    check_fit(load_spec(CONFIG / "experiments" / f"{file}.yaml"), Graph(), file)


def test_the_named_law_would_do():
    example = bridge_at(None).calibration.wired
    for law in laws_for("force", example):
        check_fit(spec(law), Graph(bridge=bridge_at(None)), "spec")
    assert OUTPUT_FEEDBACK in laws_for("force", example)
    assert "fasmc" not in laws_for("force", example)


def test_parts_left_to_the_rig_are_remarks():
    disturbance = {"name": "force", "signal": {"name": "sine", "amplitude": 1e3, "frequency": 1.0}}
    hidden = [{"name": "command_delay", "delay": 1e-3}]
    remarks = check_fit(spec(OUTPUT_FEEDBACK, disturbance=disturbance, effects=hidden), Graph(bridge=bridge()), "spec")
    assert "the disturbance of the experiment (force, sine) is not sent" in remarks[0]
    assert "command_delay" in remarks[1]
    assert check_fit(spec(disturbance=disturbance), Graph(), "spec") == ()


def test_the_backends_that_wait_declare_it():
    assert [name for name in BACKENDS.names() if getattr(BACKENDS.load(name), "WAITS", False)] == ["udp"]


def test_both_pressures_of_a_single_rod_or_its_load_cell_stand_for_its_load_pressure():
    single = spec("fasmc_predictive", rig="rig_single_rod.yaml")
    chambers = {name: {"channel": 8 + side, "scale": 2.5e6} for side, name in enumerate(("pressure_a", "pressure_b"))}
    wired = {name: channel for name, channel in {**ALL, **chambers}.items() if name != "load_pressure"}
    check_fit(single, Graph(bridge=bridge(channels=wired)), "spec")
    check_fit(single, Graph(bridge=bridge(["pressure_a", "pressure_b"], wired)), "spec")
    with pytest.raises(BadInput, match="fasmc_predictive needs load_pressure"):
        check_fit(single, Graph(bridge=bridge(["pressure_b", "force"], wired)), "spec")
