"""Identification of any friction model: its declared parameters fitted to sliding and presliding."""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import scipy

from ehls_ros.arrays import Array
from ehls_ros.duals import exp, value_of
from ehls_ros.errors import BadInput
from ehls_ros.identification import joint
from ehls_ros.identification.balance import Recorded
from ehls_ros.identification.friction_run import force_along, slopes_along
from ehls_ros.identification.joint import REACH, JointFit, Problem, Start
from ehls_ros.identification.motion import Motion, slides
from ehls_ros.identification.static import MIN_BLOCKS, StaticFit
from ehls_ros.identification.uncertainty import SHARP
from ehls_ros.physics.friction import FRICTION_MODELS
from ehls_ros.physics.rig import Rig
from ehls_ros.schema import declarations

VISCOUS = "viscous_coefficient"
"""Parameter common to all models, a linear coefficient of the force balance."""

SAMPLES, STARTS = 64, 3
"""Points of a Sobol sequence tried as starts, and number of the best that are fitted."""

WIDTH = math.log(10.0)
"""Half width of the range of the samples about the start, in coordinates."""

MAX_STD = 1.0
"""Standard deviation of a coordinate above which the data hold no information on it."""

FORGETTING = 3.0
"""Travel after a reversal, in lengths of break-away, after which the contact no longer depends on it."""

MIN_FORGETTING = 3e-3
"""Least travel after a reversal after which the contact no longer depends on it [m]."""

RISE = 1e-3
"""Least starting value of Fs - Fc, as a fraction of Fc."""


class Axis(NamedTuple):
    """One coordinate.

    Attributes:
        name: name of the parameter; for an entry of a list, with its number from 1.
        parameter: name of the parameter.
        entry: index of the entry of a list from 0; None for a number.
        scale: unit of a linear coordinate; 0 for a logarithmic one.
        low: smallest value.
        high: largest value.
    """

    name: str
    parameter: str
    entry: int | None
    scale: float
    low: float
    high: float

    def coordinate(self, value: float) -> float:
        """Return the coordinate of a value."""
        if self.scale:
            return value / self.scale
        return math.log(value) if value > 0.0 else -math.inf

    def of(self, friction: Any) -> float:
        """Return the coordinate of a friction."""
        value = getattr(friction, self.parameter)
        return self.coordinate(value if self.entry is None else value[self.entry])

    def value(self, coordinate: Any) -> Any:
        """Return the value at a coordinate, snapped to a limit of its range within rounding."""
        value = coordinate * self.scale if self.scale else exp(coordinate)
        limit = min(max(value_of(value), self.low), self.high)
        # The sum is exactly the limit, and a dual keeps its tangents.
        return value + (limit - value_of(value)) if math.isclose(value_of(value), limit, rel_tol=1e-9) else value


