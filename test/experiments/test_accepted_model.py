"""The rig that an operator has accepted: within adaptation's distance of the controller's rig file, or not used."""

from pathlib import Path

import pytest

from ehls_ros.control.controllers.base import model_of
from ehls_ros.errors import BadInput
from ehls_ros.experiments.accepted_rig import LONGEST, accepted_model, write_accepted
from ehls_ros.experiments.spec import load_rig
from ehls_ros.experiments.state_files.access import NotWritten
from ehls_ros.experiments.yaml_files import rig_text
from ehls_ros.physics.rig import EffectUse, Rig, effects_from_list, rig_to_mapping

OWN = load_rig(Path(__file__).resolve().parents[2] / "config" / "rig_paper.yaml")
PERIOD = 1e-3


def accepted(rig: Rig):
    return accepted_model(rig_text(rig_to_mapping(rig)), OWN, PERIOD, "accepted_rig")


def scaled(section: str, name: str, factor: float) -> Rig:
    part = getattr(OWN, section)
    return OWN._replace(**{section: part._replace(**{name: factor * getattr(part, name)})})


def effects(*found: dict) -> tuple[EffectUse, ...]:
    return effects_from_list(list(found), "test")


NUMBERS = [("plant", name) for name in ("piston_area", "bulk_modulus", "valve_gain", "supply_pressure", "moving_mass")]
NUMBERS += [("friction", "attraction_rate"), ("friction", "stribeck_velocity")]


@pytest.mark.parametrize(("section", "name"), NUMBERS)
def test_each_coefficient_moves_as_far_as_adaptation_may(section, name):
    moved = accepted(scaled(section, name, 1.29))
    assert getattr(getattr(moved, section), name) == pytest.approx(1.29 * getattr(getattr(OWN, section), name))
    for factor in (1.31, 10.0, 0.1):
        with pytest.raises(BadInput, match=f"{name} is .* the rig file's is .*: it may move by 30%"):
            accepted(scaled(section, name, factor))


def test_what_was_found_is_in_the_model():
    """A monitor names a leakage as an effect; a controller has coefficients."""
    leaky = OWN.with_effects(
        effects({"name": "internal_leakage_shift", "added": 2e-12}, {"name": "command_delay", "delay": 1e-3})
    )
    model = accepted(leaky)
    assert model.plant.leakage_coefficient == pytest.approx(OWN.plant.leakage_coefficient + 2e-12)
    assert model.command_delay == 1e-3
    # Beyond a third of the valve's flow, at the supply pressure, leakages are refused.
    with pytest.raises(BadInput, match="leakage_coefficient is"):
        accepted(OWN.with_effects(effects({"name": "internal_leakage_shift", "added": 1e-9})))
    with pytest.raises(BadInput, match="command_delay is"):
        accepted(OWN.with_effects(effects({"name": "command_delay", "delay": 5e-3})))


def test_the_rig_file_itself_changes_nothing():
    assert accepted(OWN) == model_of(OWN, PERIOD)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("plant: 3", "'friction' is missing"),
        ("[" * 1000, "nested"),
        ("x" * (LONGEST + 1), f"at most {LONGEST}"),
        (rig_text(rig_to_mapping(OWN._replace(limits=OWN.limits._replace(spool=2e-2)))), "it has other limits"),
        (
            rig_text(rig_to_mapping(OWN)).replace("model: gms", "model: stribeck"),
            "it has another friction model",
        ),
    ],
)
def test_what_is_no_such_rig_is_refused(text, said):
    with pytest.raises(BadInput, match=said):
        accepted_model(text, OWN, PERIOD, "accepted_rig")


def test_the_file_replaces_its_like_alone(tmp_path: Path):
    path = tmp_path / "rig_accepted.yaml"
    for rig in (OWN, scaled("plant", "moving_mass", 1.1)):
        write_accepted(path, rig_text(rig_to_mapping(rig)))
        assert load_rig(path) == rig
    path.write_text("mine", encoding="utf-8")
    with pytest.raises(NotWritten, match="is not replaced"):
        write_accepted(path, "")
    assert path.read_text(encoding="utf-8") == "mine"
