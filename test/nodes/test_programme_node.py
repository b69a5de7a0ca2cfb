"""A programme over DDS: each load cycle is counted once across a stop, a resume, and two kills of the node."""

import time
from types import SimpleNamespace

import pytest

pytest.importorskip("ehls_msgs.msg._programme_point", reason="needs ehls_msgs built, as `make setup` does")

from diagnostic_msgs.msg import DiagnosticArray
from emulated_rig import acknowledged
from patience import PATIENCE
from std_srvs.srv import SetBool, Trigger

from benchmarks.spoilt_memory import PROGRAMME as PROGRAMME_OF_FATIGUE
from ehls_msgs.msg import LoaderState, ProgrammePoint
from ehls_ros.control.programme.motion import Runner, State
from ehls_ros.control.programme.pacing import Pacer
from ehls_ros.experiments.programme_records import read_state
from ehls_ros.experiments.state_files.access import LOCKS, NotWritten
from ehls_ros.nodes.ahead import LEAD
from ehls_ros.nodes.programme_node import ProgrammeNode
from ehls_ros.recording.topics import DEPTH

CYCLES = 500

GONE = DEPTH + LEAD + 100
"""Control cycles after which the rig has neither reference nor the snapshots from before the node ended."""


@pytest.mark.long
def test_no_load_cycle_is_lost_or_counted_twice(ros_domain_id, tmp_path):
    from benchmarks.programme_endurance import endure

    found = endure(tmp_path, CYCLES)
    assert found.logged == found.once == CYCLES
    assert found.lost == 0
    # Two stops and two resumes, each within some load cycles; all others have their ten control cycles.
    assert found.whole + found.stretched == CYCLES
    assert 2 <= found.stretched <= 20


PROGRAMME = """
title: short
stop_time: 0.05
blocks:
  - {block: cycles, amplitude: 500.0, mean: 500.0, frequency: 20.0, count: 100000, limits: {peak: [0.0, 1.0]}}
"""


def test_a_programme_begins_with_the_snapshot_of_now_and_stops_on_its_limits(graph, participant, spec_file, tmp_path):
    """A rig that has run for a while before, whose earlier snapshots are still available."""
    file, spec = tmp_path / "programme.yaml", spec_file(duration=100.0, controller="sic")
    file.write_text(PROGRAMME, encoding="utf-8")
    states, points = participant.collect(LoaderState, "loader_state"), participant.collect(ProgrammePoint, "programme_point")
    diagnostics = participant.collect(DiagnosticArray, "/diagnostics")
    common = {"spec": spec, "timing": "lockstep"}
    graph.start("reference_node", **common)
    for name in ("disturbance_node", "sic_node"):
        graph.start(name, **common)
    graph.start("plant_sim_node", **common, partners="reference_node,disturbance_node,sic_node")
    participant.until(lambda: states and states[-1].cycle > 500)
    graph.kill("reference_node")
    killed_ns = time.time_ns()

    def out():
        """Return the diagnostics of a controller that lacks the reference of its next cycle."""
        reported = [status for array in diagnostics.after(killed_ns) for status in array.status]
        return [status for status in reported if status.message == "no force reference for the present cycle"]

    participant.until(out)
    [answered] = [int(pair.value) for pair in out()[-1].values if pair.key == "cycle"]
    last = answered + 1
    graph.start("programme_node", **common, programme=file, folder=tmp_path / "run", autostart=False)
    assert participant.change("programme_node", "configure")
    # It publishes the points of a stopped programme, too: the first one is soon gone.
    participant.until(points.publishers)
    assert participant.change("programme_node", "activate")
    participant.until(lambda: points and points[-1].state == State.STOPPED)
    assert points[0].cycle == last
    assert points[0].load_cycles == 0
    assert (tmp_path / "run" / "load_cycles.csv").read_text().splitlines()[1].startswith("1,0,1,")
    participant.until(lambda: "the peak is " in graph.log("programme_node"))


STEADY = """
title: steady
blocks:
  - {block: cycles, amplitude: 500.0, mean: 500.0, frequency: 20.0, count: 100000}
"""

CYCLES_PER_LOAD_CYCLE = 50
"""Control cycles of a millisecond in a load cycle of the steady programme."""


