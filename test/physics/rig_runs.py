"""Running the simulator through given inputs."""

from pathlib import Path

import numpy as np
from reference_solver import Floats

from ehls_ros.physics.simulator import Simulator

PAPER_RIG = Path(__file__).resolve().parents[2] / "config" / "rig_paper.yaml"
PERIOD = 1e-3


def run(simulator: Simulator, inputs: Floats) -> Floats:
    """Run the commands and disturbances of each cycle; return the states from the start on, shape (cycles + 1, states)."""
    states = [simulator.y.copy()]
    for u, force, rate in inputs.tolist():
        assert simulator.advance(u, force, rate, 0.0, 0.0) == 0
        states.append(simulator.y.copy())
    return np.array(states)
