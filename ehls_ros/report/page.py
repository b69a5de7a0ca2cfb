"""Self-contained HTML page: blocks of text, tables and figures, with plotly.js embedded.

Every report consists of these blocks. All text is escaped here.
"""

import json
import logging
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from importlib import import_module
from pathlib import Path
from typing import TypeVar

import numpy as np
import yaml
from numpy.typing import NDArray

from ehls_ros.report.decimation import BUCKETS
from ehls_ros.report.plot import FONT, Axis, Layout, Trace, stacked_layout, time_layout, time_line

MISSING_NUMBER = "–"

PLOTLY = "pip install plotly (Ubuntu's python3-plotly lacks plotly.js)"
"""How to install the library that draws the figures."""

Configuration = Mapping[str, object]
"""Content of a configuration file: nested mappings, sequences, scalars and arrays under free names."""


@dataclass(frozen=True)
class Panel:
    """A figure with its heading.

    Attributes:
        title: heading.
        traces: plotly traces.
        layout: plotly layout.
        note: explanation of the figure, in one or two sentences.
        height: height of the figure in pixels.
        over_time: whether the horizontal axis is the time of the run; all such figures zoom together.
        least_width: width in pixels below which a figure of several subplots has fewer of them side by side.
    """

    title: str
    traces: Sequence[Trace]
    layout: Layout
    note: str = ""
    height: int = 260
    over_time: bool = True
    least_width: int = 0


def plane(title: str, traces: Sequence[Trace], x: Axis, y: Axis, note: str = "", height: int = 340, **layout: object) -> Panel:
    """Return a figure of one quantity against another.

    Args:
        title: heading.
        traces: plotly traces.
        x: horizontal axis.
        y: vertical axis.
        note: explanation of the figure.
        height: height in pixels.
        layout: further keys of plotly's layout.
    """
    return Panel(title, traces, stacked_layout(x, [y]) | layout, note, height, over_time=False)


class Rows:
    """A figure of rows over one time axis, built from top to bottom.

    Attributes:
        title: heading.
        time: time of the samples since the start, shape (n,) [s].
        traces: the plotly traces so far.
    """

    def __init__(self, title: str, time: NDArray[np.float64], *rows: Axis, buckets: int = BUCKETS) -> None:
        """Begin a figure.

        Args:
            title: heading.
            time: time of the samples since the start, shape (n,) [s].
            rows: axes of the first rows; lines go to the last one.
            buckets: number of intervals to which a long line is reduced.
        """
        self.title, self.time, self.traces = title, time, list[Trace]()
        self._rows, self._buckets = list(rows), buckets

    def row(self, axis: Axis) -> int:
        """Add a row to which the next lines go, and return its number."""
        self._rows.append(axis)
        return len(self._rows)

    def line(
        self,
        values: NDArray[np.float64],
        name: str,
        color: str,
        *,
        width: float = 1.5,
        dash: str = "solid",
        time: NDArray[np.float64] | None = None,
        **style: object,
    ) -> None:
        """Draw a signal in the last row.

        Args:
            values: in the trajectory's unit, shape (n,), NaN in gaps.
            name: entry in the legend.
            color: colour of the line.
            width: line width in pixels.
            dash: plotly's name of the pattern.
            time: times of the samples [s]; by default those of the figure.
            style: further keys of plotly's trace.
        """
        unit, row, time = self._rows[-1].unit, len(self._rows), self.time if time is None else time
        trace = time_line(time, values, name, unit, color, row=row, width=width, dash=dash, buckets=self._buckets)
        self.traces.append(trace | style)

    def panel(self, note: str = "", height: int = 260, *, over_time: bool = True) -> Panel:
        """Return the figure.

        Args:
            note: explanation of the figure.
            height: height in pixels.
            over_time: whether the horizontal axis is the time of the run.
        """
        return Panel(self.title, self.traces, time_layout(float(self.time[-1]), self._rows), note, height, over_time)


