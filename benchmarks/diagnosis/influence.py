"""Influence of the diagnosis' chosen numbers: answers with all numbers off by random factors at once, regressed on these.

    python -m benchmarks.diagnosis.influence --draws 30           # factors of its own for each case: most power
    python -m benchmarks.diagnosis.influence --draws 30 --common  # the same factors for all cases of a draw: the exam

Draw 0 has the chosen values. A line of JSON is written per diagnosis; an interrupted run is resumed.
"""

import os

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[variable] = "1"

import ast  # noqa: E402
import importlib  # noqa: E402
import inspect  # noqa: E402
import math  # noqa: E402
import pickle  # noqa: E402
import pkgutil  # noqa: E402
import re  # noqa: E402
import sys  # noqa: E402
from collections.abc import Iterator, Mapping, Sequence  # noqa: E402
from importlib.abc import MetaPathFinder  # noqa: E402
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader  # noqa: E402
from pathlib import Path  # noqa: E402
from types import CodeType, ModuleType  # noqa: E402
from typing import Any, NamedTuple  # noqa: E402

import numpy as np  # noqa: E402
from rich.console import Console  # noqa: E402
from rich.table import Table  # noqa: E402

from benchmarks.common import ROOT, parser_of  # noqa: E402
from benchmarks.rows import Row, appended, read_rows  # noqa: E402
from ehls_ros import diagnosis  # noqa: E402
from ehls_ros.arrays import Array  # noqa: E402
from ehls_ros.declared_numbers import DeclaredNumber, declared_numbers  # noqa: E402
from ehls_ros.diagnosis import rules  # noqa: E402

SEED = 360_360
"""Seed of the cases and of the factors."""

SPREAD = 0.25
"""Numbers are multiplied or divided by up to 1 + SPREAD, log-uniformly."""

MIXED = {
    "clean": (0, 1, 2, 3, 4, 5, 6, 7, 8, 10, 11, 13, 16),
    "partial": (0, 1, 2, 3),
    "baseline": (0, 1, 2, 3),
}
"""Numbers of the cases of each exam: singles, pairs, nothing and outside the list; rigs that no model describes."""

UNUSED = ("free_run", "prediction")
"""Modules that no diagnosis uses."""

BASELINE = "ehls_ros.experiments.baseline"
"""Module that diagnoses against baselines."""

AFRESH = ("ehls_ros.diagnosis", "ehls_ros.experiments", "ehls_ros.identification", "benchmarks.diagnosis")
"""Modules that depend on the numbers."""

CERTAIN = 6.9
"""Largest log-odds: a probability of 0.999."""


def moved(value: float, x: float) -> float:
    """Return a number with the factor exp(x); of a fraction above one half, the complement is multiplied."""
    if isinstance(value, int):
        return max(1, round(value * math.exp(x)))
    return 1.0 - (1.0 - value) * math.exp(x) if 0.5 < value < 1.0 else value * math.exp(x)


def chosen() -> list[DeclaredNumber]:
    """Return the numbers chosen by judgement that a diagnosis uses."""
    names = [f"{diagnosis.__name__}.{found.name}" for found in pkgutil.iter_modules(diagnosis.__path__) if not found.ispkg]
    modules = [importlib.import_module(name) for name in (*names, BASELINE) if name.rpartition(".")[2] not in UNUSED]
    used = {name for module in modules for name in re.findall(r"\brules\.([A-Z_]+)\b", inspect.getsource(module))}
    return [
        n for module in modules[:-1] for n in declared_numbers(module) if n.chosen and (module is not rules or n.name in used)
    ]


class MovedModule(SourceFileLoader):
    """Loader of a module with other values of its numbers."""

    def __init__(self, name: str, path: str, values: Mapping[tuple[str, str], float]) -> None:
        """Store the values, by module and name."""
        super().__init__(name, path)
        self.values = values

    def get_code(self, fullname: str) -> CodeType:
        """Return the module's code with the values."""
        tree = ast.parse(self.get_data(self.path))
        for statement in tree.body:
            if isinstance(statement, ast.Assign) and isinstance(statement.targets[0], ast.Name):
                key = fullname, statement.targets[0].id
                if key in self.values:
                    statement.value = ast.copy_location(ast.Constant(self.values[key]), statement.value)
        return compile(tree, self.path, "exec")


