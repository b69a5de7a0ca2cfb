"""From a fit to coefficients with standard errors: propagation against formulas, and coefficients left undetermined."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made_motions import PowerCoordinates, PowerLaw

from ehls_ros.experiments.spec import load_rig
from ehls_ros.identification import uncertainty
from ehls_ros.identification.elements import STATIC, ElementCoordinates
from ehls_ros.identification.joint import JointFit
from ehls_ros.identification.uncertainty import estimates
from ehls_ros.physics.rig import Rig

CONFIG = Path(__file__).parents[2] / "config"
LINEAR = {"viscous": 7325.0, "spring": 4e4, "constant": 686.7}


@pytest.fixture(scope="module")
def rig() -> Rig:
    paper = load_rig(CONFIG / "rig_paper.yaml")
    return paper._replace(
        friction=paper.friction._replace(element_stiffness=(3e6, 1e6), element_weight=(0.7, 0.3), attraction_rate=1650.0)
    )


def fit_of(rig: Rig, covariance: Any = None, free: Any = None, linear: dict[str, float] | None = None) -> JointFit:
    """Return a fit with the rig's friction, by default of all coordinates, with 0.1 % standard errors."""
    coordinates = ElementCoordinates(len(rig.friction.element_stiffness))
    linear = LINEAR if linear is None else linear
    free = coordinates.names if free is None else tuple(free)
    sharp = np.array([1e-3] * len(free) + [1e-3 * abs(value) for value in linear.values()])
    return JointFit(
        coordinates=coordinates,
        z=coordinates.pack(rig.friction),
        free=free,
        limited=(),
        linear_names=tuple(linear),
        linear=np.array(list(linear.values())),
        covariance=np.diag(sharp**2) if covariance is None else covariance,
        cost=1.0,
        blocks=100.0,
        noise=(1.0,),
        residuals=(np.zeros(3),),
    )


def correlation(found: uncertainty.Estimates, first: str, second: str) -> float:
    names = list(found.by_name)
    return float(found.correlations[names.index(first), names.index(second)])


def test_standard_errors_are_those_of_the_formulas(rig):
    found = estimates(fit_of(rig), rig).by_name
    f = rig.friction
    rise = f.static_force - f.coulomb_force
    assert found["coulomb_force"].std == pytest.approx(1e-3 * f.coulomb_force, rel=1e-6)
    assert found["static_force"].std == pytest.approx(1e-3 * np.hypot(f.coulomb_force, rise), rel=1e-6)
    assert found["attraction_rate"].std == pytest.approx(1.65, rel=1e-6)
    for i in (1, 2):
        assert found[f"element_stiffness_{i}"].std == pytest.approx(1e-3 * f.element_stiffness[i - 1], rel=1e-6)
        # d alpha / d ln(alpha_1/alpha_2) = alpha_1 alpha_2
        assert found[f"element_weight_{i}"].std == pytest.approx(1e-3 * 0.7 * 0.3, rel=1e-6)
    assert found["viscous_coefficient"].value == pytest.approx(7325.0 - rig.plant.viscous_damping)
    assert found["viscous_coefficient"].std == pytest.approx(7.325, rel=1e-6)
    assert found["gravity"].value == pytest.approx(686.7 / rig.plant.moving_mass)
    assert found["gravity"].std == pytest.approx(0.6867 / rig.plant.moving_mass, rel=1e-6)


def test_correlations_are_those_of_the_formulas(rig):
    found = estimates(fit_of(rig), rig)
    f = rig.friction
    share = f.coulomb_force / np.hypot(f.coulomb_force, f.static_force - f.coulomb_force)
    assert correlation(found, "coulomb_force", "static_force") == pytest.approx(share, rel=1e-6)
    assert correlation(found, "element_weight_1", "element_weight_2") == pytest.approx(-1.0, rel=1e-6)
    assert correlation(found, "coulomb_force", "gravity") == 0.0
    np.testing.assert_allclose(np.diag(found.correlations), 1.0)
    np.testing.assert_allclose(found.correlations, found.correlations.T)


def test_a_fitted_mass_enters_gravity(rig):
    linear = {"viscous": 7325.0, "constant": 700.0, "mass": 70.0}
    found = estimates(fit_of(rig, linear=linear), rig)
    gravity = found.by_name["gravity"]
    assert gravity.value == pytest.approx(10.0)
    assert gravity.std == pytest.approx(10.0 * np.hypot(1e-3, 1e-3), rel=1e-5)
    assert correlation(found, "gravity", "moving_mass") == pytest.approx(-np.sqrt(0.5), rel=1e-5)
    assert found.rig.plant.moving_mass == 70.0
    assert "spring_stiffness" not in found.by_name
    assert found.rig.plant.spring_stiffness == rig.plant.spring_stiffness


