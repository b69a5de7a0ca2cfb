"""Tuning of a control law for a rig, as done by `ehls tune`."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ehls_ros.api.results import figure, written
from ehls_ros.api.simulation import RigSource, SpecSource, spec_content
from ehls_ros.api.simulation import rig as read_rig
from ehls_ros.experiments.spec import Spec
from ehls_ros.experiments.tuning.files import EXPERIMENT, document, experiment_text, parameters_text
from ehls_ros.experiments.tuning.task import task_of
from ehls_ros.experiments.tuning.tune import USUAL, Tuned, Wanted
from ehls_ros.experiments.tuning.tune import tune as find
from ehls_ros.progress import progress_bar
from ehls_ros.report.tuning import sentence, trade_off, write_tuning_report

if TYPE_CHECKING:
    from plotly.graph_objects import Figure


class TuningResult:
    """Numbers of a law for a rig, with the error and the margins that they give.

    Attributes:
        found: the complete result.
    """

    def __init__(self, found: Tuned) -> None:
        """Keep the result."""
        self.found = found

    @property
    def numbers(self) -> Mapping[str, float]:
        """The numbers found, by name; others keep the law's defaults for the rig."""
        return self.found.chosen.numbers

    @property
    def spec(self) -> Spec:
        """The experiment with these numbers, for :func:`ehls_ros.simulate` and :func:`ehls_ros.controller`."""
        return self.found.spec

    @property
    def sentence(self) -> str:
        """The result in a sentence."""
        return sentence(self.found)

    @property
    def remarks(self) -> tuple[str, ...]:
        """Remarks for the user."""
        return self.found.remarks

    def to_dict(self) -> dict[str, Any]:
        """Return the content of ``tuning.json``."""
        return document(self.found)

    def save(self, folder: str | Path) -> Path:
        """Write the experiment and the parameter file of the controller's node into a folder, and return the folder."""
        into = Path(folder)
        written(into / EXPERIMENT, lambda path: path.write_text(experiment_text(self.found), encoding="utf-8"))
        file = into / f"{self.spec.controller.name}.yaml"
        written(file, lambda path: path.write_text(parameters_text(self.found), encoding="utf-8"))
        return into

    def plot(self) -> "Figure":
        """Draw the error over the gain margin."""
        return figure(trade_off(self.found))

    def report(self, path: str | Path) -> Path:
        """Write the HTML report of `ehls tune` and return its path."""
        return written(path, lambda file: write_tuning_report(self.found, file))

    def __repr__(self) -> str:
        """Return a one-line summary."""
        return f"<TuningResult: {self.sentence}>"


def tune(
    rig: RigSource,
    law: str = "fasmc_predictive",
    *,
    spec: SpecSource | None = None,
    margins: tuple[float, float] = USUAL,
    uncertainty: float = 1.0,
    seed: int = 0,
    jobs: int | None = None,
) -> TuningResult:
    """Find the numbers of a control law for a rig.

    Args:
        rig: the rig as the controller knows it, with delay, coupling and noise.
        law: name of the control law.
        spec: experiment whose reference and disturbance count; None: sines of force and motion within the rig's reach.
        margins: gain margin [dB] and phase margin [degree] asked for.
        uncertainty: factor on the standard errors of the rig's coefficients, its file's or assumed ones; 0: it is exact.
        seed: seed of the rigs drawn within the uncertainty.
        jobs: number of processes; None: one per processor.

    Raises:
        BadInput: a value is wrong, or the law has no numbers to tune.
    """
    given, where, folder = (None, "tune", Path()) if spec is None else spec_content(spec)
    task = task_of(read_rig(rig), law, given, where, folder)
    with progress_bar("tuning") as bar:
        found = find(
            task,
            wanted=Wanted(*margins),
            uncertainty=uncertainty,
            seed=seed,
            jobs=jobs,
            progress=bar,
        )
    return TuningResult(found)
