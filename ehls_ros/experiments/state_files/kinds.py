"""Declarations of all kinds of state: size, type of the document, arrays, and the remedy for a file that cannot be used."""

from collections.abc import Mapping
from typing import Annotated, Any, Literal, NamedTuple

from ehls_ros.control.programme.counting import Stiffness
from ehls_ros.control.programme.motion import Motion
from ehls_ros.declared_arrays import Entry
from ehls_ros.diagnosis import rules
from ehls_ros.experiments.state_files.state_file import Kind
from ehls_ros.schema import quantity, text

MOST_CYCLES = 1 << 53
"""Largest number of a control cycle or load cycle."""

LATEST_NS = (1 << 63) - 1
"""Latest time stamp [ns]."""

LONGEST_TIME = 1e10
"""Largest time on a monitor's axis [s]."""

Cycle = Annotated[int, quantity("1", "number of a control cycle", minimum=-1, maximum=MOST_CYCLES)]
Count = Annotated[int, quantity("1", "number of things", minimum=0, maximum=MOST_CYCLES)]
Time = Annotated[float, quantity("s", "time on the monitor's axis", minimum=-LONGEST_TIME, maximum=LONGEST_TIME)]
Stamp = Annotated[int, quantity("ns", "time stamp", minimum=0, maximum=LATEST_NS)]


# --- learnt files of companions -------------------------------------------------------------------------


class LearntAbout(NamedTuple):
    """The document of a companion's file.

    Attributes:
        companion: its name.
        about: conditions of the learning, in words.
        parts: numbers of the parts that the arrays belong to, such as blocks of a programme.
    """

    companion: str
    about: Mapping[str, str]
    parts: tuple[Count, ...]


LEARNT = Kind(
    "learnt file",
    1,
    1 << 28,
    LearntAbout,
    "a file that the same companion learnt with these parameters on this rig, or a name that does not exist yet",
    arrays=20_000,
)
"""Learnt arrays of a companion; a load cycle of 100 000 samples takes 8 MB."""


# --- programmes -----------------------------------------------------------------------------------------


class ProgrammeState(NamedTuple):
    """Where a programme is.

    Attributes:
        programme: digest of its course.
        hold: value held after a stop; None: where it stands.
        stop_time: time in which it comes to rest [s].
        hold_time: time of the ramp to the value held [s].
        holds: values held after a stop since it began, as its file was changed.
        run: the rig's process that counts the control cycles.
        seen: newest control cycle known.
        published: last control cycle whose reference was published.
        counting: first control cycle of the load cycle under way.
        counted: load cycles in the log.
        motions: motions that are under way or to come.
        stiffness: stiffness of the blocks that ran.
    """

    programme: str
    hold: float | None
    stop_time: float
    hold_time: float
    holds: tuple[float | None, ...]
    run: str
    seen: Cycle
    published: Cycle
    counting: Cycle
    counted: Count
    motions: tuple[Motion, ...]
    stiffness: tuple[Stiffness, ...] = ()


PROGRAMME = Kind(
    "programme state",
    1,
    1 << 22,
    ProgrammeState,
    "the file as programme_node left it, another folder, or anew:=true to begin the programme anew",
)
"""Where a programme goes on; it has a few kilobytes."""


# --- the monitor ----------------------------------------------------------------------------------------


class ReadingRecord(NamedTuple):
    """A coefficient as it was identified; attributes of :class:`ehls_ros.diagnosis.monitoring.tracking.Reading`.

    A value that is not a number is None, and so is an infinite standard error.
    """

    name: str
    value: float | None
    deviation: float | None
    unit: str
    why_not: str


class PastRecord(NamedTuple):
    """The coefficients at a time."""

    time: Time
    readings: tuple[ReadingRecord, ...]


class EstimateRecord(NamedTuple):
    """A parameter of a cause; a standard error that is not known is None."""

    value: float
    std: float | None
    unit: str


class CauseRecord(NamedTuple):
    """A cause of a change; attributes of :class:`ehls_ros.experiments.monitoring.examination.FoundCause`."""

    name: str
    stage: str
    probability: Annotated[float, quantity("1", "probability of the cause", minimum=0.0, maximum=1.0)]
    equivalent_to: tuple[str, ...]
    parameters: Mapping[str, EstimateRecord]


class ChangeRecord(NamedTuple):
    """A change of the rig; attributes of :class:`ehls_ros.experiments.monitoring.health.FoundChange`.

    ``earliest`` is None where it lies before the first sample, ``cleared`` while the change shows, another time where it is not
    known.
    """

    number: Count
    causes: tuple[CauseRecord, ...]
    stage: str
    depends_on: tuple[str, ...]
    since: Time | None
    earliest: Time | None
    latest: Time | None
    noticed: Time | None
    named: Time | None
    cleared: Time | None
    acknowledged: bool
    before: bool


