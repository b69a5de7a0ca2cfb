"""Result of a tuning as HTML: error over margin, results and numbers."""

import math
from collections.abc import Callable, Sequence
from html import escape
from typing import NamedTuple

from ehls_ros.dashboard.graph import TuningPoint, TuningResult
from ehls_ros.report.page import MIN_LIMIT, MISSING_NUMBER, number, with_unit
from ehls_ros.report.plot import decades
from ehls_ros.report.tuning import HELD, LOST

WIDTH, HEIGHT = 300, 190
"""Size of the drawing, in its units, which are pixels where it has this width."""

LEFT, RIGHT, TOP, BOTTOM = 58, 8, 8, 36
"""Margins around the axes."""

MAX_TICKS = 6
"""Largest number of ticks of an axis."""

STEPS = (1.0, 2.0, 5.0)
"""Steps of ticks within a decade."""


class _Axes(NamedTuple):
    """Axes of the drawing.

    Attributes:
        gain_db: right end of the linear axis, which begins at zero [dB].
        low: lower end of the logarithmic axis [N].
        high: upper end [N].
    """

    gain_db: float
    low: float
    high: float

    def x(self, gain_db: float) -> float:
        return LEFT + (WIDTH - LEFT - RIGHT) * gain_db / self.gain_db

    def y(self, error: float) -> float:
        low, at, high = (math.log(value) for value in (self.low, error, self.high))
        return TOP + (HEIGHT - TOP - BOTTOM) * (high - at) / (high - low)


def trade_off_svg(result: TuningResult) -> str:
    """Return the largest error over the gain margin as SVG; the stylesheet colours it."""
    curve = _curve(result)
    marks = {"found": _place(result.found), "default": _place(result.default)}
    points = [*curve, *filter(None, marks.values())]
    limit = _drawn_limit(result)
    low, high = decades([error for _, error in points] + ([limit] if limit else []))
    axes = _Axes(1.05 * max([result.wanted_db, 1.0, *(gain for gain, _ in points)]), low, high)
    parts = [_grid(axes), _line(axes, [(result.wanted_db, low), (result.wanted_db, high)], "wanted")]
    if limit:
        parts.append(_line(axes, [(0.0, limit), (axes.gain_db, limit)], "limit"))
    parts.append(_line(axes, curve, "curve"))
    parts += [_dot(axes, place, "small") for place in curve]
    parts += [_dot(axes, place, name) for name, place in marks.items() if place is not None]
    title = "<title>Largest error over gain margin</title>"
    return f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" role="img">{title}{"".join(parts)}</svg>'


def legend(result: TuningResult) -> str:
    """Return the legend of the drawing as HTML: only what it shows."""
    shown = {
        "found": ("●", "found", _place(result.found)),
        "default": ("◆", "default", _place(result.default)),
        "curve": ("━", "all slower or faster", _curve(result)),
        "wanted": ("┊", "margin asked for", True),
        "limit": ("╌", "causal limit", _drawn_limit(result)),
    }
    return "".join(f'<span class="{name}"><i>{sign}</i> {text}</span>' for name, (sign, text, there) in shown.items() if there)


def results_table(result: TuningResult) -> str:
    """Return error and margins of default and found numbers as an HTML table, with the causal limit below them."""
    cells: dict[str, Callable[[TuningPoint], str]] = {
        "largest error": lambda point: with_unit(point.error, "N", LOST),
        HELD: lambda point: with_unit(None if point.held is None else 100.0 * point.held, "%", LOST),
        "gain margin": lambda point: with_unit(point.gain_db, "dB", "unlimited"),
        "phase margin": lambda point: with_unit(point.phase_deg, "°", "unlimited"),
    }
    if not result.default.held and not result.found.held:
        del cells[HELD]
    rows = [(name, cell(result.default), cell(result.found)) for name, cell in cells.items()]
    limit = result.causal_limit
    text = "unknown" if limit is None else with_unit(limit, "N") if limit >= MIN_LIMIT else f"below {MIN_LIMIT:g} N"
    last = f'<tr><th>causal limit of the error</th><td colspan="2">{escape(text)}</td></tr>'
    return _table("in simulation", rows, last)


def numbers_table(result: TuningResult) -> str:
    """Return the numbers, default and found, as an HTML table."""
    rows = [
        (f"{each.name} [{each.unit}]" if each.unit != "1" else each.name, number(each.default, 4), number(each.found, 4))
        for each in result.numbers
    ]
    return _table("number", rows, titles=[each.meaning for each in result.numbers])


