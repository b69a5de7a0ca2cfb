import base64
import json
import re
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest
from plotly.offline import get_plotlyjs

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
    "Force tracking": {"force_n"},
    "Force error": {"force_n", "force_reference_n"},
    "Valve": {"valve_command_m"},
    "Load pressure": {"load_pressure_pa"},
    "Motion": {"position_m"},
    "Estimated friction": {"friction_gms_n"},
    "Adaptation": {"delta_n"},
    "Sliding variable": {"s_mpa_s"},
    "Response of the loop": {"response_s"},
    "Distribution of the response": {"response_s"},
    "Sliding plane": {"e3_mpa", "s_mpa_s"},
    "Friction against velocity": {"friction_gms_n", "velocity_m_s"},
    "Force against position": {"force_n", "position_m"},
}
"""Every panel with a smallest set of signals it can be drawn from."""


def make_run(count=600, **metadata):
    """A run with every signal, each with its own noise so that no series becomes shorter than others."""
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
    signals["response_s"] = 2e-4 * random.lognormal(0.0, 0.3, count)
    signals["saturated"] = (random.random(count) > 0.99).astype(float)
    signals["friction_fallback"] = (random.random(count) > 0.99).astype(float)
    facts = {"title": "a run", "rig": RIG, "spec": SPEC, "versions": {"ehls_ros": "0"}, "timing": "lockstep", "wall_s": 0.5}
    return Trajectory(time_s, signals, facts | metadata)


def only(run, names):
    return replace(run, signals={name: run[name] for name in names})


METRICS = evaluate(make_run()).as_json()
UNKNOWN = METRICS | {"max_error_n": float("nan"), "rms_error_n": float("nan"), "convergence_s": None}


@pytest.fixture
def whole_report(tmp_path):
    def write(run, metrics=METRICS):
        path = tmp_path / "report.html"
        write_experiment_report(run, metrics, path)
        return path.read_text(encoding="utf-8")

    return write


@pytest.fixture
def report(whole_report, monkeypatch):
    """The same without the five megabytes of plotly.js."""
    monkeypatch.setattr("ehls_ros.report.page.get_plotlyjs", lambda: "")
    return whole_report


def panels(html):
    """Title, traces and layout of every figure; a number JSON does not know is an error, as in a browser."""

    def refuse(constant):
        raise ValueError(constant)

    pattern = r'<h2>(.*?)</h2>.*?<script type="application/json">(.*?)</script>'
    found = [(title, json.loads(text, parse_constant=refuse)) for title, text in re.findall(pattern, html, re.DOTALL)]
    return {title: (figure["data"], figure["layout"]) for title, figure in found}


def numbers(array):
    if isinstance(array, list):
        return np.array([np.nan if value is None else value for value in array])
    return np.frombuffer(base64.b64decode(array["bdata"]), "<f4")


def drawn_axes(layout):
    return {
        name: axis for name, axis in layout.items() if re.fullmatch(r"[xy]axis\d*", name) and axis.get("visible") is not False
    }


def check(html):
    """What must hold of every figure of every report."""
    for title, (traces, layout) in panels(html).items():
        for name, axis in drawn_axes(layout).items():
            assert re.search(r"\[[^\]]+\]$", axis["title"]["text"]), f"{title}: {name} has no unit"
        for trace in traces:
            assert trace.get("yaxis", "y").replace("y", "yaxis") in layout, f"{title}: no axis for {trace.get('name')}"
        shown = [trace for trace in traces if trace.get("hoverinfo") != "skip"]
        assert any(np.isfinite(numbers(trace["y"])).any() for trace in shown), f"{title} is empty"


def test_all_panels_of_a_whole_run(report):
    html = report(make_run())
    assert set(panels(html)) == set(TITLES)
    assert "is left out" not in html
    check(html)


def test_panels_over_time_share_one_time_axis(report):
    ranges = [layout["xaxis"]["range"] for _, layout in panels(report(make_run())).values() if "yaxis9" in layout]
    assert len(ranges) == 9
    assert all(span == [0.0, pytest.approx(0.599)] for span in ranges)


@pytest.mark.parametrize("title", TITLES)
def test_a_panel_needs_only_its_own_signals(report, title):
    html = report(only(make_run(), TITLES[title]), UNKNOWN)
    assert title in panels(html)
    check(html)
    for other in set(TITLES) - set(panels(html)):
        assert html.count(f"<b>{other}</b> is left out: ") == 1


@pytest.mark.parametrize("missing", sorted(SIGNALS))
def test_any_signal_may_be_missing(report, missing):
    run = make_run()
    check(report(only(run, set(SIGNALS) - {missing})))
    check(report(replace(run, signals={**run.signals, missing: np.full_like(run[missing], np.nan)})))