class DeclaredCoordinates(NamedTuple):
    """Coordinates of declared parameters: logarithms of non-negative ones, else multiples of the start.

    A static force is searched for as its excess over Coulomb friction, so that it stays above it.

    Attributes:
        model: name of the friction model.
        template: a friction of that model.
        axes: the coordinates.
    """

    model: str
    template: Any
    axes: tuple[Axis, ...]

    @classmethod
    def of(cls, model: str, friction: Any) -> "DeclaredCoordinates":
        """Return the coordinates of a model about one set of its parameters."""
        axes = []
        for declared in declarations(type(friction)):
            value = getattr(friction, declared.name)
            if declared.name == VISCOUS or not isinstance(value, float | tuple):
                continue
            entries = [(None, value)] if isinstance(value, float) else list(enumerate(value))
            for entry, number in entries:
                name = declared.name if entry is None else f"{declared.name}_{entry + 1}"
                low = -math.inf if declared.minimum is None else declared.minimum
                high = math.inf if declared.maximum is None else declared.maximum
                positive = number > 0.0 and (low >= 0.0 or entry is not None)
                width = high - low if math.isfinite(high - low) else 1.0
                axes.append(Axis(name, declared.name, entry, 0.0 if positive else abs(number) or width, low, high))
        return cls(model, friction, tuple(axes))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the coordinates."""
        return tuple(axis.name for axis in self.axes)

    def pack(self, friction: Any) -> Array:
        """Return the coordinates of a friction, shape (len(names),)."""
        if _has_rise(friction):
            rise = max(friction.static_force - friction.coulomb_force, RISE * friction.coulomb_force)
            friction = friction._replace(static_force=rise)
        values = (
            getattr(friction, a.parameter) if a.entry is None else getattr(friction, a.parameter)[a.entry] for a in self.axes
        )
        return np.array([axis.coordinate(value) for axis, value in zip(self.axes, values, strict=True)])

    def unpack(self, z: Array) -> Any:
        """Return the friction at coordinates ``z``, without its viscous part."""
        values: dict[str, Any] = {VISCOUS: 0.0}
        for axis, coordinate in zip(self.axes, z.tolist(), strict=True):
            value = axis.value(coordinate)
            values[axis.parameter] = value if axis.entry is None else (*values.get(axis.parameter, ()), value)
        friction = self.template._replace(**values)
        if _has_rise(friction):
            friction = friction._replace(static_force=friction.coulomb_force + friction.static_force)
        return friction

    def bounds(self, z: Array, period: float) -> tuple[Array, Array]:
        """Return the lowest and the highest coordinates of a search from ``z``; ``period`` is the blocks' length [s]."""
        low = np.maximum([axis.coordinate(axis.low) for axis in self.axes], z - REACH)
        high = np.minimum([axis.coordinate(axis.high) for axis in self.axes], z + REACH)
        return low, high

    def force(self, motion: Motion, friction: Any) -> Array:
        """Return the mean friction force in each block of a motion, without the viscous part, shape (n,) [N]."""
        return force_along(motion, self.model, friction)

    def slopes(self, motion: Motion, friction: Any) -> Array:
        """Return the derivatives of the force by the tangents of a friction of duals, shape (n, tangents) [N]."""
        return slopes_along(motion, self.model, friction)


def _has_rise(friction: Any) -> bool:
    return {"coulomb_force", "static_force"} <= set(friction._fields)


class DeclaredFit(NamedTuple):
    """Result of the fit of a declared friction model.

    Attributes:
        fit: the joint fit.
        remarks: sentences about its limits.
    """

    fit: JointFit
    remarks: tuple[str, ...]


