"""Draw the plots of docs/how_to/tuning.md, tuning_*.svg.

One plot per parameter of FASMC: three runs, and the settled error over the parameter's range with the bound (44). All runs
apply a constant 10 kN against the paper's large disturbance, in this process.
"""

from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ehls_ros.experiments.loop import run_in_process
from ehls_ros.experiments.spec import load_spec
from ehls_ros.schema import declarations
from ehls_ros.trajectory import Trajectory

FOLDER = Path(__file__).parent
SPEC = load_spec(FOLDER.parents[1] / "config" / "experiments" / "constant_fd2.yaml")
DURATION = 6.0
TRANSIENT = 3.0
"""Start of the settled part of a run [s]."""

COLOURS = ("#1b6ca8", "#222222", "#c8553d")
WIDTH, HEIGHT = 380, 580
"""One panel above the other: a telephone shows them in full size."""

PANEL_WIDTH, PANEL_HEIGHT, LEFT = 290, 200, 66
TOPS = (40, 330)
FAR_ABOVE = 1e4
"""Upper limit of the error axis; larger errors are drawn there [N]."""


class Case(NamedTuple):
    """One plot: parameter, the three values shown, the range swept, and the time shown [s]."""

    name: str
    shown: tuple[float, float, float]
    sweep: tuple[float, float]
    start: float
    end: float


CASES = (
    Case("k", (6.0, 12.0, 24.0), (3.0, 96.0), 0.0, 1.6),
    Case("g", (20.0, 60.0, 240.0), (6.0, 1000.0), 4.0, 6.0),
    Case("h", (6.25, 25.0, 50.0), (1.0, 100.0), 4.0, 6.0),
    Case("b", (55.0, 107.5, 215.0), (20.0, 1000.0), 4.0, 6.0),
)


