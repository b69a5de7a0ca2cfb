"""Identification of a rig from recordings as an object, as done by `ehls identify`."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Literal, overload

from ehls_ros.api.arguments import check_least
from ehls_ros.api.recordings import Columns, Data, by_name
from ehls_ros.api.results import figure, html, written
from ehls_ros.api.simulation import RigSource
from ehls_ros.api.simulation import rig as rig_of
from ehls_ros.errors import BadInput
from ehls_ros.estimate import Estimate
from ehls_ros.experiments.analysis import identify_whole_rig
from ehls_ros.identification import identify as friction
from ehls_ros.identification.identify import DEFAULT_OPTIMISER
from ehls_ros.identification.result import Identification
from ehls_ros.identification.rig_result import RigIdentification
from ehls_ros.physics.rig import Rig
from ehls_ros.progress import progress_bar
from ehls_ros.report.identification import write_identification_report
from ehls_ros.report.identification_figures import stribeck
from ehls_ros.report.rig_identification import write_rig_report

if TYPE_CHECKING:
    from pandas import DataFrame
    from plotly.graph_objects import Figure


class FrictionResult(Identification):
    """Identified friction: ``rig``, ``estimates`` by name, ``not_identifiable``, ``remarks``."""

    __slots__ = ()

    def to_pandas(self) -> "DataFrame":
        """Return the estimates as a table: value, standard error and unit by name."""
        return _table(self.estimates)

    def plot(self) -> "Figure":
        """Draw the Stribeck curve: steady friction against velocity, data and fits.

        Raises:
            BadInput: the data have no steady sliding.
        """
        return figure(stribeck(self))

    def report(self, path: str | Path, before: Rig | None = None) -> Path:
        """Write the HTML report of `ehls identify` and return its path.

        Args:
            path: the file.
            before: the rig before the identification, shown beside the new values.

        Raises:
            BadInput: the file cannot be written.
        """
        return written(path, lambda file: write_identification_report(self, file, before=before))

    def __repr__(self) -> str:
        """Return a one-line summary."""
        return _line(self)

    def _repr_html_(self) -> str:
        return _html(self)


class RigResult(RigIdentification):
    """An identified rig: ``rig``, ``estimates`` by name, ``not_identifiable`` with reasons, ``absent``, ``remarks``."""

    __slots__ = ()

    def to_pandas(self) -> "DataFrame":
        """Return the estimates as a table: value, standard error and unit by name."""
        return _table(self.estimates)

    def report(self, path: str | Path, before: Rig) -> Path:
        """Write the HTML report of `ehls identify --whole-rig` and return its path.

        Args:
            path: the file.
            before: the rig before the identification, shown beside the new values.

        Raises:
            BadInput: the file cannot be written.
        """
        return written(path, lambda file: write_rig_report(self, file, before=before))

    def __repr__(self) -> str:
        """Return a one-line summary."""
        return _line(self)

    def _repr_html_(self) -> str:
        return _html(self)


def _line(found: FrictionResult | RigResult) -> str:
    return f"<{type(found).__name__}: {len(found.estimates)} estimates, {len(found.not_identifiable)} not identifiable>"


def _html(found: FrictionResult | RigResult) -> str:
    lacking = [f"not identifiable: {', '.join(found.not_identifiable)}"] if found.not_identifiable else []
    return html("", found.to_pandas().to_html(float_format="{:.5g}".format), (*lacking, *found.remarks))


def _table(estimates: Mapping[str, Estimate]) -> "DataFrame":
    from pandas import DataFrame  # noqa: PLC0415 - half a second that only tables cost

    return DataFrame.from_dict(estimates, orient="index", columns=Estimate._fields)


@overload
def identify(
    data: Data | Iterable[Data],
    rig: RigSource,
    *,
    whole_rig: Literal[False] = False,
    columns: Columns | None = None,
    optimiser: str = DEFAULT_OPTIMISER,
    elements: int | None = None,
    seed: int = 0,
    progress: bool = True,
) -> FrictionResult: ...


@overload
def identify(
    data: Data | Iterable[Data],
    rig: RigSource,
    *,
    whole_rig: Literal[True],
    columns: Columns | None = None,
    seed: int = 0,
    progress: bool = True,
) -> RigResult: ...


def identify(
    data: Data | Iterable[Data],
    rig: RigSource,
    *,
    whole_rig: bool = False,
    columns: Columns | None = None,
    optimiser: str = DEFAULT_OPTIMISER,
    elements: int | None = None,
    seed: int = 0,
    progress: bool = True,
) -> FrictionResult | RigResult:
    """Identify a rig, or its friction alone, from recordings.

    Args:
        data: one or several recordings, or their paths.
        rig: the rig or its file, as starting point of the search.
        whole_rig: identify valve, flow, mass, spring and sensors as well, as far as they are recorded.
        columns: names and units used in the data, for paths.
        optimiser: of the friction's static fit.
        elements: number of friction elements; None: as many as the data support.
        seed: seed of the search's random numbers.
        progress: show a progress bar, in a notebook or on a terminal.

    Returns:
        The estimates with their standard errors, and the rig updated with them.

    Raises:
        BadInput: data or rig cannot be read, or the data cannot be used; the message names the signal.
    """
    check_least(elements, 1, "elements")
    check_least(seed, 0, "seed")
    known = rig_of(rig)
    if whole_rig and elements is not None:
        expected = "one of them: the whole rig keeps the rig file's number of friction elements"
        raise BadInput("elements and whole_rig are given", "identify", expected)
    recordings = by_name(data, columns)
    with progress_bar("identifying", shown=progress, lines=False) as bar:
        if whole_rig:
            return RigResult(*identify_whole_rig(recordings, known, seed=seed, progress=bar))
        found = friction.identify(
            recordings,
            known,
            optimiser=optimiser,
            elements=elements,
            seed=seed,
            progress=lambda doing, done, total: bar(done, total, doing),
        )
    return FrictionResult(*found)
