"""Spoilt files of all learnt or remembered data: none may crash a program, exhaust it, or destroy a foreign file.

python -m benchmarks.spoilt_memory [--files 300] [--seed 1] [--kinds learnt,programme]

Each file is spoilt in one way: bytes damaged, cut, compressed or huge; of another rig or control rate, or with values that are
impossible although its checksum is right; or a pipe, a folder, a device, a link. Then the parts of a program that use the
file start and end. The table counts, for each kind, the cases in which the file was taken, refused or set aside, and those
in which the end could not be written. Failures are tracebacks, foreign files changed, more than :data:`SECONDS` or
:data:`MEMORY`. A case depends on its number and the seed alone.
"""

import hashlib
import io
import itertools
import json
import math
import os
import random
import resource
import shutil
import signal
import stat
import subprocess
import sys
import tempfile
import time
import traceback
import zipfile
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import cache, partial
from pathlib import Path
from types import FrameType
from typing import Any, NamedTuple
from unittest import mock

import numpy as np
from numpy.typing import NDArray

from benchmarks.common import parser_of
from benchmarks.fuzz import Hang, spoilt
from ehls_ros.control.companion_chain import CompanionChain
from ehls_ros.control.companions.base import PLACE, Past, Upcoming
from ehls_ros.control.controllers.base import FORESEEN, ROW, STATUS_SIZE, model_of
from ehls_ros.control.learning.force_prediction import ForcePrediction
from ehls_ros.control.programme.counting import Counter as LoadCycleCounter
from ehls_ros.control.programme.counting import Sample
from ehls_ros.control.programme.declaration import Parameters
from ehls_ros.control.programme.expansion import Programme
from ehls_ros.control.programme.motion import Rows, Runner
from ehls_ros.diagnosis.hypotheses import Candidate
from ehls_ros.diagnosis.monitoring.blocks import Scores
from ehls_ros.diagnosis.monitoring.directions import Direction
from ehls_ros.diagnosis.monitoring.tracking import PastReadings, Reading
from ehls_ros.diagnosis.stages import CHANNELS
from ehls_ros.errors import BadInput
from ehls_ros.estimate import Estimate
from ehls_ros.experiments import learnt_files
from ehls_ros.experiments.accepted_rig import accepted_model, write_accepted
from ehls_ros.experiments.files import config_folder
from ehls_ros.experiments.monitoring import flight_recorder
from ehls_ros.experiments.monitoring.cycle_assembly import Anchor
from ehls_ros.experiments.monitoring.examination import FoundCause, SynchronousExaminer
from ehls_ros.experiments.monitoring.flight_recorder import Flight, FlightRecorder
from ehls_ros.experiments.monitoring.health import FoundChange
from ehls_ros.experiments.monitoring.memory import UNUSABLE, Memory
from ehls_ros.experiments.monitoring.monitor import Monitor
from ehls_ros.experiments.monitoring.monitor import Parameters as Watching
from ehls_ros.experiments.monitoring.saved_state import LearntRig, SavedState
from ehls_ros.experiments.programme_records import LOG, digest, open_records, plain, state_file
from ehls_ros.experiments.spec import Spec, company_of, load_rig, spec_from_mapping
from ehls_ros.experiments.state_files import archive
from ehls_ros.experiments.state_files.access import NotWritten
from ehls_ros.experiments.state_files.kinds import ProgrammeState
from ehls_ros.experiments.state_files.state_file import CHECKSUM, CHECKSUM_END, Origin
from ehls_ros.experiments.yaml_files import rig_text
from ehls_ros.physics import sensors
from ehls_ros.physics.rig import rig_to_mapping
from ehls_ros.recording import limits
from ehls_ros.recording.provenance import checksum_of
from ehls_ros.recording.regular_file import read_text
from ehls_ros.schema import parse
from ehls_ros.trajectory import Trajectory

SECONDS = 20.0
"""Longest time for one case [s]."""

MEMORY = 1 << 29
"""Maximum memory of one case beyond the process's baseline [B]."""

NOBODY = 65534
"""User id without privileges, for read-only folders that root could write."""

SMALL_DISK = 2048
"""Size of a file at which the disk is full [B]."""

BOMB = 1_400_000_000
"""Size to which a compressed file expands [B]."""

RIG = load_rig(config_folder() / "rig_paper.yaml")
PERIOD = 1e-3
ORIGIN = Origin.of(RIG, PERIOD)

TAKEN, REFUSED, ASIDE = "taken", "refused", "put aside"


