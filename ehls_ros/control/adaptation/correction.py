"""Select the estimates handed over to a controller, limit their rate, and word the report to the user."""

import math
from typing import Any, NamedTuple

from ehls_ros.control.controllers.base import Model
from ehls_ros.physics.rig import EffectUse, Rig


class Description(NamedTuple):
    """Coefficient that may be wrong.

    Attributes:
        words: name in reports.
        unit: unit of its estimate; ``""`` if it is relative to the rig file.
        rough: factor on the standard error below which the estimate is used.
    """

    words: str
    unit: str = ""
    rough: float = 1.0


COEFFICIENTS = {
    "valve_gain": Description("valve gain"),
    "valve_bandwidth": Description("valve bandwidth"),
    "command_delay": Description("command delay", "s"),
    "discharge_coefficient": Description("discharge coefficient"),
    "bulk_modulus": Description("bulk modulus over volume", rough=3.0),
    "piston_area": Description("piston area"),
    "friction_level": Description("friction level", rough=3.0),
    "viscous_coefficient": Description("viscous friction", rough=2.0),
    "moving_mass": Description("moving mass", rough=2.0),
}
"""Coefficients to estimate, by name."""


class Estimated(NamedTuple):
    """Estimate of a coefficient.

    Attributes:
        value: estimate relative to the rig file's value; for a delay, in s.
        std: standard error of the value.
        meaning: the estimated quantity, if it is more than the coefficient alone.
    """

    value: float
    std: float
    meaning: str = ""


class AdaptationLimits(NamedTuple):
    """Conditions and bounds on the adaptation of a coefficient.

    Attributes:
        reach: largest relative change.
        rate: largest relative change per second [1/s].
        certain: largest relative standard error of a usable estimate.
        significance: standard errors by which an estimate must differ from the value in use.
    """

    reach: float
    rate: float
    certain: float
    significance: float


class ChangeBounds(NamedTuple):
    """Bounds on the change of one coefficient.

    Attributes:
        change: largest change from its nominal value, in its unit.
        rate: largest change per second.
    """

    change: float
    rate: float


def change_bounds(limits: AdaptationLimits, nominal: float, least: float = 0.0) -> ChangeBounds:
    """Return the bounds on the change of a coefficient.

    Args:
        limits: relative bounds.
        nominal: the rig file's value.
        least: smallest change that is always allowed, as a zero delay has no relative change.
    """
    size = max(abs(nominal), least)
    return ChangeBounds(max(limits.reach * size, least), limits.rate * size)


