"""Expansion of a campaign file, and its forbidden contents."""

import itertools
import json

import numpy as np
import pytest
import yaml
from campaign_cases import BASE, CONFIG, DRAWS, specs, write

from ehls_ros.errors import BadInput
from ehls_ros.experiments.campaign.plan import load_plan
from ehls_ros.experiments.spec import load_spec, spec_from_mapping, spec_to_mapping


def test_a_grid_is_every_combination_on_the_base(tmp_path):
    plan = load_plan(write(tmp_path, vary={"controller.k": [6.0, 12], "duration": [0.1, 0.2, 0.3]}))
    made = specs(plan)
    assert [(s["controller"]["k"], s["duration"]) for s in made] == list(itertools.product((6.0, 12.0), (0.1, 0.2, 0.3)))
    base = spec_to_mapping(spec_from_mapping(BASE, "base", CONFIG))
    for spec in made:
        spec["controller"]["k"], spec["duration"] = base["controller"]["k"], base["duration"]
        assert spec == json.loads(json.dumps(base))


def test_a_range_includes_both_ends(tmp_path):
    linear, log = {"start": 10.0, "stop": 40.0, "points": 4}, {"start": 1.0, "stop": 100.0, "points": 3, "spacing": "log"}
    assert [s["controller"]["k"] for s in specs(load_plan(write(tmp_path, vary={"controller.k": linear})))] == [10, 20, 30, 40]
    found = [s["controller"]["k"] for s in specs(load_plan(write(tmp_path, vary={"controller.k": log})))]
    assert found == pytest.approx([1.0, 10.0, 100.0])


def test_what_is_zipped_changes_together(tmp_path):
    plan = load_plan(
        write(
            tmp_path,
            vary={"seed": [1, 2]},
            zip=[{"controller.k": [6, 12], "controller.h": [50, 25]}],
        )
    )
    found = {(s["seed"], s["controller"]["k"], s["controller"]["h"]) for s in specs(plan)}
    assert found == {(1, 6.0, 50.0), (2, 6.0, 50.0), (1, 12.0, 25.0), (2, 12.0, 25.0)}


def test_sections_are_replaced_before_what_lies_in_them(tmp_path):
    vary = {
        "controller.xi": [2.0],
        "controller": [{"name": "fasmc", "k": 7.0}],
        "reference": ["constant", {"name": "triangle", "amplitude": 5e3}],
        "effects": [[], [{"name": "valve_dead_zone"}]],
        "compensation": ["stribeck"],
    }
    plan = load_plan(write(tmp_path, vary=vary))
    made = specs(plan)
    assert {(s["controller"]["k"], s["controller"]["xi"]) for s in made} == {(7.0, 2.0)}
    assert {(s["reference"]["name"], len(s["rig"]["effects"])) for s in made} == set(
        itertools.product(("constant", "triangle"), (0, 1))
    )
    assert not any(s["controller_rig"]["effects"] for s in made)
    labels = {(run.values["reference"], run.values["effects"]) for run in plan.runs()}
    assert ("triangle amplitude=5000", "valve_dead_zone") in labels
    assert ("constant", "none") in labels


def test_relative_numbers_are_factors_on_the_points_own_value(tmp_path):
    vary = {
        "rig.plant.moving_mass": [50.0, 100.0],
        "controller.k": {"start": 0.5, "stop": 2.0, "points": 2, "relative": True},
        "controller.h": {"uniform": [2.0, 2.0], "relative": True},
    }
    plan = load_plan(write(tmp_path, runs=1, vary=vary))
    assert {s["controller"]["k"] for s in specs(plan)} == {6.0, 24.0}
    assert {s["controller"]["h"] for s in specs(plan)} == {50.0}
    assert {run.values["controller.k"] for run in plan.runs()} == {6.0, 24.0}


def test_a_path_may_lead_into_lists_and_to_what_the_base_leaves_out(tmp_path):
    vary = {"rig.friction.element_stiffness.1": [1e5], "rig.sensors.force.noise_std": [3.0]}
    [spec] = specs(load_plan(write(tmp_path, vary=vary)))
    assert spec["rig"]["friction"]["element_stiffness"] == [1.884e6, 1e5, 1.841e5]
    assert spec["rig"]["sensors"]["force"]["noise_std"] == 3.0
    assert spec["controller_rig"]["sensors"] == {}