def test_nothing_recorded(report):
    html = report(Trajectory(np.empty(0), {}), {})
    assert not panels(html)
    assert html.count("is left out") == len(TITLES)


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
    force = next(trace for trace in panels(html)["Force tracking"][0] if trace["name"] == "force")
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
    for name in ("s_mpa_s", "alpha", "beta", "delta_n", "force_bound_n"):
        run[name][:] = 0.0
    html = report(run)
    assert set(TITLES) - set(panels(html)) == {"Adaptation", "Sliding variable", "Sliding plane"}
    assert "bound (44)" not in html


def test_bounds_limits_and_convergence_are_drawn(report):
    html = report(make_run(), METRICS | {"convergence_s": 0.123})
    names = {title: [trace.get("name") for trace in traces] for title, (traces, _) in panels(html).items()}
    assert {"bound (44)", "converged after 0.123 s"} <= set(names["Force error"])
    assert "± limit of the spool" in names["Valve"]
    assert "± supply pressure" in names["Load pressure"]
    assert "bound ±b/h = ±4.30 MPa/s" in names["Sliding variable"]
    assert "region of (44)" in names["Sliding plane"]
    assert [name.split()[0] for name in names["Distribution of the response"][1:]] == ["median", "99", "99.9", "largest"]


def test_a_far_limit_is_told_and_not_drawn(report):
    html = report(make_run(rig={"limits": {"spool": 0.01}}))
    assert "The limit of the spool, ±10.0 mm, lies outside the picture." in html


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
    html = report(make_run(title=hostile, timing=hostile, spec=spec, rig={hostile: hostile}), METRICS | {"bag": hostile})
    assert hostile not in html
    assert html.count("&lt;script&gt;alert(1)&lt;/script&gt;") >= 6


def test_the_page_loads_nothing(whole_report):
    html = whole_report(make_run())
    assert html.count(get_plotlyjs()) == 1
    own = html.replace(get_plotlyjs(), "")
    assert not re.search(r"\b(src|href|action|data)\s*=|url\(|@import|https?:|fetch\(", own)
    assert "default-src 'none'" in own


def test_the_file_of_a_long_run_is_small_and_keeps_its_peak(whole_report):
    run = make_run(250_000)
    for values in run.signals.values():
        values[::500] = np.nan
    run["force_n"][123_457] = 4.2e4
    html = whole_report(run)
    assert len(html.encode()) < 8e6
    force = next(trace for trace in panels(html)["Force tracking"][0] if trace["name"] == "force")
    assert np.nanmax(numbers(force["y"])) == 42.0
    assert "every 0.0625 s" in html


def test_a_report_takes_little_time_and_does_not_depend_on_it(whole_report):
    run = make_run(10_000)
    start = time.perf_counter()
    first = whole_report(run)
    assert time.perf_counter() - start < 1.5
    assert first == whole_report(run)


def test_importing_the_report_compiles_nothing():
    code = "import sys, ehls_ros.report.experiment; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout.split()
    assert not {"numba", "scipy", "pandas", "rclpy", "plotly.graph_objs"} & set(loaded)


@pytest.mark.parametrize(
    ("changes", "words", "good"),
    [
        ({"max_error_n": 50.0, "convergence_s": 0.7}, ["within 50.0 N", "0.500 %", "after 0.700 s", "0 of 600 cycles"], True),
        ({"max_error_n": 50.0, "convergence_s": 0.0}, ["from the start"], True),
        ({"max_error_n": 50.0, "convergence_s": None}, ["had not converged"], False),
        ({"max_error_n": 50.0, "convergence_s": 0.7, "missed_cycles": 3}, ["3 of 600 cycles"], False),
        ({"max_error_n": float("nan"), "convergence_s": None}, ["cannot be told"], None),
    ],
)
def test_the_verdict(changes, words, good):
    run = make_run()
    run["force_n"][:] = run["force_reference_n"][:] = 1e4
    sentence, verdict = summary(run, METRICS | changes)
    assert verdict is good
    for word in words:
        assert word in sentence


def test_the_verdict_looks_at_the_bound():
    run = make_run()
    run["force_n"][:] = run["force_reference_n"][:] = 1e4
    metrics = METRICS | {"max_error_n": 90.0, "convergence_s": 0.1}
    run["force_n"][400:403] += 90.0
    sentence, good = summary(run, metrics)
    assert "left its bound (44) in 3 cycles" in sentence
    assert good is False
    run["force_bound_n"][:] = np.inf
    assert summary(run, metrics)[1] is None