class MonitorState(NamedTuple):
    """The memory of a monitor without its arrays.

    Attributes:
        baselines: names of the recordings that a change is measured from.
        end: newest time on the monitor's axis [s].
        anchors: times on that axis with their stamps [s], [ns].
        well: the healthy rig's model, as a rig file.
        model: the same with the changes since.
        changes: changes that were found.
        history: the last readings of the coefficients.
        readings: the newest ones.
        watched: time for which blocks were judged [s].
        learnt: name of the file of the healthy rig; empty: none.
        blocks: name of the file of the summed blocks; empty: none.
    """

    baselines: tuple[str, ...]
    end: Time
    anchors: tuple[tuple[Time, Stamp], ...]
    well: Mapping[str, Any]
    model: Mapping[str, Any]
    changes: tuple[ChangeRecord, ...]
    history: tuple[PastRecord, ...]
    readings: tuple[ReadingRecord, ...]
    watched: Time
    learnt: Annotated[str, text("file's name")] = ""
    blocks: Annotated[str, text("file's name")] = ""


class DirectionRecord(NamedTuple):
    """A departure that is looked for; attributes of :class:`ehls_ros.diagnosis.monitoring.directions.Direction`.

    A bound that is infinite is None.
    """

    name: str
    number: Count
    free: tuple[str, ...]
    fixed: tuple[tuple[str, float], ...]
    starts: tuple[tuple[float, ...], ...]
    lower: tuple[float | None, ...]
    upper: tuple[float | None, ...]
    units: tuple[str, ...]
    neutral: tuple[float, ...]
    parameter: str
    values: tuple[float, ...]


class HealthyRig(NamedTuple):
    """The healthy rig without its arrays.

    Attributes:
        kind: origin from which a change is measured.
        directions: the departures that are looked for.
        signals: names of the recording's signals, in the order of its rows.
    """

    kind: Literal["the rig file", "the first minutes", "healthy recordings"]
    directions: tuple[DirectionRecord, ...]
    signals: tuple[str, ...]


LARGEST_SCORE = 1e15
"""Largest score, information or share of a block; the scores are in units of noise."""

ROWS = 3
"""Rows of a block: score, information and share."""

HEALTHY_ARRAYS: Mapping[str, Entry] = {
    "rows": Entry(shape=(ROWS, "blocks", "quantities"), least=-LARGEST_SCORE, most=LARGEST_SCORE),
    "lengths": Entry("int64", ("sections",), least=1, most=1 << 20),
    "time": Entry(shape=("samples",), least=-LONGEST_TIME, most=LONGEST_TIME),
    "signals": Entry(shape=("names", "samples"), missing=True),
}
"""Arrays beside :class:`HealthyRig`: healthy blocks, their number in each section, and the recording of the first minutes."""

BLOCK_ARRAYS: Mapping[str, Entry] = {
    "begins": Entry(shape=("blocks",), least=-LONGEST_TIME, most=LONGEST_TIME),
    "rows": Entry("float32", (ROWS, "blocks", "quantities"), least=-LARGEST_SCORE, most=LARGEST_SCORE),
}
"""Arrays of the summed blocks."""

MOST_BLOCKS = rules.LONGEST_WATCH
"""Most summed blocks."""

LEARNS_ANEW = "the file as the monitor left it; without it, the monitor learns anew"

MONITOR = Kind("monitor memory", 1, 1 << 22, MonitorState, LEARNS_ANEW)
"""The memory of a monitor; after years with a thousand changes it has half a megabyte."""

HEALTHY = Kind("healthy rig", 1, 1 << 28, HealthyRig, LEARNS_ANEW, arrays=len(HEALTHY_ARRAYS))
"""The healthy rig; ten minutes at 5 kHz take 200 MB, a minute at 1 kHz 4 MB."""


class NoContent(NamedTuple):
    """A document without content."""


BLOCKS = Kind("monitored blocks", 1, 1 << 24, NoContent, LEARNS_ANEW, arrays=len(BLOCK_ARRAYS))
"""The summed blocks; an hour of them takes a megabyte."""


# --- the flight recorder --------------------------------------------------------------------------------


class FlightRecord(NamedTuple):
    """A trip of the gate.

    Attributes:
        cause: of the trip.
        stamp_ns: when it was [ns].
        baselines: recordings of the healthy rig that it is compared with.
        own_baseline: whether samples of the healthy rig lie beside it.
    """

    cause: str
    stamp_ns: Stamp
    baselines: tuple[str, ...]
    own_baseline: bool


FLIGHT = Kind("flight", 1, 1 << 20, FlightRecord, "a flight as the monitor left it")
"""The mark of a flight's folder, with the inputs of its diagnosis."""


class FlightSignals(NamedTuple):
    """The names of a flight's arrays: signals of the samples before the trip, and of the healthy rig's."""

    bag: tuple[str, ...]
    baseline: tuple[str, ...]


def flight_arrays(signals: FlightSignals) -> dict[str, Entry]:
    """Return the declaration of a flight's arrays."""
    declared = {}
    for part, names in signals._asdict().items():
        if names or part == "bag":
            declared[f"{part}/"] = Entry(shape=(part,))
            declared |= {f"{part}/{name}": Entry(shape=(part,), missing=True) for name in names}
    return declared


SAMPLES = Kind("flight samples", 1, 1 << 30, FlightSignals, "samples as the monitor left them", arrays=100)
"""Samples before a trip; ten minutes at 5 kHz take 290 MB."""
