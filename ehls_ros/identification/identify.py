"""Identification of a rig's friction: static fit, then a joint fit of model and force balance to all recordings."""

import itertools
import math
import time as clock
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np

from ehls_ros.diagnosis.contradictions import check_suits
from ehls_ros.errors import BadInput
from ehls_ros.identification.balance import Recorded, check_unit, without_known
from ehls_ros.identification.declared import fit_declared
from ehls_ros.identification.elements import MODEL, fit_elements, understated
from ehls_ros.identification.motion import SMALL_TRAVEL, Motion, motions_of
from ehls_ros.identification.optimisers import OPTIMISERS
from ehls_ros.identification.result import Identification
from ehls_ros.identification.static import Search, StaticFit, steady_fit
from ehls_ros.identification.strokes import Missing, missing_strokes
from ehls_ros.identification.uncertainty import estimates
from ehls_ros.physics.rig import Rig, check_known
from ehls_ros.samples import Mask
from ehls_ros.trajectory import Trajectory

DEFAULT_OPTIMISER = "pso"
"""Fastest optimiser in `benchmarks/optimisers.py` without a failed run; least squares is the most accurate."""

MASS_SIGNAL = 10.0
"""Inertia force, in standard deviations of the force's noise, above which the mass is fitted."""

STEADY = 0.1
"""Largest inertia force, and largest scatter of the force, of steady sliding, as a fraction of Coulomb friction."""

SOME_OUTLIERS = 1e-3
"""Omitted fraction of a recording above which a remark is made."""

NEEDED = ("plant.moving_mass", "plant.piston_area", "plant.spring_stiffness", "plant.viscous_damping")
"""Keys of the rig file required besides the friction."""

STEPS, DONE = 4, "done"
"""Number of progress steps of an identification, and the name of the last report."""

Progress = Callable[[str, int, int], None]


class MissingStrokes(BadInput):
    """Raised if the recordings lack strokes needed for the identification of friction."""

    def __init__(self, what: str, where: str, expected: str, missing: Missing) -> None:
        """Create the message and store the missing motion."""
        super().__init__(what, where, expected)
        self.missing = missing


