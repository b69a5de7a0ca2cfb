import re
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from report_pages import check, numbers, panels

from ehls_ros.experiments.metrics import evaluate
from ehls_ros.report.experiment import summary, write_experiment_report
from ehls_ros.trajectory import SIGNALS, Trajectory

PERIOD = 1e-3
RIG = {"plant": {"piston_area": 2.6e-3, "supply_pressure": 7e6}, "limits": {"spool": 3e-3, "position": [-0.3, 0.3]}}
SPEC = {
    "reference": {"name": "sine", "amplitude": 1e4},
    "disturbance": {"name": "force", "signal": {"name": "sine"}},
    "controller": {"name": "fasmc", "k": 12.0, "g": 60.0, "h": 25.0, "b": 107.5},
}
TITLES = {
    "Force": {"force_n"},
    "Force error": {"force_n", "force_reference_n"},
    "Valve": {"valve_command_m"},
    "Load pressure": {"load_pressure_pa"},
    "Motion": {"position_m"},
    "Position error": {"position_m", "position_reference_m"},
    "Estimated friction": {"friction_gms_n"},
    "Adaptation": {"delta_n"},
    "Sliding variable": {"s_pa_s"},
    "Response of the loop": {"response_s"},
    "Distribution of the response": {"response_s"},
    "Sliding plane": {"e3_pa", "s_pa_s"},
    "Friction against velocity": {"friction_gms_n", "velocity_m_s"},
    "Force against position": {"force_n", "position_m"},
}
"""Every panel with a minimum set of signals for drawing it."""


def make_run(count=600, **metadata):
    """Return a run with every signal, each with different noise so that no series becomes shorter than others."""
    random = np.random.default_rng(1)
    time_s = np.arange(count) * PERIOD
    wave = np.sin(2 * np.pi * time_s)
    scales = {"force_n": 1e4, "force_reference_n": 1e4, "load_pressure_pa": 3.8e6, "valve_command_m": 2e-3, "spool_m": 2e-3}
    signals = {
        name: scales.get(name, 1.0) * (wave + 1e-3 * random.standard_normal(count))
        for name in SIGNALS
        if name not in ("friction_elements_n", "friction_slipping")
    }
    signals["friction_elements_n"] = random.standard_normal((count, 3))
    signals["friction_slipping"] = (random.random((count, 3)) > 0.5).astype(float)
    signals["supply_pressure_pa"] = np.full(count, 7e6)
    signals["force_bound_n"] = np.full(count, 78.0)
    for name in ("alpha", "beta"):
        signals[name] = 1.0 + 0.1 * signals[name]
    signals["at_bound"] = (random.random(count) > 0.99).astype(float)
    signals["response_s"] = 2e-4 * random.lognormal(0.0, 0.3, count)
    signals["saturated"] = (random.random(count) > 0.99).astype(float)
    signals["friction_fallback"] = (random.random(count) > 0.99).astype(float)
    facts = {"title": "a run", "rig": RIG, "spec": SPEC, "versions": {"ehls_ros": "0"}, "timing": "lockstep", "wall_s": 0.5}
    return Trajectory(time_s, signals, facts | metadata)


def only(run, names):
    return replace(run, signals={name: run[name] for name in names})


METRICS = evaluate(make_run())
UNKNOWN = METRICS._replace(max_error_n=float("nan"), rms_error_n=float("nan"), convergence_s=None)


@pytest.fixture
def whole_report(written):
    return lambda run, metrics=METRICS: written(lambda path: write_experiment_report(run, metrics, path))


@pytest.fixture
def report(whole_report, without_plotly):
    return whole_report


def test_all_panels_of_a_whole_run(report):
    html = report(make_run())
    assert set(panels(html)) == set(TITLES)
    assert "is left out" not in html
    check(html)


def test_panels_over_time_share_one_time_axis(report):
    ranges = [layout["xaxis"]["range"] for _, layout in panels(report(make_run())).values() if "yaxis9" in layout]
    assert len(ranges) == 10
    assert all(span == [0.0, pytest.approx(0.599)] for span in ranges)


@pytest.mark.parametrize("title", TITLES)
def test_a_panel_needs_only_its_own_signals(report, title):
    html = report(only(make_run(), TITLES[title]), UNKNOWN)
    assert title in panels(html)
    check(html)
    follows_position = "position_reference_m" in TITLES[title]
    not_followed = {"Force", "Force error"} if follows_position else {"Position error"}
    for other in set(TITLES) - set(panels(html)):
        assert html.count(f"<b>{other}</b> is left out: ") == (other not in not_followed)


@pytest.mark.parametrize("missing", sorted(SIGNALS))
def test_any_signal_may_be_missing(report, missing):
    run = make_run()
    check(report(only(run, set(SIGNALS) - {missing})))
    check(report(replace(run, signals={**run.signals, missing: np.full_like(run[missing], np.nan)})))


def test_nothing_recorded(report):
    html = report(Trajectory(np.empty(0), {}), None)
    assert not panels(html)
    assert html.count("is left out") == len(TITLES) - 1
    assert "Position error" not in html
    assert "no reference" in html


