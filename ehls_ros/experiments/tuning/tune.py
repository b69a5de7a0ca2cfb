"""Find the numbers of a control law for a rig: the least error that holds within the file's uncertainty and the margins.

The law's file names the numbers that are tuned (``TUNED``). Each is a factor on its default for the rig. Factors are varied all
together at first, then one after another, up and down, by a step that shrinks when nothing improves (coordinate search: Kolda,
Lewis, Torczon, SIAM Review 45, 2003). A set of numbers is judged by the largest error of the true force in the last half of a
run, as the mean of several: on the rig of the file, with different noise of the sensors, and on rigs drawn within its
uncertainty, with other frequencies where no experiment is given. The error of one run scatters by 10 to 20 %, and a search
would choose its luck; one lost run outweighs all others. A set is given up when the runs made show that it is worse than the
best one, run by run (racing: Maron, Moore, Neural Information Processing Systems 6, 1994). Margins below those asked for count
as a larger error, so that the search returns to them from anywhere, and so does an error of a small force against an actuator
under test that holds.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from statistics import fmean
from typing import NamedTuple

import numpy as np

from ehls_ros.control.controllers import CONTROLLERS
from ehls_ros.control.margins import LoopMargins
from ehls_ros.errors import BadInput
from ehls_ros.experiments.causal_limit import limit_under
from ehls_ros.experiments.spec import COMMAND_DELAY, Spec
from ehls_ros.experiments.stepped_run import stepped_run
from ehls_ros.experiments.tuning.loop_margins import changed, margins_of, slipping
from ehls_ros.experiments.tuning.task import Task, held, loses, still
from ehls_ros.experiments.tuning.uncertainty import uncertain
from ehls_ros.parallel import Workers
from ehls_ros.physics.rig import Rig
from ehls_ros.physics.sensors import LOAD_PRESSURE, SPOOL
from ehls_ros.schema import declarations

FIRST_STEP, LAST_STEP = 3.0, 1.2
"""Factors by which a number is varied at first and at last."""

WIDEST = 30.0
"""Largest factor on a default, either way."""

LEAST = 1e-9
"""Smallest error distinguished from zero [N]."""

BETTER = 0.98
"""Ratio of two scores below which the smaller one is an improvement."""

AFFORDED = 1.25
"""Factor on the least error, with what it lacks, up to which a set that lacks nothing is chosen."""

PRICE = 0.5
"""Power of the loop's distance from instability by which lacking margins count: at half the distance of those asked for, an
error counts 1.4 times. A higher price bought some dB with twice the error on rigs whose law reaches no such margins."""

NEAR = 0.01
"""Distance below which loops are equally bad."""

STEADY = 0.05
"""Swing of the error of a small force against an actuator that holds, over its amplitude, above which it counts as an error.

The largest error there is that of friction when the piston breaks away, which no numbers avoid.
"""

REPEATS, RIGS = 2, 5
"""Numbers of runs on the rig of the file, and of rigs drawn within the uncertainty for a given experiment."""

FASTER = 4.0
"""Factor on the valve's bandwidth and on the rate of sampling where their lag is left out."""

MAX_TRIALS = 60
"""Largest number of sets of numbers tried by the search."""

SPEEDS = (0.15, 0.3, 0.55, 1.0, 1.8, 3.3, 6.0)
"""Factors on all tuned rates together: the first sets tried, and those of the trade-off curve."""

FAR = 2.0
"""Error over the causal limit above which a remark names the limitation that costs most."""

Progress = Callable[[int, int], None]


class Wanted(NamedTuple):
    """Margins asked for.

    Attributes:
        gain_db: factor by which the loop's gain may rise or fall [dB].
        phase_deg: angle by which its phase may change [degree].
    """

    gain_db: float = 6.0
    phase_deg: float = 30.0


USUAL = Wanted()
"""Margins asked for by default."""


class Trial(NamedTuple):
    """A set of numbers with its results.

    Attributes:
        numbers: values of the tuned numbers by name.
        error: mean over the runs on the rig of the file of the largest error of each [N]; infinite if one is.
        typical: the same over all runs; infinite for numbers given up.
        worst: largest error of all runs made [N].
        held: swing of the error of a small force against an actuator under test that holds, over the force's amplitude; 0
            without such.
        margins: margins of the loop.
        errors: largest error of each run made [N].
    """

    numbers: Mapping[str, float]
    error: float
    typical: float
    worst: float
    held: float
    margins: LoopMargins
    errors: tuple[float, ...] = ()

    def lacking(self, wanted: Wanted) -> float:
        """Return the logarithm of the factor on the error by which the search counts lacking margins and unsteadiness."""
        wide, short = distances(*wanted), distances(self.gain_db, self.margins.phase_deg)
        ratio = max((asked + NEAR) / (found + NEAR) for asked, found in zip(wide, short, strict=True))
        return PRICE * math.log(max(ratio, 1.0)) + max(math.log(max(self.held, LEAST) / STEADY), 0.0)

    def has(self, wanted: Wanted) -> bool:
        """Return whether the loop has the margins asked for."""
        return self.gain_db >= wanted.gain_db and self.margins.phase_deg >= wanted.phase_deg

    @property
    def gain_db(self) -> float:
        """Factor by which the loop's gain may rise or fall [dB]."""
        return min(self.margins.gain_db, self.margins.fall_db)

    def score(self, wanted: Wanted) -> float:
        """Return the logarithm of the error, with what it lacks; smaller is better."""
        return (math.log(self.typical) if 0.0 < self.typical < math.inf else math.inf) + self.lacking(wanted)


