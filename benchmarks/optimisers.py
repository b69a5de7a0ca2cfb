"""The optimisers on the paper's static objective (20)-(21): time to within 1 % of the lowest cost, and failed runs.

All get the same compiled objective on the same data: the paper's 40 velocities, six repeats, its friction with the noise and
resolution of its force sensor. Runs are interleaved seed by seed, so that other load on the machine affects all alike. A run
that uses up its evaluations has failed. Libraries are listed with their default settings and with the best of several tried,
our swarm also with the usual constants and without crossover and mutation. `make setup WITH=optimisers` installs the
libraries that do not come with ehls_ros.
"""

import platform
import time
from importlib.metadata import PackageNotFoundError, version
from typing import Any, NamedTuple

import numpy as np
import yaml

from benchmarks.common import RIG, parser_of, quartiles
from ehls_ros.arrays import Array
from ehls_ros.errors import BadInput
from ehls_ros.identification import stribeck
from ehls_ros.identification.optimisers import OPTIMISERS
from ehls_ros.identification.optimisers.base import Problem, Result
from ehls_ros.physics.rig import rig_from_mapping

SPEEDS_MM_S = (2, 3, 4, 6, 8, 10, 12, 14, 16, 20, 25, 30, 45, 60, 75, 90, 105, 120, 135, 150)
REPEATS = 6
NOISE, RESOLUTION = 2.0, 4.0  # N
WITHIN = 1.01
LIBRARIES = ("numpy", "numba", "scipy", "pymoo", "pyswarms")
OURS = "pso"
CONTESTANTS: tuple[tuple[str, dict[str, Any]], ...] = (
    (OURS, {}),
    ("pso", {"crossovers": 0, "particles": 40, "inertia": 0.7298, "cognitive": 1.4962, "social": 1.4962}),
    ("least_squares", {}),
    ("differential_evolution", {}),
    ("differential_evolution", {"population": 5}),
    ("pymoo_pso", {}),
    ("pymoo_ga", {}),
    ("pymoo_ga", {"population": 200}),
    ("pyswarms_gbest", {}),
    ("pyswarms_gbest", {"particles": 40}),
    ("pyswarms_gbest", {"particles": 40, "inertia": 0.6, "cognitive": 1.7, "social": 1.7}),
)


class Contestant(NamedTuple):
    """An optimiser with its settings."""

    label: str
    optimiser: Any
    parameters: Any

    def run(self, problem: Problem, seed: int, target: float) -> tuple[Result, float]:
        """Search; return the result and the time it took [s]."""
        before = time.perf_counter()
        result = self.optimiser.minimise(problem, self.parameters, seed, target)
        return result, time.perf_counter() - before


def measured(seed: int) -> Problem:
    """Return the static objective of simulated measurements."""
    rig = rig_from_mapping(yaml.safe_load(RIG.read_text(encoding="utf-8")), str(RIG))
    p, damping = rig.friction, rig.plant.viscous_damping
    speeds = np.array(SPEEDS_MM_S) * 1e-3
    v = np.tile(np.concatenate([speeds, -speeds]), REPEATS)
    excess = (p.static_force - p.coulomb_force) * np.exp(-(np.abs(v / p.stribeck_velocity) ** p.stribeck_exponent))
    force = (damping + p.viscous_coefficient) * v + np.sign(v) * (p.coulomb_force + excess)
    force += NOISE * np.random.default_rng(seed).standard_normal(v.size)
    return stribeck.problem(v, np.round(force / RESOLUTION) * RESOLUTION, viscous_damping=damping)


def contestants(problem: Problem, evaluations: int) -> list[Contestant]:
    """Return the contestants whose libraries are installed, compiled; print the others."""
    found = []
    for name, settings in CONTESTANTS:
        optimiser = OPTIMISERS.load(name)
        parameters = optimiser.Parameters(evaluations=evaluations, **settings)
        if hasattr(parameters, "patience"):
            parameters = parameters._replace(patience=evaluations)
        chosen = ", ".join(f"{key} {value:g}" for key, value in settings.items())
        contestant = Contestant(f"{name} ({chosen})" if chosen else name, optimiser, parameters)
        try:
            contestant.run(problem, 0, np.inf)
            contestant.run(problem._replace(upper=problem.upper * 0.999), 0, -np.inf)
        except BadInput as error:
            print(f"{contestant.label} left out: {error.what}")
        else:
            found.append(contestant)
    return found


