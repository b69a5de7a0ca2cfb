"""Sentences of a diagnosis report."""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from ehls_ros.diagnosis.causes import spring_in_force
from ehls_ros.diagnosis.result import NAMING, Cause, ChannelGain, Diagnosis, Rival, Sensitivity, StageResult
from ehls_ros.diagnosis.rules import TOLERANCE
from ehls_ros.diagnosis.stages import CHANNELS, Channel, Stage
from ehls_ros.diagnosis.verdict import NEEDED_MOTION
from ehls_ros.estimate import Estimate
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.effects.base import Side, Words
from ehls_ros.report.page import listed, number
from ehls_ros.report.quantities import ALMOST, NORMAL_95, change, estimate, likely, percent, quantity, value
from ehls_ros.schema import Declaration, declarations
from ehls_ros.trajectory import SIGNALS

AT_NOISE = 1.5
"""Ratio of residual to noise up to which a balance counts as closed to the noise."""

SHORT_TIME = 0.1
"""Share of the time up to which half of a squared error counts as concentrated."""

IN_A_SENTENCE = 2
"""Maximum number of causes, or of signals, listed in the sentence of the verdict."""

CERTAIN_PROBABILITY = 0.95
"""Probability above which a cause is named without its probability."""

LIKELY = 0.5
"""Probability below which a cause is one of several candidates."""

OPEN_CANDIDATE = 10.0
"""Shortfall of gain up to which a rival of such a cause is a candidate [nats]."""

RIG_FILE = "in the rig file"
"""State to which a changed value is compared, without baselines."""

FITTED_RIG = "in the fitted rig"
"""State to which a changed value is compared, if a first draft of a rig file was fitted first."""

UNDECIDED = "undecided by these data"
"""Mark of a clause with several candidates."""

LACKS = "the simulation lacks"
"""Beginning of a clause on a missing effect, once in a sentence."""

KEY_VALUES = (
    "internal_leakage_shift", "bulk_modulus_shift", "valve_gain_shift", "coulomb_shift", "viscous_shift", "mass_shift",
)  # fmt: skip
"""Effects whose smallest visible sizes are told in the sentence of a result without any error."""

CANDIDATES = 3
"""Maximum number of candidates in a sentence."""

HOPELESS = 1e6
"""Odds above which a rival is excluded, and the exact figure is not shown."""

STAGE_NAMES: Mapping[Stage, str] = {
    "force_balance": "force balance",
    "flow": "flow balance",
    "valve": "valve",
    "sensors": "sensor agreement",
}


class ChannelWords(NamedTuple):
    """Texts of a channel of the model's residuals.

    Attributes:
        short: its name in titles.
        residual: the compared quantities.
        measured: measured quantity, as labelled on the axis of its figure.
    """

    short: str
    residual: str
    measured: str


CHANNEL_WORDS: Mapping[Channel, ChannelWords] = {
    "spool": ChannelWords("spool", "spool, recorded minus simulated from the command", "spool"),
    "volume": ChannelWords("flow balance", "flow balance", "flow taken up"),
    "volume_a": ChannelWords("balance of chamber A", "flow balance of chamber A", "flow taken up by A"),
    "volume_b": ChannelWords("balance of chamber B", "flow balance of chamber B", "flow taken up by B"),
    "supply": ChannelWords("supply pressure", "supply pressure, recorded minus modelled", "supply pressure"),
    "force": ChannelWords("force balance", "force balance", "driving force"),
    "cell": ChannelWords("load cell", "load cell minus piston area times load pressure", "force"),
    "velocity": ChannelWords("velocity sensor", "velocity sensor minus slope of the position", "velocity"),
}

SIDES: Mapping[Side, str] = {"a": " of chamber A", "b": " of chamber B", "both": " of both chambers"}
"""Chambers within a sentence, after a cause."""

COMPARED: Mapping[Stage, str] = {
    "force_balance": "force balance (3), with friction simulated along the recorded motion",
    "flow": "volume balance (1), (2), or those of both chambers, of recorded spool, pressure and motion; supply pressure",
    "valve": "spool (4) simulated from the recorded command, compared with the recorded spool",
    "sensors": "two sensors of the same quantity, compared with each other",
}


def words(name: str) -> Words:
    """Return the terms used for an effect in the report."""
    return EFFECTS.load(name).WORDS


