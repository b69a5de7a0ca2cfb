"""Declarations of all kinds of state: size, type of the document, arrays, and the remedy for an unusable file."""

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
        about: conditions of the learning, as text.
        parts: numbers of the parts of the arrays, such as blocks of a programme.
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
    """Progress of a programme.

    Attributes:
        programme: digest of its course.
        hold: value held after a stop; None: the present value.
        stop_time: time to come to rest [s].
        hold_time: duration of the ramp to the hold value [s].
        holds: all hold values since its beginning, as its file may change.
        run: process of the rig that counts the control cycles.
        seen: newest control cycle known.
        published: last control cycle whose reference was published.
        counting: first control cycle of the current load cycle.
        counted: number of load cycles in the log.
        motions: current and later motions.
        stiffness: stiffness of the blocks run so far.
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
"""State from which a programme resumes; a few kilobytes."""


# --- the monitor ----------------------------------------------------------------------------------------


class ReadingRecord(NamedTuple):
    """An identified coefficient; attributes of :class:`ehls_ros.diagnosis.monitoring.tracking.Reading`.

    NaN values and infinite standard errors are None.
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
    """A parameter of a cause; an unknown standard error is None."""

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

    ``earliest`` is None if it is before the first sample, ``cleared`` while the change is active, other times if unknown.
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


class IdentificationRecord(NamedTuple):
    """An identified rig; attributes of :class:`ehls_ros.experiments.monitoring.identified.Identification`.

    Of wrong numbers there are the given ones.
    """

    rig: Mapping[str, Any]
    wrong: Mapping[str, float]
    estimates: Mapping[str, EstimateRecord]
    why_not: Mapping[str, str]


class MonitorState(NamedTuple):
    """The memory of a monitor without its arrays.

    Attributes:
        baselines: names of the baseline recordings.
        end: newest time on the monitor's axis [s].
        anchors: times on that axis [s] with their stamps [ns].
        well: model of the healthy rig, as a rig file.
        model: the same with the changes since.
        changes: detected changes.
        history: the last readings of the coefficients.
        readings: the newest readings.
        watched: time for which blocks were judged [s].
        learnt: name of the file of the healthy rig; empty: none.
        blocks: name of the file of the summed blocks; empty: none.
        identification: the identification of the healthy rig.
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
    identification: IdentificationRecord | None = None


class DirectionRecord(NamedTuple):
    """A tested departure; attributes of :class:`ehls_ros.diagnosis.monitoring.directions.Direction`.

    An infinite bound is None.
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
        kind: kind of baseline.
        directions: the departures tested.
        signals: names of the recording's signals, in the order of its rows.
    """

    kind: Literal["the rig file", "the first minutes", "healthy recordings"]
    directions: tuple[DirectionRecord, ...]
    signals: tuple[str, ...]


MAX_SCORE = 1e15
"""Largest score, information or share of a block; the scores are in units of noise."""

ROWS = 3
"""Rows of a block: score, information and share."""

HEALTHY_ARRAYS: Mapping[str, Entry] = {
    "rows": Entry(shape=(ROWS, "blocks", "quantities"), minimum=-MAX_SCORE, maximum=MAX_SCORE),
    "lengths": Entry("int64", ("sections",), minimum=1, maximum=1 << 20),
    "time": Entry(shape=("samples",), minimum=-LONGEST_TIME, maximum=LONGEST_TIME),
    "signals": Entry(shape=("names", "samples"), missing=True),
}
"""Arrays beside :class:`HealthyRig`: healthy blocks, their number in each section, and the recording of the first minutes."""

BLOCK_ARRAYS: Mapping[str, Entry] = {
    "begins": Entry(shape=("blocks",), minimum=-LONGEST_TIME, maximum=LONGEST_TIME),
    "rows": Entry("float32", (ROWS, "blocks", "quantities"), minimum=-MAX_SCORE, maximum=MAX_SCORE),
}
"""Arrays of the summed blocks."""

MOST_BLOCKS = rules.LONGEST_WATCH
"""Maximum number of summed blocks."""

LEARNS_ANEW = "the file as the monitor left it; without it, the monitor learns anew"

MONITOR = Kind("monitor memory", 1, 1 << 22, MonitorState, LEARNS_ANEW)
"""Memory of a monitor; half a megabyte after years with a thousand changes."""

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
        cause: cause of the trip.
        stamp_ns: time of the trip [ns].
        baselines: recordings of the healthy rig for comparison.
        own_baseline: whether samples of the healthy rig are stored with it.
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
