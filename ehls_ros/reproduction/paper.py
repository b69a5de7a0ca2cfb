"""The paper's published simulations, section 5.1: Table 3 and the text around it."""

from typing import Any, NamedTuple

REFERENCES: dict[str, dict[str, Any]] = {
    "constant": {"name": "constant", "value": 1e4},
    "sine": {"name": "sine", "amplitude": 1e4, "frequency": 0.5},
    "triangle": {"name": "triangle", "amplitude": 1e4, "frequency": 0.5},
    "irregular": {"name": "irregular", "amplitude": 1e4},
}
"""Reference forces; the paper shows the triangle and the irregular signal without a definition."""

DISTURBANCES: dict[str, dict[str, Any]] = {
    "fd1": {"name": "sine", "amplitude": 2e3, "frequency": 0.25},
    "fd2": {"name": "sine", "amplitude": 5e3, "frequency": 1.0},
}
"""Disturbance forces: 2 sin(0.5 pi t) kN and 5 sin(2 pi t) kN."""

SIC, FASMC_1, FASMC_2 = CONTROLLERS = ("SIC", "FASMC I", "FASMC II")
"""Controllers by their names in Table 3."""

EVERYTHING, TENFOLD, DELTA_ALONE = "α̂, β̂ and D̂ adapt", "α̂, β̂ ten times as fast", "D̂ alone adapts"
SCALES_ALONE, NO_ADAPTATION = "α̂ and β̂ alone adapt", "nothing adapts"
"""Kinds of adaptation of FASMC II compared in the study."""

FULL_SCALE = 1e4
"""Force to which the relative errors of Table 3 refer [N]."""


class Cell(NamedTuple):
    """One combination of Table 3, by the names above."""

    controller: str
    reference: str
    disturbance: str


CELLS = tuple(Cell(c, r, d) for c in CONTROLLERS for d in DISTURBANCES for r in REFERENCES)
"""Every combination, in the order of Table 3; SIC with triangle and irregular signal is not in the paper."""

_RELATIVE_ERROR = {
    "SIC": ((1.12, 2.76, None, None), (2.23, 3.92, None, None)),
    "FASMC I": ((0.181, 0.954, 0.876, 0.753), (1.57, 1.92, 1.76, 1.97)),
    "FASMC II": ((0.049, 0.378, 0.342, 0.247), (0.421, 0.913, 0.798, 0.616)),
}
RELATIVE_ERROR: dict[Cell, float | None] = {
    Cell(controller, reference, disturbance): value
    for controller, rows in _RELATIVE_ERROR.items()
    for disturbance, row in zip(DISTURBANCES, rows, strict=True)
    for reference, value in zip(REFERENCES, row, strict=True)
}
"""Table 3: largest steady error in per cent of 10 kN."""

_FASMC_CONVERGENCE = ((0.8, 1.8, 1.8, None), (1.3, 3.3, 1.8, None))
_CONVERGENCE = {
    "SIC": ((1.2, 2.2, None, None), (1.6, 6.0, None, None)),
    "FASMC I": _FASMC_CONVERGENCE,
    "FASMC II": _FASMC_CONVERGENCE,
}
CONVERGENCE: dict[Cell, float | None] = {
    Cell(controller, reference, disturbance): value
    for controller, rows in _CONVERGENCE.items()
    for disturbance, row in zip(DISTURBANCES, rows, strict=True)
    for reference, value in zip(REFERENCES, row, strict=True)
}
"""Convergence time in the text [s]; for SIC, sine, fd2 it is "more than 6 s"; none is given for the irregular signal."""

REDUCTION = {"constant": 73.2, "sine": 56.7, "triangle": 61.8, "irregular": 68.7}
"""Reduction of the error by GMS against Stribeck compensation, averages in the text [%]."""

FIGURES: dict[int, tuple[Cell, ...]] = {
    **{
        number: (Cell(SIC, reference, disturbance),)
        for number, (disturbance, reference) in enumerate(((d, r) for d in DISTURBANCES for r in ("constant", "sine")), start=6)
    },
    **{
        number: (Cell(FASMC_1, reference, disturbance), Cell(FASMC_2, reference, disturbance))
        for first, references in ((10, ("constant", "sine")), (14, ("triangle", "irregular")))
        for number, (disturbance, reference) in enumerate(((d, r) for d in DISTURBANCES for r in references), start=first)
    },
    18: (Cell(FASMC_2, "sine", "fd2"),),
}
"""Runs in each figure of the paper; Figure 18 shows alpha, beta and D."""
