"""Exam on a single rod of which one pressure is missing, and the sides of its effects."""

from collections.abc import Callable, Mapping

import numpy as np

from benchmarks.diagnosis.cases import Case, effect_of, name_of, rig_file, shown
from truth_generator import Recording, degrade, draw_effect, variants
from truth_generator.cases import REFUSED
from truth_generator.single_rod import chambers

RIG = "single_rod"

OF_SENSORS = (*REFUSED, "pressure_sensor_bias", "pressure_sensor_gain")
"""Effects of the pressure sensors, one of which is missing in the exam `one_pressure`."""


def _load_pressure(r: Recording) -> Recording:
    cylinder = chambers(rig_file(RIG))
    return variants.one_pressure(r, (cylinder["area_a"], cylinder["area_b"]))


SIGNALS: Mapping[str, Callable[[Recording], Recording]] = {
    "pressure_a": lambda r: degrade.without(r, "pressure_b_pa"),
    "load_pressure": _load_pressure,
}
"""Kinds of data with one pressure."""


def make_one_pressure(seed: int, number: int, duration: float) -> Case:
    """Draw a case with one pressure, of both kinds in turn; the effect shows with all signals."""
    rng = np.random.default_rng([seed, number, 6])
    name = effect_of(seed, number, RIG, OF_SENSORS)
    case = shown(rng, seed, number, "singles", duration, lambda: {name: draw_effect(name, rng, rig_file(RIG))}, RIG)
    return case._replace(exam=name_of("one_pressure", RIG), data=list(SIGNALS)[number % len(SIGNALS)])


def side_of(name: str, hidden: Mapping[str, Mapping[str, object]]) -> str | None:
    """Return the side of a hidden effect, if it has one: that of an end stop is a number."""
    side = hidden[name].get("side")
    return side if isinstance(side, str) else None