def assert_a_second_is_refused(graph, own, tmp_path):
    """Start another node in the folder of the running one: even ``anew`` takes nothing from it."""
    words = [word for key, value in (own | {"anew": True}).items() for word in ("-p", f"{key}:={value}")]
    names = ["-r", "__node:=programme_node_2"]
    second = graph.run("second", ["-m", "ehls_ros.nodes.programme_node", "--ros-args", *words, *names])
    assert second.wait(PATIENCE) != 0
    first = f"process {graph.processes['programme_node'].pid}" if LOCKS.exists() else "another process"
    said = f"{tmp_path / 'run'}: {first} runs another programme in the folder; expected another folder, or that process stopped"
    assert graph.log("second").count(said) == 1
    assert "Traceback" not in graph.log("second")
    assert sorted(path.name for path in (tmp_path / "run").glob("[!.]*")) == ["load_cycles.csv", "programme_state.json"]


@pytest.mark.long
def test_a_programme_that_the_rig_ran_on_without_stands_until_it_is_resumed(graph, participant, spec_file, tmp_path):
    """In realtime, after its node was killed and absent for long; the rig's gate closes meanwhile, its cycles continue."""
    file, spec = tmp_path / "programme.yaml", spec_file(duration=100.0, controller="sic")
    file.write_text(STEADY, encoding="utf-8")
    states, points = participant.collect(LoaderState, "loader_state"), participant.collect(ProgrammePoint, "programme_point")
    own = {"spec": spec, "programme": file, "folder": tmp_path / "run"}
    graph.start("programme_node", **own)
    graph.start("plant_sim_node", spec=spec)
    participant.until(lambda: states and points and points[-1].load_cycles >= 5)
    assert_a_second_is_refused(graph, own, tmp_path)
    graph.kill("programme_node")
    # The state contains the last published cycle: a killed node loses the messages not yet delivered.
    saved = read_state(tmp_path / "run")
    assert saved is not None
    participant.until(lambda: states[-1].cycle > saved.published + GONE)
    started_ns = time.time_ns()
    graph.start("programme_node", **own)
    participant.until(lambda: points[-1].state == State.STOPPED and points.after(started_ns))
    stood = points[-1].load_cycles
    assert points.after(started_ns)[0].cycle > saved.published
    assert stood <= saved.published // CYCLES_PER_LOAD_CYCLE

    def goes_on():
        """Resume, again if a held-up machine has let the reference run out once more; return whether load cycles follow."""
        if points[-1].state == State.STOPPED:
            answer, repeated = participant.ask(Trigger, "programme_resume", Trigger.Request())
            assert answer.success or repeated
            participant.until(lambda: points[-1].state != State.STOPPED)
        return points[-1].state == State.RUNNING and points[-1].load_cycles > stood

    participant.until(goes_on)


