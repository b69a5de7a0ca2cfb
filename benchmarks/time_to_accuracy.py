"""Time to an error of 1e-4, of the simulator and of general solvers, on the four cases of test/physics/reference_solver.py.

Every solver takes the coarsest setting whose largest deviation from the reference, of any state relative to its range, is below
the bound. SciPy's solvers have the package's compiled equations, restart with each command, and end a call at each change of
mode. Diffrax has the equations of benchmarks/batch.py, whose modes follow from the state, compiled for one run of the whole
motion; only the generalised Maxwell slip cases are written for it.
"""

import importlib
import importlib.util
import os
import platform
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, NamedTuple

import numba
import numpy as np
import scipy
from scipy.integrate import solve_ivp

from benchmarks.batch import equations, rig_constants
from benchmarks.common import ROOT, in_turns, parser_of
from benchmarks.physics_accuracy import errors, rig_of
from ehls_ros.arrays import Array, in_python, kernel_no_refcount
from ehls_ros.physics import simulator
from ehls_ros.physics.composition import compiled
from ehls_ros.physics.plant import FRICTION, Chains, Coefficients, U, hold
from ehls_ros.physics.simulator import Constants, Simulator, State, at_rest

sys.path.insert(0, str(ROOT / "test" / "physics"))

from reference_solver import ABSOLUTE_TOLERANCE, FORCE_TOLERANCE, RELATIVE_TOLERANCE, Case, cases, solve

BOUND = 1e-4
STEPS = (1e-3, 5e-4, 1e-3 / 3.0, 2.5e-4, 1e-4)
METHODS = ("RK45", "DOP853", "LSODA")
TOLERANCES = (1e-3, 1e-4, 1e-5, 1e-6, 1e-7)
LATE = 1e-12
"""Event function value from which events count: for SciPy, a function that stays at zero crosses it all the time."""

BRIEFLY = 1e-9
"""Time past a located event at which the mode changes [s]: where it is found, its function may still be negative."""

MOST_CHANGES = 20
"""Maximum number of mode changes in a cycle; a solver that finds more chatters between two modes."""


class Stuck(Exception):
    """Raised if a solver does not get past a change of mode."""


Solver = Callable[[float], Array]
"""Returns the states at the cycles, shape (cycles + 1, states), for a step [s] or a tolerance."""


class Equations(NamedTuple):
    """The compiled ``evaluate`` and ``switch`` of a plant."""

    evaluate: Callable[..., float]
    switch: Callable[..., None]


def build(cylinder: Any, valve: Any, friction: Any, elements: int, states: int, chains: Chains) -> Equations:
    """Build a plant's equations for other solvers; arguments as those of :func:`ehls_ros.physics.simulator.build`."""
    plant = simulator.build(cylinder, valve, friction, elements, states, chains)
    evaluate, switch = plant.evaluate, plant.switch

    @kernel_no_refcount
    def evaluated(t: float, y: Array, constants: Constants, state: State, rate: Array) -> float:
        c = Coefficients(constants.plant, constants.friction, state.inputs, constants.effects, state.inputs[U], (), ())
        value: float = evaluate(t, y, state.mode, c, rate)
        return value

    @kernel_no_refcount
    def switched(t: float, y: Array, constants: Constants, state: State) -> None:
        c = Coefficients(constants.plant, constants.friction, state.inputs, constants.effects, state.inputs[U], (), ())
        switch(t, y, state.mode, c)

    return Equations(evaluated, switched)


ENTRIES = {"evaluate": "t, y, constants, state, rate", "switch": "t, y, constants, state"}


def ours(case: Case) -> Solver:
    """Return the simulator, called once per cycle."""
    rig, made = rig_of(case), dict[float, Simulator]()

    def run(step: float) -> Array:
        if step not in made:
            made[step] = Simulator(rig, case.period, step)
        one = made[step]
        one.state = at_rest(rig, case.period, step).state
        one.y, one.inputs, one.cycle = one.state.y, one.state.inputs, 0
        states = np.empty((len(case.inputs) + 1, one.y.size))
        states[0] = one.y
        for cycle, (u, force, rate) in enumerate(case.inputs.tolist(), start=1):
            one.advance(u, force, rate, 0.0, 0.0)
            states[cycle] = one.y
        return states

    return run


def with_scipy(case: Case, method: str) -> Solver:
    """Return a solver of SciPy."""
    rig = rig_of(case)
    prepared = at_rest(rig, case.period)
    parts, constants = prepared.parts, prepared.constants
    kernel = compiled(build, ENTRIES, **parts._asdict())
    scale = np.array([*ABSOLUTE_TOLERANCE, *[FORCE_TOLERANCE] * (prepared.state.y.size - FRICTION)]) / RELATIVE_TOLERANCE

    def run(tolerance: float) -> Array:
        state = at_rest(rig, case.period).state
        rate = np.empty(state.y.size)

        def right(t: float, y: Array) -> Array:
            kernel.evaluate(t, y, constants, state, rate)
            return rate.copy()

        def event(t: float, y: Array) -> float:
            value: float = kernel.evaluate(t, y, constants, state, rate)
            return value - LATE

        event.terminal, event.direction = True, 1.0  # type: ignore[attr-defined]
        y, states = state.y, [state.y.copy()]
        for cycle, (u, force, force_rate) in enumerate(case.inputs.tolist()):
            t, end = cycle * case.period, (cycle + 1) * case.period
            in_python(hold)(state.inputs, t, u, force, force_rate, 0.0, 0.0)
            changes = 0
            while t < end:
                if kernel.evaluate(t, y, constants, state, rate) > 0.0:
                    kernel.switch(t, y, constants, state)
                part = solve_ivp(right, (t, end), y, method=method, rtol=tolerance, atol=scale * tolerance, events=event)
                if part.status < 0:
                    raise RuntimeError(part.message)
                y, t = part.y[:, -1].copy(), float(part.t[-1])
                if part.status == 1:
                    y, t, changes = y + BRIEFLY * right(t, y), t + BRIEFLY, changes + 1
                if changes > MOST_CHANGES:
                    raise Stuck
            states.append(y.copy())
        return np.array(states)

    return run


