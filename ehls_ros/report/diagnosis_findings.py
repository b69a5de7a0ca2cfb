"""What a diagnosis says, in words."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from ehls_ros.diagnosis.result import Cause, Diagnosis, Rival, Sensitivity, StageResult
from ehls_ros.diagnosis.stage_results import NEEDED_MOTION, NEEDED_SIGNALS
from ehls_ros.diagnosis.stages import Channel, Stage
from ehls_ros.estimate import Estimate
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.report.diagnosis_units import change, estimate, part, quantity
from ehls_ros.report.page import listed, number
from ehls_ros.schema import declarations

CLOSED = 1.2
"""What is left, in that of noise, up to which a balance is said to close to the noise."""

SURE = 0.95
"""Probability from which on a cause is named without a probably."""

HOPELESS = 1000.0
"""Nats from which on it does not matter how many."""

LEAKY = 1.5
"""What is left, in that of noise, from which on the form of the model is said to differ."""

STAGE_NAMES: Mapping[Stage, str] = {
    "force_balance": "force balance",
    "flow": "flow balance",
    "valve": "valve",
    "sensors": "agreement of the sensors",
}

CHANNEL_NAMES: Mapping[Channel, str] = {
    "spool": "spool, recorded less simulated from the command",
    "volume": "flow balance",
    "supply": "supply pressure, recorded less modelled",
    "force": "force balance",
    "cell": "load cell less load pressure",
    "velocity": "velocity sensor less slope of the position",
}

CHANNEL_SHORT: Mapping[Channel, str] = {
    "spool": "spool",
    "volume": "flow balance",
    "supply": "supply pressure",
    "force": "force balance",
    "cell": "load cell",
    "velocity": "velocity sensor",
}

COMPARED: Mapping[Stage, str] = {
    "force_balance": "the balance (3) with friction run along the recorded motion",
    "flow": "the volume balance (1), (2) of recorded spool, pressure and motion; the supply pressure",
    "valve": "the spool (4) simulated from the recorded command against the recorded one",
    "sensors": "two sensors of one quantity against each other",
}


class Words(NamedTuple):
    """How an effect is called in a sentence.

    Attributes:
        noun: a phrase.
        lacking: the simulation has nothing of it; else it has it, but wrong.
    """

    noun: str
    lacking: bool = True


_WORDS: Mapping[str, Words] = {
    "valve_dead_zone": Words("a dead zone of the valve"),
    "valve_null_bias": Words("a shift of the valve's null"),
    "valve_gain_asymmetry": Words("a valve gain that differs between the sides"),
    "valve_gain_shift": Words("the gain of the valve", lacking=False),
    "valve_saturation": Words("a limit of the valve's opening"),
    "valve_bandwidth_shift": Words("the bandwidth of the valve", lacking=False),
    "valve_second_order": Words("the spool's second-order dynamics"),
    "valve_hysteresis": Words("a hysteresis of the valve"),
    "command_delay": Words("a delay of the command"),
    "supply_pressure_droop": Words("a supply pressure that gives way under flow"),
    "bulk_modulus_shift": Words("the bulk modulus of the oil", lacking=False),
    "entrained_air": Words("air in the oil"),
    "internal_leakage_shift": Words("the leakage past the piston", lacking=False),
    "turbulent_leakage": Words("a leakage through an orifice"),
    "external_leakage": Words("a leakage to the outside"),
    "coulomb_shift": Words("the Coulomb friction", lacking=False),
    "coulomb_asymmetry": Words("a Coulomb friction that differs between the directions"),
    "viscous_shift": Words("the viscous friction", lacking=False),
    "viscous_asymmetry": Words("a viscous friction that differs between the directions"),
    "stribeck_shift": Words("the Stribeck curve", lacking=False),
    "presliding_stiffness_shift": Words("the presliding stiffness", lacking=False),
    "pressure_dependent_friction": Words("a friction that grows with the pressure"),
    "position_dependent_friction": Words("a friction that changes along the stroke"),
    "temperature_dependent_friction": Words("a friction that changes with the oil's temperature"),
    "mass_shift": Words("the moving mass", lacking=False),
    "spring_rate_shift": Words("the stiffness of the spring", lacking=False),
    "spring_hardening": Words("a spring that hardens"),
    "hinge_backlash": Words("a play in the hinge"),
    "end_stop": Words("an end stop inside the stroke"),
    "flexible_mode": Words("a flexible mode of the load"),
    "pressure_sensor_bias": Words("the zero of the load pressure sensor", lacking=False),
    "pressure_sensor_gain": Words("the gain of the load pressure sensor", lacking=False),
    "pressure_sensor_lag": Words("a lag of the load pressure sensor"),
    "position_sensor_bias": Words("the zero of the position sensor", lacking=False),
    "position_sensor_gain": Words("the gain of the position sensor", lacking=False),
    "sensor_delay": Words("a delay of a sensor"),
    "periodic_disturbance": Words("a periodic force"),
    "constant_load": Words("a constant force"),
    "coupling_stiffness": Words("the elastic coupling to the position servo"),
}


def words(name: str) -> Words:
    """Return how an effect is called; a new one by its own name."""
    return _WORDS.get(name, Words(f"the effect '{name.replace('_', ' ')}'"))


def meaning(name: str) -> str:
    """Return what an effect is, the first sentence of its file."""
    text = (EFFECTS.load(name).__doc__ or "").strip().split("\n\n", maxsplit=1)[0]
    return " ".join(text.split())


def parameter_meaning(effect: str, parameter: str) -> str:
    """Return what a parameter is, from its declaration."""
    return next((d.description for d in declarations(EFFECTS.load(effect).Parameters) if d.name == parameter), "")


def parameters_text(parameters: Mapping[str, Estimate], digits: int = 1) -> str:
    """Write the parameters of a cause as a sentence has them."""
    return ", ".join(f"{name.replace('_', ' ')} {estimate(e, digits)}" for name, e in parameters.items())


# --- the verdict -------------------------------------------------------------------------------


def verdict_sentence(found: Diagnosis) -> tuple[str, bool | None]:
    """Sum a diagnosis up.

    Args:
        found: the diagnosis.

    Returns:
        One or two sentences, and whether all is well; None where it cannot be told.
    """
    if found.verdict == "effect":
        return _effect_sentence(found), False
    if found.verdict == "unknown":
        return _unknown_sentence(found), False
    if found.verdict == "consistent":
        return _consistent_sentence(found), True
    missing = listed([STAGE_NAMES[stage] for stage, result in found.stages.items() if not result.judged])
    return f"These data do not tell whether the simulation is right: they say nothing of {missing}.", None


def _effect_sentence(found: Diagnosis) -> str:
    lacks = [_named(cause) for cause in found.causes if words(cause.name).lacking]
    wrong = [_named(cause) for cause in found.causes if not words(cause.name).lacking]
    said = [*([f"lacks {listed(lacks)}"] if lacks else []), *([f"has {listed(wrong)} wrong"] if wrong else [])]
    sure = min(cause.probability for cause in found.causes) >= SURE
    text = f"The simulation {'' if sure else 'probably '}{' and '.join(said)}"
    for cause in found.causes:
        if cause.equivalent_to:
            others = " or ".join(words(name).noun for name in cause.equivalent_to)
            text += f"; these data explain it as well by {others}"
    wrong_before = [(stage, result) for stage, result in found.stages.items() if result.judged and result.exceeds]
    if found.gain is None or not wrong_before:
        return f"{text}."
    with_it = "with it" if len(found.causes) == 1 else "with them"
    balances = listed([f"the {STAGE_NAMES[stage]}" for stage, _ in wrong_before])
    if all((result.nrmse_after or 0.0) <= CLOSED * (result.noise_floor or 0.0) for _, result in wrong_before):
        return f"{text}; {with_it} {balances} close{'s' if len(wrong_before) == 1 else ''} to the noise."
    closed = part(found.gain.closed_fraction)
    return f"{text}; {with_it} {closed} of the error that noise does not explain is gone from {balances}."


def _named(cause: Cause) -> str:
    noun = words(cause.name).noun
    return f"{noun} ({parameters_text(cause.parameters)})" if cause.parameters else noun


def _unknown_sentence(found: Diagnosis) -> str:
    stage = found.unknown_stage
    result = None if stage is None else found.stages[stage]
    text = "The simulation is wrong in a way that no effect it knows explains"
    if stage is None or result is None:
        return f"{text}."
    text = f"In the {STAGE_NAMES[stage]} the simulation is wrong in a way that no effect it knows explains"
    if result.nrmse_after is not None and result.noise_floor:
        text += f": {part(result.nrmse_after)} is left, where noise makes {part(result.noise_floor)}"
    text += f". It depends on {listed([quantity(s) for s in found.depends_on])}" if found.depends_on else _on_none()
    if found.partial:
        text += f"; part of it looks like {listed([words(name).noun for name in found.partial])}"
    return f"{text}."


def _on_none() -> str:
    return ". It depends on none of the recorded signals alone"


def _consistent_sentence(found: Diagnosis) -> str:
    judged = [STAGE_NAMES[stage] for stage, result in found.stages.items() if result.judged]
    text = f"The simulation agrees with this recording: in {listed(judged)} nothing is left but noise"
    rest = [STAGE_NAMES[stage] for stage, result in found.stages.items() if not result.judged]
    return f"{text}; of {listed(rest)} the data tell nothing." if rest else f"{text}."


# --- parts of the page -------------------------------------------------------------------------


def behind(rival: Rival) -> str:
    """Write by how much a rival explains less; what is hopeless by its order only."""
    return f"more than {number(int(HOPELESS))}" if rival.behind > HOPELESS else number(max(rival.behind, 0.0), 2)


def why_lost(cause: Cause, rival: Rival) -> str:
    """Say why another effect was not named in a cause's place."""
    if rival.name in cause.equivalent_to:
        return "cannot be told from it with these data"
    if rival.closed_fraction < 0.0:
        return "in its place makes the error larger"
    if rival.closed_fraction < 0.995:
        return f"leaves {number(100.0 * (1.0 - rival.closed_fraction), 2)} % of the error that noise does not explain"
    return "closes nearly as much, but held-out data prefer the cause"