@dataclass(frozen=True)
class LeftOut:
    """A figure that could not be drawn.

    Attributes:
        title: its heading.
        reason: reason, such as the missing signals.
    """

    title: str
    reason: str


@dataclass(frozen=True)
class Entry:
    """A table cell with more than a single text.

    Attributes:
        text: first line.
        beside: second line, such as a value to compare with.
        heat: shade, from -1 (far better, blue) over 0 (none) to 1 (far worse, orange).
    """

    text: str
    beside: str = ""
    heat: float = 0.0


def number(value: object, digits: int = 3) -> str:
    """Write a number in fixed point with thousands separators, or a dash if it is not a finite number.

    Args:
        value: the number.
        digits: significant digits; digits before the point are never dropped.
    """
    if isinstance(value, bool) or not isinstance(value, int | float | np.number) or not math.isfinite(value):
        return MISSING_NUMBER
    if isinstance(value, int | np.integer) or value == 0:
        return f"{int(value):,}".replace(",", "\u202f")
    magnitude = int(f"{value:.{digits - 1}e}".split("e")[1])
    if not -4 <= magnitude < 15:
        return f"{value:.{digits - 1}e}"
    return f"{value:,.{max(digits - 1 - magnitude, 0)}f}".replace(",", "\u202f")


def limit_text(limit: float) -> str:
    """Return a causal limit [N] for a table, to 0.1 N, the resolution of force sensors; "unknown" if NaN."""
    if math.isnan(limit):
        return "unknown"
    return f"{limit:.1f} N" if limit >= MIN_LIMIT else f"<{MIN_LIMIT:g} N"


def with_unit(value: object, unit: str, missing: str = MISSING_NUMBER) -> str:
    """Write a number with its unit; if it is not a finite number, the text for a missing one."""
    text = number(value)
    return missing if text == MISSING_NUMBER else f"{text} {unit}"


def signed(value: float, digits: int = 3) -> str:
    """Write a change with its sign."""
    return f"{'+' if value > 0 else '−' if value < 0 else '±'}{number(abs(value), digits)}"


def listed(parts: Sequence[str]) -> str:
    """Join words by commas and a final "and"."""
    return "".join(parts) if len(parts) < 2 else f"{', '.join(parts[:-1])} and {parts[-1]}"


def verdict(text: str, *, good: bool | None) -> str:
    """Return the sentence that summarises the page.

    Args:
        text: the sentence.
        good: True if all is well, False if something needs attention, None if the data are insufficient.
    """
    kind = {True: "good", False: "look", None: "open"}[good]
    return f'<p class="verdict {kind}">{escape(text)}</p>'


def heading(text: str) -> str:
    """Return the heading of a section."""
    return f'<h2 class="part" id="{_anchor(text)}">{escape(text)}</h2>'


def _anchor(text: str) -> str:
    return re.sub(r"\W+", "-", text.lower()).strip("-")


def sections(parts: Iterable[tuple[str, Iterable[str]]]) -> list[str]:
    """Return the sections of a page below a line of links to them.

    Args:
        parts: heading and blocks of each; a section without blocks is left out.

    Returns:
        The blocks of the page.
    """
    made = [(title, kept) for title, blocks in parts if (kept := [block for block in blocks if block])]
    links = "".join(f'<a href="#{_anchor(title)}">{escape(title)}</a>' for title, _ in made)
    contents = f'<nav class="contents">{links}</nav>'
    return [contents, *(block for title, blocks in made for block in (heading(title), *blocks))]


def paragraph(text: str) -> str:
    """Return a paragraph."""
    return f"<p>{_html(text)}</p>"


def bullets(texts: Iterable[str]) -> str:
    """Return a bulleted list of short texts."""
    return f"<ul>{''.join(f'<li>{_html(text)}</li>' for text in texts)}</ul>"


