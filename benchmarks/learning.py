"""Benefit of the companion `learning` on the emulated rig, and its cost after disturbing events.

usage: python -m benchmarks.learning [--seeds 8] [--repetitions 20] [--law fasmc_predictive] [--method waveform] [--preview]
                   [--events-only | --cells-only]

The paper's four experiments with a rig's sensors, config/experiments/measured_*.yaml. Errors are those of the piston's true
force, without noise; median and largest of the seeds. The noise floor is the non-repeating part of the last five load cycles;
the ratio is that of the largest error in these five to it.

`loaded` is another run, from rest with the learnt data and other noise: its first load cycle from 1 s on, or its second where
that takes no 1.5 s. It is relative to the median of the last five of the run before in the same part. An event's figure is the
largest error from the event on, relative to that of the same run without learning.
"""

import argparse
import math
import tempfile
import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from benchmarks.common import MEASURED_EFFECTS, experiment, largest, parser_of, print_heading, print_row
from ehls_ros.arrays import Array
from ehls_ros.control.companions.base import PLACE
from ehls_ros.control.controller import Controller, Outlook
from ehls_ros.control.controllers.base import model_of
from ehls_ros.control.disturbances import DISTURBANCES
from ehls_ros.experiments import learnt_files
from ehls_ros.experiments.loop import sampled
from ehls_ros.experiments.spec import Spec, company_of
from ehls_ros.physics import sensors
from ehls_ros.physics.plant import PL
from ehls_ros.physics.simulator import Simulator

PERIODS = {"constant_fd1": 4.0, "sine_fd1": 4.0, "constant_fd2": 1.0, "sine_fd2": 2.0}
"""Time after which reference and disturbance both repeat [s]."""

EVENT_EXPERIMENT = "sine_fd2"
LEARNT = 8
"""Load cycles before an event."""

RISE = 1.0
"""Time from rest to the wanted force, in which no correction helps [s]: the law's speed is 15.6 kN/s."""

BACK, RECOVERY_TIME = 50.0, 0.2
"""Error at which the force counts as recovered after a trip [N], and the time after that from which the error counts [s]."""

SHORT = 1.5
"""Length of a load cycle of which too little remains after that [s]."""

AFTER = 4
"""Load cycles evaluated after it."""


class Case(NamedTuple):
    """Configuration of a run.

    Attributes:
        experiment: of config/experiments, without ``measured_``.
        law: name of the controller.
        companions: as in a spec.
        seed: of the noise.
        reference: replaces the experiment's.
    """

    experiment: str
    law: str
    companions: Sequence[dict[str, Any]]
    seed: int
    reference: dict[str, Any] | None = None

    def spec(self) -> Spec:
        """Return the experiment."""
        changed = {} if self.reference is None else {"reference": self.reference}
        known, companions = [*MEASURED_EFFECTS], [*self.companions]
        name = f"measured_{self.experiment}"
        return experiment(name, known_effects=known, controller=self.law, companions=companions, **changed)


class Run:
    """A closed loop cycle by cycle, as the nodes step it."""

    def __init__(self, case: Case) -> None:
        """Start at rest."""
        spec = self._spec = case.spec()
        period = self._period = spec.settings.control_period
        self._simulator = Simulator(spec.loader_rig(), period, servo=spec.servo())
        self._wanted, self._motion = sampled(spec.reference, period), sampled(spec.disturbance.signal, period)
        kind = DISTURBANCES.load(spec.disturbance.name)
        self._moved = kind.build(spec.disturbance.parameters, self._motion, spec.rig, period)
        model = model_of(spec.controller_rig, period)
        company = company_of(spec, model, case.experiment)
        learnt_files.recall(company, spec)
        self.controller = Controller(case.law, spec.controller.parameters, model, company)
        self._random = np.random.default_rng(case.seed)
        self._cycle, self._command = 0, 0.0
        self._answered = -1
        self.scale = 1.0

    def seconds(self, duration: float, *, valve: str = "follows") -> Array:
        """Run for a while and return the true force error by cycle [N].

        Args:
            duration: duration [s].
            valve: behaviour of the valve: ``follows``; ``closed``, as after a trip; ``held``, as without answers.
        """
        cycles = round(duration / self._period)
        error, nowhere = np.empty(cycles), np.full(PLACE, np.nan)
        for i in range(cycles):
            k, simulator = self._cycle, self._simulator
            measured = simulator.measure(self._random.standard_normal(7))
            measured[sensors.VELOCITY] = math.nan
            reference = self.scale * self._wanted.row(k)
            error[i] = self._spec.rig.plant.piston_area * simulator.y[PL] - reference[0]
            if valve != "held":
                elapsed, self._answered = k - self._answered, k
                known = self._motion.row(k)
                self._command = self.controller.step(measured, reference, np.zeros(2), elapsed, Outlook(k, nowhere, known))
            simulator.advance(0.0 if valve == "closed" else self._command, *self._moved.rows(k, 1)[0])
            self._cycle += 1
        return error

    def keep_learnt(self) -> None:
        """Write the learnt file."""
        learnt_files.keep(self.controller.companions, self._spec)

    def soften(self, share: float) -> None:
        """Reduce the stiffness of the coupling by a share."""
        parameters = self._spec.disturbance.parameters
        softer = parameters._replace(stiffness=(1.0 - share) * parameters.stiffness)
        spec = self._spec._replace(disturbance=self._spec.disturbance._replace(parameters=softer))
        self._simulator.constants = Simulator(spec.loader_rig(), self._period, servo=spec.servo()).constants