def left_over(result: StageResult) -> str:
    """Say in a word how a stage does."""
    if not result.judged:
        return "not judged"
    if result.unexplained:
        return "something is left that no effect explains"
    if result.exceeds:
        return "wrong before, explained now"
    if result.incident is not None:
        return f"nothing but noise, except between {result.incident[0]:.1f} and {result.incident[1]:.1f} s"
    return "nothing but noise"


def caveats(found: Diagnosis, remarks: Sequence[str] = ()) -> list[str]:
    """Return what has to be kept in mind."""
    out = []
    for stage, result in found.stages.items():
        if found.verdict != "effect" or not result.judged or result.nrmse_after is None or not result.noise_floor:
            continue
        ratio = result.nrmse_after / result.noise_floor
        if result.exceeds and ratio > LEAKY:
            out.append(
                f"In the {STAGE_NAMES[stage]} {number(ratio, 2)} times the noise is left. "
                + (
                    "That is more than a right cause leaves as a rule: it may be an effect that the list does not have, which"
                    " lowers the probability here."
                    if result.leaves_much
                    else "The cause is right in the main; the form the model gives it may differ from the rig's, so take its"
                    " parameters as the best of that form."
                )
            )
    if found.verdict == "effect":
        out.append(
            "All of this rests on one recording. Standard errors hold for it; another day, another temperature or another load"
            " may give other values. Repeat the recording before the extended rig file replaces the old one."
        )
        stages = [cause.stage for cause in found.causes]
        if len(set(stages)) < len(stages):
            out.append(
                "Two causes in one stage may also be one of a kind that the list of effects does not have: it then looks"
                " like two that it has. That lowers their probability here; a recording of other motions tells."
            )
        if any(cause.fixed for cause in found.causes):
            out.append("Parameters that were not fitted stand in the extended rig file at the values their form has for them.")
    if found.verdict == "consistent":
        out.append(
            "That nothing shows does not mean that nothing is wrong: it means that nothing larger than the sizes in"
            " 'What would have been noticed' acts in what this recording does."
        )
    return [*out, *(f"{_capital(remark)}." for remark in (*found.remarks, *remarks))]


