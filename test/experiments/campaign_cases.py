"""Small campaigns for tests."""

import json
from pathlib import Path

import yaml

CONFIG = Path(__file__).parents[2] / "config"
BASE = {
    "rig": str(CONFIG / "rig_paper.yaml"),
    "duration": 0.2,
    "reference": {"name": "sine", "amplitude": 1e4, "frequency": 0.5},
    "controller": {"name": "fasmc"},
}
DRAWS = {
    "rig.plant.moving_mass": {"uniform": [0.9, 1.1], "relative": True},
    "rig.friction.static_force": {"normal": [900.0, 20.0]},
}


def write(folder, **content):
    """Write a campaign file and return its path."""
    path = folder / "campaign.yaml"
    path.write_text(yaml.safe_dump({"base": BASE, **content}))
    return path


def specs(plan):
    """Return the runs' specs, parsed."""
    return [json.loads(run.spec) for run in plan.runs()]
