"""A killed monitor resumes: without loss, and without false alarms."""

import csv
import shutil
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest

from ehls_ros.cli.main import main
from ehls_ros.errors import BadInput
from ehls_ros.estimate import Estimate
from ehls_ros.experiments.loop import run_in_process
from ehls_ros.experiments.monitoring.cycle_assembly import Anchor
from ehls_ros.experiments.monitoring.daily import results_of_day
from ehls_ros.experiments.monitoring.examination import Finding, FoundCause, Task
from ehls_ros.experiments.monitoring.health import FoundChange, State
from ehls_ros.experiments.monitoring.memory import COEFFICIENTS, STATE, Memory
from ehls_ros.experiments.monitoring.monitor import COMPARED_TIME, Monitor, Parameters
from ehls_ros.experiments.spec import Spec
from ehls_ros.experiments.state_files.access import NotWritten
from ehls_ros.experiments.state_files.state_file import Origin
from ehls_ros.physics.rig import Rig
from ehls_ros.trajectory import Trajectory

WATCHED = Parameters(learning_time=30.0, reading_time=10.0)
ANCHORS = (Anchor(0.0, 1_700_000_000 * 10**9),)
PARAMETERS = {"added": Estimate(2e-12, 1e-13, "m^3/(s*Pa)")}
LEAKS = FoundCause("internal_leakage_shift", "flow", 0.98, ("turbulent_leakage",), PARAMETERS)
CHANGE = FoundChange(1, (LEAKS,), "flow", (), 30.0, -np.inf, 33.0, 35.0, 36.0, acknowledged=True)


class FindsNothing:
    """An examiner who finds the rig as its file describes it."""

    def __init__(self) -> None:
        self.task: Task | None = None

    def begin(self, task: Task) -> None:
        self.task = task

    def finding(self) -> Finding | None:
        task, self.task = self.task, None
        return task and Finding("consistent", (), task.rig)

    def close(self) -> None:
        self.task = None


@pytest.fixture(scope="module")
def healthy(rig_file: Path) -> tuple[Spec, Trajectory]:
    from ehls_ros.experiments.spec import spec_from_mapping

    plain = {
        "rig": rig_file.name,
        "reference": {"name": "sine", "amplitude": 1e4, "frequency": 0.5},
        "disturbance": {"name": "force", "signal": {"name": "sine", "amplitude": 5e3, "frequency": 1.0}},
        "controller": {"name": "fasmc"},
        "duration": 70.0,
    }
    spec = spec_from_mapping(plain, "spec.yaml", rig_file.parent)
    return spec, run_in_process(spec)


def memory_of(folder: Path, rig: Rig, baselines: Sequence[str] = ()) -> Memory:
    return Memory(folder, Origin.of(rig, 1e-3), baselines)


@pytest.fixture(scope="module")
def rig_file() -> Path:
    return Path(__file__).resolve().parents[2] / "config" / "rig_paper.yaml"


