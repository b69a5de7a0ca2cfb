"""The safety gate with the simulated rig: the paper's experiments pass unchanged, and stops are gentle."""

import functools
from pathlib import Path

import numpy as np
import pytest
from tiers import tiered

from ehls_ros.control.controller import Controller
from ehls_ros.control.controllers.base import model_of
from ehls_ros.control.friction_estimator import FrictionEstimator
from ehls_ros.experiments.loop import run_in_process, sampled, simulator_of
from ehls_ros.experiments.spec import load_rig, load_spec
from ehls_ros.hardware.gate_parameters import SIMULATED, Parameters
from ehls_ros.hardware.safety_gate import Gate
from ehls_ros.physics.rig import SENSED
from ehls_ros.physics.sensors import FORCE, POSITION, VELOCITY
from ehls_ros.recording.topics import LOADER_STATE

CONFIG = Path(__file__).parents[2] / "config"
PERIOD = 1e-3
EXPERIMENTS = sorted(path.stem for path in (CONFIG / "experiments").glob("*.yaml") if "sweep" not in path.stem)
LEAVES_THE_STROKE = {"constant_fd2", "constant_fd2_sic"}
WITHIN_THE_STROKE = set(EXPERIMENTS) - LEAVES_THE_STROKE
QUICK = {"sine_fd2", "constant_fd2", "measured_sine_fd1", "servo_sine"}


@functools.cache
def recorded(experiment):
    """Return the rig, and an experiment's recording on it."""
    rig = load_rig(CONFIG / "rig_paper_measured.yaml")
    spec = load_spec(CONFIG / "experiments" / f"{experiment}.yaml")
    measured, believed = (rig.with_effects(of.effects) for of in (spec.rig, spec.controller_rig))
    return rig, run_in_process(spec._replace(rig=measured, controller_rig=believed))


def through_the_gate(experiment, parameters):
    """Return an experiment's commands before and after the gate, and the gate."""
    rig, run = recorded(experiment)
    readings = np.stack([run[name] for name in LOADER_STATE.signals.values()], axis=1).tolist()
    reference = run["force_reference_n"].tolist() if "force_reference_n" in run.signals else [np.nan] * len(readings)
    commands = run["valve_command_m"].tolist()
    gate = Gate(rig, PERIOD, parameters, bounds={})
    gate.begin()
    written = []
    for k, command in enumerate(commands):
        gate.sense(k, readings[k], reference[k])
        assert gate.take(k, command, "controller") or gate.causes
        if k == 0:
            assert gate.enable() is None
        written.append(gate.step(k * PERIOD))
    return commands, written, gate


@pytest.mark.parametrize("experiment", tiered(EXPERIMENTS, *QUICK))
def test_every_experiment_passes_bit_for_bit_on_the_simulated_rig(experiment):
    commands, written, gate = through_the_gate(experiment, Parameters(**SIMULATED))
    assert written == commands
    assert {d.name for d in gate.detectors.values() if d.count} == set()


@pytest.mark.parametrize("experiment", tiered(sorted(WITHIN_THE_STROKE), *QUICK - LEAVES_THE_STROKE))
def test_the_defaults_of_a_real_rig_pass_experiments_within_the_stroke(experiment):
    commands, written, gate = through_the_gate(experiment, Parameters(enable_time=0.0))
    assert written == commands
    assert gate.causes == []


@pytest.mark.parametrize("experiment", sorted(LEAVES_THE_STROKE))
def test_the_defaults_of_a_real_rig_stop_experiments_that_leave_the_stroke(experiment):
    _, written, gate = through_the_gate(experiment, Parameters(enable_time=0.0))
    assert [cause.detector for cause in gate.causes][:1] == ["position"]
    assert written[-1] == 0.0


class Loop:
    """The paper's 10 kN sine against its large disturbance, stepped with the gate in the loop."""

    def __init__(self, parameters):
        spec = load_spec(CONFIG / "experiments" / "sine_fd2.yaml")
        self.simulator = simulator_of(spec)
        self.controller = Controller(spec.controller.name, spec.controller.parameters, model_of(spec.controller_rig, PERIOD))
        self.friction = FrictionEstimator("gms", spec.controller_rig, PERIOD)
        self.reference = sampled(spec.reference, PERIOD).rows(0, spec.cycles)
        self.disturbance = sampled(spec.disturbance.signal, PERIOD).rows(0, spec.cycles)
        self.gate = Gate(spec.rig, PERIOD, parameters, bounds={})
        self.gate.begin()
        self.cycle = 0
        self.written = []

    def run(self, cycles, controller=True):
        """Run some cycles; return readings of shape (cycles, signals)."""
        readings = np.empty((cycles, len(SENSED)))
        for row in readings:
            k = self.cycle
            row[:] = self.simulator.measure(np.zeros(len(SENSED)))
            self.gate.sense(k, row.tolist(), self.reference[k][0])
            if controller:
                estimate = self.friction.update(row[VELOCITY])[:2]
                command = self.controller.step(row, self.reference[k], np.asarray(estimate), 1)
                self.gate.take(k, command, "controller")
            if k == 0:
                assert self.gate.enable() is None
            self.written.append(self.gate.step(k * PERIOD))
            force, rate = self.disturbance[k][:2]
            self.simulator.advance(self.written[-1], force, rate, 0.0, 0.0)
            self.cycle += 1
        return readings


def test_blending_in_leaves_the_loop_stable():
    loop = Loop(Parameters(position_margin=-0.005))
    readings = loop.run(6000)
    assert loop.gate.state == "active"
    assert np.max(np.abs(np.diff(loop.written))) < 1e-3
    assert np.max(np.abs(readings[:, FORCE])) < 1.25e4
    error = readings[:, FORCE] - loop.reference[:6000, 0]
    # 78 N is the law's bound.
    assert np.max(np.abs(error[3000:])) < 78.1


@pytest.mark.parametrize(("reaction", "peak", "travel"), [("cut", 7e3, 0.1), ("ramp", 7e3, 0.1)])
def test_a_controller_that_dies_at_full_speed_harms_nothing(reaction, peak, travel):
    loop = Loop(Parameters(enable_time=0.0, on_command_stale=reaction))
    before = loop.run(3155)
    assert abs(before[-1, VELOCITY]) > 1.15
    after = loop.run(400, controller=False)
    assert [cause.detector for cause in loop.gate.causes] == ["command_stale"]
    assert np.max(np.abs(after[:, FORCE])) < peak
    assert abs(after[-1, POSITION] - after[0, POSITION]) < travel
    at_rest = np.flatnonzero(np.abs(after[:, VELOCITY]) > 0.1)
    # 20 ms of watchdog, the ramp, and the response of valve and oil.
    assert at_rest[-1] < 20 + 20 + 60
