"""Running a campaign in this process: reuse of results, repeated runs, and traces of a failed run."""

import json
import sys
from contextlib import nullcontext

import numpy as np
import pytest
from campaign_cases import BASE, CONFIG, DRAWS, write

from ehls_ros.cli.main import main
from ehls_ros.errors import BadInput, WorkFailed
from ehls_ros.experiments.campaign import conduct as conducting
from ehls_ros.experiments.campaign import work
from ehls_ros.experiments.campaign.backends import Backend, local
from ehls_ros.experiments.campaign.conduct import conduct
from ehls_ros.experiments.campaign.plan import load_plan
from ehls_ros.experiments.campaign.store import opened, read_results
from ehls_ros.experiments.loop import run_in_process
from ehls_ros.experiments.metrics import evaluate
from ehls_ros.experiments.spec import spec_from_mapping
from ehls_ros.extras import install_command
from ehls_ros.physics.lane_memory import LANES

pyarrow_parquet = pytest.importorskip("pyarrow.parquet", reason="pyarrow, of the extra campaign, is not installed")


def make(path, out, progress=None):
    plan = load_plan(path)
    with opened(out) as folder:
        return conduct(plan, folder, local(1), progress)


def rows(out):
    return read_results(out / "results.parquet")


def kept(out):
    return [digest for part in (out / "parts").glob("*.parquet") for digest in read_results(part)["digest"]]


def test_a_row_is_what_the_experiment_gives_by_itself(tmp_path):
    path = write(tmp_path, runs=3, vary={**DRAWS, "controller.k": [6, 12]})
    assert make(path, tmp_path / "out")[:2] == (6, 6)
    found = rows(tmp_path / "out")
    for run in load_plan(path).runs():
        metrics = evaluate(run_in_process(spec_from_mapping(json.loads(run.spec), "run", CONFIG)))._asdict()
        for name in set(work.METRICS) - {"wall_s"}:
            assert found[name][run.number] == metrics[name], name
        assert found["rig.plant.moving_mass"][run.number] == json.loads(run.spec)["rig"]["plant"]["moving_mass"]
    assert found["run"] == list(range(6))
    assert found["draw"] == [0, 0, 1, 1, 2, 2]
    assert found["error"] == [None] * 6
    assert all(wall > 0.0 for wall in found["wall_s"])


def test_the_table_has_fixed_kinds_of_columns_and_says_what_made_it(tmp_path):
    make(write(tmp_path, vary={"controller.k": [6, 12], "compensation": ["gms", "stribeck"]}), tmp_path / "out")
    schema = pyarrow_parquet.read_schema(tmp_path / "out" / "results.parquet")
    kinds = {name: str(schema.field(name).type) for name in schema.names}
    assert kinds["controller.k"] == kinds["max_error_n"] == kinds["convergence_s"] == "double"
    assert kinds["compensation"] == kinds["error"] == kinds["digest"] == "string"
    assert kinds["cycles"] == kinds["run"] == "int64"
    assert json.loads(schema.metadata[b"ehls_ros"])["version"] == work.code_version()


def test_started_again_it_makes_nothing_again(tmp_path):
    path = write(tmp_path, runs=4, vary=DRAWS)
    assert make(path, tmp_path / "out").made == 4
    first = rows(tmp_path / "out")
    assert make(path, tmp_path / "out").made == 0
    assert rows(tmp_path / "out") == first


def test_a_changed_campaign_takes_over_what_it_shares(tmp_path):
    out = tmp_path / "out"
    make(write(tmp_path, vary={"controller.k": [6, 12]}), out)
    assert make(write(tmp_path, vary={"controller.h": [25], "controller.k": [12, 18, 6]}), out)[:2] == (3, 1)
    found = rows(out)
    assert found["controller.k"] == [12.0, 18.0, 6.0]
    assert found["controller.h"] == [25.0] * 3
    again = tmp_path / "again"
    make(tmp_path / "campaign.yaml", again)
    assert found["max_error_n"] == rows(again)["max_error_n"]


def test_other_code_makes_every_run_anew(tmp_path, monkeypatch):
    path = write(tmp_path, vary={"controller.k": [6, 12]})
    make(path, tmp_path / "out")
    other = f"{work.code_version()}x"
    for module in (work, conducting, sys.modules[local.__module__]):
        monkeypatch.setattr(module, "code_version", lambda: other)
    assert make(path, tmp_path / "out").made == 2
    assert len(rows(tmp_path / "out")["run"]) == 2


@pytest.mark.parametrize("after", [1, 5])
def test_an_interruption_keeps_what_is_done(tmp_path, after):
    path, out = write(tmp_path, runs=8, vary=DRAWS), tmp_path / "out"

    def interrupt(done, total):
        if done >= after:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        make(path, out, interrupt)
    done = kept(out)
    assert after <= len(done) < 8
    assert not (out / "results.parquet").exists()
    assert make(path, out).made == 8 - len(done)
    assert sorted(kept(out)) == sorted(set(kept(out))) == sorted(rows(out)["digest"])


def test_runs_that_fail_leave_their_reason_and_the_others_go_on(tmp_path):
    # A Coulomb force above the static one is refused; the centre of the distribution is below.
    vary = {"rig.friction.coulomb_force": {"uniform": [600.0, 1100.0]}}
    path = write(tmp_path, runs=12, vary=vary)
    assert make(path, tmp_path / "out").made == 12
    found = rows(tmp_path / "out")
    refused = [value > 865.4 for value in found["rig.friction.coulomb_force"]]
    assert 0 < sum(refused) < 12
    assert [error is not None for error in found["error"]] == refused
    assert [error is None for error in found["max_error_n"]] == refused
    assert all("coulomb_force" in error for error in found["error"] if error)


