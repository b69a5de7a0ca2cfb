"""Raw data of real rigs, for the exam `raw`: the visible effects and the diagnosis's inputs for each kind of data."""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from benchmarks.diagnosis.cases import Hidden, rig, rig_file, trajectory_of
from ehls_ros.recording.columns import ColumnMap, Cylinder
from ehls_ros.recording.conversion import converted
from ehls_ros.recording.joining import join
from ehls_ros.trajectory import Trajectory
from truth_generator import LISTED, Recording, record, variants
from truth_generator.residuals import model_residuals
from truth_generator.visibility import background, prominence

SLOW = 100.0
"""Rate of slow data [1/s]."""

FAST = ("valve_command_m", "spool_m", "load_pressure_pa")
"""Signals of the fast one of two tables."""

FIRST = 0.0037
"""Time of the first row of a slow table [s]."""

RATIO = 1.5
"""Area of the bore to that of the rod side; the mean area is that of the rig file."""

APART = 2.0
"""Weight of the nominal equations' residual on such data without an effect: recordings of two motions differ by it, too."""


class Kind(NamedTuple):
    """A kind of data.

    Attributes:
        given: returns the trajectory for the diagnosis, from a recording with all signals.
        left: the same for the truth's measure of visibility; signals at two rates count as slow ones.
        fast: stages visible at the full rate, although ``left`` is slow.
        unseen: stages that cannot be judged.
    """

    given: Callable[[Recording], Trajectory]
    left: Callable[[Recording], Recording]
    fast: tuple[str, ...] = ()
    unseen: tuple[str, ...] = ()


def _joined(r: Recording) -> Trajectory:
    fast, slow = variants.two_rates(r, FAST, SLOW, FIRST)
    return join({"fast": trajectory_of(fast), "slow": trajectory_of(slow)}, "", "case")


def _single_rod(r: Recording) -> Trajectory:
    area = rig().plant.piston_area
    rod_side = 2.0 * area / (1.0 + RATIO)
    areas = (RATIO * rod_side, rod_side)
    given = variants.single_rod(r, areas, np.random.default_rng([r.truth["seed"], 4]))
    return converted(trajectory_of(given), ColumnMap(cylinder=Cylinder(*areas)), "case")


def _slow(r: Recording) -> Recording:
    return variants.slowed(r, SLOW)


KINDS: Mapping[str, Kind] = {
    "slow": Kind(lambda r: trajectory_of(_slow(r)), _slow),
    "two_rates": Kind(_joined, _slow, fast=("valve",)),
    "command_only": Kind(lambda r: trajectory_of(variants.command_only(r)), variants.command_only),
    "sparse": Kind(lambda r: trajectory_of(variants.sparse(r)), variants.sparse),
    "single_rod": Kind(_single_rod, lambda r: r, unseen=("flow",)),
}


def visible(kind: str, hidden: Hidden, experiment: str, seed: int, duration: float) -> dict[str, float]:
    """Return the visibility of an effect by stage, against noise and the nominal equations' residual at the data's rate."""
    data = KINDS[kind]
    full = record(rig_file(), hidden, experiment, seed=seed, duration=duration, noise=0.0)

    def seen(left: Callable[[Recording], Recording]) -> dict[str, float]:
        without = background(rig_file(), experiment, seed=seed, duration=duration, given=left)
        changed = model_residuals(rig_file(), left(full))
        return prominence(without, [(APART, without.left)], without.left, changed).visibility

    found = seen(data.left)
    quick = seen(lambda r: r) if data.fast else {}
    # Two sensors of one quantity disagree only because of faults of their own.
    unseen = {*data.unseen, *(() if any(LISTED[name].stage == "sensors" for name in hidden) else ("sensors",))}
    return {s: 0.0 if s in unseen else quick[s] if s in data.fast else value for s, value in found.items()}
