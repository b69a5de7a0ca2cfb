"""Bumpless switch of the valve between running controllers and back, without a trip.

In lockstep the run equals that of the same switches in one process.
"""

import numpy as np
import pytest

pytest.importorskip("ehls_msgs.msg._driver", reason="needs ehls_msgs built, as `make setup` does")

from diagnostic_msgs.msg import DiagnosticArray
from patience import PATIENCE
from std_msgs.msg import Bool

from ehls_msgs.msg import ControllerStatus, Driver, LoaderState, ValveCommand
from ehls_msgs.srv import SwitchController
from ehls_ros.cli.main import main
from ehls_ros.control.controller import Controller
from ehls_ros.control.controllers import CONTROLLERS
from ehls_ros.control.controllers.base import model_of
from ehls_ros.control.disturbances import DISTURBANCES
from ehls_ros.experiments.loop import run_in_process, sampled, simulator_of
from ehls_ros.experiments.spec import Use, load_spec
from ehls_ros.nodes import parameter_requests
from ehls_ros.physics import sensors
from ehls_ros.physics.rig import SENSED

FIRST, SECOND = "fasmc_output_feedback", "sic"
WITHOUT_COUPLING = "fasmc_output_feedback, coupling_stiffness: 0.0, coupling_damping: 0.0"
PHASE = 500
"""Minimum number of cycles that each controller drives."""


def law_of(sender):
    """Return the law of a sender, whose name contains its node and process."""
    return sender.rpartition("/")[2].rpartition("_node-")[0]


def in_one_process(spec, drivers, joined, missed, cycles):
    """Return force [N] and command [m] of a run in which controllers join and drive from the given cycles on.

    The second one does not follow the cycles ``missed``.
    """
    period = spec.settings.control_period
    simulator, random = simulator_of(spec), np.random.default_rng(spec.settings.seed)
    wanted = sampled(spec.reference, period).rows(0, cycles)
    kind = DISTURBANCES.load(spec.disturbance.name)
    source = kind.build(spec.disturbance.parameters, sampled(spec.disturbance.signal, period), spec.rig, period)
    disturbance = source.rows(0, cycles)
    tunings = {SECOND: CONTROLLERS.load(SECOND).Parameters(), FIRST: spec.controller.parameters}
    laws = {name: Controller(name, tunings[name], model_of(spec.controller_rig, period)) for name in joined}
    forces, commands, driver, last = np.empty(cycles), np.zeros(cycles), FIRST, {}
    for cycle in range(cycles):
        measured = simulator.measure(random.standard_normal(len(SENSED)))
        answers = {}
        for name, law in laws.items():
            if cycle >= joined[name] and (name == driver or cycle not in missed):
                seen = measured, wanted[cycle], np.zeros(2)
                if name == driver:
                    answers[name] = law.step(*seen)
                else:
                    answers[name] = law.follow(*seen, commands[cycle - 1], cycle - last.get(name, cycle - 1))
                last[name] = cycle
        driver = drivers.get(cycle, driver)
        forces[cycle], commands[cycle] = measured[sensors.FORCE], answers[driver]
        simulator.advance(commands[cycle], *disturbance[cycle])
    return forces, commands


