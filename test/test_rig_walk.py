"""The walk of docs/how_to/rig.md on an emulated rig that differs from its file, with a wrong sign in the wiring."""

import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest
import yaml
from terminal import dialogue

from ehls_ros.cli.main import main
from ehls_ros.experiments.files import config_folder
from ehls_ros.experiments.spec import load_rig
from ehls_ros.experiments.yaml_files import rig_text
from ehls_ros.hardware.backends.udp import bound_socket
from ehls_ros.physics.rig import rig_to_mapping

EHLS = [sys.executable, "-m", "ehls_ros.cli.main"]

ANSWERS = """
bore: 40 mm
rod: 25 mm
rods: two
stroke: 120 mm
supply_pressure: 140 bar
rated_flow: 19 l/min
rated_drop: 70 bar
bandwidth: 90 Hz
bandwidth_at: -90 deg
moving_mass: 40 kg
position_noise: 0.4
pressure_noise: 2
force_noise: 2
"""

TRUE = {"bulk_modulus": 0.85, "discharge_coefficient": 1.15, "moving_mass": 1.2, "valve_bandwidth": 0.9}
"""True coefficients of the plant over the file's."""

STILL = {"name": "constant", "value": 0.0}

STIFFNESS = 1.2e6
"""Stiffness of the coupling, which the file does not tell [N/m]."""

PROGRAMME = """
title: walk
blocks:
  - {block: cycles, amplitude: 1500.0, mean: 500.0, frequency: 1.0, count: 3}
"""


def written(path: Path, content: object) -> Path:
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    return path


@contextmanager
def emulator(spec: Path, bridge: Path) -> Iterator[None]:
    """Run the emulated rig, which waits for each command."""
    command = [*EHLS, "rig-emulator", "--spec", str(spec), "--bridge", str(bridge), "--lockstep", "--patience", "600"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        assert "listening" in process.stdout.readline()
        yield
    finally:
        process.terminate()
        process.communicate()


def bridge_of(rig: Path, port: int) -> dict[str, object]:
    """Return a bridge file with converters that suit a rig."""
    bridge = yaml.safe_load((config_folder() / "bridge_udp.yaml").read_text(encoding="utf-8"))
    bridge["backend"]["port"] = port
    limits, plant = load_rig(rig).limits, load_rig(rig).plant
    spans = {
        "position": limits.position[1] - limits.position[0], "load_pressure": limits.load_pressure,
        "spool_position": limits.spool, "force": limits.force, "supply_pressure": plant.supply_pressure,
    }  # fmt: skip
    channels = {signal: {**bridge["channels"][signal], "scale": 0.13 * span} for signal, span in spans.items()}
    command = {**bridge["command"], "scale": limits.spool / 5.0}
    return {**bridge, "channels": channels, "command": command}


@pytest.mark.long
def test_the_walk_from_data_sheet_to_programme(tmp_path):
    (tmp_path / "answers.yaml").write_text(ANSWERS, encoding="utf-8")
    rig, folder = tmp_path / "rig.yaml", tmp_path / "commission"
    assert main(["new-rig", "--out", str(rig), "--from", str(tmp_path / "answers.yaml")]) == 0
    file = load_rig(rig)
    true = file.with_plant(**{name: factor * getattr(file.plant, name) for name, factor in TRUE.items()})
    true = true.with_friction(coulomb_force=1.2 * file.friction.coulomb_force, static_force=1.2 * file.friction.static_force)
    (tmp_path / "true.yaml").write_text(rig_text(rig_to_mapping(true._replace(effects=()))), encoding="utf-8")
    with closing(bound_socket("127.0.0.1", 0)) as unused:
        port = unused.getsockname()[1]
    right = bridge_of(rig, port)
    bridge = written(tmp_path / "bridge.yaml", right)
    channels = {**right["channels"], "load_pressure": {**right["channels"]["load_pressure"]}}
    channels["load_pressure"]["scale"] *= -1.0
    wrong = written(tmp_path / "wrong.yaml", {**right, "channels": channels})
    spec = {"rig": "true.yaml", "reference": STILL, "controller": "fasmc", "duration": 1000.0}
    free = written(tmp_path / "free.yaml", spec)
    held = {"name": "position_servo", "stiffness": STIFFNESS, "damping": 1e-3 * STIFFNESS, "signal": {**STILL}}
    connected = written(tmp_path / "connected.yaml", {**spec, "disturbance": held})

    def commission(bridge: Path, *answers: str) -> tuple[int, str]:
        command = [*EHLS, "commission", str(rig), "--bridge", str(bridge), "--lockstep", "--out", str(folder)]
        return dialogue([*command, "--margins", "2", "15"], answers)

    with emulator(free, bridge):
        code, shown = commission(wrong, "\n", "\n")
        assert code == 2, shown
        assert "channels.load_pressure.scale with the other sign" in shown
    with emulator(free, bridge):
        code, shown = commission(bridge, "\n", "\n", "q\n")
        assert code == 1, shown
        assert "goes on after: Sensors at rest" in shown
    with emulator(connected, bridge):
        code, shown = commission(bridge, "\n", "\n", "\n")
        assert code == 0, shown
    found = load_rig(folder / "rig.yaml")
    assert found.plant.discharge_coefficient == pytest.approx(true.plant.discharge_coefficient, rel=0.01)
    assert found.plant.moving_mass == pytest.approx(true.plant.moving_mass, rel=0.02)
    assert found.friction.coulomb_force == pytest.approx(true.friction.coulomb_force, rel=0.05)
    assert found.plant.bulk_modulus == pytest.approx(true.plant.bulk_modulus, rel=0.1)
    effects = {use.name: use.parameters for use in found.effects}
    assert effects["command_delay"].delay == pytest.approx(1e-3, rel=0.05)
    assert effects["coupling_stiffness"].stiffness == pytest.approx(STIFFNESS, rel=0.2)
    assert found.standard_errors["plant.moving_mass"] > 0.0
    log = json.loads((folder / "commission.json").read_text(encoding="utf-8"))
    assert len(log["first_run"]["sentences"]) >= 3
    run = [*EHLS, "experiment", str(folder / "experiment.yaml"), "--in-process", "--out", str(tmp_path / "run")]
    assert subprocess.run(run, check=False).returncode == 0
    (tmp_path / "programme.yaml").write_text(PROGRAMME, encoding="utf-8")
    assert main(["programme", str(tmp_path / "programme.yaml")]) == 0
