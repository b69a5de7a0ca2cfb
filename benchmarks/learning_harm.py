"""Search for cases in which the companion `learning` increases the force error.

usage: python -m benchmarks.learning_harm [--cases 200] [--seed 1] [--noises 3] [--jobs 1]
                                          [--kinds ...] [--laws ...] [--methods ...]

Each case is a random disturbance under one law and one method. It runs without and with learning, on the same noise, for some
seeds of that noise. Errors are those of the piston's true force, from the third load cycle on. Three ratios are formed, with
over without; the largest over the load cycles counts:

* peak: largest error of the whole run, mean of the seeds;
* cycle: largest error of one load cycle, mean of the seeds;
* rms: rms error of one load cycle, of all seeds.
"""

import math
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import Any, NamedTuple, cast

import numpy as np

from benchmarks.common import CONFIG, parser_of
from ehls_ros.arrays import Array
from ehls_ros.control.companions import COMPANIONS
from ehls_ros.control.companions.base import PLACE, Past, Upcoming
from ehls_ros.control.controllers.base import FORESEEN, ROW
from ehls_ros.experiments.loop import CHUNK, ClosedLoop, Given
from ehls_ros.experiments.spec import Spec, Use, load_rig, spec_from_mapping
from ehls_ros.physics.effects.coupling_stiffness import Parameters as Coupling
from ehls_ros.physics.rig import SENSED, EffectUse, Rig, rig_to_mapping
from ehls_ros.physics.sensors import FORCE

CONTROL_PERIOD = 1e-3

FIRST = 2
"""Load cycles that do not count."""

BOUND = 1.1
"""Ratio that must not be exceeded."""


class Case(NamedTuple):
    """Configuration of a case.

    Attributes:
        kind: of disturbance.
        text: description of the disturbance.
        spec: law and rig; its signals are not used.
        period: of the load cycle [cycles].
        wanted: reference with its two derivatives, shape (n, 3).
        disturbance: force, its rate, displacement, velocity, shape (n, 4).
        later: rigs that the loader becomes, each from a cycle on.
        method: of learning.
    """

    kind: str
    text: str
    spec: Spec
    period: int
    wanted: Array
    disturbance: Array
    later: tuple[tuple[int, Rig], ...]
    method: str


class Outcome(NamedTuple):
    """One run.

    Attributes:
        error: true force error by load cycle, shape (load cycles, samples) [N].
        report: the companions' report at the end.
    """

    error: Array
    report: dict[str, float | str]


def simulate(case: Case, companions: Sequence[Use], noise: int) -> Outcome:
    """Run a case with some companions, on one seed of the noise."""
    loop = ClosedLoop(case.spec._replace(companions=tuple(companions)), check=False)
    normal = np.random.default_rng(noise).standard_normal((len(case.wanted), len(SENSED)))
    place, actuator = np.full((CHUNK, PLACE), np.nan), np.full((CHUNK, 3), np.nan)
    record, error = np.empty((CHUNK, loop.columns.status.stop)), np.empty(len(case.wanted))
    later, company, first = list(case.later), loop.company, 0
    while first < len(error):
        if later and first >= later[0][0]:
            loop.become(later.pop(0)[1])
        count = min(CHUNK, len(error) - first, later[0][0] - first if later else CHUNK)
        if company:
            count = company.room(first, place[:count])
        wanted = case.wanted[first : first + count]
        rows = np.full((count, ROW), np.nan)
        rows[:, :FORESEEN] = wanted
        company.ahead(Upcoming(first, rows, place[:count], actuator[:count]))
        plant, control = loop._plant, loop._control  # noqa: SLF001
        step = loop._run_compiled  # noqa: SLF001
        for i in range(count):
            k, one = first + i, slice(i, i + 1)
            given = Given(normal[k : k + 1], rows[one], case.disturbance[k : k + 1])
            step(k, plant.constants, plant.state, control, given, record[one])
            error[k] = plant.state.truth[FORCE] - wanted[i, 0]
        if company:
            past = Past(
                first,
                rows,
                wanted,
                place[:count],
                record[:count, loop.columns.measured],
                record[:count, loop.columns.command],
                record[:count, loop.columns.status],
            )
            loop._control = control._replace(model=company.done(past, control.model))  # noqa: SLF001
        first += count
    return Outcome(error.reshape(-1, case.period), company.report())


