"""State and log of a programme: checked before anything is changed, and refused if no run can have left them."""

import shutil
from pathlib import Path

import pytest

from benchmarks.spoilt_memory import ORIGIN, PERIOD, PROGRAMME, RIG, changed, make_programme
from ehls_ros.control.programme.declaration import Parameters
from ehls_ros.control.programme.expansion import Programme
from ehls_ros.control.programme.motion import Runner
from ehls_ros.errors import BadInput
from ehls_ros.experiments.programme_records import LOG, STATE, Records, open_records, read_state
from ehls_ros.experiments.state_files.state_file import Origin
from ehls_ros.schema import parse


@pytest.fixture(scope="module")
def left(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder left by a programme of 100 load cycles, of which 19 were counted."""
    folder = tmp_path_factory.mktemp("programme")
    make_programme(folder, STATE)
    return folder


@pytest.fixture
def folder(left: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(left, tmp_path / "copy"))


def opened(folder: Path, *, anew: bool = False, programme: Programme = PROGRAMME, origin: Origin = ORIGIN) -> Records:
    records = open_records(folder, programme, origin, "force", RIG.limits, anew=anew)
    records.close()
    return records


def altered(**settings: object) -> Programme:
    return Programme(parse(Parameters, {**PROGRAMME.parameters._asdict(), **settings}, "test"), "test")


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_a_programme_goes_on_where_it_was(folder: Path):
    before = contents(folder)
    records = opened(folder)
    assert records.state == read_state(folder)
    assert (records.counted, records.remarks) == (19, ())
    assert contents(folder) == before


def spoil_state(key: str, value: object):
    def spoil(folder: Path) -> None:
        def change(document, arrays) -> None:
            document["content"][key] = value

        changed(folder / STATE, change)

    return spoil


def spoil_motion(**values: object):
    def spoil(folder: Path) -> None:
        def change(document, arrays) -> None:
            document["content"]["motions"][-1].update(values)

        changed(folder / STATE, change)

    return spoil


def spoil_leg(**values: object):
    def spoil(folder: Path) -> None:
        def change(document, arrays) -> None:
            document["content"]["motions"][-1]["legs"][-1].update(values)

        changed(folder / STATE, change)

    return spoil


def spoil_log(change):
    return lambda folder: (folder / LOG).write_bytes(change((folder / LOG).read_bytes()))


SPOILT = {
    "rests at 1e9": (spoil_motion(rests=1e9), "it rests at 1e+09, the rig's range is -18200 to 18200"),
    "rests where the programme does not": (spoil_motion(rests=5e3), "it rests at 5000, where the programme holds"),
    "1e12 N to begin with": (spoil_leg(row=[1e12, 0.0, 0.0]), "a leg leads 1e+12 from the middle"),
    "1e12 N to end with": (spoil_leg(to=1e12), "a leg leads 1e+12 from the middle"),
    "a jump after a leg": (spoil_leg(to=900.0), "the reference jumps between two legs from 900 to 100"),
    "an endless leg": (spoil_leg(duration=1e9), "a leg takes 1e+09 s"),
    "far along the programme": (spoil_motion(since=1e6), "a motion is 1e+06 s along the programme"),
    "twice its speed": (spoil_motion(speed=2.0), "a motion follows the programme at 2 times its speed"),
    "backwards": (spoil_motion(speed=-0.5), "a motion follows the programme at -0.5 times its speed"),
    "no motions": (spoil_state("motions", []), "no motion holds"),
    "a motion as text": (spoil_state("motions", ["stop"]), "a mapping of keys to values"),
    "a negative stiffness": (spoil_state("stiffness", [{"block": 0, "total": -1.0, "cycles": 3}]), "a stiffness that is not"),
    "the stiffness that brought a division by zero back": (
        spoil_state("stiffness", [{"block": 0, "total": 0.0, "cycles": 10}]),
        "a stiffness that is not positive",
    ),
    "cycles out of order": (spoil_state("published", 3), "its control cycles do not follow one another"),
    "more load cycles than there are": (spoil_state("counted", 101), "101 load cycles are counted, the programme has 100"),
    "a NUL tail of the log": (spoil_log(lambda log: log + bytes(512)), "damaged at its end (a line is not text)"),
    "a last line of text": (spoil_log(lambda log: log + b"the end\n"), "a line has 1 values, not 16"),
    "load cycle 999999999": (
        spoil_log(lambda log: log + log.splitlines(keepends=True)[-1].replace(b"19,", b"999999999,", 1)),
        "a line has load cycle 999999999, the programme has 100",
    ),
    "load cycles ahead of the state": (
        spoil_log(lambda log: log + log.splitlines(keepends=True)[-1].replace(b"19,", b"57,", 1)),
        "the log has load cycle 57, the programme has reached",
    ),
    "load cycles that go back": (
        spoil_log(lambda log: log + log.splitlines(keepends=True)[3]),
        "load cycle 3 follows load cycle 19",
    ),
    "a log of positions": (spoil_log(lambda log: log.replace(b"peak_n", b"peak_m", 1)), "the log has other columns"),
    "an empty state": (lambda folder: (folder / STATE).write_bytes(b""), "it is empty"),
}


@pytest.mark.parametrize("way", SPOILT)
def test_what_no_run_can_have_left_is_refused_before_anything_is_changed(folder: Path, way: str):
    spoil, said = SPOILT[way]
    spoil(folder)
    before = contents(folder)
    with pytest.raises(BadInput) as refused:
        opened(folder)
    assert said in str(refused.value)
    assert "anew:=true" in refused.value.expected
    assert contents(folder) == before


@pytest.mark.parametrize(
    ("programme", "origin", "said"),
    [
        (altered(start=600.0), ORIGIN, "it is of another programme"),
        (PROGRAMME, Origin.of(RIG, 2.0 * PERIOD), "is of a control_period of 0.001 s, not 0.002 s"),
        (PROGRAMME, ORIGIN._replace(rig={**ORIGIN.rig, "sensors": {"force": {"bias": 1.0}}}), "it has no sensors.force"),
    ],
)
def test_the_state_of_another_programme_rig_or_rate_is_refused(folder: Path, programme, origin, said):
    before = contents(folder)
    with pytest.raises(BadInput, match="anew:=true") as refused:
        opened(folder, programme=programme, origin=origin)
    assert said in str(refused.value)
    assert contents(folder) == before


def test_settings_that_changed_since_the_last_start_are_named(folder: Path):
    said = opened(folder, programme=altered(hold=None, stop_time=0.25)).remarks
    assert said == (
        "hold of the programme was 100 and is not given from the next stop on [N or m]",
        "stop_time of the programme was 0.5 and is 0.25 from the next stop on [s]",
    )
    # Its limits and its pacing may change.
    pacing = {"mode": "static", "tolerance": 10.0}
    assert opened(folder, programme=altered(limits={"peak_error": 100.0}, pacing=pacing)).remarks == ()


def test_a_programme_that_begins_anew_loses_nothing_of_the_one_before(folder: Path):
    before = contents(folder)
    records = opened(folder, anew=True)
    assert records.state is None
    assert "programme_state.1.json" in records.remarks[0]
    after = contents(folder)
    assert (after["programme_state.1.json"], after["load_cycles.1.csv"]) == (before[STATE], before[LOG])
    assert after[LOG].count(b"\n") == 1
    # A log whose state is lost is kept as well.
    opened(folder)
    (folder / LOG).write_bytes(before[LOG])
    opened(folder)
    assert contents(folder)["load_cycles.2.csv"] == before[LOG]
    (folder / LOG).write_bytes(b"mine\n")
    with pytest.raises(BadInput, match="the log has other columns"):
        opened(folder, anew=True)
    assert contents(folder)[LOG] == b"mine\n"


def test_lines_that_a_power_failure_took_are_said_and_not_counted_again(folder: Path):
    lines = (folder / LOG).read_bytes().splitlines(keepends=True)
    (folder / LOG).write_bytes(b"".join(lines[:15]) + lines[15][:9])
    records = opened(folder)
    assert records.counted == 19
    assert records.remarks == (f"{folder / LOG} lacks the load cycles 15 to 19, which were counted",)
    # The torn line is gone.
    assert (folder / LOG).read_bytes() == b"".join(lines[:15])


@pytest.mark.parametrize("anew", [False, True])
def test_a_second_programme_in_a_folder_is_refused_and_changes_nothing(folder: Path, anew: bool):
    records = open_records(folder, PROGRAMME, ORIGIN, "force", RIG.limits, anew=False)
    before = contents(folder)
    with pytest.raises(BadInput, match="runs another programme in the folder; expected another folder, or that process"):
        opened(folder, anew=anew)
    assert contents(folder) == before
    records.close()
    assert opened(folder).counted == 19


def test_records_that_are_refused_leave_the_folder_free(folder: Path):
    with pytest.raises(BadInput, match="it is of another programme"):
        opened(folder, programme=altered(start=600.0))
    assert opened(folder).counted == 19


def test_a_folder_that_cannot_be_written_is_said_at_the_start(tmp_path: Path):
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(BadInput, match=r"the programme state cannot be written \((Not a directory|File exists)\)"):
        opened(tmp_path / "file" / "run")


def test_every_motion_that_a_programme_makes_is_accepted():
    """The check covers stop, resume, skip and pacing, at any time."""
    from ehls_ros.control.programme.motion_check import check_motions

    paced = altered(pacing={"mode": "static", "tolerance": 10.0})
    for seed in range(20):
        programme = (PROGRAMME, paced)[seed // 2 % 2]
        runner = Runner(programme, PERIOD, (Runner.beginning(programme, 0, 300.0, 0.3 * (seed % 2)),))
        cycle = 0
        for step in range(30):
            cycle += (1, 7, 40, 160, 600)[(seed + step * step) % 5]
            request = ("stop", "resume", "skip", "resume")[(step + seed) % 4]
            runner.stop(cycle, "test") if request == "stop" else getattr(runner, request)(cycle)
            cycle += 40
            if runner.motions[-1].rests is None and cycle > runner.arrival():
                runner.run_to_reversal(cycle) if programme is paced else runner.pace(cycle, (0.3, 1.0)[step % 2])
            runner.forget(cycle - (0, 200, 900)[step % 3])
            check_motions(tuple(runner.motions), PROGRAMME, PERIOD, (100.0,), -2e4, 2e4)
        runner.motions = [runner.resting(cycle, runner.at(cycle)[0], 800.0, "fell out", runner.motions[-1].skipped)]
        check_motions(tuple(runner.motions), PROGRAMME, PERIOD, (100.0,), -2e4, 2e4)