class Axis(NamedTuple):
    """A straight or logarithmic scale from data to pixels."""

    low: float
    high: float
    first: float
    last: float
    logarithmic: bool = False

    def place(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the pixels of values, cut to the axis."""
        low, high, at = (np.log10(v) if self.logarithmic else np.asarray(v) for v in (self.low, self.high, values))
        part = np.clip((at - low) / (high - low), 0.0, 1.0)
        return np.asarray(self.first + part * (self.last - self.first))

    def ticks(self) -> list[float]:
        """Return round numbers on the axis."""
        if self.logarithmic:
            decades = range(int(np.floor(np.log10(self.low))), int(np.ceil(np.log10(self.high))) + 1)
            factors = (1, 2, 5) if self.high < 100.0 * self.low else (1,)
            ticks = [factor * 10.0**n for n in decades for factor in factors]
            return [tick for tick in ticks if self.low <= tick * 1.001 and tick <= self.high * 1.001]
        step = 10.0 ** np.floor(np.log10((self.high - self.low) / 2.5))
        step *= next(factor for factor in (1, 2, 5, 10) if (self.high - self.low) / (factor * step) <= 5)
        return [float(n * step) for n in range(round(np.ceil(self.low / step)), int(self.high / step + 1e-9) + 1)]


def run(name: str, value: float) -> Trajectory:
    """Run the experiment with one parameter changed."""
    tuned = SPEC.controller._replace(parameters=SPEC.controller.parameters._replace(**{name: value}))
    return run_in_process(SPEC._replace(settings=SPEC.settings._replace(duration=DURATION), controller=tuned))


def settled_error(trajectory: Trajectory) -> float:
    """Return the largest settled error [N]."""
    return float(np.abs(trajectory["force_error_n"][trajectory.time_s >= TRANSIENT]).max())


def draw(case: Case) -> str:
    """Return the plot of one parameter as SVG."""
    unit = next(d.unit for d in declarations(type(SPEC.controller.parameters)) if d.name == case.name)
    runs = [(value, run(case.name, value)) for value in case.shown]
    values = np.geomspace(*case.sweep, 15)
    swept = [run(case.name, value) for value in values]
    errors = np.array([settled_error(trajectory) for trajectory in swept])
    bounds = np.array([trajectory["force_bound_n"][-1] for trajectory in swept])

    above = [(f"{case.name} = {value:g}", trajectory.time_s, trajectory["force_error_n"]) for value, trajectory in runs]
    shown = [error[(time >= case.start) & (time <= case.end)] for _, time, error in above]
    rise = case.start == 0.0
    largest = 1.1 * max(float(np.abs(error).max()) for error in shown)
    low, high = (-10.0, 1.0) if rise else (-largest, largest)
    x = Axis(case.start, case.end, LEFT, LEFT + PANEL_WIDTH)
    y = Axis(low, high, TOPS[0] + PANEL_HEIGHT, TOPS[0])
    parts = frame(x, y, "time [s]", "force error [kN]" if rise else "force error [N]")
    for (label, time, error), colour, row in zip(above, COLOURS, range(3), strict=True):
        part = (time >= case.start) & (time <= case.end)
        parts.append(line(x.place(time[part][::4]), y.place(error[part][::4] * (1e-3 if rise else 1.0)), colour))
        parts.append(words(LEFT + 96 * row, TOPS[0] - 12, label, colour))

    x = Axis(*case.sweep, LEFT, LEFT + PANEL_WIDTH, logarithmic=True)
    y = Axis(1.0, FAR_ABOVE, TOPS[1] + PANEL_HEIGHT, TOPS[1], logarithmic=True)
    parts += frame(x, y, f"{case.name} [{unit}]", "largest settled error [N]")
    there = np.isfinite(bounds)
    parts.append(line(x.place(values[there]), y.place(bounds[there]), "#888888", dashed=True))
    parts.append(line(x.place(values), y.place(errors), COLOURS[1]))
    at = y.place(np.array([settled_error(trajectory) for _, trajectory in runs]))
    parts += [dot(*place, colour) for *place, colour in zip(x.place(np.array(case.shown)), at, COLOURS, strict=True)]
    parts.append(words(LEFT, TOPS[1] - 12, "simulated", COLOURS[1]))
    parts.append(words(LEFT + 84, TOPS[1] - 12, "bound (44)", "#888888"))
    return svg(parts)


def frame(x: Axis, y: Axis, below: str, beside: str) -> list[str]:
    """Return a panel's frame, ticks and titles."""
    size = f'width="{x.last - x.first}" height="{y.first - y.last}"'
    parts = [f'<rect x="{x.first}" y="{y.last}" {size} fill="none" stroke="#bbbbbb"/>']
    for tick in x.ticks():
        at = float(x.place(np.float64(tick)))
        parts += [stroke(at, y.first, at, y.last), words(at, y.first + 16, f"{tick:g}", anchor="middle")]
    for tick in y.ticks():
        at = float(y.place(np.float64(tick)))
        parts += [stroke(x.first, at, x.last, at), words(x.first - 6, at + 4, f"{tick:g}", anchor="end")]
    middle = (y.first + y.last) / 2
    parts.append(words((x.first + x.last) / 2, y.first + 36, below, anchor="middle"))
    turned = f'transform="rotate(-90 {x.first - 46} {middle})"'
    parts.append(words(x.first - 46, middle, beside, anchor="middle", more=turned))
    return parts


def stroke(x1: float, y1: float, x2: float, y2: float) -> str:
    """Return a line of the grid."""
    return f'<line x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}" stroke="#e4e4e4"/>'


def line(x: NDArray[np.float64], y: NDArray[np.float64], colour: str, *, dashed: bool = False) -> str:
    """Return a curve."""
    points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y, strict=True))
    dashes = ' stroke-dasharray="5 4"' if dashed else ""
    return f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="1.6"{dashes}/>'


def dot(x: float, y: float, colour: str) -> str:
    """Return a point."""
    return f'<circle cx="{x:.1f}" cy="{y:.1f}" r="4" fill="{colour}"/>'


def words(x: float, y: float, text: str, colour: str = "#444444", *, anchor: str = "start", more: str = "") -> str:
    """Return a text."""
    return f'<text x="{x:.1f}" y="{y:.1f}" fill="{colour}" text-anchor="{anchor}" {more}>{escape(text)}</text>'


def svg(parts: Sequence[str]) -> str:
    """Return the SVG file, with a white background for dark themes."""
    inside = "\n".join(parts)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" width="{WIDTH}" height="{HEIGHT}" '
        f'font-family="sans-serif" font-size="12">\n<rect width="100%" height="100%" fill="#ffffff"/>\n{inside}\n</svg>\n'
    )


if __name__ == "__main__":
    for case in CASES:
        path = FOLDER / f"tuning_{case.name}.svg"
        path.write_text(draw(case), encoding="utf-8")
        print(path)
