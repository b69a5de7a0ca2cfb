"""Starting point for the fit of a whole rig: each stage's coefficients from its residuals, robust to a poor first guess."""

from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from ehls_ros.diagnosis.record import COMMAND, FORCE, PRESSURE, SPOOL, SUPPLY, VELOCITY, Record
from ehls_ros.diagnosis.stages import Channel
from ehls_ros.identification.rig_coefficients import (
    COULOMB,
    DEAD_ZONE,
    DELAY,
    SENSORS,
    STIFFNESS,
    VISCOUS,
    Coefficient,
    Sizes,
    placed,
    read,
)
from ehls_ros.identification.rig_fit import RigFit, Stack, fit
from ehls_ros.identification.rig_identifiability import estimated
from ehls_ros.physics.rig import Rig

BANDWIDTH, GAIN, NULL = "plant.valve_bandwidth", "plant.valve_gain", "effects.valve_null_bias.command"
VALVE = (BANDWIDTH, GAIN, NULL)
SUPPLY_PRESSURE = "plant.supply_pressure"
FLOW = (
    SUPPLY_PRESSURE,
    "plant.discharge_coefficient",
    "plant.leakage_coefficient",
    "plant.bulk_modulus",
    "effects.valve_null_bias.opening",
)
BEAM = ("plant.moving_mass", "plant.spring_stiffness", "effects.constant_load.force", VISCOUS)
STRIBECK_VELOCITY = "friction.stribeck_velocity"

SHARP = (COULOMB, VISCOUS, STIFFNESS)
"""Coefficients of friction in which the loss has a single minimum."""

OF_VALVE: tuple[Channel, ...] = ("spool",)
OF_FLOW: tuple[Channel, ...] = ("volume", "supply")
OF_BALANCE: tuple[Channel, ...] = ("force",)
"""Residual channels of the stages."""

NEEDED: Mapping[Channel, str] = {
    "spool": "the valve command and the spool, sampled fast enough for the valve",
    "volume": "load pressure or load cell, spool or command, and the motion",
    "force": "load pressure or load cell, and the position, with its turns resolved",
    "cell": "load pressure and load cell",
    "velocity": "position and velocity",
}
"""Signals required for a residual."""

SUPPLY_FACTORS = (0.45, 0.6, 0.8, 1.0, 1.3, 1.7, 2.2)
"""Factors on the given supply pressure from which the flow is fitted, unless the supply pressure was recorded."""

ABOVE_LOAD = 1.02
"""Least supply pressure tried, as a multiple of a large load pressure."""

LAPS = (0.02, 0.1, 0.3)
"""Dead zones from which the flow is fitted, as fractions of a large spool displacement."""

DELAYS = (1e-3, 4e-3, 1.2e-2)
"""Delays of the command from which the valve is fitted [s]."""

STRIBECK_FACTORS = (1.0, 0.4, 2.5)
"""Factors on the given Stribeck velocity from which friction is fitted."""

NEEDED_GAIN = 60.0
"""Least decrease of the loss for which a dead zone or a delay is accepted [nats]."""

MIN_SIGMAS = 4.0
"""Standard errors by which an optional coefficient must differ from its neutral value to be included."""

LARGE = 0.98
"""Quantile of a signal's magnitude that counts as large."""

SMALL = 1e-3
"""Least fraction of the rig's limit that counts as large, also if a signal was not recorded."""

NEAR = 6e-3
"""Loss per residual by which equally good fits of friction from several starts may differ [nats].

A correct model lost 0.0005 to 0.006 against the fit in 10 recordings of the truth generator, 25 s each, since the friction
between two samples is not recorded.
"""

SEARCHED, TRIED = 8, 4
"""Maximum number of Gauss-Newton steps from one of several starts, for all coefficients and for a few."""


def sizes(records: Sequence[Record], rig: Rig) -> Sizes:
    """Return the magnitudes that count as large in some recordings.

    Args:
        records: the recordings.
        rig: the first guess.
    """
    limits = rig.limits
    spool = SPOOL if any(SPOOL in r for r in records) else COMMAND
    return Sizes(
        spool=max(_large(records, spool), SMALL * limits.spool),
        force=max(_large(records, FORCE), rig.plant.piston_area * _large(records, PRESSURE), SMALL * limits.force),
        velocity=max(_large(records, VELOCITY), SMALL * limits.velocity),
    )


def _large(records: Sequence[Record], signal: str) -> float:
    return max((float(np.quantile(np.abs(r.signals[signal]), LARGE)) for r in records if signal in r), default=0.0)


def without_signals(records: Sequence[Record], stack: Stack, known: Collection[str]) -> dict[str, str]:
    """Return the coefficients for which signals are missing, with the reason.

    Args:
        records: the recordings.
        stack: their residuals.
        known: the coefficients that can be fitted, by path.
    """
    friction = [path for path in known if path.startswith("friction.")]
    groups: Mapping[Channel, Sequence[str]] = {
        "spool": (*VALVE, DELAY),
        "volume": (*FLOW, *DEAD_ZONE),
        "force": (*BEAM, *friction),
        "cell": SENSORS[:2],
        "velocity": SENSORS[2:],
    }
    out = {
        path: f"it requires {NEEDED[channel]}"
        for channel, paths in groups.items()
        if channel not in stack.channels
        for path in paths
        if path in known
    }
    if "volume" in stack.channels and not any(SPOOL in r for r in records):
        # The spool is simulated, so the bandwidth is identified from the flow.
        del out[BANDWIDTH]
        out[GAIN] = "without a recorded spool, only its product with plant.discharge_coefficient is known"
        out[NULL] = "without a recorded spool, it acts like effects.valve_null_bias.opening"
    return out


