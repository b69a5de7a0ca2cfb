"""Times of day and dates as recorders write them."""

import numpy as np
import pytest

from ehls_ros.recording.table_layout import is_clock
from ehls_ros.recording.times import seconds_of_clock

NOON = 43200.0

CLOCKS = {
    "milliseconds behind a colon": ("12:00:01:000 12:00:01:005", (NOON + 1.0, NOON + 1.005)),
    "milliseconds that are not padded": ("12:00:01:5 12:00:01:10", (NOON + 1.005, NOON + 1.01)),
    "microseconds behind a colon": ("12:00:01:000250 12:00:01:000500", (NOON + 1.00025, NOON + 1.0005)),
    "more digits than nanoseconds": ("12:00:01,0000000000000000000 12:00:01.5000000000000000001", (NOON + 1.0, NOON + 1.5)),
    "halves of the day": ("11:59:59.5_AM 12:00:00.0_PM 12:00:00.5_PM", (NOON - 0.5, NOON, NOON + 0.5)),
    "halves of the day over midnight": ("11:59:59_p.m. 12:00:00_a.m.", (2 * NOON - 1.0, 2 * NOON)),
    "minutes only": ("11:59_AM 12:00_PM", (NOON - 60.0, NOON)),
    "an offset from UTC": ("2026-05-01T12:00:00.125+01:00 2026-05-01T12:00:00.135+01:00", (NOON + 0.125, NOON + 0.135)),
    "the end of summer time": ("2026-10-25T02:59:59+02:00 2026-10-25T02:00:00+01:00", (10799.0, 10800.0)),
    "dates with slashes, the year first": ("2026/05/01_12:00:00 2026/05/01_12:00:01", (NOON, NOON + 1.0)),
    "a month by its name": ("01-Mai-2026_12:00:00 01-May-2026_12:00:01", (NOON, NOON + 1.0)),
    "hours of one digit": ("1/2/2026_9:00 1/2/2026_9:01", (32400.0, 32460.0)),
    "a year of two digits": ("28.2.24_23:59:59 29.2.24_00:00:00", (2 * NOON - 1.0, 2 * NOON)),
    "a day above 12": ("12/30/2026_23:59:59 12/31/2026_00:00:00", (2 * NOON - 1.0, 2 * NOON)),
}
"""Cells, whose spaces are written as underscores, and their seconds since midnight."""


@pytest.mark.parametrize("name", CLOCKS)
def test_clock_times_are_read_with_all_their_digits(name: str):
    cells, seconds = CLOCKS[name]
    texts = [cell.replace("_", " ") for cell in cells.split()]
    assert all(map(is_clock, texts))
    found = seconds_of_clock(np.array(texts, dtype=object))
    np.testing.assert_allclose(found.seconds, seconds, rtol=0.0, atol=1e-9)
    assert found.remark == ""


@pytest.mark.parametrize(("last", "order"), [("01/03/2026", "month/day/year"), ("02/02/2026", "day/month/year")])
def test_the_order_of_day_and_month_is_decided_by_the_rows(last: str, order: str):
    found = seconds_of_clock(np.array(["01/02/2026 23:59:59", f"{last} 00:00:00"], dtype=object))
    assert np.diff(found.seconds) == [1.0]
    assert found.remark == f"dates such as '01/02/2026 23:59:59' are read as {order}, in which the days follow each other"


def test_cells_that_are_no_clock_are_missing():
    for cells in (["12:00:01", "x", None], ["2026-05-01 12:00:01", "2026-02-30 12:00:01", None], ["31/02/2026 9:00", "x", ""]):
        seconds = seconds_of_clock(np.array(cells, dtype=object)).seconds
        assert np.isnan(seconds).tolist() == [cells[0].startswith("31"), True, True]


@pytest.mark.parametrize("cell", ["", "12", "1.5", "1,5", "12:03", "1:2:3", "2026", "1-2-3", "10.20.30.40", "-", "abc"])
def test_other_cells_are_no_clock(cell: str):
    assert not is_clock(cell)
