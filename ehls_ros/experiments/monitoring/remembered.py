"""What a monitor must remember to go on where another one of the same rig ended."""

from typing import NamedTuple

from ehls_ros.arrays import Array
from ehls_ros.diagnosis.monitoring.blocks import Scores
from ehls_ros.diagnosis.monitoring.directions import Direction
from ehls_ros.diagnosis.monitoring.tracking import Reading
from ehls_ros.experiments.monitoring.health import FoundChange
from ehls_ros.physics.rig import Rig
from ehls_ros.trajectory import Trajectory


class Past(NamedTuple):
    """What the coefficients were.

    Attributes:
        time: end of the averaged blocks [s].
        readings: of all coefficients.
    """

    time: float
    readings: tuple[Reading, ...]


class Learnt(NamedTuple):
    """What a healthy rig is.

    Attributes:
        kind: what a change is measured from.
        directions: the departures that are looked for.
        sections: scores of the healthy blocks, one section each condition of the rig.
        recording: the rig's own first minutes, where they are what a change is measured from.
    """

    kind: str
    directions: tuple[Direction, ...]
    sections: tuple[tuple[Scores, ...], ...]
    recording: Trajectory | None = None


class Remembered(NamedTuple):
    """Everything that a monitor knows.

    Attributes:
        learnt: what a healthy rig is; None while that is not known.
        well: the healthy rig's model.
        model: the same with what has changed since.
        changes: what was found, oldest first.
        history: the last readings of the coefficients.
        readings: the newest ones.
        watched: time for which blocks were judged [s].
        begins: begins of the blocks that are summed [s].
        rows: score, information and share of these, shape (3, blocks, n).
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