LAWS = ("fasmc_predictive", "fasmc_output_feedback", "fasmc_predictive", "sic", "fasmc_predictive", "fasmc")
METHODS = ("waveform", "harmonics", "waveform", "peak_valley")
PERIODS = (0.5, 1.0, 2.0, 4.0)
"""Length of the load cycles [s]."""
DURATION, LEAST_LOAD_CYCLES = 16.0, 10
STIFFNESS, DAMPING = 2e6, 2e3
"""Coupling to the servo, if any [N/m, N s/m]."""


class Line(NamedTuple):
    """A sine.

    Attributes:
        size: amplitude.
        frequency: [Hz].
        phase: [rad].
    """

    size: float
    frequency: float
    phase: float


class Draft:
    """A case under construction, modified by its kind.

    Attributes:
        random: numbers that the kind draws.
        period: of the load cycle [s].
        t: times of the cycles, and of one more [s].
        coupled: whether the actuator under test is a position servo.
        motion: lines of its command [m].
        force: lines of a force on the piston [N].
        added: additional force, shape (n + 1,) [N].
        scale: of motion and force lines, shape (n + 1,) or 1.
        wanted: lines of the reference [N].
        mean: of the reference [N].
        wanted_scale: of these lines, shape (n + 1,) or 1.
        noise: of the sensors, relative to the usual one.
        later: rigs to come, as changes of a rig at a time [s].
        text: description of the kind's changes.
    """

    def __init__(self, random: np.random.Generator) -> None:
        """Draw the values common to all kinds."""
        self.random = random
        self.period = float(random.choice(PERIODS))
        cycles = max(LEAST_LOAD_CYCLES, math.ceil(DURATION / self.period))
        self.t = cast(Array, np.arange(cycles * round(self.period / CONTROL_PERIOD) + 1) * CONTROL_PERIOD)
        self.load_cycles = cycles
        self.coupled = bool(random.random() < 0.5)
        self.motion: list[Line] = []
        self.force: list[Line] = []
        self.added = np.zeros(len(self.t))
        self.scale: Array | float = 1.0
        self.shift: Array = np.zeros(len(self.t))
        self.mean = float(random.uniform(-5e3, 5e3))
        self.wanted = [Line(*self._wanted())] if random.random() < 0.7 else []
        self.wanted_scale: Array | float = 1.0
        self.noise = 1.0
        self.later: list[tuple[float, Callable[[Rig], Rig]]] = []
        self.text = ""

    def _wanted(self) -> tuple[float, float, float]:
        slowest = 1.0 / self.period
        frequency = slowest * int(self.random.integers(1, max(2, 1 + int(1.0 / slowest))))
        size = self.random.uniform(1e3, 8e3) * min(1.0, 0.7 / frequency)
        return size, frequency, self.angle()

    def angle(self) -> float:
        """Return a phase [rad]."""
        return float(self.random.uniform(0.0, 2.0 * math.pi))

    def harmonic(self, highest: float) -> float:
        """Return a frequency in step with the load cycle [Hz]."""
        return int(self.random.integers(1, max(2, 1 + int(highest * self.period)))) / self.period

    def in_step(self, size: float = 1.0) -> None:
        """Make the actuator under test move in step with the load cycle."""
        if self.coupled:
            frequency = self.harmonic(1.0)
            self.motion.append(Line(size * self.random.uniform(0.02, 0.1) * min(1.0, 1.0 / frequency), frequency, self.angle()))
        else:
            for _ in range(int(self.random.integers(1, 4))):
                frequency = self.harmonic(4.0)
                most = 4e3 / max(1.0, frequency) ** 1.5
                self.force.append(Line(size * self.random.uniform(0.2, 1.0) * most, frequency, self.angle()))

    def line(self, frequency: float) -> Line:
        """Return a force of a given frequency [Hz] that a law can hold."""
        most = 1.5e3 / max(1.0, frequency / 2.0)
        made = Line(float(np.exp(self.random.uniform(math.log(0.05), 0.0))) * most, frequency, self.angle())
        self.force.append(made)
        self.text += f" {made.size:.0f} N at {frequency:.4g} Hz (turns {frequency * self.period % 1.0:.3f})"
        return made

    def when(self) -> float:
        """Return the time of an event, with load cycles before and after it [s]."""
        return float(self.random.uniform(3.0, self.load_cycles - 3.0)) * self.period

    def at(self, time: float, value: float, before: float = 1.0) -> Array:
        """Return a value that changes at a time."""
        return np.where(self.t < time, before, value)

    def case(self, kind: str, law: str, method: str) -> Case:
        """Return the case."""
        n = len(self.t) - 1
        motion = self.scale * _sum(self.motion, self.t + self.shift)
        force = self.scale * _sum(self.force, self.t + self.shift) + self.added
        disturbance = np.zeros((n, 4))
        for column, signal in ((0, force), (2, motion)):
            disturbance[:, column], disturbance[:, column + 1] = signal[:-1], np.diff(signal) / CONTROL_PERIOD
        scale = np.broadcast_to(self.wanted_scale, self.t.shape)
        wanted = np.column_stack([scale * _sum(self.wanted, self.t, derivative) for derivative in range(3)])[:-1]
        wanted[:, 0] += self.mean
        spec = self._spec(law)
        later, rig = [], spec.loader_rig()
        for time_, change in self.later:
            rig = change(rig)
            later.append((round(time_ / CONTROL_PERIOD), rig))
        about = f"{law} {method} {self.period:g} s {'coupled' if self.coupled else 'free'}:{self.text}"
        return Case(kind, about, spec, round(self.period / CONTROL_PERIOD), wanted, disturbance, tuple(later), method)

    def _spec(self, law: str) -> Spec:
        perfect = law in PERFECT
        rig = rig_to_mapping(load_rig(CONFIG / ("rig_paper.yaml" if perfect else "rig_paper_measured.yaml")))
        for sensor in rig["sensors"].values():
            sensor["noise_std"] *= self.noise
        coupling = {"stiffness": STIFFNESS, "damping": DAMPING} if self.coupled else {"stiffness": 0.0, "damping": 0.0}
        effects: list[dict[str, Any]] = [{"name": "coupling_stiffness", **coupling}]
        if not perfect:
            effects.append({"name": "command_delay", "delay": 1e-3})
        controller: dict[str, Any] = {"name": law}
        if law == "fasmc_output_feedback":
            controller |= {f"coupling_{name}": value for name, value in coupling.items()}
        data = {
            "rig": rig,
            "effects": effects,
            "known_effects": [use["name"] for use in effects],
            "reference": "constant",
            "controller": controller,
        }
        return spec_from_mapping(data, law, CONFIG)