def noun_of(cause: Cause) -> str:
    """Return the term for a cause within a sentence, with the chamber that it acts on."""
    return words(cause.name).noun + ("" if cause.side is None else SIDES[cause.side])


def meaning(name: str) -> str:
    """Return the definition of an effect: the first paragraph of its file's docstring."""
    text = (EFFECTS.load(name).__doc__ or "").strip().split("\n\n", maxsplit=1)[0]
    return " ".join(text.split())


def parameter_meaning(effect: str, parameter: str) -> str:
    """Return the description of a parameter from its declaration."""
    declared = _declared(effect, parameter)
    return "" if declared is None else declared.description


def _declared(effect: str, parameter: str) -> Declaration | None:
    """Return the declaration of an effect's parameter; None if it has no such parameter."""
    return next((d for d in declarations(EFFECTS.load(effect).Parameters) if d.name == parameter), None)


def is_in_range(size: Sensitivity) -> bool:
    """Return whether an effect's parameter can have its smallest detectable size."""
    declared = _declared(size.name, size.parameter)
    if declared is None:
        return False
    bounds = declared.minimum, declared.maximum
    return any(bound is None or size.smallest <= abs(bound - float(declared.default)) for bound in bounds)


def parameters_text(effect: str, parameters: Mapping[str, Estimate], digits: int = 1, errors: float = 1.0) -> str:
    """Write the parameters of an effect for use within a sentence, with a multiple of their standard errors."""
    return ", ".join(
        f"{name.replace('_', ' ')} {fitted(effect, name, e._replace(std=errors * e.std), digits)}"
        for name, e in parameters.items()
    )


def sized(effect: str, parameters: Mapping[str, Estimate], since: str = RIG_FILE) -> str:
    """Write the size of an effect for use within a sentence, with the half width of its 95 % interval.

    Args:
        effect: its name.
        parameters: its fitted parameters.
        since: state to which a changed value is compared.
    """
    if not parameters:
        return ""
    loaded = EFFECTS.load(effect)
    every = [d for d in declarations(loaded.Parameters) if d.name not in getattr(loaded, "FIXED", ())]
    if not words(effect).lacking and len(every) == len(parameters) == 1:
        [declared], [e] = every, parameters.values()
        neutral = float(declared.default)
        inside = e.value not in (declared.minimum, declared.maximum)
        if math.isfinite(e.std) and inside and (neutral == 0.0 or (neutral == 1.0 and e.unit == "1")):
            away, half = abs(e.value - neutral), NORMAL_95 * e.std
            text = estimate(Estimate(away, half, e.unit), 1)
            if neutral == 1.0:
                text = estimate(Estimate(100.0 * away, 100.0 * half, "1"), 1) + " %"
            return f"{text} {'higher' if e.value > neutral else 'lower'} than {since} (95 %)"
    return f"{parameters_text(effect, parameters, 1, NORMAL_95)} (95 %)"


def fitted(effect: str, parameter: str, e: Estimate, digits: int = 2) -> str:
    """Write a fitted parameter with its standard error, or a note that it is not determined or at the end of its range.

    Args:
        effect: name of the effect.
        parameter: name of the parameter.
        e: its estimate.
        digits: significant digits of the standard error.
    """
    declared = _declared(effect, parameter)
    low, high = (None, None) if declared is None else (declared.minimum, declared.maximum)
    width = math.inf if low is None or high is None else high - low
    if not (math.isfinite(e.std) and e.std < width):
        return f"{value(e.value, e.unit)}, not determined"
    if e.value in (low, high) and declared is not None and e.value not in (0.0, declared.default):
        return f"{value(e.value, e.unit)}, the end of its range"
    return estimate(e, digits)


# --- the verdict -------------------------------------------------------------------------------


def verdict_sentence(found: Diagnosis) -> tuple[str, bool | None]:
    """Summarise a diagnosis without baselines.

    Args:
        found: the diagnosis.

    Returns:
        A sentence, and whether the simulation is right; None if the data are insufficient.
    """
    if found.verdict in NAMING:
        return sentence_of([claims(found, FITTED_RIG if found.corrected else RIG_FILE), *rest_of(found)]), False
    if found.verdict == "unknown":
        return _unknown_sentence(found), False
    if found.verdict == "consistent":
        return _consistent_sentence(found), True
    missing = listed([STAGE_NAMES[stage] for stage, result in found.stages.items() if not result.judged])
    return f"The data are insufficient to assess the simulation: {missing} cannot be evaluated.", None


