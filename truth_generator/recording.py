"""Record one experiment on the rig, as its data acquisition would store it (`record`)."""

import csv
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from . import kernel, single_rod
from .effects import Effect, Sizes, effects_of, hang, is_single, listed_of, wander
from .experiments import TICK, Plan, planned
from .forms import Day, FormErrors
from .other_forms import OTHER_FORMS

CHANNELS = {
    "position_m": kernel.POSITION,
    "velocity_m_s": kernel.VELOCITY,
    "load_pressure_pa": kernel.PRESSURE,
    "spool_m": kernel.SPOOL,
    "supply_pressure_pa": kernel.SUPPLY,
    "force_n": kernel.FORCE,
    "oil_temperature_k": kernel.TEMPERATURE,
    "pressure_a_pa": kernel.PRESSURE_A,
    "pressure_b_pa": kernel.PRESSURE_B,
}
# Noise and resolution: those of the paper, and those chosen in config/rig_paper_measured.yaml.
SENSORS = {
    "position_m": (2.0e-6, 5.0e-6),
    "velocity_m_s": (1.0e-4, 0.0),
    "load_pressure_pa": (1.0e3, 1.2e3),
    "spool_m": (1.0e-6, 1.0e-6),
    "supply_pressure_pa": (1.0e3, 1.2e3),
    "force_n": (2.0, 4.0),
    "oil_temperature_k": (0.05, 0.0),
    "pressure_a_pa": (1.0e3, 1.2e3),
    "pressure_b_pa": (1.0e3, 1.2e3),
}
RIG_SENSORS = {
    "position_m": "position", "velocity_m_s": "velocity", "load_pressure_pa": "load_pressure", "spool_m": "spool_position",
    "supply_pressure_pa": "supply_pressure", "force_n": "force", "oil_temperature_k": "oil_temperature",
    "pressure_a_pa": "pressure_a", "pressure_b_pa": "pressure_b",
}  # fmt: skip
COLUMNS = (
    "valve_command_m", "spool_m", "load_pressure_pa", "supply_pressure_pa", "position_m", "velocity_m_s", "force_n",
    "disturbance_force_n", "oil_temperature_k",
)  # fmt: skip
SERVO_COLUMNS = ("disturbance_displacement_m", "disturbance_velocity_m_s")


class IntegrationStopped(RuntimeError):
    """The rig cannot be integrated: an effect or a form error exceeds the physical limits of a rig."""


@dataclass
class Recording:
    """Samples by the data contract's column names, with the ground truth.

    truth: effects (their sizes), forms (kinds and sizes of the rig's form errors, by stage), natural (the effects' sizes for
    comparison with estimates; none for another form), stages (their groups), appears_in (the stage whose residual shows
    them), outside, near, experiment, seed, rate, noise, duration, degraded.
    states: the kernel's state at every sample, if requested.
    """

    time: np.ndarray
    columns: dict[str, np.ndarray]
    truth: dict[str, Any]
    states: np.ndarray | None = None

    def write_csv(self, path: str | Path) -> None:
        """Write the samples with a header row; NaN is left empty."""
        table = [self.time, *self.columns.values()]
        with Path(path).open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(["time_s", *self.columns])
            texts = [["" if value != value else f"{value:.10g}" for value in column.tolist()] for column in table]  # noqa: PLR0124
            writer.writerows(zip(*texts, strict=True))