def identify(
    recordings: Mapping[str, Trajectory],
    rig: Rig,
    *,
    optimiser: str = DEFAULT_OPTIMISER,
    parameters: Any = None,
    elements: int | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> Identification:
    """Identify the friction of a rig.

    Args:
        recordings: by a name for messages; each with ``position_m`` and ``force_n`` or ``load_pressure_pa``.
        rig: the rig as known so far: mass, piston area and B0 are taken from it, and the search starts from its friction.
        optimiser: of the static fit, a name of :data:`ehls_ros.identification.optimisers.OPTIMISERS`.
        parameters: its parameters; None: the declared defaults.
        elements: number of friction elements, of a model that has them; None: as many as the data show.
        seed: seed of the search's random numbers.
        progress: called with the name of the step that begins, the steps done and the number of steps.

    Returns:
        The result.

    Raises:
        BadInput: the recordings cannot be used; the message names the signal.
    """
    began = clock.perf_counter()
    steps = itertools.count()

    def report(what: str) -> None:
        if progress is not None:
            progress(what, STEPS if what == DONE else next(steps), STEPS)

    if not recordings:
        raise BadInput("there is no recording", "identification", "at least one recording")
    if elements is not None and rig.friction_model != MODEL:
        what = f"{elements} friction elements are asked for, friction model {rig.friction_model!r} has none"
        raise BadInput(what, "identification", f"no number of elements, or a rig whose friction model is {MODEL}")
    report("reading the motion")
    names = ", ".join(recordings)
    check_known(rig, "identification", NEEDED)
    doubts = [f"{name}: {doubt}" for name, recording in recordings.items() for doubt in check_suits(recording, rig, name)]
    motions = motions_of(recordings, rig)
    usable = tuple(m.resolved & known_state(m) if m.small else m.resolved for m in motions)
    if not any(np.any(u) for u in usable):
        raise BadInput("no stretch of any recording can be used", names, "longer recordings without gaps")
    linear = fitted_linear(motions, rig)

    report("static fit")
    chosen = parameters if parameters is not None else OPTIMISERS.load(optimiser).Parameters()
    # Steady sliding has hardly any inertia force, so the mass of the rig file is used.
    straight = tuple(name for name in linear if name not in {"viscous", "mass"})
    known = tuple(without_known(m, straight, rig) for m in motions)
    slow = tuple(u if m.small else u & is_steady(m, rig) for u, m in zip(usable, motions, strict=True))
    wide = [i for i, m in enumerate(motions) if not m.small]
    even = [u & is_steady(m, rig) for u, m in zip(usable, motions, strict=True)]
    lacking = missing_strokes(motions, even, rig, _disturbance(recordings))
    with _explained(lacking):
        sliding = Recorded(known, slow, straight).chosen(wide)
        steady = steady_fit(sliding, rig.plant.viscous_damping, Search(optimiser, chosen, seed))
        if steady is not None:
            _check_units(names, rig, steady)

    recorded = Recorded(tuple(without_known(m, linear, rig) for m in motions), usable, linear)
    start = start_of(rig, steady)
    with _explained(lacking):
        by_elements = fit_elements(recorded, rig, start, steady, elements, report) if rig.friction_model == MODEL else None
        result = by_elements or fit_declared(recorded._replace(usable=slow), rig, start, steady, report)
    found = estimates(result.fit, rig)
    too_small = understated(found.by_name) if by_elements else {}
    report(DONE)
    return Identification(
        rig=found.rig,
        estimates=found.by_name,
        correlations=found.correlations,
        not_identifiable=found.not_identifiable,
        remarks=(
            *(f"{name}: {remark}" for name, read in recordings.items() for remark in read.preparation.remarks),
            *doubts,
            *_remarks(motions, lacking),
            *result.remarks,
            *found.remarks,
            *_understated_remark(too_small),
        ),
        static=steady,
        branch=by_elements.branch if by_elements else None,
        nodes=by_elements.nodes if by_elements else (),
        criteria=by_elements.criteria if by_elements else {},
        fit=result.fit,
        motions=recorded.motions,
        method=optimiser,
        wall_s=clock.perf_counter() - began,
        lacking=lacking,
        understated=too_small,
    )


def known_state(motion: Motion) -> Mask:
    """Return the blocks after the second reversal of their stretch, where the contact's initial state no longer matters."""
    at_start = np.maximum.accumulate(np.where(motion.fresh, motion.strokes, 0))
    known: Mask = motion.strokes - at_start >= 2
    return known


def fitted_linear(motions: Sequence[Motion], rig: Rig) -> tuple[str, ...]:
    """Return the names of the linear coefficients identifiable from the recordings."""
    names = ["viscous"]
    used = [m for m in motions if np.any(m.resolved)]
    widest = max((float(np.ptp(m.position[m.resolved])) for m in used), default=0.0)
    if rig.plant.spring_stiffness > 0.0 and widest > SMALL_TRAVEL:
        names.append("spring")
    names.append("constant")
    signals = [float(np.std(m.acceleration[m.resolved])) * rig.plant.moving_mass / max(m.force_noise, 1e-9) for m in used]
    if max(signals, default=0.0) > MASS_SIGNAL:
        names.append("mass")
    return tuple(names)


def is_steady(motion: Motion, rig: Rig) -> Mask:
    """Return the blocks of steady motion, in which inertia force and scatter of the force are small compared with friction.

    Stick-slip too fast for the blocks is invisible in the velocity, but shows in the force.
    """
    limit = STEADY * rig.friction_level(math.inf)
    usual = float(np.median(motion.scatter[motion.resolved])) if np.any(motion.resolved) else 0.0
    steady: Mask = rig.plant.moving_mass * np.abs(motion.acceleration) <= limit
    return steady & (motion.scatter <= max(limit, 3.0 * usual))


def start_of(rig: Rig, steady: StaticFit | None) -> Any:
    """Return the starting friction: the rig file's, updated with those coefficients of a static fit that the model has."""
    if steady is None:
        return rig.friction
    found = steady.friction._asdict()
    found["coulomb_force"] = max(found["coulomb_force"], 1e-3 * rig.friction_level(math.inf))
    found["static_force"] = max(found["static_force"], found["coulomb_force"])
    return rig.friction._replace(**{name: value for name, value in found.items() if name in rig.friction._fields})


def _check_units(names: str, rig: Rig, steady: StaticFit) -> None:
    """Reject coefficients of the static fit that only a wrong unit explains."""
    check_unit("friction", steady.friction.coulomb_force, rig.friction_level(math.inf), names)
    if "spring" in steady.linear:
        check_unit("spring", steady.linear["spring"], rig.plant.spring_stiffness, names)


@contextmanager
def _explained(lacking: Missing) -> Iterator[None]:
    """Add the missing strokes to the error of a failing fit."""
    try:
        yield
    except BadInput as error:
        if not lacking.descriptions:
            raise
        what = f"{error.what}: there are no {', no '.join(lacking.descriptions)}"
        expected = f"{lacking.requested}; valve, oil and inertia can still be identified with --whole-rig"
        raise MissingStrokes(what, error.where, expected, lacking) from None


def _disturbance(recordings: Mapping[str, Trajectory]) -> float:
    """Return the largest standard deviation of a recorded disturbance force [N]."""
    acting = [r["disturbance_force_n"] for r in recordings.values() if "disturbance_force_n" in r]
    return max((float(np.nanstd(force)) for force in acting if np.any(np.isfinite(force))), default=0.0)


def _understated_remark(factors: Mapping[str, float]) -> list[str]:
    """Return a remark on understated standard errors, if there are any."""
    if not factors:
        return []
    named = ", ".join(f"{name} {factor:g} times" for name, factor in factors.items())
    return [f"Errors may exceed their standard errors where a loop moves the piston by less than its sensor resolves: {named}."]


def _remarks(motions: Sequence[Motion], lacking: Missing) -> list[str]:
    """Return remarks on omitted samples and missing strokes."""
    remarks = [
        f"{m.name}: {100.0 * m.outliers:.1f} % of the samples were outliers or missing and left out."
        for m in motions
        if m.outliers > SOME_OUTLIERS
    ]
    if lacking.descriptions:
        remarks.append(
            f"missing: {', '.join(lacking.descriptions)}; {lacking.requested} would identify the friction more reliably."
        )
    return remarks