PERFECT = ("fasmc", "sic")
"""Laws that need the paper's sensors."""


def _sum(lines: Sequence[Line], t: Array, derivative: int = 0) -> Array:
    total = np.zeros(len(t))
    for line in lines:
        omega = 2.0 * math.pi * line.frequency
        total += line.size * omega**derivative * np.sin(omega * t + line.phase + 0.5 * math.pi * derivative)
    return total


def in_step(draft: Draft) -> None:
    """A disturbance that repeats completely."""
    draft.in_step()


def out_of_step(draft: Draft) -> None:
    """One line at a frequency unrelated to the load cycle."""
    if draft.random.random() < 0.5:
        draft.in_step()
    draft.line(float(np.exp(draft.random.uniform(math.log(0.3), math.log(15.0)))))


def nearly_in_step(draft: Draft) -> None:
    """A line whose phase turns slowly from load cycle to load cycle."""
    if draft.random.random() < 0.5:
        draft.in_step()
    turn = float(np.exp(draft.random.uniform(math.log(0.004), math.log(0.1)))) * draft.random.choice([-1.0, 1.0])
    draft.line(draft.harmonic(8.0) + turn / draft.period)


def every_other(draft: Draft) -> None:
    """A line that repeats every second, third or fourth load cycle."""
    if draft.random.random() < 0.5:
        draft.in_step()
    draft.line(
        draft.harmonic(8.0) + float(draft.random.choice([1.0 / 2.0, 1.0 / 3.0, 2.0 / 3.0, 1.0 / 4.0, 1.0 / 6.0])) / draft.period
    )


def several(draft: Draft) -> None:
    """Lines in step and out of it."""
    draft.in_step()
    for _ in range(int(draft.random.integers(2, 5))):
        draft.line(float(np.exp(draft.random.uniform(math.log(0.3), math.log(15.0)))))


def steps(draft: Draft) -> None:
    """Steps at any time."""
    draft.in_step()
    size, rate = float(np.exp(draft.random.uniform(math.log(30.0), math.log(1e3)))), draft.random.uniform(0.3, 2.0)
    times = np.sort(draft.random.uniform(0.0, draft.t[-1], int(rate * draft.t[-1])))
    levels = size * draft.random.uniform(-1.0, 1.0, len(times) + 1)
    draft.added += levels[np.searchsorted(times, draft.t)]
    draft.text += f" steps to {size:.0f} N, {rate:.2f} per s"