class Memorised(NamedTuple):
    """A kind of memory.

    Attributes:
        name: its name in the table.
        make: writes healthy files into a folder, and returns the one that is spoilt.
        use: starts a program on the folder and ends it; returns one of :data:`TAKEN`, :data:`REFUSED` and :data:`ASIDE`.
        stays: whether a file that is refused must stay as it is.
    """

    name: str
    make: Callable[[Path], Path]
    use: Callable[[Path], str]
    stays: bool = True


# --- learnt files ---------------------------------------------------------------------------------------

SIZE = 400


def learning_spec(folder: Path, method: str, law: str) -> Spec:
    """Return an experiment with learning from a file of a folder."""
    data = {
        "rig": rig_to_mapping(RIG),
        "reference": {"name": "sine", "amplitude": 1500.0, "frequency": 1.0 / (SIZE * PERIOD)},
        "controller": {"name": law},
        "companions": [{"name": "learning", "method": method, "period": SIZE * PERIOD, "file": str(folder / "learnt.npz")}],
    }
    return spec_from_mapping(data, "spoilt", folder)


def learning_company(spec: Spec) -> CompanionChain:
    """Return the experiment's companion."""
    return company_of(spec, model_of(spec.controller_rig, PERIOD), "spoilt")


def learn(company: CompanionChain, cycles: int = 6) -> None:
    """Train the companion on a repeating error."""
    companion, nowhere, rest = company.members["learning"], np.full((1, PLACE), np.nan), np.zeros(1)
    draw = np.random.default_rng(1)
    model = model_of(RIG, PERIOD)
    for cycle in range(cycles * SIZE):
        angle = 2.0 * math.pi * cycle / SIZE
        rows = np.full((1, ROW), np.nan)
        rows[0, :FORESEEN] = 1500.0 * math.sin(angle), 0.0, 0.0
        wanted = rows[:, :FORESEEN].copy()
        companion.ahead(Upcoming(cycle, rows, nowhere, np.full((1, 3), np.nan)))
        measured, status = np.zeros((1, 7)), np.zeros((1, STATUS_SIZE))
        measured[0, sensors.FORCE] = rows[0, 0] + 60.0 * math.cos(angle) + 0.5 * draw.standard_normal()
        companion.done(Past(cycle, rows, wanted, nowhere, measured, rest, status), model)


@cache
def _learnt(method: str, law: str) -> bytes:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        spec = learning_spec(folder, method, "fasmc")
        company = learning_company(spec)
        learn(company)
        learnt_files.keep(company, spec)
        content = (folder / "learnt.npz").read_bytes()
    return content if law == "fasmc" else forged(content, law=law)


def forged(content: bytes, law: str) -> bytes:
    """Return a learnt file as a predictive law leaves it."""
    force = ForcePrediction(SIZE, SIZE * PERIOD, 80.0, 0.02)
    pull = 500.0 * np.sin(2.0 * math.pi * np.arange(SIZE) / SIZE)
    for noise in np.random.default_rng(2).standard_normal((4, SIZE)):
        force.observe(pull + noise)
    force.correct()

    def change(document: dict[str, Any], arrays: dict[str, Any]) -> None:
        document["content"]["about"]["controller"] = law
        arrays.update({f"0.force.{name}": array for name, array in force.stored().items()})

    return changed_archive(content, change)


def make_learnt(folder: Path, method: str, law: str) -> Path:
    """Write a learnt file."""
    path = folder / "learnt.npz"
    path.write_bytes(_learnt(method, law))
    return path


def use_learnt(folder: Path, method: str, law: str) -> str:
    """Start and end an experiment."""
    spec = learning_spec(folder, method, law)
    company = learning_company(spec)
    try:
        learnt_files.recall(company, spec)
    except BadInput as error:
        return refused(error)
    check_commands(company)
    learnt_files.keep(company, spec)
    return TAKEN


def check_commands(company: CompanionChain) -> None:
    """Check that the correction of the reference is finite and a fraction of it."""
    companion, nowhere = company.members["learning"], np.full((1, PLACE), np.nan)
    for cycle in range(0, SIZE, 10):
        rows = np.full((1, ROW), np.nan)
        rows[0, :FORESEEN] = 1500.0 * math.sin(2.0 * math.pi * cycle / SIZE), 0.0, 0.0
        wanted = rows[0, 0]
        companion.ahead(Upcoming(cycle, rows, nowhere, np.full((1, 3), np.nan)))
        if not abs(rows[0, 0] - wanted) <= 0.1 * RIG.limits.force:
            raise AssertionError(f"{rows[0, 0]:g} N are followed in place of {wanted:g} N")


# --- programmes -----------------------------------------------------------------------------------------

