"""The flight recorder: what a rig did before its gate tripped, as a bag with its diagnosis, the last few of them.

Writing the bag and the diagnosis are another process's work, which gives way to all others and survives the monitor's end.
Run as a module, with a folder that :meth:`FlightRecorder.begin` has filled, this file is that process; it becomes
``ehls diagnose``.
"""

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

import numpy as np

from ehls_ros.errors import BadInput
from ehls_ros.experiments.yaml_files import rig_text
from ehls_ros.physics.rig import Rig, rig_to_mapping
from ehls_ros.process import give_way
from ehls_ros.trajectory import Trajectory

SAMPLES, ORDER, RIG, BAG, BASELINE, RESULTS, LOG = (
    "samples.npz", "order.json", "rig.yaml", "bag", "baseline", "diagnosis", "log.txt",
)  # fmt: skip
"""Names in a flight's folder; of the first two, the process makes the others."""

MEGABYTE = 10**6


class Flight(NamedTuple):
    """What is to be recorded.

    Attributes:
        recording: the samples before the trip.
        about: the trip, for the bag's metadata: cause and time.
        stamp_ns: when it was [ns].
    """

    recording: Trajectory
    about: Mapping[str, Any]
    stamp_ns: int


class FlightRecorder:
    """Keeps the last flights in a folder, one below it for each."""

    def __init__(self, folder: Path, number: int, megabytes: float) -> None:
        """Use a folder.

        Args:
            folder: of all flights; made with the first one.
            number: flights kept.
            megabytes: size of all flights together [MB].
        """
        self._folder = folder
        self._number = number
        self._bytes = megabytes * MEGABYTE
        self._process: subprocess.Popen[bytes] | None = None

    @property
    def busy(self) -> bool:
        """Whether a flight is still being written or diagnosed."""
        return self._process is not None and self._process.poll() is None

    def begin(self, flight: Flight, rig: Rig, baselines: Sequence[Path] = (), own: Trajectory | None = None) -> Path:
        """Begin to write a flight and to diagnose it, while no other one is.

        Args:
            flight: what is recorded.
            rig: the model it is compared with.
            baselines: recordings of the healthy rig.
            own: the same as samples.

        Returns:
            The flight's folder.

        Raises:
            OSError: the disk is full or fails.
        """
        self._make_room()
        stamp = datetime.fromtimestamp(flight.stamp_ns * 1e-9, UTC).strftime("%Y%m%d-%H%M%S")
        names = (stamp, *(f"{stamp}-{i}" for i in range(2, self._number + 2)))
        folder = next(path for name in names if not (path := self._folder / name).exists())
        folder.mkdir(parents=True)
        (folder / RIG).write_text(rig_text(rig_to_mapping(rig)), encoding="utf-8")
        parts = {BAG: flight.recording} | ({BASELINE: own} if own is not None else {})
        arrays = {f"{part}/{name}": values for part, t in parts.items() for name, values in t.signals.items()}
        arrays |= {f"{part}/": t.time_s for part, t in parts.items()}
        with (folder / SAMPLES).open("wb") as file:
            np.savez(file, **arrays)  # type: ignore[arg-type]  # names of arrays, not of options
        compared = [*(str(path.resolve()) for path in baselines), *([str((folder / BASELINE).resolve())] if own else [])]
        (folder / ORDER).write_text(json.dumps({"about": flight.about, "baselines": compared}), encoding="utf-8")
        with (folder / LOG).open("wb") as log:
            command = [sys.executable, "-m", __name__, str(folder.resolve())]
            # In a session of its own, so that what stops the monitor does not stop it.
            self._process = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=log, stderr=subprocess.STDOUT, start_new_session=True
            )
        return folder

    def _make_room(self) -> None:
        """Remove the oldest flights until another one may be kept."""
        flights = sorted((path for path in self._folder.glob("*") if path.is_dir()), key=lambda path: path.stat().st_mtime)
        sizes = [sum(file.stat().st_size for file in path.rglob("*") if file.is_file()) for path in flights]
        while flights and (len(flights) >= self._number or sum(sizes) > self._bytes):
            shutil.rmtree(flights.pop(0), ignore_errors=True)
            sizes.pop(0)


def write(folder: Path) -> list[str]:
    """Write the bags of a flight's folder, and return the arguments of ``ehls`` that diagnose it.

    Args:
        folder: as :meth:`FlightRecorder.begin` has left it.
    """
    from ehls_ros.recording.bag_writer import write_trajectory  # noqa: PLC0415 - the monitor itself writes no bags

    order = json.loads((folder / ORDER).read_text(encoding="utf-8"))
    parts: dict[str, dict[str, Any]] = {}
    with np.load(folder / SAMPLES, allow_pickle=False) as arrays:
        for key in arrays.files:
            part, _, name = key.partition("/")
            parts.setdefault(part, {})[name] = arrays[key]
    for part, signals in parts.items():
        time = signals.pop("")
        write_trajectory(folder / part, Trajectory(time, signals, {"trip": order["about"]} if part == BAG else {}))
    for done in (SAMPLES, ORDER):
        (folder / done).unlink()
    baseline = ["--baseline", *order["baselines"]] if order["baselines"] else []
    return ["diagnose", str(folder / BAG), "--rig", str(folder / RIG), *baseline, "--out", str(folder / RESULTS)]


def main() -> NoReturn:
    """Write a flight's bag, and become its diagnosis."""
    give_way()
    try:
        arguments = write(Path(sys.argv[1]))
    except (BadInput, OSError) as error:
        sys.exit(str(error))
    sys.stderr.flush()
    os.execv(sys.executable, [sys.executable, "-m", "ehls_ros", *arguments])  # noqa: S606 - a list of arguments, no shell


if __name__ == "__main__":
    main()