class Moving(MetaPathFinder):
    """Import of modules with other values of their numbers."""

    def __init__(self, values: Mapping[tuple[str, str], float]) -> None:
        """Store the values, by module and name."""
        self.values = values

    def find_spec(self, name: str, path: Sequence[str] | None, target: ModuleType | None = None) -> ModuleSpec | None:
        """Find a module that depends on the numbers, to be loaded with their values."""
        spec = PathFinder.find_spec(name, path, target) if name.startswith(AFRESH) else None
        if spec is not None and spec.origin is not None:
            spec.loader = MovedModule(name, spec.origin, self.values)
        return spec


def factors_of(draw: int, case: int, common: bool, count: int) -> Array:
    """Return the logarithms of the factors, in units of the largest."""
    rng = np.random.default_rng([SEED, draw, 0 if common else 1 + case])
    return rng.uniform(-1.0, 1.0, count) if draw else np.zeros(count)


class Input(NamedTuple):
    """A case: what `running.run` tells of it, the recordings, and the seed of its diagnosis."""

    row: Row
    recordings: list[Any]
    number: int


def inputs(duration: float, path: Path) -> list[Input]:
    """Return the cases, drawn at the first call."""
    if not path.exists():
        from benchmarks.diagnosis import cases, exams  # noqa: PLC0415

        found = []
        for exam, numbers in MIXED.items():
            for number in numbers:
                case = exams.EXAMS[exam].make(SEED, number, duration)
                recording = cases.recording_of(case)
                told = {key: recording.truth[key] for key in ("natural", "stages", "appears_in", "near", "outside")}
                all_of_it = [cases.trajectory_of(r) for r in (recording, *cases.healthy_of(case))]
                found.append(Input(case.told() | told, all_of_it, number))
        path.write_bytes(pickle.dumps(found))
    return list(pickle.loads(path.read_bytes()))  # noqa: S301


def rows(todo: Sequence[tuple[int, int]], given: Sequence[Input], common: bool) -> Iterator[Row]:
    """Yield the row of each draw and case."""
    numbers, reach = chosen(), math.log1p(SPREAD)
    for draw, index in todo:
        # Numbers are also default values of arguments: the modules that use them are imported afresh.
        for name in [name for name in sys.modules if name.startswith(AFRESH)]:
            del sys.modules[name]
        x = factors_of(draw, index, common, len(numbers))
        values = {(n.module, n.name): moved(n.value, reach * float(part)) for n, part in zip(numbers, x, strict=True)}
        sys.meta_path[:] = [Moving(values), *(finder for finder in sys.meta_path if not isinstance(finder, Moving))]
        running, cases = (importlib.import_module(f"benchmarks.diagnosis.{name}") for name in ("running", "cases"))
        new, *healthy = given[index].recordings
        factors = {n.name: round(float(part), 4) for n, part in zip(numbers, x, strict=True)}
        row: Row = {"draw": draw, "case": index, "common": common, "factors": factors}
        try:
            how = {"seed": given[index].number, "threads": 1}
            if healthy:
                against = importlib.import_module("ehls_ros.experiments.baseline").diagnose_against
                found = against(new, healthy, cases.rig(), "case", **how)
            else:
                found = importlib.import_module("ehls_ros.diagnosis.diagnose").diagnose(new, cases.rig(), "case", **how)
            row["ours"] = running.told(found)
        except Exception as error:  # noqa: BLE001
            row["error"] = repr(error)
        yield row


class Mark(NamedTuple):
    """How good an answer is: right or wrong, log-odds of the truth, and the largest relative error of a size."""

    right: float
    margin: float
    size: float


def mark(given: Input, row: Row) -> Mark:
    """Return the mark of an answer."""
    from benchmarks.diagnosis.judge import judge  # noqa: PLC0415

    whole = given.row | row
    if "ours" not in row:
        return Mark(0.0, -CERTAIN, math.nan)
    judged, ours, hidden = judge(whole), row["ours"], list(given.row["hidden"])
    beliefs = [({c["name"], *c["equivalent_to"]}, c["probability"] * (1 + len(c["equivalent_to"]))) for c in ours["causes"]]
    if given.row["kind"] in ("singles", "pairs"):
        true = [max((p for names, p in beliefs if name in names), default=0.0) for name in hidden]
        absent = [p for names, p in beliefs if names.isdisjoint(hidden)]
        odds = min(*map(_log_odds, true), *[-_log_odds(p) for p in absent], CERTAIN)
    else:
        odds = -_log_odds(max((p for _, p in beliefs), default=0.0 if judged.right else 0.5))
    sizes = [abs(q.error) for q in judged.quantities]
    return Mark(float(judged.right), odds, max(sizes) if sizes else math.nan)


def _log_odds(p: float) -> float:
    least = 1.0 / (1.0 + math.exp(CERTAIN))
    p = min(max(p, least), 1.0 - least)
    return math.log(p / (1.0 - p))


