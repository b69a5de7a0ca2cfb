"""A technician's hour without `ros2`: a programme is stopped in the middle, resumed and verified, by verbs and on the page."""

import csv
import json
import math
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import yaml
from ehls_command import ehls
from patience import PATIENCE

pytest.importorskip("ehls_msgs.msg._programme_point", reason="needs ehls_msgs built, as `make setup` does")

from emulated_rig import ROOT, own_port

LOAD_CYCLES = 40
WITHIN = 12
"""Load cycle from which on the rig is stopped."""

SAME_FORCE = 20.0
"""Difference of peaks and valleys before and after the stop up to which they are the same [N]: 2 % of the range."""

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
    (tmp_path / "hour.yaml").write_text(PROGRAMME, encoding="utf-8")
    content = yaml.safe_load((ROOT / "config" / "bridge_udp.yaml").read_text(encoding="utf-8"))
    content["backend"]["port"] = own_port()
    file.write_text(yaml.safe_dump(content), encoding="utf-8")
    spec.write_text(yaml.safe_dump(SPEC), encoding="utf-8")
    words = ["rig-emulator", "--spec", str(spec), "--bridge", str(file), "--lockstep", "--patience", str(PATIENCE)]
    emulator = subprocess.Popen([*COMMAND, *words], stdout=subprocess.PIPE)
    assert b"listening" in emulator.stdout.readline()
    yield ["--plant", "bridge", "--bridge", str(file)]
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
    folder = tmp_path / "run"
    words = ["programme", str(tmp_path / "hour.yaml"), "--run", str(folder), "--spec", str(tmp_path / "rig.yaml"), *bridge]
    run = subprocess.Popen([*COMMAND, *words, "--json"], stdout=subprocess.PIPE, text=True)
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
    assert "to continue" not in output
    check_load_cycles(folder)
    done = ehls("verify", str(folder), "--out", str(tmp_path / "verify"))
    assert done.returncode == 0, done.stderr
    check_verification(done.stdout, (tmp_path / "verify" / "report.html").read_text(encoding="utf-8"))
    check_report((folder / "report.html").read_text(encoding="utf-8"))


STATE = "document.querySelector('[data-name=state]').innerText"

PRESS_NEXT = """(() => {
  const now = Date.now();
  const names = ["acknowledge stop", "reset and enable", "enable", "resume programme"];
  const found = names.map(name => document.querySelector(`[data-name="${name}"]`));
  const next = found.find(button => button.offsetParent !== null && !button.disabled);
  if (next && now - (window.pressed ??= 0) > 1000) { next.click(); window.pressed = now; }
  return document.querySelector("[data-name=programme]").innerText.endsWith("finished");
})()"""
"""Presses the next button that resumes operation; true once the programme has finished."""


@pytest.mark.long
def test_the_same_hour_on_the_page(bridge, tmp_path, ros_domain_id):
    pytest.importorskip("nicegui", reason="needs the extra `dashboard`")
    pytest.importorskip("websockets", reason="needs websockets to drive a browser")
    from headless_browser import CHROMIUM, browser
    from served import dashboard

    if CHROMIUM is None:
        pytest.skip("needs Chromium")
    spec = {**SPEC, "reference": {"name": "programme", "file": str(tmp_path / "hour.yaml")}}
    (tmp_path / "on_page.yaml").write_text(yaml.safe_dump(spec), encoding="utf-8")
    with (
        browser(tmp_path / "chromium") as chromium,
        dashboard(tmp_path, ros_domain_id, "--spec", "on_page.yaml", *bridge) as server,
        chromium.tab(server.address) as page,
    ):
        page.resize(1366, 768)
        page.until(f"{STATE}.startsWith('valve closed')")
        page.click("[data-name=tab-experiment]")
        page.until("document.querySelector('[data-name=record]')?.disabled === false")
        page.click("[data-name=record]")
        page.click("[data-name=tab-nodes]")
        page.until(
            "[...document.querySelectorAll('[data-name=node-recorder_node] dt')]"
            ".some(name => name.textContent === 'cycles' && Number(name.nextElementSibling.textContent) > 0)"
        )
        page.click("[data-name=enable]")
        [log] = tmp_path.glob("runs/*/load_cycles.csv")
        folder = log.parent
        until(lambda: len(load_cycles(folder)) >= WITHIN)
        page.click("[data-name='emergency stop']")
        page.is_told("emergency stop stop-1: the valve is closed")
        page.until(f"{STATE}.startsWith('stopped, valve closed')")
        page.until("document.querySelector('[data-name=programme]').innerText.endsWith('stopped')")
        steps = "Acknowledge stop, then Reset and enable, then Resume programme."
        page.until(f"document.querySelector('[data-name=trouble]').innerText.includes('To go on: {steps}')")
        page.until(PRESS_NEXT)
        assert f"{LOAD_CYCLES} of {LOAD_CYCLES} load cycles" in page.text("programme")
        page.click("[data-name=tab-experiment]")
        page.click("[data-name=record]")
        page.until("document.querySelector('[data-name=activity]').innerText.includes('Recorded: ')")
        check_load_cycles(folder)
        for verb, check in (("verify", check_verification), ("report", lambda _, document: check_report(document))):
            page.click(f"[data-name='{verb} recording']")
            page.until(f"document.querySelector('[data-name=document-{verb}]').offsetParent !== null")
            # As the link does, with the page's token.
            with chromium.tab(f"{server.server}documents/{verb}?token={server.token}") as document:
                document.until("!!document.querySelector('.js-plotly-plot .main-svg')")
                check(page.text(f"result-{verb}"), document.evaluate("document.body.innerText"))
                assert document.complaints == []
        assert page.complaints == []


def check_load_cycles(folder):
    """Check that each load cycle is logged once and complete, and that the force after the stop is that before it."""
    rows = load_cycles(folder)
    assert [int(row["load_cycle"]) for row in rows] == list(range(1, LOAD_CYCLES + 1))
    # Each was applied completely; those in which the rig was stopped and resumed have more control cycles.
    assert all(int(row["samples"]) >= 100 for row in rows), [row["samples"] for row in rows]
    assert all(math.isfinite(float(row["peak_n"])) for row in rows)
    for name in ("peak_n", "valley_n"):
        before, after = (np.median([float(row[name]) for row in part]) for part in (rows[:WITHIN], rows[-WITHIN:]))
        assert abs(after - before) < SAME_FORCE


def check_verification(answer, document):
    """Check that the cycles were judged without those in which the valve was closed."""
    assert "judged by its cycles" in answer
    assert "The safety gate kept the valve closed" in document


def check_report(document):
    """Check that the report has the count, and names the stop."""
    text = re.sub(r"<[^>]*>", " ", document)
    assert re.search(rf"Load cycles\s+{LOAD_CYCLES}\s", text)
    assert "The safety gate kept the valve closed" in text.replace("Warning: the", "The")
    assert "tripped by emergency stop" in document


@pytest.mark.long
def test_a_rig_that_does_not_run_is_one_line_with_domain_and_namespace(ros_domain_id):
    for words, sought in ((("rig", "status"), "rig"), (("programme", "stop"), "programme")):
        done = ehls(*words, "--namespace", "rig2")
        assert done.returncode == 2
        [line] = done.stderr.splitlines()
        assert f"ROS domain {ros_domain_id}, namespace /rig2: no {sought} is found" in line
        assert "Traceback" not in line
