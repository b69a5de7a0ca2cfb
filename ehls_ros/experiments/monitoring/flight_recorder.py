"""Flight recorder: bags of the samples before trips of the gate, with their diagnoses, for the last few trips.

The bag is written and diagnosed in a separate process of low priority, which survives the end of the monitor. That process is
this file, run as a module with a folder filled by :meth:`FlightRecorder.begin`; it then executes ``ehls diagnose``. Only files
written by a flight recorder are ever removed.
"""

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple, NoReturn

import numpy as np

from ehls_ros.declared_arrays import check_arrays
from ehls_ros.errors import BadInput
from ehls_ros.experiments.state_files import access
from ehls_ros.experiments.state_files.kinds import FLIGHT, SAMPLES, FlightRecord, FlightSignals, flight_arrays
from ehls_ros.experiments.state_files.state_file import Origin, StateFile
from ehls_ros.experiments.yaml_files import rig_text
from ehls_ros.physics.rig import Rig, rig_to_mapping
from ehls_ros.process import give_way
from ehls_ros.trajectory import Trajectory

SIGNALS, MARK, RIG, BAG, BASELINE, RESULTS, LOG = (
    "samples.npz", "flight.json", "rig.yaml", "bag", "baseline", "diagnosis", "log.txt",
)  # fmt: skip
"""Names in a flight's folder; the process creates the others from the first two."""

NAME = re.compile(r"[0-9]{8}-[0-9]{6}(-[0-9]{1,4})?")
"""Names of the flights' folders."""

MEGABYTE = 10**6


class Flight(NamedTuple):
    """A trip to be recorded.

    Attributes:
        recording: the samples before the trip.
        cause: cause of the trip.
        stamp_ns: time of the trip [ns].
    """

    recording: Trajectory
    cause: str
    stamp_ns: int


class FlightRecorder:
    """Recorder that keeps the last flights in subfolders of a folder."""

    def __init__(self, folder: Path, number: int, megabytes: float) -> None:
        """Use a folder.

        Args:
            folder: folder of all flights; created with the first one.
            number: number of flights kept.
            megabytes: maximum size of all flights together [MB].
        """
        self._folder = folder
        self._number = number
        self._bytes = megabytes * MEGABYTE
        self._process: subprocess.Popen[bytes] | None = None

    @property
    def busy(self) -> bool:
        """Whether a flight is still being written or diagnosed."""
        return self._process is not None and self._process.poll() is None

    def begin(
        self, flight: Flight, rig: Rig, control_period: float, baselines: Sequence[Path] = (), own: Trajectory | None = None
    ) -> Path:
        """Start writing and diagnosing a flight; no other one may be in progress.

        Args:
            flight: the trip to be recorded.
            rig: the model for the diagnosis.
            control_period: control period of the rig [s].
            baselines: recordings of the healthy rig.
            own: samples of the healthy rig, as a further baseline.

        Returns:
            The flight's folder.

        Raises:
            NotWritten: the folder or a file in it cannot be written.
            OSError: the process cannot be started.
        """
        self._make_room()
        stamp = datetime.fromtimestamp(flight.stamp_ns * 1e-9, UTC).strftime("%Y%m%d-%H%M%S")
        names = (stamp, *(f"{stamp}-{i}" for i in range(2, self._number + 2)))
        folder = next((path for name in names if not os.path.lexists(path := self._folder / name)), None)
        if folder is None:
            raise access.NotWritten(f"{self._folder / stamp}: cannot be made (it is there)")
        try:
            folder.mkdir(parents=True)
        except OSError as error:
            raise access.NotWritten(f"{folder}: cannot be made ({error.strerror})") from None
        try:
            self._fill(folder, flight, Origin.of(rig, control_period), rig, baselines, own)
        except access.NotWritten:
            _remove(folder)
            raise
        with (folder / LOG).open("wb") as log:
            command = [sys.executable, "-m", __name__, str(folder.resolve())]
            # In a separate session, so that signals to the monitor do not stop it.
            self._process = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=log, stderr=subprocess.STDOUT, start_new_session=True
            )
        return folder

    @staticmethod
    def _fill(
        folder: Path, flight: Flight, origin: Origin, rig: Rig, baselines: Sequence[Path], own: Trajectory | None
    ) -> None:
        """Write the files from which another process creates the bag and the diagnosis."""
        record = FlightRecord(flight.cause, flight.stamp_ns, tuple(str(path.resolve()) for path in baselines), own is not None)
        StateFile(folder / MARK, FLIGHT, origin).write(record._asdict(), durable=False)
        content = rig_text(rig_to_mapping(rig)).encode()
        access.replace(folder / RIG, lambda file: file.write(content), durable=False)
        parts = {BAG: flight.recording} | ({BASELINE: own} if own is not None else {})
        arrays = {f"{part}/{name}": values for part, t in parts.items() for name, values in t.signals.items()}
        arrays |= {f"{part}/": t.time_s for part, t in parts.items()}
        signals = FlightSignals(*(tuple(parts[part].signals) if part in parts else () for part in (BAG, BASELINE)))
        StateFile(folder / SIGNALS, SAMPLES, origin).write(signals._asdict(), arrays, durable=False)

    def _make_room(self) -> None:
        """Remove the oldest flights to make room for another one."""
        flights = sorted(self._flights().items(), key=lambda item: item[1])
        sizes = [_size(path) for path, _ in flights]
        while flights and (len(flights) >= self._number or sum(sizes) > self._bytes):
            _remove(flights.pop(0)[0])
            sizes.pop(0)

    def _flights(self) -> dict[Path, int]:
        """Return the flights' folders, identified by name and mark, with their modification times [ns]."""
        found = {}
        with suppress(OSError):
            for entry in os.scandir(self._folder):
                if NAME.fullmatch(entry.name) and entry.is_dir(follow_symlinks=False):
                    path = Path(entry.path)
                    if StateFile(path / MARK, FLIGHT, None).is_own():
                        found[path] = entry.stat(follow_symlinks=False).st_mtime_ns
        return found


