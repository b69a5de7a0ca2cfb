"""Learning does not make the force error larger: forces out of step with the load cycle, and random disturbances."""

import math
from typing import Any

import numpy as np
import pytest

from benchmarks.learning_harm import CONFIG, FIRST, Case, simulate
from ehls_ros.control.companions.learning import Parameters
from ehls_ros.control.learning.force_prediction import MAX_CHANGE
from ehls_ros.experiments.spec import Use, spec_from_mapping

PERIOD, CYCLES = 4.0, 8


def pulled(size: float, frequency: float) -> Case:
    """Return a case with a constant reference and a sinusoidal force."""
    data: dict[str, Any] = {
        "rig": "rig_paper_measured.yaml",
        "effects": [{"name": "command_delay", "delay": 1e-3}],
        "known_effects": ["command_delay"],
        "reference": "constant",
        "controller": {"name": "fasmc_predictive"},
    }
    steps = round(CYCLES * PERIOD / 1e-3)
    t, omega = np.arange(steps) * 1e-3, 2.0 * math.pi * frequency
    disturbance, wanted = np.zeros((steps, 4)), np.zeros((steps, 3))
    disturbance[:, 0], disturbance[:, 1] = size * np.sin(omega * t), size * omega * np.cos(omega * t)
    wanted[:, 0] = 5e3
    spec = spec_from_mapping(data, "pulled", CONFIG)
    return Case(
        "out_of_step", f"{size:g} N at {frequency:g} Hz", spec, round(PERIOD / 1e-3), wanted, disturbance, (), "waveform"
    )


@pytest.mark.long
@pytest.mark.parametrize(("size", "frequency"), [(500.0, 1.37), (130.0, 1.3), (430.0, 0.7), (350.0, 5.1)])
def test_a_force_out_of_step_is_recognised_and_hardly_costs_anything(size: float, frequency: float):
    """It once added up to 860 N in every other load cycle."""
    case = pulled(size, frequency)
    bare = simulate(case, (), 0)
    learnt = simulate(case, (Use("learning", Parameters(period=PERIOD)),), 0)
    rms = [np.sqrt(np.mean(run.error[FIRST:] ** 2, axis=1)) for run in (learnt, bare)]
    assert np.all(rms[0] < 1.2 * rms[1])
    assert np.abs(learnt.error[FIRST:]).max() < 1.2 * np.abs(bare.error[FIRST:]).max()
    assert "not in step with the load cycle" in str(learnt.report["learning.state"])
    assert float(learnt.report["learning.force_change"]) > MAX_CHANGE