class Correction:
    """Coefficient on its way from the rig file's value to the estimate.

    Attributes:
        value: value handed over, relative to the rig file's; for a delay, in s.
    """

    def __init__(self, name: str, nominal: float, period: float) -> None:
        """Start with the rig file's value.

        Args:
            name: name of the coefficient.
            nominal: the rig file's value if estimated in its unit, otherwise 1.
            period: control period [s].
        """
        self._description = COEFFICIENTS[name]
        self._nominal = nominal
        self._least = period if self._description.unit else 0.0
        self._aim = self.value = float(nominal)
        self._latest: Estimated | None = None

    def judge(self, latest: Estimated | None, limits: AdaptationLimits) -> None:
        """Choose the target from the latest estimate; None if there is no estimate."""
        self._latest = latest
        if latest is None or not self._usable(latest, limits):
            return
        if abs(latest.value - self._aim) > limits.significance * latest.std or self._aim != self._nominal:
            reach = self._reach(limits)
            self._aim = float(min(max(latest.value, self._nominal - reach, 0.0), self._nominal + reach))

    def move(self, duration: float, limits: AdaptationLimits) -> bool:
        """Move towards the target for a time [s]; return whether the value changed."""
        most = change_bounds(limits, self._nominal, self._least).rate * duration
        change = min(max(self._aim - self.value, -most), most)
        self.value += change
        return change != 0.0

    def sentence(self, limits: AdaptationLimits) -> str:
        """Return the report of this coefficient as a sentence."""
        name, latest = self._description.words, self._latest
        if latest is None or not self._usable(latest, limits):
            how = (
                ""
                if latest is None or not math.isfinite(latest.std)
                else f" to better than ± {self._amount(latest.std / self._relative(latest.value))}"
            )
            return f"{name}: not identified{how}; the rig file's value is used"
        about = latest.meaning or f"the rig file's {name}"
        std = self._amount(latest.std / self._relative(latest.value) ** 2)
        off = latest.value - self._nominal
        if abs(off) <= limits.significance * latest.std:
            return f"{about} agrees with this run (± {std})"
        words = ("short", "long") if self._description.unit else ("low", "high")
        amount = self._amount(abs(off) / self._relative(latest.value))
        most = self._amount(self._reach(limits))
        end = f"; the controller is given a change of {most} at most" if self.capped(limits) else ""
        return f"{about} seems {amount} {words[int(off < 0.0)]} (± {std}){end}"

    def capped(self, limits: AdaptationLimits) -> bool:
        """Return whether the latest estimate is certain enough to be used but out of reach."""
        latest = self._latest
        if latest is None or not self._usable(latest, limits):
            return False
        off = abs(latest.value - self._nominal)
        return off > max(self._reach(limits), limits.significance * latest.std)

    def at_bound(self, limits: AdaptationLimits) -> str:
        """Return the sentence with the remedy for an estimate that is out of reach."""
        return f"{self.sentence(limits)}: correct the rig file, for which the run leaves rig_adapted.yaml"

    def _reach(self, limits: AdaptationLimits) -> float:
        """Return the largest change, in the coefficient's unit."""
        return change_bounds(limits, self._nominal, self._least).change

    def _usable(self, latest: Estimated, limits: AdaptationLimits) -> bool:
        return latest.std <= self._description.rough * limits.certain * max(self._nominal, self._least)

    def _relative(self, value: float) -> float:
        """Return the divisor that converts an estimate's error to the rig file's error, which is relative to the truth."""
        return 1.0 if self._description.unit else value

    def _amount(self, value: float) -> str:
        if self._description.unit:
            return f"{1e3 * value:.2g} ms"
        percent = 100.0 * value
        return f"{percent:.1f} %" if percent < 0.95 else f"{percent:.0f} %"


def corrected(model: Model, original: Model, values: dict[str, float]) -> Model:
    """Return a model with the handed-over coefficients.

    Args:
        model: the model in use.
        original: the rig file's.
        values: values by name, relative to the rig file's; the delay in s.
    """
    plant, friction = original.plant, original.friction
    changed = {name: getattr(plant, name) * value for name, value in values.items() if name in plant._fields}
    scaled = {name: getattr(friction, name) * values["friction_level"] for name in SCALED if name in friction._fields}
    if "viscous_coefficient" in friction._fields:
        scaled["viscous_coefficient"] = friction.viscous_coefficient * values["viscous_coefficient"]
    return model._replace(
        plant=model.plant._replace(**changed),
        cylinder=_with_areas(model.cylinder, original.cylinder, values["piston_area"]),
        friction=model.friction._replace(**scaled),
        command_delay=values["command_delay"],
    )


def _with_areas(cylinder: Any, original: Any, value: float) -> Any:
    """Return a cylinder's parameters with the areas of both chambers, if it has any, relative to the rig file's."""
    areas = [name for name in ("area_a", "area_b") if name in getattr(original, "_fields", ())]
    return cylinder._replace(**{name: getattr(original, name) * value for name in areas}) if areas else cylinder


SCALED = ("coulomb_force", "static_force", "attraction_rate")
"""Friction parameters that scale with the level: the curve, and the rate at which elements approach it."""


def corrected_rig(rig: Rig, original: Model, values: dict[str, float]) -> Rig:
    """Return a rig file's content with the handed-over coefficients; arguments as those of :func:`corrected`."""
    model = corrected(original, original, values)
    delay = model.command_delay
    effects = tuple(
        EffectUse(use.name, use.parameters._replace(delay=delay)) if use.name == "command_delay" else use for use in rig.effects
    )
    cylinder = rig.cylinder._replace(parameters=model.cylinder)
    return rig._replace(plant=model.plant, cylinder=cylinder, friction=model.friction, effects=effects)


def differs(value: float, nominal: float) -> bool:
    """Return whether a handed-over value differs from the rig file's."""
    return not math.isclose(value, nominal, rel_tol=1e-12, abs_tol=1e-12)