class Limit(NamedTuple):
    """Error with the same numbers without one limitation; larger where the numbers no longer fit.

    Attributes:
        removed: the limitation, such as ``noise of the sensors``.
        error: error without it, as that of a trial [N].
    """

    removed: str
    error: float


class Tuned(NamedTuple):
    """Result of :func:`tune`.

    Attributes:
        task: the experiment.
        wanted: margins asked for.
        default: results of the law's defaults for the rig.
        chosen: results of the numbers found.
        causal_limit: error of the best law without foresight [N]; NaN if not determined.
        limits: error without each limitation.
        curve: results of all tuned numbers made slower and faster together.
        tried: number of sets tried.
        remarks: sentences for the user.
    """

    task: Task
    wanted: Wanted
    default: Trial
    chosen: Trial
    causal_limit: float
    limits: tuple[Limit, ...]
    curve: tuple[Trial, ...]
    tried: int
    remarks: tuple[str, ...]

    @property
    def lost(self) -> bool:
        """Whether the numbers found do not hold the force."""
        return loses(self.task.spec, self.chosen.error)

    @property
    def holds(self) -> bool:
        """Whether the force is held with the margins asked for."""
        return not self.lost and self.chosen.lacking(self.wanted) == 0.0

    @property
    def spec(self) -> Spec:
        """The experiment with the numbers found."""
        return with_numbers(self.task.spec, self.chosen.numbers)


def tune(
    task: Task,
    *,
    wanted: Wanted = USUAL,
    uncertainty: float = 1.0,
    seed: int = 0,
    jobs: int | None = None,
    progress: Progress | None = None,
) -> Tuned:
    """Find the numbers of a task's law.

    Args:
        task: the experiment.
        wanted: margins asked for.
        uncertainty: factor on the standard errors of the rig's coefficients, its file's or assumed ones; 0: it is exact.
        seed: seed of the rigs drawn.
        jobs: number of processes; None: one per processor.
        progress: called with the number of trials done and the largest number.

    Raises:
        BadInput: the law names no numbers to tune, or a margin is negative or not finite.
    """
    check_margins(wanted)
    names = tunable(task.spec.controller.name)
    again = [_with_seed(task.spec, seed + number) for number in range(1, REPEATS)]
    others = task.others or (task.spec,) * RIGS
    rigs = uncertain(others, seed + REPEATS, uncertainty) if uncertainty > 0.0 else []
    with Workers(jobs) as workers:
        search = _Search([task.spec, *again], rigs, names, wanted, workers, progress)
        [default] = search.all([{}])
        search.improve(default)
        curve = search.all([search.faster(search.choice().numbers, speed) for speed in SPEEDS])
        # Faster or slower altogether may be better still.
        chosen = search.choice(AFFORDED)
        limits = search.limits(chosen)
    found = Tuned(
        task,
        wanted,
        default,
        chosen,
        causal_limit_of(with_numbers(task.spec, chosen.numbers)),
        tuple(limits),
        tuple(curve),
        len(search.trials),
        (),
    )
    return found._replace(remarks=(*task.remarks, *_remarks(found, search.trials)))


def distances(gain_db: float, phase_deg: float) -> tuple[float, float]:
    """Return the distances from the critical point of the points of a frequency response with a gain and a phase margin."""
    return 1.0 - math.pow(10.0, -gain_db / 20.0), 2.0 * math.sin(0.5 * math.radians(min(phase_deg, 180.0)))


def check_margins(wanted: Wanted) -> None:
    """Check the margins asked for.

    Raises:
        BadInput: one is negative or not finite.
    """
    if not all(0.0 <= margin < math.inf for margin in wanted):
        asked = f"margins of {wanted.gain_db:g} dB and {wanted.phase_deg:g} degrees are asked for"
        raise BadInput(asked, "margins", "two numbers of 0 or more")


