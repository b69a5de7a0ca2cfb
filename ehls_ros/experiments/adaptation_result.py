"""Results of the companion ``adaptation`` from the recording of a run: sentences, and the rig file to write.

The companion uses readings and commands only. Its results can therefore be reproduced from any recording, also over DDS and of
a real rig.
"""

from itertools import pairwise
from typing import NamedTuple, cast

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.control.adaptation.correction import corrected_rig
from ehls_ros.control.companions.adaptation import STRIDE, Adaptation
from ehls_ros.control.companions.base import PLACE, Past
from ehls_ros.control.controllers.base import ROW, STATUS_SIZE, model_of
from ehls_ros.experiments.spec import Spec, company_of
from ehls_ros.experiments.yaml_files import rig_text
from ehls_ros.physics.rig import Rig, rig_to_mapping
from ehls_ros.recording.topics import LOADER_STATE
from ehls_ros.trajectory import Trajectory

NAME = "adaptation"
"""Name of the companion."""


class Adapted(NamedTuple):
    """Adaptation results of a run for its rig file.

    Attributes:
        sentences: results for the user.
        at_bounds: sentences on coefficients beyond the range of the adaptation, with the remedy.
        rig: the controller's rig with the adapted values; None if unchanged.
    """

    sentences: tuple[str, ...]
    at_bounds: tuple[str, ...]
    rig: Rig | None

    def text(self) -> str:
        """Return the rig file to write; empty if there is nothing to change."""
        if self.rig is None:
            return ""
        heading = "".join(f"# {sentence}\n" for sentence in ("Found by adaptation while running:", *self.sentences))
        return heading + rig_text(rig_to_mapping(self.rig))


def adapted(spec: Spec, trajectory: Trajectory) -> Adapted | None:
    """Return the adaptation results of a run for the controller's rig file; None without adaptation.

    Args:
        spec: the experiment.
        trajectory: its recording.
    """
    used = tuple(use for use in spec.companions if use.name == NAME)
    if not used:
        return None
    original = model_of(spec.controller_rig, spec.settings.control_period)
    chain = company_of(spec._replace(companions=used), original, spec.settings.title)
    adaptation = cast(Adaptation, chain.members[NAME])
    model = original
    for past in _stretches(trajectory, original.period):
        model = adaptation.done(past, model)
    estimation = adaptation.estimation
    estimation.solve()
    sentences = tuple(str(value) for value in estimation.report().values() if isinstance(value, str))
    rig = corrected_rig(spec.controller_rig, original, estimation.values()) if estimation.changed() else None
    return Adapted(sentences, estimation.at_bounds(), rig)


def _stretches(trajectory: Trajectory, period: float) -> list[Past]:
    """Split a recording at the calls of the companion and at missing cycles."""
    cycles = np.round(trajectory.time_s / period).astype(int)
    measured = np.column_stack([_signal(trajectory, name) for name in LOADER_STATE.signals.values()])
    command = _signal(trajectory, "valve_command_m")
    cuts = np.flatnonzero((np.diff(cycles) != 1) | (cycles[1:] % STRIDE == 0)) + 1
    bounds = [0, *cuts.tolist(), len(cycles)]
    nothing = np.full((len(cycles), max(ROW, PLACE, STATUS_SIZE)), np.nan)
    return [
        Past(
            int(cycles[first]),
            nothing[first:last, :ROW],
            nothing[first:last, :3],
            nothing[first:last, :PLACE],
            measured[first:last],
            command[first:last],
            nothing[first:last, :STATUS_SIZE],
        )
        for first, last in pairwise(bounds)
    ]


def _signal(trajectory: Trajectory, name: str) -> Array:
    values = trajectory.signals.get(name)
    return np.full(len(trajectory.time_s), np.nan) if values is None else values
