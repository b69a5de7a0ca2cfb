"""Declaration of a programme's file: its settings, its limits, and the tree of its blocks.

An entry of ``blocks`` is a block or a repeat::

    - {block: cycles, name: service load, waveform: sine, mean: 5.0e+3, amplitude: 4.0e+3, frequency: 2.0, count: 1000}
    - {repeat: 20, blocks: [...]}
"""

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, NamedTuple

from ehls_ros.control.programme.blocks import BLOCKS
from ehls_ros.errors import BadInput, one_of
from ehls_ros.schema import missing_key, notes, parse, quantity, text

MAX_PASSES = 10**15
"""Most repeats."""

MAX_DEPTH = 16
"""Largest nesting depth of repeats."""


class Limits(NamedTuple):
    """Limits at which the programme stops; omitted ones are not monitored."""

    peak: Annotated[tuple[float, float] | None, text("lowest and highest peak of a load cycle", unit="N or m")] = None
    valley: Annotated[tuple[float, float] | None, text("lowest and highest valley of a load cycle", unit="N or m")] = None
    peak_error: Annotated[
        float | None, quantity("N or m", "largest difference of a load cycle's peak from the reference's", above=0.0)
    ] = None
    valley_error: Annotated[
        float | None, quantity("N or m", "largest difference of a load cycle's valley from the reference's", above=0.0)
    ] = None
    error: Annotated[float | None, quantity("N or m", "largest difference from the reference at any time", above=0.0)] = None
    position: Annotated[tuple[float, float] | None, text("lowest and highest position of the piston", unit="m")] = None
    stiffness_change: Annotated[
        float | None,
        quantity(
            "%", "largest change of force range over displacement range of a load cycle since the block's first ones", above=0.0
        ),
    ] = None
    stiffness_cycles: Annotated[int, quantity("1", "first load cycles whose mean stiffness is compared with", minimum=1)] = 10
    settling: Annotated[int, quantity("1", "first load cycles of each pass of a block that are not judged", minimum=0)] = 0

    @property
    def of_value(self) -> bool:
        """Whether a limit depends on the measured force or position that the programme prescribes."""
        own = (self.peak, self.valley, self.peak_error, self.valley_error, self.error, self.stiffness_change)
        return any(limit is not None for limit in own)

    @property
    def of_position(self) -> bool:
        """Whether a limit depends on the position of the piston."""
        return self.position is not None or self.stiffness_change is not None


class Pacing(NamedTuple):
    """Null pacing: whether and how the programme follows the measured peaks and valleys.

    ``static``: it waits at each of them. ``dynamic``: its time runs slower while they fall short.
    """

    mode: Annotated[str, text("none, static or dynamic", choices=("none", "static", "dynamic"))] = "none"
    tolerance: Annotated[
        float | None, quantity("N or m", "largest shortfall of a measured peak or valley from the reference's", above=0.0)
    ] = None
    timeout: Annotated[
        float,
        quantity("s", "time without a peak in tolerance, static or at the slowest speed, after which it stops", above=0.0),
    ] = 30.0
    slowest: Annotated[
        float,
        quantity("1", "lowest speed of the programme's time in dynamic pacing; 1: the normal speed", minimum=0.01, maximum=1.0),
    ] = 0.1


class Parameters(NamedTuple):
    """Settings of a programme, and its blocks; in place of these a spec may name a YAML ``file``."""

    blocks: Annotated[tuple[Mapping[str, Any], ...], text("blocks and repeats, in their order")]
    title: Annotated[str, text("what the programme is called")] = "programme"
    start: Annotated[float, quantity("N or m", "value before the first block", minimum=-1e6, maximum=1e6)] = 0.0
    transition: Annotated[
        float,
        quantity(
            "s", "time of the ramp to a block that begins at another value than the programme stands at", above=0.0, maximum=1e4
        ),
    ] = 0.5
    hold: Annotated[
        float | None,
        quantity("N or m", "value that is held after a stop; none: where the programme stands", minimum=-1e6, maximum=1e6),
    ] = None
    stop_time: Annotated[
        float, quantity("s", "time in which a stopped programme comes to rest, and gets going again", above=0.0, maximum=1e3)
    ] = 0.5
    hold_time: Annotated[
        float, quantity("s", "time of the ramp to the value held, and of the ramp back", above=0.0, maximum=1e3)
    ] = 1.0
    limits: Annotated[Mapping[str, Any] | None, text("limits of all blocks; a block may have its own")] = None
    pacing: Annotated[Mapping[str, Any] | None, text("null pacing of all blocks; a block may have its own")] = None


