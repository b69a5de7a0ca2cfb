"""The page of a monitor: its texts and figures for a monitor's possible states."""

import math
from datetime import UTC, date, datetime
from pathlib import Path

import numpy as np
import pytest
from report_pages import check, numbers, panels, parts, row, rows

from ehls_ros.diagnosis.monitoring.tracking import COEFFICIENTS, PastReadings, Reading
from ehls_ros.diagnosis.result import Fitted
from ehls_ros.estimate import Estimate
from ehls_ros.experiments.files import configured
from ehls_ros.experiments.monitoring.examination import FoundCause
from ehls_ros.experiments.monitoring.health import Event, FoundChange, Health, State
from ehls_ros.experiments.monitoring.monitor import Parameters
from ehls_ros.experiments.monitoring.offer import Offer
from ehls_ros.experiments.monitoring.replay import MonitoringResult, RecordingSpan
from ehls_ros.experiments.monitoring.trends import LimitPrediction
from ehls_ros.experiments.spec import load_rig
from ehls_ros.report.monitor import daily_report, write_monitor_report
from ehls_ros.report.monitor_findings import Clock, answer, duration, false_alarms

RIG = load_rig(configured(Path("rig_paper_measured")))
LEAKAGE, MASS = "leakage_coefficient", "moving_mass"
HOURS = 20
WHY_NOT = "not excited by the programme"
CAUSE = FoundCause(
    "internal_leakage_shift", "flow", 0.98, ("external_leakage",), {"added": Estimate(4e-12, 1e-13, "m^5/(N s)")}
)
CHANGE = FoundChange(1, (CAUSE,), "flow", (), 36000.0, 35000.0, 37000.0, 36100.0, 36100.0)


def reading(name, value, deviation, *, told=True):
    unit = {LEAKAGE: "m^5/(N s)", MASS: "kg"}[name]
    return Reading(name, value, deviation if told else math.inf, unit, "" if told else WHY_NOT)


@pytest.fixture
def worn():
    """A day in which a leakage grows, and a mass that is determined only in the middle."""
    history = [
        PastReadings(
            3600.0 * hour,
            (
                reading(LEAKAGE, 4.7e-12 + 1e-13 * max(hour - 9, 0), 2e-14),
                reading(MASS, 70.0, 0.5, told=5 <= hour < 12),
            ),
        )
        for hour in range(1, HOURS + 1)
    ]
    health = Health(
        3600.0 * HOURS, State.WATCHING, "", (CHANGE,), history[-1].readings, 71000.0, "the rig file", 0.25,
        {LEAKAGE: Estimate(1e-13, 1e-15, "m^5/(N s)/h")},
    )  # fmt: skip
    events = (Event(60.0, "watching", "watched <against> the rig file"), Event(36100.0, "named", CHANGE.sentence()))
    return MonitoringResult(
        rig=RIG,
        parameters=Parameters(reading_time=3600.0),
        health=health,
        history=history,
        events=events,
        stretches=(RecordingSpan("monday", 0.0, 30000.0, 120.0), RecordingSpan("tuesday", 30001.0, 72000.0, 0.0)),
        limits={LEAKAGE: LimitPrediction(1.2e-11, 62.0, 58.0, 66.5)},
        offer=Offer("velocity_sweep", "friction over velocity, creeping to fast", 14.2, 2, (MASS,), {"duration": 7.1}),
    )


@pytest.fixture
def healthy(worn):
    return worn._replace(health=worn.health._replace(changes=(), rates={}, outside=0.0))


def page_of(written, watched, **options):
    return written(lambda path: write_monitor_report(watched, path, "axis.csv", **options))


def test_every_figure_has_units_and_something_in_it(worn, written, without_plotly):
    text = page_of(written, worn)
    check(text)
    assert parts(text) == [
        "Changes", "Events", "Coefficients", "Trends", "Not identified", "Judged data", "Method",
    ]  # fmt: skip
    assert set(panels(text)) == {"Events over time", "Internal leakage", "Moving mass"}


def test_the_head_line_says_what_since_when_and_how_sure(worn, healthy):
    sentence, good = answer(worn)
    assert good is False
    for words in (
        "leakage past the piston",
        "since 10.0 h",
        "9.72 h and 10.3 h",
        "98 %",
        "to the outside",
        "± 0.020",
        "1.851 ± 0.042 times",
    ):
        assert words in sentence
    assert answer(healthy) == ("No change detected in 19.7 h against the rig file.", True)
    idle = healthy._replace(health=healthy.health._replace(state=State.IDLE, reason="the piston rests"))
    assert answer(idle) == ("The rig is not judged: the piston rests.", None)