def drift(draft: Draft) -> None:
    """The repeating part grows, fades, or shifts later and later."""
    draft.in_step()
    end = draft.t[-1]
    what = int(draft.random.integers(3))
    if what == 0:
        factor = float(draft.random.choice([0.2, 0.5, 1.5, 2.0]))
        draft.scale = 1.0 + (factor - 1.0) * draft.t / end
        draft.text += f" scale to {factor:g}"
    elif what == 1:
        late = float(draft.random.uniform(-0.3, 0.3)) * draft.period
        draft.shift = late * draft.t / end
        draft.text += f" {late:.3g} s later at the end"
    else:
        size = float(draft.random.uniform(-2e3, 2e3))
        draft.added += size * draft.t / end
        draft.text += f" mean force to {size:.0f} N"


def stiffness(draft: Draft) -> None:
    """The specimen cracks."""
    draft.coupled = True
    draft.in_step()
    when, share = draft.when(), float(draft.random.uniform(0.3, 0.7))

    def cracked(rig: Rig) -> Rig:
        softer = Coupling((1.0 - share) * STIFFNESS, DAMPING)
        changed = (EffectUse(use.name, softer) if use.name == "coupling_stiffness" else use for use in rig.effects)
        return rig._replace(effects=tuple(changed))

    draft.later.append((when, cracked))
    draft.text += f" stiffness -{100 * share:.0f} % at {when / draft.period:.2f} load cycles"


def friction(draft: Draft) -> None:
    """The friction changes."""
    draft.in_step()
    when, factor = draft.when(), float(draft.random.choice([0.1, 0.3, 0.5, 1.5]))

    def slippery(rig: Rig) -> Rig:
        names = ("coulomb_force", "static_force", "viscous_coefficient")
        return rig._replace(friction=rig.friction._replace(**{name: factor * getattr(rig.friction, name) for name in names}))

    draft.later.append((when, slippery))
    draft.text += f" friction x {factor:g} at {when / draft.period:.2f} load cycles"


def load(draft: Draft) -> None:
    """The actuator under test moves less or more, at once, or stops; or jumps ahead in its motion."""
    draft.in_step()
    when = draft.when()
    if draft.random.random() < 0.5:
        factor = float(draft.random.choice([0.0, 0.5, 0.8, 1.3]))
        at = when if not draft.coupled else math.ceil(when / draft.period) * draft.period
        # A motion cannot jump: it is blended.
        lead = np.clip((draft.t - at) / (0.2 if draft.coupled else 0.01), 0.0, 1.0)
        draft.scale = 1.0 + (factor - 1.0) * lead**2 * (3.0 - 2.0 * lead)
        draft.text += f" load x {factor:g} at {at / draft.period:.2f} load cycles"
    else:
        late = float(draft.random.uniform(0.02, 0.5)) * draft.period
        lead = np.clip((draft.t - when) / max(0.2, 2.0 * late), 0.0, 1.0)
        draft.shift = -late * lead**2 * (3.0 - 2.0 * lead)
        draft.text += f" {late:.3g} s later from {when / draft.period:.2f} load cycles on"


def noise(draft: Draft) -> None:
    """Sensors are noisy, or the force is."""
    draft.in_step()
    if draft.random.random() < 0.4:
        draft.noise = float(draft.random.uniform(1.5, 6.0))
        draft.text += f" noise x {draft.noise:.1f}"
        return
    size, corner = float(np.exp(draft.random.uniform(math.log(5.0), math.log(300.0)))), float(draft.random.uniform(1.0, 20.0))
    white, value = draft.random.standard_normal(len(draft.t)), np.zeros(len(draft.t))
    keep = math.exp(-2.0 * math.pi * corner * CONTROL_PERIOD)
    first = second = 0.0
    for i, w in enumerate(white):
        first = keep * first + (1.0 - keep) * w
        second = keep * second + (1.0 - keep) * first
        value[i] = second
    draft.added += size * value / np.std(value)
    draft.text += f" random force of {size:.0f} N rms to {corner:.1f} Hz"


def reference(draft: Draft) -> None:
    """The programme changes."""
    draft.in_step()
    draft.wanted = draft.wanted or [Line(3e3 * min(1.0, draft.period), 1.0 / draft.period, draft.angle())]
    when = math.ceil(draft.when() / draft.period) * draft.period
    factor = float(draft.random.choice([0.0, 0.5, 0.9, 1.01, 1.05, 1.4]))
    lead = np.clip((draft.t - when) / 0.5, 0.0, 1.0)
    draft.wanted_scale = 1.0 + (factor - 1.0) * lead**3 * (10.0 - 15.0 * lead + 6.0 * lead**2)
    draft.text += f" reference x {factor:g} from load cycle {when / draft.period:.0f} on"


