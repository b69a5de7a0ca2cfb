"""Sentences of a monitor's report."""

import math
from collections.abc import Mapping
from datetime import datetime, timedelta
from typing import NamedTuple

from ehls_ros.diagnosis.monitoring.tracking import COEFFICIENTS, Reading
from ehls_ros.diagnosis.result import Fitted
from ehls_ros.estimate import Estimate
from ehls_ros.experiments.monitoring.baseline import RIG_FILE
from ehls_ros.experiments.monitoring.health import FoundChange, State
from ehls_ros.experiments.monitoring.replay import MonitoringResult
from ehls_ros.experiments.monitoring.trends import NORMAL_95, LimitPrediction
from ehls_ros.physics.rig import Rig
from ehls_ros.report.diagnosis_findings import STAGE_NAMES, capital, words
from ehls_ros.report.diagnosis_findings import fitted as fitted_parameter
from ehls_ros.report.page import MISSING_NUMBER, listed, number, signed
from ehls_ros.report.quantities import after, likely, percent, quantity, unit_for, value, written

MINUTE, HOUR, DAY, YEAR = 60.0, 3600.0, 86400.0, 8766.0 * 3600.0

IN_SECONDS, IN_MINUTES = 10.0 * MINUTE, 2.0 * HOUR
"""Longest times shown in seconds and in minutes [s]."""

NOT_OBSERVABLE, NOT_YET = "no recorded signal depends on it", "no samples judged yet"
"""Reasons why a coefficient has no reading."""

MAX_HEADLINE_CHANGES = 2
"""Maximum number of changes described in the headline."""


class Clock(NamedTuple):
    """Format of times on the monitor's axis.

    Attributes:
        zero: the wall time at which the axis is 0; None: times are written relative to it.
    """

    zero: datetime | None = None

    def text(self, seconds: float) -> str:
        """Format a time."""
        if self.zero is not None:
            return f"{self.zero + timedelta(seconds=seconds):%Y-%m-%d %H:%M:%S}"
        return duration(seconds)


FROM_ZERO = Clock()
"""Format of times relative to the beginning."""


def duration(seconds: float) -> str:
    """Write a time with its unit."""
    for longest, unit, symbol in ((IN_SECONDS, 1.0, "s"), (IN_MINUTES, MINUTE, "min"), (2.0 * DAY, HOUR, "h")):
        if abs(seconds) <= longest:
            return f"{number(seconds / unit)} {symbol}"
    return f"{number(seconds / DAY)} days"


def answer(watched: MonitoringResult, clock: Clock = FROM_ZERO) -> tuple[str, bool | None]:
    """Return the rig's health in a sentence, and whether no change is active; None if nothing was judged."""
    health = watched.health
    if health.active:
        sentences = [change_sentence(change, watched.rig, clock) for change in health.active[:MAX_HEADLINE_CHANGES]]
        more = len(health.active) - MAX_HEADLINE_CHANGES
        return f"{'. '.join(sentences)}{f'. {more} more changes are active' if more > 0 else ''}.", False
    if not health.watched or health.state in {State.LEARNING, State.IDLE}:
        reason = health.reason or f"the scatter of the healthy rig is still being learnt ({duration(health.time)} recorded)"
        return f"The rig is not judged: {reason}.", None
    past = [change for change in health.changes if not change.active]
    cleared = f" {len(past)} earlier changes have cleared." if past else ""
    wrong = [_wrong(*item) for item in health.rig_values.items()]
    file = f" The rig file is wrong: {listed(wrong)}." if wrong else ""
    return f"No change detected in {duration(health.watched)} against {health.baseline}.{cleared}{file}", True


def _wrong(path: str, wrong: Fitted) -> str:
    """Write a wrong number of the rig file, with the identified one and its 95 % interval."""
    unit = unit_for(wrong.fitted.unit, abs(wrong.fitted.value))
    text = written(unit.factor * wrong.fitted.value, unit.factor * NORMAL_95 * wrong.fitted.std)
    name = path.partition(".")[2].replace("_", " ")
    return f"{name} {number(unit.factor * wrong.given)}, identified {text.value} ± {text.error}{after(unit)}"


def change_sentence(change: FoundChange, rig: Rig, clock: Clock) -> str:
    """Return a sentence on a change: cause, size, onset and probability.

    Args:
        change: the change.
        rig: the healthy rig, to whose values sizes are relative.
        clock: format of times.
    """
    since = f"since {clock.text(change.since)}"
    if math.isfinite(change.earliest) and change.latest > change.earliest:
        since += f" (between {clock.text(change.earliest)} and {clock.text(change.latest)})"
    elif not math.isfinite(change.earliest):
        since = f"since {clock.text(change.latest)} or earlier"
    if not change.causes:
        depends = f", depends on {listed([quantity(s) for s in change.depends_on])}" if change.depends_on else ""
        stage = STAGE_NAMES.get(change.stage, change.stage)  # type: ignore[call-overload]
        return f"The {stage} has changed {since}, the cause is unknown{depends}"
    cause = change.causes[0]
    sizes = listed([_size(cause.name, name, e, rig) for name, e in cause.parameters.items()])
    equivalent = (
        f"; {listed([words(name).noun for name in cause.equivalent_to])} would be indistinguishable"
        if cause.equivalent_to
        else ""
    )
    return f"{capital(words(cause.name).noun)} changed {since}: {sizes}, probability {likely(cause.probability)}{equivalent}"