def test_a_trend_shows_value_band_rig_file_limit_and_change(worn, written, without_plotly):
    traces, layout = panels(page_of(written, worn))["Internal leakage"]
    by_name = {trace["name"]: trace for trace in traces}
    assert set(by_name) == {"95 %", "value", "healthy", "limit", "change"}
    values = numbers(by_name["value"]["y"])
    assert values[-1] == pytest.approx(1e11 * 5.8e-12)
    band = numbers(by_name["95 %"]["y"])
    assert band.max() - values.max() == pytest.approx(1e11 * 1.96 * 2e-14, rel=1e-3)
    assert numbers(by_name["limit"]["y"]) == pytest.approx([1.2, 1.2])
    assert by_name["change"]["x"] == pytest.approx([10.0, 10.0])
    assert layout["xaxis"]["title"]["text"] == "time since start [h]"
    assert layout["yaxis"]["title"]["text"].endswith("[cm³/(s bar)]")


def test_coefficients_not_identified_are_grey_with_the_reason(worn, written, without_plotly):
    text = page_of(written, worn)
    traces, layout = panels(text)["Moving mass"]
    assert [(shape["x0"], shape["x1"]) for shape in layout["shapes"]] == [(0.0, 4.0), (11.0, 20.0)]
    told = np.concatenate([numbers(trace["x"]) for trace in traces if trace["name"] == "value"])
    assert (told.min(), told.max()) == pytest.approx((4.0, 11.0))
    assert WHY_NOT in row(text, "Not identified", "moving mass")[1]
    # Coefficients without any reading are listed as well.
    assert len(rows(text, "Not identified")) == len(COEFFICIENTS)
    assert "velocity_sweep" in text
    assert "run 2 times" in text
    text = page_of(written, worn._replace(offer=None, missing=(MASS,)))
    assert "No experiment of the catalogue identifies moving mass from the recorded signals" in text


def test_rate_and_limit_stand_with_their_intervals(worn, written, without_plotly):
    text = page_of(written, worn)
    cells = row(text, "Coefficients", "internal leakage")
    assert cells[3] == "+0.010 ± 0.00020 cm³/(s bar)"
    assert cells[4] == "1.2 cm³/(s bar): in 2.58 days (95 %: 2.42 days to 2.77 days)"
    assert "valid at every load and speed" in text
    old = worn._replace(health=worn.health._replace(baseline="healthy recordings"))
    assert "25 % of the last minute was outside" in page_of(written, old)
    assert "2.00 min were not driven" in text or "120 s were not driven" in text


def test_words_of_events_are_text(worn, written, without_plotly):
    assert "watched &lt;against&gt; the rig file" in page_of(written, worn)


def test_a_page_without_anything_is_one_too(healthy, written, without_plotly):
    nothing = Health(math.nan, State.LEARNING, "", (), (), 0.0, "the rig file", 0.0, {})
    text = page_of(written, healthy._replace(health=nothing, history=(), events=(), stretches=(), limits={}, offer=None))
    assert "The rig is not judged" in text
    check(text)


def test_the_report_of_a_day_shows_that_day(worn, tmp_path, without_plotly):
    clock = Clock(datetime(2026, 3, 2, 18, 0, tzinfo=UTC))
    path = daily_report(worn, tmp_path, date(2026, 3, 3), clock)
    assert path == tmp_path / "report-2026-03-03.html"
    text = path.read_text()
    check(text)
    traces, layout = panels(text)["Internal leakage"]
    assert layout["xaxis"]["title"]["text"] == "time of day [h]"
    assert layout["xaxis"]["range"] == [0.0, 24.0]
    [value] = [trace for trace in traces if trace["name"] == "value"]
    # Readings from midnight on, the first of them averaged from then.
    assert numbers(value["x"]).tolist() == pytest.approx([0.0, *range(15)])
    assert "since 2026-03-03 04:00:00" in text
    assert "watched &lt;against&gt;" not in text


def test_times_and_rates_in_words():
    assert [duration(seconds) for seconds in (12.34, 660.0, 7200.0, 36000.0, 864000.0)] == [
        "12.3 s", "11.0 min", "120 min", "10.0 h", "10.0 days",
    ]  # fmt: skip
    assert "8.8 a year" in false_alarms(1000.0)
    assert "one in 11 years" in false_alarms(1e5)


def test_wrong_numbers_of_the_rig_file_are_stated(healthy):
    mass, gain = Fitted(105.0, Estimate(70.0, 0.1, "kg"), None), Fitted(1.1, Estimate(1.0, 0.001, "1"), None)
    wrong = {"plant.moving_mass": mass, "plant.valve_gain": gain}
    sentence, good = answer(healthy._replace(health=healthy.health._replace(rig_values=wrong)))
    assert good
    assert "The rig file is wrong: moving mass 105, identified 70.00 ± 0.20 kg and valve gain 1.10, identified" in sentence
