"""Free run of rigs without a valve: position simulated from the recorded force alone, such as the EMPS axis of examples/emps.

    python -m benchmarks.force_driven emps.csv --columns examples/emps/columns.yaml --rig A.yaml B.yaml --from 12.42

The simulator starts from the measured position and velocity and receives the force as that of a disturbance; its piston area is
made so small that the oil has no part in the motion. The error is that of the position over the whole span, and over windows
that start again from the measured state.
"""

from pathlib import Path

import numpy as np

from benchmarks.common import parser_of
from ehls_ros.arrays import Array
from ehls_ros.experiments.spec import load_rig
from ehls_ros.physics.plant import V, X
from ehls_ros.physics.rig import Rig
from ehls_ros.physics.simulator import Simulator
from ehls_ros.recording.columns import read_columns
from ehls_ros.recording.load import load

NO_AREA = 1e-7
"""Piston area with which the oil's force is negligible [m^2]."""

START = 0.05
"""Time about a start over which the velocity is taken from the position [s]."""


def driven(rig: Rig, time: Array, position: Array, force: Array, begin: int, end: int) -> Array:
    """Return the simulated position of a part of a recording, shape (end - begin,) [m].

    Args:
        rig: the rig.
        time: of the samples, evenly spaced, shape (n,) [s].
        position: measured, shape (n,) [m].
        force: measured, shape (n,) [N].
        begin: first sample.
        end: the sample after the last.
    """
    period = float(np.median(np.diff(time)))
    simulator = Simulator(rig._replace(plant=rig.plant._replace(piston_area=NO_AREA)).quiet(), period)
    around = slice(max(begin - round(START / period), 0), begin + round(START / period) + 1)
    slope, level = np.polyfit(time[around] - time[begin], position[around], 1)
    simulator.y[X], simulator.y[V] = level, slope
    out = np.empty(end - begin)
    for k in range(begin, end):
        out[k - begin] = simulator.y[X]
        rate = (force[min(k + 1, len(force) - 1)] - force[k]) / period
        simulator.advance(0.0, -float(force[k]), -float(rate), 0.0, 0.0)
    return out


def main() -> None:
    """Print the table."""
    parser = parser_of(__doc__)
    parser.add_argument("data", type=Path, help="recording with position and force")
    parser.add_argument("--rig", type=Path, nargs="+", required=True, help="rig files to compare")
    parser.add_argument("--columns", type=Path, help="map of the recording's columns")
    parser.add_argument("--from", dest="begin", type=float, default=0.0, help="first time, s (%(default)s)")
    parser.add_argument("--window", type=float, default=1.0, help="length of the windows, s (%(default)s)")
    options = parser.parse_args()
    recording = load(options.data, read_columns(options.columns) if options.columns else None)
    time, position, force = recording.time_s, recording.signals["position_m"], recording.signals["force_n"]
    begin = int(np.searchsorted(time, options.begin))
    length = round(options.window / float(np.median(np.diff(time))))
    print(f"{options.data.name}, {time[begin]:g} to {time[-1]:g} s, position {np.std(position[begin:]) * 1e3:.1f} mm rms")
    for path in options.rig:
        rig = load_rig(path)
        whole = driven(rig, time, position, force, begin, len(time)) - position[begin:]
        starts = range(begin, len(time) - length + 1, length)
        parts = [driven(rig, time, position, force, s, s + length) - position[s : s + length] for s in starts]
        rmse, windows = (1e3 * float(np.sqrt(np.mean(np.square(errors)))) for errors in (whole, parts))
        whole_text = f"rmse {rmse:8.3f} mm, largest {1e3 * float(np.max(np.abs(whole))):8.3f} mm"
        print(f"{path}: {whole_text}; windows of {options.window:g} s: rmse {windows:7.3f} mm")


if __name__ == "__main__":
    main()
