"""The dashboard's tuning: its process, the texts and the drawing, without a browser, ROS or a long search."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest
from patience import PATIENCE
from tunings import RESULT, SCRIPT, TUNING

from ehls_ros.control.margins import LoopMargins
from ehls_ros.dashboard import tuning_job, tuning_process
from ehls_ros.dashboard.graph import GraphSnapshot, StartProgress, TuningPoint
from ehls_ros.dashboard.tuning_figures import legend, numbers_table, results_table, trade_off_svg
from ehls_ros.dashboard.tuning_job import TuningJob
from ehls_ros.dashboard.tuning_process import Report, result_of, task_for
from ehls_ros.dashboard.tuning_status import law_to_tune, progress_text, why_not_applicable
from ehls_ros.errors import BadInput
from ehls_ros.experiments.files import configured
from ehls_ros.experiments.json_document import json_document
from ehls_ros.experiments.spec import load_spec
from ehls_ros.experiments.tuning import tune as search
from ehls_ros.experiments.tuning.tune import Trial, Tuned, Wanted
from ehls_ros.physics.rig import effects_from_list
from ehls_ros.process import NICENESS, is_running

SPEC = load_spec(configured("sine_fd2", "experiments"))
POSITION_SPEC = load_spec(configured("friction_presliding", "experiments"))


def until(true, what):
    deadline = time.monotonic() + PATIENCE
    while not true():
        assert time.monotonic() < deadline, what
        time.sleep(0.02)


def reported(**fields):
    return json.dumps(json_document(Report(**fields)))


PROGRESS, DONE = reported(done=3, most=97), reported(result=RESULT)


@pytest.fixture
def job(tmp_path, monkeypatch):
    """Return a function that makes a job whose process runs a program given as text; all end with the test."""
    monkeypatch.chdir(tmp_path)
    made = []

    def make(program):
        made.append(TuningJob(lambda folder, law: [sys.executable, "-c", program, str(folder), law]))
        return made[-1]

    yield make
    for each in made:
        each.close()


def process_of(started):
    until(lambda: started._run._process is not None, "no process")
    return started._run._process


def test_a_tuning_reports_its_progress_then_its_result_and_keeps_its_files(job):
    # It goes on once its folder has the file.
    program = f"""
import pathlib, sys, time
print({PROGRESS!r}, flush=True)
while not pathlib.Path(sys.argv[1], "go").exists():
    time.sleep(0.01)