def sentence_of(clauses: Sequence[str]) -> str:
    """Join clauses to a sentence."""
    text = "; ".join(clauses)
    return f"{text[:1].upper()}{text[1:]}."


def claims(found: Diagnosis, since: str = RIG_FILE) -> str:
    """Return a clause that names the causes with their sizes, at most two; it leaves open candidates open.

    Args:
        found: a diagnosis that names causes.
        since: state to which changed values are compared.
    """
    probable = [cause for cause in found.causes if cause.probability >= LIKELY] or list(found.causes[:1])
    texts = [_claim(found, cause, since) for cause in probable[:IN_A_SENTENCE]]
    both = f"{LACKS} "
    texts = [text.removeprefix(both) if i and texts[0].startswith(both) else text for i, text in enumerate(texts)]
    more = len(probable) - len(texts)
    if more:
        texts.append(f"{'another cause adds' if more == 1 else f'{more} more causes add'} to the error")
    if any(UNDECIDED in text for text in texts):
        return "; ".join(texts)
    return ", and ".join([", ".join(texts[:-1]), texts[-1]] if len(texts) > 2 else texts)


def _claim(found: Diagnosis, cause: Cause, since: str) -> str:
    """Return a clause for one cause, or for the candidates if the data do not decide between them."""
    noun, size, where = noun_of(cause), sized(cause.name, cause.parameters, since), STAGE_NAMES[CHANNELS[cause.channel]]
    rivals = [rival for rival in cause.rivals if _is_open(cause, rival)]
    untried = [name for name in cause.equivalent_to if name not in {rival.name for rival in rivals}]
    candidates = [(0.0, _with(noun, size))]
    candidates += [(r.behind, _with(words(r.name).noun, sized(r.name, r.parameters, since))) for r in rivals]
    candidates += [(math.inf, words(name).noun) for name in untried]
    if len(candidates) > 1:
        # A rival that explains more, and was not named for another reason, is more probable nevertheless.
        texts = [text for _, text in sorted(candidates, key=lambda candidate: candidate[0])]
        return f"the error in the {where} has one of these causes, {UNDECIDED}: {', or '.join(texts[:CANDIDATES])}"
    how_sure = "" if cause.probability >= CERTAIN_PROBABILITY else f", with a probability of {likely(cause.probability)}"
    if cause.probability < LIKELY:
        return f"the cause of the error in the {where} is uncertain: nearest is {_with(noun, size)}{how_sure}"
    return f"{_stated(found, cause, size, since)}{how_sure}"


def _is_open(cause: Cause, rival: Rival) -> bool:
    unsure = cause.probability < LIKELY and rival.behind < OPEN_CANDIDATE
    return unsure or rival.name in cause.equivalent_to


def _stated(found: Diagnosis, cause: Cause, size: str, since: str) -> str:
    noun, at = noun_of(cause), f": {size}" if size else ""
    if spring_in_force(found.rig, cause):
        return f"the recorded force contains no force of the spring: {noun} is {size}"
    if words(cause.name).lacking:
        return f"{LACKS} {noun}{at}" if since in (RIG_FILE, FITTED_RIG) else f"{noun} has appeared{at}"
    return f"{noun} is {size}" if " than " in size else f"{noun} differs from that {since}{at}"


def _with(noun: str, size: str) -> str:
    return f"{noun} ({size.removesuffix(' (95 %)')})" if size else noun


def rest_of(found: Diagnosis) -> list[str]:
    """Return a clause on the error that remains with the causes in the model; none without a gain."""
    if found.verdict == "partial":
        closed = "a part" if found.gain is None else _most(found.gain.closed_fraction)
        unlikely = [cause for cause in found.causes if cause.probability < LIKELY]
        less = f"less likely: {_in_short(unlikely)}" if 0 < len(unlikely) < len(found.causes) else ""
        return [f"this explains {closed} of the error", *([less] if less else []), rest(found)]
    wrong_before = [(stage, result) for stage, result in found.stages.items() if result.judged and result.exceeds]
    if found.gain is None or not wrong_before:
        return []
    balances = listed([f"the {STAGE_NAMES[stage]}" for stage, _ in wrong_before])
    if all(at_noise(result) for _, result in wrong_before):
        return [f"the rest of {balances} is within the noise"]
    return [f"this removes {_most(found.gain.closed_fraction)} of the error beyond the noise from {balances}"]