def _size(flight: Path) -> int:
    """Return the size of a flight's folder [B]."""
    total = 0
    for root, _, names in os.walk(flight):
        for name in names:
            with suppress(OSError):
                total += os.lstat(os.path.join(root, name)).st_size  # noqa: PTH118 - Path objects are slow
    return total


def _remove(flight: Path) -> None:
    """Remove the files of a flight and its diagnosis; foreign files beside them are kept."""
    for name in (BAG, BASELINE, RESULTS):
        shutil.rmtree(flight / name, ignore_errors=True)
    for name in (SIGNALS, RIG, LOG, MARK):
        with suppress(OSError):
            (flight / name).unlink()
    with suppress(OSError):
        flight.rmdir()


def write(folder: Path) -> list[str]:
    """Write the bags of a flight's folder, and return the arguments of ``ehls`` for its diagnosis.

    Args:
        folder: folder prepared by :meth:`FlightRecorder.begin`.

    Raises:
        BadInput: the folder is not in that state.
    """
    from ehls_ros.recording.bag_writer import write_trajectory  # noqa: PLC0415 - the monitor itself writes no bags

    mark, samples = StateFile(folder / MARK, FLIGHT, None), StateFile(folder / SIGNALS, SAMPLES, None)
    marked, sampled = mark.read(), samples.read()
    if marked is None or sampled is None:
        raise BadInput("it holds no flight", str(folder), f"a folder with {MARK} and {SIGNALS}")
    record: FlightRecord = marked.content
    signals: FlightSignals = sampled.content
    try:
        check_arrays(sampled.arrays, flight_arrays(signals))
        parts: Mapping[str, Sequence[str]] = {BAG: signals.bag} | ({BASELINE: signals.baseline} if record.own_baseline else {})
        recordings = {
            part: Trajectory(sampled.arrays[f"{part}/"], {name: sampled.arrays[f"{part}/{name}"] for name in names})
            for part, names in parts.items()
        }
        if any(np.any(np.diff(recording.time_s) <= 0.0) for recording in recordings.values()):
            raise samples.refusal("its times do not increase")
    except BadInput:
        raise
    except (ValueError, KeyError) as error:
        raise samples.refusal(str(error)) from None
    trip = {"cause": record.cause, "stamp_ns": record.stamp_ns}
    for part, recording in recordings.items():
        metadata = {"trip": trip} if part == BAG else {}
        write_trajectory(folder / part, Trajectory(recording.time_s, recording.signals, metadata))
    (folder / SIGNALS).unlink()
    compared = [*record.baselines, *([str(folder.resolve() / BASELINE)] if record.own_baseline else [])]
    baseline = ["--baseline", *compared] if compared else []
    return ["diagnose", str(folder / BAG), "--rig", str(folder / RIG), *baseline, "--out", str(folder / RESULTS)]


def main() -> NoReturn:
    """Write a flight's bag, then execute its diagnosis."""
    give_way()
    try:
        arguments = write(Path(sys.argv[1]))
    except (BadInput, OSError) as error:
        sys.exit(str(error))
    sys.stderr.flush()
    os.execv(sys.executable, [sys.executable, "-m", "ehls_ros", *arguments])  # noqa: S606 - a list of arguments, no shell


if __name__ == "__main__":
    main()
