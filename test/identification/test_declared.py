"""The declared parameters of a friction model as coordinates, and any model run along a motion."""

from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
import pytest
from made_motions import motion

from ehls_ros.errors import BadInput
from ehls_ros.experiments.spec import load_rig
from ehls_ros.identification.balance import Recorded
from ehls_ros.identification.declared import DeclaredCoordinates, fit_declared
from ehls_ros.identification.friction_run import force_along
from ehls_ros.identification.joint import REACH
from ehls_ros.physics.friction import FRICTION_MODELS
from ehls_ros.physics.rig import Rig, rig_from_mapping, rig_to_mapping
from ehls_ros.schema import declarations, quantity, text

CONFIG = Path(__file__).parents[2] / "config"
MODELS = FRICTION_MODELS.names()


def rig_of(model: str) -> Rig:
    mapping = rig_to_mapping(load_rig(CONFIG / "rig_paper.yaml"))
    mapping["friction"]["model"] = model
    return rig_from_mapping(mapping, model)


class Odd(NamedTuple):
    """Parameters of every kind."""

    viscous_coefficient: Annotated[float, quantity("N s/m", "viscous", minimum=0.0)]
    level: Annotated[float, quantity("N", "level", above=0.0)]
    tilt: Annotated[float, quantity("1", "tilt", minimum=-0.5, maximum=0.5)]
    shape: Annotated[float, quantity("1", "shape", minimum=1.0, maximum=4.0)]
    stiffness: Annotated[tuple[float, ...], text("stiffness of each element", "N/m")]


ODD = Odd(50.0, 200.0, 0.0, 1.0, (1e6, 2e5))


@pytest.mark.parametrize("model", MODELS)
def test_coordinates_and_friction_are_each_others_inverse(model):
    friction = rig_of(model).friction
    coordinates = DeclaredCoordinates.of(model, friction)
    again = coordinates.unpack(coordinates.pack(friction))
    for name, value in friction._asdict().items():
        expected = 0.0 if name == "viscous_coefficient" else value
        np.testing.assert_allclose(getattr(again, name), expected, rtol=1e-12)


@pytest.mark.parametrize("model", MODELS)
def test_bounds_hold_the_start_and_stay_in_the_declared_ranges(model):
    friction = rig_of(model).friction
    coordinates = DeclaredCoordinates.of(model, friction)
    z = coordinates.pack(friction)
    low, high = coordinates.bounds(z, 0.01)
    assert np.all((low <= z) & (z <= high))
    assert np.all(high - low <= 2.0 * REACH * (1.0 + 1e-12))
    ranges = {d.name: (d.minimum, d.maximum) for d in declarations(type(friction))}
    for corner in (low, high):
        for name, value in coordinates.unpack(corner)._asdict().items():
            smallest, largest = ranges[name]
            for number in np.atleast_1d(value):
                assert smallest is None or number >= smallest
                assert largest is None or number <= largest * (1.0 + 1e-9)


def test_every_kind_of_parameter_has_its_coordinate():
    coordinates = DeclaredCoordinates.of("odd", ODD)
    assert coordinates.names == ("level", "tilt", "shape", "stiffness_1", "stiffness_2")
    z = coordinates.pack(ODD)
    np.testing.assert_allclose(z, [np.log(200.0), 0.0, 0.0, np.log(1e6), np.log(2e5)], atol=1e-12)
    low, high = coordinates.bounds(z, 0.01)
    np.testing.assert_allclose(coordinates.unpack(low)[2:4], [-0.5, 1.0])
    np.testing.assert_allclose(coordinates.unpack(high)[2:4], [0.5, 4.0])
    assert coordinates.unpack(z + np.log(2.0) * np.array([1.0, 0.0, 0.0, 0.0, 1.0])).stiffness == pytest.approx((1e6, 4e5))


def test_static_friction_stays_above_coulombs():
    model = next(name for name in MODELS if {"coulomb_force", "static_force"} <= set(rig_of(name).friction._fields))
    friction = rig_of(model).friction
    coordinates = DeclaredCoordinates.of(model, friction)
    random = np.random.default_rng(0)
    for z in coordinates.pack(friction) + random.normal(0.0, 3.0, (50, len(coordinates.names))):
        moved = coordinates.unpack(z)
        assert moved.static_force > moved.coulomb_force


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("speed", [0.02, -0.1])
def test_along_steady_sliding_the_force_is_the_level(model, speed):
    rig = rig_of(model)
    force = force_along(motion(np.full(1500, speed)), model, rig.friction)
    assert force[-1] == pytest.approx(np.sign(speed) * rig.friction_level(speed), rel=1e-4)


@pytest.mark.parametrize("model", MODELS)
def test_the_motion_turned_round_turns_the_force_round(model):
    friction = rig_of(model).friction
    velocity = 0.01 * np.sin(np.linspace(0.1, 30.0, 900))
    forwards, backwards = (force_along(motion(way * velocity), model, friction) for way in (1.0, -1.0))
    np.testing.assert_allclose(backwards, -forwards, rtol=1e-6, atol=1e-6 * np.abs(forwards).max())


@pytest.mark.parametrize("model", MODELS)
def test_a_gap_begins_with_the_contact_at_rest(model):
    velocity = np.tile(np.full(300, 0.01), 2)
    force = force_along(motion(velocity, fresh=np.arange(600) % 300 == 0), model, rig_of(model).friction)
    np.testing.assert_allclose(force[300:], force[:300], rtol=1e-9)


@pytest.mark.parametrize("model", MODELS)
def test_without_sliding_and_presliding_there_is_advice(model):
    rig = rig_of(model)
    made = motion(np.full(100, 0.1))
    with pytest.raises(BadInput, match=r"made: there is (no steady sliding|neither .* loop); expected strokes at constant"):
        fit_declared(Recorded((made,), (made.resolved,), ("viscous", "constant")), rig, rig.friction, None, lambda what: None)