class Start(NamedTuple):
    """Starting point of the joint fit.

    Attributes:
        rig: the rig.
        spread: by path, spread of the coordinates among equally good fits, as a standard error.
    """

    rig: Rig
    spread: Mapping[str, float]


def stage_by_stage(stack: Stack, rig: Rig, free: Mapping[str, Coefficient], records: Sequence[Record]) -> Start:
    """Fit valve, flow and force balance one after the other, each to the residuals of its stage.

    A dead zone and a delay of the command are included if they are significant.

    Args:
        stack: the recordings.
        rig: the first guess.
        free: the coefficients to fit, by path.
        records: the recordings.

    Returns:
        The starting point of the joint fit.
    """
    if "spool" in stack.channels:
        rig = _valve(stack, rig, free)
    if "volume" in stack.channels:
        rig = _flow(stack, rig, free, records)
    return _force(stack, rig, free) if "force" in stack.channels else Start(rig, {})


def _valve(stack: Stack, rig: Rig, free: Mapping[str, Coefficient]) -> Rig:
    chosen = [free[path] for path in VALVE if path in free]
    basic = fit(stack, rig, chosen, OF_VALVE)
    if DELAY not in free:
        return basic.rig
    starts = [placed(rig, {DELAY: delay}) for delay in DELAYS]
    return _better(stack, basic, _best(stack, starts, [*chosen, free[DELAY]], OF_VALVE), (DELAY,))


def _flow(stack: Stack, rig: Rig, free: Mapping[str, Coefficient], records: Sequence[Record]) -> Rig:
    chosen = [free[path] for path in (*FLOW, *(() if "spool" in stack.channels else (BANDWIDTH,))) if path in free]
    linear = [c for c in chosen if c.path not in (SUPPLY_PRESSURE, BANDWIDTH)]
    recorded = [float(np.median(r.signals[SUPPLY])) for r in records if SUPPLY in r]
    pressure = _large(records, PRESSURE) or _large(records, FORCE) / rig.plant.piston_area
    given = [max(rig.plant.supply_pressure * factor, ABOVE_LOAD * pressure) for factor in SUPPLY_FACTORS]
    starts = [placed(rig, {SUPPLY_PRESSURE: start}) for start in recorded[:1] or sorted(set(given))]
    if SUPPLY_PRESSURE in free:
        rig = min((fit(stack, start, linear, OF_FLOW[:1], TRIED) for start in starts), key=lambda f: f.comparable).rig
    basic = fit(stack, rig, chosen, OF_FLOW)
    if not set(DEAD_ZONE) <= set(free):
        return basic.rig
    spool = free[DEAD_ZONE[0]].scale
    laps = [placed(basic.rig, dict.fromkeys(DEAD_ZONE, lap * spool)) for lap in LAPS]
    return _better(stack, basic, _best(stack, laps, [*chosen, *(free[path] for path in DEAD_ZONE)], OF_FLOW), DEAD_ZONE)


def _force(stack: Stack, rig: Rig, free: Mapping[str, Coefficient]) -> Start:
    rig = fit(stack, rig, [free[path] for path in (*BEAM, COULOMB) if path in free], OF_BALANCE).rig
    friction = [path for path in free if path.startswith("friction.") and path not in BEAM]
    starts = [rig]
    if STRIBECK_VELOCITY in free:
        velocity = read(rig, STRIBECK_VELOCITY)
        starts = [placed(rig, {STRIBECK_VELOCITY: factor * velocity}) for factor in STRIBECK_FACTORS]
    chosen = [free[path] for path in (*BEAM, *friction) if path in free]
    trials = [fit(stack, start, chosen, OF_BALANCE, SEARCHED) for start in starts]
    best = min(trials, key=lambda f: f.comparable)
    near = [f for f in trials if f.comparable <= best.comparable + NEAR * len(best.e)]
    distances = np.max([np.abs(f.z - best.z) for f in near], axis=0)
    spread = {
        path: 0.5 * float(d) for path, d in zip(best.paths, distances, strict=True) if path in friction and path not in SHARP
    }
    return Start(best.rig, spread)


def _best(stack: Stack, starts: Sequence[Rig], chosen: Sequence[Coefficient], channels: Collection[Channel]) -> RigFit:
    trials = [fit(stack, start, chosen, channels, SEARCHED) for start in starts]
    return fit(stack, min(trials, key=lambda f: f.comparable).rig, chosen, channels)


def _better(stack: Stack, basic: RigFit, other: RigFit, more: Sequence[str]) -> Rig:
    """Return the rig with additional coefficients if they gain enough and one is significant, else the basic rig."""
    found = estimated(stack, other).by_path
    significant = any(found[path].value > MIN_SIGMAS * found[path].std for path in more)
    return other.rig if significant and basic.comparable - other.comparable > NEEDED_GAIN else basic.rig
