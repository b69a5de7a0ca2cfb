"""`import ehls_ros as ehls`: the interface of scripts and notebooks."""

import re
import subprocess
import sys
from functools import partial

import numpy as np
import pytest
import yaml
from pandas import DataFrame, Series
from rich.console import Console

import ehls_ros as ehls
from ehls_ros import progress
from ehls_ros.api.recordings import by_name
from ehls_ros.errors import BadInput
from ehls_ros.experiments import compiling
from ehls_ros.physics.effects.viscous_asymmetry import Parameters as Asymmetry
from ehls_ros.physics.rig import EffectUse

HEAVY = ("numba", "numpy", "pandas", "plotly", "rclpy", "rich", "scipy", "yaml")


@pytest.fixture(scope="module")
def run():
    """One second of a simulated rig."""
    return ehls.simulate("constant_fd2", duration=1.0, controller={"name": "fasmc", "k": 6.0}, seed=3)


@pytest.fixture
def own_file(run, tmp_path):
    """The run in a bench's file format, with the map of its columns."""
    table = run.to_pandas()
    table["x [mm]"], table["p [bar]"] = 1e3 * table["position_m"], 1e-5 * table["load_pressure_pa"]
    table[["x [mm]", "p [bar]"]].to_csv(tmp_path / "bench.csv", index_label="t")
    columns = {
        "time_s": {"name": "t"},
        "position_m": {"name": "x [mm]", "unit": "mm"},
        "load_pressure_pa": {"name": "p [bar]", "unit": "bar"},
    }
    return tmp_path / "bench.csv", columns


def test_the_import_loads_nothing():
    code = f"import sys, ehls_ros; print([name for name in sys.modules if name in {HEAVY} or name.startswith('ehls_ros.')])"
    assert subprocess.check_output([sys.executable, "-c", code], text=True).strip() == "[]"


def test_every_public_name_is_there_and_no_other():
    assert sorted(name for names in ehls._HOME.values() for name in names) == sorted(ehls.__all__)
    assert all(getattr(ehls, name).__module__.startswith("ehls_ros.") for name in ehls.__all__)
    assert set(ehls.__all__) <= set(dir(ehls))
    with pytest.raises(AttributeError, match="no_such_name"):
        _ = ehls.no_such_name


def test_the_module_is_the_command():
    said = subprocess.check_output([sys.executable, "-m", "ehls_ros", "run", "--help"], text=True)
    assert said.startswith("usage: ehls run")


def test_arguments_take_the_place_of_the_experiments(run):
    assert run.spec.settings.duration == run.time_s[-1] == 1.0
    assert (run.spec.controller.parameters.k, run.spec.settings.seed) == (6.0, 3)
    assert run.metrics.cycles == len(run) == 1001
    again = ehls.simulate(run.spec, rig="rig_paper_measured", effects=[{"name": "viscous_asymmetry", "asymmetry": 10.0}])
    assert again.spec.rig.sensors
    assert [use.name for use in again.spec.rig.effects] == ["viscous_asymmetry"]
    assert not again.spec.controller_rig.effects


def test_a_run_that_ends_early_is_a_result_with_the_reason():
    run = ehls.simulate("constant_fd2", effects=[{"name": "viscous_asymmetry", "asymmetry": -1e6}])
    assert run.time_s[-1] < 1.0
    assert "the run ended at" in run.metrics.warnings[0]


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: ehls.simulate("sine_fd3"), r"'sine_fd3'; expected a file's path, or .*sine_fd2"),
        (lambda: ehls.simulate("sine_fd2", duration=-1.0), "simulate, from .*: duration is -1"),
        (lambda: ehls.simulate(rig="rig_paper"), "reference"),
        (lambda: ehls.rig("no_rig.yaml"), r"no_rig\.yaml"),
        (lambda: ehls.rig(None), "rig: it is of the type NoneType; expected a rig, the path"),
        (lambda: ehls.simulate(5), "spec: it is of the type int"),
        (lambda: ehls.campaign(["sine_fd2"]), "plan: it is of the type list"),
        (lambda: ehls.campaign({"base": "sine_fd2"}, jobs=0), "jobs: it is 0; expected a whole number, 1 or more"),
        (
            lambda: ehls.diagnose(DataFrame(), "rig_paper"),
            r"data: it is of the type DataFrame; .* Recording\(",
        ),
        (lambda: ehls.diagnose("x.csv", "rig_paper", threads=0), "threads: it is 0"),
        (lambda: ehls.diagnose("x.csv", "rig_paper", seed=-1), "seed: it is -1; expected a whole number, 0 or more"),
        (lambda: ehls.diagnose("x.csv", "rig_paper", seed="1"), "seed: it is '1'"),
        (lambda: ehls.identify("x.csv", "rig_paper", elements=0), "elements: it is 0"),
        (lambda: ehls.load("x.csv", {"position": {"name": "x"}}), "columns: name 'position' is unknown"),
        (lambda: ehls.identify([], "rig_paper", whole_rig=True, elements=3), "elements and whole_rig"),
        (lambda: ehls.campaign({"base": "sine_fd2", "vary": {"controler.k": [1.0]}}), r"controler\.k"),
    ],
)
def test_a_mistake_is_said_with_its_place(call, said):
    with pytest.raises(ehls.BadInput, match=said):
        call()