def test_the_state_is_kept_whatever_counting_raises():
    saved = list[tuple[int, bool]]()
    node = SimpleNamespace(runner=object(), next=7, _count=lambda: 1 // 0)
    node._save = lambda published, *, durable: saved.append((published, durable))
    with pytest.raises(ZeroDivisionError):
        ProgrammeNode.stop(node)
    assert saved == [(6, True)]


def test_a_programme_stops_where_its_records_cannot_be_written():
    runner = Runner(PROGRAMME_OF_FATIGUE, 1e-3, (Runner.beginning(PROGRAMME_OF_FATIGUE, 0),))
    log = list[str]()
    logger = SimpleNamespace(error=log.append)
    node = SimpleNamespace(
        unwritten="",
        tally=SimpleNamespace(counter=SimpleNamespace(complaint="")),
        pacer=Pacer(PROGRAMME_OF_FATIGUE, 1e-3),
        next=500,
        requests=[],
        _running=lambda: runner,
        get_logger=lambda: logger,
    )
    for _ in range(3):
        with ProgrammeNode._writing(node):
            raise NotWritten("state.json: cannot be written (No space left on device)")
        ProgrammeNode._follow_requests(node)
    assert runner.motions[-1].kind == "stop"
    assert runner.motions[-1].reason == "state.json: cannot be written (No space left on device)"
    assert len(log) == 2
    # Once they can be written again, it can continue.
    with ProgrammeNode._writing(node):
        node.unwritten = ""
    assert runner.resume(900)
    ProgrammeNode._follow_requests(node)
    assert runner.motions[-1].kind == "resume"


@pytest.mark.long
def test_a_programme_holds_where_an_emergency_stop_closed_the_valve(graph, participant, spec_file, tmp_path):
    """Load cycles that were published but not applied are not counted; none is lost, and none is counted twice."""
    file, spec = tmp_path / "programme.yaml", spec_file(duration=1000.0, controller="sic")
    file.write_text(STEADY, encoding="utf-8")
    points = participant.collect(ProgrammePoint, "programme_point")
    common = {"spec": spec, "timing": "lockstep"}
    graph.start("programme_node", **common, programme=file, folder=tmp_path / "run")
    for name in ("disturbance_node", "sic_node"):
        graph.start(name, **common)
    graph.start("plant_sim_node", **common, partners="programme_node,disturbance_node,sic_node", speed=1.0)

    def granted(kind, service, request):
        participant.until(lambda: participant.call(kind, service, request).success)

    participant.until(lambda: points and points[-1].load_cycles >= 5)
    stop = participant.call(Trigger, "emergency_stop", Trigger.Request()).message.partition(";")[0]
    participant.until(lambda: points[-1].state == State.STOPPED)
    refused = participant.call(Trigger, "programme_resume", Trigger.Request())
    assert not refused.success
    assert "enable the rig" in refused.message
    held = points[-1].load_cycles
    participant.until(lambda: not (stop_ := acknowledged(participant, stop)) or stop_ != stop)
    granted(Trigger, "reset_trips", Trigger.Request())
    granted(SetBool, "enable", SetBool.Request(data=True))
    participant.rest(0.2)
    assert points[-1].load_cycles == held
    granted(Trigger, "programme_resume", Trigger.Request())
    participant.until(lambda: points[-1].load_cycles >= held + 5)
    assert graph.stop("programme_node") == 0, graph.log("programme_node")
    heading, *lines = (tmp_path / "run" / "load_cycles.csv").read_text(encoding="utf-8").splitlines()
    rows = [dict(zip(heading.split(","), line.split(","), strict=True)) for line in lines]
    assert [int(row["load_cycle"]) for row in rows] == list(range(1, len(rows) + 1))
    assert len(rows) > held
    assert all(int(row["samples"]) >= CYCLES_PER_LOAD_CYCLE for row in rows), [row["samples"] for row in rows]
    assert not any(row["peak_n"] == "nan" for row in rows)


WAITS = """
title: waits
blocks:
  - {block: cycles, amplitude: 2000.0, mean: 2000.0, frequency: 10.0, count: 30}
pacing: {mode: static, tolerance: 100.0, timeout: 5.0}
"""


@pytest.mark.long
def test_a_programme_that_waits_for_its_peaks_reaches_them_also_after_a_kill(graph, participant, spec_file, tmp_path):
    """A law that lags behind the reference; each load cycle is counted once, and none before its valley is reached."""
    file, spec = tmp_path / "programme.yaml", spec_file(duration=1000.0, controller="sic")
    file.write_text(WAITS, encoding="utf-8")
    points = participant.collect(ProgrammePoint, "programme_point")
    common = {"spec": spec, "timing": "lockstep"}
    own = {**common, "programme": file, "folder": tmp_path / "run"}
    graph.start("programme_node", **own)
    for name in ("disturbance_node", "sic_node"):
        graph.start(name, **common)
    graph.start("plant_sim_node", **common, partners="programme_node,disturbance_node,sic_node")
    participant.until(lambda: points and points[-1].load_cycles >= 5)
    graph.kill("programme_node")
    killed_ns = time.time_ns()
    saved = read_state(tmp_path / "run")
    assert saved is not None
    assert saved.counted < 30
    graph.start("programme_node", **own)
    participant.until(lambda: points.after(killed_ns) and points[-1].state == State.FINISHED)
    assert State.WAITING in {point.state for point in points}
    assert graph.stop("programme_node") == 0, graph.log("programme_node")
    heading, *lines = (tmp_path / "run" / "load_cycles.csv").read_text(encoding="utf-8").splitlines()
    rows = [dict(zip(heading.split(","), map(float, line.split(",")), strict=True)) for line in lines]
    assert [row["load_cycle"] for row in rows] == list(range(1, 31))
    assert all(row["peak_n"] > 3900.0 and row["valley_n"] < 100.0 for row in rows)