@pytest.mark.long
def test_a_controller_takes_over_gives_back_and_succeeds_one_that_leaves(graph, participant, spec_file):
    path = spec_file(duration=1000.0, controller=FIRST)
    path.write_text(path.read_text(encoding="utf-8").replace(f"name: {FIRST}", f"name: {WITHOUT_COUPLING}"), encoding="utf-8")
    told = participant.collect(Driver, "driver")
    states = participant.collect(LoaderState, "loader_state")
    commands = participant.collect(ValveCommand, "valve_command")
    shadows = participant.collect(ValveCommand, "standby_command")
    statuses = participant.collect(ControllerStatus, "controller_status")
    driving = participant.collect(Bool, "driving")
    diagnostics = participant.collect(DiagnosticArray, "/diagnostics")
    for name in ("reference_node", "disturbance_node", f"{FIRST}_node"):
        graph.start(name, spec=path, timing="lockstep")
    # The test must keep up with the messages.
    graph.start("plant_sim_node", spec=path, timing="lockstep", speed=1.0)

    def drives(law, cycles=PHASE):
        participant.until(lambda: bool(told) and law_of(told[-1].sender) == law)
        participant.until(lambda: bool(states) and states[-1].cycle >= told[-1].cycle + cycles)

    def switch(name):
        return participant.call(SwitchController, "switch_controller", SwitchController.Request(controller=name))

    drives(FIRST)
    refused = switch(f"{SECOND}_node")
    assert not refused.success
    assert "does not stand by" in refused.message
    graph.start(f"{SECOND}_node", spec=path, timing="lockstep", autostart=False)
    assert participant.change(f"{SECOND}_node", "configure")
    # It determines the first cycle that it follows.
    participant.until(lambda: shadows.publishers() >= 2)
    assert participant.change(f"{SECOND}_node", "activate")
    # The plant waits for the new one as soon as it has discovered it; until then it may miss cycles.
    participant.until(lambda: len(shadows) > PHASE and shadows[-1].cycle == shadows[-PHASE].cycle + PHASE - 1)
    assert switch(f"{SECOND}_node").success
    drives(SECOND)
    assert switch(f"/ehls/{FIRST}_node").success
    drives(FIRST)
    assert "drives already" in switch(f"{FIRST}_node").message
    assert graph.stop(f"{FIRST}_node") == 0, graph.log(f"{FIRST}_node")
    drives(SECOND)

    assert [law_of(message.sender) for message in told] == ["", FIRST, SECOND, FIRST, SECOND]
    assert all(message.data for message in driving)
    assert not any("second_sender" in status.message for array in diagnostics for status in array.status)
    # Each cycle has one command and one status, of the controller that drove.
    turns = {message.cycle: law_of(message.sender) for message in told if message.sender}
    of_cycle = [max(first for first in turns if first <= max(message.cycle, 1)) for message in commands]
    assert [law_of(message.sender) for message in commands] == [turns[first] for first in of_cycle]
    assert len({message.cycle for message in statuses}) == len(statuses)

    spec = load_spec(path)
    cycles = states[-1].cycle + 1
    joined, switched = shadows[0].cycle, list(turns)[1]
    participant.until(lambda: any(message.cycle == switched - 1 and law_of(message.sender) == SECOND for message in shadows))
    missed = set(range(joined, switched)) - {message.cycle for message in shadows}
    forces, sent = in_one_process(spec, turns, {FIRST: 0, SECOND: joined}, missed, cycles)
    heard = np.array([(message.cycle, message.force) for message in states])
    assert min(np.histogram(heard[:, 0], [*turns, np.inf])[0]) >= PHASE
    apart = np.abs(heard[:, 1] - forces[heard[:, 0].astype(int)])
    # Only the joining controller may miss cycles: the previous driver follows the other at once.
    assert np.max(apart) <= 1e-6

    settings = spec.settings._replace(duration=cycles * spec.settings.control_period)
    alone = [
        run_in_process(spec._replace(settings=settings, controller=use)).signals
        for use in (spec.controller, Use(SECOND, CONTROLLERS.load(SECOND).Parameters()))
    ]
    usual_error = max(np.max(np.abs(run["force_n"] - run["force_reference_n"])[PHASE:]) for run in alone)
    usual_change = max(np.max(np.abs(np.diff(run["valve_command_m"][PHASE:]))) for run in alone)
    wanted = alone[0]["force_reference_n"]
    for first in list(turns)[1:]:
        after = slice(first, first + PHASE // 2)
        assert np.max(np.abs(forces[after] - wanted[after])) <= 1.2 * usual_error
        assert np.max(np.abs(np.diff(sent[first - 1 : first + 5]))) <= 1.2 * usual_change


@pytest.mark.long
def test_the_command_waits_for_a_controller_that_starts_and_names_one_that_does_not(graph, spec_file, capsys, monkeypatch):
    monkeypatch.setattr(parameter_requests, "FOUND", PATIENCE)
    path = spec_file(duration=1000.0, controller=SECOND)
    for name in ("reference_node", "disturbance_node", f"{SECOND}_node"):
        graph.start(name, spec=path, timing="lockstep")
    graph.start("plant_sim_node", spec=path, timing="lockstep", speed=1.0)
    graph.start("fasmc_node", spec=path, timing="lockstep", autostart=False)
    assert main(["switch", "fasmc_node"]) == 1
    assert "fasmc_node is unconfigured; it stands by once it is active" in capsys.readouterr().err
    graph.stop("fasmc_node")
    graph.start("fasmc_node", spec=path, timing="lockstep")
    assert main(["switch", "fasmc_node"]) == 0, capsys.readouterr().err
    assert "takes over" in capsys.readouterr().out
