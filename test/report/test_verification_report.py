import dataclasses
import html
import math

import numpy as np
import pytest
from report_pages import check, numbers, panels, parts, row, rows

from ehls_ros.experiments.verification.verify import Given, verify_recording
from ehls_ros.report.verification import MAX_DRAWN, write_verification_report
from ehls_ros.trajectory import Trajectory

TIME = np.arange(0.0, 12.0, 2e-3)


def wave(amplitude, lag=0.0, mean=0.0, order=1):
    return mean + amplitude * np.sin(2.0 * np.pi * order * TIME - lag)


def verified(force, reference, **given):
    signals = {"force_n": force, "force_reference_n": reference, "position_m": wave(1e-3)}
    return verify_recording(Trajectory(TIME, signals), Given(**given), "made")


@pytest.fixture(scope="module")
def distorted():
    """2 % too small, a tenth of a radian late, 3 % of third harmonic, and a first cycle that is far off."""
    force = wave(9.8e3, lag=0.1) + wave(294.0, order=3) + np.where(TIME < 1.0, 500.0, 0.0)
    return verified(force, wave(1e4), inertia_mass=50.0, cell_uncertainty=1.0)


def test_a_block_has_table_budget_and_figures_with_units(distorted, written, without_plotly):
    text = written(lambda path: write_verification_report(distorted, path, "made"))
    check(text)
    assert parts(text) == ["Whole recording", "How it was made"]
    assert "This report certifies nothing" in html.unescape(text)
    table = row(text, "Whole recording", "amplitude")
    assert table[1:3] == ["10\u202f000 N", "9\u202f800.0 N"]
    assert table[3].startswith("−200 ± 98 N")
    assert row(text, "Whole recording", "phase")[3].startswith(f"−{math.degrees(0.1):.2f} ±")
    assert "at the start of their stretch" in text
    assert "50.0 kg between load cell and specimen" in text
    drawn = panels(text)
    assert list(drawn) == ["One cycle", "Peaks and valleys", "Harmonics"]
    traces, layout = drawn["Harmonics"]
    assert numbers(traces[0]["y"])[1] == pytest.approx(3.0, rel=1e-3)
    assert layout["yaxis"]["title"]["text"] == "amplitude [%]"
    left_out = next(trace for trace in drawn["Peaks and valleys"][0] if trace["name"] == "peak, left out")
    assert numbers(left_out["x"])[0] == 1.0


def test_a_block_without_cycles_says_why(written, without_plotly):
    found = verified(TIME + 3.0, TIME)
    text = written(lambda path: write_verification_report(found, path))
    check(text)
    assert "its reference does not repeat" in text
    assert ">3.00 N<" in text
    assert not panels(text)


def test_a_reference_that_never_repeats_has_its_response_in_bands(written, without_plotly):
    irregular = sum(wave(1e3, lag=f, order=f) for f in (0.31, 0.77, 1.31, 2.03, 3.17))
    found = verified(np.interp(TIME - 0.02, TIME, irregular), irregular)
    text = written(lambda path: write_verification_report(found, path))
    check(text)
    assert "The force is off by" in text
    assert "its lag 20.0 ms" in html.unescape(text)
    drawn = panels(text)
    assert [trace["name"] for trace in drawn["Response"][0]] == ["gain", "lag", "coherence"]


def test_many_blocks_have_a_table_and_the_first_have_figures(distorted, written, without_plotly):
    [block] = distorted.blocks
    many = tuple(block._replace(name=f"block {number}", number=number) for number in range(MAX_DRAWN + 2))
    found = dataclasses.replace(distorted, blocks=many)
    text = written(lambda path: write_verification_report(found, path))
    assert len(rows(text, "Blocks")) == len(many) + 1
    assert text.count('type="application/json"') == 3 * MAX_DRAWN
    assert "Figures of 2 more blocks are left out" in text