PROGRAMME = Programme(
    parse(
        Parameters,
        {
            "blocks": [
                {"block": "cycles", "mean": 1e3, "amplitude": 500.0, "frequency": 10.0, "count": 70},
                {"block": "dwell", "time": 0.5},
                {"block": "cycles", "mean": 2e3, "amplitude": 300.0, "frequency": 5.0, "count": 30},
            ],
            "start": 500.0,
            "hold": 100.0,
        },
        "spoilt",
    )
)


def sample_of(rows: Rows, row: int, cycle: int, error: float) -> Sample:
    """Return a control cycle whose force has an error [N], as if it had been measured."""
    points, force = rows.points, float(rows.reference[row, 0])
    return Sample(
        cycle,
        int(points.block[row]),
        int(points.repetition[row]),
        int(points.load_cycles[row]),
        float(points.phase[row]),
        int(rows.state[row]),
        force,
        force + error,
        1e-6 * force,
    )


def make_programme(folder: Path, name: str) -> Path:
    """Write state and log of a programme that was stopped, and return one of them."""
    runner = Runner(PROGRAMME, PERIOD, (Runner.beginning(PROGRAMME, 0),))
    counter, rows, found = LoadCycleCounter(PROGRAMME), runner.rows(0, 2000), []
    for k in range(2000):
        found += counter.add(sample_of(rows, k, k, 3.0))
    runner.stop(2100, "on request")
    records = open_records(folder, PROGRAMME, ORIGIN, "force", RIG.limits, anew=False)
    records.log.add(found, 1.7e9)
    records.log.flush()
    records.close()
    p = PROGRAMME.parameters
    state = ProgrammeState(
        digest(PROGRAMME), p.hold, p.stop_time, p.hold_time, (p.hold,), "a run", 1999, 2199, 1950, counter.done,
        tuple(runner.motions), counter.stiffness,
    )  # fmt: skip
    state_file(folder, ORIGIN).write(plain(state))
    return folder / name


def use_programme(folder: Path) -> str:
    """Resume a programme where it was and end it."""
    try:
        records = open_records(folder, PROGRAMME, ORIGIN, "force", RIG.limits, anew=False)
    except BadInput as error:
        return refused(error)
    try:
        if records.state is None:
            return TAKEN
        state = records.state
        counter = LoadCycleCounter(PROGRAMME, records.counted, state.stiffness)
        runner = Runner(PROGRAMME, PERIOD, state.motions)
        rows = runner.rows(state.seen, 3000)
        if not (np.all(np.isfinite(rows.reference)) and np.all(np.abs(rows.reference[:, 0]) <= 2.0 * RIG.limits.force)):
            raise AssertionError(f"the reference goes to {np.max(np.abs(rows.reference[:, 0])):g} N")
        for k in range(0, 3000, 7):
            records.log.add(counter.add(sample_of(rows, k, state.seen + k, 0.0)), 1.7e9)
        records.log.flush()
        end = state._replace(counted=counter.done, seen=state.seen + 2999, published=state.seen + 2999)
        state_file(folder, ORIGIN).write(plain(end))
    finally:
        records.close()
    return TAKEN


# --- the monitor ----------------------------------------------------------------------------------------


def saved_state() -> SavedState:
    """Return the memory of a monitor that has watched a healthy rig for a while."""
    leak = Candidate(
        name="internal_leakage_shift",
        number=0,
        free=("added",),
        fixed=(),
        starts=np.array([[0.0], [1e-12]]),
        lower=np.array([0.0]),
        upper=np.array([np.inf]),
        units=("m^5/(N s)",),
        neutral=np.zeros(1),
    )
    directions = (Direction(leak, "added", np.array([1e-12])),)
    draw, quantities = np.random.default_rng(1), len(directions) + len(CHANNELS)

    def rows(blocks: int) -> NDArray[np.float64]:
        ones = np.ones((blocks, quantities))
        return np.stack([draw.standard_normal((blocks, quantities)), ones, ones])

    none = np.zeros((0, 0))
    sections = (tuple(Scores(row[0], row[1], row[2], none) for row in rows(40).swapaxes(0, 1)),)
    readings = (
        Reading("leakage_coefficient", 4.7e-12, 1e-13, "m^5/(N s)"),
        Reading("moving_mass", 70.0, math.inf, "kg", "not excited by the programme"),
    )
    cause = FoundCause("internal_leakage_shift", "flow", 0.98, ("turbulent_leakage",), {"added": Estimate(2e-12, 1e-13, "1")})
    return SavedState(
        learnt=LearntRig("the rig file", directions, sections),
        healthy_rig=RIG,
        model=RIG,
        changes=(FoundChange(1, (cause,), "flow", (), 30.0, -math.inf, 33.0, 35.0, 36.0),),
        history=tuple(PastReadings(60.0 * (k + 1), readings) for k in range(10)),
        readings=readings,
        watched=600.0,
        begins=tuple(2.5 * k for k in range(30)),
        rows=rows(30),
    )


