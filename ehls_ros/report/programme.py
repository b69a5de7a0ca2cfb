"""Report of a test programme: its course, its blocks, and its rainflow counts."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.control.programme.expansion import Programme
from ehls_ros.experiments.programme_summary import Counts, Summary, in_bins
from ehls_ros.report import page, plot
from ehls_ros.report.page import Panel, Row, number
from ehls_ros.report.plot import Axis

MOST = 400
"""Maximum number of block passes drawn, from the beginning of the programme."""

SHOWN = 4
"""Number of load cycles of a block drawn in detail; the rest of it is a line along peaks and valleys."""

SAMPLES = 50
"""Number of samples of a drawn load cycle."""


def write_programme_report(programme: Programme, summary: Summary, path: Path) -> None:
    """Write one self-contained HTML file that shows a programme.

    Args:
        programme: the programme.
        summary: summary of its content.
        path: file to write; its folder must exist.
    """
    header = ["block", "kind", "passes", "load cycles", "time [s]", "peak [N]", "valley [N]", "largest rate [N/s]"]
    rows: list[Row] = [
        [b.name, b.kind, *map(number, (b.passes, b.load_cycles, b.duration_s, b.peak_n, b.valley_n, b.largest_rate_n_s))]
        for b in summary.blocks
    ]
    known = [("Rainflow of the programme", summary.rainflow), ("Rainflow of the recorded force", summary.recorded)]
    parts = [
        ("Course", [page.figures([_course(programme)])]),
        ("Blocks", [page.table(header, rows)]),
        *((title, [_counts(counts)]) for title, counts in known if counts),
    ]
    sentence = (
        "; ".join(summary.complaints) or "The rig reaches the forces of every block, and their rates with the piston at rest."
    )
    page.write_page(
        path,
        title=summary.title,
        subtitle=f"Test programme of {number(summary.load_cycles)} load cycles in {number(summary.duration_s)} s",
        blocks=[page.verdict(sentence, good=not summary.complaints), *page.sections(parts)],
    )


def _course(programme: Programme) -> Panel:
    time, value = (np.concatenate(parts) for parts in zip(*_drawn(programme), strict=True))
    last = float(time[-1])
    cut = "" if last >= programme.duration - 1e-6 else f" The first {number(last)} s of {number(programme.duration)} s."
    traces = [plot.line(time, value, "programme", plot.KILONEWTON, plot.BLUE)]
    note = f"Of each block the first {SHOWN} load cycles; of the others where they end.{cut}"
    return Panel("Programme", traces, plot.time_layout(last, [Axis("force", plot.KILONEWTON)]), note, 360)


def _drawn(programme: Programme) -> Iterator[tuple[Array, Array]]:
    """Yield times [s] and values [N] of each pass of a block."""
    at = 0.0
    for _ in range(MOST):
        spot = programme.spot(at)
        course = spot.segment.course
        cycles = min(course.count, SHOWN)
        first = cycles * course.cycle if cycles else course.duration
        local = np.linspace(0.0, first, SAMPLES * max(cycles, 1) + 1)
        if cycles < course.count:
            # Peaks lie at half load cycles.
            rest = np.linspace(first, course.duration, min(2 * (course.count - cycles), 200) + 1)
            local = np.append(local, np.round(2.0 * rest[1:] / course.cycle) * 0.5 * course.cycle)
        yield spot.since + local, spot.segment.sample(np.minimum(local, course.duration))[:, 0]
        at = spot.end
        if at >= programme.duration - 1e-6:
            return


def _counts(counts: Counts) -> str:
    rows: list[Row] = [[number(size), number(mean), number(cycles, 6)] for size, mean, cycles in in_bins(counts)]
    return page.table(["range [N]", "mean [N]", "cycles"], rows)