def nominal_sizes(rig: Mapping[str, Any]) -> np.ndarray:
    """Return the kernel's record for a rig file without hidden effects.

    Raises:
        ValueError: the rig file uses a feature that this generator does not support.
    """
    p = np.zeros(1, kernel.DTYPE)
    for name, value in kernel.FIELDS.items():
        p[name] = value
    plant, friction = rig["plant"], rig["friction"]
    for field, key in {
        "supply": "supply_pressure", "density": "oil_density", "bulk": "bulk_modulus", "discharge": "discharge_coefficient",
        "gradient": "valve_area_gradient", "leakage": "leakage_coefficient", "mass": "moving_mass",
        "spring": "spring_stiffness", "damping": "viscous_damping", "valve_rate": "valve_bandwidth",
        "valve_gain": "valve_gain", "gravity": "gravity",
    }.items():  # fmt: skip
        p[field] = plant[key]
    if is_single(rig):
        single_rod.put_nominal(p, rig)
    else:
        p["area"], p["volume"] = plant["piston_area"], plant["total_volume"]
    for field, key in {
        "fc": "coulomb_force", "fs": "static_force", "vs": "stribeck_velocity", "exponent": "stribeck_exponent",
        "viscous": "viscous_coefficient",
    }.items():  # fmt: skip
        p[field] = friction[key]
    stiffness = np.asarray(friction["element_stiffness"], float)
    if friction["model"] == "gms":
        n = stiffness.size
        if n > kernel.N_ELEMENTS:
            raise ValueError(f"{n} friction elements: at most {kernel.N_ELEMENTS} fit")
        p["model"], p["n_elements"], p["attraction"] = kernel.GMS, n, friction["attraction_rate"]
        p["stiffness"][0, :n] = stiffness
        p["weight"][0, :n] = friction["element_weight"]
    elif friction["model"] == "lugre":
        p["model"], p["n_elements"] = kernel.LUGRE, 1
        p["stiffness"][0, 0] = stiffness.sum()
    else:
        raise ValueError(f"friction model {friction['model']!r}: the truth has gms and lugre")
    if rig.get("effects"):
        raise ValueError("the rig file has effects: the truth starts from a nominal rig and adds the hidden effects")
    limits = rig.get("limits", {})
    p["spool_limit"] = limits.get("spool", 1.0e-2)
    p["nominal_supply"], p["nominal_area"], p["nominal_bulk"] = p["supply"], p["area"], p["bulk"]
    p["flow_gain"] = p["valve_gain"] * p["discharge"] * p["gradient"] / np.sqrt(p["density"])
    return p


def sensor(rig: Mapping[str, Any], column: str) -> tuple[float, float]:
    """Return noise and resolution of a sensor, from the rig file if given there, otherwise from `SENSORS`.

    Raises:
        ValueError: the rig file has a sensor fault; only hidden effects may add sensor faults.
    """
    key = RIG_SENSORS[column]
    given = rig.get("sensors", {}).get(key)
    if given is None:
        return SENSORS[column]
    if faults := {name for name in ("bias", "bandwidth", "delay") if given.get(name)}:
        raise ValueError(f"sensors: {key}: {sorted(faults)} is not among the parameters of a nominal sensor")
    return given.get("noise_std", 0.0), given.get("resolution", 0.0)


def effect_of(rig: Mapping[str, Any], name: str, given: Sizes) -> tuple[Effect, Sizes]:
    """Return an effect of a rig by the formula named in its sizes, if any, with neutral values for omitted sizes.

    Raises:
        KeyError: unknown effect or formula.
        ValueError: unknown size.
    """
    if "form" in given:
        return OTHER_FORMS[name][given["form"]], given
    effect = effects_of(rig)[name]
    if unknown := set(given) - set(effect.neutral) - {"site", "signals", "phase"}:
        raise ValueError(f"{name}: no size {sorted(unknown)}; there are {sorted(effect.neutral)}")
    return effect, effect.neutral | given


def appears_in(rig: Mapping[str, Any], name: str, sizes: Sizes) -> str:
    """Return the stage whose residual shows an effect."""
    return "flow" if sizes.get("site") == "ports" else effect_of(rig, name, sizes)[0].stage


def _grown(rig: Mapping[str, Any], healthy: np.ndarray, effects: Mapping[str, Sizes]) -> np.ndarray:
    """Return the kernel's record of a healthy rig with effects added."""
    p = healthy.copy()
    for name, given in effects.items():
        effect, sizes = effect_of(rig, name, given)
        effect.apply(p[0], sizes)
    return p