def facts(items: Iterable[tuple[str, str]]) -> str:
    """Return a compact grid of key figures.

    Args:
        items: label and value of each; one with an empty value is left out.
    """
    cells = "".join(f"<div><dt>{escape(label)}</dt><dd>{escape(value)}</dd></div>" for label, value in items if value)
    return f'<dl class="facts">{cells}</dl>' if cells else ""


MIN_LIMIT = 0.1
"""Smallest causal limit shown as a number [N]."""

Row = Sequence[str | Entry]
"""A row of a table: one text or entry per cell."""


def table(header: Sequence[str], rows: Sequence[Row]) -> str:
    """Return a table whose first column names the row; words are aligned to the left, figures to the right.

    A table too wide for a narrow screen becomes a list there.

    Args:
        header: one title per column.
        rows: one text or entry per cell.
    """
    columns = list(zip(*[[_text(cell) for cell in row] for row in rows], strict=True)) or [()] * len(header)
    kinds = [' class="words"' if place and not _figures(texts) else "" for place, texts in enumerate(columns)]
    listed = _width(header, columns) > NARROW
    head = "".join(f'<th scope="col"{kind}>{escape(title)}</th>' for title, kind in zip(header, kinds, strict=True))
    named = [f' data-column="{escape(title)}"' if listed and title else "" for title in header]
    body = "".join(
        f'<tr><th scope="row">{_inner(row[0])}</th>'
        + "".join(
            f"<td{name}{kind}{_shade(cell)}>{_inner(cell)}</td>"
            for cell, name, kind in zip(row[1:], named[1:], kinds[1:], strict=True)
        )
        + "</tr>"
        for row in rows
    )
    return (
        f'<div class="wide"><table{LISTED if listed else ""}><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>'
    )


Item = TypeVar("Item")


def table_of(items: Iterable[Item], columns: Mapping[str, Callable[[Item], str | Entry]]) -> str:
    """Return a table with a row for each item; empty without items.

    Args:
        items: the items, in order.
        columns: title of each column, and the function that returns an item's cell in it.
    """
    rows = [[cell(item) for cell in columns.values()] for item in items]
    return table(tuple(columns), rows) if rows else ""


NARROW, CHARACTER, PADDING = 340, 7.5, 17
"""Width of a table on a narrow screen, of a character in it, and of the padding of a cell, in pixels."""

LISTED = ' class="listed"'
_FIGURE = re.compile(r"[<>≈▲±+−\-\s]*\d|–$")


def _text(cell: str | Entry) -> str:
    return cell if isinstance(cell, str) else cell.text


def _figures(texts: Sequence[str]) -> bool:
    """Return whether a column contains figures, with which most of its cells begin."""
    filled = [text for text in texts if text]
    return 2 * sum(bool(_FIGURE.match(text)) for text in filled) > len(filled)


def _width(header: Sequence[str], columns: Sequence[Sequence[str]]) -> float:
    """Estimate the width of a table in pixels, with unbroken figures and titles broken between words."""
    longest = [max([0, *map(len, texts), *map(len, title.split())]) for title, texts in zip(header, columns, strict=True)]
    return sum(CHARACTER * count + PADDING for count in longest)


def _shade(cell: str | Entry) -> str:
    if isinstance(cell, str) or not cell.heat:
        return ""
    color = "213, 94, 0" if cell.heat > 0 else "0, 114, 178"
    return f' style="background: rgba({color}, {0.5 * min(abs(cell.heat), 1.0):.2f})"'


def _inner(cell: str | Entry) -> str:
    beside = f"<small>{_html(cell.beside)}</small>" if isinstance(cell, Entry) and cell.beside else ""
    return _html(_text(cell)) + beside


def _html(text: str) -> str:
    """Return a text as HTML; text between backticks is marked as code."""
    return re.sub(r"`([^`]+)`", r"<code>\1</code>", escape(text))