@pytest.mark.parametrize(
    "work", [ehls.diagnose, ehls.identify, partial(ehls.identify, whole_rig=True)], ids=["diagnose", "friction", "whole rig"]
)
def test_a_rig_in_another_unit_is_named_before_anything_is_fitted(work, tmp_path):
    time = np.arange(0.0, 5.0, 0.01)
    moving = np.sin(time)
    table = np.stack([time, 0.1 * moving, 2e6 * moving, np.full_like(time, 7e6)], axis=1)
    signals = "time_s,position_m,load_pressure_pa,supply_pressure_pa"
    np.savetxt(tmp_path / "recorded.csv", table, delimiter=",", header=signals, comments="")
    known = ehls.rig("rig_paper")
    wrong = known._replace(plant=known.plant._replace(supply_pressure=70.0))
    with pytest.raises(ehls.BadInput, match=r"recorded\.csv: plant\.supply_pressure .* is 70 Pa: bar\?.*70 bar was meant"):
        work(tmp_path / "recorded.csv", wrong, progress=False)


def test_a_file_of_ones_own_is_read_by_a_mapping_or_its_file(own_file, run, tmp_path):
    path, columns = own_file
    (tmp_path / "columns.yaml").write_text(yaml.safe_dump(columns))
    for given in (columns, str(tmp_path / "columns.yaml")):
        read = ehls.load(str(path), given)
        assert np.allclose(read["position_m"], run["position_m"], rtol=1e-9)
    assert read.name == "bench.csv"
    assert read.describe().loc["position_m", "unit"] == "m"
    assert columns["position_m"]["unit"] == "mm", "the caller's mapping is left alone"


def test_a_recording_becomes_a_table_and_a_file_and_comes_back(run, tmp_path):
    table = run.to_pandas()
    assert table.index.name == "time_s"
    assert np.array_equal(table["friction_elements_n_1"], run["friction_elements_n"][:, 0])
    for name in ("run.csv", "bag"):
        back = ehls.load(run.save(tmp_path / name))
        assert np.array_equal(back["force_n"], run["force_n"])
    assert "<title>" in run.report(tmp_path / "new" / "run.html").read_text(encoding="utf-8")


def test_a_recording_is_made_of_lists_and_columns_of_tables():
    recording = ehls.Recording([0.0, 0.1], {"force_n": Series([1.0, 2.0], index=[7, 8])})
    assert (repr(recording), recording["force_n"][-1]) == ("<Recording recording: 0.1 s, 2 samples, 1 signals>", 2.0)
    with pytest.raises(KeyError, match="did you mean 'force_n'"):
        _ = recording["forc_n"]
    with pytest.raises(ValueError, match=r"time_s is 0\.1 after 0\.1 in sample 3"):
        ehls.Recording([0.0, 0.1, 0.1], {})


def test_recordings_of_one_name_are_numbered(run):
    assert list(by_name([run, run], None)) == [f"{run.name} 1", f"{run.name} 2"]
    assert list(by_name(run, None)) == [run.name]


def test_signals_of_one_unit_share_a_row_whose_axis_has_the_unit(run):
    pytest.importorskip("plotly.graph_objects")
    drawn = run.plot("force_n", "load_pressure_pa", "force_reference_n")
    assert [trace.yaxis for trace in drawn.data] == ["y", "y", "y2"]
    assert (drawn.layout.yaxis.title.text, drawn.layout.yaxis2.title.text) == ("force [N]", "pressure [bar]")
    with pytest.raises(ehls.BadInput, match="no_signal"):
        run.plot("no_signal")


def test_a_campaign_is_a_table_with_a_row_for_a_run_that_fails(run):
    pytest.importorskip("joblib")
    pytest.importorskip("pyarrow")
    worn = run.spec._replace(rig=run.spec.rig.with_effects((EffectUse("viscous_asymmetry", Asymmetry(0.0)),)))
    found = ehls.campaign({"base": worn, "vary": {"rig.effects.0.asymmetry": [0.0, -1e6]}}, jobs=1)
    table = found.to_pandas()
    assert list(table["rig.effects.0.asymmetry"]) == [0.0, -1e6]
    assert table["error"].isna().tolist() == [True, False]
    assert "rig.effects.0.asymmetry" in found.plot().layout.xaxis.title.text