ANCHORS = (Anchor(0.0, 1_700_000_000 * 10**9),)


def make_monitor(folder: Path, name: str) -> Path:
    """Write a monitor's memory, and return one of its files."""
    memory = Memory(folder, ORIGIN)
    memory.save(saved_state(), ANCHORS, 600.0)
    memory.close()
    return folder / name


def use_monitor(folder: Path) -> str:
    """Start a monitor and end it."""
    outcome = TAKEN
    memory = Memory(folder, ORIGIN)
    monitor = Monitor(RIG, Watching(), SynchronousExaminer())
    try:
        if (kept := memory.restore()) is not None:
            monitor.restore(kept.state)
            monitor.health()
    except UNUSABLE as error:
        outcome = ASIDE
        reason = error if isinstance(error, BadInput) else BadInput(str(error), str(folder), "sense")
        one_line(memory.put_aside(reason))
    with suppress(BadInput):
        memory.check_writable()
    try:
        outcome = ASIDE if memory.open_history() else outcome
        memory.save(saved_state(), ANCHORS, 700.0)
    finally:
        memory.close()
    return outcome


# --- the flight recorder --------------------------------------------------------------------------------


class Ended:
    """A process that has ended."""

    def poll(self) -> int:
        """Return its code."""
        return 0


@contextmanager
def no_processes() -> Iterator[None]:
    """Prevent the flight recorder from starting processes."""
    with mock.patch.object(subprocess, "Popen", return_value=Ended()):
        yield


def _flight(second: int) -> Flight:
    recording = Trajectory(np.linspace(0.0, 1.0, 50), {"position_m": np.zeros(50), "valve_command_m": np.full(50, np.nan)})
    return Flight(recording, "emergency stop", (1_700_000_000 + second) * 10**9)


def make_flight(folder: Path, name: str) -> Path:
    """Write a flight, and return one of its files."""
    with no_processes():
        made = FlightRecorder(folder / "flights", 3, 1.0).begin(_flight(0), RIG, PERIOD)
    return made / name


def use_flight(folder: Path) -> str:
    """Make a bag of the first flight, and write others until it is removed."""
    outcome = TAKEN
    first = next(path for path in sorted((folder / "flights").iterdir()) if path.name.startswith("20231114"))
    try:
        flight_recorder.write(first)
    except BadInput as error:
        outcome = refused(error)
    except OSError as error:
        # In the words of the process that does it.
        raise NotWritten(str(error)) from None
    with no_processes():
        for second in range(1, 5):
            FlightRecorder(folder / "flights", 2, 1.0).begin(_flight(second), RIG, PERIOD)
    return outcome


# --- accepted rigs --------------------------------------------------------------------------------------


def make_accepted(folder: Path) -> Path:
    """Write an accepted rig."""
    rig = RIG._replace(plant=RIG.plant._replace(bulk_modulus=0.9 * RIG.plant.bulk_modulus))
    write_accepted(folder / "rig_accepted.yaml", rig_text(rig_to_mapping(rig)))
    return folder / "rig_accepted.yaml"


def use_accepted(folder: Path) -> str:
    """Pass the rig to a controller, and replace its file by another one."""
    path, outcome = folder / "rig_accepted.yaml", TAKEN
    try:
        text = read_text(path, limits.TEXT, "an accepted rig")
        model = accepted_model(text, RIG, PERIOD, "accepted_rig")
        if not abs(model.plant.piston_area / RIG.plant.piston_area - 1.0) < 0.31:
            raise AssertionError(f"the piston area becomes {model.plant.piston_area}")
    except BadInput as error:
        outcome = refused(error)
    write_accepted(path, rig_text(rig_to_mapping(RIG)))
    return outcome


def learnt_kind(name: str, method: str, law: str = "fasmc") -> Memorised:
    """Return the memory of one learning method."""
    return Memorised(
        f"learnt, {name}", partial(make_learnt, method=method, law=law), partial(use_learnt, method=method, law=law)
    )


