"""The compiled kernel of the paper's rig, compared with the same scheme written in C.

Both run the same motion with one command per millisecond: a large sine of the spool with the paper's disturbance fd2, mostly
slipping with some reversals. In a single call, they also run a motion under a constant command. All runs are interleaved, so
that other work on the machine affects all alike.
"""

import ctypes
import platform
import subprocess
import tempfile
import time
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numba
import numpy as np
import yaml

from benchmarks.common import RIG, ROOT, in_turns, parser_of, quartiles
from ehls_ros.arrays import Array
from ehls_ros.physics.composition import compiled
from ehls_ros.physics.integration_step import LONGEST_STEP
from ehls_ros.physics.plant import FD, FD_RATE, START, U
from ehls_ros.physics.rig import Rig, rig_from_mapping
from ehls_ros.physics.simulator import Constants, Simulator, State, build, parts_of

PERIOD = 1e-3
COMPILERS = {
    "cc -O3": ("cc", "-O3"),
    "cc -O3 -march=native": ("cc", "-O3", "-march=native"),
    "cc -O3 -march=native, no FMA": ("cc", "-O3", "-march=native", "-ffp-contract=off"),
}
MARK = 1.1


class Motion(NamedTuple):
    """A motion both sides run: the plant's first inputs per call, shape (calls, 4), and the steps per call."""

    name: str
    inputs: Array
    steps: int


def motions(duration: float) -> list[Motion]:
    """Return the motion with a command per cycle, and the one under a constant command."""
    t = np.arange(round(duration / PERIOD)) * PERIOD
    omega = 2.0 * np.pi
    commands = np.column_stack(
        [6e-4 * np.sin(omega * t), 5e3 * np.sin(omega * t + 0.7), 5e3 * omega * np.cos(omega * t + 0.7), t]
    )
    held = np.array([[2e-4, 500.0, 300.0, 0.0]])
    return [
        Motion("cycles of 1 ms", commands, round(PERIOD / LONGEST_STEP)),
        Motion("one call", held, round(duration / LONGEST_STEP)),
    ]


class NumbaKernel:
    """The package's kernel, called from compiled code as in the in-process loop."""

    def __init__(self, rig: Rig) -> None:
        """Compile."""
        simulator = Simulator(rig, PERIOD, LONGEST_STEP)
        advance = compiled(build, {"advance": "cycle, constants, state"}, **parts_of(simulator.rig)._asdict()).advance
        self.y, self.mode, self.inputs = simulator.y, simulator.mode, simulator.inputs
        # With a period of 1 s, the kernel's cycles count time.
        self._constants, self._state = simulator.constants._replace(period=1.0), simulator.state

        @numba.njit(error_model="numpy")
        def run(constants: Constants, state: State, commands: Array) -> int:
            inputs, dense = state.inputs, 0
            for k in range(len(commands)):
                inputs[U], inputs[FD], inputs[FD_RATE], inputs[START] = commands[k]
                dense += advance(inputs[START], constants, state)
            return dense

        self._run = run

    def become(self, rig: Rig) -> None:
        """Continue as another rig without effects."""
        self._constants = self._constants._replace(plant=rig.plant, friction=rig.friction)

    def run(self, motion: Motion) -> int:
        """Run a motion from the present state."""
        dense: int = self._run(self._constants._replace(steps=motion.steps), self._state, motion.inputs)
        return dense


class CKernel:
    """The C version."""

    def __init__(self, rig: Rig, command: tuple[str, ...], folder: Path) -> None:
        """Compile with a command and load."""
        library = folder / f"{'_'.join(command)}.so"
        subprocess.run([*command, "-shared", "-fPIC", "-o", library, ROOT / "benchmarks" / "kernel_twin.c", "-lm"], check=True)
        self._function = ctypes.CDLL(str(library)).run_cycles
        self.y, self.mode, self.inputs = np.zeros(7), np.zeros(4), np.zeros(7)
        self.become(rig)

    def become(self, rig: Rig) -> None:
        """Continue as another rig without effects."""
        self._plant = np.array(rig.plant)
        self._friction = np.hstack([np.atleast_1d(value) for value in rig.friction])

    def run(self, motion: Motion) -> int:
        """Run a motion from the present state."""
        arrays = (self.y, self.mode, self._plant, self._friction, self.inputs, motion.inputs)
        pointers = [array.ctypes.data_as(ctypes.c_void_p) for array in arrays]
        dense: int = self._function(
            *pointers, ctypes.c_long(len(motion.inputs)), ctypes.c_double(LONGEST_STEP), ctypes.c_long(motion.steps)
        )
        return dense


def at_rest(kernel: Any) -> None:
    """Reset the state of a kernel to rest."""
    kernel.y[:], kernel.mode[:] = 0.0, 0.0
    kernel.mode[0] = 1.0


def deviation(kernel: Any, other: Any, motion: Motion) -> float:
    """Return the difference of two kernels at the end of each cycle, relative to each state's range."""
    tracks: list[Array] = []
    for contestant in (kernel, other):
        at_rest(contestant)
        track = []
        for row in motion.inputs:
            contestant.run(Motion("", row[None, :], motion.steps))
            track.append(contestant.y.copy())
        tracks.append(np.array(track))
    return float(np.max(np.abs(tracks[0] - tracks[1]).max(axis=0) / np.abs(tracks[1]).max(axis=0)))


def from_rest(kernel: Any, motion: Motion) -> None:
    """Run a motion from rest."""
    at_rest(kernel)
    kernel.run(motion)


def main() -> None:
    """Print the table."""
    parser = parser_of(__doc__)
    parser.add_argument("--runs", type=int, default=101, help="interleaved runs of each")
    parser.add_argument("--duration", type=float, default=0.5, help="plant time of a run [s]")
    options = parser.parse_args()
    rig = rig_from_mapping(yaml.safe_load(RIG.read_text(encoding="utf-8")), str(RIG))
    with tempfile.TemporaryDirectory() as folder:
        ours = NumbaKernel(rig)
        twins = {name: CKernel(rig, command, Path(folder)) for name, command in COMPILERS.items()}
        contestants: dict[str, Any] = {"numba": ours, **twins}
        version = subprocess.run(["cc", "--version"], check=True, capture_output=True, text=True).stdout.splitlines()[0]
        print(f"{platform.machine()}, {version}, numba {numba.__version__}, step {LONGEST_STEP:g} s, {options.runs} runs")
        for motion in motions(options.duration):
            steps = len(motion.inputs) * motion.steps
            print(f"\n{motion.name} ({steps} steps)")
            print(f"{'':30}{'ns/step':>9}{'numba/C (quartiles)':>25}{'deviation':>12}")
            works = {name: partial(from_rest, kernel, motion) for name, kernel in contestants.items()}
            times = in_turns(works, options.runs, time.perf_counter, warm_up=2)
            each = {name: float(np.median(taken)) / steps * 1e9 for name, taken in times.items()}
            print(f"{'numba':30}{each['numba']:9.1f}")
            for name, twin in twins.items():
                ratio = quartiles(times["numba"] / times[name], ".3f")
                print(f"{name:30}{each[name]:9.1f}{ratio:>25}{deviation(ours, twin, motion):12.1e}")
        print(f"\ntarget: {MARK} x")


if __name__ == "__main__":
    main()
