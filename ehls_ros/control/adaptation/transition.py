"""Transition of a running controller's model to an accepted rig, within the bounds and at the rate of adaptation.

All coefficients move together along a straight line. Relations that hold in both rigs, such as weights that sum to 1, therefore
hold in each intermediate model. The coefficient with the largest relative change determines the duration.
"""

import math
from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

from ehls_ros.control.adaptation.correction import AdaptationLimits, ChangeBounds, change_bounds
from ehls_ros.control.controllers.base import Model
from ehls_ros.errors import BadInput

WHERE = "accepted rig"

PARTS = ("plant", "friction", "cylinder", "valve")
"""Parts of a model whose coefficients move."""

MOVING = ("command_delay", "coupling_stiffness", "coupling_damping")
"""Numbers of a model that move besides those of its parts."""

NO_SIZES: Mapping[str, float] = MappingProxyType({})

ROUNDING = 1e-9
"""Fraction of a bound by which rounding may exceed it."""


class _Coefficient(NamedTuple):
    """A coefficient in three models.

    Attributes:
        name: key in a rig file.
        nominal: value in the rig file that the controller was started with.
        present: value in use.
        wanted: value in the accepted rig.
        size: reference of relative changes if the nominal value is smaller.
        least: smallest change that is always allowed.
    """

    name: str
    nominal: float
    present: float
    wanted: float
    size: float = 0.0
    least: float = 0.0

    @property
    def constant(self) -> bool:
        """Whether the coefficient does not move: all three values are equal, or unknown."""
        unknown = math.isnan(self.nominal) and math.isnan(self.wanted)
        return unknown or self.nominal == self.present == self.wanted


class Transition:
    """Interpolation from the model in use to that of an accepted rig.

    Attributes:
        duration: duration of the transition [s].
    """

    def __init__(
        self, original: Model, present: Model, wanted: Model, limits: AdaptationLimits, sizes: Mapping[str, float] = NO_SIZES
    ) -> None:
        """Check the accepted rig against the one that the controller was started with.

        Args:
            original: the model that the controller was started with.
            present: the model in use.
            wanted: the model of the accepted rig.
            limits: how far and how fast coefficients may move.
            sizes: references of relative changes, by name, for coefficients that may be near zero, such as a leakage.

        Raises:
            BadInput: the accepted rig is of another kind, or a coefficient differs by more than ``limits`` allows.
        """
        _check_kind(original, wanted)
        duration = 0.0
        for each in _coefficients(original, present, wanted, sizes):
            if each.constant:
                continue
            allowed = change_bounds(limits, max(abs(each.nominal), each.size), each.least)
            if not abs(each.wanted - each.nominal) <= (1.0 + ROUNDING) * allowed.change:
                raise _beyond(each, allowed, limits)
            duration = max(duration, abs(each.wanted - each.present) / allowed.rate)
        self._present, self._wanted = present, wanted
        self.duration = duration
        self._elapsed = 0.0

    @property
    def complete(self) -> bool:
        """Whether the accepted rig has been reached."""
        return self._elapsed >= self.duration

    def after(self, elapsed: float) -> Model:
        """Return the model after a further time [s]; from ``duration`` on, exactly that of the accepted rig."""
        self._elapsed += elapsed
        if self.complete:
            return self._wanted
        part = self._elapsed / self.duration
        old, new = self._present, self._wanted
        between = {name: _between(getattr(old, name), getattr(new, name), part) for name in MOVING}
        for name in PARTS:
            pairs = zip(getattr(old, name), getattr(new, name), strict=True)
            between[name] = type(getattr(new, name))(*(_between(*pair, part) for pair in pairs))
        return new._replace(**between)


def with_own_sensors(original: Model, wanted: Model) -> Model:
    """Return the model of an accepted rig with the sensor noise and period of the running controller."""
    return wanted._replace(noise=original.noise, period=original.period)


def _check_kind(original: Model, wanted: Model) -> None:
    for part in ("cylinder", "valve"):
        if type(getattr(wanted, part)) is not type(getattr(original, part)):
            raise BadInput(f"it has another kind of {part}", WHERE, f"the {part} of the controller's rig file")
    if type(wanted.friction) is not type(original.friction):
        names = [type(model.friction).__module__.rpartition(".")[2] for model in (wanted, original)]
        raise BadInput(f"the friction model is {names[0]}", WHERE, f"{names[1]}, as in the controller's rig file")
    for name, before, after in zip(original.friction._fields, original.friction, wanted.friction, strict=True):
        if isinstance(before, tuple) and len(before) != len(after):
            raise BadInput(f"{name} has {len(after)} values", WHERE, f"{len(before)}, as in the controller's rig file")
    if wanted.spool_limit != original.spool_limit:
        raise BadInput(f"limits: spool is {wanted.spool_limit:g}", WHERE, f"{original.spool_limit:g}, the controller's")


def _coefficients(original: Model, present: Model, wanted: Model, sizes: Mapping[str, float]) -> Iterator[_Coefficient]:
    for part in PARTS:
        models = [getattr(model, part) for model in (original, present, wanted)]
        for name, *values in zip(getattr(models[0], "_fields", ()), *models, strict=True):
            if isinstance(values[0], tuple):
                for index, each in enumerate(zip(*values, strict=True)):
                    yield _Coefficient(f"{name}[{index}]", *each)
            else:
                nominal, now, accepted = values
                yield _Coefficient(name, nominal, now, accepted, size=sizes.get(name, 0.0))
    for name in MOVING:
        nominal, now, accepted = (getattr(model, name) for model in (original, present, wanted))
        yield _Coefficient(name, nominal, now, accepted, least=original.period if name == "command_delay" else 0.0)


def _beyond(each: _Coefficient, allowed: ChangeBounds, limits: AdaptationLimits) -> BadInput:
    before, after = ("unknown" if math.isnan(value) else f"{value:g}" for value in (each.nominal, each.wanted))
    share = (
        f"a change of at most {allowed.change:g}, {100.0 * limits.reach:g} % in all" if allowed.change > 0.0 else "no change"
    )
    return BadInput(
        f"{each.name} goes from {before} to {after}",
        WHERE,
        f"{share}, while the controller runs; for a larger one start it with that rig file",
    )


def _between(old: Any, new: Any, part: float) -> Any:
    if isinstance(old, tuple):
        return tuple(_between(before, after, part) for before, after in zip(old, new, strict=True))
    return old + part * (new - old)
