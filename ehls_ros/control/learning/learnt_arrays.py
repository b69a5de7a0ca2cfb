"""Learnt arrays kept from one run to the next: the declaration of each block's arrays, and their bounds.

The forces are bounded by the rig, because a correction is added to the reference from the first load cycle on, before any error
can show that it is wrong.
"""

import math
from collections.abc import Mapping
from typing import Literal, NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.control.companions.base import Setting
from ehls_ros.control.controllers.base import FORESEEN
from ehls_ros.control.learning.learnt_block import LearntBlock
from ehls_ros.control.learning.repetition import MAX_SAMPLES
from ehls_ros.declared_arrays import Arrays, Entry, check_arrays

Method = Literal["waveform", "harmonics", "peak_valley"]

MIN_SAMPLES = 8
"""Fewest samples of a load cycle."""

MAX_CYCLES = 1e9
"""Largest number of load cycles used."""

MAX_VALUE = 1e15
"""Largest number of any array, in its unit."""

REFERENCE_SHARE = 0.5
"""Largest correction of a reference relative to its largest magnitude; one by peaks, valleys and phase has its ``reach``."""

FORCE_SHARE = 0.05
"""Largest correction of a small reference relative to the rig's largest force."""

_COMPLEX = Entry("complex128", ("harmonics",), maximum=MAX_VALUE)
_POSITIVE = Entry(shape=("harmonics",), minimum=0.0, maximum=MAX_VALUE)
_UNKNOWN = Entry(shape=("harmonics",), minimum=0.0, infinite=True)
_COUNT = Entry("int64", (), minimum=0, maximum=MAX_CYCLES)
_NUMBERS = Entry(shape=(3,), minimum=-MAX_VALUE, maximum=MAX_VALUE)
_NUMBERS_POSITIVE = Entry(shape=(3,), minimum=0.0, maximum=MAX_VALUE)

BLOCK: Mapping[str, Entry] = {
    "period": Entry(shape=(), minimum=MIN_SAMPLES - 0.5, maximum=MAX_SAMPLES + 0.5),
    "wanted": Entry(shape=("samples",), minimum=-MAX_VALUE, maximum=MAX_VALUE),
    "limits": Entry(shape=(2,), minimum=0.0, infinite=True),
    "largest": Entry(shape=(2,), minimum=0.0, maximum=MAX_VALUE),
    "errors": Entry(shape=(2,), minimum=0.0, maximum=MAX_VALUE),
    "bare": Entry(shape=("samples",), minimum=0.0, infinite=True),
}
"""Arrays of each block with any method."""

SAMPLED: Mapping[str, Entry] = {
    "cycles": _COUNT,
    "spectrum": _COMPLEX,
    "response": _COMPLEX,
    "doubt": _POSITIVE,
    "cross": _COMPLEX,
    "power": _POSITIVE,
}
"""Arrays of a correction by waveform or harmonics."""

FORCE: Mapping[str, Entry] = {
    "cycles": _COUNT,
    "spectrum": _COMPLEX,
    "mean": _COMPLEX,
    "noise": _UNKNOWN,
    "latest": _COMPLEX,
    "share": Entry(shape=(), minimum=0.0, maximum=MAX_VALUE),
}
"""Arrays of the foreseen force."""

PEAK_VALLEY: Mapping[str, Entry] = {
    "cycles": _COUNT,
    "numbers": _NUMBERS,
    "estimate": _NUMBERS,
    "variance": Entry(shape=(3,), minimum=0.0, infinite=True),
    "wander": _NUMBERS_POSITIVE,
    "secant": _NUMBERS,
    "cross": _NUMBERS,
    "power": _NUMBERS_POSITIVE,
    "useless": _NUMBERS_POSITIVE,
    "rest": _NUMBERS_POSITIVE,
}
"""Arrays of a correction of peaks, valleys and phase."""


class ForceBounds(NamedTuple):
    """Largest forces that can be learnt on a rig.

    Attributes:
        force: largest force of the rig [N].
        foreseen: largest external force [N]. If the piston is coupled to the actuator under test, it includes the coupling
            force for a far end that moves by the whole stroke.
    """

    force: float = math.inf
    foreseen: float = math.inf