def slopes(x: Array, y: Array) -> tuple[Array, Array]:
    """Return the slope of an answer's mark on each factor, and its standard error.

    Args:
        x: logarithms of the factors, in units of their largest, shape (rows, numbers).
        y: marks less those of the same cases with the chosen values, shape (rows,).
    """
    x, y = x - x.mean(axis=0), y - y.mean()
    square = np.maximum(np.sum(x**2, axis=0), 1e-300)
    slope = x.T @ y / square
    # One by one: the factors are independent, and the others' effects are scatter.
    scatter = np.sum((y[:, None] - x * slope) ** 2, axis=0)
    return slope, np.sqrt(scatter / max(len(y) - 2, 1) / square)


def show(found: Sequence[Row], given: Sequence[Input], console: Console) -> None:
    """Print the exam under random rules and the influence of each number."""
    marks = {(r["draw"], r["case"]): mark(given[r["case"]], r) for r in found}
    random = [r for r in found if r["draw"] > 0]
    nominal = [m for (draw, _), m in marks.items() if draw == 0]
    right = np.array([marks[r["draw"], r["case"]].right for r in random])
    console.print(f"chosen values: {100 * np.mean([m.right for m in nominal]):.0f} % of {len(nominal)} cases right")
    console.print(f"random values: {100 * right.mean():.1f} % of {len(random)} right")
    complete = [d for d in {r["draw"] for r in random} if sum(r["draw"] == d for r in random) == len(given)]
    if complete:
        scores = [100 * np.mean([marks[d, c].right for c in range(len(given))]) for d in complete]
        low, middle, high = np.quantile(scores, [0.0, 0.5, 1.0])
        console.print(f"{len(scores)} draws: median {middle:.0f} %, {low:.0f} to {high:.0f} %")
    numbers = {n.name: n.value for n in chosen()}
    # Rows of an older version may lack some numbers, and have others.
    names = sorted(set(numbers).intersection(*(r["factors"] for r in random)))
    x = np.array([[r["factors"][name] for name in names] for r in random])
    y = np.array([np.subtract(marks[r["draw"], r["case"]], marks[0, r["case"]]) for r in random])
    by_mark = []
    for k in range(3):
        known = np.isfinite(y[:, k])
        by_mark.append(slopes(x[known], y[known, k]))
    table = Table(title=f"change per + {100 * SPREAD:.0f} % of a number, ± its standard error")
    for column in ("number", "value", "right, points", "log-odds", "size error, %", "largest"):
        table.add_column(column)
    strongest = np.max([np.abs(s) / np.maximum(e, 1e-300) for s, e in by_mark], axis=0)
    chance = math.sqrt(2.0 * math.log(strongest.size * len(by_mark)))
    console.print(
        f"without any influence, the largest of {strongest.size} × {len(by_mark)} slopes would be about {chance:.1f} σ"
    )
    for k in np.argsort(-strongest):
        cells = [f"{f * s[k]:.2f} ± {f * e[k]:.2f}" for f, (s, e) in zip((100.0, 1.0, 100.0), by_mark, strict=True)]
        table.add_row(names[k], f"{numbers[names[k]]:g}", *cells, f"{strongest[k]:.1f} σ")
    console.print(table)


def main() -> None:
    """Run the draws and print the influence of each number."""
    parser = parser_of(__doc__)
    parser.add_argument("--draws", type=int, default=30)
    parser.add_argument("--duration", type=float, default=12.0, help="duration of the recordings, s (%(default)s)")
    parser.add_argument("--only", choices=MIXED, help="cases of this exam only")
    parser.add_argument("--common", action="store_true", help="one set of factors for all cases of a draw")
    parser.add_argument("--out", type=Path, default=ROOT / "runs" / "influence.jsonl", help="file of results (%(default)s)")
    options = parser.parse_args()
    options.out.parent.mkdir(parents=True, exist_ok=True)
    given = inputs(options.duration, options.out.with_name(f"influence-{SEED}-{options.duration:g}.pickle"))
    done = read_rows([options.out])
    known = {(r["draw"], r["case"]) for r in done}
    wanted = [c for c, case in enumerate(given) if options.only in (None, case.row["exam"])]
    todo = [(d, c) for d in range(options.draws + 1) for c in wanted if (d, c) not in known]
    for row in appended(options.out, rows(todo, given, options.common)):
        done.append(row)
        print(row["draw"], row["case"], row.get("error") or row["ours"]["verdict"], flush=True)
    show(done, given, Console(width=140))


if __name__ == "__main__":
    main()
