"""Diagnosis of a rig's model as an object, as done by `ehls diagnose`."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from ehls_ros.api.arguments import check_least
from ehls_ros.api.recordings import Columns, Data, by_name
from ehls_ros.api.results import fields_of, figure, html, written
from ehls_ros.api.simulation import RigSource
from ehls_ros.api.simulation import rig as rig_of
from ehls_ros.diagnosis.record import USED
from ehls_ros.diagnosis.result import Diagnosis
from ehls_ros.experiments.analysis import diagnose_recordings
from ehls_ros.experiments.consequences import Consequences
from ehls_ros.progress import progress_bar
from ehls_ros.report.diagnosis import answer, write_diagnosis_report
from ehls_ros.report.diagnosis_figures import stage_bars
from ehls_ros.report.diagnosis_findings import largest_first
from ehls_ros.report.diagnosis_residuals import over_time

if TYPE_CHECKING:
    from pandas import DataFrame
    from plotly.graph_objects import Figure


@dataclass(frozen=True, kw_only=True, repr=False)
class DiagnosisResult(Diagnosis):
    """Errors of a rig's model, their causes, the gain from correcting them, and the consequences.

    Attributes:
        follows: free run of both models, benefit to the controller, and in ``next_experiment`` an experiment that would
            separate open causes.
        name: name of the diagnosed recording.
    """

    follows: Consequences
    name: str

    @property
    def sentence(self) -> str:
        """The result in a sentence."""
        return answer(self)[0]

    def to_pandas(self) -> "DataFrame":
        """Return the causes as a table, one row per parameter; share is that of the removable error."""
        from pandas import DataFrame  # noqa: PLC0415 - half a second that only tables cost

        columns = ["cause", "probability", "share", "parameter", "value", "std", "unit"]
        rows = [
            (cause.name, cause.probability, cause.share, name, *found)
            for cause in self.causes
            for name, found in cause.parameters.items()
        ]
        return DataFrame(rows, columns=columns)

    def plot(self) -> "Figure":
        """Draw the residual over time in the channel with the largest error, without and with the causes."""
        return figure(over_time(self, largest_first(self)[0]) if self.traces else stage_bars(self))

    def plot_stages(self) -> "Figure":
        """Draw the residual of each stage of the model beside its noise floor."""
        return figure(stage_bars(self))

    def report(self, path: str | Path) -> Path:
        """Write the HTML report of `ehls diagnose` and return its path.

        Raises:
            BadInput: the file cannot be written.
        """
        return written(path, lambda file: write_diagnosis_report(self, file, self.follows, self.name))

    def __repr__(self) -> str:
        """Return a one-line summary."""
        causes = ", ".join(cause.name for cause in self.causes)
        return f"<{type(self).__name__} {self.name}: {self.verdict}{f': {causes}' if causes else ''}>"

    def _repr_html_(self) -> str:
        table = self.to_pandas().to_html(index=False, float_format="{:.4g}".format) if self.causes else ""
        return html(self.sentence, table, (*self.missing, *self.remarks, *self.follows.all_remarks))


def diagnose(
    data: Data | Iterable[Data],
    rig: RigSource,
    *,
    columns: Columns | None = None,
    baseline: Data | Iterable[Data] = (),
    seed: int = 0,
    threads: int | None = None,
    progress: bool = True,
) -> DiagnosisResult:
    """Find errors of a rig's model, or changes since a healthy state, from a recording.

    Args:
        data: the recording, or its path; several of the rig in one condition, such as short strokes, are judged together.
        rig: the rig, or its file.
        columns: names and units used in the data, for paths.
        baseline: one or several recordings of the healthy rig; none: the recording is judged by itself.
        seed: of the noise added to find the noise floor, and of resampling.
        threads: number of hypotheses tried in parallel; None: one per processor.
        progress: show a progress bar, in a notebook or on a terminal.

    Returns:
        The diagnosis: ``verdict``, ``causes`` with their parameters, and ``extended``, the rig with the causes. Insufficient
        data give the verdict ``insufficient``, with the signals and motion to record in ``missing``.

    Raises:
        BadInput: the data or the rig cannot be read, or the data are not of such a rig.
    """
    check_least(threads, 1, "threads")
    check_least(seed, 0, "seed")
    model = rig_of(rig)
    with progress_bar("diagnosing", shown=progress, lines=False) as bar:
        recordings = by_name(data, columns, USED)
        baselines = by_name(baseline, columns, USED)
        found, follows = diagnose_recordings(recordings, model, baselines=baselines, seed=seed, threads=threads, progress=bar)
    return DiagnosisResult(**fields_of(Diagnosis, found), follows=follows, name=", ".join(recordings))
