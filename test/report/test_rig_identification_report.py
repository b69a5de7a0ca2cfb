"""The report of a whole rig's identification lists the identified and missing coefficients, and the reduction of residuals."""

import html
from pathlib import Path

import numpy as np
import pytest
from report_pages import parts, rows

from ehls_ros.estimate import Estimate
from ehls_ros.experiments.spec import load_rig
from ehls_ros.identification.rig_result import ChannelFit, RigIdentification
from ehls_ros.report.rig_identification import write_rig_report

RIG = load_rig(Path(__file__).parents[2] / "config" / "rig_paper_measured.yaml")
CORRELATIONS = np.array([[1.0, -0.95, 0.1], [-0.95, 1.0, 0.2], [0.1, 0.2, 1.0]])
STD = np.array([0.5, 40.0, 2.0])
FOUND = RigIdentification(
    rig=RIG,
    estimates={
        "plant.moving_mass": Estimate(140.0, 0.5, "kg"),
        "plant.spring_stiffness": Estimate(4e4, 40.0, "N/m"),
        "effects.constant_load.force": Estimate(55.0, 2.0, "N"),
    },
    covariance=CORRELATIONS * np.outer(STD, STD),
    correlations=CORRELATIONS,
    absent={"sensors.force.bias": Estimate(0.1, 0.2, "N")},
    not_identifiable={"plant.bulk_modulus": "not excited: the data hardly depend on it"},
    channels={"force": ChannelFit(0.5, 0.002, 0.0019), "volume": ChannelFit(0.3, 0.01, 0.001)},
    recordings=("a.csv", "b.csv"),
    remarks=("a.csv: 1 % of the samples are missing",),
    wall_s=3.0,
)


@pytest.fixture
def text(tmp_path) -> str:
    path = tmp_path / "report.html"
    write_rig_report(FOUND, path, before=RIG)
    return path.read_text(encoding="utf-8")


def test_the_parts_come_in_order(text):
    assert parts(text) == ["Coefficients", "Not identifiable", "Residuals", "Correlations", "How it was made"]


def test_each_coefficient_has_value_error_interval_and_what_it_was(text):
    cells = next(row for row in rows(text, "Coefficients") if row[0] == "plant.moving_mass")
    assert cells[1:3] == ["140.00", "0.50"]
    assert cells[4:] == ["139.02 to 140.98", "kg", "70 | +100 %"]


def test_what_was_looked_for_in_vain_is_listed(text):
    assert any(row[0] == "sensors.force.bias" for row in rows(text, "Coefficients"))


def test_the_reason_for_what_is_not_told_is_given(text):
    assert ["plant.bulk_modulus", "690\u202f000\u202f000", "not excited: the data hardly depend on it"] in rows(
        text, "Not identifiable"
    )


def test_only_strong_correlations_are_listed(text):
    assert rows(text, "Correlations")[1:] == [["plant.moving_mass", "plant.spring_stiffness", "\u22120.950"]]


def test_the_answer_names_what_is_left(text):
    answer = html.unescape(text).partition('<p class="verdict')[2].partition("</p>")[0]
    assert "3 coefficients" in answer
    assert "volume balance" in answer
    assert "force balance" not in answer