def lowest_cost(problem: Problem) -> float:
    """Return the lowest known cost: the best of many least-squares fits."""
    optimiser = OPTIMISERS.load("least_squares")
    parameters = optimiser.Parameters(starts=20, tolerance=1e-14)
    return min(optimiser.minimise(problem, parameters, seed).cost for seed in range(5))


def race(problem: Problem, field: list[Contestant], seeds: int, target: float) -> dict[str, tuple[Array, Array, Array]]:
    """Run all for each seed, in rotating order.

    Returns:
        Success, time [s] and evaluations of every run, by label.
    """
    rows: dict[str, list[tuple[bool, float, int]]] = {contestant.label: [] for contestant in field}
    for seed in range(seeds):
        first = seed % len(field)
        for contestant in field[first:] + field[:first]:
            result, taken = contestant.run(problem, seed, target)
            rows[contestant.label].append((result.cost <= target, taken, result.evaluations))
    return {label: tuple(np.array(column) for column in zip(*runs, strict=True)) for label, runs in rows.items()}  # type: ignore[misc]


def main() -> None:
    """Print the tables."""
    parser = parser_of(__doc__)
    parser.add_argument("--seeds", type=int, default=50, help="runs of each optimiser")
    parser.add_argument("--evaluations", type=int, default=20_000, help="evaluations after which a run has failed")
    parser.add_argument("--data-seed", type=int, default=1, help="seed of the measurements' noise")
    options = parser.parse_args()
    versions = []
    for name in LIBRARIES:
        try:
            versions.append(f"{name} {version(name)}")
        except PackageNotFoundError:
            versions.append(f"no {name}")
    print(f"{platform.machine()}, python {platform.python_version()}, {', '.join(versions)}")
    problem = measured(options.data_seed)
    lowest = lowest_cost(problem)
    print(f"{problem.residual_count} residuals, lowest cost {lowest:.6g}, target {WITHIN * lowest:.6g}")
    field = contestants(problem, options.evaluations)
    runs = race(problem, field, options.seeds, WITHIN * lowest)

    width = max(len(label) for label in runs)
    print(f"\nto within 1 % of the lowest cost, {options.seeds} seeds; times and evaluations of the runs that succeeded")
    print(f"{'':{width}}  success  {'ms':>22}  {'evaluations':>22}  {'x ours':>7}  ms/success  {'x ours':>7}")
    ours, all_ours = (float(np.median(runs[OURS][1])), float(runs[OURS][1].sum() / max(1, runs[OURS][0].sum())))
    for label, (success, taken, evaluations) in runs.items():
        won = success.astype(bool)
        share = f"{won.sum()}/{won.size}"
        if not won.any():
            print(f"{label:{width}}  {share:>7}")
            continue
        expected = taken.sum() / won.sum()
        print(
            f"{label:{width}}  {share:>7}  {quartiles(taken[won] * 1e3, '.2f'):>22}  {quartiles(evaluations[won], '.0f'):>22}"
            f"  {np.median(taken[won]) / ours:7.1f}  {expected * 1e3:10.2f}  {expected / all_ours:7.1f}"
        )

    sure = [contestant for contestant in field if runs[contestant.label][0].all()]
    print("\nthose that always succeeded, to their own end")
    print(f"{'':{width}}  {'ms':>22}  {'evaluations':>22}  largest excess of cost")
    for contestant in sure:
        done = [contestant.run(problem, seed, -np.inf) for seed in range(options.seeds)]
        times, counts = np.array([taken for _, taken in done]), np.array([result.evaluations for result, _ in done])
        excess = max(result.cost / lowest - 1.0 for result, _ in done)
        print(
            f"{contestant.label:{width}}  {quartiles(times * 1e3, '.2f'):>22}  {quartiles(counts, '.0f'):>22}  {excess:22.1e}"
        )
    fastest = min(sure, key=lambda contestant: float(np.median(runs[contestant.label][1])))
    fewest = min(sure, key=lambda contestant: float(np.median(runs[contestant.label][2])))
    print(f"\nof these the fastest to 1 %: {fastest.label}; with the fewest evaluations: {fewest.label}")
    print("mark: 10 x ours for every library's swarm and genetic algorithm, at no lower success")


if __name__ == "__main__":
    main()
