"""Many trajectories side by side: compiled lanes compared with C, the kernel one by one, and other solvers.

First the plant alone, under commands that are the same for all rigs; then whole experiments. All contestants of a table take
turns, and ratios are within a turn, so that other work on the machine affects all alike. Times are processor times, except for
two threads. These are compared with one thread by wall time, which is meaningful only on a machine with two idle processors.

The other solvers run the same equations with modes chosen in each evaluation instead of at located events, as is usual with
them: SciPy's LSODA, a rig at a time, with compiled equations; and diffrax with fixed steps, vectorised by ``jax.vmap``.
Diffrax is not among the package's extras; its entry is left empty where it is not installed.
"""

import argparse
import importlib
import importlib.util
import os
import platform
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import numba
import numpy as np
from scipy.integrate import solve_ivp

from benchmarks.common import EXPERIMENTS, RIG, in_turns, parser_of, quartiles
from benchmarks.kernel_vs_c import PERIOD, CKernel, Motion, NumbaKernel, at_rest, motions
from ehls_ros.arrays import Array, kernel_no_refcount
from ehls_ros.experiments.batch import run_batch
from ehls_ros.experiments.loop import run_in_process
from ehls_ros.experiments.spec import Spec, load_rig, load_spec
from ehls_ros.physics.cylinder import double_rod
from ehls_ros.physics.friction import gms
from ehls_ros.physics.integration import WORK_ROWS
from ehls_ros.physics.integration_step import LONGEST_STEP
from ehls_ros.physics.lane_memory import LANES, Rows, column, flat, numbers, numbers_in
from ehls_ros.physics.lanes import LaneRows, lanes_integrator
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.plant import FD, FD_RATE, FRICTION, INPUTS, START, Coefficients, U, system
from ehls_ros.physics.rig import Rig
from ehls_ros.physics.servo import NO_EFFECTS
from ehls_ros.physics.simulator import ORDER
from ehls_ros.physics.valve import load_flow

ELEMENTS = 3
SIZE, MODES = FRICTION + ELEMENTS, 1 + ELEMENTS
STEPS = round(PERIOD / LONGEST_STEP)
VARIED = ("supply_pressure", "bulk_modulus", "total_volume", "moving_mass", "viscous_damping", "valve_bandwidth")
NATIVE = ("cc", "-O3", "-march=native")
TWIN = "C -march=native"
BRIEF = 200
"""Number of cycles sufficient to time SciPy."""
TOLERANCES = np.array([1e-9, 1e-8, 10.0, 1e-10, 1e-3, 1e-3, 1e-3])
TURNING_SPEED = 1e-5
"""Velocity range over which the other solvers' direction of motion changes [m/s]."""


def rigs_like(rig: Rig, count: int) -> list[Rig]:
    """Return rigs whose coefficients are within 10 % of a rig's; the first is that rig."""
    random = np.random.default_rng(2018)
    made = [rig]
    while len(made) < count:
        plant = {key: getattr(rig.plant, key) * random.uniform(0.9, 1.1) for key in VARIED}
        coulomb = rig.friction.coulomb_force * random.uniform(0.9, 1.1)
        made.append(rig._replace(plant=rig.plant._replace(**plant), friction=rig.friction._replace(coulomb_force=coulomb)))
    return made[:count]


def sine_fd2(spec: Spec, cycles: int) -> Array:
    """Return the inputs of the plant in Table 3's sine with fd2, as in the closed loop."""
    run = run_in_process(spec)
    rows = [run[name][:cycles] for name in ("valve_command_m", "disturbance_force_n")]
    rates = np.gradient(rows[1], PERIOD)
    return np.column_stack([*rows, rates, run.time_s[:cycles]])


def creeping(cycles: int) -> Array:
    """Return the inputs of a slow reciprocating motion in which the elements stick and slip: a command of 20 µm at 5 Hz."""
    t = np.arange(cycles) * PERIOD
    return np.column_stack([2e-5 * np.sin(10.0 * np.pi * t), 0.0 * t, 0.0 * t, t])


class Known(NamedTuple):
    """The constants of a lane."""

    plant: Plant
    friction: Any