def with_diffrax(case: Case) -> Solver:
    """Return Tsit5 of Diffrax, with steps controlled by their error."""
    os.environ.setdefault("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false")
    diffrax, jax = importlib.import_module("diffrax"), importlib.import_module("jax")
    jax.config.update("jax_enable_x64", True)
    jnp, rates = jax.numpy, equations(jax.numpy)
    p, f, k, a = (jnp.array(values) for values in rig_constants(rig_of(case)))
    commands, count = jnp.array(case.inputs), len(case.inputs)
    times = jnp.arange(count + 1) * case.period
    scale = jnp.array([*ABSOLUTE_TOLERANCE, *[FORCE_TOLERANCE] * 3]) / RELATIVE_TOLERANCE

    def right(t: Any, y: Any, _: Any) -> Any:
        cycle = jnp.minimum((t / case.period + 1e-9).astype(int), count - 1)
        u, force, rate = commands[cycle]
        return jnp.stack(rates(y, u, force + rate * (t - times[cycle]), p, f, k, a))

    def solved(tolerance: Any) -> Any:
        control = diffrax.PIDController(tolerance, tolerance * scale, jump_ts=times)
        return diffrax.diffeqsolve(
            diffrax.ODETerm(right), diffrax.Tsit5(), 0.0, times[-1], 1e-5, jnp.zeros(7), saveat=diffrax.SaveAt(ts=times),
            stepsize_controller=control, max_steps=1_000_000, throw=False, adjoint=diffrax.ForwardMode(),
        ).ys  # fmt: skip

    run = jax.jit(solved)
    return lambda tolerance: np.asarray(run(tolerance))


class Contestant(NamedTuple):
    """A solver with its coarsest setting within the bound.

    Attributes:
        solve: the solver.
        setting: step [s] or tolerance.
        error: largest relative deviation.
    """

    solve: Solver
    setting: float
    error: float


def contestants(case: Case, reference: Array) -> Iterator[tuple[str, Contestant | None]]:
    """Yield the solvers by name; None for one that never meets the bound."""
    solvers: dict[str, tuple[Solver, tuple[float, ...]]] = {"ehls_ros": (ours(case), STEPS)}
    solvers |= {f"SciPy {method}": (with_scipy(case, method), TOLERANCES) for method in METHODS}
    if case.law == "gms" and importlib.util.find_spec("diffrax") is not None:
        solvers["Diffrax Tsit5"] = with_diffrax(case), TOLERANCES
    for name, (solver, settings) in solvers.items():
        best: Contestant | None = None
        for setting in settings:
            try:
                error = float(errors(solver(setting), reference).max())
            except Stuck:
                continue
            if error <= BOUND:
                best = Contestant(solver, setting, error)
                break
        yield name, best


def table(case: Case, runs: int) -> Iterator[str]:
    """Yield the lines of a case's table: times, and how many times faster than the best of the others."""
    reference = solve(case.constants, case.law, case.inputs, case.period).y
    found = dict(contestants(case, reference))
    within = {name: one for name, one in found.items() if one is not None}
    timed = in_turns({name: partial(one.solve, one.setting) for name, one in within.items()}, runs, time.process_time)
    best = min((name for name in within if name != "ehls_ros"), key=lambda name: float(np.median(timed[name])))
    yield f"{'':20}{'setting':>12}{'error':>10}{'time, ms':>12}{'x real time':>13}{'ehls_ros is x':>15}{'quartiles':>16}"
    for name, one in found.items():
        if one is None:
            yield f"{name:20}{f'above {BOUND:g}, or stuck, at every setting':>50}"
            continue
        low, middle, high = np.percentile(timed[name] / timed["ehls_ros"], [25, 50, 75])
        taken = float(np.median(timed[name]))
        shown = f"{middle:15.0f}{f'{low:.0f}-{high:.0f}':>16}{' *' if name == best else ''}"
        speed = len(case.inputs) * case.period / taken
        yield f"{name:20}{one.setting:12.2g}{one.error:10.1e}{1e3 * taken:12.2f}{speed:13.1f}{shown}"


def main() -> None:
    """Print the tables."""
    parser = parser_of(__doc__)
    parser.add_argument("--duration", type=float, default=0.5, help="plant time of a case [s], at most 2")
    parser.add_argument("--runs", type=int, default=5, help="interleaved runs")
    options = parser.parse_args()
    print(f"{platform.machine()}, numba {numba.__version__}, scipy {scipy.__version__}; *: the best of the others")
    for case in (whole.shortened(options.duration) for whole in cases().values()):
        print(f"\n{case.name} ({case.law}), {options.duration:g} s, time to an error of {BOUND:g}")
        for line in table(case, options.runs):
            print(line, flush=True)


if __name__ == "__main__":
    main()