def _table(head: str, rows: Sequence[tuple[str, str, str]], last: str = "", titles: Sequence[str] = ()) -> str:
    lines = [f"<tr><th>{head}</th><td>default</td><td>found</td></tr>"]
    for index, (name, default, found) in enumerate(rows):
        title = f' title="{escape(titles[index])}"' if titles else ""
        lines.append(f"<tr{title}><th>{escape(name)}</th><td>{escape(default)}</td><td>{escape(found)}</td></tr>")
    return f"<table>{''.join(lines)}{last}</table>"


def _place(point: TuningPoint) -> tuple[float, float] | None:
    """Return gain margin [dB] and error [N] of a point; None if it cannot be drawn."""
    if not point.error or point.gain_db is None or not 0.0 < point.error < math.inf:
        return None
    return point.gain_db, point.error


def _curve(result: TuningResult) -> list[tuple[float, float]]:
    """Return the places of the curve in the order of speed; unstable loops have none."""
    return [place for place in map(_place, result.curve) if place is not None and place[0] > 0.0]


def _drawn_limit(result: TuningResult) -> float:
    """Return the causal limit [N]; 0 if it is unknown or too small for a force sensor."""
    return result.causal_limit if result.causal_limit is not None and result.causal_limit >= MIN_LIMIT else 0.0


def _grid(axes: _Axes) -> str:
    """Return ticks, their labels and the titles of both axes."""
    bottom, right = HEIGHT - BOTTOM, WIDTH - RIGHT
    parts = []
    for gain in _linear_ticks(axes.gain_db):
        x = axes.x(gain)
        parts.append(f'<path class="grid" d="M{x:.1f} {TOP}V{bottom}"/>')
        parts.append(f'<text x="{x:.1f}" y="{bottom + 14}" text-anchor="middle">{gain:g}</text>')
    for error in _logarithmic_ticks(axes.low, axes.high):
        y = axes.y(error)
        parts.append(f'<path class="grid" d="M{LEFT} {y:.1f}H{right}"/>')
        parts.append(f'<text x="{LEFT - 5}" y="{y + 4:.1f}" text-anchor="end">{_tick(error)}</text>')
    middle = 0.5 * (TOP + bottom)
    parts.append(f'<text x="{0.5 * (LEFT + right):.0f}" y="{HEIGHT - 6}" text-anchor="middle">gain margin [dB]</text>')
    parts.append(f'<text transform="translate(11 {middle:.0f}) rotate(-90)" text-anchor="middle">largest error [N]</text>')
    return "".join(parts)


def _linear_ticks(end: float) -> list[float]:
    decade = 10.0 ** math.floor(math.log10(end / MAX_TICKS))
    step = next(step * decade for step in (*STEPS, 10.0) if step * decade * MAX_TICKS >= end)
    return [step * index for index in range(math.floor(end / step) + 1)]


def _logarithmic_ticks(low: float, high: float) -> list[float]:
    """Return ticks within the ends: 1, 2 and 5 in each decade, or powers of ten, the highest ones only if there are many."""
    exponents = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    for steps in (STEPS, STEPS[:1]):
        ticks = [tick for exponent in exponents for step in steps if low <= (tick := step * 10.0**exponent) <= high]
        if len(ticks) <= MAX_TICKS:
            break
    return ticks[:: math.ceil(len(ticks) / MAX_TICKS) or 1]


def _tick(value: float) -> str:
    return number(value, 1) if value < 1e6 else f"{value:.0e}" if value != 0.0 else MISSING_NUMBER


def _line(axes: _Axes, points: Sequence[tuple[float, float]], name: str) -> str:
    if len(points) < 2:
        return ""
    path = "L".join(f"{axes.x(gain):.1f} {axes.y(error):.1f}" for gain, error in points)
    return f'<path class="{name}" d="M{path}"/>'


def _dot(axes: _Axes, place: tuple[float, float], name: str) -> str:
    x, y = axes.x(place[0]), axes.y(place[1])
    if name == "default":
        return f'<path class="{name}" d="M{x:.1f} {y - 6:.1f}l6 6l-6 6l-6 -6z"/>'
    return f'<circle class="{name}" cx="{x:.1f}" cy="{y:.1f}" r="{2.5 if name == "small" else 5}"/>'