class Lanes:
    """The package's lane kernel, which runs rigs side by side."""

    def __init__(self, rigs: list[Rig]) -> None:
        """Compile, and fill the blocks."""
        rows = Rows()
        self._rows = LaneRows.of(rows, SIZE, MODES)
        inputs, known = rows.take(INPUTS), rows.take(numbers_in((rigs[0].plant, rigs[0].friction)))
        self._like = Known(rigs[0].plant, rigs[0].friction)
        blocks = -(-len(rigs) // LANES)
        self._blocks = np.zeros((blocks, rows.count, LANES))
        own = np.array([flat(Known(rig.plant, rig.friction)) for rig in rigs + rigs[:1] * (blocks * LANES - len(rigs))])
        self._blocks[:, known:] = own.reshape(blocks, LANES, -1).swapaxes(1, 2)
        self._run = _lanes_kernel(self._rows, inputs, known)
        self._work = [np.empty((WORK_ROWS, SIZE)) for _ in range(blocks)]

    def reset(self) -> None:
        """Bring all rigs to rest."""
        self._blocks[:, self._rows.y : self._rows.y + SIZE] = 0.0
        self._blocks[:, self._rows.mode : self._rows.mode + MODES] = 0.0
        self._blocks[:, self._rows.mode] = 1.0

    def run(self, motion: Motion, threads: int = 1) -> None:
        """Run a motion with all rigs."""

        def block(index: int) -> None:
            self._run(self._blocks[index].reshape(-1), self._like, motion.inputs, motion.steps, self._work[index])

        if threads == 1:
            for index in range(len(self._blocks)):
                block(index)
        else:
            with ThreadPoolExecutor(threads) as pool:
                list(pool.map(block, range(len(self._blocks))))

    def state(self, index: int) -> Array:
        """Return a rig's state."""
        state: Array = self._blocks[index // LANES, self._rows.y : self._rows.y + SIZE, index % LANES]
        return state


def _lanes_kernel(rows: LaneRows, inputs: int, known: int) -> Callable[..., None]:
    """Return the compiled run of a block."""
    evaluate, switch = system(double_rod, load_flow, gms, ELEMENTS, NO_EFFECTS)
    inputs_of, nothing = column(INPUTS), column(0)

    @kernel_no_refcount
    def coefficients(block: Array, like: Known, lane: int) -> Coefficients:
        c, w = numbers(like, block, known, lane), inputs_of(block, inputs, lane)
        return Coefficients(c.plant, c.friction, w, nothing(block, inputs, lane), w[U], (), ())

    advance = lanes_integrator(evaluate, switch, coefficients, rows, SIZE, MODES, order=ORDER)

    @numba.njit(error_model="numpy", nogil=True)
    def run(block: Array, like: Known, commands: Array, steps: int, work: Array) -> None:
        for k in range(len(commands)):
            for lane in range(LANES):
                w = inputs_of(block, inputs, lane)
                w[U], w[FD], w[FD_RATE], w[START] = commands[k]
            advance(commands[k, 3], block, like, LONGEST_STEP, steps, work)

    compiled: Callable[..., None] = run
    return compiled


def equations(xp: Any) -> Callable[..., list[Any]]:
    """Return the paper's equations for other solvers, written with the functions of a module like NumPy.

    The modes follow from the state: an element slips where its force has reached its share of the level. The direction of
    motion changes over a small velocity range, as a variable-step solver would hardly advance otherwise.
    """

    def rates(y: Any, u: Any, load: Any, p: Any, f: Any, k: Any, a: Any) -> list[Any]:
        x, v, pressure, spool = y[0], y[1], y[2], y[3]
        level = f[0] + (f[1] - f[0]) * xp.exp(-(xp.abs(v / f[2]) ** f[3]))
        drop = p[0] - xp.sign(spool) * pressure
        flow = p[3] * p[4] * spool * xp.sign(drop) * xp.sqrt(xp.abs(drop) / p[1])
        direction = xp.tanh(v / TURNING_SPEED)
        friction = f[4] * v + y[4] + y[5] + y[6]
        made = [
            v,
            (p[8] * pressure - p[11] * v - p[10] * x - p[7] * p[14] - load - friction) / p[7],
            4.0 * p[2] / p[6] * (flow - p[8] * v - p[5] * pressure),
            p[12] * (p[13] * u - spool),
        ]
        for i in range(3):
            slips = 1.0 * (direction * y[4 + i] >= a[i] * level)
            made.append(slips * f[5] * (direction * a[i] - y[4 + i] / level) + (1.0 - slips) * k[i] * v)
        return made

    return rates


def rig_constants(rig: Rig) -> tuple[Array, Array, Array, Array]:
    """Return a rig's coefficients as the arguments ``p``, ``f``, ``k`` and ``a`` of :func:`equations`."""
    f = rig.friction
    rest = [f.coulomb_force, f.static_force, f.stribeck_velocity, f.stribeck_exponent, f.viscous_coefficient, f.attraction_rate]
    return np.array(rig.plant), np.array(rest), np.array(f.element_stiffness), np.array(f.element_weight)


class SciPy:
    """LSODA, a rig at a time."""

    def __init__(self, rigs: list[Rig]) -> None:
        """Compile the equations."""
        rates = numba.njit(equations(np))

        @numba.njit
        def right(t: float, y: Array, commands: Array, p: Array, f: Array, k: Array, a: Array) -> Array:
            i = min(int(t / PERIOD), len(commands) - 1)
            load = commands[i, 1] + commands[i, 2] * (t - commands[i, 3])
            made = np.empty(7)
            for place, value in enumerate(rates(y, commands[i, 0], load, p, f, k, a)):
                made[place] = value
            return made

        self._right, self._rigs = right, [rig_constants(rig) for rig in rigs]

    def run(self, motion: Motion) -> None:
        """Run a motion with all rigs."""
        for rig in self._rigs:
            span, given = (0.0, len(motion.inputs) * PERIOD), (motion.inputs, *rig)
            solve_ivp(self._right, span, np.zeros(7), "LSODA", args=given, max_step=PERIOD, rtol=1e-6, atol=TOLERANCES)


class Diffrax:
    """Tsit5 with the package's step, all rigs at once on one processor."""

    def __init__(self, rigs: list[Rig]) -> None:
        """Prepare."""
        os.environ.setdefault("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false")
        diffrax, jax = importlib.import_module("diffrax"), importlib.import_module("jax")
        jax.config.update("jax_enable_x64", True)
        jnp, rates = jax.numpy, equations(jax.numpy)

        def one(p: Any, f: Any, k: Any, a: Any, commands: Any) -> Any:
            def right(t: Any, y: Any, _: Any) -> Any:
                row = commands[jnp.minimum((t / PERIOD).astype(int), len(commands) - 1)]
                return jnp.stack(rates(y, row[0], row[1] + row[2] * (t - row[3]), p, f, k, a))

            return diffrax.diffeqsolve(
                diffrax.ODETerm(right), diffrax.Tsit5(), 0.0, len(commands) * PERIOD, LONGEST_STEP, jnp.zeros(7),
                stepsize_controller=diffrax.ConstantStepSize(), max_steps=len(commands) * STEPS + 10,
                adjoint=diffrax.ForwardMode(),
            ).ys  # fmt: skip

        self._run = jax.jit(jax.vmap(one, in_axes=(0, 0, 0, 0, None)))
        self._rigs = [jnp.array(np.stack(column_)) for column_ in zip(*map(rig_constants, rigs), strict=True)]

    def run(self, motion: Motion) -> None:
        """Run a motion with all rigs."""
        self._run(*self._rigs, motion.inputs).block_until_ready()


def shown(times: dict[str, Array], unit: float, per: str, reference: str, counts: dict[str, int]) -> Iterator[str]:
    """Return the lines of a table: medians per unit of work, and how many times faster than a reference, with quartiles."""
    yield f"{'':34}{per:>12}{f'x {reference} (quartiles)':>30}"
    each = {name: values / counts[name] for name, values in times.items()}
    for name, values in each.items():
        yield f"{name:34}{np.median(values) * unit:12.4g}{quartiles(each[reference] / values, '.3f'):>30}"


def plants(rig: Rig, options: argparse.Namespace, folder: Path) -> None:
    """Print the tables of the plant alone."""
    cycles = 200 if options.quick else 500
    large = motions(cycles * PERIOD)[0]
    spec = load_spec(EXPERIMENTS / "sine_fd2.yaml")
    contestants = NumbaKernel(rig), CKernel(rig, NATIVE, folder)
    for motion, count in (
        (Motion("large sine", large.inputs, STEPS), 200 if options.quick else 1000),
        (Motion("Table 3 sine-fd2", sine_fd2(spec, 4 * cycles), STEPS), LANES),
        (Motion("stick-slip", creeping(4 * cycles), STEPS), LANES),
    ):
        plant(motion, rigs_like(rig, count), *contestants, options)


def plant(motion: Motion, rigs: list[Rig], ours: NumbaKernel, twin: CKernel, options: argparse.Namespace) -> None:
    """Print the table of one motion of some rigs."""
    lanes, steps = Lanes(rigs), len(motion.inputs) * motion.steps
    # Contestants that take rigs one by one run only as many as are needed for timing.
    some, many, brief = rigs[:LANES], rigs[: 4 * LANES], motion._replace(inputs=motion.inputs[:BRIEF])

    def together(threads: int) -> None:
        lanes.reset()
        lanes.run(motion, threads)

    contestants: dict[str, Callable[[], None]] = {
        TWIN: lambda: singles(twin, some, motion),
        "numba, one by one": lambda: singles(ours, some, motion),
        "lanes": lambda: together(1),
    }
    counts = dict(zip(contestants, (len(some) * steps, len(some) * steps, len(rigs) * steps), strict=True))
    if not options.own:
        scipy = SciPy(rigs[:1])
        contestants["SciPy LSODA"] = lambda: scipy.run(brief)
        counts["SciPy LSODA"] = len(brief.inputs) * motion.steps
        if importlib.util.find_spec("diffrax"):
            diffrax = Diffrax(many)
            contestants["diffrax, vmap"] = lambda: diffrax.run(motion)
            counts["diffrax, vmap"] = len(many) * steps
    times = in_turns(contestants, options.runs, time.process_time)
    print(f"\n{motion.name}: {len(rigs)} rigs, {steps} steps each")
    print("\n".join(shown(times, 1e9, "ns/step", TWIN, counts)))
    print(f"greatest difference between lanes and one by one: {difference(lanes, ours, some, motion):g}")
    if len(rigs) > LANES:
        two_threads(together, options.runs)


def two_threads(work: Callable[[int], None], runs: int) -> None:
    """Print the gain from a second thread: in wall time, and in processor time, which is more meaningful on a busy machine."""
    for clock, what in ((time.perf_counter, "wall time"), (time.process_time, "processor time, of two threads together")):
        times = in_turns({"one": lambda: work(1), "two": lambda: work(2)}, runs, clock)
        print(f"one thread over two, {what}: {quartiles(times['one'] / times['two'], '.2f')}")


def singles(kernel: NumbaKernel | CKernel, rigs: list[Rig], motion: Motion) -> None:
    """Run a motion with several rigs, one after another."""
    for rig in rigs:
        at_rest(kernel)
        kernel.become(rig)
        kernel.run(motion)


def difference(lanes: Lanes, kernel: NumbaKernel, rigs: list[Rig], motion: Motion) -> float:
    """Return the greatest difference of any state at the end."""
    lanes.reset()
    lanes.run(motion)
    worst = 0.0
    for index, rig in enumerate(rigs):
        singles(kernel, [rig], motion)
        worst = max(worst, float(np.abs(lanes.state(index) - kernel.y).max()))
    return worst


def experiments(options: argparse.Namespace) -> None:
    """Print the table of whole experiments."""
    base = load_spec(EXPERIMENTS / "sine_fd2.yaml")
    base = base._replace(settings=base.settings._replace(duration=2.0 if options.quick else 10.0))
    specs = [
        base._replace(rig=rig, settings=base.settings._replace(seed=seed))
        for seed, rig in enumerate(rigs_like(base.rig, 2 * LANES))
    ]

    def one_by_one() -> None:
        for spec in specs[:4]:
            run_in_process(spec)

    def batch(threads: int) -> None:
        for _, result in run_batch(specs, threads=threads):
            if isinstance(result, Exception):
                raise result

    contestants = {"one by one": one_by_one, "batch": lambda: batch(1)}
    counts = {"one by one": 4, "batch": len(specs)}
    print(f"\nsine-fd2, FASMC II: whole experiments of {base.settings.duration:g} s, {len(specs)} rigs")
    print("\n".join(shown(in_turns(contestants, options.runs, time.process_time), 1e3, "ms/run", "one by one", counts)))
    two_threads(batch, options.runs)


def main() -> None:
    """Print the tables."""
    parser = parser_of(__doc__)
    parser.add_argument("--runs", type=int, default=11, help="turns of each contestant (%(default)s)")
    parser.add_argument("--quick", action="store_true", help="shorter motions")
    parser.add_argument("--own", action="store_true", help="without SciPy and diffrax")
    options = parser.parse_args()
    print(f"{platform.machine()}, numba {numba.__version__}, {LANES} lanes, step {LONGEST_STEP:g} s, {options.runs} turns")
    with tempfile.TemporaryDirectory() as folder:
        plants(load_rig(RIG), options, Path(folder))
    experiments(options)


if __name__ == "__main__":
    main()