class Leaf(NamedTuple):
    """Block as declared in the file.

    Attributes:
        number: number in the order of the file.
        name: name of the block.
        kind: name of its member of :data:`BLOCKS`.
        parameters: parameters of the block.
        limits: limits that stop the programme in this block.
        pacing: null pacing in this block.
    """

    number: int
    name: str
    kind: str
    parameters: Any
    limits: Limits
    pacing: Pacing


class Repeat(NamedTuple):
    """Blocks that are run several times in succession."""

    count: int  # type: ignore[assignment]  # a tuple has a method of this name
    parts: tuple["Leaf | Repeat", ...]


def tree_of(p: Parameters, where: str) -> Repeat:
    """Check a programme's blocks and return them as one repeat that is run once.

    Args:
        p: the programme.
        where: the file, for error messages.

    Raises:
        BadInput: an entry is wrong; the first is reported.
    """
    shared = {"limits": p.limits or {}, "pacing": p.pacing or {}}
    _settings(shared, {}, where)
    return Repeat(1, _parts(p.blocks, where, shared, [], 0))


Shared = Mapping[str, Mapping[str, Any]]
"""Settings of all blocks, which a block may replace one by one: ``limits`` and ``pacing``."""


def _settings(shared: Shared, entry: Mapping[str, Any], where: str) -> tuple[Limits, Pacing]:
    """Return limits and pacing of a block."""
    merged = {}
    for name, common in shared.items():
        own = entry.get(name)
        if own is not None and not isinstance(own, Mapping):
            raise BadInput(f"{name} is {own!r}", where, "a mapping")
        merged[name] = {**common, **(own or {})}
    pacing = parse(Pacing, merged["pacing"], f"{where}: pacing")
    if pacing.mode != "none" and pacing.tolerance is None:
        raise missing_key("tolerance", notes(Pacing)["tolerance"], f"{where}: pacing")
    return parse(Limits, merged["limits"], f"{where}: limits"), pacing


def _parts(
    entries: Sequence[Mapping[str, Any]], where: str, shared: Shared, leaves: list[Leaf], depth: int
) -> tuple[Leaf | Repeat, ...]:
    if not isinstance(entries, list | tuple) or not entries:
        raise BadInput(f"blocks is {entries!r}", where, "a list of one block or more")
    if depth > MAX_DEPTH:
        raise BadInput("the repeats are too deep", where, f"at most {MAX_DEPTH} within each other")
    return tuple(_part(entry, f"{where}: blocks[{i}]", shared, leaves, depth) for i, entry in enumerate(entries))


def _part(entry: Any, where: str, shared: Shared, leaves: list[Leaf], depth: int) -> Leaf | Repeat:
    if not isinstance(entry, Mapping) or ("block" in entry) == ("repeat" in entry):
        kinds = ", ".join(BLOCKS.names())
        raise BadInput(f"entry is {entry!r}", where, f"a mapping with 'block', one of {kinds}, or with 'repeat' and 'blocks'")
    if "repeat" in entry:
        for key in entry:
            if key not in {"repeat", "blocks"}:
                raise BadInput(f"key {key!r} is unknown", where, one_of(key, ("repeat", "blocks")))
        count = parse(_Times, {"repeat": entry["repeat"]}, where).repeat
        return Repeat(count, _parts(entry.get("blocks", ()), where, shared, leaves, depth + 1))
    kind = entry["block"]
    member = BLOCKS.load(kind, where)
    number = len(leaves)
    named = parse(_Named, {key: entry[key] for key in ("name",) if key in entry}, where)
    within = f"{where}: {kind}"
    leaf = Leaf(
        number,
        named.name or f"{kind} {number}",
        kind,
        parse(member.Parameters, {key: value for key, value in entry.items() if key not in OF_ANY}, within),
        *_settings(shared, entry, where),
    )
    leaves.append(leaf)
    return leaf


OF_ANY = ("block", "name", "limits", "pacing")
"""Keys of every block besides its parameters."""


class _Times(NamedTuple):
    repeat: Annotated[int, quantity("1", "number of passes", minimum=1, maximum=MAX_PASSES)]


class _Named(NamedTuple):
    name: Annotated[str, text("what the block is called")] = ""