def _capital(text: str) -> str:
    text = text.rstrip(".")
    return text if text[:1].isupper() or "_" in text.split(" ", maxsplit=1)[0] else text[:1].upper() + text[1:]


_LOOK: Mapping[tuple[Stage, str], str] = {
    (
        "force_balance",
        "velocity_m_s",
    ): "friction over velocity: identify it anew (`ehls identify`) or try another friction model",
    ("force_balance", "acceleration_m_s2"): "inertia: a second body, or a mass that moves with part of the stroke only",
    ("force_balance", "position_m"): "the geometry: springs, stops, guides, the lever between cylinder and load",
    ("force_balance", "load_pressure_pa"): "the pressure sensors' curve, and what presses on the seals",
    ("force_balance", "disturbance_force_n"): "how the disturbance reaches the piston: its sensor, lever and crosstalk",
    ("force_balance", "oil_temperature_k"): "what warms up: oil, seals, the sensors' zeros",
    ("force_balance", "time_s"): "what drifts: a sensor's zero, the temperature, a mounting that works loose",
    ("flow", "spool_m"): "the valve's flow curve: lands, notches, flow forces",
    ("flow", "valve_command_m"): "the valve's flow curve: lands, notches, flow forces",
    ("flow", "load_pressure_pa"): "leakages and relief valves, and the pressure drop in lines and fittings",
    ("flow", "load_pressure_rate_pa_s"): "what gives way under pressure: hoses, air, an accumulator",
    ("flow", "velocity_m_s"): "pressure drops between valve and cylinder, leakage past moving seals",
    ("flow", "supply_pressure_pa"): "the supply: pump control, accumulator, other consumers",
    ("valve", "valve_command_m"): "the valve's static curve from command to spool, and its amplifier",
    ("valve", "spool_m"): "where along its stroke the spool sticks or its sensor bends",
    ("valve", "velocity_m_s"): "flow forces on the spool",
    ("valve", "load_pressure_pa"): "flow forces on the spool",
    ("valve", "time_s"): "what drifts: the null, the pilot stage's temperature",
    ("sensors", "load_pressure_pa"): "the curves of load cell and pressure sensors against each other",
    ("sensors", "position_m"): "the position sensor's scale along the stroke",
    ("sensors", "oil_temperature_k"): "zeros that move with the temperature",
    ("sensors", "time_s"): "zeros that drift, and samples that hang",
}
_LOOK_ANYHOW: Mapping[Stage, str] = {
    "force_balance": "forces that nobody counted, and what has a memory: creeping springs, stick patches, free play",
    "flow": "what has a memory: hoses that swell, accumulators, air that comes and goes",
    "valve": "what has a memory: a spool that sticks, a rate limit, hum on the command",
    "sensors": "samples that hang, converters that miss codes, cables",
}


