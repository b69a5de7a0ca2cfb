"""Friction loops of the seals of examples/seals: half their width as measured, and the error that a rig file leaves in it.

    python -m benchmarks.seal_loops NAP310_*bar.csv --columns examples/seals/columns.yaml --rig runs/seal/rig_extended.yaml

The half width is half the difference between both directions of the mean force less area times pressure, in each third of the
stroke's middle. The residual of a model that has the friction right does not change with the direction: half its difference is
the model's error of the half width.
"""

from itertools import pairwise
from pathlib import Path

import numpy as np

from benchmarks.common import parser_of
from ehls_ros.arrays import Array
from ehls_ros.diagnosis.dependence import signals_along
from ehls_ros.diagnosis.evidence import gather
from ehls_ros.diagnosis.record import POSITION, VELOCITY, prepare
from ehls_ros.diagnosis.stages import setup
from ehls_ros.experiments.spec import load_rig
from ehls_ros.physics.rig import Rig
from ehls_ros.recording.columns import read_columns
from ehls_ros.recording.load import load
from ehls_ros.trajectory import Trajectory

MIDDLE = (0.2, 0.8)
"""Quantiles of the position between which loops are compared: the turns are outside."""

THIRDS = 3
MOVING = 0.3
"""Least speed of a window that counts, over the rms speed."""


def half_widths(values: Array, position: Array, velocity: Array) -> Array:
    """Return half the difference of a quantity between both directions in each third of the middle, shape (thirds,)."""
    moving = np.abs(velocity) > MOVING * np.sqrt(np.mean(velocity**2))
    first, last = map(float, np.quantile(position[moving], MIDDLE))
    places = pairwise(np.linspace(first, last, THIRDS + 1).tolist())
    inside = [moving & (position >= low) & (position < high) for low, high in places]
    return np.array([0.5 * (np.mean(values[i & (velocity > 0.0)]) - np.mean(values[i & (velocity < 0.0)])) for i in inside])


def loops(trajectory: Trajectory, rig: Rig, name: str) -> Array:
    """Return the half widths of the force balance's residual [N]."""
    record = prepare(trajectory, rig, name)
    evidence = gather(record, rig, setup(record, rig), 0)
    signals = signals_along(evidence.comparison(), rig)
    position, velocity = (evidence.means("force", signals[signal]) for signal in (POSITION, VELOCITY))
    return half_widths(evidence.base.values["force"] * evidence.floor["force"], position, velocity)


def measured_loops(trajectory: Trajectory, rig: Rig, name: str) -> Array:
    """Return the half widths of the measured loop [N]: residuals with two levels of friction, continued to none."""
    whole = rig.friction._replace(static_force=rig.friction.coulomb_force, viscous_coefficient=0.0)
    half = whole._replace(coulomb_force=0.5 * whole.coulomb_force, static_force=0.5 * whole.coulomb_force)
    with_whole, with_half = (loops(trajectory, rig._replace(effects=(), friction=f), name) for f in (whole, half))
    return 2.0 * with_half - with_whole


def main() -> None:
    """Print the table."""
    parser = parser_of(__doc__)
    parser.add_argument("data", type=Path, nargs="+", help="recordings")
    parser.add_argument("--rig", type=Path, nargs="+", required=True, help="rig files to compare")
    parser.add_argument("--columns", type=Path, required=True, help="map of the recordings' columns")
    options = parser.parse_args()
    columns = read_columns(options.columns)
    errors: dict[Path, list[float]] = {path: [] for path in options.rig}
    for data in options.data:
        recording = load(data, columns)
        rigs = {path: load_rig(path) for path in options.rig}
        measured = np.abs(measured_loops(recording, next(iter(rigs.values())), data.name))
        print(f"{data.name:28} measured {' '.join(f'{h:6.2f}' for h in measured)} N")
        for path, rig in rigs.items():
            off = np.abs(loops(recording, rig, data.name)) / measured
            errors[path] += off.tolist()
            print(f"{'':28} {path}: off by {' '.join(f'{part:6.1%}' for part in off)}")
    for path, parts in errors.items():
        print(f"{path}: within 10 % in {sum(part <= 0.1 for part in parts)} of {len(parts)}, median {np.median(parts):.1%}")


if __name__ == "__main__":
    main()
