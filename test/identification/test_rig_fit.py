"""The derivatives of a rig's fit against central differences, and its error by the rounding of the motion."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from ehls_ros.diagnosis import stages
from ehls_ros.diagnosis.evidence import gather
from ehls_ros.diagnosis.record import prepare
from ehls_ros.duals import Dual
from ehls_ros.identification.rig_coefficients import (
    BIASES,
    DEAD_ZONE,
    DELAY,
    DROOP,
    HYSTERESIS,
    SECOND_ORDER,
    coefficients,
    model_at,
    placed,
    uses,
)
from ehls_ros.identification.rig_fit import Stack, fit
from ehls_ros.identification.rig_noise import rounding
from ehls_ros.identification.rig_stages import BANDWIDTH, OF_BALANCE, sizes
from ehls_ros.physics.rig import rig_from_mapping
from ehls_ros.trajectory import Trajectory
from truth_generator import record

RIG_FILE = Path(__file__).parents[2] / "config" / "rig_paper_measured.yaml"
USED = {
    DELAY: 3.3e-3,
    **dict(zip(HYSTERESIS, (2.113e-6, 0.31), strict=True)),
    **dict(zip(DROOP, (7.1e8, 0.037), strict=True)),
    **dict(zip(DEAD_ZONE, (1.0437e-5, 1.3571e-5), strict=True)),
    **dict(zip(BIASES, (1.0123e-6, 2.317e-6, 20.0), strict=True)),
}
SECOND = dict(zip(SECOND_ORDER, (431.0, 0.83), strict=True))
"""Effects in the rig, with a valve of first or of second order.

Their values avoid those of the recorded spool, where the flow has corners.
"""

STEPS = (1e-2, 1e-3, 1e-4, 1e-5, 1e-7)
"""Difference steps: long ones for small effects, as events are located to 1e-9 of a step; short ones near corners."""


@pytest.fixture(scope="module")
def recording():
    rig = yaml.safe_load(RIG_FILE.read_text(encoding="utf-8"))
    made = record(rig, {"command_delay": {"delay": 3.3e-3}}, "rich", seed=3, duration=5.0)
    return rig, Trajectory(made.time, made.columns)


def test_an_effect_without_a_size_has_no_shape_either():
    rig = rig_from_mapping(yaml.safe_load(RIG_FILE.read_text(encoding="utf-8")), "rig")
    wide = placed(rig, dict(zip(HYSTERESIS, (2e-6, 1.0), strict=True)))
    assert [use.name for use in wide.effects] == ["valve_hysteresis"]
    assert placed(wide, {HYSTERESIS[0]: 0.0}).effects == ()
    second = placed(rig, {SECOND_ORDER[0]: 300.0})
    assert [use.name for use in second.effects] == ["valve_second_order"]
    assert placed(second, {SECOND_ORDER[0]: 0.0}).effects == ()


@pytest.mark.long
@pytest.mark.parametrize(("missing", "order"), [("", {}), ("spool_m", SECOND)], ids=["first order", "second order, no spool"])
def test_the_derivatives_are_those_of_central_differences(recording, missing, order):
    given, trajectory = recording
    rig = placed(rig_from_mapping(given, "rig"), USED | order)
    left = {name: values for name, values in trajectory.signals.items() if name != missing}
    read = prepare(Trajectory(trajectory.time_s, left), rig, "case")
    stack = Stack([gather(read, rig, stages.setup(read, rig), seed=0)])
    # Without a spool, the flow differs: its spool varies too.
    for channel in ("volume", "supply") if missing else stack.channels:
        chosen = [
            c
            for c in coefficients(rig, sizes([read], rig))
            if c.path.startswith("sensors") == (channel in ("cell", "velocity"))
            and uses(rig, c.path)
            and not (order and c.path == BANDWIDTH)
        ]
        z, rows = np.array([c.coordinate(rig) for c in chosen]), stack.rows([channel])
        duals = [Dual(x, {i: 1.0}) for i, x in enumerate(z.tolist())]
        exact = stack.slopes(model_at(rig, chosen, duals), [channel], len(chosen))
        assert np.any(exact)
        base = stack.residuals(rig)

        def at(i, moved, z=z, chosen=chosen, rows=rows, base=base):
            values = z.copy()
            values[i] += moved
            return stack.joined(stack.residuals(model_at(rig, chosen, values.tolist()), base))[rows]

        for i, c in enumerate(chosen):
            size, errors = float(np.linalg.norm(exact[:, i])), []
            for h in STEPS:
                difference = (8.0 * (at(i, h) - at(i, -h)) - (at(i, 2.0 * h) - at(i, -2.0 * h))) / (12.0 * h)
                errors.append(float(np.linalg.norm(difference - exact[:, i])))
            assert min(errors) <= 1e-6 * size, (channel, c.path)


def test_a_lag_and_a_delay_of_the_load_cell_keep_the_derivatives(recording):
    given, trajectory = recording
    cell = {**given["sensors"]["force"], "delay": 1.3e-3, "bandwidth": 600.0}
    rig = rig_from_mapping({**given, "sensors": {**given["sensors"], "force": cell}}, "rig")
    read = prepare(trajectory, rig, "case")
    stack = Stack([gather(read, rig, stages.setup(read, rig), seed=0)])
    chosen = [c for c in coefficients(rig, sizes([read], rig)) if c.path.startswith("sensors.force")]
    z, rows, base = np.array([c.coordinate(rig) for c in chosen]), stack.rows(["cell"]), stack.residuals(rig)
    duals = [Dual(x, {i: 1.0}) for i, x in enumerate(z.tolist())]
    exact = stack.slopes(model_at(rig, chosen, duals), ["cell"], len(chosen))
    for i in range(len(chosen)):
        steps = np.eye(len(chosen))[i] * 1e-3
        ends = [stack.joined(stack.residuals(model_at(rig, chosen, (z + s).tolist()), base))[rows] for s in (steps, -steps)]
        np.testing.assert_allclose((ends[0] - ends[1]) / 2e-3, exact[:, i], atol=1e-5 * np.max(np.abs(exact[:, i])))


def test_the_rounding_of_the_motion_is_the_change_by_a_wider_fit(recording):
    given, trajectory = recording
    left = {name: values for name, values in trajectory.signals.items() if name != "velocity_m_s"}
    rig = rig_from_mapping(given, "rig")
    read = prepare(Trajectory(trajectory.time_s, left), rig, "case")
    setup = stages.setup(read, rig)
    evidence = gather(read, rig, setup, seed=0)
    stack, wider = (Stack([replace(evidence, setup=s)]).only(OF_BALANCE) for s in (setup, setup.with_wider_fit()))
    paths = ("plant.moving_mass", "friction.coulomb_force", "friction.element_stiffness")
    chosen = [c for c in coefficients(rig, sizes([read], rig)) if c.path in paths]
    now, moved = (fit(s, rig, chosen, OF_BALANCE) for s in (stack, wider))
    found = rounding(stack, now)
    assert [found[c.path] for c in chosen] == pytest.approx(np.abs(moved.z - now.z), rel=0.3, abs=1e-4)
    assert found["friction.element_stiffness"] > 10.0 * found["plant.moving_mass"]