def force_bounds(setting: Setting) -> ForceBounds:
    """Return the bounds implied by a controller's rig; infinite if the rig file has no limit."""
    limits = setting.limits
    if limits is None:
        return ForceBounds()
    stiffness, damping = (
        max(getattr(knows, name, 0.0) for knows in (setting.model, setting.tuning))
        for name in ("coupling_stiffness", "coupling_damping")
    )
    low, high = limits.position
    foreseen = limits.force + stiffness * (high - low) + damping * limits.velocity
    return ForceBounds(*(bound if bound > 0.0 else math.inf for bound in (limits.force, foreseen)))


def declared(method: Method, *, foresees: bool) -> dict[str, Entry]:
    """Return the declaration of a block's arrays.

    Args:
        method: method of the correction.
        foresees: whether an external force is foreseen as well.
    """
    reference = dict(PEAK_VALLEY if method == "peak_valley" else SAMPLED)
    if method != "peak_valley":
        kind = "complex128" if method == "harmonics" else "float64"
        length = "amplitudes" if method == "harmonics" else "samples"
        reference |= {
            "estimate": Entry(kind, (length,), maximum=MAX_VALUE),
            "variance": Entry(shape=(length,), minimum=0.0, infinite=True),
            "noise": Entry(shape=(length,), minimum=0.0, infinite=True),
        }
    out = {**BLOCK, **{f"reference.{name}": entry for name, entry in reference.items()}}
    return out | {f"force.{name}": entry for name, entry in FORCE.items()} if foresees else out


def check_block(arrays: Arrays, method: Method, bounds: ForceBounds, *, foresees: bool) -> None:
    """Check the arrays of one block against their declaration.

    Args:
        arrays: arrays by name.
        method: method of the correction.
        bounds: bounds of the rig.
        foresees: whether an external force is foreseen as well.

    Raises:
        ValueError: an array does not fit; the first is named.
    """
    samples = len(arrays["wanted"]) if "wanted" in arrays and arrays["wanted"].ndim == 1 else 0
    if not MIN_SAMPLES <= samples <= MAX_SAMPLES:
        raise ValueError(f"a load cycle has {samples} samples, not {MIN_SAMPLES} to {MAX_SAMPLES}")
    check_arrays(arrays, declared(method, foresees=foresees), {"samples": samples, "harmonics": samples // 2 + 1})
    if abs(float(arrays["period"]) - samples) > 1.0:
        raise ValueError(f"a load cycle of {float(arrays['period']):g} control cycles has {samples} samples")
    if float(np.max(np.abs(arrays["reference.estimate"]))) > bounds.force:
        raise ValueError(f"the error learnt exceeds the rig's force of {bounds.force:g} N")


def out_of_bounds(learnt: LearntBlock, method: Method, bounds: ForceBounds) -> str:
    """Return as text by how much a block's correction or foreseen force exceeds its bounds; empty if neither does.

    Args:
        learnt: learnt of the block.
        method: method of the correction.
        bounds: bounds of the rig.
    """
    correction, foreseen = (_largest(learnt.table[:, column]) for column in (0, FORESEEN))
    bound = bounds.force if method == "peak_valley" else largest_correction(learnt.wanted, bounds)
    if correction > bound:
        return f"the reference would be corrected by {correction:.4g} N, more than {bound:.4g} N"
    if foreseen > bounds.foreseen:
        return f"a force of {foreseen:.4g} N would be foreseen, more than {bounds.foreseen:.4g} N"
    return ""


def largest_correction(wanted: Array, bounds: ForceBounds) -> float:
    """Return the largest correction of a reference, also the largest rms error at which the force counts as followed [N].

    Args:
        wanted: the reference over a load cycle [N].
        bounds: bounds of the rig.
    """
    return max(REFERENCE_SHARE * float(np.max(np.abs(wanted))), FORCE_SHARE * bounds.force)


def _largest(values: Array) -> float:
    """Return the largest magnitude; 0 for a table without values (NaN)."""
    return float(np.max(np.abs(values))) if np.all(np.isfinite(values)) else 0.0