KINDS: tuple[Memorised, ...] = (
    learnt_kind("waveform", "waveform"),
    learnt_kind("harmonics", "harmonics"),
    learnt_kind("peaks and valleys", "peak_valley"),
    learnt_kind("foreseen force", "waveform", "fasmc_predictive"),
    Memorised("programme, state", partial(make_programme, name="programme_state.json"), use_programme),
    Memorised("programme, log", partial(make_programme, name=LOG), use_programme),
    Memorised("monitor, memory", partial(make_monitor, name="memory.json"), use_monitor, stays=False),
    Memorised("monitor, healthy rig", partial(make_monitor, name="learnt_0.npz"), use_monitor, stays=False),
    Memorised("monitor, blocks", partial(make_monitor, name="blocks_0.npz"), use_monitor, stays=False),
    Memorised("monitor, history", partial(make_monitor, name="coefficients.csv"), use_monitor, stays=False),
    Memorised("flight, samples", partial(make_flight, name="samples.npz"), use_flight, stays=False),
    Memorised("flight, mark", partial(make_flight, name="flight.json"), use_flight, stays=False),
    Memorised("accepted rig", make_accepted, use_accepted, stays=False),
)
"""All kinds of memory."""


# --- ways to spoil a file -------------------------------------------------------------------------------

NUMBERS: tuple[Any, ...] = (
    *(0, -1, 1, 2, 1e9, -1e12, 1e12, 1e300, 5e-324, 10**30, 2**53, 2**63, 0.5),
    *(True, None, "1", "", [], {}, [[]]),
)
"""Replacement values."""


def sealed(document: Mapping[str, Any] | bytes) -> bytes:
    """Return a document with a matching checksum."""
    whole = document if isinstance(document, bytes) else json.dumps(document).encode()
    body = whole[:-1]
    return body + CHECKSUM + f"{checksum_of(body):016x}".encode() + CHECKSUM_END


def opened(document: bytes) -> dict[str, Any]:
    """Return a document without its checksum."""
    body: dict[str, Any] = json.loads(document.rpartition(CHECKSUM)[0] + b"}")
    return body


Change = Callable[[dict[str, Any], dict[str, Any]], None]
"""Changes document and arrays in place."""


def changed_archive(content: bytes, change: Change) -> bytes:
    """Return a file with arrays whose content was changed, with correct checksums."""
    held = archive.read(content, 100_000)
    document, arrays = opened(held.document), dict[str, Any](held.arrays)
    change(document, arrays)
    made = io.BytesIO()
    archive.write(made, sealed(document), arrays)
    return made.getvalue()


def changed(path: Path, change: Change) -> None:
    """Change document, and arrays if any, of a state file; a table or text gets a wrong cell instead."""
    content = path.read_bytes()
    if path.suffix == ".npz":
        path.write_bytes(changed_archive(content, change))
    elif path.suffix == ".json":
        document = opened(content)
        change(document, {})
        path.write_bytes(sealed(document))
    else:
        raise NotApplicable


class NotApplicable(Exception):
    """Raised if a way to spoil a file does not apply to it."""


def places(part: Any) -> Iterator[tuple[Any, Any]]:
    """Yield all containers of a document with their keys."""
    keys = list(part) if isinstance(part, dict) else range(len(part))
    for key in keys:
        yield part, key
        if isinstance(part[key], dict | list):
            yield from places(part[key])


def other_value(draw: random.Random, path: Path) -> None:
    """Replace one value of the document by another, or by none."""

    def change(document: dict[str, Any], _: dict[str, Any]) -> None:
        part, key = draw.choice(list(places(document["content"])) or [(document, "content")])
        if draw.random() < 0.15:
            del part[key]
        elif isinstance(part[key], float | int) and draw.random() < 0.3:
            part[key] *= draw.choice((-1, 10, 1000, 1e9))
        else:
            part[key] = draw.choice(NUMBERS)

    if path.suffix in {".npz", ".json"}:
        changed(path, change)
        return
    lines = path.read_bytes().split(b"\n")
    line = draw.randrange(max(len(lines) - 3, 0), len(lines))
    cells = lines[line].split(b"," if path.suffix == ".csv" else b" ")
    cells[draw.randrange(len(cells))] = draw.choice((b"999999999", b"nan", b"-1", b"1e300", b"x", b"", b"0", b"[[[", b"\0"))
    lines[line] = b",".join(cells)
    path.write_bytes(b"\n".join(lines))