def _most(closed: float) -> str:
    """Write the closed fraction of an error, never as all of it."""
    return "more than 99.9 %" if closed >= ALMOST else percent(closed)


def _in_short(causes: Sequence[Cause]) -> str:
    """List causes by name within a sentence, at most two of them."""
    names = [noun_of(cause) for cause in causes[:IN_A_SENTENCE]]
    more = len(causes) - len(names)
    return listed([*names, *([f"{more} more" if more > 1 else "one more"] if more else [])])


def rest(found: Diagnosis) -> str:
    """Return a clause on the unexplained error: its stage, size, and the signals on which it depends."""
    stage = found.unknown_stage
    if stage is None:
        return f"the rest {depends(found)}, and no known effect explains it"
    result = found.stages[stage]
    size = (
        f", {number(result.nrmse_after / result.noise_floor, 2)} times the noise,"
        if result.noise_floor and result.nrmse_after is not None and not at_noise(result)
        else ""
    )
    return f"the rest in the {STAGE_NAMES[stage]}{size} {depends(found)}, and no known effect explains it"


def depends(found: Diagnosis) -> str:
    """Return a clause on the signals on which an unexplained error depends."""
    signals = (
        listed([quantity(s) for s in found.depends_on[:IN_A_SENTENCE]]) if found.depends_on else "no recorded signal alone"
    )
    return f"depends on {signals}"


def _unknown_sentence(found: Diagnosis) -> str:
    if found.unknown_stage is None:
        return "The simulation is wrong, and no known effect explains how."
    result = found.stages[found.unknown_stage]
    where = STAGE_NAMES[found.unknown_stage]
    if found.term is not None:
        return f"The simulation's {where} is wrong by {_size(result)}, and no known effect explains it."
    text = f"The simulation's {where} is wrong by {_size(result)}; the error {depends(found)}, and no known effect explains it"
    nearest = f"; nearest is {listed([words(name).noun for name in found.partial[:IN_A_SENTENCE]])}" if found.partial else ""
    near = concentrated(found, found.unknown_stage)
    sentences = [f"{text}{nearest}", *([f"Half of its square lies in {near}"] if near else [])]
    for stage, other in found.stages.items():
        if other.unexplained and stage != found.unknown_stage:
            near = concentrated(found, stage)
            place = f"; half of its square lies in {near}" if near else ""
            sentences.append(f"The {STAGE_NAMES[stage]} has an unexplained error, too: {_size(other)}{place}")
    return " ".join(f"{sentence}." for sentence in sentences)


def concentrated(found: Diagnosis, stage: Stage) -> str:
    """Return the short time, at one end of a signal's range, that holds half of a stage's squared error; empty if none does."""
    traces = [trace for channel, trace in found.traces.items() if CHANNELS[channel] == stage]
    ends = []
    for trace in traces:
        power = trace.after**2
        for signal in found.stages[stage].depends_on:
            if signal in trace.against and signal in SIGNALS:
                rising = np.argsort(trace.against[signal])
                for side, order in (("below", rising), ("above", rising[::-1])):
                    last = int(np.searchsorted(np.cumsum(power[order]), 0.5 * np.sum(power)))
                    ends.append(((last + 1) / len(power), side, signal, float(trace.against[signal][order[last]])))
    share, side, signal, bound = min(ends, default=(1.0, "", "", 0.0))
    if share > SHORT_TIME:
        return ""
    return f"the {percent(share)} of the time with {quantity(signal)} {side} {value(bound, SIGNALS[signal].unit)}"


def _consistent_sentence(found: Diagnosis) -> str:
    judged = [(stage, result) for stage, result in found.stages.items() if result.judged]
    quiet = [STAGE_NAMES[stage] for stage, result in judged if at_noise(result)]
    small = [
        f"no significant error in {STAGE_NAMES[stage]} ({_size(result)})" for stage, result in judged if not at_noise(result)
    ]
    parts = [f"only noise remains in {listed(quiet)}", *small] if quiet else small
    text = f"The simulation agrees with this recording: {listed(parts)}"
    rest = [STAGE_NAMES[stage] for stage, result in found.stages.items() if not result.judged]
    return (f"{text}; the data are insufficient to assess {listed(rest)}." if rest else f"{text}.") + visible(found)


