"""Settings left open in the paper, and the effect of each on Table 3."""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

from ehls_ros.control.controllers import fasmc
from ehls_ros.parallel import Task
from ehls_ros.reproduction import paper
from ehls_ros.reproduction.cases import Change, largest_error
from ehls_ros.reproduction.paper import Cell
from ehls_ros.reproduction.results import TriedChoice

PHI1_READINGS = 1000.0 / 103.0
"""The text's phi1 is 103 or, with a lost exponent, 10^3."""


class Choice(NamedTuple):
    """One open setting with an alternative value.

    Attributes:
        what: the setting.
        ours: the value of Table 3.
        other: the value tried.
        change: change of the cases.
        cells: the cells it can affect.
    """

    what: str
    ours: str
    other: str
    change: Change
    cells: tuple[Cell, ...]


def _cells(controller: str, *references: str) -> tuple[Cell, ...]:
    return tuple(c for c in paper.CELLS if c.controller == controller and c.reference in (references or paper.REFERENCES))


def choices() -> list[Choice]:
    """Return the open settings."""
    every = _cells(paper.FASMC_2)
    triangle, irregular = _cells(paper.FASMC_2, "triangle"), _cells(paper.FASMC_2, "irregular")
    sic = _cells(paper.SIC)

    def tuned(**values: float) -> Change:
        return Change({"controller": values})

    return [
        Choice("start", "at rest, no pressure, x = 0", "x = 50 mm", Change({"initial_position": 0.05}), every),
        Choice("start", "at rest, no pressure, x = 0", "x = -50 mm", Change({"initial_position": -0.05}), every),
        Choice("triangle's corners", "2 % of the period", "0.5 %", Change({"reference": {"corner": 0.005}}), triangle),
        Choice("triangle's corners", "2 % of the period", "10 %", Change({"reference": {"corner": 0.1}}), triangle),
        *(
            Choice("irregular signal", "seed 1", f"seed {seed}", Change({"reference": {"seed": seed}}), irregular)
            for seed in (2, 3)
        ),
        Choice("irregular signal", "0.1–0.8 Hz", "to 2 Hz", Change({"reference": {"highest_frequency": 2.0}}), irregular),
        Choice("SIC's inner loop", "PI", "P alone", Change({"controller": {"integral": 0.0}}), sic),
        Choice("SIC's inner loop", "motion fed forward", "95 % of it", Change({"controller": {"compensation": 0.95}}), sic),
        Choice("SIC's inner loop", "motion fed forward", "PI alone", Change({"controller": {"compensation": 0.0}}), sic),
        Choice(
            "φ1 printed as 103 or 10³",
            "our rate",
            "10³/103 = 9.7 times it",
            tuned(phi1=fasmc.Parameters().phi1 * PHI1_READINGS),
            every,
        ),
        Choice("keeping α̂, β̂", "forgetting 0.1 1/s and projection", "projection alone", tuned(forgetting=0.0), every),
        Choice("keeping α̂, β̂", "forgetting 0.1 1/s and projection", "forgetting 1 1/s", tuned(forgetting=1.0), every),
        Choice("rate of pL", "model, corrected by its error", "model alone", tuned(rate_correction=0.0), every),
        Choice("unit of k_i in Table 1", "N/mm", "N/m", Change(known_friction={"element_stiffness": 1e-3}), every),
        Choice("sign of gravity in (3)", "as printed", "turned round", Change(plant={"gravity": -1.0}), every),
    ]


def tasks() -> list[Task]:
    """Return the runs."""
    return [partial(largest_error, cell, choice.change) for choice in choices() for cell in choice.cells]


def summary(results: Sequence[float]) -> tuple[TriedChoice, ...]:
    """Return a record per choice, from the results of :func:`tasks`."""
    rows, start = [], 0
    for choice in choices():
        errors = results[start : start + len(choice.cells)]
        start += len(choice.cells)
        cells = {f"{cell.reference} {cell.disturbance}": float(error) for cell, error in zip(choice.cells, errors, strict=True)}
        rows.append(TriedChoice(choice.what, choice.cells[0].controller, choice.ours, choice.other, cells))
    return tuple(rows)
