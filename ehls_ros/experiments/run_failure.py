"""Failures of runs whose data are kept nevertheless."""

from ehls_ros.errors import WorkFailed
from ehls_ros.experiments.metrics import Metrics
from ehls_ros.trajectory import Trajectory


class RunFailed(WorkFailed):
    """A run that failed.

    Attributes:
        complete: whether it has all its cycles.
        trajectory: the run up to the failure, if kept.
    """

    complete = False
    trajectory: Trajectory | None = None


class Implausible(RunFailed):
    """A run in an impossible state: values not finite, or far beyond the rig's limits."""


class NotKept(RunFailed):
    """A complete run whose companions' files could not be written."""

    complete = True


class NodeFailed(RunFailed):
    """A complete run on the graph, after which a node ended with an error.

    Attributes:
        wall_s: wall time from the plant's first to its last cycle [s].
    """

    complete = True

    def __init__(self, what: str, wall_s: float) -> None:
        """Set the one-line message, and the wall time [s]."""
        super().__init__(what)
        self.wall_s = wall_s


def with_failure(metrics: Metrics, failure: RunFailed | None) -> Metrics:
    """Return the metrics of a run with the reason for its failure among the warnings.

    Other warnings of an incomplete run are dropped, as they follow from the failure.
    """
    if failure is None:
        return metrics
    warnings = metrics.warnings if failure.complete else ()
    return metrics._replace(warnings=(*warnings, str(failure)))