def fit_declared(
    recorded: Recorded, rig: Rig, start: Any, steady: StaticFit | None, report: Callable[[str], None]
) -> DeclaredFit:
    """Fit the parameters of any friction model.

    Sliding is fitted first, then presliding for the parameters that sliding does not determine well, then everything together.

    Args:
        recorded: the recordings.
        rig: the rig as known so far.
        start: friction to start from, including the results of a static fit.
        steady: the static fit; None without steady sliding.
        report: called with the name of each step that begins.

    Returns:
        The fit.

    Raises:
        BadInput: there are too few blocks of steady sliding, and of presliding.
    """
    coordinates = DeclaredCoordinates.of(rig.friction_model, start)
    law = FRICTION_MODELS.load(rig.friction_model)
    motions = recorded.motions
    # A rigid contact has no presliding.
    rigid = not math.isfinite(law.stiffness(start))
    small = [] if rigid else [i for i, m in enumerate(motions) if m.small and recorded.usable[i].sum() >= MIN_BLOCKS]
    wide = [i for i, m in enumerate(motions) if not m.small]
    far = recorded.chosen(wide)
    forget = max(FORGETTING * law.break_away(start), MIN_FORGETTING)
    settle = 0.0 if steady is None else steady.settle_time
    sliding = tuple(u & slides(m, forget, settle) for m, u in zip(far.motions, far.usable, strict=True))
    far = far._replace(usable=sliding)
    if steady is None or sum(int(u.sum()) for u in sliding) < MIN_BLOCKS:
        wide = []
    if not small and not wide:
        names = ", ".join(m.name for m in motions)
        what = "there is no steady sliding" if rigid else "there is neither steady sliding nor a hysteresis loop"
        raise BadInput(what, names, f"strokes at constant velocities both ways{'' if rigid else ', or a small sine'}")
    near, everything = recorded.chosen(small), Start(coordinates, start, coordinates.names)
    if not wide:
        report("presliding")
        remark = "Nothing slides steadily for long enough: all parameters are fitted to presliding."
        return DeclaredFit(joint.placed(_best_fit(near, everything), small, motions), (remark,))
    report("sliding")
    determined = _determined(far, everything, SHARP if small else MAX_STD)
    free = tuple(name for name in coordinates.names if name not in determined.free)
    if not small:
        remark = "No presliding is recorded: parameters not identified from sliding keep the rig file's values."
        fit = joint.with_doubt(joint.fit(far, determined), far)
        return DeclaredFit(joint.placed(fit, wide, motions), (remark,) if free and not rigid else ())
    report("presliding")
    begin = _best_fit(near, determined._replace(free=free)).friction if free else determined.friction
    both = sorted([*small, *wide])
    usable = dict(zip([*wide, *small], [*far.usable, *near.usable], strict=True))
    all_of_them = recorded.chosen(both)._replace(usable=tuple(usable[i] for i in both))
    return DeclaredFit(joint.placed(joint.fit(all_of_them, everything._replace(friction=begin)), both, motions), ())


def _determined(recorded: Recorded, start: Start, doubt: float) -> Start:
    """Return a start with only the coordinates free whose standard error is below a limit; with all free if there are none."""
    fit = joint.fit(recorded, start, rounds=1)
    std = np.sqrt(np.diag(fit.covariance))[: len(fit.free)]
    determined = tuple(name for name, own in zip(fit.free, std, strict=True) if own <= doubt and name not in fit.limited)
    if not determined:
        return start
    z = np.where([name in determined for name in start.coordinates.names], fit.z, start.coordinates.pack(start.friction))
    return Start(start.coordinates, start.coordinates.unpack(z), determined)


def _best_fit(recorded: Recorded, start: Start) -> JointFit:
    """Fit from the given start and the best of several others, and return the best fit."""
    coordinates = start.coordinates
    z = coordinates.pack(start.friction)
    problem = Problem(recorded, start, z, [max(m.force_noise, 1e-9) for m in recorded.motions])
    low, high = map(problem.free, coordinates.bounds(z, max(m.period for m in recorded.motions)))
    own = np.clip(problem.free(z), low, high)
    unit = scipy.stats.qmc.Sobol(len(own), scramble=False).random(SAMPLES)
    bottom, top = np.maximum(low, own - WIDTH), np.minimum(high, own + WIDTH)
    trials = [own, *(bottom + unit * (top - bottom))]
    # Absolute values, so that a few stray blocks do not decide the choice.
    costs = [float(np.sum(np.abs(problem.residuals(trial)))) for trial in trials]
    chosen = {*np.argsort(costs)[:STARTS].tolist(), 0}
    fits = [joint.fit(recorded, start._replace(friction=problem.friction(trials[i]))) for i in sorted(chosen)]
    return min(fits, key=lambda fit: _unexplained(fit, recorded))


def _unexplained(fit: JointFit, recorded: Recorded) -> float:
    """Return the mean absolute residual [N]; a block that was left out counts with its limit."""
    total, count = 0.0, 0
    for residuals, usable, noise in zip(fit.residuals, recorded.usable, fit.noise, strict=True):
        left_out = usable & np.isnan(residuals)
        total += float(np.nansum(np.abs(residuals))) + joint.FAR * noise * int(left_out.sum())
        count += int(usable.sum())
    return total / max(1, count)
