"""Force errors due to a wrong rig file, without and with the companion ``adaptation``.

    python -m benchmarks.adaptation --experiments sine_fd2 measured_sine_fd2 --rigs 100

First table: one coefficient of the controller's rig file is 20 % low or high. Second table: every coefficient of the rig
differs by up to 10 % from the controller's rig file. Errors are the largest of the true driving force against the reference,
in the first second and in the last half.
"""

import argparse
import math
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import numpy as np
from numpy.random import Generator

from benchmarks.common import MEASURED_EFFECTS, experiment, parser_of, print_heading, print_row
from ehls_ros.arrays import Array
from ehls_ros.experiments.loop import ClosedLoop
from ehls_ros.experiments.run_failure import Implausible
from ehls_ros.experiments.spec import Spec
from ehls_ros.physics.rig import Rig
from ehls_ros.physics.sensors import FORCE

OFF, SPREAD = 0.2, 0.1
LEVEL = ("coulomb_force", "static_force", "attraction_rate")
COEFFICIENTS = (
    "valve_gain",
    "discharge_coefficient",
    "piston_area",
    "bulk_modulus",
    "friction_level",
    "viscous_coefficient",
    "command_delay",
)


class Errors(NamedTuple):
    """Largest true error in the first second and in the last half [N]; infinite where the run ended early."""

    first: float
    last: float


class Watched(ClosedLoop):
    """A loop that records the true driving force of every cycle."""

    def __init__(self, spec: Spec) -> None:
        """Prepare the loop."""
        self.forces: list[float] = []
        super().__init__(spec)
        self.forces.clear()

    def _run(self, first: int, record: Array, reference: Array, disturbance: Array, random: Generator) -> None:
        for i in range(len(record)):
            one = slice(i, i + 1)
            super()._run(first + i, record[one], reference[one], disturbance[one], random)
            self.forces.append(float(self._plant.state.truth[FORCE]))


def errors_of(spec: Spec) -> tuple[Errors, dict[str, float | str]]:
    """Run an experiment; return its errors and its companions' report."""
    loop = Watched(spec)
    wanted: list[Array] = []
    try:
        wanted.extend(block.reference[:, 0] for block in loop.blocks())
    except Implausible:
        return Errors(math.inf, math.inf), loop.company.report()
    error = np.abs(np.array(loop.forces) - np.concatenate(wanted))
    second = round(1.0 / spec.settings.control_period)
    return Errors(float(error[:second].max()), float(error[len(error) // 2 :].max())), loop.company.report()


def spec_of(name: str, law: str, duration: float, *, adapting: bool, seed: int = 0) -> Spec:
    """Return one of the package's experiments under another law."""
    known = [*MEASURED_EFFECTS] if name.startswith("measured") else []
    companions = ["adaptation"] if adapting else []
    return experiment(name, controller=law, duration=duration, seed=seed, companions=companions, known_effects=known)


def scaled(rig: Rig, factors: dict[str, float]) -> Rig:
    """Return a rig with coefficients multiplied."""
    plant, friction, effects = rig.plant, rig.friction, rig.effects
    for name, factor in factors.items():
        if name in plant._fields:
            plant = plant._replace(**{name: getattr(plant, name) * factor})
        elif name == "command_delay":
            effects = tuple(
                use._replace(parameters=use.parameters._replace(delay=use.parameters.delay * factor))
                if use.name == name
                else use
                for use in effects
            )
        else:
            names = LEVEL if name == "friction_level" else (name,)
            friction = friction._replace(**{each: getattr(friction, each) * factor for each in names})
    return rig._replace(plant=plant, friction=friction, effects=effects)


def one_wrong(options: argparse.Namespace) -> None:
    """Print the effect of one wrong coefficient, without and with adaptation."""
    errors = ("off: first s, last half [N]", "on: first s, last half [N]", "last half over nominal")
    print_heading("experiment", "wrong", *errors)
    for name in options.experiments:
        make = _maker(name, options)
        nominal = errors_of(make(adapting=False))[0]
        right, _ = errors_of(make(adapting=True))
        _print_errors(name, "nothing", nominal, right, nominal)
        for coefficient in COEFFICIENTS:
            if coefficient == "command_delay" and not name.startswith("measured"):
                continue
            for factor in (1.0 - OFF, 1.0 + OFF):
                off, on = (
                    errors_of(_believing(make(adapting=adapting), {coefficient: factor}))[0] for adapting in (False, True)
                )
                _print_errors(name, f"{coefficient} × {factor:g}", off, on, nominal)


def many_wrong(options: argparse.Namespace) -> None:
    """Print the effect of small errors in all coefficients, over many rigs."""
    print(f"\n{options.rigs} rigs, every coefficient within {100 * SPREAD:g} % of the controller's rig file, last half [N]")
    print_heading("experiment", "nominal", "median", "largest", "median over nominal", "ended early")
    for name in options.experiments:
        make = _maker(name, options)
        nominal = errors_of(make(adapting=False))[0].last
        last = np.array([_drawn(make(adapting=True), np.random.default_rng([options.seed, i])) for i in range(options.rigs)])
        lost = int(np.sum(~np.isfinite(last)))
        median = float(np.median(last))
        print_row(name, f"{nominal:.1f}", f"{median:.1f}", f"{last.max():.1f}", f"{median / nominal:.2f}", lost)


def _maker(name: str, options: argparse.Namespace) -> Callable[..., Spec]:
    def make(*, adapting: bool) -> Spec:
        return spec_of(name, options.law, options.duration, adapting=adapting, seed=options.seed)

    return make


def _believing(spec: Spec, factors: dict[str, float]) -> Spec:
    return spec._replace(controller_rig=scaled(spec.controller_rig, factors))


def _drawn(spec: Spec, rng: np.random.Generator) -> float:
    """Return the error in the last half on a rig with randomly drawn coefficients."""
    fixed = {"arm_length", "gravity"}
    names: Iterable[Any] = [n for n in spec.rig.plant._fields if n not in fixed]
    names = [*names, "friction_level", "stribeck_velocity", "stribeck_exponent", "viscous_coefficient", "command_delay"]
    factors = {name: float(rng.uniform(1.0 - SPREAD, 1.0 + SPREAD)) for name in names}
    return errors_of(spec._replace(rig=scaled(spec.rig, factors)))[0].last


def _print_errors(name: str, wrong: str, off: Errors, on: Errors, nominal: Errors) -> None:
    errors = (f"{found.first:.1f}, {found.last:.1f}" for found in (off, on))
    print_row(name, wrong, *errors, f"{on.last / nominal.last:.2f}")


def main() -> None:
    """Print the tables."""
    parser = parser_of(__doc__)
    parser.add_argument("--experiments", nargs="+", default=["sine_fd2", "measured_sine_fd2"])
    parser.add_argument("--law", default="fasmc_predictive")
    parser.add_argument("--duration", type=float, default=20.0)
    parser.add_argument("--rigs", type=int, default=25)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--one", action=argparse.BooleanOptionalAction, default=True, help="the first table")
    options = parser.parse_args()
    if options.one:
        one_wrong(options)
    if options.rigs > 0:
        many_wrong(options)


if __name__ == "__main__":
    main()