def test_the_covariance_of_a_rotated_fit_propagates_whole(rig):
    random = np.random.default_rng(0)
    size = len(ElementCoordinates(2).names) + len(LINEAR)
    root = 1e-3 * random.standard_normal((size, size)) * np.array([1.0] * (size - 3) + list(LINEAR.values()))[:, np.newaxis]
    fit = fit_of(rig, root @ root.T)
    found = estimates(fit, rig)
    everything = np.concatenate([fit.z, fit.linear])
    names = list(found.by_name)
    draws = []
    for kick in random.standard_normal((4000, size)):
        draw = uncertainty.coefficients(fit, everything + root @ kick, rig)
        draws.append([draw[name] for name in names])
    np.testing.assert_allclose(np.std(draws, axis=0), [found.by_name[name].std for name in names], rtol=0.06)
    np.testing.assert_allclose(np.corrcoef(np.transpose(draws)), found.correlations, atol=0.06)


def test_units_are_the_declared_ones(rig):
    found = estimates(fit_of(rig), rig).by_name
    units = {name: estimate.unit for name, estimate in found.items()}
    assert units == {
        "coulomb_force": "N",
        "static_force": "N",
        "stribeck_velocity": "m/s",
        "stribeck_exponent": "1",
        "viscous_coefficient": "N s/m",
        "element_stiffness_1": "N/m",
        "element_stiffness_2": "N/m",
        "element_weight_1": "1",
        "element_weight_2": "1",
        "attraction_rate": "N/s",
        "spring_stiffness": "N/m",
        "gravity": "m/s^2",
    }


def test_what_was_not_searched_for_is_named_and_kept(rig):
    fit = fit_of(rig, free=STATIC)
    fit = fit._replace(z=fit.z + np.array([0.1] * 4 + [0.0] * (len(fit.z) - 4)))
    found = estimates(fit, rig)
    assert set(found.not_identifiable) == {"viscous_damping", "attraction_rate", "element_stiffness", "element_weight"}
    assert found.rig.friction.element_stiffness == rig.friction.element_stiffness
    assert found.rig.friction.element_weight == rig.friction.element_weight
    assert found.rig.friction.attraction_rate == rig.friction.attraction_rate
    assert found.rig.friction.coulomb_force == pytest.approx(np.exp(0.1) * rig.friction.coulomb_force)


def test_the_only_elements_weight_is_no_question_once_its_stiffness_is_known(rig):
    one = rig._replace(friction=rig.friction._replace(element_stiffness=(2e6,), element_weight=(1.0,)))
    assert "element_weight" not in estimates(fit_of(one), one).not_identifiable
    assert "element_weight" in estimates(fit_of(one, free=STATIC), one).not_identifiable


def test_a_vague_coefficient_is_no_number_but_a_sentence(rig):
    fit = fit_of(rig)
    fit.covariance[2, 2] = 0.3**2
    found = estimates(fit, rig)
    assert "stribeck_velocity" not in found.by_name
    assert "stribeck_velocity" in found.not_identifiable
    assert "stribeck_velocity has a standard error of 30 %." in found.remarks
    assert found.correlations.shape == (len(found.by_name),) * 2


def test_what_cannot_be_told_apart_is_said_unless_one_is_sharp(rig):
    fit = fit_of(rig)
    fit.covariance[2:4, 2:4] = 0.1**2 * np.array([[1.0, -0.9995], [-0.9995, 1.0]])
    found = estimates(fit, rig)
    assert {"stribeck_velocity", "stribeck_exponent"} <= set(found.not_identifiable)
    assert "stribeck_velocity and stribeck_exponent cannot be told apart (correlation -0.9995)." in found.remarks
    fit.covariance[2:4, 2:4] *= 0.01
    assert "stribeck_velocity" in estimates(fit, rig).by_name


def test_a_coefficient_at_the_limit_of_its_search_is_not_told(rig):
    found = estimates(fit_of(rig)._replace(limited=("attraction_rate", "static_rise")), rig)
    assert "attraction_rate ended at a limit of its search." in found.remarks
    assert "attraction_rate" not in found.by_name
    # Fs exceeds its rise.
    assert ("static_force" in found.by_name) == (
        rig.friction.static_force - rig.friction.coulomb_force < uncertainty.MAX_STD * rig.friction.static_force
    )


def test_a_viscous_coefficient_below_zero_is_reported_and_no_rigs(rig):
    found = estimates(fit_of(rig, linear={"viscous": 10.0, "constant": 700.0}), rig)
    assert found.by_name["viscous_coefficient"].value == pytest.approx(10.0 - rig.plant.viscous_damping)
    assert found.rig.friction.viscous_coefficient == 0.0


def test_a_constant_force_that_no_gravity_makes_stays_out_of_the_rig(rig):
    found = estimates(fit_of(rig, linear={"viscous": 7325.0, "constant": 1e5}), rig)
    assert found.by_name["gravity"].value == pytest.approx(1e5 / rig.plant.moving_mass)
    assert found.rig.plant.gravity == rig.plant.gravity


def test_any_model_has_its_coefficients_by_name(rig):
    fit = fit_of(rig, np.diag([0.01, 0.02, 7.0]) ** 2, ("level", "exponent"), {"viscous": 700.0})
    fit = fit._replace(coordinates=PowerCoordinates(), z=np.log([100.0, 0.5]))
    values = uncertainty.coefficients(fit, np.append(fit.z, 700.0), rig._replace(friction=PowerLaw(1.0, 1.0)))
    assert values == pytest.approx({"level": 100.0, "exponent": 0.5, "viscous_coefficient": 700.0 - rig.plant.viscous_damping})