def corrected(found: Diagnosis) -> str:
    """Return a sentence on the rig file's wrong numbers, which were corrected first; empty without any."""
    if not found.corrected:
        return ""
    pairs = [(p.partition(".")[2], w.fitted, value(w.given, w.fitted.unit)) for p, w in found.corrected.items()]
    numbers = ", ".join(f"{name} {estimate(right, 1)} instead of {wrong}" for name, right, wrong in pairs)
    return f" The recordings contradict these numbers of the rig file, which were corrected first: {numbers}."


def visible(found: Diagnosis) -> str:
    """Return a sentence with the sizes from which wrong values of coefficients would have shown; empty if none would."""
    sizes = []
    for name in KEY_VALUES:
        shown = [s for s in found.sensitivities if s.name == name and is_in_range(s)]
        smallest = min(shown, key=lambda s: s.smallest, default=None)
        if smallest is not None:
            sizes.append(f"{words(name).noun} {change(smallest.smallest, smallest.unit)}")
    wrong = "a wrong value" if found.baseline is None else "a change"
    return f" In nine of ten recordings like this, {wrong} shows from these sizes on: {', '.join(sizes)}." if sizes else ""


def at_noise(result: StageResult) -> bool:
    """Return whether only noise remains in a stage with all named causes in the model."""
    return (result.nrmse_after or 0.0) <= AT_NOISE * (result.noise_floor or 0.0)


def _size(result: StageResult) -> str:
    return f"{percent(result.nrmse_before)} of its largest term, noise {percent(result.noise_floor)}"


def noise_meaning(found: Diagnosis) -> str:
    """Return the definition of noise in all figures, tables and sentences of the page."""
    spread = ", and the natural spread that the baselines show" if found.baseline is not None else ""
    return (
        "Noise, everywhere on this page, is the largest deviation of a right model: by the effect of the sensors' noise on the"
        " balance, estimated from the scatter from sample to sample, by motion between samples, and by"
        f" {100.0 * TOLERANCE:g} % of the largest term, the accuracy no model exceeds{spread}. Tables and sentences give its"
        " rms, figures ±2 times its value, which should hold 95 % of the residual. A signal that really moves as fast as it is"
        " sampled counts as noisy: then the residual stays well below."
    )


def gain_sentence(found: Diagnosis) -> str:
    """Return a sentence with the error closed by the causes on held-out data; empty without causes."""
    gain = found.gain
    if gain is None:
        return ""
    low, high = gain.ci95
    return (
        f"On held-out data the residual of the {STAGE_NAMES[CHANNELS[gain.channel]]} falls from"
        f" {percent(gain.heldout_nrmse_before)} to {percent(gain.heldout_nrmse_after)} of its largest term, noise"
        f" {percent(gain.noise_floor)}; {percent(gain.closed_fraction)} of the mean square beyond the noise is closed"
        f" (95 % interval {percent(low)} to {percent(high)})."
    )


def check_sentences(checks: Mapping[str, Mapping[Channel, ChannelGain]]) -> tuple[str, ...]:
    """Return a sentence for each recording to which nothing was fitted, with the part of its error that is closed."""
    out = []
    for name, gains in checks.items():
        closes = [f"{percent(g.closed)} in the {STAGE_NAMES[CHANNELS[c]]}" for c, g in gains.items() if g.closed > 0.0]
        spoils = [STAGE_NAMES[CHANNELS[c]] for c, g in gains.items() if g.closed <= 0.0]
        said = [f"the extended model closes {listed(closes)}"] if closes else []
        said += [f"it is worse than the given one in the {listed(spoils)}"] if spoils else []
        out.append(f"On {name}, to which nothing was fitted, {', and '.join(said) or 'there is no error to close'}.")
    return tuple(out)


# --- parts of the page -------------------------------------------------------------------------


def odds(rival: Rival) -> str:
    """Write the odds for a cause against a rival on held-out data, as a lower bound if very large."""
    if rival.behind > math.log(HOPELESS):
        return f">\u202f{number(int(HOPELESS))}\u202f:\u202f1"
    return f"{number(math.exp(max(rival.behind, 0.0)), 2)}\u202f:\u202f1"


def runner_up_sentences(found: Diagnosis) -> list[str]:
    """Return, for each cause, the next best effect in its place and the effects indistinguishable from it."""
    out = []
    for cause in found.causes:
        noun, text = words(cause.name).noun, ""
        runner = next((rival for rival in cause.rivals if rival.name not in cause.equivalent_to), None)
        if runner is not None:
            text = (
                f"The runner-up to {noun} is {words(runner.name).noun}: it {why_lost(cause, runner)}, and the odds against it"
                f" are {odds(runner)} on held-out data."
            )
        if cause.equivalent_to:
            names = listed([words(name).noun for name in cause.equivalent_to])
            text = f"{text} These data cannot distinguish {noun} from {names}.".lstrip()
        out += [text] if text else []
    return out