def other_array(draw: random.Random, path: Path) -> None:
    """Change one array: its numbers, type or shape; or leave it out."""

    def change(_: dict[str, Any], arrays: dict[str, Any]) -> None:
        if not arrays:
            raise NotApplicable
        name = draw.choice(list(arrays))
        array = arrays[name]
        match draw.randrange(9):
            case 0:
                with np.errstate(invalid="ignore"):
                    arrays[name] = np.real(array).astype(draw.choice((np.float32, np.int64, np.complex128, np.float64)))
            case 1:
                arrays[name] = array[:-1] if array.ndim else np.array([array])
            case 2:
                arrays[name] = np.concatenate([array, array]) if array.ndim else array
            case 3:
                del arrays[name]
            case 4:
                arrays[f"{name}x"] = array
            case 5:
                arrays[name] = (array * draw.choice((0, -1, 1000, 1e9))).astype(array.dtype)
            case 6:
                arrays[name] = np.zeros((0,) * array.ndim, array.dtype)
            case _:
                flat = array.astype(array.dtype).reshape(-1)
                if flat.size and flat.dtype.kind != "i":
                    flat[draw.randrange(flat.size)] = draw.choice((np.nan, np.inf, -np.inf, 1e30, -1e30))
                arrays[name] = flat.reshape(array.shape)

    changed(path, change)


def other_origin(draw: random.Random, path: Path) -> None:
    """Relabel the file as of another rig, control rate or layout."""

    def change(document: dict[str, Any], _: dict[str, Any]) -> None:
        match draw.randrange(4):
            case 0:
                document["rig"]["plant"]["piston_area"] *= 10.0
            case 1:
                document["control_period"] *= 2.0
            case 2:
                document["rig"] = draw.choice(NUMBERS)
            case _:
                document["format"] = document["format"][:-1] + "7"

    changed(path, change)


def nested(draw: random.Random, path: Path) -> None:
    """Nest the document's content deeply."""
    depth = draw.choice((900, 5000, 200_000))
    text = b"[" * depth + b"]" * depth

    def inner(document: dict[str, Any]) -> bytes:
        where = draw.choice(("content", "rig"))
        document[where] = "HERE"
        return json.dumps(document).encode().replace(b'"HERE"', text)

    if path.suffix == ".json":
        path.write_bytes(sealed(inner(opened(path.read_bytes()))))
    elif path.suffix == ".npz":
        held = archive.read(path.read_bytes(), 100_000)
        with path.open("wb") as file:
            archive.write(file, sealed(inner(opened(held.document))), held.arrays)
    else:
        path.write_bytes(path.read_bytes() + text)