def start(p: np.ndarray, plan: Plan, rig: Mapping[str, Any]) -> np.ndarray:
    """Return the initial state: at rest, with the nominal load in equilibrium."""
    y = np.zeros(kernel.N_BASE + int(p["n_elements"]))
    plant = rig["plant"]
    x = plan.x0
    force = plant["spring_stiffness"] * x + plant["moving_mass"] * plant["gravity"] + plan.disturbance[0]
    y[[kernel.X, kernel.XB, kernel.ZS]] = x
    y[[kernel.PL, kernel.ZH, kernel.PM]] = force / p["area"]
    if is_single(rig):
        y[[kernel.PA, kernel.PB]] = single_rod.resting(rig, force)
    y[kernel.PS] = plant["supply_pressure"]
    y[kernel.QM] = p["mount"] * p["mount_pressure"] * math.asinh(y[kernel.PL] / p["mount_pressure"])
    if p["load_on_second"] != 0.0 and p["second_stiffness"] > 0.0:
        y[kernel.X] += force / p["second_stiffness"] + math.copysign(0.5 * p["gap"], force)
    elif p["two_body"] != 0.0:
        y[kernel.XB] -= p["second_share"] * p["mass"] * plant["gravity"] / p["second_stiffness"]
    return y


def record(
    rig: Mapping[str, Any],
    effects: Mapping[str, Sizes],
    experiment: str,
    *,
    seed: int,
    duration: float = 60.0,
    rate: float = 1000.0,
    noise: float = 1.0,
    columns: Iterable[str] | None = None,
    hold: bool = False,
    internals: bool = False,
    forms: FormErrors | None = None,
    day: Day | None = None,
    disturbed: bool = True,
    growth: Sequence[tuple[float, Mapping[str, Sizes]]] = (),
) -> Recording:
    """Run an experiment on a rig with hidden effects.

    Args:
        rig: content of the rig file.
        effects: sizes by effect name, as `draw_effect` and `draw_other_form` return them; omitted sizes are neutral.
        experiment: name in `EXPERIMENTS`, or several in sequence, joined by `+` as for `planned`.
        seed: seed of the experiment, the noise and random effects; noise and experiment do not depend on the effects.
        duration: duration, s.
        rate: sampling rate of the recording, 1/s; the control always runs at 1 kHz.
        noise: multiple of the sensors' noise and resolution; 0 for perfect sensors.
        columns: names to record; by default those of the data contract, and the servo's columns if the servo moves the beam.
        hold: keep the disturbance constant over a control cycle, as in the simulator, instead of linear between samples as on
            a rig.
        internals: whether to keep the kernel's states.
        forms: form errors of the rig; without them it matches the rig file's model.
        day: condition of the healthy rig; the rig file's by default.
        disturbed: whether a disturbance force acts; without it, the same motion requires another force.
        growth: later sizes of the effects, each with its start time, s, in ascending order; no random effects.

    Raises:
        KeyError: unknown experiment or effect.
        ValueError: unknown size or column, or an unsupported rig file.
        IntegrationStopped: the integration failed.
    """
    rig = dict(rig)
    seeds = np.random.SeedSequence(seed).spawn(4)
    chance, noise_of, plan_of, noise_of_chambers = (np.random.default_rng(s) for s in seeds)
    n_ticks = max(round(duration / TICK), 1)
    ticks = TICK * np.arange(n_ticks + 1)
    plan = planned(experiment, plan_of, ticks, rig)
    if not disturbed:
        plan.force, plan.disturbance = plan.force - plan.disturbance, np.zeros(n_ticks + 1)

    p = nominal_sizes(rig)
    zero, held = np.zeros(n_ticks + 1), np.zeros(n_ticks + 1, np.int64)
    truth: dict[str, Any] = {name: {} for name in ("effects", "forms", "natural", "stages", "appears_in", "near")}
    truth["outside"] = []
    p["warming"], p["warming_time"] = chance.uniform(-0.3, 0.3), 30.0
    if forms is not None:
        forms.apply(p[0])
        truth["forms"] = {stage: {"kinds": list(forms.kinds[stage]), "size": size} for stage, size in forms.sizes.items()}
    if day is not None:
        day.apply(p[0])
    healthy = p.copy()
    if {"hinge_backlash", "flexible_mode"} <= set(effects):
        raise ValueError("hinge_backlash and flexible_mode: there is one second body, not two")
    for name, given in effects.items():
        effect, sizes = effect_of(rig, name, given)
        effect.apply(p[0], sizes)
        if name == "pressure_zero_wander":
            zero += wander(sizes, np.random.default_rng([seed, 1]), n_ticks + 1, TICK)
        elif name == "held_dropouts":
            held |= hang(sizes, np.random.default_rng([seed, 2]), n_ticks + 1, TICK)
        truth["effects"][name] = dict(sizes)
        truth["natural"] |= {} if "form" in sizes else {name: effect.natural(sizes, rig)}
        truth["stages"][name] = effect.stage
        truth["appears_in"][name] = appears_in(rig, name, sizes)
        truth["near"][name] = list(effect.near)
        if name not in listed_of(rig):
            truth["outside"].append(name)
    rigs = np.concatenate([p, *(_grown(rig, healthy, sizes) for _, sizes in growth)])
    begins = np.array([0, *(round(time / TICK) for time, _ in growth)], np.int64)
    rigs["w_force"], rigs["w_position"] = plan.w_force, plan.w_position
    for name, channel in CHANNELS.items():
        rigs["noise_std"][:, channel], rigs["resolution"][:, channel] = (noise * value for value in sensor(rig, name))

    n = math.floor(n_ticks * TICK * rate + 1e-6)
    at = np.arange(n) / rate
    same = math.isclose(rate * TICK, 1.0)

    def drawn(rows: int) -> np.ndarray:
        # Two streams, so that a seed gives a double rod the noise that it had before there were chambers.
        return np.hstack([of.standard_normal((rows, k)) for of, k in ((noise_of, kernel.PRESSURE_A), (noise_of_chambers, 2))])

    control_noise = drawn(n_ticks)
    sample_noise = control_noise if same else drawn(n)
    signals = np.empty((n, kernel.N_CHANNELS))
    command, disturbance, displacement = np.empty(n), np.empty(n), np.empty(n)
    y = start(p[0], plan, rig)
    states = np.empty((n if internals else 0, y.size))
    done = kernel.simulate(
        rigs, begins, y, np.zeros(kernel.N_ELEMENTS, np.int64), TICK,
        plan.force, plan.position, plan.speed, plan.disturbance, plan.servo, hold, control_noise, zero, held,
        at, sample_noise, same, signals, command, disturbance, displacement, states,
    )  # fmt: skip
    if done < n_ticks:
        raise IntegrationStopped(
            f"{experiment} with {dict(effects)}: integration stopped after {done * TICK:.3f} s of {duration} s"
        )

    everything = {name: np.ascontiguousarray(signals[:, channel]) for name, channel in CHANNELS.items()}
    everything["valve_command_m"], everything["disturbance_force_n"] = command, disturbance
    coupled = "coupling_stiffness" in effects or plan.servo_recorded
    everything["disturbance_displacement_m"] = displacement if coupled else np.zeros(n)
    servo_speed = np.interp(at, ticks, np.gradient(plan.servo, TICK)) if coupled else np.zeros(n)
    everything["disturbance_velocity_m_s"] = servo_speed
    usual = single_rod.COLUMNS if is_single(rig) else COLUMNS
    chosen = list(columns) if columns is not None else [*usual, *(SERVO_COLUMNS if coupled else ())]
    if unknown := set(chosen) - set(everything):
        raise ValueError(f"no columns {sorted(unknown)}; there are {sorted(everything)}")
    truth |= {"experiment": experiment, "seed": seed, "rate": rate, "noise": noise, "duration": duration, "degraded": []}
    return Recording(at, {name: everything[name] for name in chosen}, truth, states if internals else None)
