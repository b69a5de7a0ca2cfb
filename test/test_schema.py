"""Values are converted to their declared type, or refused with the expected value."""

import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal, NamedTuple

import pytest

from ehls_ros.errors import BadInput
from ehls_ros.schema import Misfit, fitted, from_json, parse, quantity, text


class Cell(NamedTuple):
    """A set of every kind of parameter."""

    gain: Annotated[float, quantity("V/N", "gain", above=0.0)]
    channel: Annotated[int, quantity("1", "channel", minimum=0, maximum=31)] = 0
    range: Annotated[tuple[float, float], text("ends", "V")] = (-10.0, 10.0)
    levels: Annotated[tuple[float, ...], text("levels")] = ()
    spacing: Literal["linear", "log"] = "linear"
    reaction: Annotated[str, text("reaction", choices=("hold", "cut"))] = "hold"
    spread: Annotated[tuple[float, float] | None, text("spread")] = None
    limit: Annotated[float | None, quantity("N", "limit", minimum=0.0)] = None
    live: bool = False
    note: Any = None


def test_values_are_taken_as_declared():
    cell = parse(Cell, {"gain": 2, "channel": 3.0, "range": [0, 5], "levels": [1, 2.5], "spread": [1, 2], "note": [1]}, "cell")
    assert cell == Cell(2.0, 3, (0.0, 5.0), (1.0, 2.5), spread=(1.0, 2.0), note=[1])
    assert type(cell.gain) is float
    assert type(cell.channel) is int
    assert parse(Cell, {"gain": 1.0, "spread": None, "limit": None}, "cell") == Cell(1.0)


@pytest.mark.parametrize(
    ("wrong", "line"),
    [
        ({}, "key 'gain' is missing; expected a value for it (gain [V/N])"),
        ({"gain": 0}, "gain is 0; expected a value greater than 0 (gain [V/N])"),
        (
            {"gain": True},
            "gain is True; expected a valid number (in YAML, yes, on, no and off mean true and false) (gain [V/N])",
        ),
        ({"gain": "1"}, "gain is '1'; expected a valid number without quotes (gain [V/N])"),
        ({"gain": math.inf}, "gain is inf; expected a finite number (gain [V/N])"),
        ({"gain": 10**400}, None),
        ({"gain": 1.0, "channel": 1.5}, "channel is 1.5; expected a valid integer (channel [1], 0 to 31)"),
        ({"gain": 1.0, "channel": math.nan}, "channel is nan; expected a valid integer (channel [1], 0 to 31)"),
        ({"gain": 1.0, "channel": 32}, "channel is 32; expected a value less than or equal to 31 (channel [1], 0 to 31)"),
        ({"gain": 1.0, "range": 5.0}, "range is 5.0; expected a list (ends [V])"),
        ({"gain": 1.0, "range": [1.0]}, "range is [1.0]; expected a list of 2 values (ends [V])"),
        ({"gain": 1.0, "levels": [1.0, math.nan]}, "levels[1] is nan; expected a finite number (levels)"),
        ({"gain": 1.0, "spacing": "lin"}, "spacing is 'lin'; expected one of linear, log; did you mean 'linear'?"),
        ({"gain": 1.0, "reaction": "warn"}, "reaction is 'warn'; expected one of hold, cut (reaction)"),
        ({"gain": 1.0, "reaction": 7}, "reaction is 7; expected a valid string in quotes (reaction)"),
        ({"gain": 1.0, "live": 1}, "live is 1; expected a valid boolean"),
        (
            {"gain": 1.0, 7: 1},
            "key '7' is unknown; expected one of gain, channel, range, levels, spacing, reaction, spread, limit, live, note",
        ),
    ],
)
def test_what_does_not_fit_is_named(wrong, line):
    with pytest.raises(BadInput) as caught:
        parse(Cell, wrong, "cell")
    assert line is None or str(caught.value) == f"cell: {line}"
    assert caught.value.where == "cell"


class Counted(NamedTuple):
    """A document's count of one topic."""

    messages: int
    names: Mapping[str, str] | None = None


def test_a_document_is_read_as_its_type():
    found = from_json(Mapping[str, Counted], b'{"/a": {"messages": 3}, "/b": {"messages": 4, "names": {"x": "y"}}}')
    assert found == {"/a": Counted(3), "/b": Counted(4, {"x": "y"})}


@pytest.mark.parametrize(
    "document",
    [b"", b"\xff", b"[]", b'{"/a": 3}', b'{"/a": {"messages": "3"}}', b'{"/a": {"messages": 3, "more": 1}}', b"[" * 10**6],
)
def test_another_document_is_refused(document):
    with pytest.raises(ValueError):  # noqa: PT011 - of several kinds
        from_json(Mapping[str, Counted], document)


@pytest.mark.parametrize("document", ['{"x": NaN}', '{"x": -Infinity}', '{"x": "\\ud800"}'])
def test_what_json_has_not_is_refused_wherever_it_stands(document):
    with pytest.raises(ValueError):  # noqa: PT011 - of several kinds
        from_json(Any, document)


def test_a_misfit_names_value_and_expectation():
    with pytest.raises(Misfit, match=r"^'a'; expected a valid number$"):
        fitted(float, "a")
