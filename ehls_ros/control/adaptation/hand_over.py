"""Which of the estimates a controller is given, how fast, and what the user is told."""

import math
from typing import NamedTuple

from ehls_ros.control.controllers.base import Model
from ehls_ros.physics.rig import EffectUse, Rig


class Named(NamedTuple):
    """A coefficient that may be wrong.

    Attributes:
        words: what it is called.
        unit: ``""`` for one that is told relative to the rig file; else the unit of its estimate.
        rough: standard error with which it is worth using, over the others'.
    """

    words: str
    unit: str = ""
    rough: float = 1.0


COEFFICIENTS = {
    "valve_gain": Named("valve gain"),
    "valve_bandwidth": Named("valve bandwidth"),
    "command_delay": Named("command delay", "s"),
    "discharge_coefficient": Named("discharge coefficient"),
    "bulk_modulus": Named("bulk modulus over volume", rough=3.0),
    "piston_area": Named("piston area"),
    "friction_level": Named("friction level", rough=3.0),
    "viscous_coefficient": Named("viscous friction", rough=2.0),
    "moving_mass": Named("moving mass", rough=2.0),
}
"""What is looked for, by name."""


class Estimated(NamedTuple):
    """An estimate.

    Attributes:
        value: over the rig file's value; a delay in s.
        std: its standard error.
        meaning: what it is an estimate of, where that is more than the coefficient alone.
    """

    value: float
    std: float
    meaning: str = ""


class Caution(NamedTuple):
    """When a coefficient moves, how far and how fast.

    Attributes:
        reach: largest relative change.
        rate: largest relative change in a second [1/s].
        certain: largest relative standard error of an estimate that counts.
        significance: standard errors by which an estimate must differ from what the controller has.
    """

    reach: float
    rate: float
    certain: float
    significance: float


class Leeway(NamedTuple):
    """How far and how fast one coefficient may move.

    Attributes:
        change: largest change from its nominal value, in its unit.
        rate: largest change in a second.
    """

    change: float
    rate: float


def leeway(caution: Caution, nominal: float, least: float = 0.0) -> Leeway:
    """Return how far and how fast a coefficient may move.

    Args:
        caution: relative bounds.
        nominal: the rig file's value.
        least: smallest change that is always allowed: a delay of none has no relative change.
    """
    size = max(abs(nominal), least)
    return Leeway(max(caution.reach * size, least), caution.rate * size)


class HandedOver:
    """One coefficient on its way from the rig file's value to the estimate.

    Attributes:
        value: what the controller is given, over the rig file's value; a delay in s.
    """

    def __init__(self, name: str, nominal: float, period: float) -> None:
        """Start with the rig file's value.

        Args:
            name: of the coefficient.
            nominal: the rig file's value where it is told in its unit, else 1.
            period: of the cycles [s].
        """
        self._named = COEFFICIENTS[name]
        self._nominal = nominal
        self._least = period if self._named.unit else 0.0
        self._aim = self.value = float(nominal)
        self._latest: Estimated | None = None

    def judge(self, latest: Estimated | None, caution: Caution) -> None:
        """Choose where to go from the latest estimate; None: there is none."""
        self._latest = latest
        if latest is None or not self._known(latest, caution):
            return
        if abs(latest.value - self._aim) > caution.significance * latest.std or self._aim != self._nominal:
            reach = self._reach(caution)
            self._aim = float(min(max(latest.value, self._nominal - reach, 0.0), self._nominal + reach))

    def move(self, duration: float, caution: Caution) -> bool:
        """Go on for a time [s]; return whether anything changed."""
        most = leeway(caution, self._nominal, self._least).rate * duration
        change = min(max(self._aim - self.value, -most), most)
        self.value += change
        return change != 0.0

    def told(self, caution: Caution) -> str:
        """Return the sentence for the user."""
        name, latest = self._named.words, self._latest
        if latest is None or not self._known(latest, caution):
            how = (
                ""
                if latest is None or not math.isfinite(latest.std)
                else f" better than ± {self._amount(latest.std / self._relative(latest.value))}"
            )
            return f"{name}: this run does not tell it{how}; the rig file's is used"
        about = latest.meaning or f"the rig file's {name}"
        std = self._amount(latest.std / self._relative(latest.value) ** 2)
        off = latest.value - self._nominal
        if abs(off) <= caution.significance * latest.std:
            return f"{about} agrees with this run (± {std})"
        words = ("short", "long") if self._named.unit else ("low", "high")
        amount = self._amount(abs(off) / self._relative(latest.value))
        most = self._amount(self._reach(caution))
        end = f"; the controller is given a change of {most} at most" if self.capped(caution) else ""
        return f"{about} seems {amount} {words[int(off < 0.0)]} (± {std}){end}"

    def capped(self, caution: Caution) -> bool:
        """Return whether the latest estimate is known well enough to be used, and out of reach."""
        latest = self._latest
        if latest is None or not self._known(latest, caution):
            return False
        off = abs(latest.value - self._nominal)
        return off > max(self._reach(caution), caution.significance * latest.std)

    def at_bound(self, caution: Caution) -> str:
        """Return what is to be done about an estimate that is out of reach."""
        return f"{self.told(caution)}: correct the rig file, for which the run leaves rig_adapted.yaml"

    def _reach(self, caution: Caution) -> float:
        """Return the largest change, in the coefficient's unit."""
        return leeway(caution, self._nominal, self._least).change

    def _known(self, latest: Estimated, caution: Caution) -> bool:
        return latest.std <= self._named.rough * caution.certain * max(self._nominal, self._least)

    def _relative(self, value: float) -> float:
        """Return what an estimate is divided by to speak of the rig file's error: it is this much off the truth."""
        return 1.0 if self._named.unit else value

    def _amount(self, value: float) -> str:
        if self._named.unit:
            return f"{1e3 * value:.2g} ms"
        percent = 100.0 * value
        return f"{percent:.1f} %" if percent < 0.95 else f"{percent:.0f} %"


def corrected(model: Model, original: Model, values: dict[str, float]) -> Model:
    """Return a model with coefficients handed over.

    Args:
        model: the model in use.
        original: the rig file's.
        values: by name, over the rig file's; the delay in s.
    """
    plant, friction = original.plant, original.friction
    changed = {name: getattr(plant, name) * value for name, value in values.items() if name in plant._fields}
    scaled = {name: getattr(friction, name) * values["friction_level"] for name in SCALED if name in friction._fields}
    if "viscous_coefficient" in friction._fields:
        scaled["viscous_coefficient"] = friction.viscous_coefficient * values["viscous_coefficient"]
    return model._replace(
        plant=model.plant._replace(**changed),
        friction=model.friction._replace(**scaled),
        command_delay=values["command_delay"],
    )


SCALED = ("coulomb_force", "static_force", "attraction_rate")
"""What grows with the friction level: the curve, and the rate at which elements approach it."""


def corrected_rig(rig: Rig, original: Model, values: dict[str, float]) -> Rig:
    """Return a rig file's content with coefficients handed over; arguments as of :func:`corrected`."""
    model = corrected(original, original, values)
    delay = model.command_delay
    effects = tuple(
        EffectUse(use.name, use.parameters._replace(delay=delay)) if use.name == "command_delay" else use for use in rig.effects
    )
    return rig._replace(plant=model.plant, friction=model.friction, effects=effects)


def differs(value: float, nominal: float) -> bool:
    """Tell whether a value handed over is another than the rig file's."""
    return not math.isclose(value, nominal, rel_tol=1e-12, abs_tol=1e-12)