def why_lost(cause: Cause, rival: Rival) -> str:
    """Return the reason why another effect was not named instead of a cause."""
    if rival.name in cause.equivalent_to:
        return "cannot be distinguished from it with these data"
    if rival.closed_fraction < 0.0:
        return "makes the error larger"
    if rival.closed_fraction < 0.995:
        return f"leaves {number(100.0 * (1.0 - rival.closed_fraction), 2)} % of the error beyond the noise"
    return "closes nearly as much, but the held-out data prefer the cause"


def left_over(result: StageResult) -> str:
    """Return a short description of a stage's remainder."""
    if not result.judged:
        return "not evaluated"
    if result.unexplained:
        return "an error remains that no effect explains"
    if result.exceeds:
        return "wrong in the given model, explained by the extension"
    text = "only noise" if at_noise(result) else "no significant error"
    if result.incident is not None:
        return f"{text}, except between {result.incident[0]:.1f} and {result.incident[1]:.1f} s"
    return text


def caveats(found: Diagnosis, remarks: Sequence[str] = ()) -> list[str]:
    """Return the limits of the conclusions, a sentence or two each."""
    out = []
    for stage, result in found.stages.items():
        if not found.names_causes or not result.judged or result.nrmse_after is None or not result.noise_floor:
            continue
        ratio = result.nrmse_after / result.noise_floor
        if result.exceeds and not at_noise(result):
            out.append(
                f"In the {STAGE_NAMES[stage]} {number(ratio, 2)} times the noise remains. "
                + (
                    "A correct cause usually leaves less: the true cause may be an effect outside the list. The probability"
                    " allows for this."
                    if result.leaves_much
                    else "The cause is essentially right, but its form in the model may differ from the rig's: take its"
                    " parameters as the best fit of that form."
                )
            )
    if found.verdict == "partial":
        out.append(
            "What remains was counted as noise when probabilities and standard errors were found. The causes may stand for an"
            " effect outside the list, so none is held for certain."
        )
    if found.names_causes:
        out.append(
            "The diagnosis rests on one recording, and so do the standard errors: another day, temperature or load may give"
            " other values. Repeat the recording before you replace the rig file by the extended one."
        )
        stages = [cause.stage for cause in found.causes]
        if len(set(stages)) < len(stages):
            out.append(
                "Two causes in one stage may stand for a single effect outside the list, which two effects of the list can"
                " imitate. Their probabilities allow for this; a recording of different motions would settle it."
            )
        if any(cause.fixed for cause in found.causes):
            out.append("Parameters that were not fitted have the values that their form prescribes in the extended rig file.")
    if found.verdict == "consistent":
        proves = "no proof that the model is right" if found.baseline is None else "no proof that nothing has changed"
        out.append(
            f"Agreement is {proves}: effects smaller than the sizes under 'Sensitivity', or in motions that this recording does"
            " not contain, would not have been seen."
        )
    return [*out, *(f"{capital(remark)}." for remark in (*found.remarks, *remarks))]


def capital(text: str) -> str:
    """Capitalise a sentence and drop its full stop; the name of a signal is not changed."""
    text = text.rstrip(".")
    return text if text[:1].isupper() or "_" in text.split(" ", maxsplit=1)[0] else text[:1].upper() + text[1:]