@cache
def _bomb(size: int) -> bytes:
    made, piece = io.BytesIO(), bytes(1 << 20)
    with zipfile.ZipFile(made, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as file, file.open("rows.npy", "w") as entry:
        np.lib.format.write_array_header_1_0(entry, {"descr": "<f8", "fortran_order": False, "shape": (size // 8,)})
        for _ in range(size // len(piece)):
            entry.write(piece)
    return made.getvalue()


def bomb(draw: random.Random, path: Path) -> None:
    """A small file that expands to a large one."""
    path.write_bytes(_bomb(BOMB))


def foreign_archive(draw: random.Random, path: Path) -> None:
    """A file of numpy, with a pickle or without."""
    made = io.BytesIO()
    np.savez(made, a=np.zeros(3), b=np.array([{}, []], dtype=object) if draw.random() < 0.5 else np.zeros(2))
    path.write_bytes(made.getvalue())


def empty(draw: random.Random, path: Path) -> None:
    """An empty file."""
    path.write_bytes(b"")


def huge(draw: random.Random, path: Path) -> None:
    """A sparse file of ten gigabytes, which may begin correctly."""
    if draw.random() < 0.5:
        empty(draw, path)
    os.truncate(path, 10**10)


def damaged(draw: random.Random, path: Path) -> None:
    """Damaged bytes."""
    path.write_bytes(spoilt(draw, path.read_bytes()))


def cut(draw: random.Random, path: Path) -> None:
    """A file that was cut, or whose end became zeros in a power failure."""
    content = path.read_bytes()
    kept = content[: draw.randrange(len(content) + 1)]
    path.write_bytes(kept + draw.choice((b"", bytes(4096), b"this line is text\n", b"999999999,0,1\n")))


def pipe(draw: random.Random, path: Path) -> None:
    """A pipe without a writer."""
    path.unlink()
    os.mkfifo(path)


def directory(draw: random.Random, path: Path) -> None:
    """A folder."""
    path.unlink()
    path.mkdir()
    if draw.random() < 0.5:
        (path / "kept.txt").write_text("a foreign file", encoding="utf-8")


def device(draw: random.Random, path: Path) -> None:
    """A link to a device."""
    path.unlink()
    path.symlink_to(draw.choice(("/dev/zero", "/dev/full", "/dev/null", "/proc/self/mem")))


def link(draw: random.Random, path: Path) -> None:
    """A link: to the file itself moved elsewhere, to a foreign file, to nothing, to itself."""
    outside = path.parent / "outside"
    outside.mkdir()
    match draw.randrange(4):
        case 0:
            path.rename(outside / "own")
            path.symlink_to(outside / "own")
        case 1:
            (outside / "foreign.txt").write_text("a foreign file", encoding="utf-8")
            path.unlink()
            path.symlink_to(outside / "foreign.txt")
        case 2:
            path.unlink()
            path.symlink_to(outside / "nothing")
        case _:
            path.unlink()
            path.symlink_to(path)


def left_alone(draw: random.Random, path: Path) -> None:
    """The intact file, on a disk or in a folder that is not."""


class Surroundings(NamedTuple):
    """State of disk and folder of the file.

    Attributes:
        full: whether no file can become larger than :data:`SMALL_DISK`.
        read_only: whether the folder cannot be written.
    """

    full: bool = False
    read_only: bool = False


OF_FILES = (
    *(damaged, cut, other_value, other_value, other_value, other_array, other_array, other_array, other_origin),
    *(nested, bomb, foreign_archive, empty, huge, pipe, directory, device, link),
)

WAYS: tuple[tuple[Callable[[random.Random, Path], None], Surroundings], ...] = (
    *((way, Surroundings()) for way in OF_FILES),
    (left_alone, Surroundings(full=True)),
    (left_alone, Surroundings(read_only=True)),
)
"""Ways to spoil a file, in turn."""


# --- running --------------------------------------------------------------------------------------------


class Case(NamedTuple):
    """The result of one file.

    Attributes:
        outcome: one of :data:`TAKEN`, :data:`REFUSED` and :data:`ASIDE`; empty: the program failed.
        unwritten: whether a file could not be written at the end.
        failure: the traceback's last line, or the bound that was exceeded; empty: none.
        changed: foreign files that were changed.
    """

    outcome: str
    unwritten: bool
    failure: str
    changed: tuple[str, ...]


def one_line(said: str) -> str:
    """Check that a message is one readable line, and return it."""
    if not said.isprintable() or len(said) > 4000:
        raise AssertionError(f"not one readable line: {said!r}")
    return said


def refused(error: BadInput) -> str:
    """Return the outcome of a file that was refused in one readable line."""
    one_line(str(error))
    return REFUSED


FOREIGN: Mapping[str, bytes] = {
    "mine.npz": b"PK\3\4 mine", "learnt_5.npz": b"mine", "blocks_0.npz.bak": b"mine", "notes.txt": b"mine",
    "flights/20200101-000000/measured.csv": b"mine", "load_cycles.1.csv": b"mine",
}  # fmt: skip
"""Files of others in the folder of a memory."""


def _print_of(path: Path) -> str:
    """Return a fingerprint of a file's kind and content; only regular files of bounded size are opened."""
    if not os.path.lexists(path):
        return "nothing"
    mode = os.lstat(path).st_mode
    if stat.S_ISLNK(mode):
        return f"link to {path.readlink()}"
    if stat.S_ISREG(mode) and os.lstat(path).st_size < 1 << 28:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    return f"{stat.S_IFMT(mode)} of {os.lstat(path).st_size}"


def foreign_prints(folder: Path) -> dict[str, str]:
    """Return the prints of all foreign files in a folder, and of those that links lead to."""
    found = {name: _print_of(folder / name) for name in FOREIGN}
    return found | {str(path): _print_of(path) for path in folder.rglob("foreign.txt")}


@contextmanager
def bounded() -> Iterator[None]:
    """Interrupt a case that takes too long."""

    def on_time_up(number: int, frame: FrameType | None) -> None:
        raise Hang

    before = signal.signal(signal.SIGALRM, on_time_up)
    # A running test may use the same alarm.
    earlier = signal.setitimer(signal.ITIMER_REAL, SECONDS)
    try:
        yield
    finally:
        signal.signal(signal.SIGALRM, before)
        signal.setitimer(signal.ITIMER_REAL, *earlier)


@contextmanager
def surrounded(folder: Path, surroundings: Surroundings) -> Iterator[None]:
    """Make the disk full, or the folder read-only."""
    size, most = resource.getrlimit(resource.RLIMIT_FSIZE)
    root = os.geteuid() == 0
    if surroundings.read_only:
        for path in (folder, *(path for path in folder.rglob("*") if path.is_dir() and not path.is_symlink())):
            path.chmod(0o555)
        if root:
            os.seteuid(NOBODY)
    if surroundings.full:
        resource.setrlimit(resource.RLIMIT_FSIZE, (SMALL_DISK, most))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, most))
        if surroundings.read_only:
            if root:
                os.seteuid(0)
            for path in (folder, *(path for path in folder.rglob("*") if path.is_dir() and not path.is_symlink())):
                path.chmod(0o755)


def run_case(kind: Memorised, number: int, seed: int, folder: Path) -> Case:
    """Spoil one file and let a program use it.

    Args:
        kind: of the memory.
        number: of the case.
        seed: of all cases.
        folder: an empty folder.
    """
    draw = random.Random(f"{seed} {kind.name} {number}")  # noqa: S311
    spoil, surroundings = WAYS[number % len(WAYS)]
    victim = kind.make(folder)
    for name, content in FOREIGN.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
    with suppress(NotApplicable):
        spoil(draw, victim)
    foreign, before = foreign_prints(folder), _print_of(victim)
    outcome, unwritten, failure = "", False, ""
    try:
        with bounded(), surrounded(folder, surroundings):
            outcome = kind.use(folder)
    except NotWritten as error:
        unwritten = True
        one_line(str(error))
    except (Hang, MemoryError) as error:
        failure = f"unbounded: {type(error).__name__} by {spoil.__name__}"
    except Exception as error:  # noqa: BLE001 - any other exception is a finding
        frame = traceback.extract_tb(error.__traceback__)[-1]
        failure = f"{type(error).__name__} in {Path(frame.filename).name}:{frame.lineno} by {spoil.__name__}: {error}"
    after = foreign_prints(folder)
    lost = tuple(name for name, mark in foreign.items() if after.get(name) != mark)
    if kind.stays and outcome == REFUSED and _print_of(victim) != before:
        lost += (f"{victim.name}, which was refused",)
    return Case(outcome, unwritten, failure, lost)


def spoil_kind(kind: Memorised, files: int, seed: int, folder: Path, numbers: Sequence[int] | None = None) -> list[Case]:
    """Run the cases of one kind of memory.

    Args:
        kind: of the memory.
        files: number of files.
        seed: of the cases.
        folder: for the files; they are removed.
        numbers: the cases that are run; None: all of them.
    """
    cases = []
    for number in range(files) if numbers is None else numbers:
        place = folder / f"{number}"
        place.mkdir(mode=0o755)
        cases.append(run_case(kind, number, seed, place))
        shutil.rmtree(place)
    return cases


def row(kind: Memorised, cases: Sequence[Case], seconds: float) -> str:
    """Return the table's row of a kind."""
    counts = Counter(case.outcome for case in cases)
    unbounded = sum(case.failure.startswith("unbounded") for case in cases)
    tracebacks = sum(bool(case.failure) for case in cases) - unbounded
    figures = [
        len(cases), counts[TAKEN], counts[REFUSED], counts[ASIDE], sum(case.unwritten for case in cases),
        tracebacks, sum(bool(case.changed) for case in cases), unbounded, f"{seconds:.1f}",
    ]  # fmt: skip
    return f"| {kind.name} | {' | '.join(map(str, figures))} |"


HEADER = """| memory | files | taken | refused | put aside | not written | tracebacks | foreign files changed | unbounded | s |
|---|---|---|---|---|---|---|---|---|---|"""


def main() -> None:
    """Run all kinds, or the requested ones, and print the table."""
    parser = parser_of(__doc__)
    parser.add_argument("--files", type=int, default=300, help="files of each kind")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--kinds", default="", help="first words of the kinds to run, separated by commas; all by default")
    options = parser.parse_args()
    wanted = tuple(filter(None, options.kinds.split(",")))
    own = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0]) * resource.getpagesize()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        folder.chmod(0o755)
        _bomb(BOMB)
        resource.setrlimit(resource.RLIMIT_AS, (own + MEMORY, resource.getrlimit(resource.RLIMIT_AS)[1]))
        print(HEADER)
        failures = list[str]()
        for kind in KINDS:
            if wanted and not kind.name.startswith(wanted):
                continue
            began = time.monotonic()
            cases = spoil_kind(kind, options.files, options.seed, folder)
            print(row(kind, cases, time.monotonic() - began), flush=True)
            for number, case in enumerate(cases):
                found = [case.failure, *(f"changed {path}" for path in case.changed)]
                failures += [f"{kind.name} {number}: {failure}" for failure in found if failure]
    print("\n".join(itertools.islice(failures, 40)))
    sys.exit(bool(failures))


if __name__ == "__main__":
    main()
