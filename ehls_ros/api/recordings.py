"""Recording as an object: a trajectory with conversions to a table, a figure, a report or a file."""

from collections.abc import Collection, Iterable, Iterator, Mapping, MappingView, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from ehls_ros.api.arguments import check_kind
from ehls_ros.api.results import fields_of, figure, html, written
from ehls_ros.errors import BadInput, one_of
from ehls_ros.experiments.causal_limit import evaluate_recording
from ehls_ros.experiments.metrics import Metrics
from ehls_ros.experiments.run_folder import recording_in
from ehls_ros.recording import load as formats
from ehls_ros.recording.bag_writer import write_trajectory
from ehls_ros.recording.columns import ColumnMap, columns_from_mapping, read_columns
from ehls_ros.recording.csv_file import write_csv
from ehls_ros.report.experiment import write_experiment_report
from ehls_ros.report.run_figures import signals_over_time
from ehls_ros.trajectory import READABLE, SIGNALS, Trajectory

if TYPE_CHECKING:
    from pandas import DataFrame
    from plotly.graph_objects import Figure

Columns = ColumnMap | Mapping[str, Any] | str | Path
"""A map of columns: an object, a mapping like its YAML file, or the path of that file."""

Data = str | Path | Trajectory
"""A recording, or its path."""

EXPECTED_DATA = "a path, or a recording; of arrays, Recording(time_s, {'force_n': ...})"


@dataclass(frozen=True, kw_only=True, repr=False)
class Recording(Trajectory):
    """Signals over a common time base, from a file, a simulation, or arrays: ``Recording(time_s, {"force_n": force})``.

    ``recording["force_n"]`` is one signal, and ``"force_n" in recording`` is whether it was recorded. ``len(recording)`` is the
    number of samples.

    Attributes:
        name: name in errors and reports.
    """

    name: str = "recording"

    def __post_init__(self) -> None:
        """Convert lists and columns of tables to arrays, and check the times.

        Raises:
            ValueError: time does not increase, or a signal has an unknown name or another length.
        """
        object.__setattr__(self, "time_s", np.asarray(self.time_s, dtype=np.float64))
        signals = {name: np.asarray(values, dtype=np.float64) for name, values in self.signals.items()}
        object.__setattr__(self, "signals", signals)
        super().__post_init__()
        wrong = np.flatnonzero(~(np.diff(self.time_s) > 0.0))
        if wrong.size:
            before, after = self.time_s[wrong[0] : wrong[0] + 2]
            raise ValueError(f"time_s is {after} after {before} in sample {wrong[0] + 2}; expected times that increase, in s")

    def __getitem__(self, name: str) -> NDArray[np.float64]:
        """Return a signal, in SI units, shape (n,), or (n, elements) of the friction elements.

        Raises:
            KeyError: it was not recorded.
        """
        if name not in self.signals:
            raise KeyError(f"there is no signal {name!r}; expected {one_of(name, self.signals)}")
        return self.signals[name]

    @cached_property
    def metrics(self) -> Metrics:
        """Figures of merit of the run, computed from its signals as by `ehls report`.

        Raises:
            BadInput: it has no reference that was followed.
        """
        found = evaluate_recording(self)
        if found is None:
            what = "there are no metrics: the recording has no force_reference_n, or no force_n beside it"
            raise BadInput(what, self.name, "a run with both; name their columns in the map (columns=...)")
        return found

    def to_pandas(self) -> "DataFrame":
        """Return a table: one row per sample, indexed by ``time_s``, one column per signal in SI units."""
        from pandas import DataFrame, Index  # noqa: PLC0415 - half a second that only tables cost

        columns: dict[str, Any] = {}
        for name, values in self.signals.items():
            if values.ndim == 1:
                columns[name] = values
            else:
                columns |= {f"{name}_{number}": column for number, column in enumerate(values.T, start=1)}
        return DataFrame(columns, index=Index(self.time_s, name="time_s"))

    def describe(self) -> "DataFrame":
        """Return a table with one row per signal: description, unit, smallest and largest value, missing fraction."""
        from pandas import DataFrame  # noqa: PLC0415 - half a second that only tables cost

        rows = {}
        for name, values in self.signals.items():
            known = values[np.isfinite(values)]
            ends = (known.min(), known.max()) if known.size else (np.nan, np.nan)
            rows[name] = (*READABLE[name], *ends, 1.0 - known.size / max(values.size, 1))
        return DataFrame.from_dict(rows, orient="index", columns=["what", "unit", "min", "max", "missing"])

    def plot(self, *signals: str) -> "Figure":
        """Draw signals over time, with one row per unit.

        Args:
            signals: their names; none: the measured ones.

        Raises:
            BadInput: a signal was not recorded.
        """
        return figure(signals_over_time(self, signals))

    def report(self, path: str | Path) -> Path:
        """Write the HTML report of `ehls report` and return its path.

        Raises:
            BadInput: the file cannot be written.
        """
        return written(path, lambda file: write_experiment_report(self, evaluate_recording(self), file, name=self.name))

    def save(self, path: str | Path) -> Path:
        """Write a CSV file, or a bag if the path does not end in ``.csv``, and return its path.

        Raises:
            BadInput: the file cannot be written, or the bag exists.
        """
        writer = write_csv if Path(path).suffix.lower() == ".csv" else write_trajectory
        return written(path, lambda file: writer(file, self))

    def __repr__(self) -> str:
        """Return a one-line summary."""
        return f"<{type(self).__name__} {self.name}: {self._extent()}>"

    def _extent(self) -> str:
        seconds = float(self.time_s[-1] - self.time_s[0]) if len(self) else 0.0
        return f"{seconds:.4g} s, {len(self)} samples, {len(self.signals)} signals"

    def _repr_html_(self) -> str:
        table = self.describe().to_html(float_format="{:.5g}".format)
        return html(self.name, table, self.preparation.remarks, f": {self._extent()}")


