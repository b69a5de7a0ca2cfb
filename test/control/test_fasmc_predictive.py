"""The predictive law: the simulation study's largest disturbance, and the use of a force predicted by a companion."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ehls_ros.control import state_estimator
from ehls_ros.control.controller import Controller, Outlook
from ehls_ros.control.controllers.base import model_of
from ehls_ros.control.process_noise import MEAN_SQUARE
from ehls_ros.experiments.loop import run_in_process, sampled, simulator_of
from ehls_ros.experiments.metrics import evaluate
from ehls_ros.experiments.spec import Spec, company_of, spec_from_mapping
from ehls_ros.physics.rig import SENSED
from ehls_ros.recording.yaml_text import read_yaml

EXPERIMENTS = Path(__file__).parents[2] / "config" / "experiments"
PREVIEW = ["disturbance_preview"]


def spec_of(cell: str = "sine_fd2", **changes: Any) -> Spec:
    path = EXPERIMENTS / f"{cell}.yaml"
    content = {**read_yaml(path, "spec"), "controller": "fasmc_predictive", "duration": 4.0, **changes}
    return spec_from_mapping(content, str(path), path.parent)


class Stepped:
    """A run with a stepped controller: commands [m], and the content of its memory at the end."""

    def __init__(self, spec: Spec, known: slice = slice(None), row: np.ndarray | None = None) -> None:
        plant, random = simulator_of(spec), np.random.default_rng(spec.settings.seed)
        wanted, force = sampled(spec.reference, 1e-3), sampled(spec.disturbance.signal, 1e-3)
        actuator = np.full((spec.cycles, 3), np.nan)
        actuator[known] = force.rows(0, spec.cycles)[known]
        model = model_of(spec.controller_rig, 1e-3)
        company = company_of(spec, model, "test")
        self.controller = Controller(spec.controller.name, spec.controller.parameters, model, company)
        self.commands, self.errors = np.empty(spec.cycles), np.empty(spec.cycles)
        for k in range(spec.cycles):
            measured = plant.measure(random.standard_normal(len(SENSED)))
            self.errors[k] = plant.truth[SENSED.index("force")] - wanted.row(k)[0]
            self.commands[k] = self.controller.step(measured, wanted.row(k), np.zeros(2), outlook=Outlook(k, None, actuator[k]))
            plant.advance(self.commands[k], *force.row(k)[:2], 0.0, 0.0)

    def unforeseen_rate(self) -> float:
        """Return the rms rate of the unpredicted force, as assumed by the filter [N/s]."""
        return math.sqrt(self.controller._memory[state_estimator.MEMORY_SIZE + MEAN_SQUARE])

    def foreseen(self) -> np.ndarray:
        return state_estimator.state_of.py_func(self.controller._memory).expected


# A quarter of the paper's Table 3 [N].
@pytest.mark.parametrize(("cell", "most"), [("sine_fd2", 22.8), ("constant_fd2", 10.5)])
def test_the_error_is_a_quarter_of_table_3_without_any_preview(cell, most):
    assert evaluate(run_in_process(spec_of(cell))).max_error_n < most


def test_a_force_that_is_foreseen_leaves_the_filter_quiet_and_the_error_small():
    blind, seeing = Stepped(spec_of()), Stepped(spec_of(companions=PREVIEW))
    # The disturbance is 5 kN at 1 Hz.
    assert blind.unforeseen_rate() == pytest.approx(5e3 * 2.0 * math.pi / math.sqrt(2.0), rel=0.2)
    assert seeing.unforeseen_rate() < 0.05 * blind.unforeseen_rate()
    # The remainder is friction at reversals, which is not predicted.
    late = slice(len(blind.errors) // 2, None)
    assert np.median(np.abs(seeing.errors[late])) < np.median(np.abs(blind.errors[late]))
    assert np.max(np.abs(seeing.errors[late])) < 1.2 * np.max(np.abs(blind.errors[late]))


@pytest.mark.parametrize("companions", [[], PREVIEW])
def test_a_controller_that_is_stepped_and_the_loop_in_one_process_come_to_the_same(companions):
    spec = spec_of(companions=companions, duration=1.0)
    run = run_in_process(spec)["valve_command_m"]
    assert np.max(np.abs(Stepped(spec).commands - run)) <= 1e-9 * np.max(np.abs(run))


def test_a_preview_that_comes_late_or_ends_is_used_while_it_is_there():
    spec = spec_of(companions=PREVIEW, duration=2.0)
    some = Stepped(spec, slice(700, 1300))
    assert np.isfinite(some.commands).all()
    assert some.foreseen()[3] == 0.0
    never = Stepped(spec, slice(0))
    assert np.array_equal(some.commands[:700], never.commands[:700])
    # Neither end has a step.
    assert np.max(np.abs(some.errors[700:])) < 2.0 * np.max(np.abs(never.errors[700:])) + 1.0


def test_rows_without_preview_and_without_companions_are_the_same():
    blind, never = Stepped(spec_of(duration=0.5)), Stepped(spec_of(companions=PREVIEW, duration=0.5), slice(0))
    assert np.array_equal(blind.commands, never.commands)