def test_a_foreign_recording_has_its_name_its_rate_and_its_statistics(written, without_plotly):
    time_s = np.delete(0.002 * np.arange(1000), slice(300, 350))
    force = np.where(time_s > 1.0, 200.0, -100.0)
    force[:19] = np.nan
    run = Trajectory(time_s, {"force_n": force, "position_m": 0.01 * time_s, "pressure_a_pa": 1e6 * time_s})
    html = written(lambda path: write_experiment_report(run, None, path, name="axis_7.csv"))
    assert "<h1>axis_7.csv</h1>" in html
    assert "1.998 s at 500.0 Hz, 950 samples with 1 gap between them, the longest 0.102 s." in html.replace("\u202f", "")
    cells = {name: row for name, *row in re.findall("<tr>" + 7 * r".*?>([^<]*)</t[hd]>" + "</tr>", html)}
    rms = np.sqrt(np.nanmean(force**2))
    assert cells["force_n"] == ["-100.0", "200.0", f"{np.nanmean(force):.2f}", f"{rms:.1f}", "N", "2.0 %"]
    assert cells["position_m"][:2] + cells["position_m"][4:] == ["0", "19.98", "mm", "0 %"]
    assert cells["pressure_a_pa"][:2] + cells["pressure_a_pa"][4:] == ["0", "19.98", "bar", "0 %"]
    assert panels(html)["Force"][1]["yaxis"]["title"]["text"] == "force [N]"


@pytest.mark.parametrize("count", [1, 2, 3])
def test_hardly_any_samples(report, count):
    html = report(make_run(count))
    assert set(panels(html)) == set(TITLES)
    check(html)
    traces, _ = panels(html)["Load pressure"]
    assert (traces[0]["mode"] == "lines+markers") == (count == 1)


def test_gaps_stay_gaps_and_lonely_samples_show(report):
    run = make_run()
    for values in run.signals.values():
        values[100:200] = np.nan
    run["spool_m"][::2] = np.nan
    html = report(run)
    check(html)
    force = next(trace for trace in panels(html)["Force"][0] if trace["name"] == "force")
    assert np.isnan(numbers(force["y"])).any()
    modes = {trace["name"]: trace["mode"] for trace in panels(html)["Valve"][0]}
    assert (modes["command"], modes["spool"]) == ("lines", "lines+markers")
    assert "missed cycles (100)" in html


def test_infinite_values_are_gaps(report):
    run = make_run()
    for values in run.signals.values():
        values[50] = np.inf
    run["force_bound_n"][:300] = np.inf
    check(report(run))


def test_a_loop_that_was_not_timed_has_no_response(report):
    run = make_run()
    run["response_s"][:] = 0.0
    html = report(run)
    assert "Response of the loop" not in panels(html)
    check(html)


def test_a_controller_without_sliding_mode_has_no_panels_of_zeros(report):
    run = make_run()
    for name in ("s_pa_s", "alpha", "beta", "delta_n", "force_bound_n"):
        run[name][:] = 0.0
    html = report(run)
    assert set(TITLES) - set(panels(html)) == {"Adaptation", "Sliding variable", "Sliding plane"}
    assert "bound (44)" not in html


def position_run():
    run = make_run()
    rest = {name: values for name, values in run.signals.items() if not name.startswith("force_reference")}
    rest["position_m"] = rest["position_reference_m"] + 2e-3 * (run.time_s > 0.5) + 5e-3 * (run.time_s < 0.05)
    return replace(run, signals=rest)


def test_a_run_along_a_position_shows_the_position_instead_of_force_tracking(report):
    run = position_run()
    html = report(run, evaluate(run))
    check(html)
    assert list(panels(html))[:2] == ["Motion", "Position error"]
    assert not {"Force", "Force error"} & set(panels(html))
    assert "<b>Force" not in html
    names = {title: [trace.get("name") for trace in traces] for title, (traces, _) in panels(html).items()}
    assert {"piston position", "position reference", "piston velocity", "velocity reference"} <= set(names["Motion"])
    traces, layout = panels(html)["Position error"]
    assert numbers(traces[0]["y"]).max() == pytest.approx(5.0)
    assert layout["yaxis"]["range"] == pytest.approx([-2.5, 2.5])
    for words in ("stayed within 2.00 mm of the reference", "Largest position error, last half", "2.00 mm", "1.15 mm"):
        assert words in html


@pytest.mark.parametrize(("missed", "good"), [(0, None), (3, False)])
def test_the_verdict_on_a_run_along_a_position(missed, good):
    sentence, verdict = summary(position_run(), UNKNOWN._replace(missed_cycles=missed))
    assert f"{missed} of 600 cycles" in sentence
    assert verdict is good


