"""Defaults follow from the rig: exactly the declared ones on the paper's, scaled on others; given values take precedence."""

import numpy as np
import pytest

from benchmarks.scaled_rigs import case, similar
from ehls_ros.control.companions import COMPANIONS
from ehls_ros.control.controllers import CONTROLLERS, fasmc
from ehls_ros.control.disturbances import DISTURBANCES
from ehls_ros.control.estimate_bounds import bounds_of, sentence
from ehls_ros.control.observers import OBSERVERS
from ehls_ros.control.rig_scale import PAPER_PLANT, PAPER_SENSORS, Ratios, defaults_for, ratios, tuned_for
from ehls_ros.experiments.files import config_folder
from ehls_ros.experiments.loop import run_in_process
from ehls_ros.experiments.metrics import evaluate
from ehls_ros.experiments.spec import COMMAND_DELAY, load_rig, spec_from_mapping, spec_to_mapping
from ehls_ros.hardware.gate_parameters import Parameters as GateParameters
from ehls_ros.physics.rig import UNKNOWN
from ehls_ros.schema import declarations

PAPER, MEASURED = (load_rig(config_folder() / f"{name}.yaml") for name in ("rig_paper", "rig_paper_measured"))
FAMILIES = {"controller": CONTROLLERS, "observer": OBSERVERS, "companion": COMPANIONS, "disturbance": DISTURBANCES}
DECLARED = {f"{kind} {name}": family.load(name).Parameters for kind, family in FAMILIES.items() for name in family.names()}
DECLARED["gate"] = GateParameters
SIZED = ("N", "Pa", "m", "kg", "t")
"""Units of quantities that scale with a rig."""


def test_the_paper_s_rig_is_the_one_that_defaults_are_declared_for():
    assert PAPER.plant == PAPER_PLANT
    assert {name: sensor for name, sensor in MEASURED.sensors.items() if name in PAPER_SENSORS} == PAPER_SENSORS
    assert ratios(PAPER) == ratios(MEASURED) == Ratios(*[1.0] * len(Ratios._fields))


@pytest.mark.parametrize("name", DECLARED)
def test_on_the_paper_s_rig_each_default_is_the_declared_one(name):
    declared = DECLARED[name]
    for rig in (PAPER, MEASURED):
        assert defaults_for(declared, rig) == {d.name: d.default for d in declarations(declared) if d.scale}


@pytest.mark.parametrize("name", [name for name in DECLARED if not name.startswith("companion")])
def test_every_number_with_a_size_follows_the_rig(name):
    for d in declarations(DECLARED[name]):
        symbols = d.unit.replace("^", " ").replace("/", " ").replace("mm", "m").replace("MPa", "Pa").split()
        sized = isinstance(d.default, float) and d.default != 0.0 and (set(symbols) & set(SIZED) or d.name == COMMAND_DELAY)
        assert bool(d.scale) == bool(sized), f"{name}: {d.name} [{d.unit}]"


def test_a_rig_ten_times_as_large_has_ten_times_the_forces():
    tuning, paper = tuned_for(fasmc.Parameters, similar(PAPER, 10.0)), fasmc.Parameters()
    for name, power in {
        "k": 0,
        "g": 0,
        "h": 1,
        "b": 1,
        "delta_f": 1,
        "phi1": -1,
        "phi2": -1,
        "phi3": 1,
        "delta_maximum": 1,
    }.items():
        assert getattr(tuning, name) == pytest.approx(getattr(paper, name) * 10.0**power), name


def test_numbers_that_are_given_are_used_as_they_are():
    given = {**fasmc.Parameters()._asdict(), "delta_maximum": 123.0}
    assert case("fasmc", 10.0, **given).controller.parameters == fasmc.Parameters(**given)
    written = case("fasmc", 10.0)
    assert spec_from_mapping(spec_to_mapping(written), "again", config_folder()).controller == written.controller


def test_a_rig_that_lacks_a_number_has_the_paper_s():
    rig = PAPER._replace(plant=PAPER.plant._replace(moving_mass=UNKNOWN, piston_area=UNKNOWN))
    assert tuned_for(fasmc.Parameters, rig) == fasmc.Parameters()


@pytest.mark.parametrize("size", [0.1, 10.0])
def test_fasmc_holds_a_rig_of_any_size_as_it_holds_the_paper_s(size):
    ours, paper = (evaluate(run_in_process(case("fasmc", n, 3.0))) for n in (size, 1.0))
    assert ours.warnings == ()
    assert ours.max_error_n == pytest.approx(size * paper.max_error_n, rel=1e-3)
    assert ours.max_error_n < 0.01 * size * 10e3


def test_an_estimate_at_its_bound_is_said_with_its_share_and_remedy():
    run = run_in_process(case("fasmc", 10.0, 3.0, delta_maximum=5e4))
    [said] = [warning for warning in evaluate(run).warnings if warning.startswith("D̂")]
    late = run.time_s >= run.time_s[0] + 0.5 * np.ptp(run.time_s)
    share = round(100.0 * np.mean(np.abs(run["delta_n"][late]) >= 5e4))
    assert share > 10
    assert said.startswith(f"D̂ stood at its bound of ±50 kN for {share} % of the last half: raise delta_maximum")
    assert np.array_equal(run["at_bound"] > 0.5, (np.abs(run["delta_n"]) >= 5e4) | ~within(run["alpha"]) | ~within(run["beta"]))


def within(scale):
    p = fasmc.Parameters()
    return (scale > p.scale_minimum) & (scale < p.scale_maximum)


def test_bounds_of_zero_width_bound_nothing():
    off = fasmc.Parameters(delta_maximum=0.0, scale_minimum=1.0, scale_maximum=1.0)
    assert bounds_of(fasmc, off) == ()
    assert bounds_of(CONTROLLERS.load("sic"), CONTROLLERS.load("sic").Parameters()) == ()


def test_each_side_of_a_range_has_its_remedy():
    said = [sentence(bound) for bound in bounds_of(fasmc, fasmc.Parameters())]
    assert [each.split(",")[0] for each in said] == [
        "D̂ stands at its bound of ±50 kN: raise delta_maximum",
        "α̂ stands at its bound of 5: raise scale_maximum",
        "α̂ stands at its bound of 0.2: lower scale_minimum",
        "β̂ stands at its bound of 5: raise scale_maximum",
        "β̂ stands at its bound of 0.2: lower scale_minimum",
    ]
    values = {"D̂": (-6e4, 0.0), "α̂": (5.0, 1.0)}
    for bound in bounds_of(fasmc, fasmc.Parameters())[:2]:
        assert [bound.reached(value) for value in values[bound.estimate]] == [True, False]
        assert not bound.reached(float("nan"))