def _size(effect: str, parameter: str, e: Estimate, rig: Rig) -> str:
    """Write a parameter with its 95 % interval and, if it adds to a coefficient, the resulting multiple of its value."""
    text = f"{parameter} {fitted_parameter(effect, parameter, e._replace(std=NORMAL_95 * e.std))}"
    added = (c for c in COEFFICIENTS.values() if (c.effect, c.parameter) == (effect, parameter) and c.coefficient)
    found = next((c for c in added if not c.relative), None)
    given = 0.0 if found is None else found.given(rig)
    if found is None or not given:
        return text
    factor = written(1.0 + e.value / given, NORMAL_95 * e.std / abs(given))
    return f"{text}, {found.words} {factor.value} ± {factor.error} times the healthy value"


def false_alarms(hours: float) -> str:
    """Return an explanation of the false-alarm rate."""
    a_year = YEAR / HOUR / hours
    often = f"{number(a_year, 2)} a year" if a_year >= 1.0 else f"one in {number(1.0 / a_year, 2)} years"
    return (
        f"The mean time between false alarms is set to {number(hours)} h: on a healthy rig that runs day and night, at most"
        f" {often} on average. A detected change is diagnosed, and reported with a cause only if the diagnosis confirms it."
    )


def covers_all(baseline: str) -> bool:
    """Return whether a baseline covers every operating point, as the rig file's model does."""
    return baseline == RIG_FILE


def outside(share: float, baseline: str) -> str:
    """Return a sentence on the time outside the baseline.

    Args:
        share: fraction of the last minute.
        baseline: name of the baseline.
    """
    if covers_all(baseline):
        return "The baseline is the rig file, whose model is valid at every load and speed."
    if share <= 0.0:
        return "All of the last minute was within the range of the baseline."
    return (
        f"{percent(share)} of the last minute was outside the range of the baseline, such as at a higher load or speed, and is"
        " not judged."
    )


def known(watched: MonitoringResult) -> list[Reading]:
    """Return the final readings of all coefficients; one without a reading states the reason."""
    there = {reading.name: reading for reading in watched.health.readings}
    why_not = NOT_OBSERVABLE if there else NOT_YET
    return [
        there.get(name) or Reading(name, coefficient.given(watched.rig), math.inf, "", why_not)
        for name, coefficient in COEFFICIENTS.items()
    ]


def reading_text(reading: Reading) -> str:
    """Write a reading with its 95 % interval."""
    unit = unit_for(reading.unit, abs(reading.value))
    text = written(unit.factor * reading.value, unit.factor * NORMAL_95 * reading.deviation)
    return f"{text.value} ± {text.error}{after(unit)}"


HEADER = ("coefficient", "value, 95 %", "healthy", "change per hour", "limit")
"""Columns of the table of coefficients."""


def table_row(reading: Reading, watched: MonitoringResult) -> list[str]:
    """Return the texts of a coefficient's row in the table."""
    coefficient = COEFFICIENTS[reading.name]
    if not reading.identified:
        return [coefficient.words, f"not identified: {reading.why_not}", "", "", ""]
    given = value(coefficient.given(watched.rig), reading.unit)
    rate = watched.health.rates.get(reading.name)
    limit = watched.limits.get(reading.name)
    unit = unit_for(reading.unit, abs(reading.value))
    change = MISSING_NUMBER
    if rate is not None:
        change = f"{signed(unit.factor * rate.value, 2)} ± {number(NORMAL_95 * unit.factor * rate.std, 2)}{after(unit)}"
    return [coefficient.words, reading_text(reading), given, change, "" if limit is None else limit_text(limit, reading.unit)]


def limit_text(found: LimitPrediction, unit: str) -> str:
    """Return a phrase on the time at which a limit is reached."""
    limit = value(found.limit, unit)
    if found.why_not:
        return f"{limit}: no prediction, {found.why_not}"
    if found.hours <= 0.0:
        return f"{limit}: reached"
    likeliest, earliest, latest = (duration(hours * HOUR) for hours in (found.hours, found.earliest, found.latest))
    return f"{limit}: in {likeliest} (95 %: {earliest} to {latest})"


def offered(watched: MonitoringResult) -> str:
    """Return a sentence on the experiment that would identify the missing coefficients; empty if there are none."""
    offer = watched.offer
    if offer is None:
        grey = [COEFFICIENTS[name].words for name in watched.missing]
        return f"No experiment of the catalogue identifies {listed(grey)} from the recorded signals." if grey else ""
    names: Mapping[str, str] = {name: COEFFICIENTS[name].words for name in offer.tells}
    often = "" if offer.repeats == 1 else f", run {offer.repeats} times"
    takes = f"{offer.purpose}, {duration(offer.seconds)}{often}"
    return (
        f"The shortest experiment that identifies {listed(list(names.values()))}: `{offer.name}`, {takes}, as simulated on the"
        " healthy rig."
    )
