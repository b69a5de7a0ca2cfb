"""Reading of MATLAB files with one variable per signal: version 4 to 7 by scipy, version 7.3 by h5py."""

from collections.abc import Iterator, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from ehls_ros.errors import BadInput
from ehls_ros.recording.contained import check_library, contained, library_errors
from ehls_ros.recording.table import Pick, RawTable, check_length

EXPECTED_FILE = "a MAT file as written by MATLAB's save"

MAX_DEPTH = 20
"""Deepest nesting of structures in version 7.3, whose links can form cycles [1]."""

MAX_VARIABLES = 10_000
"""Maximum number of variables of a file of version 7.3 [1]."""


def read_mat(path: Path, pick: Pick | None = None) -> RawTable:
    """Read a MAT file.

    Args:
        path: the file. Each variable is a column; the fields of a structure ``s`` are columns ``s.field``.
        pick: returns the names of the columns to read; None for all.

    Returns:
        The table.

    Raises:
        BadInput: the file cannot be read.
    """
    return contained(read_here, path, pick, EXPECTED_FILE, RawTable)


def read_here(path: Path, pick: Pick | None) -> RawTable:
    """Read a MAT file in this process, without a memory limit; see :func:`read_mat`."""
    where = str(path)
    with library_errors("a MAT file", where, EXPECTED_FILE), path.open("rb") as stream:
        newest = scipy.io.matlab.matfile_version(stream)[0] == 2
        if newest:
            check_library("h5py", "h5py", path)
            with import_module("h5py").File(path, "r") as file:
                return _table(dict(_datasets(file)), pick, where)
        stream.seek(0)
        return _table(dict(_flatten(scipy.io.loadmat(stream, simplify_cells=True))), pick, where)


def _table(variables: Mapping[str, Any], pick: Pick | None, where: str) -> RawTable:
    names = tuple(variables)
    wanted = names if pick is None else pick(names)
    check_length(max((variables[name].size for name in wanted if hasattr(variables[name], "size")), default=0), 1, where)
    return RawTable(names, {name: _signal(variables[name], pick is None) for name in wanted}, "sample")


def _signal(variable: Any, lenient: bool) -> NDArray[Any] | None:
    """Return the values of a variable; None for text and cell arrays and, if lenient, for other non-signals."""
    of_newest = hasattr(variable, "attrs")
    values = np.atleast_1d(np.asarray(variable[()] if of_newest else variable))
    if of_newest:
        # MATLAB vectors have two dimensions, and arrays are stored in column-major order.
        values = values.T.squeeze() if values.size > 1 else values.ravel()
        if variable.attrs.get("MATLAB_class", b"double") in (b"char", b"cell"):
            return None
    if lenient and (values.ndim != 1 or values.dtype.kind not in "fiub"):
        return None
    return values


def _flatten(variables: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in variables.items():
        if isinstance(value, dict):
            yield from _flatten(value, f"{prefix}{name}.")
        elif not name.startswith("__"):
            yield prefix + name, value


def _datasets(group: Any, prefix: str = "", depth: int = 0) -> Iterator[tuple[str, Any]]:
    """Yield the variables of version 7.3; links to other files are skipped."""
    h5py: Any = import_module("h5py")
    if depth > MAX_DEPTH or len(group) > MAX_VARIABLES:
        what = f"its structures are nested {depth} deep with {len(group)} fields"
        raise BadInput(what, group.file.filename, f"at most {MAX_DEPTH} and {MAX_VARIABLES}")
    for name in group:
        if name.startswith("#") or not isinstance(group.get(name, getlink=True), h5py.HardLink):
            continue
        member = group[name]
        if isinstance(member, h5py.Group):
            yield from _datasets(member, f"{prefix}{name}.", depth + 1)
        elif isinstance(member, h5py.Dataset) and not (member.external or member.is_virtual):
            yield prefix + name, member