print("a library's remark", flush=True)
print({DONE!r}, flush=True)
"""
    tuned = job(program)
    assert tuned.state() is None
    assert tuned.begin(SPEC, "sine", "fasmc").done
    until(lambda: tuned.state().done == 3, "no progress")
    state = tuned.state()
    assert (state.running, state.result, state.most) == (True, None, 97)
    assert tuned.document("tuning-report") is None
    refused = tuned.begin(SPEC, "sine", "fasmc")
    assert not refused.done
    assert "a tuning is running" in refused.message
    folder = Path(state.folder)
    assert folder.parent == Path("runs")
    assert load_spec(folder / "spec.yaml") == SPEC
    (folder / "go").touch()
    until(lambda: not tuned.state().running, "it goes on")
    ended = tuned.state()
    assert (ended.failure, ended.result) == ("", RESULT)
    assert ended.seconds == tuned.state().seconds
    assert tuned.document("tuning-report") == folder / "report.html"
    assert tuned.document("tuning-numbers") == folder / "fasmc.yaml"
    assert tuned.document("../../etc/passwd") is None
    assert not tuned.cancel().done
    assert folder.exists()


FOREVER = f"import time\nprint({DONE!r}, flush=True)\ntime.sleep(1e6)"


def test_a_cancelled_tuning_leaves_neither_process_nor_files_and_another_can_begin(job):
    tuned = job(FOREVER)
    tuned.begin(SPEC, "sine", "fasmc")
    process = process_of(tuned)
    assert tuned.cancel().done
    assert process.returncode == -signal.SIGTERM
    state = tuned.state()
    assert (state.running, state.result, state.failure) == (False, None, "cancelled")
    assert list(Path("runs").iterdir()) == []
    assert tuned.begin(SPEC, "again", "fasmc").done
    assert tuned.state().running


def test_a_process_that_does_not_end_on_request_is_killed_and_a_closed_job_begins_nothing(job, monkeypatch):
    monkeypatch.setattr(tuning_job, "END_TIME", 0.05)
    tuned = job(f"import signal\nsignal.signal(signal.SIGTERM, signal.SIG_IGN)\n{FOREVER}")
    tuned.begin(SPEC, "sine", "fasmc")
    process = process_of(tuned)
    until(lambda: tuned._run._result is not None, "the process does not ignore the request yet")
    tuned.close()
    assert process.returncode == -signal.SIGKILL
    assert not tuned.begin(SPEC, "sine", "fasmc").done
    assert list(Path("runs").iterdir()) == []


@pytest.mark.parametrize(
    ("program", "words"),
    [
        (f"import sys\nprint({DONE!r})\nprint('the disk is full')\nsys.exit(1)", "the disk is full"),
        ('print(\'{"done": "many"}\')', '{"done": "many"}'),
        ("import sys\nsys.stdout.buffer.write(b'\\xff\\n')", "\N{REPLACEMENT CHARACTER}"),
        ("", "its process ended with code 0"),
        ("import os\nos.kill(os.getpid(), 9)", "its process ended with code -9"),
    ],
)
def test_a_tuning_that_fails_has_a_reason_and_leaves_no_files(job, program, words):
    tuned = job(program)
    tuned.begin(SPEC, "sine", "fasmc")
    until(lambda: not tuned.state().running, "it goes on")
    state = tuned.state()
    assert state.failure == words
    assert state.result is None
    assert progress_text(state) == f"The tuning of fasmc for sine failed: {words}"
    assert list(Path("runs").iterdir()) == []


def test_a_program_that_is_missing_is_a_failure_too(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    tuned = TuningJob(lambda folder, law: ["/no/such/program"])
    tuned.begin(SPEC, "sine", "fasmc")
    until(lambda: not tuned.state().running, "it goes on")
    assert "/no/such/program" in tuned.state().failure


@pytest.mark.parametrize(
    ("spec", "law", "words"),
    [(POSITION_SPEC, "pid", "pid names no numbers to tune"), (POSITION_SPEC, "fasmc", "follows a position")],
)
def test_what_cannot_be_tuned_is_refused_before_there_is_a_process_or_a_file(job, spec, law, words):
    tuned = job("")
    answer = tuned.begin(spec, "sine", law)
    assert not answer.done
    assert words in answer.message
    assert tuned.state() is None
    assert not Path("runs").exists()


DASHBOARD = """
import sys, time
from ehls_ros.dashboard.tuning_job import TuningJob
from ehls_ros.experiments.files import configured
from ehls_ros.experiments.spec import load_spec
tuned = TuningJob()
assert tuned.begin(load_spec(configured("sine_fd2", "experiments")), "sine", "fasmc").done
while tuned._run._process is None:
    time.sleep(0.01)
