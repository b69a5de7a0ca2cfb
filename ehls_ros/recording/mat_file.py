"""MATLAB files in the format of the data contract: one variable per signal."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from scipy.io import loadmat

from ehls_ros.errors import BadInput
from ehls_ros.recording.columns import Columns
from ehls_ros.recording.contained import contained
from ehls_ros.recording.reason import reason
from ehls_ros.recording.table import RawTable, assemble, choose
from ehls_ros.trajectory import Trajectory

EXPECTED_FILE = "a MAT file as written by MATLAB's save -v7"


def read_mat(path: Path, columns: Columns = MappingProxyType({})) -> Trajectory:
    """Read a MAT file of version 4 to 7.

    Args:
        path: the file. Each variable is a column; the fields of a structure ``s`` are columns ``s.field``.
        columns: the user's own names and units.

    Returns:
        The trajectory, without metadata.

    Raises:
        BadInput: the file cannot be read, a column is wrong, or time does not increase with every sample.
    """
    return contained(read_here, path, columns, EXPECTED_FILE, Trajectory)


def read_here(path: Path, columns: Columns) -> Trajectory:
    """Read a MAT file in this process, without a memory limit; see :func:`read_mat`."""
    where, variables = str(path), _variables(path)
    chosen = choose(list(variables), columns, where)
    values = {name: np.atleast_1d(np.asarray(variables[column.name])) for name, column in chosen.items()}
    return assemble(values, chosen, where, lambda row: f"sample {row + 1}")


def raw_mat(path: Path) -> RawTable:
    """Return all variables of a MAT file that have one number per sample, by name; None for the others.

    Raises:
        BadInput: the file cannot be read.
    """
    return contained(raw_here, path, {}, EXPECTED_FILE, dict)


def raw_here(path: Path, columns: Columns) -> RawTable:
    """Do the same in this process, without a memory limit."""
    found = {name: np.atleast_1d(np.asarray(value)) for name, value in _variables(path).items()}
    return {
        name: value.astype(np.float64) if value.ndim == 1 and value.dtype.kind in "fiub" else None
        for name, value in found.items()
    }


def _variables(path: Path) -> dict[str, Any]:
    where = str(path)
    try:
        with path.open("rb") as stream:
            return dict(_flatten(loadmat(stream, simplify_cells=True)))
    except OSError as error:
        raise BadInput(f"the file cannot be read ({reason(error)})", where, EXPECTED_FILE) from None
    except NotImplementedError:
        raise BadInput("it is a MAT file of version 7.3", where, EXPECTED_FILE) from None
    except MemoryError:
        raise
    except Exception as error:  # noqa: BLE001 - scipy raises any exception on a damaged file
        raise BadInput(f"it is not a MAT file ({reason(error)})", where, EXPECTED_FILE) from None


def _flatten(variables: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in variables.items():
        if isinstance(value, dict):
            yield from _flatten(value, f"{prefix}{name}.")
        elif not name.startswith("__"):
            yield prefix + name, value
