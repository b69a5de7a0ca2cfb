"""Records of a monitor's state, from which another monitor of the same rig continues."""

from typing import NamedTuple

from ehls_ros.arrays import Array
from ehls_ros.diagnosis.monitoring.blocks import Scores
from ehls_ros.diagnosis.monitoring.directions import Direction
from ehls_ros.diagnosis.monitoring.tracking import Reading
from ehls_ros.experiments.monitoring.health import FoundChange
from ehls_ros.physics.rig import Rig
from ehls_ros.trajectory import Trajectory


class Past(NamedTuple):
    """Past readings of the coefficients.

    Attributes:
        time: end of the averaged blocks [s].
        readings: readings of all coefficients.
    """

    time: float
    readings: tuple[Reading, ...]


class Learnt(NamedTuple):
    """Learnt model of a healthy rig.

    Attributes:
        kind: kind of baseline.
        directions: the departures tested.
        sections: scores of the healthy blocks, one section per condition of the rig.
        recording: the first minutes of the rig, if they are the baseline.
    """

    kind: str
    directions: tuple[Direction, ...]
    sections: tuple[tuple[Scores, ...], ...]
    recording: Trajectory | None = None


class Remembered(NamedTuple):
    """Complete state of a monitor.

    Attributes:
        learnt: learnt model of the healthy rig; None while unknown.
        well: model of the healthy rig.
        model: the same with the changes since.
        changes: detected changes, oldest first.
        history: the last readings of the coefficients.
        readings: the newest readings.
        watched: time for which blocks were judged [s].
        begins: begin times of the summed blocks [s].
        rows: score, information and share of these blocks, shape (3, blocks, n).
    """

    learnt: Learnt | None
    well: Rig
    model: Rig
    changes: tuple[FoundChange, ...]
    history: tuple[Past, ...]
    readings: tuple[Reading, ...]
    watched: float
    begins: tuple[float, ...]
    rows: Array
