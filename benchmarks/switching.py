"""Cost of a switch from one running force controller to another: jump of the command, and force error.

usage: python -m benchmarks.switching [--moments 8] [--handover follow|unaware|cold]

The second controller stands by: it follows every cycle that the first one answers. Then it takes over, at several moments of
the load cycle. `jump` is the largest change of the command from one cycle to the next in the first cycles after the switch;
`error` is the largest force error in the fifth of a second after it. Each is compared with that of the worse of the two
controllers driving alone over the same cycles. With `unaware` the second law is stepped without its kernel `follow`, so that
it ignores the command that the valve received; with `cold` it starts at the switch.
"""

import platform
from itertools import permutations
from typing import NamedTuple

import numpy as np

from benchmarks.common import parser_of, print_heading, print_row
from ehls_ros.arrays import Array
from ehls_ros.control.controller import Controller
from ehls_ros.control.controllers import CONTROLLERS
from ehls_ros.control.controllers.base import model_of
from ehls_ros.control.disturbances import DISTURBANCES
from ehls_ros.control.friction_estimator import FrictionEstimator
from ehls_ros.control.rig_scale import defaults_for
from ehls_ros.experiments.loop import sampled, simulator_of
from ehls_ros.experiments.spec import Spec, chosen_spec
from ehls_ros.physics import sensors
from ehls_ros.physics.rig import SENSED
from ehls_ros.schema import parse

FIRST = 5
"""Cycles after the switch in which the command's changes are evaluated."""

AFTER = 0.2
"""Time after the switch in which the force error is evaluated [s]."""

FIRST_SWITCH = 2.5
"""Time before the first switch [s]."""

TURN = 2.0
"""Period of the references [s]."""

HANDOVERS = FOLLOW, UNAWARE, COLD = ("follow", "unaware", "cold")


class Contestant(NamedTuple):
    """A law with its tuning, in words and as numbers."""

    law: str
    tuning: str = ""

    def __str__(self) -> str:
        """Return the label of the row."""
        return f"{self.law} {self.tuning}".rstrip()

    def controller(self, spec: Spec) -> Controller:
        """Return the controller, ready to run."""
        values = {name: float(value) for name, _, value in (word.partition("=") for word in self.tuning.split())}
        declared = CONTROLLERS.load(self.law).Parameters
        parameters = parse(declared, values, str(self), defaults_for(declared, spec.controller_rig))
        return Controller(self.law, parameters, model_of(spec.controller_rig, spec.settings.control_period))


CASES = {
    "sine_fd2": (
        Contestant("fasmc"),
        Contestant("fasmc", "k=24 g=120"),
        Contestant("sic"),
        Contestant("fasmc_output_feedback", "coupling_stiffness=0 coupling_damping=0"),
    ),
    "measured_sine_fd2": (
        Contestant("fasmc_output_feedback"),
        Contestant("fasmc_output_feedback", "k=24 reaching_rate=150"),
        Contestant("fasmc_output_feedback", "k=6 reaching_rate=600"),
    ),
}


def run(spec: Spec, first: Contestant, second: Contestant, switch: int, cycles: int, handover: str) -> tuple[Array, Array]:
    """Run the loop with a switch at a cycle; return command [m] and force error [N] of every cycle."""
    period = spec.settings.control_period
    simulator, random = simulator_of(spec), np.random.default_rng(spec.settings.seed)
    estimator = FrictionEstimator(spec.compensation.name, spec.controller_rig, period, spec.compensation.parameters)
    wanted = sampled(spec.reference, period).rows(0, cycles)
    kind = DISTURBANCES.load(spec.disturbance.name)
    disturbing = kind.build(spec.disturbance.parameters, sampled(spec.disturbance.signal, period), spec.rig, period)
    leaving, coming = first.controller(spec), second.controller(spec)
    if handover == UNAWARE:
        coming._follow = None  # noqa: SLF001 - as for a law whose file has none
    rows, command = disturbing.rows(0, cycles).tolist(), 0.0
    commands, errors = np.empty(cycles), np.empty(cycles)
    for cycle in range(cycles):
        measured = simulator.measure(random.standard_normal(len(SENSED)))
        seen = measured, wanted[cycle], estimator.update(measured[sensors.VELOCITY])
        if cycle < switch:
            if handover != COLD:
                coming.follow(*seen, command)
            command = leaving.step(*seen)
        elif cycle == switch and handover != COLD:
            command = coming.follow(*seen, command)
        else:
            command = coming.step(*seen)
        commands[cycle], errors[cycle] = command, measured[sensors.FORCE] - wanted[cycle][0]
        simulator.advance(command, *rows[cycle])
    return commands, errors


def changes(commands: Array, switch: int) -> float:
    """Return the largest change of the command from one cycle to the next, from the switch on [m]."""
    return float(np.max(np.abs(np.diff(commands[switch - 1 : switch + FIRST]))))


def main() -> None:
    """Print the table."""
    parser = parser_of(__doc__)
    parser.add_argument("--moments", type=int, default=8, help="switches per pair, spread over a load cycle")
    parser.add_argument("--handover", choices=HANDOVERS, default=FOLLOW, help="how the second controller starts")
    options = parser.parse_args()
    print(f"{platform.processor() or platform.machine()}, Python {platform.python_version()}; handover: {options.handover}")
    for case, contestants in CASES.items():
        spec = chosen_spec(case, "")
        period = spec.settings.control_period
        after = round(AFTER / period)
        moments = [round((FIRST_SWITCH + TURN * i / options.moments) / period) for i in range(options.moments)]
        cycles = moments[-1] + after
        alone = {each: run(spec, each, each, cycles, cycles, COLD) for each in contestants}
        print(f"\n{case}")
        print_heading("from", "to", "jump [um]", "alone [um]", "error [N]", "alone [N]")
        for first, second in permutations(contestants, 2):
            jumps, errors, usual, usual_errors = [], [], [], []
            for switch in moments:
                commands, error = run(spec, first, second, switch, switch + after, options.handover)
                jumps.append(changes(commands, switch))
                errors.append(np.max(np.abs(error[switch:])))
                usual.append(max(changes(alone[each][0], switch) for each in (first, second)))
                usual_errors.append(max(np.max(np.abs(alone[each][1][switch : switch + after])) for each in (first, second)))
            figures = 1e6 * max(jumps), 1e6 * max(usual), max(errors), max(usual_errors)
            print_row(first, second, *(f"{figure:.1f}" for figure in figures))


if __name__ == "__main__":
    main()
