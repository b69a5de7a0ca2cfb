"""The experiments in config/ run and behave as described."""

from pathlib import Path

import numpy as np
import pytest

from ehls_ros.control.references import velocity_sweep
from ehls_ros.experiments.loop import run_in_process
from ehls_ros.experiments.metrics import evaluate
from ehls_ros.experiments.spec import load_rig, load_spec

FOLDER = Path(__file__).parents[2] / "config" / "experiments"
FILES = sorted(FOLDER.glob("*.yaml"))
LONGEST = 60.0
"""Maximum duration of an experiment here [s]."""
# Largest force error of the steady part [N]: the paper's if given (except SIC: 223 N there).
LARGEST = {
    "constant_fd1": 4.9,
    "constant_fd2": 42.1,
    "constant_fd2_sic": 290.0,
    "constant_velocity": None,
    "friction_presliding": None,
    "friction_sweep": None,
    "friction_sweep_quick": None,
    "irregular_fd2": 61.6,
    # The paper's, plus the load cell's noise and resolution.
    "measured_constant_fd1": 12.3 + 10.0,
    "measured_constant_fd2": 68.2 + 10.0,
    "measured_sine_fd1": 63.7,
    "measured_sine_fd2": 117.0,
    # Half of it.
    "measured_sine_fd2_preview": 58.5,
    "servo_sine": 90.0,
    "sine_fd1": 37.8,
    "sine_fd2": 91.3,
    "triangle_fd2": 79.8,
}


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_an_experiment_runs_and_is_as_good_as_it_has_to_be(path):
    spec = load_spec(path)
    spec = spec._replace(settings=spec.settings._replace(duration=min(spec.settings.duration, LONGEST)))
    run = run_in_process(spec)
    assert np.all(np.isfinite(run["force_n"]))
    assert len(run) == spec.cycles
    assert run.metadata["title"] == spec.settings.title != "experiment"
    largest = LARGEST.get(path.stem)
    if largest is not None:
        assert evaluate(run).max_error_n <= largest


def test_every_expected_experiment_is_there():
    assert {path.stem for path in FILES} >= set(LARGEST)


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_an_experiment_says_first_what_it_is(path):
    for_editors, first = path.read_text(encoding="utf-8").splitlines()[:2]
    assert for_editors.startswith("# yaml-language-server: ")
    assert first.startswith("# ")
    assert first.endswith(".")


def test_constant_velocity_moves_at_its_velocity():
    run = run_in_process(load_spec(FOLDER / "constant_velocity.yaml"))
    even = np.abs(np.abs(run["position_reference_rate_m_s"]) - 0.02) < 1e-12
    middle = even & (np.abs(run["position_m"]) < 0.04) & (run.time_s > 4.0)
    assert np.allclose(run["velocity_m_s"][middle], run["position_reference_rate_m_s"][middle], rtol=0.01)
    assert np.min(run["velocity_m_s"][middle]) < 0.0 < np.max(run["velocity_m_s"][middle])
    # (20): the driving force of either direction is half a Coulomb apart from its mean.
    forth = run["velocity_m_s"] > 0.0
    force = run["force_n"] - 4e4 * run["position_m"] - 70.0 * 9.81
    drag = 0.5 * (np.mean(force[middle & forth]) - np.mean(force[middle & ~forth]))
    level = 640.8 + (865.4 - 640.8) * np.exp(-((0.02 / 2.031e-3) ** 0.8764))
    assert drag == pytest.approx((60.0 + 7265.0) * 0.02 + level, rel=0.01)


@pytest.mark.parametrize(
    "path", [path for path in FILES if load_spec(path).reference.name == "velocity_sweep"], ids=lambda path: path.stem
)
def test_a_sweep_is_as_long_as_its_spec(path):
    spec = load_spec(path)
    length = velocity_sweep.duration(spec.reference.parameters)
    assert length < spec.settings.duration < length + 1.0
    # The comment states it too.
    assert f"{length:.1f} s" in path.read_text(encoding="utf-8") or f"{length:.2f} s" in path.read_text(encoding="utf-8")


def test_a_quick_sweep_follows_its_strokes_with_the_rigs_sensors():
    run = run_in_process(load_spec(FOLDER / "friction_sweep_quick.yaml"))
    rate = run["position_reference_rate_m_s"]
    assert len(set(np.round(rate[run["position_reference_acceleration_m_s2"] == 0.0], 9)) - {0.0}) == 40
    error = run["position_m"] - run["position_reference_m"]
    assert np.max(np.abs(error[run.time_s > 1.0])) < 100e-6
    assert np.sqrt(np.mean(error**2)) < 8e-6
    assert np.max(np.abs(run["position_m"])) < 0.2505
    assert np.max(np.abs(run["force_n"])) < 12e3
    assert not np.any(run["saturated"])


def test_presliding_shows_both_branches_of_the_loop():
    run = run_in_process(load_spec(FOLDER / "friction_presliding.yaml"))
    last = run.time_s > 50.0
    error = run["position_m"] - run["position_reference_m"]
    assert np.max(np.abs(error[last])) < 15e-6
    # Without spring and gravity, right after a reversal it rises with the three elements' stiffness, at the end it stays.
    position, force = run["position_m"][last], run["force_n"][last] - 4e4 * run["position_m"][last] - 70.0 * 9.81
    rising = run["position_reference_rate_m_s"][last] > 0.0
    stuck = rising & (position < -0.7e-3) & (position > -1.15e-3)
    assert np.polyfit(position[stuck], force[stuck], 1)[0] == pytest.approx(2.265e6, rel=0.03)
    sliding = rising & (position > 0.0)
    assert 700.0 < np.min(force[sliding]) <= np.max(force[sliding]) < 875.0


def test_the_measured_rig_is_the_papers_but_for_its_sensors():
    paper, measured = (load_rig(FOLDER.parent / f"{name}.yaml") for name in ("rig_paper", "rig_paper_measured"))
    assert measured._replace(sensors={}) == paper
    assert measured.sensors["force"].resolution == 4.0
    assert measured.sensors["position"].resolution == 5e-6