def trip(run: Run, period: float) -> Array:
    """Close the valve for a quarter of a load cycle; the error counts once the force has recovered."""
    run.seconds(0.25 * period, valve="closed")
    run.controller.reset()
    error = run.seconds((AFTER - 0.25) * period)
    return error[int(np.argmax(np.abs(error) < BACK)) + round(RECOVERY_TIME / 1e-3) :]


def change(run: Run, period: float) -> Array:
    """Lower the amplitude by a fifth."""
    run.scale = 0.8
    return run.seconds(AFTER * period)


def crack(run: Run, period: float) -> Array:
    """Lower the stiffness by 30 %."""
    run.soften(0.3)
    return run.seconds(AFTER * period)


def miss(run: Run, period: float) -> Array:
    """Miss five cycles."""
    lost = run.seconds(5e-3, valve="held")
    return np.concatenate([lost, run.seconds(AFTER * period - 5e-3)])


EVENTS: dict[str, tuple[float, Callable[[Run, float], Array]]] = {
    "programme changed": (0.0, change),
    "trip": (0.4, trip),
    "stiffness -30 %": (0.4, crack),
    "5 missed cycles": (0.4, miss),
}
"""Events, each with its position in the load cycle."""


def companions(args: argparse.Namespace, period: float, file: str = "") -> list[dict[str, Any]]:
    """Return the companions of a run with learning."""
    learning = {"name": "learning", "period": period, "method": args.method, "file": file}
    return [*alone(args), learning]


def alone(args: argparse.Namespace) -> list[dict[str, Any]]:
    """Return the companions of a run without learning."""
    return [{"name": "disturbance_preview"}] if args.preview else []


def cells(args: argparse.Namespace) -> None:
    """Print the benefit of the repetitions."""
    print("largest true error, N: median (largest) of the seeds\n")
    after = f"after {args.repetitions}"
    print_heading("", "without", "after 5 repetitions", after, "noise's share", "ratio", "loaded")
    for name, period in PERIODS.items():
        columns: list[list[float]] = [[] for _ in range(6)]
        for seed in range(args.seeds):
            bare = Run(Case(name, args.law, alone(args), seed))
            bare.seconds(period)
            with tempfile.TemporaryDirectory() as folder:
                case = Case(name, args.law, companions(args, period, f"{folder}/learnt.npz"), seed)
                run = Run(case)
                errors = np.array([run.seconds(period) for _ in range(args.repetitions + 1)])
                run.keep_learnt()
                # From rest, with other noise.
                loaded = Run(case._replace(seed=seed + 1000))
                again = loaded.seconds(period)
                begin = round(RISE / 1e-3)
                if period < SHORT:
                    again, begin = loaded.seconds(period), 0
            late = errors[-5:]
            share = float(np.max(np.abs(late - late.mean(axis=0)))) * math.sqrt(len(late) / (len(late) - 1))
            peaks = np.max(np.abs(errors), axis=1)
            found = (
                float(np.max(np.abs(bare.seconds(3.0 * period)))),
                float(peaks[5]),
                float(peaks[-1]),
                share,
                float(peaks[-5:].max()) / share,
                float(np.max(np.abs(again[begin:])) / np.median(np.max(np.abs(late[:, begin:]), axis=1))),
            )
            for column, value in zip(columns, found, strict=True):
                column.append(value)
        texts = [*map(largest, columns[:4]), *(largest(column, ".2f") for column in columns[4:])]
        print_row(name, *texts)


def events(args: argparse.Namespace) -> None:
    """Print the cost of learning after an event."""
    period = PERIODS[EVENT_EXPERIMENT]
    print(f"\n{EVENT_EXPERIMENT}, after {LEARNT} load cycles: largest error from the event on, N\n")
    print_heading("", "without learning", "with", "ratio")
    for what, (part, happen) in EVENTS.items():
        found: list[list[float]] = [[], []]
        for seed in range(args.seeds):
            for column, beside in zip(found, (alone(args), companions(args, period)), strict=True):
                run = Run(Case(EVENT_EXPERIMENT, args.law, beside, seed))
                run.seconds((LEARNT + part) * period)
                column.append(float(np.max(np.abs(happen(run, period)))))
        _print_event(what, found)
    irregular = {"name": "irregular", "amplitude": 1e4}
    found = [[], []]
    rms: list[list[float]] = [[], []]
    for seed in range(args.seeds):
        for column, mean, beside in zip(found, rms, (alone(args), companions(args, period)), strict=True):
            run = Run(Case(EVENT_EXPERIMENT, args.law, beside, seed, irregular))
            run.seconds(period)
            error = run.seconds((LEARNT - 1) * period)
            column.append(float(np.max(np.abs(error))))
            mean.append(float(np.std(error)))
    _print_event("irregular reference", found)
    _print_event("irregular reference, rms", rms)


def _print_event(what: str, found: list[list[float]]) -> None:
    print_row(what, *map(largest, found), largest(np.divide(found[1], found[0]), ".2f"))


def main() -> None:
    """Run all requested parts."""
    parser = parser_of(__doc__)
    parser.add_argument("--seeds", type=int, default=8)
    parser.add_argument("--repetitions", type=int, default=20)
    parser.add_argument("--law", default="fasmc_predictive")
    parser.add_argument("--method", default="waveform", choices=("waveform", "harmonics"))
    parser.add_argument("--preview", action="store_true", help="beside the disturbance's preview")
    parser.add_argument("--events-only", action="store_true")
    parser.add_argument("--cells-only", action="store_true")
    args = parser.parse_args()
    began = time.monotonic()
    if not args.events_only:
        cells(args)
    if not args.cells_only:
        events(args)
    print(f"\n{time.monotonic() - began:.0f} s")


if __name__ == "__main__":
    main()