def figures(panels: Iterable[Panel | LeftOut], *, columns: int = 1) -> str:
    """Return the figures that could be drawn.

    Args:
        panels: the figures, in this order.
        columns: number of figures side by side.
    """
    drawn = [panel for panel in panels if isinstance(panel, Panel)]
    if not drawn:
        return ""
    hint = f'<p class="hint">{_HINT}</p>' if sum(panel.over_time for panel in drawn) > 1 else ""
    style = f"--columns: {min(columns, len(drawn))}"
    return "\n".join([hint, f'<div class="figures" style="{style}">', *map(_figure, drawn), "</div>"])


def left_out(panels: Iterable[Panel | LeftOut]) -> str:
    """Return the list of figures that could not be drawn, one per line; more than a few are collapsed."""
    missing = [panel for panel in panels if isinstance(panel, LeftOut)]
    lines = "".join(
        f'<p class="left-out"><b>{escape(panel.title)}</b> is left out: {escape(panel.reason)}.</p>' for panel in missing
    )
    if len(missing) <= A_FEW:
        return lines
    return f"<details><summary>{len(missing)} figures are left out, as signals are missing</summary>{lines}</details>"


A_FEW = 3
"""Maximum number of omitted figures named without a click."""


def _figure(panel: Panel) -> str:
    description = json.dumps({"data": list(panel.traces), "layout": panel.layout}, separators=(",", ":"))
    note = f"<p>{escape(panel.note)}</p>" if panel.note else ""
    kind = "figure over-time" if panel.over_time else "figure"
    return (
        f"<section><header><h2>{escape(panel.title)}</h2>{note}</header>"
        f'<div class="{kind}" data-least-width="{panel.least_width}" style="height: {panel.height}px"></div>'
        f'<script type="application/json">{description.replace("<", chr(92) + "u003c")}</script></section>'
    )


def collapsed(title: str, text: str) -> str:
    """Return a block of preformatted text that opens on a click.

    Args:
        title: its heading.
        text: shown verbatim.
    """
    return f"<details><summary>{escape(title)}</summary><pre>{escape(text)}</pre></details>"


def as_yaml(configuration: Configuration) -> str:
    """Write a configuration as YAML."""
    plain = json.loads(json.dumps(configuration, default=_plain))
    return yaml.safe_dump(plain, sort_keys=False, allow_unicode=True)


def _plain(value: object) -> object:
    if isinstance(value, Mapping):
        return dict(value)
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else str(value)


def write_page(path: Path, title: str, subtitle: str, blocks: Iterable[str]) -> None:
    """Write the page.

    Args:
        path: file to write; its folder must exist.
        title: heading.
        subtitle: one line below it.
        blocks: blocks returned by the other functions of this module.
    """
    plotly = plotly_js()
    if plotly is None:
        logging.getLogger(__name__).warning("%s has no figures, which need plotly: %s", path, PLOTLY)
        script = f'<style>.figure::after {{ content: "needs plotly: {PLOTLY}" }}</style>'
    else:
        script = f"<script>{plotly}</script>\n<script>{_beside('page.js')}</script>"
    path.write_text(
        f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="{_POLICY}">
<title>{escape(title)}</title>
<style>{_beside("page.css").replace("FONT", FONT)}</style>
</head>
<body>
<main>
<h1>{escape(title)}</h1>
<p class="subtitle">{escape(subtitle)}</p>
{chr(10).join(blocks)}
</main>
{script}
</body>
</html>
""",
        encoding="utf-8",
    )


def plotly_js() -> str | None:
    """Return the source of plotly.js; None if it is not installed, as with Ubuntu's python3-plotly, which lacks it."""
    try:
        text: str = import_module("plotly.offline").get_plotlyjs()
    except (ImportError, OSError):
        return None
    return text


def _beside(name: str) -> str:
    """Return the text of a file in this module's folder."""
    return Path(__file__).with_name(name).read_text(encoding="utf-8")


_HINT = "Drag across a figure to zoom in; all figures over time follow. Double-click to go back."

_POLICY = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:"
