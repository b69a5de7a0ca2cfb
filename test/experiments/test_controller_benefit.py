"""Benefit of an extended model for the controller, and the outcome on rigs whose force cannot be controlled."""

import json
from typing import Any

import pytest

from ehls_ros.experiments import controller_benefit as module
from ehls_ros.experiments.controller_benefit import controller_benefit
from ehls_ros.experiments.json_document import json_document
from ehls_ros.experiments.loop import run_in_process
from ehls_ros.physics.rig import Rig, rig_from_mapping


@pytest.fixture
def make_rig(rig_mapping):
    """Return a maker of rigs: effects as a list, keys of sections by keyword."""

    def make(*effects: dict[str, Any], **sections: dict[str, Any]) -> Rig:
        changed = {section: {**rig_mapping[section], **values} for section, values in sections.items()}
        return rig_from_mapping({**rig_mapping, **changed, "effects": list(effects)}, "rig")

    return make


MASS = {"name": "mass_shift", "factor": 3.0}
DEAD_ZONE = {"name": "valve_dead_zone", "positive": 5e-5, "negative": 5e-5}


def test_knowing_the_mass_the_law_errs_less(make_rig):
    benefit = controller_benefit(make_rig(), make_rig(MASS))
    assert [case.case for case in benefit.cases] == [
        "10 kN held against 5 kN at 1 Hz",
        "10 kN sine of 0.5 Hz against 5 kN at 1 Hz",
    ]
    assert not benefit.same_controller
    for case in benefit.cases:
        assert case.before.trouble == case.after.trouble == ""
        assert case.after.max_error_n < 0.5 * case.before.max_error_n
        assert case.after.rms_error_n < 0.5 * case.before.rms_error_n
        assert case.before.rms_error_n < case.before.max_error_n < 150.0


def test_without_a_change_the_errors_are_the_papers(make_rig):
    benefit = controller_benefit(make_rig(), make_rig())
    assert benefit.same_controller
    # Table 3: 42.1 and 91.3 N.
    assert [case.after.max_error_n for case in benefit.cases] == pytest.approx([35.4, 35.8], abs=1.0)


@pytest.mark.long
def test_of_what_adds_to_the_equations_the_law_has_nothing(make_rig):
    benefit = controller_benefit(make_rig(), make_rig(DEAD_ZONE))
    assert benefit.same_controller
    for case in benefit.cases:
        assert case.before == case.after
        assert case.before.max_error_n > 200.0


def test_both_at_once_are_known_in_part(make_rig):
    benefit = controller_benefit(make_rig(DEAD_ZONE), make_rig(DEAD_ZONE, MASS))
    assert not benefit.same_controller
    assert all(case.after.rms_error_n != case.before.rms_error_n for case in benefit.cases)


def test_an_effect_the_old_model_had_is_known_before(make_rig):
    benefit = controller_benefit(make_rig(MASS), make_rig(MASS, DEAD_ZONE))
    assert benefit.same_controller


def test_a_loop_that_diverges_says_so_instead_of_a_number(make_rig):
    benefit = controller_benefit(make_rig(), make_rig({"name": "command_delay", "delay": 0.004}))
    assert len(benefit.cases) == 2
    for case in benefit.cases:
        assert case.after.max_error_n is None
        assert case.after.rms_error_n is None
        assert case.after.trouble.startswith("diverged: leaves the largest force at 0.0")
        assert "try " in case.after.trouble


def test_a_smaller_rig_gets_smaller_cases(make_rig):
    small = make_rig(limits={"force": 9.1e3})
    benefit = controller_benefit(small, small)
    assert [case.force_n for case in benefit.cases] == pytest.approx([5005.0, 5005.0])
    assert benefit.cases[0].case == "5 kN held against 2.5 kN at 1 Hz"
    assert all(case.after.max_error_n < 50.0 for case in benefit.cases)
    short = make_rig(limits={"position": [-0.15, 0.15]})
    assert [case.force_n for case in controller_benefit(short, short).cases] == pytest.approx([5200.0, 5200.0], rel=0.01)


def electric_axis(rig_mapping: dict[str, Any]) -> Rig:
    """A motor and a slide, its force expressed as the pressure on one square metre."""
    plant = {
        "supply_pressure": 400.0, "piston_area": 1.0, "moving_mass": 95.1, "spring_stiffness": 0.0, "viscous_damping": 0.0,
        "gravity": 0.0, "leakage_coefficient": 1.0,
    }  # fmt: skip
    friction = {
        "model": "stribeck", "coulomb_force": 20.39, "static_force": 21.0, "viscous_coefficient": 203.5,
    }  # fmt: skip
    return rig_from_mapping(
        {
            "plant": {**rig_mapping["plant"], **plant},
            "friction": {**rig_mapping["friction"], **friction},
            "limits": {"spool": 1.0, "force": 351.5, "load_pressure": 351.5, "position": [0.0, 0.25], "velocity": 0.5},
        },
        "axis",
    )


def test_an_electric_axis_has_no_force_to_be_controlled(rig_mapping):
    axis = electric_axis(rig_mapping)
    benefit = controller_benefit(axis, axis)
    assert benefit.cases == ()
    assert benefit.reason


ODD = [
    pytest.param({"plant": {"spring_stiffness": 0.0}}, id="no spring"),
    pytest.param(
        {"plant": {"spring_stiffness": 0.0, "viscous_damping": 0.0}, "friction": {"viscous_coefficient": 0.0}}, id="free"
    ),
    pytest.param({"plant": {"moving_mass": 1e-6}}, id="no mass"),
    pytest.param({"plant": {"moving_mass": 1e7}}, id="all mass"),
    pytest.param({"plant": {"gravity": 0.0}, "friction": {"coulomb_force": 1.0, "static_force": 1.0}}, id="no friction"),
    pytest.param({"plant": {"bulk_modulus": 1e3}}, id="air"),
    pytest.param({"plant": {"supply_pressure": 1e-3}}, id="no supply"),
    pytest.param({"plant": {"valve_bandwidth": 1e-3}}, id="no valve"),
    pytest.param({"plant": {"valve_bandwidth": 1e6, "bulk_modulus": 1e12}}, id="stiff"),
    pytest.param({"limits": {"position": [-1e-6, 1e-6]}}, id="no stroke"),
    pytest.param({"limits": {"position": [5.0, 6.0]}}, id="far off"),
    pytest.param({"limits": {"spool": 1e-9}}, id="no opening"),
]


@pytest.mark.parametrize("sections", ODD)
def test_an_odd_rig_is_a_result_not_an_exception(make_rig, sections):
    odd = make_rig(**sections)
    benefit = controller_benefit(odd, odd)
    assert benefit.cases or len(benefit.reason) > 20
    for case in benefit.cases:
        for steady in (case.before, case.after):
            assert bool(steady.trouble) == (steady.max_error_n is None)
    assert "NaN" not in json.dumps(json_document(benefit))


def test_it_simulates_twenty_seconds_and_tells_how_far_it_is(make_rig, monkeypatch):
    simulated: list[float] = []
    done: list[tuple[int, int]] = []

    def noted(spec):
        simulated.append(spec.settings.duration)
        return run_in_process(spec)

    monkeypatch.setattr(module, "run_in_process", noted)
    controller_benefit(make_rig(), make_rig(MASS), progress=lambda *count: done.append(count))
    assert simulated == [5.0, 5.0, 5.0, 5.0]
    assert done == [(1, 2), (2, 2)]
