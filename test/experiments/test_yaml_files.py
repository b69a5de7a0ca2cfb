"""Files written by the tool round-trip, with the unit behind each value."""

from pathlib import Path

import pytest

from ehls_ros.experiments.spec import load_rig, load_spec, spec_from_mapping, spec_to_mapping
from ehls_ros.experiments.yaml_files import rig_text, spec_text
from ehls_ros.physics.rig import rig_from_mapping, rig_to_mapping
from ehls_ros.recording.yaml_text import parse_yaml

CONFIG = Path(__file__).parents[2] / "config"


@pytest.mark.parametrize("path", sorted(CONFIG.glob("experiments/*.yaml")), ids=lambda path: path.stem)
def test_a_spec_survives_writing_with_its_units(path):
    spec = load_spec(path)
    text = spec_text(spec_to_mapping(spec))
    assert spec_from_mapping(parse_yaml(text, path.name, "spec"), path.name, path.parent) == spec
    for line in ("control_period: 0.001 ", "    supply_pressure: 7000000.0 ", "    position: [-0.3, 0.3] "):
        [written, *_] = [one for one in text.splitlines() if one.startswith(line)]
        assert written.split("# ")[1] == {"c": "s", "s": "Pa", "p": "m"}[line.strip()[0]]


def test_a_rig_with_effects_and_sensors_survives_writing_with_its_units():
    content = rig_to_mapping(load_rig(CONFIG / "rig_paper_measured.yaml"))
    content["effects"] = [{"name": "valve_dead_zone", "positive": 1e-5}, {"name": "command_delay", "delay": 5e-7}]
    rig = rig_from_mapping(content, "rig.yaml")
    text = rig_text(rig_to_mapping(rig), {"plant": {"moving_mass": "given: 70 kg"}})
    assert rig_from_mapping(parse_yaml(text, "rig.yaml", "rig file"), "rig.yaml") == rig
    assert [line.split("#")[1].strip() for line in text.splitlines() if "moving_mass" in line] == ["kg; given: 70 kg"]
    assert [line.split("#")[1].strip() for line in text.splitlines() if line.strip().startswith(("positive", "delay: 5"))] == [
        "m",
        "s",
    ]
