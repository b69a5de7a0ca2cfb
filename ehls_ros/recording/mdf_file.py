"""Reading of ASAM MDF files, version 2 to 4, with asammdf: one channel per signal, each group with its own times."""

import re
from collections import Counter
from collections.abc import Iterator, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ehls_ros.errors import BadInput
from ehls_ros.recording.contained import check_library, contained, library_errors
from ehls_ros.recording.table import Pick, RawTable, check_length, unused

LIBRARY = "asammdf"
"""Module that reads the files."""

EXPECTED_FILE = "an MDF file"

MAGIC = (b"MDF     ", b"UnFinMF ")
"""First bytes of an MDF file, closed or not."""

TIME_COLUMN = "time"
"""Name of the time column of the first group; those of further ones are numbered."""

TIME_MASTER = 1
"""Kind of a master channel, in version 4, that holds times; others hold angles, distances or numbers."""

NUMBER = re.compile(r"\d+\.?\d*(?:[eE][+-]?\d+)?|\.\d+(?:[eE][+-]?\d+)?")
WORD = re.compile(r"[A-Za-z_][\w.]*")
FUNCTIONS = frozenset(
    [
        "X",
        "X1",
        "abs",
        "acos",
        "asin",
        "atan",
        "cos",
        "cosh",
        "exp",
        "log",
        "log10",
        "pow",
        "sin",
        "sinh",
        "sqrt",
        "tan",
        "tanh",
    ]
)
"""Names that a conversion may contain; its library evaluates it as an expression of Python."""


def is_mdf(path: Path) -> bool:
    """Return whether a file begins as an MDF file, whatever its suffix; false if it cannot be read."""
    try:
        with path.open("rb") as stream:
            return stream.read(len(MAGIC[0])) in MAGIC
    except OSError:
        return False


def read_mdf(path: Path, pick: Pick | None = None) -> RawTable:
    """Read an MDF file.

    Args:
        path: the file. A channel is a column by its name, or as ``group 2/channel`` if several groups have one of that name.
            The times of the groups are ``time``, ``time 2`` and so on.
        pick: returns the names of the columns to read; None for all.

    Returns:
        The table. Samples marked as invalid are NaN.

    Raises:
        BadInput: asammdf is missing, or the file cannot be read.
    """
    check_library(LIBRARY, LIBRARY, path)
    return contained(read_here, path, pick, EXPECTED_FILE, RawTable, [LIBRARY, "numexpr", "pandas"])


def read_here(path: Path, pick: Pick | None) -> RawTable:
    """Read an MDF file in this process, without a memory limit; see :func:`read_mdf`."""
    where = str(path)
    if not is_mdf(path):
        raise BadInput(f"it does not begin with {MAGIC[0].decode().strip()}", where, EXPECTED_FILE)
    with library_errors("an MDF file", where, EXPECTED_FILE), import_module(LIBRARY).MDF(path) as file:
        return _table(file, pick, where)


def _table(file: Any, pick: Pick | None, where: str) -> RawTable:
    masters = {k: _master(file, k) for k in range(len(file.groups))}
    found = [
        (k, index, channel)
        for k, group in enumerate(file.groups)
        for index, channel in enumerate(group.channels)
        if index != file.masters_db.get(k)
    ]
    if not found:
        raise BadInput("it has no channel", where, EXPECTED_FILE)
    count = Counter(channel.name for *_, channel in found)
    places: dict[str, tuple[int, int, Any]] = {}
    for k, index, channel in found:
        name = channel.name if count[channel.name] == 1 else f"group {k + 1}/{channel.name}"
        places[unused(name, places)] = (k, index, channel)
    axes: dict[int, str] = {}
    for k in dict.fromkeys(k for k, *_ in places.values() if masters[k]):
        axes[k] = unused(TIME_COLUMN, {*places, *axes.values()})
    time_of = {name: axes[k] for name, (k, *_) in places.items() if k in axes}
    names = (*places, *axes.values())
    wanted = names if pick is None else pick(names, time_of)
    groups = {axis: k for k, axis in axes.items()}
    lengths = [int(file.groups[groups[w] if w in groups else places[w][0]].channel_group.cycles_nr) for w in wanted]
    check_length(max(lengths, default=0), len(wanted), where)
    values: dict[str, NDArray[Any] | None] = {}
    wrong: dict[str, str] = {}
    for name in wanted:
        if name in groups:
            values[name] = np.asarray(file.get_master(groups[name]), dtype=np.float64)
            continue
        k, index, channel = places[name]
        for formula in _formulas(channel.conversion):
            _check(formula, name, where)
        values[name] = _samples(*file.get(group=k, index=index, samples_only=True, ignore_invalidation_bits=True))
        if values[name] is None:
            wrong[name] = "text, or a record of several values"
    units = {name: unit for name, (*_, c) in places.items() if (unit := _unit(c))} | dict.fromkeys(groups, "s")
    remarks = (f"{', '.join(groups)}: counted from {file.header.start_time.isoformat()}",) if groups else ()
    return RawTable(names, values, "sample", units=units, remarks=remarks, wrong=wrong, time_of=time_of)


def _master(file: Any, number: int) -> bool:
    """Return whether a group has times."""
    owner = getattr(file.groups[number].channel_group, "cg_master_index", None)
    group = number if owner is None else owner
    index = file.masters_db.get(group)
    return index is not None and getattr(file.groups[group].channels[index], "sync_type", TIME_MASTER) == TIME_MASTER


def _samples(found: Any, invalid: Any) -> NDArray[Any] | None:
    """Return the numbers of a channel, with NaN where they are marked as invalid; None for text and records."""
    samples = np.asarray(found)
    if samples.dtype.kind not in "fiub" or samples.ndim != 1:
        return None
    return samples if invalid is None else np.where(np.asarray(invalid, dtype=np.bool_), np.nan, samples)


def _unit(channel: Any) -> str:
    return str(getattr(channel, "unit", "") or getattr(channel.conversion, "unit", "") or "").strip("\0 ")


def _formulas(conversion: Any) -> Iterator[str]:
    """Yield the formulas of a conversion, and of those to which it refers."""
    formula = getattr(conversion, "formula", "")
    if formula:
        yield formula.decode("latin-1") if isinstance(formula, bytes) else str(formula)
    blocks: Mapping[str, Any] = getattr(conversion, "referenced_blocks", None) or {}
    for block in blocks.values():
        if hasattr(block, "conversion_type"):
            yield from _formulas(block)


def _check(formula: str, name: str, where: str) -> None:
    """Reject a formula with anything but arithmetic of the raw value."""
    words = set(WORD.findall(NUMBER.sub(" ", formula.strip("\0"))))
    if words - FUNCTIONS or any(sign in formula for sign in "'\"[]{}@\\;:"):
        raise BadInput(f"column '{name}' has the formula {formula!r}", where, "arithmetic of X; save the channel converted")
