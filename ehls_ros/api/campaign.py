"""Campaign of many simulated experiments as one table, as done by `ehls campaign`."""

import os
from collections.abc import Mapping
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from ehls_ros.api.arguments import check_kind, check_least
from ehls_ros.api.results import fields_of, figure
from ehls_ros.experiments.campaign.backends import local
from ehls_ros.experiments.campaign.conduct import conduct
from ehls_ros.experiments.campaign.plan import load_plan, plan_from_mapping
from ehls_ros.experiments.campaign.results import CampaignResults, results_of
from ehls_ros.experiments.campaign.store import opened, read_results
from ehls_ros.experiments.files import configured
from ehls_ros.experiments.spec import Spec, spec_to_mapping
from ehls_ros.progress import progress_bar
from ehls_ros.report import campaign_figures as drawn
from ehls_ros.report.campaign_findings import groups, verdict_sentence

if TYPE_CHECKING:
    from pandas import DataFrame
    from plotly.graph_objects import Figure


@dataclass(frozen=True, kw_only=True, repr=False)
class CampaignResult(CampaignResults):
    """The table of a campaign, one entry per run.

    Attributes:
        table: all columns by name: ``run``, ``draw``, the varied values, the metrics, ``error``; a missing value is None.
    """

    table: Mapping[str, list[Any]]

    @property
    def sentence(self) -> str:
        """The result in a sentence."""
        return verdict_sentence(self)[0]

    def to_pandas(self) -> "DataFrame":
        """Return the table: one row per run, with the varied values, the metrics, and the reason of a failure."""
        from pandas import DataFrame  # noqa: PLC0415 - half a second that only tables cost

        return DataFrame({name: values for name, values in self.table.items() if name != "digest"}).set_index("run")

    def plot(self) -> "Figure":
        """Draw the largest error over one swept parameter, over two as a map, or else its distribution over the runs."""
        swept = [c for c in self.columns if c.numeric and not c.drawn and len(set(self.numbers[c.path])) > 1]
        parts = groups(self)
        if len(swept) > 1:
            return figure(drawn.heat_map(self, swept[0], swept[1], parts[0]))
        return figure(drawn.sweep(self, swept[0], parts) if swept else drawn.distribution(self, parts))

    def __repr__(self) -> str:
        """Return a one-line summary."""
        return f"<{type(self).__name__}: {len(self)} runs, {len(self.failed)} failed>"

    def _repr_html_(self) -> str:
        return str(self.to_pandas().to_html(max_rows=20, float_format="{:.5g}".format))


def campaign(
    plan: Mapping[str, Any] | str | Path,
    *,
    out: str | Path | None = None,
    jobs: int | None = None,
    progress: bool = True,
) -> CampaignResult:
    """Run a sweep or a Monte Carlo study of experiments.

    Args:
        plan: path of a campaign file, name of one supplied with the package, or its content, such as
            ``{"base": "sine_fd2", "vary": {"controller.k": [6.0, 12.0]}}``. ``base`` may be the ``spec`` of a simulation.
        out: folder for finished runs, from which the same call resumes; None: nothing is kept.
        jobs: number of processes; None: one per processor.
        progress: show a progress bar, in a notebook or on a terminal.

    Returns:
        The table. A failed run is a row with the reason in ``error``.

    Raises:
        BadInput: the plan is wrong, or pyarrow or joblib is not installed.
    """
    check_kind(plan, (Mapping, str, Path), "plan", "a path, the name of a plan that comes with the package, or a mapping")
    check_least(jobs, 1, "jobs")
    if isinstance(plan, Mapping):
        made = plan_from_mapping(_written_out(plan), "campaign", Path())
    else:
        made = load_plan(configured(plan, "campaigns"))
    place = TemporaryDirectory() if out is None else nullcontext(str(out))
    with place as path, opened(Path(path)) as folder:
        with progress_bar(made.settings.title, shown=progress, lines=False) as bar:
            conduct(made, folder, local(jobs or len(os.sched_getaffinity(0))), bar)
        table = read_results(folder.results)
    return CampaignResult(**fields_of(CampaignResults, results_of(made.columns, table)), table=table)


def _written_out(plan: Mapping[str, Any]) -> dict[str, Any]:
    """Return a plan with its base replaced by a file's path or content."""
    base = plan.get("base")
    if isinstance(base, Spec):
        return {**plan, "base": spec_to_mapping(base)}
    return {**plan, "base": str(configured(base, "experiments"))} if isinstance(base, str | Path) else dict(plan)