def tunable(law: str) -> tuple[str, ...]:
    """Return the names of the numbers of a law that are tuned.

    Raises:
        BadInput: there are none.
    """
    names: tuple[str, ...] = getattr(CONTROLLERS.load(law), "TUNED", ())
    if not names:
        raise BadInput(f"{law} names no numbers to tune", "law", "a law with TUNED, such as fasmc_predictive")
    return names


def with_numbers(spec: Spec, numbers: Mapping[str, float]) -> Spec:
    """Return an experiment with other numbers of its law."""
    return spec._replace(controller=spec.controller._replace(parameters=spec.controller.parameters._replace(**numbers)))


def causal_limit_of(spec: Spec) -> float:
    """Return the causal limit of an experiment under its disturbance, the actuator's reaction included [N]; NaN if unknown."""
    run = stepped_run(spec)
    if not np.all(np.isfinite(run.error)):
        return math.nan
    limit = limit_under(spec, run.disturbance, run.truth[:, SPOOL], run.truth[:, LOAD_PRESSURE]).limit
    return math.nan if limit is None else limit.largest


def judged(
    exact: Sequence[Spec], rigs: Sequence[Spec], numbers: Mapping[str, float], wanted: Wanted, best: Trial | None = None
) -> Trial:
    """Return the results of a set of numbers.

    Args:
        exact: the experiment on the rig of the file, with different noise.
        rigs: the experiment on rigs within the uncertainty.
        numbers: values by name.
        wanted: margins asked for.
        best: results with which the numbers are compared after each run, and given up.
    """
    specs = [with_numbers(spec, numbers) for spec in (*exact, *rigs)]
    holding = held(specs[0])
    unsteady = 0.0 if holding is None else stepped_run(holding).swing() / holding.reference.parameters.amplitude
    found = Trial(numbers, math.nan, math.nan, math.nan, unsteady, margins_of(specs[0]))
    errors = list[float]()
    for spec in specs:
        errors.append(stepped_run(spec).largest())
        mean, exactly = sum(errors) / len(specs), fmean(errors[: len(exact)])
        found = found._replace(error=exactly, typical=mean, worst=max(errors), errors=tuple(errors))
        if best is not None and len(errors) >= len(exact) and _worse(found, best, wanted):
            return found._replace(typical=math.inf)
    return found


def _worse(found: Trial, best: Trial, wanted: Wanted) -> bool:
    """Return whether the runs made show a larger error than the best, with what it lacks: their sum, or each of them.

    Where the best lacks something, numbers that lack nothing may be chosen at more error.
    """
    afforded = math.log(AFFORDED) if found.lacking(wanted) == 0.0 < best.lacking(wanted) else 0.0
    least = math.exp(best.lacking(wanted) - found.lacking(wanted) + afforded)
    each = all(error >= least * other for error, other in zip(found.errors, best.errors, strict=False))
    return each or found.score(wanted) >= best.score(wanted) + afforded


def without(spec: Spec) -> dict[str, Spec]:
    """Return an experiment with one limitation removed from the rig and from the controller's, by its name."""
    settings = spec.settings
    cases = {
        "noise of the sensors": changed(spec, lambda rig: rig._replace(sensors={})),
        "delay of the command": changed(spec, _at_once),
        "lag of the valve": changed(spec, lambda rig: rig.with_plant(valve_bandwidth=FASTER * rig.plant.valve_bandwidth)),
        "sampling": spec._replace(settings=settings._replace(control_period=settings.control_period / FASTER)),
        "friction": changed(spec, slipping),
        "motion of the actuator under test": still(spec),
    }
    return {name: case for name, case in cases.items() if case != spec}


def _at_once(rig: Rig) -> Rig:
    return rig._replace(effects=tuple(use for use in rig.effects if use.name != COMMAND_DELAY))