def test_a_run_whose_numbers_are_lost_says_when(tmp_path, monkeypatch):
    def lost(spec):
        run = run_in_process(spec)
        run.signals["force_n"][150:] = np.nan
        return run

    monkeypatch.setattr(work, "run_in_process", lost)
    make(write(tmp_path), tmp_path / "out")
    [error] = rows(tmp_path / "out")["error"]
    assert error == "the force is not finite after 0.15 s"


def test_equal_runs_are_made_once_and_told_twice(tmp_path):
    path = write(tmp_path, vary={"controller.k": [12, 12.0, 6]})
    assert make(path, tmp_path / "out").made == 2
    found = rows(tmp_path / "out")
    assert len(found["run"]) == 3
    assert found["max_error_n"][0] == found["max_error_n"][1]


@pytest.mark.parametrize(("duration", "first", "last"), [(10.0, 2 * LANES, LANES), (150.0, 2, 1)], ids=["lanes", "alone"])
def test_chunks_shrink_towards_the_end_and_hold_every_run_once(tmp_path, duration, first, last):
    plan = load_plan(write(tmp_path, runs=50 * LANES, vary=DRAWS, base={**BASE, "duration": duration}))
    with opened(tmp_path / "out") as folder:
        chunks = list(conducting._Work(plan, folder, None)._chunks(slots=2))
    sizes = [len(chunk.specs) for chunk in chunks]
    assert sizes == sorted(sizes, reverse=True)
    assert (sizes[0], sizes[-1]) == (first, last)
    assert {chunk.side_by_side for chunk in chunks} == {last == LANES}
    assert [spec for chunk in chunks for spec in chunk.specs] == [run.spec for run in plan.runs()]


@pytest.mark.parametrize(("own", "ready"), [(True, True), (True, False), (False, True)])
def test_few_runs_go_side_by_side_where_the_loop_for_that_is_compiled(tmp_path, monkeypatch, own, ready):
    monkeypatch.setattr(conducting, "is_ready", lambda spec: ready)
    together = set()

    def note(chunks):
        for chunk in chunks:
            together.add(chunk.side_by_side)
            yield chunk, [dict.fromkeys(work.METRICS) | {"error": "not made"}] * len(chunk.specs)

    plan = load_plan(write(tmp_path, runs=LANES, vary=DRAWS))
    with opened(tmp_path / "out") as folder:
        conducting.conduct(plan, folder, nullcontext(Backend(1, note, own_kernels=own)))
    assert together == {own and ready}
    assert rows(tmp_path / "out")["error"] == ["not made"] * LANES


def test_a_worker_with_other_code_is_refused():
    with pytest.raises(WorkFailed, match=r"0\.0\.0"):
        work.run_chunk([], "0.0.0")


def test_one_campaign_at_a_time_in_a_folder(tmp_path):
    with opened(tmp_path), pytest.raises(BadInput, match="another campaign"), opened(tmp_path):
        pass
    with opened(tmp_path):
        pass


def test_a_damaged_part_is_named(tmp_path):
    path = write(tmp_path)
    make(path, tmp_path / "out")
    [part] = (tmp_path / "out" / "parts").glob("*.parquet")
    part.write_bytes(part.read_bytes()[:100])
    with pytest.raises(BadInput, match=f"{part.name}.*delete it"):
        make(path, tmp_path / "out")


@pytest.mark.parametrize(
    ("module", "options"), [("pyarrow.parquet", []), ("joblib", []), ("distributed", ["--dask", "tcp://127.0.0.1:1"])]
)
def test_a_missing_package_names_its_extra(tmp_path, capsys, monkeypatch, module, options):
    monkeypatch.setitem(sys.modules, module, None)
    assert main(["campaign", str(write(tmp_path)), "--out", str(tmp_path / "out"), *options]) == 2
    assert install_command("campaign") in capsys.readouterr().err


def test_the_command_leaves_table_report_and_campaign(tmp_path, capsys):
    path, out = write(tmp_path, title="two of a kind", vary={"controller.k": [6, 12]}), tmp_path / "out"
    assert main(["campaign", str(path), "--out", str(out), "--jobs", "1", "--json"]) == 0
    summary = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert (summary["runs"], summary["made"], summary["failed"]) == (2, 2, 0)
    assert summary["largest_max_error_n"] == max(rows(out)["max_error_n"])
    assert "two of a kind" in (out / "report.html").read_text()
    assert main(["campaign", str(out / "campaign.yaml"), "--out", str(out), "--jobs", "1", "--json"]) == 0
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["made"] == 0


def test_the_spec_of_one_run_is_an_experiment_of_its_own(tmp_path, capsys):
    path = write(tmp_path, runs=2, vary=DRAWS)
    make(path, tmp_path / "out")
    assert main(["campaign", str(path), "--spec", "1"]) == 0
    (tmp_path / "one.yaml").write_text(capsys.readouterr().out)
    assert main(["experiment", str(tmp_path / "one.yaml"), "--in-process", "--out", str(tmp_path / "run")]) == 0
    metrics = json.loads((tmp_path / "run" / "metrics.json").read_text())
    assert metrics["max_error_n"] == rows(tmp_path / "out")["max_error_n"][1]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--jobs", "0"], ("--jobs is 0", "1 or more")),
        (["--spec", "9"], ("run 9", "0 to 0")),
        (["--dask", "nonsense://nowhere"], ("nonsense://nowhere", "--dask")),
    ],
)
def test_wrong_options_are_one_line(tmp_path, capsys, options, words):
    assert main(["campaign", str(write(tmp_path)), "--out", str(tmp_path / "out"), *options]) == 2
    [line] = capsys.readouterr().err.strip().splitlines()
    for word in words:
        assert word in line