print(tuned._run._process.pid, flush=True)
time.sleep(1e6)
"""


def test_the_process_is_of_low_priority_and_does_not_outlive_a_killed_dashboard(tmp_path):
    killed = subprocess.Popen([sys.executable, "-c", DASHBOARD], cwd=tmp_path, stdout=subprocess.PIPE, text=True)
    try:
        number = int(killed.stdout.readline())
        tuning = psutil.Process(number)
        until(lambda: "tuning_process" in " ".join(tuning.cmdline()) and tuning.cmdline()[0] != "nice", "it does not begin")
        assert tuning.nice() >= NICENESS
        assert os.getsid(number) != os.getsid(0), "Ctrl-C would reach it"
    finally:
        killed.kill()
        killed.wait()
        killed.stdout.close()
    until(lambda: not is_running(number), "it outlives the dashboard")


@pytest.mark.long
def test_the_process_writes_the_files_and_reports_what_they_hold(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(search, "MAX_TRIALS", 1)
    monkeypatch.setattr(search, "SPEEDS", (0.5, 1.0))
    monkeypatch.setattr(tuning_process, "end_with", lambda parent: None)
    monkeypatch.chdir(tmp_path)
    short = SPEC._replace(settings=SPEC.settings._replace(duration=0.5))
    tuned = TuningJob(lambda folder, law: ["true"])
    tuned.begin(short, "short", "fasmc")
    folder = tmp_path / "short"
    folder.mkdir()
    tuning_job.RunFolder(folder).write_spec(short)
    assert tuning_process.main([str(folder), "fasmc", "1"]) == 0
    *progress, last = (tuning_job.from_json(Report, line) for line in capsys.readouterr().out.splitlines())
    assert [report.done for report in progress] == sorted(report.done for report in progress)
    document = json.loads((folder / "tuning.json").read_text(encoding="utf-8"))
    assert last.result.found.error == document["chosen"]["max_error_n"]
    assert {number.name: number.found for number in last.result.numbers} == pytest.approx(document["numbers"], rel=1e-5)
    assert {file.name for file in folder.iterdir()} == {
        "spec.yaml", "experiment.yaml", "fasmc.yaml", "report.html", "tuning.json",
    }  # fmt: skip
    assert tuning_process.main([str(folder), "pid", "1"]) == 1
    assert "no numbers to tune" in capsys.readouterr().out


def applicable(job, spec):
    tuned = job(f"print({DONE!r})")
    tuned.begin(spec, "sine", "fasmc")
    until(lambda: not tuned.state().running, "it goes on")
    return tuned, tuned.applicable(tuned.state().folder)


def test_numbers_are_for_one_experiment_and_the_rig_that_the_controller_knows(job, tmp_path):
    tuned, found = applicable(job, SPEC)
    # As the graph's plant reads it.
    assert found.is_for(load_spec(Path(tuned.state().folder) / "spec.yaml"), "other")
    hidden = effects_from_list([{"name": "valve_dead_zone", "positive": 2e-4, "negative": 2e-4}], "test")
    assert found.is_for(SPEC._replace(rig=SPEC.rig.with_effects(hidden)), "sine")
    assert not found.is_for(SPEC._replace(controller_rig=SPEC.controller_rig.with_plant(moving_mass=90.0)), "sine")
    faster = SPEC.reference._replace(parameters=SPEC.reference.parameters._replace(frequency=2.0))
    assert not found.is_for(SPEC._replace(reference=faster), "sine")
    assert task_for(SPEC, "fasmc", "sine").spec == found.task


def test_only_the_last_tuning_can_be_applied_and_its_application_is_noted(job):
    tuned, found = applicable(job, SPEC)
    first = tuned.state().folder
    tuned.note_application(found, "applied")
    assert (tuned.state().applied, tuned.state().applications) == ("applied", 1)
    assert tuned.begin(SPEC, "again", "fasmc").done
    until(lambda: not tuned.state().running, "it goes on")
    # Its count goes on, so that the page reads the node's values again only after the next application.
    assert (tuned.state().applied, tuned.state().applications) == ("", 1)
    with pytest.raises(BadInput, match="last tuning"):
        tuned.applicable(first)
    tuned.note_application(found, "late")
    assert tuned.state().applied == ""


def test_numbers_that_lose_the_force_cannot_be_applied(job):
    tuned = job(f"print({reported(result=RESULT._replace(lost=True, holds=False))!r})")
    tuned.begin(SPEC, "sine", "fasmc")
    until(lambda: not tuned.state().running, "it goes on")
    with pytest.raises(BadInput, match="do not hold the force"):
        tuned.applicable(tuned.state().folder)


def test_a_result_has_units_and_the_numbers_of_the_parameter_file():
    margins = LoopMargins(6.5, 20.0, 30.0, 1e-3)
    start = Trial({"g": 60.0}, 40.0, 50.0, 60.0, 0.03, margins)
    best = Trial({"g": 136.7701234567}, 20.0, 25.0, 30.0, 0.03, margins)
    task = task_for(SPEC, "fasmc", "sine")
    found = Tuned(task, Wanted(), start, best, float("nan"), (), (best,), 40, ("a remark",))
    result = tuning_job.from_json(Report, reported(result=result_of(found))).result
    [number] = result.numbers
    assert (number.name, number.unit, number.default, number.found) == ("g", "1/MPa", 60.0, 136.77)
    assert result.found == TuningPoint(20.0, 6.5, 30.0, 0.03)
    assert result.causal_limit is None
    assert (result.holds, result.lost, result.remarks) == (True, False, ("a remark",))


# --- texts --------------------------------------------------------------------------------------------------------------------


def no_choice():
    raise AssertionError


@pytest.mark.parametrize(
    ("snapshot", "chosen", "law", "words"),
    [
        (GraphSnapshot(rate=1e3, laws=("fasmc", "sic")), no_choice, "fasmc", ""),
        (GraphSnapshot(), lambda: "sic", "sic", ""),
        (GraphSnapshot(rate=1e3), no_choice, "", "No controller"),
        (GraphSnapshot(starting=StartProgress(1.0, {})), no_choice, "", "starting"),
        (GraphSnapshot(rate=1e3, laws=("pid",)), no_choice, "", "The law pid has no numbers to tune"),
        (GraphSnapshot(), lambda: "no_such_law", "", "cannot be read"),
    ],
)
def test_the_law_to_tune_is_that_of_the_graph_or_of_the_choice_and_its_lack_has_a_reason(snapshot, chosen, law, words):
    found, why_not = law_to_tune(snapshot, chosen)
    assert found == law
    assert words in why_not
    assert bool(words) == bool(why_not)


def test_progress_and_outcome_are_sentences():
    running = TUNING._replace(experiment="sine", running=True, result=None)
    assert progress_text(running) == "Tuning fasmc for sine: 55 of at most 97 sets of numbers tried, 50 s."
    assert "compiling" in progress_text(running._replace(done=0, most=0))
    assert progress_text(running._replace(running=False, failure="cancelled")) == "The tuning of fasmc for sine was cancelled."
    assert progress_text(TUNING) == ""


@pytest.mark.parametrize(
    ("snapshot", "tuning", "words"),
    [
        (GraphSnapshot(rate=1e3, laws=("sic", "fasmc")), TUNING, ""),
        (GraphSnapshot(rate=1e3, laws=("sic",)), TUNING, "No node of fasmc is running."),
        (GraphSnapshot(), TUNING, "No graph is running."),
        (GraphSnapshot(rate=1e3, laws=("fasmc",)), TUNING._replace(result=RESULT._replace(lost=True)), "hold the force"),
    ],
)
def test_what_cannot_be_applied_has_a_reason(snapshot, tuning, words):
    reason = why_not_applicable(snapshot, tuning)
    assert words in reason
    assert bool(words) == bool(reason)


# --- drawing ------------------------------------------------------------------------------------------------------------------


def path_of(svg, name):
    drawn = re.search(rf'<path class="{name}" d="M([^"]*)"', svg)[1]
    return [tuple(map(float, point.split())) for point in drawn.split("L")]


def test_the_drawing_has_units_and_its_points_lie_where_their_numbers_are():
    svg = trade_off_svg(RESULT)
    assert ">gain margin [dB]</text>" in svg
    assert ">largest error [N]</text>" in svg
    [(slow_x, slow_y), (found_x, found_y)] = path_of(svg, "curve")
    [(left, limit_y), (right, _)] = path_of(svg, "limit")
    [(wanted_x, _), _] = path_of(svg, "wanted")
    # Linear in dB from zero at the left end of the limit; the curve ends before the unstable loops.
    assert (wanted_x - left) / (found_x - left) == pytest.approx(6.0 / 6.5, abs=5e-3)
    assert (slow_x - left) / (found_x - left) == pytest.approx(12.0 / 6.5, abs=1e-2)
    assert slow_x < right
    # As far apart as the logarithms of 400, 20 and 5 N; upwards is more.
    assert (found_y - slow_y) / (limit_y - found_y) == pytest.approx(1.30103 / 0.60206, abs=2e-2)
    ticks = dict(re.findall(r'y="([\d.]+)" text-anchor="end">(\d+)<', svg))
    [twenty] = [float(y) - 4.0 for y, text in ticks.items() if text == "20"] or [found_y]
    assert twenty == pytest.approx(found_y, abs=0.2)
    found = re.search(r'<circle class="found" cx="([\d.]+)" cy="([\d.]+)"', svg)
    assert (float(found[1]), float(found[2])) == (found_x, found_y)
    assert 'class="default"' in svg


@pytest.mark.parametrize(
    "result",
    [
        RESULT._replace(found=TuningPoint(None, 0.0, 0.0, None), default=TuningPoint(None, None, None, None), curve=()),
        RESULT._replace(found=TuningPoint(20.0, None, None, 0.03)),
        RESULT._replace(found=TuningPoint(1e300, 1e3, 0.0, 0.03), default=TuningPoint(1e-300, 0.0, 0.0, 0.0), causal_limit=1e9),
        RESULT._replace(wanted_db=0.0, causal_limit=None, curve=(RESULT.found,)),
    ],
)
def test_any_result_can_be_drawn(result):
    assert "nan" not in trade_off_svg(result) + results_table(result) + legend(result)


def test_a_limit_below_the_resolution_of_sensors_is_said_and_not_drawn():
    tiny = RESULT._replace(causal_limit=2.6e-3)
    assert 'class="limit"' in trade_off_svg(RESULT) + legend(RESULT)
    assert 'class="limit"' not in trade_off_svg(tiny) + legend(tiny)
    assert "below 0.1 N" in results_table(tiny)
    assert "unknown" in results_table(RESULT._replace(causal_limit=None))


def test_tables_have_units_and_texts_are_escaped():
    results = re.findall(r"<tr><th>([^<]*)</th><td>([^<]*)</td><td>([^<]*)</td></tr>", results_table(RESULT))
    assert results[1:] == [
        ("largest error", "40.0 N", "20.0 N"),
        ("small force, actuator held", "3.00 %", "3.00 %"),
        ("gain margin", "8.00 dB", "6.50 dB"),
        ("phase margin", "35.0 °", "30.0 °"),
    ]
    without = RESULT._replace(default=RESULT.default._replace(held=0.0), found=RESULT.found._replace(held=0.0))
    assert "held" not in results_table(without)
    numbers = numbers_table(RESULT)
    assert "<th>g [1/MPa]</th><td>60.00</td><td>136.8</td>" in numbers
    assert "<th>rate_correction</th>" in numbers
    assert SCRIPT not in numbers
    assert "steepness &lt;img" in numbers