Kind = TypeVar("Kind", bound=Recording)


def with_methods(kind: type[Kind], trajectory: Trajectory, name: str, **more: Any) -> Kind:
    """Convert a trajectory to a kind of recording, with ``more`` of its fields."""
    return kind(**fields_of(Trajectory, trajectory), name=name, **more)


def load(path: str | Path, columns: Columns | None = None) -> Recording:
    """Read data in any supported format.

    Supported are:

    * the folder of a run or a rosbag2, and its storage file ``.mcap`` or ``.db3``;
    * a table ``.csv``, ``.tsv``, ``.txt``, ``.dat``, ``.asc``, ``.xlsx``, ``.xls``, ``.mat``, ``.tdms``,
      ``.parquet``, ``.mf4``, ``.mdf``, ``.rsp``, ``.drv``, ``.rpc`` or ``.tim``;
    * a folder with the tables of one recording.

    Args:
        path: the folder or file.
        columns: names and units used in the data, as a mapping or the path of a YAML file with it. An example is
            ``{"position_m": {"name": "x", "unit": "mm"}}``. None: the names of the data contract.

    Returns:
        The recording, in SI units; ``preparation.remarks`` documents the reading.

    Raises:
        BadInput: the data cannot be read; the message states the location and the expected input.
    """
    check_kind(path, (str, Path), "path", "a path")
    return read(path, columns, SIGNALS)


def read(path: str | Path, columns: Columns | None, wanted: Collection[str]) -> Recording:
    """Read selected signals of a data set."""
    place = Path(path)
    return with_methods(Recording, formats.load(recording_in(place), column_map(columns), wanted), place.name or str(place))


def column_map(columns: Columns | None) -> ColumnMap | None:
    """Return a map of columns from any of its representations."""
    if columns is None or isinstance(columns, ColumnMap):
        return columns
    check_kind(columns, (Mapping, str, Path), "columns", "a path, or a mapping like {'position_m': {'name': 'x'}}")
    return columns_from_mapping(columns, Path("columns")) if isinstance(columns, Mapping) else read_columns(Path(columns))


def as_recording(data: Data, columns: Columns | None, wanted: Collection[str] = SIGNALS) -> Recording:
    """Return the data passed by a caller as a recording; ``columns`` are used for files only.

    Raises:
        BadInput: it cannot be read.
    """
    check_kind(data, (str, Path, Trajectory), "data", EXPECTED_DATA)
    if not isinstance(data, Trajectory):
        return read(data, columns, wanted)
    return data if isinstance(data, Recording) else with_methods(Recording, data, str(data.metadata.get("title", "recording")))


def by_name(data: Data | Iterable[Data], columns: Columns | None, wanted: Collection[str] = SIGNALS) -> dict[str, Recording]:
    """Return one or several recordings by name, numbered in case of duplicates."""
    # A table of pandas can be iterated too, over the names of its columns.
    check_kind(data, (str, Path, Trajectory, Sequence, MappingView, Iterator), "data", EXPECTED_DATA)
    given = [data] if isinstance(data, str | Path | Trajectory) else list(data)
    found = [as_recording(one, columns, wanted) for one in given]
    names = [one.name for one in found]
    if len(set(names)) < len(names):
        names = [f"{name} {number}" for number, name in enumerate(names, start=1)]
    return dict(zip(names, found, strict=True))
