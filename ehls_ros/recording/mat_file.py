"""Reading of MATLAB files: version 4 to 7 by scipy, version 7.3 by h5py."""

import warnings
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import scipy
from numpy.typing import NDArray

from ehls_ros.errors import BadInput
from ehls_ros.recording.contained import check_library, contained, library_errors
from ehls_ros.recording.mat_layouts import Layout, Leaf, Node, layout_of, modelica_layout, objects_only
from ehls_ros.recording.table import Pick, RawTable, check_length

EXPECTED_FILE = "a MAT file as written by MATLAB's save"

OCTAVE = (b"# Created by", b"# name: ", b"Octave-1-L", b"Octave-1-B")
"""First bytes of the formats in which Octave saves by default."""

MAX_DEPTH = 20
"""Deepest nesting of structures in version 7.3, whose links can form cycles [1]."""

MAX_VARIABLES = 10_000
"""Maximum number of variables of a file of version 7.3 [1]."""

SPARSE = "a sparse matrix: save full(...) of it"

UNNAMED = "None"
"""Name under which scipy returns MATLAB objects; several replace each other."""


def read_mat(path: Path, pick: Pick | None = None) -> RawTable:
    """Read a MAT file.

    Args:
        path: the file. Each variable is a column; the fields of a structure ``s`` are columns ``s.field``, those of a structure
            array ``s(1).field``, and the columns of a matrix ``m`` are ``m 1``, ``m 2`` and so on. Structures with time of
            Simulink, recordings of ControlDesk, and results of Dymola and OpenModelica have the names stored in them.
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
        if stream.read(len(OCTAVE[0])).startswith(OCTAVE):
            raise BadInput("it is in a format of Octave", where, "a MAT file, as by `save -v7` in Octave")
        stream.seek(0)
        newest = scipy.io.matlab.matfile_version(stream)[0] == 2
        if newest:
            check_library("h5py", "h5py", path)
            with import_module("h5py").File(path, "r") as file:
                return _table(layout_of(_group(file, _Budget())), pick, where)
        return _table(_older(stream, where), pick, where)


def _table(layout: Layout, pick: Pick | None, where: str) -> RawTable:
    objects = objects_only(layout)
    if objects:
        what = f"its variables are MATLAB objects ({', '.join(objects)})"
        raise BadInput(what, where, f"arrays, such as {next(iter(layout.wrong.values())).partition(': ')[2]}")
    names, time_of = tuple(layout.sources), dict(layout.time_of)
    if pick is not None:
        names = (*names, *layout.aliases)
        time_of |= {alias: time_of[name] for alias, name in layout.aliases.items() if name in time_of}
    wanted = names if pick is None else pick(names, time_of)
    sources = {name: layout.sources[layout.aliases.get(name, name)] for name in wanted}
    rows = max((source.length for source in sources.values()), default=0)
    total = sum({id(source.leaf): source.leaf.size for name, source in sources.items() if name not in layout.wrong}.values())
    check_length(rows, max(len(sources), -(-total // max(rows, 1))), where)
    values = {name: None if name in layout.wrong else source.values() for name, source in sources.items()}
    if pick is None:
        values = {name: found if found is not None and _is_signal(found) else None for name, found in values.items()}
    shapes = [shape for name, shape in layout.shapes.items() if any(column.startswith(f"{name} ") for column in wanted)]
    remarks = (*layout.remarks, *shapes)
    return RawTable(names, values, "sample", units=layout.units, remarks=remarks, wrong=layout.wrong, time_of=time_of)


def _is_signal(values: NDArray[Any]) -> bool:
    return values.ndim == 1 and values.dtype.kind in "fiub"


# --- version 4 to 7 ----------------------------------------------------------------------------


def _older(stream: BinaryIO, where: str) -> Layout:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of objects, which replace each other
        stream.seek(0)
        if "Aclass" in scipy.io.loadmat(stream, variable_names=("Aclass",)):
            stream.seek(0)
            return modelica_layout(scipy.io.loadmat(stream, squeeze_me=False), where)
        stream.seek(0)
        variables = scipy.io.loadmat(stream, simplify_cells=True)
        tree = {name: _node(value) for name, value in variables.items() if not name.startswith("__") and name != UNNAMED}
        if UNNAMED in variables:
            stream.seek(0)
            tree |= dict(_objects(stream))
    return layout_of(tree)


def _objects(stream: BinaryIO) -> Iterator[tuple[str, Node]]:
    for name, part in scipy.io.matlab.varmats_from_mat(stream):
        if name == UNNAMED:
            found = _node(scipy.io.loadmat(part, simplify_cells=True).get(UNNAMED))
            if isinstance(found, Leaf):
                yield found.text, found


def _node(value: Any) -> Node:
    """Convert a value as scipy returns it with simplified cells."""
    if isinstance(value, dict):
        return {name: _node(field) for name, field in value.items()}
    if isinstance(value, list) and value and all(isinstance(element, dict) for element in value):
        return [_node(element) for element in value]
    if isinstance(value, scipy.io.matlab.MatlabOpaque):
        name, _, kind, *_ = (part.decode("utf-8", "replace") if isinstance(part, bytes) else part for part in value.ravel()[0])
        return Leaf.of_object(str(name), str(kind))
    if scipy.sparse.issparse(value):
        return Leaf(value.shape, "O", wrong=SPARSE)
    if isinstance(value, str):
        return Leaf((len(value),), "U", text=value)
    array = np.atleast_1d(np.asarray(value if not isinstance(value, list) else np.array(value, dtype=object)))
    return Leaf(array.shape, array.dtype.kind, lambda: array)


# --- version 7.3 -------------------------------------------------------------------------------


class _Budget:
    """Number of variables read so far, of those of a file."""

    def __init__(self) -> None:
        self.count = 0

    def check(self, depth: int, fields: int, where: str) -> None:
        self.count += fields
        if depth > MAX_DEPTH or self.count > MAX_VARIABLES:
            what = f"its structures are nested {depth} deep with {self.count} fields"
            raise BadInput(what, where, f"at most {MAX_DEPTH} and {MAX_VARIABLES}")


def _group(group: Any, budget: _Budget, depth: int = 0) -> Node:
    """Return the variables of a file or the fields of a structure; links to other files are skipped."""
    h5py: Any = import_module("h5py")
    budget.check(depth, len(group), group.file.filename)
    members = {
        name: group[name]
        for name in group
        if not name.startswith("#") and isinstance(group.get(name, getlink=True), h5py.HardLink)
    }
    arrays = {name: m for name, m in members.items() if isinstance(m, h5py.Dataset) and _is_field(m)}
    if depth and arrays and arrays.keys() == members.keys() and len({m.size for m in arrays.values()}) == 1:
        count = next(iter(arrays.values())).size
        budget.check(depth, count * len(arrays), group.file.filename)
        flat = {name: m[()].ravel() for name, m in arrays.items()}
        return [
            {name: _member(group.file[references[k]], budget, depth + 1, name) for name, references in flat.items()}
            for k in range(count)
        ]
    return {name: _member(m, budget, depth + 1, name) for name, m in members.items() if not _elsewhere(m)}


def _is_field(dataset: Any) -> bool:
    """Return whether a dataset holds a field of each element of a structure array."""
    references = import_module("h5py").check_ref_dtype(dataset.dtype) is not None
    return references and "MATLAB_class" not in dataset.attrs and not _elsewhere(dataset)


def _elsewhere(member: Any) -> bool:
    return bool(getattr(member, "external", None) or getattr(member, "is_virtual", False))


def _member(member: Any, budget: _Budget, depth: int, name: str) -> Node:
    kind = member.attrs.get("MATLAB_class", b"double")
    written = kind.decode("ascii", "replace") if isinstance(kind, bytes) else str(kind)
    if "MATLAB_object_decode" in member.attrs:
        return Leaf.of_object(name, written)
    if "MATLAB_sparse" in member.attrs:
        return Leaf((0,), "O", wrong=SPARSE)
    if hasattr(member, "keys"):
        return _group(member, budget, depth)
    if "MATLAB_empty" in member.attrs:
        return Leaf((0,), {"char": "U", "cell": "O"}.get(written, "f"))
    if written == "char":
        short = member.size <= MAX_VARIABLES and member.dtype.kind in "ui"
        return Leaf((member.size,), "U", text="".join(map(chr, np.asarray(member[()]).T.ravel())) if short else "")
    shape = tuple(length for length in reversed(member.shape) if length != 1) or (1,)
    # MATLAB's arrays are stored in column-major order.
    return Leaf(shape, "O" if written == "cell" else member.dtype.kind, lambda: np.asarray(member[()]).T.reshape(shape))
