"""Block of load cycles of one waveform, from valley to valley."""

from collections.abc import Mapping
from functools import lru_cache
from typing import Annotated, Any, NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.control.programme.blocks.base import Course
from ehls_ros.control.references import REFERENCES
from ehls_ros.errors import BadInput
from ehls_ros.schema import parse, quantity, text

SAMPLES = 100
"""Samples per load cycle that resolve its turning points."""


class Parameters(NamedTuple):
    """Waveform, mean, amplitude, frequency and number of the cycles."""

    count: Annotated[  # type: ignore[assignment]  # a tuple has a method of this name
        int, quantity("1", "number of load cycles", minimum=1, maximum=10**12)
    ]
    frequency: Annotated[float, quantity("Hz", "load cycles per second", above=0.0, maximum=1e3)]
    amplitude: Annotated[float, quantity("N or m", "half of the range from valley to peak", above=0.0, maximum=1e6)]
    mean: Annotated[float, quantity("N or m", "mean of valley and peak", minimum=-1e6, maximum=1e6)] = 0.0
    waveform: Annotated[str, text("cyclic reference whose wave it is, such as sine, triangle or haversine")] = "sine"
    shape: Annotated[
        Mapping[str, float] | None,
        text("further parameters of that reference, such as corner of a triangle or pulse of a haversine"),
    ] = None


def waveforms() -> tuple[str, ...]:
    """Return the names of the references that can be used as waveform."""
    return tuple(name for name, member in REFERENCES.usable().items() if _is_wave(member))


def _is_wave(member: Any) -> bool:
    return hasattr(member, "VALLEY") and hasattr(member, "place") and {"amplitude", "frequency"} <= {*member.Parameters._fields}


class _Wave(NamedTuple):
    """A reference's waveform with its parameters, the offset added to its value, and the time of its first valley [s]."""

    member: Any
    parameters: Any
    raised: float
    valley: float


def _wave(p: Parameters) -> _Wave:
    return _made(p._replace(shape=None), tuple(sorted((p.shape or {}).items())))


@lru_cache(maxsize=64)
def _made(p: Parameters, shape: tuple[tuple[str, float], ...]) -> _Wave:
    member: Any = REFERENCES.load(p.waveform, "cycles: waveform")
    if not _is_wave(member):
        raise BadInput(f"waveform is {p.waveform!r}, which has no load cycles", "cycles", f"one of {', '.join(waveforms())}")
    for name in ("amplitude", "frequency", "offset", "phase"):
        if name in dict(shape):
            raise BadInput(f"shape has {name!r}", "cycles", "amplitude, frequency and mean of the block itself")
    own = "offset" in member.Parameters._fields
    values = {"amplitude": p.amplitude, "frequency": p.frequency, **dict(shape), **({"offset": p.mean} if own else {})}
    parameters = parse(member.Parameters, values, f"cycles: shape of {p.waveform}")
    return _Wave(member, parameters, 0.0 if own else p.mean, member.VALLEY / p.frequency)


def course(p: Parameters, start: float) -> Course:
    """Return the course of the cycles, which is independent of ``start``."""
    valley = float(sample(np.zeros(1), p, start)[0, 0])
    period = 1.0 / p.frequency
    return Course(valley, valley, p.count * period, period, p.count, period / SAMPLES)


def sample(t: Array, p: Parameters, start: float) -> Array:
    """Return the cycles and their derivatives."""
    wave = _wave(p)
    rows = wave.member.sample(t + wave.valley, wave.parameters)
    rows[:, 0] += wave.raised
    return rows
