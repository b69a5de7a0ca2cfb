"""ARX models as peers of `ehls predict`: force predicted from the valve command over windows started from the measured past.

    python -m benchmarks.force_prediction examples/faster/faster_first_half.csv --to 55

fits ARX(n, n) models by least squares to the first part of a recording, with and without a constant, and prints the rms error
over windows of the rest, as a fraction of the force's standard deviation there. Windows start as those of `ehls predict` do.
"""

from argparse import ArgumentParser
from pathlib import Path

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.recording.columns import read_columns
from ehls_ros.recording.load import load

ORDERS = (1, 2, 3, 4, 6, 8, 10)
LENGTHS = (1.0, 5.0)
STARTS_A_WINDOW = 4


def regressors(y: Array, u: Array, rows: Array, order: int, constant: float) -> Array:
    """Return the past values of force and command before some samples, and the constant, shape (rows, 2 order + 1)."""
    past = [signal[rows - lag] for signal in (y, u) for lag in range(1, order + 1)]
    return np.column_stack([*past, np.full(len(rows), constant)])


def predicted(weights: Array, y: Array, u: Array, starts: Array, count: int, constant: float) -> Array:
    """Return the free run of a model from each start, shape (starts, count)."""
    order = (len(weights) - 1) // 2
    force = np.column_stack([y[starts - lag] for lag in range(order)])
    out = np.empty((len(starts), count))
    for k in range(count):
        command = np.column_stack([u[starts + k - lag] for lag in range(order)])
        out[:, k] = force @ weights[:order] + command @ weights[order : 2 * order] + weights[-1] * constant
        force = np.column_stack([out[:, k], force[:, :-1]])
    return out


def main() -> None:
    """Print the table."""
    parser = ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("data", type=Path)
    parser.add_argument("--columns", type=Path, default=Path("examples/faster/columns.yaml"))
    parser.add_argument("--to", type=float, required=True, help="end of the part that is fitted [s]")
    options = parser.parse_args()
    recording = load(options.data, read_columns(options.columns))
    y, u, period = recording["force_n"], recording["valve_command_m"], float(np.median(np.diff(recording.time_s)))
    y, u = y / float(np.std(y)), u / float(np.std(u))
    split = round(options.to / period)
    for constant in (0.0, 1.0):
        for order in ORDERS:
            fitted = np.arange(order, split)
            weights = np.linalg.lstsq(regressors(y, u, fitted, order, constant), y[fitted], rcond=None)[0].astype(np.float64)
            errors = []
            for length in LENGTHS:
                count, apart = round(length / period), round(LENGTHS[0] / period) // STARTS_A_WINDOW
                starts = np.arange(split + max(ORDERS), len(y) - count - 1, apart)
                measured = y[starts[:, np.newaxis] + 1 + np.arange(count)]
                with np.errstate(over="ignore", invalid="ignore"):
                    off = predicted(weights, y, u, starts, count, constant) - measured
                    errors.append(100.0 * float(np.sqrt(np.mean(off**2)) / np.std(measured)))
            kind = "with" if constant else "without"
            shown = ", ".join(f"{length:g} s {error:.3g} %" for length, error in zip(LENGTHS, errors, strict=True))
            print(f"ARX({order}, {order}) {kind} a constant: {shown}")


if __name__ == "__main__":
    main()