_ALWAYS = "in any case"
_INSPECT: Mapping[Stage, Mapping[str, str]] = {
    "force_balance": {
        "velocity_m_s": "friction over velocity: identify it again (`ehls identify`), or try another friction model",
        "acceleration_m_s2": "inertia: a second body, or a mass that moves over a fraction of the stroke only",
        "position_m": "geometry: springs, stops, guides, the lever between cylinder and load",
        "load_pressure_pa": "the characteristics of the pressure sensors, and the pressure on the seals",
        "disturbance_force_n": "how the disturbance reaches the piston: its sensor, lever and crosstalk",
        "oil_temperature_k": "warming oil and seals, and sensor zeros that move with them",
        "time_s": "drift: a sensor's zero, the temperature, a mounting that works loose",
        _ALWAYS: "forces missing from the balance, and elements with memory: creeping springs, stick patches, free play",
    },
    "flow": {
        "spool_m": "the valve's flow curve: lands, notches, flow forces",
        "valve_command_m": "the valve's flow curve: lands, notches, flow forces",
        "load_pressure_pa": "leakages and relief valves, and the pressure drop in lines and fittings",
        "load_pressure_rate_pa_s": "compliance under pressure: hoses, air, an accumulator",
        "velocity_m_s": "pressure drops between valve and cylinder, leakage past moving seals",
        "supply_pressure_pa": "the supply: pump control, accumulator, other consumers",
        _ALWAYS: "elements with memory: hoses that swell, accumulators, air that comes and goes",
    },
    "valve": {
        "valve_command_m": "the valve's static curve from command to spool, and its amplifier",
        "spool_m": "the stroke: where the spool sticks, or its sensor is not linear",
        "velocity_m_s": "flow forces on the spool",
        "load_pressure_pa": "flow forces on the spool",
        "time_s": "drift: the null, the temperature of the pilot stage",
        _ALWAYS: "elements with memory: a spool that sticks, a rate limit; hum on the command",
    },
    "sensors": {
        "load_pressure_pa": "the characteristics of load cell and pressure sensors",
        "position_m": "the position sensor's scale along the stroke",
        "oil_temperature_k": "zeros that move with the temperature",
        "time_s": "drifting zeros, and samples that freeze",
        _ALWAYS: "samples that freeze, missing codes of a converter, cables",
    },
}
"""Parts of the rig to inspect for an unknown error of a stage, by the signal on which it depends."""


def next_steps(found: Diagnosis) -> list[str]:
    """Return the next steps if no cause, or not all of the error, is known, a sentence each."""
    if found.verdict in ("unknown", "partial") and found.unknown_stage is not None:
        stage = STAGE_NAMES[found.unknown_stage]
        return [
            f"Record another motion, faster or larger: an error of the model of the {stage} changes with it.",
            f"Check the rig file's values for the {stage} against data sheets and drawings, or fit them by `ehls identify`.",
            "Inspect the rig at the places below, to which the signals point.",
            "If you find an effect that is not on the list, write it as one file (how-to: a new effect) and diagnose again.",
        ]
    if found.verdict == "insufficient" and not any(lacks_signals(found, stage) for stage in found.stages):
        return [
            "The signals are there, but they move too little: record them with the motion below.",
            "Best is a minute at 1 kHz: slow and fast, small and large motions both ways, the load changing.",
        ]
    if found.verdict == "insufficient":
        return [
            "Record the signals below together, with the motion that each stage needs.",
            "Best are all signals at 1 kHz for a minute: slow and fast, small and large motions both ways, the load changing.",
            "`ehls columns FILE` shows which of a file's columns were understood.",
        ]
    return []


def lacks_signals(found: Diagnosis, stage: Stage) -> bool:
    """Return whether a stage cannot be judged for missing signals, not for too little motion."""
    result = found.stages[stage]
    return not result.judged and result.why_not != NEEDED_MOTION[stage]


def where_to_look(found: Diagnosis) -> list[tuple[str, str]]:
    """Return the parts of the rig to inspect for an unknown cause, each with the signal that points to it, strongest first."""
    places = {} if found.unknown_stage is None else _INSPECT[found.unknown_stage]
    pointed = [(quantity(signal), places[signal]) for signal in found.depends_on if signal in places]
    return [*pointed, (_ALWAYS, places[_ALWAYS])] if places else []


def before_name(found: Diagnosis) -> str:
    """Return the name of the model without the causes."""
    return "given model" if found.baseline is None else "no change assumed"


def after_name(found: Diagnosis) -> str:
    """Return the name of the model with the causes."""
    extended = "extended model" if found.baseline is None else "with the change"
    part = "with effects that explain a part" if found.term is None else "with the term found"
    return f"{extended if found.causes else part}, held-out data"


def compares(found: Diagnosis) -> bool:
    """Return whether there is a second model to compare with the given one."""
    return bool(found.causes or found.partial or found.term)


def largest_first(found: Diagnosis) -> list[Channel]:
    """Return the channels in order of decreasing residual."""

    def changed(channel: Channel) -> float:
        trace = found.traces[channel]
        floor = np.maximum(trace.floor, 1e-300)
        return -float(np.mean((trace.before / floor) ** 2))

    return sorted(found.traces, key=changed)