@pytest.mark.long
def test_a_diagnosis_from_a_file_to_the_extended_rig(tmp_path, capsys):
    pytest.importorskip("plotly.graph_objects")
    worn = {"name": "coulomb_shift", "offset": -150.0}
    reference = {"name": "irregular", "amplitude": 8.0e3, "seed": 1}
    recorded = ehls.simulate("sine_fd2", rig="rig_paper_measured", effects=[worn], reference=reference, duration=8.0)
    for compile_kernel in compiling.announce_compiling(compiling.diagnosis_jobs(ehls.rig("rig_paper_measured"))):
        compile_kernel()
    capsys.readouterr()
    found = ehls.diagnose(recorded.save(tmp_path / "worn.csv"), "rig_paper_measured", threads=1)
    assert (found.verdict, found.name) == ("effect", "worn.csv")
    [row] = found.to_pandas().itertuples()
    assert (row.cause, row.unit) == ("coulomb_shift", "N")
    assert abs(row.value - -150.0) < 4.0 * row.std
    assert ehls.rig(ehls.save_rig(found.extended, tmp_path / "rig.yaml")).effects[0].name == "coulomb_shift"
    assert found.sentence in found._repr_html_()
    assert "N]" in found.plot().layout.yaxis.title.text
    assert capsys.readouterr() == ("", ""), "no bar where there is no terminal"


class Displayed(list):
    """Stand-in for IPython's display that records the displayed objects."""

    def display(self, shown, *, display_id):
        assert display_id
        self.append(shown)
        return self

    def update(self, shown):
        self.append(shown)

    def HTML(self, text):  # noqa: N802 - IPython's name
        return text


def test_a_bar_in_a_notebook_needs_no_widgets_and_disappears(monkeypatch):
    cell = Displayed()
    monkeypatch.setattr(Console, "is_jupyter", True, raising=False)
    monkeypatch.setattr(Console, "__init__", as_in_a_notebook(Console.__init__))
    monkeypatch.setattr(progress, "import_module", {"IPython.display": cell}.get)
    monkeypatch.setattr(progress, "REDRAWN_EVERY", 0.0)
    with progress.progress_bar("diagnosing") as bar:
        bar(1, 4, "reading")
    first, drawn, last = cell
    assert first is drawn
    assert drawn.tasks[0].description == "reading"
    assert last == ""
    with progress.progress_bar("diagnosing", shown=False) as bar:
        bar(1, 4)
    assert len(cell) == 3


def test_progress_into_a_file_is_a_line_now_and_then(monkeypatch, capsys):
    clock = iter([0.0, 4.0, 11.0, 15.0, 7205.0])
    monkeypatch.setattr(progress.time, "monotonic", lambda: next(clock))
    with progress.progress_bar("diagnosing") as bar:
        bar(1, 100)
        bar(20, 100, "reading")
        bar(30, 100)
        bar(99, 100)
    assert capsys.readouterr().err.splitlines() == ["reading: 20 %, 11 s", "reading: 99 %, 2 h 0 min"]
    with progress.progress_bar("diagnosing", shown=False) as bar:
        bar(1, 100)
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(0.123, "0.123 s"), (42.4, "42.4 s"), (119.6, "2 min 0 s"), (12224.0, "3 h 24 min"), (3599.9, "1 h 0 min")],
)
def test_long_times_are_minutes_and_hours(seconds, text):
    assert progress.duration_text(seconds) == text


def test_compiling_is_announced_with_the_time_it_takes(monkeypatch, capsys):
    jobs = [compiling.Job(partial(str, kernel), partial(str, kernel)) for kernel in ("first", "second", "third")]
    monkeypatch.setattr(compiling, "is_compiled", lambda kernel: kernel == "first")
    assert [task() for task in compiling.announce_compiling(jobs, 2, "a run")] == ["second", "third"]
    said = capsys.readouterr().err
    assert re.fullmatch(r"a run: compiling 2 kernels, once for this version; about \d.* on this machine\n", said)
    assert compiling.announce_compiling(jobs[:1]) == []
    assert capsys.readouterr().err == ""


def test_a_loaded_run_has_metrics_and_other_data_say_how_to_get_them():
    time = np.arange(0.0, 2.0, 1e-3)
    run = ehls.Recording(time, {"force_n": np.sin(time) + 2.0, "force_reference_n": np.sin(time)})
    assert run.metrics.max_error_n == pytest.approx(2.0)
    with pytest.raises(BadInput, match="no force_reference_n"):
        _ = ehls.Recording(time, {"force_n": time}).metrics


def as_in_a_notebook(real):
    def init(self, *arguments, **options):
        real(self, *arguments, force_jupyter=True, **options)

    return init
