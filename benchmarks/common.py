"""Common parts of the benchmarks: files and experiments, command lines, turns of contestants, and texts of results."""

import argparse
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.experiments.spec import Spec, spec_from_mapping
from ehls_ros.recording.yaml_text import read_yaml

ROOT = Path(__file__).resolve().parents[1]
CONFIG = ROOT / "config"
EXPERIMENTS = CONFIG / "experiments"
RIG = CONFIG / "rig_paper.yaml"
MEASURED_RIG = CONFIG / "rig_paper_measured.yaml"
RIGS = {"paper": MEASURED_RIG, "single_rod": CONFIG / "rig_single_rod.yaml"}
"""Measured rigs by their names in the benchmarks."""

MEASURED = ("measured_constant_fd1", "measured_sine_fd1", "measured_constant_fd2", "measured_sine_fd2")
"""The experiments on the emulated rig."""

MEASURED_EFFECTS = ("command_delay", "coupling_stiffness")
"""Effects of that rig that its controller may know."""


class Quantity(NamedTuple):
    """One quantity: its true value, the estimate and its standard error."""

    name: str
    true: float
    value: float
    std: float

    @property
    def error(self) -> float:
        """Relative error."""
        return (self.value - self.true) / self.true

    @property
    def covered(self) -> bool:
        """Whether the 95 % interval holds the truth."""
        return abs(self.value - self.true) <= 1.96 * self.std

    @property
    def sigmas(self) -> float:
        """Error in standard errors."""
        return abs(self.value - self.true) / self.std if self.std > 0.0 else math.inf


def parser_of(description: str | None) -> argparse.ArgumentParser:
    """Return a parser of the command line whose help is a benchmark's docstring."""
    return argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)


def experiment(name: str, **sections: Any) -> Spec:
    """Return an experiment of the package.

    Args:
        name: name of its file.
        **sections: sections that replace those of the file.
    """
    path = EXPERIMENTS / f"{name}.yaml"
    content: Mapping[str, Any] = read_yaml(path, "spec")
    return spec_from_mapping({**content, **sections}, str(path), path.parent)


def in_turns(
    contestants: Mapping[str, Callable[[], object]], runs: int, clock: Callable[[], float], warm_up: int = 1
) -> dict[str, Array]:
    """Time contestants that take turns in rotating order, so that other load on the machine affects all equally.

    Args:
        contestants: functions by name.
        runs: timed runs of each.
        clock: time or processor time [s].
        warm_up: runs of each before these.

    Returns:
        Times by name, shape (runs,) [s].
    """
    times: dict[str, list[float]] = {name: [] for name in contestants}
    order = list(contestants.items())
    for run in range(runs + warm_up):
        first = run % len(order)
        for name, work in order[first:] + order[:first]:
            before = clock()
            work()
            times[name].append(clock() - before)
    return {name: np.array(values[warm_up:]) for name, values in times.items()}


def quartiles(values: Sequence[float] | Array, form: str) -> str:
    """Return median and quartiles as text, such as ``2.1 (1.9-2.4)`` for the format ``.1f``."""
    low, middle, high = np.percentile(values, [25, 50, 75])
    return f"{middle:{form}} ({low:{form}}-{high:{form}})"


def print_row(*cells: object) -> None:
    """Print a row of a Markdown table."""
    print(f"| {' | '.join(map(str, cells))} |", flush=True)


def print_heading(*names: object) -> None:
    """Print the heading of a Markdown table."""
    print_row(*names)
    print(f"|{'---|' * len(names)}")


def largest(values: Sequence[float] | Array, form: str = ".1f") -> str:
    """Return median and largest value as text, such as ``2.1 (3.4)``."""
    return f"{np.median(values):{form}} ({np.max(values):{form}})"
