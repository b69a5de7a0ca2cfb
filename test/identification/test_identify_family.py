"""`ehls identify` of a rig with any friction model: simulated, recorded with noise, identified from a distant guess."""

import json
import math
from itertools import cycle
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import yaml
from report.report_pages import check
from tiers import tiered

from ehls_ros.cli.main import main
from ehls_ros.control.observers import rig_model
from ehls_ros.control.references.velocity_sweep import Parameters as Sweep
from ehls_ros.control.references.velocity_sweep import duration
from ehls_ros.errors import BadInput
from ehls_ros.experiments.loop import run_in_process
from ehls_ros.experiments.spec import Use, load_rig, load_spec
from ehls_ros.physics.friction import FRICTION_MODELS
from ehls_ros.physics.rig import Rig, rig_from_mapping, rig_to_mapping
from ehls_ros.schema import declarations

CONFIG = Path(__file__).parents[2] / "config"
SWEEP = Sweep(velocities=(0.002, 0.003, 0.005, 0.01, 0.02, 0.04, 0.08, 0.15), repeats=1, travel=0.2, longest=4.5)
PERTURBED = (1.15, 1.2, 0.85, 1.1, 0.9)
FAR_OFF = (1.3, 1.4, 0.7, 1.3, 0.7)
FEW_PERCENT, INTERVAL = 0.04, 4.0
"""Accepted error of a coefficient, as a fraction of it or in standard errors."""


def rig_of(model: str) -> Rig:
    """The measured rig with another friction model."""
    mapping = rig_to_mapping(load_rig(CONFIG / "rig_paper_measured.yaml"))
    mapping["friction"]["model"] = model
    return rig_from_mapping(mapping, model)


def moved(rig: Rig, factors: tuple[float, ...]) -> Rig:
    """Return the rig with its friction parameters multiplied, as far as their ranges and the model allow."""
    friction = rig.friction
    numbers = [d for d in declarations(type(friction)) if isinstance(getattr(friction, d.name), float)]
    for declared, factor in zip(numbers, cycle(factors)):
        low, high = declared.minimum or 0.0, math.inf if declared.maximum is None else declared.maximum
        other = friction._replace(**{declared.name: min(max(factor * getattr(friction, declared.name), low), high)})
        try:
            rig.friction_law.check(other, "test")
        except BadInput:
            continue
        friction = other
    return rig._replace(friction=friction, other_friction={})


def record(rig: Rig, experiment: str, folder: Path, **changed: Any) -> Path:
    """Simulate an experiment and write the sensor readings of position and force."""
    spec = load_spec(CONFIG / "experiments" / f"{experiment}.yaml")
    reference = changed.pop("reference", spec.reference)
    spec = spec._replace(
        rig=rig,
        controller_rig=rig,
        reference=reference,
        compensation=Use("rig_model", rig_model.Parameters()),
        settings=spec.settings._replace(**changed),
    )
    run = run_in_process(spec)
    path = folder / f"{experiment}.csv"
    columns = ("position_m", "force_n")
    rows = np.column_stack([run.time_s, *(run[name] for name in columns)])
    np.savetxt(path, rows, delimiter=",", header=",".join(("time_s", *columns)), comments="", fmt="%.9g")
    return path


class Identified(NamedTuple):
    true: Rig
    guess: Rig
    rig: Rig
    result: dict[str, Any]
    report: str


@pytest.fixture(scope="module", params=tiered(FRICTION_MODELS.names(), "gms", "lugre"))
def identified(request, tmp_path_factory) -> Identified:
    folder = tmp_path_factory.mktemp(request.param)
    true = moved(rig_of(request.param), PERTURBED)
    guess = moved(true, FAR_OFF)
    (folder / "guess.yaml").write_text(yaml.safe_dump(json.loads(json.dumps(rig_to_mapping(guess)))), encoding="utf-8")
    data = [
        record(true, "friction_sweep_quick", folder, reference=Use("velocity_sweep", SWEEP), duration=duration(SWEEP), seed=1),
        record(true, "friction_presliding", folder, duration=20.0, seed=2),
    ]
    assert main(["identify", *map(str, data), "--rig", str(folder / "guess.yaml"), "--out", str(folder / "out")]) == 0
    return Identified(
        true,
        guess,
        load_rig(folder / "out" / "rig_identified.yaml"),
        json.loads((folder / "out" / "identification.json").read_text(encoding="utf-8")),
        (folder / "out" / "report.html").read_text(encoding="utf-8"),
    )


def true_value(rig: Rig, name: str) -> float | None:
    """Return a coefficient of the rig by its name in the result; None for that of an element."""
    value = getattr(rig.friction, name, getattr(rig.plant, name, None))
    return value if isinstance(value, float) else None


def test_every_coefficient_is_found_within_its_interval_or_a_few_percent(identified):
    wrong = {}
    for name, found in identified.result["parameters"].items():
        true = true_value(identified.true, name)
        if true is not None and abs(found["value"] - true) > max(FEW_PERCENT * abs(true), INTERVAL * found["std"]):
            wrong[name] = (found["value"], found["std"], true)
    assert not wrong


def test_what_the_recordings_show_is_identified(identified):
    law, true, found = identified.true.friction_law, identified.true, identified.rig
    for speed in (0.02, 0.15, math.inf):
        assert found.friction_level(speed) == pytest.approx(true.friction_level(speed), rel=0.005)
    assert found.friction.viscous_coefficient == pytest.approx(true.friction.viscous_coefficient, rel=0.005)
    # On a rigid contact the slow strokes are stick-slip.
    if math.isfinite(law.stiffness(true.friction)):
        assert law.stiffness(found.friction) == pytest.approx(law.stiffness(true.friction), rel=0.05)
        assert found.friction_level(0.002) == pytest.approx(true.friction_level(0.002), rel=0.01)
        numbers = {name for name, value in true.friction._asdict().items() if isinstance(value, float)}
        assert numbers <= set(identified.result["parameters"])


def test_the_guess_was_far_off(identified):
    true, guess = identified.true, identified.guess
    assert abs(guess.friction_level(0.02) / true.friction_level(0.02) - 1.0) > 0.15
    assert abs(guess.friction.viscous_coefficient / true.friction.viscous_coefficient - 1.0) > 0.15


def test_the_result_says_how_it_was_made(identified):
    result = identified.result
    for name, found in result["parameters"].items():
        assert found["unit"], name
        assert 0.0 < found["std"] < 0.3 * abs(found["value"]), name
    assert "viscous_damping" in result["not_identifiable"]
    assert not set(result["parameters"]) & set(result["not_identifiable"])
    assert result["method"]
    assert result["cost"] > 0.0
    assert result["wall_s"] > 0.0


def test_the_rig_file_is_one_of_the_same_model(identified):
    assert identified.rig.friction_model == identified.true.friction_model
    assert rig_from_mapping(rig_to_mapping(identified.rig), "again") == identified.rig


def test_the_report_renders(identified):
    check(identified.report)
    for name in identified.result["parameters"]:
        assert name in identified.report
    assert identified.true.friction_model in identified.report