KINDS: dict[str, Callable[[Draft], None]] = {
    kind.__name__: kind
    for kind in (
        in_step,
        out_of_step,
        nearly_in_step,
        every_other,
        several,
        steps,
        drift,
        stiffness,
        friction,
        load,
        noise,
        reference,
    )
}


def drawn(seed: int, number: int, kinds: Sequence[str], laws: Sequence[str], methods: Sequence[str]) -> Case:
    """Return a random case."""
    random = np.random.default_rng([seed, number])
    kind = kinds[number % len(kinds)]
    draft = Draft(random)
    KINDS[kind](draft)
    law, method = str(random.choice(laws)), str(random.choice(methods))
    return draft.case(kind, law, method)


class Ratios(NamedTuple):
    """Errors with learning over those without."""

    peak: float
    cycle: float
    rms: float


class Judged(NamedTuple):
    """A case, judged.

    Attributes:
        kind, text: the case's.
        ratios: worst of them.
        worst: number of the load cycle with the largest ratio.
        with_peaks, without_peaks: largest error of each load cycle, mean of the seeds [N].
        report: of the last run.
    """

    kind: str
    text: str
    ratios: Ratios
    worst: int
    with_peaks: Array
    without_peaks: Array
    report: dict[str, float | str]
    wall: float


def judge(case: Case, noises: Sequence[int]) -> Judged:
    """Run a case with and without learning."""
    began = time.monotonic()
    parameters = COMPANIONS.load("learning").Parameters(method=case.method, period=case.period * CONTROL_PERIOD)
    bare = [simulate(case, (), noise) for noise in noises]
    learnt = [simulate(case, (Use("learning", parameters),), noise) for noise in noises]
    peaks = [np.mean([np.abs(run.error[FIRST:]).max(axis=1) for run in runs], axis=0) for runs in (learnt, bare)]
    rms = [np.sqrt(np.mean([np.mean(run.error[FIRST:] ** 2, axis=1) for run in runs], axis=0)) for runs in (learnt, bare)]
    largest = [float(np.mean([np.abs(run.error[FIRST:]).max() for run in runs])) for runs in (learnt, bare)]
    by_cycle, by_rms = peaks[0] / peaks[1], rms[0] / rms[1]
    ratios = Ratios(largest[0] / largest[1], float(by_cycle.max()), float(by_rms.max()))
    worst = FIRST + int(np.argmax(by_cycle))
    wall = time.monotonic() - began
    return Judged(case.kind, case.text, ratios, worst, peaks[0], peaks[1], learnt[-1].report, wall)


def _judged(args: tuple[int, int, Sequence[str], Sequence[str], Sequence[str], Sequence[int]]) -> Judged:
    seed, number, kinds, laws, methods, noises = args
    return judge(drawn(seed, number, kinds, laws, methods), noises)


def main() -> None:
    """Run the requested cases, and print the ratios."""
    parser = parser_of(__doc__)
    parser.add_argument("--cases", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--noises", type=int, default=3)
    parser.add_argument("--kinds", nargs="+", default=list(KINDS), choices=list(KINDS))
    parser.add_argument("--laws", nargs="+", default=LAWS, choices=sorted(set(LAWS)))
    parser.add_argument("--methods", nargs="+", default=METHODS, choices=sorted(set(METHODS)))
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--only", type=int, nargs="*", help="numbers of the cases to run, in full")
    args = parser.parse_args()
    began = time.monotonic()
    numbers = range(args.cases) if args.only is None else args.only
    tasks = [(args.seed, n, args.kinds, args.laws, args.methods, range(args.noises)) for n in numbers]
    found: list[tuple[int, Judged]] = []
    with ProcessPoolExecutor(args.jobs, get_context("spawn")) as pool:
        for number, judged in zip(numbers, pool.map(_judged, tasks), strict=True):
            found.append((number, judged))
            r = judged.ratios
            flag = " <<<" if max(r) > BOUND else ""
            print(
                f"{number:4d} {r.peak:5.2f} {r.cycle:5.2f} {r.rms:5.2f} {judged.wall:5.1f}s {judged.kind}: {judged.text}{flag}",
                flush=True,
            )
            if args.only is not None:
                print("   with   ", " ".join(f"{v:.1f}" for v in judged.with_peaks))
                print("   without", " ".join(f"{v:.1f}" for v in judged.without_peaks))
                print("   ", judged.report)
    print(f"{time.monotonic() - began:.0f} s")


if __name__ == "__main__":
    main()
