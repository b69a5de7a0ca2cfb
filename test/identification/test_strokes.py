"""Missing strokes of recordings, and the experiments that deliver them."""

from pathlib import Path

import numpy as np
import pytest
from identification.recordings import PAPER_VELOCITIES, recorded, small_sine, sweep

from ehls_ros.experiments.spec import load_rig, load_spec
from ehls_ros.experiments.stroke_experiments import stroke_experiments
from ehls_ros.experiments.yaml_files import rig_text
from ehls_ros.identification.identify import MissingStrokes, identify, is_steady
from ehls_ros.identification.motion import motions_of
from ehls_ros.identification.strokes import Missing, missing_strokes
from ehls_ros.physics.rig import rig_from_mapping, rig_to_mapping

ROOT = Path(__file__).parents[2]
SWEEP = sweep(PAPER_VELOCITIES[::4])
NOTHING = Missing(("everything",), (1e-3, 4e-3, 0.03), (6e-4, 0.5))


@pytest.fixture(scope="module")
def rig():
    return load_rig(ROOT / "config" / "rig_paper.yaml")


def lacking(velocities, rig, **more):
    motions = motions_of({str(i): recorded(v, rig, i) for i, v in enumerate(velocities)}, rig)
    return missing_strokes(motions, [m.resolved & is_steady(m, rig) for m in motions], rig, **more)


def test_a_sweep_and_a_small_sine_lack_nothing(rig):
    assert lacking([SWEEP, small_sine()], rig) == ((), (), None)


@pytest.mark.parametrize(
    ("velocities", "told"),
    [
        (sweep(PAPER_VELOCITIES[8:]), ["slower than 4.1 mm/s forwards", "slower than 4.1 mm/s backwards"]),
        (sweep(PAPER_VELOCITIES[:5]), ["faster than 10 mm/s forwards", "faster than 10 mm/s backwards"]),
        (np.maximum(SWEEP, 0.0), ["slower than 4.1 mm/s backwards", "faster than 10 mm/s backwards"]),
    ],
)
def test_ranges_and_directions_that_are_missing_are_told(rig, velocities, told):
    wide = rig._replace(limits=rig.limits._replace(position=(-25.0, 25.0)))
    found = lacking([velocities, small_sine()], wide)
    assert found.descriptions == tuple(f"strokes {each}" for each in told)
    assert (found.velocities[0] < 2e-3, found.velocities[-1] > 0.02, found.sine) == (True, True, None)


def test_a_disturbance_and_no_presliding_are_told(rig):
    found = lacking([SWEEP], rig, disturbance=500.0)
    assert [told.split(",")[0] for told in found.descriptions] == ["strokes without a disturbance force", "presliding"]
    amplitude, frequency = found.sine
    assert 2.0 * np.pi * amplitude * frequency == pytest.approx(rig.friction.stribeck_velocity, rel=0.05)


def test_a_fit_that_fails_says_what_it_lacks(rig):
    wide = rig._replace(limits=rig.limits._replace(position=(-25.0, 25.0)))
    with pytest.raises(MissingStrokes) as caught:
        identify({"forth": recorded(np.maximum(sweep(PAPER_VELOCITIES[12:]), 0.0), rig, 1)}, wide)
    assert "position_m slides forwards only: there are no strokes slower than 4.1 mm/s forwards" in caught.value.what
    assert caught.value.expected.startswith("strokes both ways at constant velocities from 1 to 32 mm/s and a sine of")


def test_the_experiments_run_within_the_limits_of_the_rig(rig, tmp_path):
    short = rig._replace(limits=rig.limits._replace(position=(0.1, 0.2)))
    (tmp_path / "rig.yaml").write_text(rig_text(rig_to_mapping(short)), encoding="utf-8")
    for asked in stroke_experiments(NOTHING, short, tmp_path / "rig.yaml", tmp_path):
        (tmp_path / asked.file).write_text(asked.text, encoding="utf-8")
        spec = load_spec(tmp_path / asked.file)
        assert spec.rig == short
        assert spec.settings.initial_position == pytest.approx(0.15)
    assert {path.name for path in tmp_path.iterdir()} == {"rig.yaml", "missing_strokes.yaml", "missing_presliding.yaml"}
    assert spec.reference.parameters.offset == pytest.approx(0.15)


def test_strokes_too_fast_for_their_length_speed_up_sooner(rig, tmp_path):
    fast = NOTHING._replace(velocities=(0.1, 0.5))
    asked = next(iter(stroke_experiments(fast, rig, tmp_path / "rig.yaml", tmp_path)))
    (tmp_path / asked.file).write_text(asked.text, encoding="utf-8")
    (tmp_path / "rig.yaml").write_text(rig_text(rig_to_mapping(rig)), encoding="utf-8")
    reference = load_spec(tmp_path / asked.file).reference.parameters
    assert 0.5**2 / reference.acceleration == pytest.approx(0.5 * reference.travel)


def test_a_rig_that_is_not_known_is_asked_for_no_experiment(rig, tmp_path):
    content = rig_to_mapping(rig)
    del content["plant"]["valve_bandwidth"]
    known = rig_from_mapping(content, "rig.yaml")
    assert list(stroke_experiments(NOTHING, known, tmp_path / "rig.yaml", tmp_path)) == []
