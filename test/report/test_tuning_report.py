"""The report of a tuning."""

import math

import pytest
from report_pages import check, panels, parts, rows

from ehls_ros.control.margins import LoopMargins
from ehls_ros.experiments.files import configured
from ehls_ros.experiments.spec import load_rig
from ehls_ros.experiments.tuning.task import task_of
from ehls_ros.experiments.tuning.tune import Limit, Trial, Tuned, Wanted
from ehls_ros.report.tuning import sentence, write_tuning_report

NUMBERS = {"g": 120.0, "k": 12.0}


def trial(error, gain_db, **numbers):
    return Trial({**NUMBERS, **numbers}, error, error, 1.5 * error, 0.02, LoopMargins(gain_db, math.inf, 35.0, 1e-3))


def found(chosen, causal_limit=5.0):
    curve = (trial(40.0, 12.0), chosen, trial(9.0, 3.0), trial(math.inf, 0.0))
    limits = (Limit("friction", 30.0), Limit("noise of the sensors", 10.0), Limit("lag of the valve", math.inf))
    task = task_of(load_rig(configured("rig_paper")), "fasmc")
    return Tuned(task, Wanted(), trial(35.0, 8.0, g=60.0), chosen, causal_limit, limits, curve, 40, task.remarks)


def test_the_report_shows_numbers_trade_off_and_limitations(tmp_path):
    result = found(trial(20.0, 7.0))
    write_tuning_report(result, tmp_path / "report.html")
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    check(text)
    assert parts(text) == ["Numbers", "Error and margin", "Limitations", "Remarks", "How it was made"]
    assert ["friction", "30.0 N", "no gain with these numbers"] in rows(text, "Limitations")
    assert ["noise of the sensors", "10.0 N", "−50 %"] in rows(text, "Limitations")
    traces, _ = panels(text)["Error over gain margin"]
    assert {trace["name"] for trace in traces} >= {"chosen", "defaults", "causal limit", "margin asked for"}
    assert "20.0 N, 4.0 times the causal limit; margins 7.0 dB and 35°" in sentence(result)
    assert result.holds


@pytest.mark.parametrize(("chosen", "words"), [(trial(math.inf, 0.0), "hold the force"), (trial(20.0, 4.0), "4.0 dB")])
def test_a_result_that_falls_short_is_no_good_verdict(tmp_path, chosen, words):
    result = found(chosen, math.nan)
    write_tuning_report(result, tmp_path / "report.html")
    assert 'class="verdict look"' in (tmp_path / "report.html").read_text(encoding="utf-8")
    assert words in sentence(result)
    assert not result.holds