class _Search:
    """State of a search.

    Attributes:
        trials: all sets tried.
    """

    def __init__(
        self,
        exact: Sequence[Spec],
        rigs: Sequence[Spec],
        names: Sequence[str],
        wanted: Wanted,
        workers: Workers,
        progress: Progress | None,
    ) -> None:
        spec = exact[0]
        self._exact, self._rigs, self._names, self._wanted = exact, rigs, names, wanted
        self._workers, self._progress = workers, progress
        self._start = {name: float(getattr(spec.controller.parameters, name)) for name in names}
        self._declared = {declared.name: declared for declared in declarations(type(spec.controller.parameters))}
        self.trials = list[Trial]()

    def all(self, sets: Sequence[Mapping[str, float]]) -> list[Trial]:
        """Return the results of several sets of numbers; missing ones are the defaults. Sets tried before are not repeated."""
        within = [{name: self._within(name, given.get(name, self._start[name])) for name in self._names} for given in sets]
        known = [trial.numbers for trial in self.trials]
        best = self.choice() if self.trials else None
        new = [numbers for numbers in within if numbers not in known]
        self.trials += self._workers.run(
            [partial(judged, self._exact, self._rigs, numbers, self._wanted, best) for numbers in new]
        )
        if self._progress is not None:
            self._progress(min(len(self.trials), MAX_TRIALS), MAX_TRIALS + len(SPEEDS))
        return [next(trial for trial in self.trials if trial.numbers == numbers) for numbers in within]

    def _within(self, name: str, value: float) -> float:
        declared, start = self._declared[name], self._start[name]
        low, high = start / WIDEST, start * WIDEST
        low = low if declared.minimum is None else max(low, declared.minimum)
        high = high if declared.maximum is None else min(high, declared.maximum)
        return float(f"{min(max(value, low), high):.6g}")

    def faster(self, numbers: Mapping[str, float], factor: float) -> dict[str, float]:
        """Return numbers with all but the dimensionless ones multiplied."""
        return {name: value if self._declared[name].unit == "1" else factor * value for name, value in numbers.items()}

    def choice(self, afforded: float = 1.0 / BETTER) -> Trial:
        """Return the best of all sets tried; of those whose error, with what it lacks, is near the least, one without a lack.

        Args:
            afforded: factor on the least error up to which others are near.
        """
        best = min(self.trials, key=lambda trial: trial.score(self._wanted))
        level = best.score(self._wanted) + math.log(afforded)
        near = [trial for trial in self.trials if trial.score(self._wanted) <= level]
        whole = [trial for trial in near if trial.lacking(self._wanted) == 0.0]
        return min(whole or [best], key=lambda trial: trial.score(self._wanted))

    def improve(self, start: Trial) -> None:
        """Try all numbers of a start faster or slower together, then sets each better than the one before."""
        self.all([self.faster(start.numbers, speed) for speed in SPEEDS])
        best, step = self.choice(), FIRST_STEP
        while step > LAST_STEP and len(self.trials) < MAX_TRIALS:
            improved = False
            for name in self._names:
                if len(self.trials) >= MAX_TRIALS:
                    break
                value = best.numbers[name]
                moved = {self._within(name, value * factor) for factor in (step, 1.0 / step)} - {value}
                trials = self.all([{**best.numbers, name: number} for number in sorted(moved)])
                better = min((best, *trials), key=lambda trial: trial.score(self._wanted))
                if better.score(self._wanted) < best.score(self._wanted) + math.log(BETTER):
                    best, improved = better, True
            if not improved:
                step = math.sqrt(step)

    def limits(self, chosen: Trial) -> list[Limit]:
        """Return the error without each limitation, with the same numbers."""
        cases = [without(with_numbers(spec, chosen.numbers)) for spec in self._exact]
        tasks = [partial(_largest, case[name]) for name in cases[0] for case in cases]
        errors = np.reshape(self._workers.run(tasks), (len(cases[0]), len(cases)))
        return [Limit(name, fmean(each)) for name, each in zip(cases[0], errors, strict=True)]


def _with_seed(spec: Spec, seed: int) -> Spec:
    """Return an experiment with other noise of the sensors."""
    return spec._replace(settings=spec.settings._replace(seed=seed))


def _largest(spec: Spec) -> float:
    return stepped_run(spec).largest()


def _remarks(found: Tuned, tried: Sequence[Trial]) -> list[str]:
    chosen, wanted = found.chosen, found.wanted
    if found.lost:
        return ["no numbers hold the force of this experiment: try a smaller reference, a slower motion or another law"]
    remarks = list[str]()
    if not chosen.has(wanted):
        reached = f"the margins found are {chosen.gain_db:.1f} dB and {chosen.margins.phase_deg:.0f} degrees"
        asked = f"{wanted.gain_db:g} dB and {wanted.phase_deg:g} degrees"
        costs = [trial.error for trial in tried if trial.has(wanted) and not loses(found.task.spec, trial.error)]
        known = f"with {asked} the error is {min(costs):.3g} N at least" if costs else f"no numbers tried have {asked}"
        remarks.append(f"{reached}; {known}")
    least = min(found.limits, key=lambda limit: limit.error)
    if 0.0 < FAR * found.causal_limit < chosen.error and least.error < chosen.error:
        beside = f"the error is {chosen.error / found.causal_limit:.1f} times the causal limit"
        remarks.append(
            f"{beside}, which leaves out the lag of the valve and the break-away of friction; without {least.removed} it is"
            f" {least.error:.3g} N with the same numbers"
        )
    holding = held(found.spec)
    if holding is not None and chosen.held > STEADY:
        against = "against an actuator under test that holds"
        remarks.append(
            f"a force of {holding.reference.parameters.amplitude:.3g} N {against} errs by {100.0 * chosen.held:.0f} %"
        )
    return remarks
