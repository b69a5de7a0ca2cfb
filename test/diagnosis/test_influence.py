"""The regression of answers on the numbers of the diagnosis."""

import subprocess
import sys

import numpy as np
import pytest

from benchmarks.diagnosis.influence import chosen, factors_of, moved, slopes
from ehls_ros.diagnosis import rules


def test_numbers_move_by_their_factor_and_fractions_keep_below_one():
    assert moved(4.5, 0.2) == pytest.approx(4.5 * np.exp(0.2))
    assert 1.0 - moved(0.95, 0.2) == pytest.approx(0.05 * np.exp(0.2))
    assert moved(3, 0.2) == 4
    assert moved(1, -0.2) == 1


def test_chosen_numbers_are_those_a_diagnosis_uses():
    names = [number.name for number in chosen()]
    assert "NEEDED_GAIN" in names
    assert "MAX_ITERATIONS" in names
    assert not {"MONITOR_LEAD", "FREE_RUN", "MAX_SQUARE", "EDGE"} & set(names)


def test_slopes_are_those_of_the_answers_within_their_errors():
    rng = np.random.default_rng(1)
    x = rng.uniform(-1.0, 1.0, (600, 50))
    slope, error = slopes(x, 2.0 * x[:, 3] - 1.0 + rng.normal(size=600))
    assert slope[3] == pytest.approx(2.0, abs=4.0 * error[3])
    assert np.mean(np.abs(np.delete(slope, 3)) < 2.0 * np.delete(error, 3)) > 0.85


def test_factors_are_one_for_all_cases_only_if_asked():
    assert np.array_equal(factors_of(2, 0, True, 5), factors_of(2, 1, True, 5))
    assert not np.array_equal(factors_of(2, 0, False, 5), factors_of(2, 1, False, 5))
    assert not np.any(factors_of(0, 0, False, 5))


def test_modules_are_imported_with_moved_numbers():
    code = """
import importlib, sys
from benchmarks.diagnosis.influence import AFRESH, Moving
for name in [name for name in sys.modules if name.startswith(AFRESH)]:
    del sys.modules[name]
sys.meta_path.insert(0, Moving({("ehls_ros.diagnosis.rules", "HUBER"): 4.0, ("ehls_ros.diagnosis.fit", "MAX_ITERATIONS"): 3}))
fit, loss = (importlib.import_module(f"ehls_ros.diagnosis.{name}") for name in ("fit", "loss"))
print(loss.CLIP, loss.rules.MAX_SQUARE, *fit.Worker.fit.__defaults__)
"""
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert found.split() == ["20.0", "16.0", "3", "None"]
    assert rules.HUBER == 3.0
