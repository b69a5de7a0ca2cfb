"""Effects in the closed loop of one kernel: those that depend on past commands, and the reading of the supply."""

from pathlib import Path

import numpy as np

from ehls_ros.experiments.loop import run_in_process, simulator_of
from ehls_ros.experiments.spec import load_spec, spec_from_mapping, spec_to_mapping
from ehls_ros.physics.rig import SENSED

ROOT = Path(__file__).resolve().parents[2]


def test_the_loop_and_the_simulator_stepped_from_outside_agree_to_the_bit():
    mapping = spec_to_mapping(load_spec(ROOT / "config" / "experiments" / "sine_fd2.yaml"))
    mapping["duration"] = 0.5
    mapping["effects"] = [
        {"name": "command_delay", "delay": 4.3e-4},
        {"name": "supply_pressure_droop", "resistance": 5e7, "time_constant": 0.02},
    ]
    spec = spec_from_mapping(mapping, "spec", ROOT)
    loop, simulator = run_in_process(spec), simulator_of(spec)
    rows = []
    for k in range(len(loop)):
        rows.append(simulator.measure(np.zeros(len(SENSED))).copy())
        disturbance = loop["disturbance_force_n"][k], loop["disturbance_force_rate_n_s"][k]
        simulator.advance(loop["valve_command_m"][k], *disturbance, 0.0, 0.0)
    stepped = dict(zip(SENSED, np.array(rows).T, strict=True))
    for signal, name in (("position", "position_m"), ("spool_position", "spool_m"), ("supply_pressure", "supply_pressure_pa")):
        np.testing.assert_array_equal(stepped[signal], loop[name])
    assert np.min(loop["supply_pressure_pa"]) < 6.99e6
