"""Margins of the loop that `fasmc_predictive` closes, measured as on a rig: by a small multi-sine on the spool command.

The same experiment runs twice with perfect sensors, once with d added between controller and plant. The difference of the
plant's input, u, over d is the sensitivity S = 1/(1 + L), and L = 1/S - 1. Runs of several multi-sines average out the
contributions of friction and reference at the excited frequencies. `python -m benchmarks.predictive_margins`
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.common import MEASURED, experiment, parser_of
from benchmarks.preview import with_preview
from ehls_ros.arrays import Array
from ehls_ros.control.controllers.fasmc_predictive import Parameters
from ehls_ros.control.margins import loop_margins
from ehls_ros.experiments.spec import Spec, Use
from ehls_ros.experiments.stepped_run import stepped_run

DURATION, WINDOW = 6.0, 4.0
"""Duration of a run, and time at its end over which the response is taken [s]."""

FREQUENCIES = 120
"""Frequencies of a multi-sine, from :data:`LOWEST` [Hz] to the Nyquist frequency."""

LOWEST = 1.0
AMPLITUDE = 1e-7
"""Amplitude of each sine [m]."""


class Loop(NamedTuple):
    """A loop as measured.

    Attributes:
        omega: frequencies [rad/s], shape (n,).
        response: of the opened loop, shape (n,).
        deviation: standard deviation of the sensitivity's mean over the multi-sines, shape (n,).
    """

    omega: Array
    response: NDArray[np.complex128]
    deviation: Array


def measured(spec: Spec, runs: int) -> Loop:
    """Return the response of an experiment's loop, from some multi-sines."""
    settings = spec.settings._replace(duration=DURATION)
    spec = spec._replace(settings=settings, rig=spec.rig._replace(sensors={}))
    period, cycles = spec.settings.control_period, spec.cycles
    last = round(WINDOW / period)
    lines = np.unique(np.round(np.geomspace(LOWEST * WINDOW, last // 2, FREQUENCIES)).astype(int))
    turns = 2.0 * np.pi * np.outer(np.arange(cycles), lines) / last
    usual = stepped_run(spec).command[-last:]
    found = []
    for run in range(runs):
        phases = np.random.default_rng(run).uniform(0.0, 2.0 * np.pi, len(lines))
        # At the Nyquist frequency a sampled sine has no phase.
        phases[-1] = 0.0
        added = AMPLITUDE * np.cos(turns + phases).sum(axis=1)
        moved = np.fft.rfft(stepped_run(spec, added).command[-last:] - usual)[lines]
        found.append(moved / np.fft.rfft(added[-last:])[lines])
    sensitivity = np.mean(found, axis=0)
    deviation = np.std(found, axis=0) / np.sqrt(runs)
    return Loop(2.0 * np.pi * lines / WINDOW, 1.0 / sensitivity - 1.0, deviation)


def main() -> None:
    """Print the margins."""
    parser = parser_of(__doc__)
    parser.add_argument("--runs", type=int, default=4, help="multi-sines of each loop")
    runs = parser.parse_args().runs
    simulated = experiment("sine_fd2")._replace(controller=Use("fasmc_predictive", Parameters()))
    specs = {"simulation, sine fd2": simulated}
    specs |= {f"rig, {name.removeprefix('measured_')}": with_preview(name, []) for name in MEASURED}
    print(f"{'loop':24}{'gain/dB':>10}{'fall/dB':>10}{'phase/deg':>12}{'delay/ms':>10}{'largest S':>12}{'deviation':>12}")
    for name, spec in specs.items():
        loop = measured(spec, runs)
        found = loop_margins(loop.omega, loop.response)
        peak = float(np.max(1.0 / np.abs(1.0 + loop.response)))
        margins = f"{found.gain_db:10.1f}{found.fall_db:10.1f}{found.phase_deg:12.1f}{1e3 * found.delay:10.2f}"
        print(f"{name:24}{margins}{peak:12.2f}{np.max(loop.deviation):12.3f}", flush=True)


if __name__ == "__main__":
    main()
