"""Cost of the derivatives of a trajectory, compared with one run and with central differences.

    python -m benchmarks.gradient

One run is the simulator's compiled functions with floats: plant and sensors, a cycle a millisecond. The gradient is the same
functions with duals. Both are interleaved; a ratio is the median of the ratios of neighbouring runs. Central differences take
two runs per coefficient.

The error is the largest deviation from them (fourth order, integration step 10 µs), relative to the largest derivative of its
signal. The best of six difference steps counts, where they change the signal by more than 1e-7: an event is located to 1e-9 of
a step, and no closer. Too long a step moves a bend that is no event, as of an end stop's force, to another integration step.
"""

import time
from collections.abc import Callable
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np
import yaml

from benchmarks.common import RIG, parser_of
from ehls_ros.arrays import Array, kernel
from ehls_ros.physics import simulator
from ehls_ros.physics.composition import compiled
from ehls_ros.physics.plant import TEMPERATURE, Chains, hold
from ehls_ros.physics.rig import SENSED, Rig, rig_from_mapping
from ehls_ros.physics.sensitivity import Inputs, prepared, sensitivities
from ehls_ros.physics.simulator import Constants, State, at_rest, parts_of

PERIOD, FINE = 1e-3, 1e-5
CHANGES, LONGEST, TOLD = (1e-4, 1e-5, 3e-6, 1e-6, 4e-7, 2e-7), 3e-3, 1e-7
"""Signal changes that the differences aim at, the longest step, and the smallest change that can be resolved."""

PLANT = (
    "supply_pressure", "bulk_modulus", "discharge_coefficient", "moving_mass", "spring_stiffness", "valve_bandwidth",
    "piston_area", "leakage_coefficient", "oil_density", "valve_gain", "total_volume", "viscous_damping",
    "valve_area_gradient",
)  # fmt: skip
FRICTION = ("static_force", "coulomb_force", "stribeck_velocity", "viscous_coefficient", "stribeck_exponent")


class Case(NamedTuple):
    """A motion: friction model, effects, spool command [m] and disturbance [N] as sines."""

    model: str
    effects: tuple[dict[str, Any], ...]
    spool: float
    frequency: float
    force: float


CASES = {
    "sine, Maxwell slip": Case("gms", (), 6e-4, 1.0, 5e3),
    "stick and slip, Maxwell slip": Case("gms", (), 8e-5, 10.0, 0.0),
    "stick-slip, static friction": Case("stribeck", (), 1.5e-5, 4.0, 0.0),
    "end stop, delayed command": Case(
        "stribeck",
        (
            {"name": "end_stop", "upper": 4e-3, "stiffness": 5e6, "damping": 0.0, "loss": 2.0},
            {"name": "command_delay", "delay": 2.337e-3},
        ),
        4e-4,
        5.0,
        2e3,
    ),
}


class Plain(NamedTuple):
    """The compiled run with floats."""

    run: Callable[..., int]


def build(cylinder: Any, valve: Any, friction: Any, elements: int, states: int, chains: Chains) -> Plain:
    """Build one run with floats."""
    plant = simulator.build(cylinder, valve, friction, elements, states, chains)
    advance, sense = plant.advance, plant.sense

    @kernel
    def run(constants: Constants, state: State, rows: Array, out: Array) -> int:
        dense, noise = 0, np.zeros(state.measured.size)
        for k in range(rows.shape[0]):
            state.inputs[TEMPERATURE] = rows[k, 5]
            sense(k, constants, state, noise)
            out[k] = state.measured
            hold(state.inputs, k * constants.period, rows[k, 0], rows[k, 1], rows[k, 2], rows[k, 3], rows[k, 4])
            dense += advance(k, constants, state)
        return dense

    return Plain(run)


def inputs_of(case: Case, cycles: int) -> Inputs:
    """Return the inputs of a case."""
    rate = 2.0 * np.pi * case.frequency
    t = rate * np.arange(cycles) * PERIOD
    return Inputs(case.spool * np.sin(t), case.force * np.sin(t + 0.7), case.force * rate * np.cos(t + 0.7))


