"""A technician's hour without `ros2`: a programme on a rig is stopped, resumed and ended by the verbs of `ehls`."""

import csv
import json
import math
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import yaml
from ehls_command import ehls
from patience import PATIENCE

pytest.importorskip("ehls_msgs.msg._programme_point", reason="needs ehls_msgs built, as `make setup` does")

from emulated_rig import ROOT, own_port

LOAD_CYCLES = 40
WITHIN = 12
"""Load cycle from which on the rig is stopped."""

PROGRAMME = f"""
title: hour
hold: 0.0
stop_time: 0.05
hold_time: 0.1
blocks:
  - {{block: ramp, name: preload, to: 1.0e+3, rate: 4.0e+3}}
  - {{block: cycles, name: service, mean: 1.5e+3, amplitude: 500.0, frequency: 10.0, count: {LOAD_CYCLES}}}
"""

SPEC = {
    "title": "a rig behind a bridge",
    "rig": str(ROOT / "config" / "rig_paper_measured.yaml"),
    "reference": {"name": "constant", "value": 0.0},
    "disturbance": {"name": "force", "signal": {"name": "sine", "amplitude": 500.0, "frequency": 1.0}},
    "controller": {"name": "fasmc_output_feedback", "coupling_stiffness": 0.0, "coupling_damping": 0.0},
}

COMMAND = (sys.executable, "-m", "ehls_ros.cli.main")


@pytest.fixture
def bridge(tmp_path, ros_domain_id):
    """Start an emulated rig, and return the options that connect a run to it."""
    file, spec = tmp_path / "bridge.yaml", tmp_path / "rig.yaml"
    content = yaml.safe_load((ROOT / "config" / "bridge_udp.yaml").read_text(encoding="utf-8"))
    content["backend"]["port"] = own_port()
    file.write_text(yaml.safe_dump(content), encoding="utf-8")
    spec.write_text(yaml.safe_dump(SPEC), encoding="utf-8")
    words = ["rig-emulator", "--spec", str(spec), "--bridge", str(file), "--lockstep", "--patience", str(PATIENCE)]
    emulator = subprocess.Popen([*COMMAND, *words], stdout=subprocess.PIPE)
    assert b"listening" in emulator.stdout.readline()
    yield ["--spec", str(spec), "--plant", "bridge", "--bridge", str(file)]
    emulator.send_signal(signal.SIGINT)
    emulator.communicate(timeout=PATIENCE)


def asked(*words):
    """Return the answer of a verb as data, and its exit code."""
    done = ehls(*words, "--json")
    return (json.loads(done.stdout) if done.returncode == 0 else done.stderr), done.returncode


def until(condition):
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.1)


def load_cycles(folder: Path):
    log = folder / "load_cycles.csv"
    return list(csv.DictReader(log.open(encoding="utf-8", newline=""))) if log.exists() else []


@pytest.mark.long
def test_a_programme_is_stopped_in_the_middle_and_goes_on_where_it_was(bridge, tmp_path):
    programme, folder = tmp_path / "hour.yaml", tmp_path / "run"
    programme.write_text(PROGRAMME, encoding="utf-8")
    run = subprocess.Popen(
        [*COMMAND, "programme", str(programme), "--run", str(folder), *bridge, "--json"], stdout=subprocess.PIPE, text=True
    )
    try:
        until(lambda: run.poll() is not None or len(load_cycles(folder)) >= WITHIN)
        stop, code = asked("rig", "stop")
        assert code == 0, stop
        assert stop["next"] == [f"ehls rig acknowledge {stop['stop']}", "ehls rig reset", "ehls rig enable"]
        refused, code = asked("rig", "reset")
        assert code == 1
        assert "acknowledge" in refused
        status, _ = asked("rig", "status")
        assert status["state"] == "stopped"
        assert status["next"][0] == f"ehls rig acknowledge {status['stop']}"
        refused, code = asked("programme", "resume")
        assert code == 1
        assert "enable the rig" in refused
        # A busy computer may trip the gate again.
        while run.poll() is None:
            status, code = asked("rig", "status")
            if code == 0 and status["next"]:
                asked(*status["next"][0].split()[1:])
            time.sleep(0.2)
    finally:
        run.send_signal(signal.SIGINT)
        output, _ = run.communicate(timeout=PATIENCE)
    assert run.returncode == 0, output
    assert f"ehls rig acknowledge {stop['stop']}" in output
    assert "programme resume" in output
    rows = load_cycles(folder)
    assert [int(row["load_cycle"]) for row in rows] == list(range(1, LOAD_CYCLES + 1))
    # Each was applied completely; those in which the rig was stopped and resumed have more control cycles.
    assert all(int(row["samples"]) >= 100 for row in rows), [row["samples"] for row in rows]
    assert all(math.isfinite(float(row["peak_n"])) for row in rows)
    assert "to continue" not in output


def test_a_rig_that_does_not_run_is_one_line_with_domain_and_namespace(ros_domain_id):
    for words, sought in ((("rig", "status"), "rig"), (("programme", "stop"), "programme")):
        done = ehls(*words, "--namespace", "rig2")
        assert done.returncode == 2
        [line] = done.stderr.splitlines()
        assert f"ROS domain {ros_domain_id}, namespace /rig2: no {sought} is found" in line
        assert "Traceback" not in line