def where_to_look(found: Diagnosis) -> list[tuple[str, str]]:
    """Return what at the rig to look at for an unknown cause, each with the signal that points there, strongest first."""
    stage = found.unknown_stage
    if stage is None:
        return []
    told = [(quantity(signal), _LOOK[stage, signal]) for signal in found.depends_on if (stage, signal) in _LOOK]
    return [*told, ("in any case", _LOOK_ANYHOW[stage])]


def to_record(found: Diagnosis) -> list[tuple[str, str, str]]:
    """Return what is missing of each stage that was not judged: stage, signals it needs, what the data have to do."""
    not_judged = [stage for stage, result in found.stages.items() if not result.judged]
    return [(STAGE_NAMES[stage], NEEDED_SIGNALS[stage], NEEDED_MOTION[stage]) for stage in not_judged]


def smallest_text(item: Sensitivity) -> str:
    """Write the smallest size of an effect that would have been noticed."""
    return change(item.smallest, item.unit)


def runner_up(cause: Cause) -> Rival | None:
    """Return the best effect in a cause's place that the data tell from it."""
    return next((rival for rival in cause.rivals if rival.name not in cause.equivalent_to), None)


def compares(found: Diagnosis) -> bool:
    """Tell whether there is another model beside the given one to be shown."""
    return bool(found.causes or found.partial)


def largest_first(found: Diagnosis) -> list[Channel]:
    """Return the channels, those that changed most first."""

    def changed(channel: Channel) -> float:
        trace = found.traces[channel]
        floor = np.maximum(trace.floor, 1e-300)
        return -float(np.mean((trace.before / floor) ** 2))

    return sorted(found.traces, key=changed)