def paths_of(count: int) -> tuple[str, ...]:
    """Return the first coefficients, of plant and friction in turn."""
    both = [path for pair in zip(PLANT, FRICTION, strict=False) for path in (f"plant.{pair[0]}", f"friction.{pair[1]}")]
    return (*both, *(f"plant.{name}" for name in PLANT[len(FRICTION) :]))[:count]


def timed(call: Callable[..., Any], *arguments: Any) -> float:
    """Return the processor time of a call [s], which other work on the machine hardly affects."""
    began = time.thread_time()
    call(*arguments)
    return time.thread_time() - began


def changed(rig: Rig, path: str, by: float) -> Rig:
    """Return a rig with one coefficient changed by a fraction of it."""
    section, name = path.split(".")
    part = getattr(rig, section)
    return rig._replace(**{section: part._replace(**{name: (1.0 + by) * getattr(part, name)})})


def largest_error(rig: Rig, paths: tuple[str, ...], inputs: Inputs) -> float:
    """Return the largest error of the derivatives against central differences, each signal with its best difference step."""
    found, worst = sensitivities(rig, paths, inputs, step=FINE), 0.0
    size = np.max(np.abs(found.readings), axis=0)
    for index, path in enumerate(paths):
        section, name = path.split(".")
        value, largest = getattr(getattr(rig, section), name), np.max(np.abs(found.derivatives[:, :, index]), axis=0)
        best = np.full(len(SENSED), np.inf)
        for change in CHANGES:
            by = min(change / max(float(np.max(value * largest[size > 0.0] / size[size > 0.0])), 1e-300), LONGEST)
            ends = [sensitivities(changed(rig, path, s * by), paths, inputs, step=FINE).readings for s in (-2, -1, 1, 2)]
            differences = (8.0 * (ends[2] - ends[1]) - (ends[3] - ends[0])) / (12.0 * by * value)
            told = by * value * largest > TOLD * size
            error = np.max(np.abs(found.derivatives[:, :, index] - differences), axis=0)
            best[told] = np.minimum(best[told], error[told] / largest[told])
        worst = max(worst, float(np.max(best[best < np.inf], initial=0.0)))
    return worst


def main() -> None:
    """Print the table."""
    parser = parser_of(__doc__)
    parser.add_argument("--cycles", type=int, default=1000, help="of each run (%(default)s)")
    parser.add_argument("--repeats", type=int, default=60, help="of each measurement (%(default)s)")
    parser.add_argument("--counts", type=int, nargs="+", default=[5, 10, 18], help="of coefficients (%(default)s)")
    options = parser.parse_args()
    print(f"{'':30s}{'coefficients':>13s}{'one run':>10s}{'gradient':>10s}{'ratio':>8s}{'differences':>13s}{'error':>10s}")
    for name, case in CASES.items():
        data = yaml.safe_load(RIG.read_text(encoding="utf-8"))
        data["friction"]["model"] = case.model
        rig = rig_from_mapping({**data, "effects": list(case.effects)}, "rig").quiet()
        inputs, parts = inputs_of(case, options.cycles), parts_of(rig)
        # Kernels are built from importable modules, and the program's main module is not one.
        own = import_module("benchmarks.gradient")
        plain = compiled(own.build, {"run": "constants, state, rows, out"}, **parts._asdict()).run
        for count in options.counts:
            paths, times = paths_of(count), list[tuple[float, float]]()
            for _ in range(options.repeats + 1):
                start, ready = at_rest(rig, PERIOD), prepared(rig, paths, inputs, PERIOD)
                out = np.empty((options.cycles, len(SENSED)))
                one = timed(plain, start.constants, start.state, ready.rows, out)
                times.append((one, timed(ready.run)))
            run, gradient = np.array(times[1:]).T
            error = largest_error(rig, paths, inputs)
            print(
                f"{name:30s}{count:13d}{1e3 * np.median(run):8.2f}ms{1e3 * np.median(gradient):8.2f}ms"
                f"{np.median(gradient / run):8.2f}{2 * count:13d}{error:10.1e}",
                flush=True,
            )


if __name__ == "__main__":
    main()