def test_every_point_of_the_grid_sees_the_same_draws(tmp_path):
    plan = load_plan(write(tmp_path, runs=5, seed=3, vary={**DRAWS, "controller.k": [6, 12]}))
    by_draw = {}
    for run in plan.runs():
        drawn = {path: run.values[path] for path in (*DRAWS, "seed")}
        assert by_draw.setdefault(run.draw, drawn) == drawn
    assert len({d["rig.plant.moving_mass"] for d in by_draw.values()}) == 5
    assert len({d["seed"] for d in by_draw.values()}) == 5


def test_a_run_can_be_made_alone_and_survives_further_draws_and_paths(tmp_path):
    few = load_plan(write(tmp_path, runs=4, seed=3, vary=DRAWS))
    alone = few.run(2)
    assert list(few.runs())[2] == alone
    more = load_plan(write(tmp_path, runs=9, seed=3, vary={"controller.h": {"loguniform": [10.0, 40.0]}, **DRAWS}))
    assert {path: more.run(2).values[path] for path in alone.values} == alone.values
    other = load_plan(write(tmp_path, runs=4, seed=4, vary=DRAWS))
    assert other.run(2).values["rig.plant.moving_mass"] != alone.values["rig.plant.moving_mass"]


def test_draws_follow_their_distributions(tmp_path):
    vary = {**DRAWS, "controller.k": {"loguniform": [1.0, 100.0]}}
    runs = list(load_plan(write(tmp_path, runs=2000, vary=vary)).runs())
    mass, force, k = (np.array([run.values[path] for run in runs]) for path in vary)
    # Bounds of five standard errors.
    assert 63.0 <= mass.min() < 63.2
    assert 76.8 < mass.max() <= 77.0
    assert mass.mean() == pytest.approx(70.0, abs=5 * 14.0 / np.sqrt(12 * 2000))
    assert force.mean() == pytest.approx(900.0, abs=5 * 20.0 / np.sqrt(2000))
    assert force.std() == pytest.approx(20.0, rel=5 / np.sqrt(2 * 2000))
    assert np.log10(k).mean() == pytest.approx(1.0, abs=5 * 2.0 / np.sqrt(12 * 2000))
    assert abs(np.corrcoef(mass, force)[0, 1]) < 5 / np.sqrt(2000)


def test_the_noise_differs_from_draw_to_draw_unless_its_seed_is_varied(tmp_path):
    assert len({s["seed"] for s in specs(load_plan(write(tmp_path, runs=3)))}) == 3
    assert {s["seed"] for s in specs(load_plan(write(tmp_path, runs=3, vary={"seed": [7]})))} == {7}


def test_the_kept_file_means_the_same_elsewhere(tmp_path):
    (tmp_path / "load.csv").write_text("time_s,value\n0.0,0.0\n1.0,100.0\n")
    vary = {**DRAWS, "reference": ["constant", {"name": "load_spectrum", "file": "load.csv"}]}
    plan = load_plan(write(tmp_path, runs=2, seed=5, vary=vary))
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "kept.yaml").write_text(yaml.safe_dump(plan.file))
    assert specs(load_plan(elsewhere / "kept.yaml")) == specs(plan)


def test_columns_know_units_and_what_is_no_number(tmp_path):
    vary = {**DRAWS, "controller.k": [6, 12], "reference": ["constant", "sine"], "disturbance.signal.value": [0.0, 1.0]}
    base = {**BASE, "disturbance": {"name": "force", "signal": {"name": "constant"}}}
    columns = {column.path: column for column in load_plan(write(tmp_path, base=base, runs=1, vary=vary)).columns}
    assert (columns["rig.plant.moving_mass"].unit, columns["rig.plant.moving_mass"].drawn) == ("kg", True)
    assert (columns["controller.k"].unit, columns["controller.k"].numeric, columns["controller.k"].drawn) == (
        "MPa/s",
        True,
        False,
    )
    assert not columns["reference"].numeric
    assert columns["disturbance.signal.value"].unit
    assert columns["seed"].drawn