def test_bounds_limits_and_convergence_are_drawn(report):
    html = report(make_run(), METRICS._replace(convergence_s=0.123))
    names = {title: [trace.get("name") for trace in traces] for title, (traces, _) in panels(html).items()}
    assert {"bound (44)", "converged after 0.123 s"} <= set(names["Force error"])
    assert "± limit of the spool" in names["Valve"]
    assert "± supply pressure" in names["Load pressure"]
    assert "bound ±b/h = ±4.30 MPa/s" in names["Sliding variable"]
    assert "region of (44)" in names["Sliding plane"]
    assert [name.split()[0] for name in names["Distribution of the response"][1:]] == ["median", "99", "99.9", "largest"]


def test_a_far_limit_is_told_and_not_drawn(report):
    html = report(make_run(rig={"limits": {"spool": 0.01}}))
    assert "The limit of the spool, ±10.0 mm, is outside the figure." in html


def test_the_error_is_scaled_to_its_steady_part(report):
    run = make_run()
    run["force_n"][:100] -= 1e4
    traces, layout = panels(report(run))["Force error"]
    low, high = layout["yaxis"]["range"]
    assert -200 < low < -78 < 78 < high < 200
    assert min(numbers(trace["y"]).min() for trace in traces) < -9e3


def test_text_of_the_metadata_is_escaped(report):
    hostile = "<script>alert(1)</script>"
    spec = SPEC | {"controller": {"name": hostile, hostile: hostile}}
    html = report(make_run(title=hostile, timing=hostile, spec=spec, rig={hostile: hostile}), METRICS._replace(bag=hostile))
    assert hostile not in html
    assert html.count("&lt;script&gt;alert(1)&lt;/script&gt;") >= 6


def test_the_page_loads_nothing(whole_report):
    html = whole_report(make_run())
    plotly = pytest.importorskip("plotly.offline", reason="plotly is not installed").get_plotlyjs()
    assert html.count(plotly) == 1
    own = html.replace(plotly, "")
    assert not re.search(r"\b(src|href|action|data)\s*=|url\(|@import|https?:|fetch\(", own)
    assert "default-src 'none'" in own


def test_the_file_of_a_long_run_is_small_and_keeps_its_peak(whole_report):
    run = make_run(250_000)
    for values in run.signals.values():
        values[::500] = np.nan
    run["force_n"][123_457] = 4.2e4
    html = whole_report(run)
    assert len(html.encode()) < 8e6
    force = next(trace for trace in panels(html)["Force"][0] if trace["name"] == "force")
    assert np.nanmax(numbers(force["y"])) == 42.0
    assert "every 0.0625 s" in html


def test_importing_the_report_loads_neither_plotlys_objects_nor_pandas():
    code = "import sys, ehls_ros.report.experiment; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout.split()
    assert not {"pandas", "plotly.graph_objs"} & set(loaded)


@pytest.mark.parametrize(
    ("changes", "words", "good"),
    [
        ({"max_error_n": 50.0, "convergence_s": 0.7}, ["within 50.0 N", "0.500 %", "after 0.700 s", "0 of 600 cycles"], True),
        ({"max_error_n": 50.0, "convergence_s": 0.7, "convergence_band_n": 100.0}, ["0.700 s, to within ±100 N"], True),
        (
            {"max_error_n": 50.0, "convergence_s": 0.0, "convergence_band_n": 100.0},
            ["inside its band of ±100 N from the start"],
            True,
        ),
        ({"max_error_n": 50.0, "convergence_s": 0.7, "warnings": ("limits are left",)}, ["after 0.700 s"], False),
        (
            {"max_error_n": 509.0, "convergence_s": None, "convergence_band_n": 100.0, "oscillation_n": 505.0},
            ["did not converge: it oscillates by ±505 N in the last half, with a band of ±100 N"],
            False,
        ),
        ({"max_error_n": 50.0, "convergence_s": 0.7, "missed_cycles": 3}, ["3 of 600 cycles"], False),
        ({"max_error_n": float("nan"), "convergence_s": None}, ["cannot be evaluated"], None),
    ],
)
def test_the_verdict(changes, words, good):
    run = only(make_run(), [name for name in SIGNALS if not name.startswith("position_reference")])
    run["force_n"][:] = run["force_reference_n"][:] = 1e4
    sentence, verdict = summary(run, METRICS._replace(**changes))
    assert verdict is good
    for word in words:
        assert word in sentence


def test_warnings_are_shown(report):
    html = report(make_run(), METRICS._replace(warnings=("the rig leaves its limits", "<b>")))
    assert "Warning: the rig leaves its limits." in html
    assert "Warning: &lt;b&gt;." in html


def test_the_verdict_looks_at_the_bound():
    run = make_run()
    run["force_n"][:] = run["force_reference_n"][:] = 1e4
    metrics = METRICS._replace(max_error_n=90.0, convergence_s=0.1)
    run["force_n"][400:403] += 90.0
    sentence, good = summary(run, metrics)
    assert "left its bound (44) in 3 cycles" in sentence
    assert good is False
    run["force_bound_n"][:] = np.inf
    assert summary(run, metrics)[1] is None


def test_the_same_run_gives_the_same_page(report):
    assert report(make_run()) == report(make_run())