def fed(monitor: Monitor, trajectory: Trajectory, begin: float, end: float) -> list[str]:
    """Give a monitor the samples of a period, and return its events."""
    first, last = np.searchsorted(trajectory.time_s, [begin, end])
    events = []
    for part in np.array_split(np.arange(first, last), max(1, (last - first) // 500)):
        signals = {name: values[part] for name, values in trajectory.signals.items() if values.ndim == 1}
        events += [event.kind for event in monitor.add(trajectory.time_s[part], signals)]
    return events


@pytest.fixture(scope="module")
def kept(healthy: tuple[Spec, Trajectory], tmp_path_factory: pytest.TempPathFactory) -> tuple[Monitor, Path]:
    """Return a monitor that watches, with a change it found, and the folder with its memory."""
    spec, trajectory = healthy
    folder = tmp_path_factory.mktemp("monitor")
    monitor = Monitor(spec.rig, WATCHED, FindsNothing())
    assert fed(monitor, trajectory, 0.0, 52.5) == ["learnt", "watching"]
    monitor.changes.append(CHANGE)
    memory_of(folder, spec.rig).save(monitor.saved_state(), ANCHORS, 52.5)
    return monitor, folder


@pytest.fixture
def folder(kept: tuple[Monitor, Path], tmp_path: Path) -> Path:
    return Path(shutil.copytree(kept[1], tmp_path / "copy"))


@pytest.mark.long
def test_it_goes_on_with_all_it_knew_and_without_an_alarm(healthy, kept, folder: Path):
    spec, trajectory = healthy
    before, _ = kept
    found = memory_of(folder, spec.rig).restore()
    assert found is not None
    assert (found.anchors, found.end) == (ANCHORS, 52.5)
    after = Monitor(spec.rig, WATCHED, FindsNothing())
    after.restore(found.state)
    assert [str(change) for change in after.changes] == [str(CHANGE)]
    assert after.history == before.history
    assert [past.time for past in after.history] == pytest.approx([41.5], abs=3.0)
    assert after.health().watched == before.health().watched > 0.0
    was, now, was_watched = before.saved_state(), after.saved_state(), before.health().watched
    assert now.begins == was.begins
    assert np.allclose(now.rows, was.rows, rtol=1e-6)
    assert [d.key for d in now.learnt.directions] == [d.key for d in was.learnt.directions]
    # The next blocks are judged, as they would have been.
    assert fed(after, trajectory, 52.5, 62.0) == fed(before, trajectory, 52.5, 62.0) == []
    assert after.health().state == State.WATCHING
    assert after.health().watched == was_watched + COMPARED_TIME
    assert np.allclose(after.saved_state().rows[:, -1], before.saved_state().rows[:, -1], rtol=1e-3, atol=1e-6)


@pytest.mark.long
def test_the_history_grows_by_what_is_new(healthy, folder: Path):
    spec, trajectory = healthy
    lines = (folder / COEFFICIENTS).read_text(encoding="utf-8").splitlines()
    memory = memory_of(folder, spec.rig)
    after = Monitor(spec.rig, WATCHED, FindsNothing())
    after.restore(memory.restore().state)
    memory.save(after.saved_state(), ANCHORS, 52.5)
    assert (folder / COEFFICIENTS).read_text(encoding="utf-8").splitlines() == lines
    fed(after, trajectory, 52.5, 69.9)
    memory.save(after.saved_state(), ANCHORS, 69.9)
    with (folder / COEFFICIENTS).open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [list(row.values()) for row in rows][: len(lines) - 1] == [line.split(",") for line in lines[1:]]
    new = {reading.name: reading for reading in after.history[-1].readings if reading.identified}
    assert {row["name"]: float(row["value"]) for row in rows[len(lines) - 1 :]} == pytest.approx(
        {name: reading.value for name, reading in new.items()}, rel=1e-6
    )
    assert rows[-1]["time"].startswith("2023-11-14T22:1")


@pytest.mark.parametrize(
    "spoil",
    [
        lambda folder: (folder / STATE).write_text("{", encoding="utf-8"),
        lambda folder: next(folder.glob("learnt*")).write_bytes(b""),
        lambda folder: next(folder.glob("learnt*")).write_bytes(b"PK"),
        lambda folder: next(folder.glob("blocks*")).unlink(),
        lambda folder: (folder / STATE).write_text(
            (folder / STATE).read_text(encoding="utf-8").replace("internal_leakage_shift", "x", 1).replace("cause", "c"),
            encoding="utf-8",
        ),
    ],
)
def test_what_cannot_be_used_is_put_aside_as_it_is_and_written_anew(healthy, kept, folder: Path, spoil):
    spoil(folder)
    spoilt = (folder / STATE).read_bytes()
    memory = memory_of(folder, healthy[0].rig)
    with pytest.raises(BadInput) as refused:
        memory.restore()
    said = memory.put_aside(refused.value)
    assert said.endswith(f"it is now in {folder / 'aside-1'}")
    assert (folder / "aside-1" / STATE).read_bytes() == spoilt
    assert memory.restore() is None
    memory.save(kept[0].saved_state(), ANCHORS, 50.0)
    assert memory_of(folder, healthy[0].rig).restore().end == 50.0


def test_a_writer_that_is_killed_leaves_the_state_before(healthy, kept, folder: Path, monkeypatch: pytest.MonkeyPatch):
    memory = memory_of(folder, healthy[0].rig)
    memory.restore()
    before = {path.name for path in folder.iterdir()}
    monkeypatch.setattr(Path, "replace", lambda *_: (_ for _ in ()).throw(OSError("killed")))
    with pytest.raises(NotWritten, match="killed"):
        memory.save(kept[0].saved_state(), ANCHORS, 50.0)
    monkeypatch.undo()
    assert {path.name for path in folder.iterdir()} == before
    assert memory_of(folder, healthy[0].rig).restore().end == 52.5


def test_another_rig_learns_for_itself(healthy, folder: Path):
    rig = healthy[0].rig
    other = rig._replace(plant=rig.plant._replace(moving_mass=2.0 * rig.plant.moving_mass))
    memory = memory_of(folder, other)
    with pytest.raises(BadInput, match=r"of another rig: plant\.moving_mass is 70\.0, not 140\.0") as refused:
        memory.restore()
    memory.put_aside(refused.value)
    assert {path.name for path in (folder / "aside-1").iterdir()} >= {STATE, COEFFICIENTS, "learnt_0.npz", "blocks_0.npz"}
    assert [path.name for path in folder.iterdir()] == ["aside-1"]
    # It can be taken up again.
    assert memory_of(folder / "aside-1", rig).restore().end == 52.5
    for memory in (
        memory_of(folder / "aside-1", rig, ["a healthy recording"]),
        Memory(folder / "aside-1", Origin.of(rig, 2e-3)),
    ):
        with pytest.raises(BadInput, match=r"baselines none|control_period"):
            memory.restore()


def test_foreign_files_are_neither_replaced_nor_removed(healthy, kept, folder: Path):
    foreign = {"notes.npz": b"PK", "learnt_1.npz": b"mine", "blocks_7.npz": b"", "learnt_x.npz": b"PK"}
    for name, content in foreign.items():
        (folder / name).write_bytes(content)
    memory = memory_of(folder, healthy[0].rig)
    kept_by_me = kept[0].saved_state()
    for end in (50.0, 55.0, 60.0):
        memory.save(
            kept_by_me._replace(learnt=kept_by_me.learnt._replace(directions=tuple(kept_by_me.learnt.directions))), ANCHORS, end
        )
    assert {name: (folder / name).read_bytes() for name in foreign} == foreign
    assert memory_of(folder, healthy[0].rig).restore().end == 60.0
    # Of its files, only those in use are left.
    assert len(list(folder.glob("*.npz"))) == len(foreign) + 2


def test_a_history_of_something_else_is_put_aside_and_a_torn_line_is_finished(healthy, kept, folder: Path):
    path = folder / COEFFICIENTS
    whole = path.read_bytes()
    path.write_bytes(whole + b"2023-11-14T22:1")
    memory = memory_of(folder, healthy[0].rig)
    assert memory.open_history() == ""
    memory.close()
    assert path.read_bytes() == whole
    path.write_text("date,value\n", encoding="utf-8")
    assert "aside-1" in memory.open_history()
    assert (folder / "aside-1" / COEFFICIENTS).read_text(encoding="utf-8") == "date,value\n"
    memory.save(kept[0].saved_state(), ANCHORS, 50.0)
    assert path.read_bytes().splitlines()[0] == whole.splitlines()[0]


def test_a_repair_begins_anew(healthy, folder: Path):
    spec, trajectory = healthy
    monitor = Monitor(spec.rig, WATCHED, FindsNothing())
    monitor.restore(memory_of(folder, spec.rig).restore().state)
    fed(monitor, trajectory, 52.5, 53.0)
    monitor.reset()
    assert monitor.health().active == ()
    assert monitor.health().state == State.LEARNING
    assert monitor.saved_state().learnt is None


def test_the_report_of_a_day_is_made_of_the_folder(healthy, kept, folder: Path, capsys):
    """The stamps are those of the anchors: findings are reported with their wall time."""
    begin = datetime.fromtimestamp(ANCHORS[-1].stamp_ns * 1e-9).astimezone()
    watched, midnight = results_of_day(folder, begin.date())
    assert midnight.date() == begin.date()
    [past] = watched.history
    assert midnight.timestamp() + past.time == pytest.approx(ANCHORS[-1].stamp_ns * 1e-9 + 40.4 - ANCHORS[-1].time, abs=3.0)
    assert {r.name: r.value for r in past.readings} == pytest.approx(
        {r.name: r.value for r in kept[0].history[0].readings if r.identified}, rel=1e-6
    )
    assert watched.health.changes[0].name == CHANGE.name
    assert main(["report", str(folder), "--day", begin.date().isoformat()]) == 0
    page = folder / f"report-{begin.date()}.html"
    assert capsys.readouterr().out.strip() == str(page)
    assert "internal leakage" in page.read_text(encoding="utf-8")
