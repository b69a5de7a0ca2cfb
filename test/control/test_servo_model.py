"""The position servo predicted by its model against the simulated one, and the law's reaction to a wrong model."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.preview import with_preview
from ehls_ros.control.companion_chain import CompanionChain
from ehls_ros.control.companions.base import Past, Upcoming
from ehls_ros.control.controllers.base import FORESEEN, ROW, Model
from ehls_ros.control.disturbances.base import DISPLACEMENT, VELOCITY
from ehls_ros.errors import BadInput
from ehls_ros.experiments.loop import ClosedLoop, sampled
from ehls_ros.experiments.spec import Spec, spec_from_mapping
from ehls_ros.experiments.stepped_run import stepped_run
from ehls_ros.recording.yaml_text import read_yaml

EXPERIMENTS = Path(__file__).parents[2] / "config" / "experiments"
PREVIEW = {"name": "disturbance_preview"}
STIFFNESS, DAMPING = 2e6, 2e3
"""Stiffness and damping of the beam [N/m, N s/m], the defaults of the position servo."""

FORESEEN_WITHIN = {"measured_sine_fd1": 1.0, "measured_constant_fd2": 8.0}
"""Largest error of the predicted force, of 70 and 180 kN rms [N]. If the pistons exchanged their motion only once a cycle, it
would be 2.1 and 12.7 N."""


class Witness:
    """Records the rows as the preceding companions left them."""

    def __init__(self) -> None:
        self.rows: list[np.ndarray] = []

    def room(self, first: int, place: np.ndarray) -> int:
        return len(place)

    def ahead(self, upcoming: Upcoming) -> None:
        self.rows.append(upcoming.rows.copy())

    def done(self, past: Past, model: Model) -> Model:
        return model

    def save(self) -> None:
        pass


def lasting(spec: Spec, duration: float) -> Spec:
    return spec._replace(settings=spec.settings._replace(duration=duration))


def foreseen_and_true(spec: Spec) -> tuple[np.ndarray, np.ndarray]:
    """Return the rows' predicted force with its derivatives, and the true force of the servo's motion [N]."""
    loop, witness = ClosedLoop(spec), Witness()
    loop.company = CompanionChain({**loop.company.members, "witness": witness})
    moved = np.concatenate([block.disturbance for block in loop.blocks()])
    return np.concatenate(witness.rows)[:, FORESEEN:], -(STIFFNESS * moved[:, DISPLACEMENT] + DAMPING * moved[:, VELOCITY])


@pytest.mark.parametrize("name", FORESEEN_WITHIN)
def test_the_force_foreseen_is_the_one_that_comes(name):
    foreseen, true = foreseen_and_true(lasting(with_preview(name, [PREVIEW]), 3.0))
    late = slice(1000, -2)
    assert np.max(np.abs(foreseen[late, 0] - true[late])) < FORESEEN_WITHIN[name]
    # The command acts one cycle late, for a cycle: the parabola passes through the force at that time.
    after = 2e-3
    then = foreseen[late] @ np.array([1.0, after, 0.5 * after**2])
    assert np.max(np.abs(then - true[1002:])) < FORESEEN_WITHIN[name]
    # Held, that force would be far off.
    assert np.max(np.abs(true[1002:] - true[late])) > 100.0 * np.max(np.abs(then - true[1002:]))


def test_the_law_follows_better_with_a_preview_and_no_worse_with_one_that_is_wrong():
    def largest(*companions: dict[str, Any]) -> float:
        return stepped_run(lasting(with_preview("measured_constant_fd2", list(companions)), 3.0)).largest()

    without, right = largest(), largest(PREVIEW)
    assert right < 0.5 * without
    for factor in (0.8, 1.2):
        assert largest({**PREVIEW, "position_gain": factor * 30.0}) < 1.1 * without


def test_a_preview_that_nobody_can_use_is_refused():
    path = EXPERIMENTS / "measured_constant_fd2.yaml"
    content = {**read_yaml(path, "spec"), "companions": ["disturbance_preview"]}

    def refused(**changes: Any) -> BadInput:
        with pytest.raises(BadInput) as caught:
            ClosedLoop(spec_from_mapping({**content, **changes}, "spec.yaml", path.parent))
        return caught.value

    assert "does not use what is foreseen" in refused(controller="fasmc").what
    assert "coupling_stiffness under known_effects" in refused(controller="fasmc_predictive").expected
    assert "follows a position" in refused(controller="pid", reference={"name": "constant", "value": 0.0}).what


def preview_of(spec: Spec) -> Any:
    return ClosedLoop(spec).company.members["disturbance_preview"]


def upcoming(first: int, command: np.ndarray) -> Upcoming:
    rows = np.full((len(command), ROW), np.nan)
    rows[:, :3] = 0.0
    return Upcoming(first, rows, np.full((len(command), 2), np.nan), command)


def test_where_the_command_was_not_known_it_is_believed_again_once_it_has_settled():
    command = np.zeros((600, 3))
    command[:, 0], command[10:20] = 0.01, np.nan
    cycles = upcoming(0, command)
    preview_of(with_preview("measured_constant_fd2", [PREVIEW])).ahead(cycles)
    known = np.isfinite(cycles.rows[:, FORESEEN:]).all(axis=1)
    # 10 time constants of 1/30 s.
    assert np.flatnonzero(np.diff(known)).tolist() == [9, 20 + 333]
    # At rest the far end pulls only through the spring.
    assert cycles.rows[-1, FORESEEN] == pytest.approx(-STIFFNESS * 0.01, rel=5e-3)


@pytest.mark.parametrize("missed", [1, 5])
def test_cycles_left_out_change_next_to_nothing(missed):
    spec = with_preview("measured_constant_fd2", [PREVIEW])
    command = sampled(spec.disturbance.signal, 1e-3).rows(0, 2000)
    whole, first, second = (
        upcoming(k, part) for k, part in ((0, command), (0, command[:1500]), (1500 + missed, command[1500 + missed :]))
    )
    preview_of(spec).ahead(whole)
    preview = preview_of(spec)
    preview.ahead(first)
    preview.ahead(second)
    off = np.max(np.abs(second.rows[:, FORESEEN] - whole.rows[1500 + missed :, FORESEEN]))
    # Of 250 kN.
    assert off < 5.0