WRONG = {
    "no mapping": ([1], ("list", "mapping")),
    "unknown key": ({"varry": {}}, ("varry", "vary")),
    "no base": ({"base": None}, ("base", "None")),
    "base that is not there": ({"base": "nowhere.yaml"}, ("nowhere.yaml", "read")),
    "unknown section": ({"vary": {"controler.k": [1]}}, ("controler.k", "controller")),
    "settings are not a section": ({"vary": {"settings.seed": [1]}}, ("settings.seed", "seed")),
    "unknown parameter": ({"vary": {"controller.kk": [1]}}, ("kk", "unknown")),
    "unknown rig section": ({"vary": {"rig.plnt.moving_mass": [1]}}, ("plnt", "plant")),
    "unknown drawn parameter": ({"runs": 1, "vary": {"rig.plant.mass": {"uniform": [1, 2]}}}, ("mass", "unknown")),
    "nothing to be relative to": (
        {"runs": 1, "vary": {"rig.plant.mass": {"uniform": [1, 2], "relative": True}}},
        ("rig.plant.mass", "moving_mass"),
    ),
    "relative to a word": (
        {"runs": 1, "vary": {"rig.friction.model": {"uniform": [1, 2], "relative": True}}},
        ("rig.friction.model", "numbers"),
    ),
    "path beyond a number": ({"vary": {"controller.k.x": [1]}}, ("controller.k.x", "'x'")),
    "path beyond a list": ({"vary": {"rig.friction.element_weight.9": [1]}}, ("element_weight.9", "below 3")),
    "value out of range": ({"vary": {"controller.k": [12, 1e9]}}, ("controller.k = 1000000000", "k is")),
    "unknown controller": ({"vary": {"controller": ["fasmc", "magic"]}}, ("controller = magic", "magic", "fasmc")),
    "parameter of another controller": ({"vary": {"controller": ["sic"], "controller.k": [12]}}, ("controller = sic", "k")),
    "empty list": ({"vary": {"controller.k": []}}, ("controller.k", "empty")),
    "a bare value": ({"vary": {"controller.k": 12}}, ("controller.k", "12", "list")),
    "half a range": ({"vary": {"controller.k": {"start": 1}}}, ("controller.k", "stop", "missing")),
    "range over zero": ({"vary": {"controller.k": {"start": -1, "stop": 1, "points": 3, "spacing": "log"}}}, ("one sign",)),
    "two distributions": (
        {"runs": 1, "vary": {"controller.k": {"uniform": [1, 2], "normal": [1, 2]}}},
        ("uniform and normal", "one of"),
    ),
    "distribution upside down": ({"runs": 1, "vary": {"controller.k": {"uniform": [2, 1]}}}, ("[2, 1]", "low <= high")),
    "negative scatter": ({"runs": 1, "vary": {"controller.k": {"normal": [1, -1]}}}, ("normal", "0 or more")),
    "logarithm of nothing": ({"runs": 1, "vary": {"controller.k": {"loguniform": [0, 1]}}}, ("above 0",)),
    "draws without runs": ({"vary": {"controller.k": {"uniform": [1, 2]}}}, ("runs", "controller.k")),
    "no runs": ({"runs": 0}, ("runs is 0",)),
    "zip of unequal lengths": (
        {"zip": [{"controller.k": [1, 2], "controller.h": [1]}]},
        ("controller.k has 2", "controller.h has 1"),
    ),
    "zip of a draw": ({"runs": 1, "zip": [{"controller.k": {"uniform": [1, 2]}}]}, ("zip[0]", "distribution")),
    "varied twice": ({"vary": {"controller.k": [1]}, "zip": [{"controller.k": [1]}]}, ("twice", "controller.k")),
    "too many": ({"vary": {"controller.k": {"start": 1, "stop": 2, "points": 100000}}, "runs": 1000}, ("100000 points",)),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_wrong_campaign_is_refused_with_what_where_and_what_was_expected(case, tmp_path):
    content, words = WRONG[case]
    if isinstance(content, dict):
        path = write(tmp_path, **content)
    else:
        path = tmp_path / "campaign.yaml"
        path.write_text(yaml.safe_dump(content))
    with pytest.raises(BadInput) as refused:
        load_plan(path)
    line = str(refused.value)
    for word in (*words, "expected", ".yaml"):
        assert word in line, line


@pytest.mark.parametrize("path", sorted((CONFIG / "campaigns").glob("*.yaml")), ids=lambda path: path.stem)
def test_the_campaigns_that_come_along_are_whole(path):
    plan = load_plan(path)
    assert len(plan) > 100
    assert path.read_text(encoding="utf-8").startswith("# ")
    assert all(column.unit for column in plan.columns if column.numeric)


def test_the_monte_carlo_that_comes_along_varies_every_single_coefficient_of_the_rig():
    plan = load_plan(CONFIG / "campaigns" / "rig_within_ten_percent.yaml")
    rig = load_spec(CONFIG / "experiments" / "constant_fd1.yaml").rig
    single = {
        f"rig.{section}.{name}"
        for section, values in (("plant", rig.plant), ("friction", rig.friction))
        for name, value in values._asdict().items()
        # The arm enters no equation, gravity does not scatter, and weights sum to one.
        if isinstance(value, float) and name not in {"arm_length", "gravity"}
    }
    assert set(plan.drawn) == single
    assert len(plan.points) == 4
