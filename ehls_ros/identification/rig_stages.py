"""Starting point for the fit of a whole rig: each stage's coefficients from its residuals, robust to a poor first guess."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ehls_ros.diagnosis.record import COMMAND, FORCE, PRESSURE, SPOOL, SUPPLY, VELOCITY, Record
from ehls_ros.diagnosis.stages import VOLUMES, Channel
from ehls_ros.identification.rig_coefficients import (
    COULOMB,
    DEAD_ZONE,
    DELAY,
    DROOP,
    EDGE_GAINS,
    HOSES,
    HYSTERESIS,
    LEAKAGES,
    LOAD,
    OVERLAPS,
    ROUNDINGS,
    SECOND_ORDER,
    SENSORS,
    STIFFNESS,
    TANK,
    TYPICAL_LAG,
    VISCOUS,
    Coefficient,
    Sizes,
    acting,
    placed,
    read,
    without,
)
from ehls_ros.identification.rig_coefficients import SUPPLY as OF_SUPPLY
from ehls_ros.identification.rig_fit import RigFit, Stack, fit
from ehls_ros.identification.rig_identifiability import OVERLAP, estimated
from ehls_ros.physics.rig import Rig

BANDWIDTH, GAIN, NULL = "plant.valve_bandwidth", "plant.valve_gain", "effects.valve_null_bias.command"
VALVE = (BANDWIDTH, GAIN, NULL)
FURTHER = (HYSTERESIS, SECOND_ORDER, (DELAY,))
"""Effects between command and spool that are included if they are significant."""

ALL_OF_VALVE = (*VALVE, *(path for group in FURTHER for path in group))
"""All coefficients that the spool depends on."""

SUPPLY_PRESSURE, DISCHARGE = "plant.supply_pressure", "plant.discharge_coefficient"
FLOW = (
    SUPPLY_PRESSURE,
    DISCHARGE,
    "plant.leakage_coefficient",
    "plant.bulk_modulus",
    "effects.valve_null_bias.opening",
)
IN_CHAMBERS = (
    *EDGE_GAINS,
    "plant.leakage_coefficient",
    "plant.bulk_modulus",
    *LEAKAGES,
    SUPPLY_PRESSURE,
    *OVERLAPS,
    *HOSES,
    TANK,
    *ROUNDINGS,
    *OF_SUPPLY,
)
"""Coefficients of the flow of two chambers, those that determine most of it first."""

SIMPLEST = 6
"""Number of them from which the others are fitted."""

BEAM = ("plant.moving_mass", "plant.spring_stiffness", LOAD, VISCOUS)
STRIBECK_VELOCITY = "friction.stribeck_velocity"

SHARP = (COULOMB, VISCOUS, STIFFNESS)
"""Coefficients of friction in which the loss has a single minimum."""

OF_VALVE: tuple[Channel, ...] = ("spool",)
OF_FLOW: tuple[Channel, ...] = (*VOLUMES, "supply")
OF_BALANCE: tuple[Channel, ...] = ("force",)
"""Residual channels of the stages."""

OF_SENSORS: tuple[Channel, ...] = ("cell", "velocity")
"""Residuals of two sensors of one quantity, which need no model."""

NEEDED: Mapping[Channel, str] = {
    "spool": "the valve command and the spool, sampled fast enough for the valve",
    "volume": "load pressure or load cell, spool or command, and the motion",
    "volume_a": "two of the chambers' pressures and the load cell, spool or command, and the position",
    "force": "load pressure or load cell, and the position in motion, with its turns resolved",
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

DELAYS = (0.03, 0.4)
"""Delays of the command from which the valve is fitted, as fractions of its whole lag."""

PLAY = 0.01
"""Width of a hysteresis from which the valve is fitted, as a fraction of a large spool displacement."""

ROUND = 0.5
"""Spread of a hysteresis's plays from which it is fitted."""

DAMPING = 0.7
"""Damping ratio of a valve of second order from which it is fitted."""

DROOPED = 0.3
"""Droop of the supply from which the flow is fitted, in its coordinate."""

STRIBECK_FACTORS = (1.0, 0.4, 2.5)
"""Factors on the given Stribeck velocity from which friction is fitted."""

STIFFNESS_FACTORS = (0.5, 2.0)
"""The same on the given stiffness of the elements: from half of it, a fit of presliding may end far from the truth."""

NEEDED_GAIN = 60.0
"""Least decrease of the loss for which a dead zone or a delay is accepted [nats]."""

MIN_SIGMAS = 4.0
"""Standard errors by which an optional coefficient must differ from its neutral value to be included."""

KEPT_GAIN = 0.5 * OVERLAP * MIN_SIGMAS**2
"""Least gain for which one of several effects of the valve is kept [nats]; without it, the others take its share."""

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
    groups = by_channel(known)
    out = {
        path: f"it requires {NEEDED[channel]}"
        for channel, paths in groups.items()
        if channel not in stack.channels
        for path in paths
    }
    if set(VOLUMES) & set(stack.channels) and not any(SPOOL in r for r in records):
        # The spool is simulated, so its dynamics are identified from the flow.
        for path in groups["spool"]:
            del out[path]
        chambers = "volume" not in stack.channels
        gain, null = (EDGE_GAINS[0], OVERLAPS[0]) if chambers else FLOW[1::3]
        out[GAIN] = f"without a recorded spool, only its product with {gain} is known"
        out[NULL] = f"without a recorded spool, it acts like {null}"
    return out


def by_channel(known: Collection[str]) -> dict[Channel, list[str]]:
    """Return the coefficients that the residuals of a stage or of two sensors depend on, by the first of their channels."""
    balance: Channel = "volume_a" if EDGE_GAINS[0] in known else "volume"
    groups: Mapping[Channel, Sequence[str]] = {
        "spool": ALL_OF_VALVE,
        balance: tuple(dict.fromkeys((*FLOW, *DEAD_ZONE, *DROOP, *IN_CHAMBERS))),
        "force": (*BEAM, *(p for p in known if p.startswith("friction.") and p not in BEAM)),
        "cell": SENSORS[:2],
        "velocity": SENSORS[2:],
    }
    return {channel: [path for path in paths if path in known] for channel, paths in groups.items()}


class Block(NamedTuple):
    """Coefficients that no other residuals depend on.

    Attributes:
        paths: the coefficients.
        channels: the residuals that depend on them.
    """

    paths: Sequence[str]
    channels: tuple[Channel, ...]


def blocks(stack: Stack, known: Collection[str]) -> list[Block]:
    """Return the independent blocks of coefficients, without those of the sensors.

    Each stage takes its inputs from the recording and has coefficients of its own; but where the spool was not recorded, it is
    simulated, and valve and flow are one block.
    """
    paths = by_channel(known)
    balances = [path for channel in VOLUMES for path in paths.get(channel, ())]
    valve, flow = Block(paths["spool"], OF_VALVE), Block(balances, OF_FLOW)
    if any(set(VOLUMES) & set(e.channels) and SPOOL not in e.record for e in stack.evidences):
        flow, valve = Block([*valve.paths, *flow.paths], (*OF_VALVE, *OF_FLOW)), Block((), ())
    return [block for block in (valve, flow, Block(paths["force"], OF_BALANCE)) if set(block.channels) & set(stack.channels)]


class Start(NamedTuple):
    """Starting point of the fits with standard errors.

    Attributes:
        rig: the rig.
        spread: by path, spread of the coordinates among equally good fits, as a standard error.
    """

    rig: Rig
    spread: Mapping[str, float]


def stage_by_stage(stack: Stack, rig: Rig, free: Mapping[str, Coefficient], records: Sequence[Record]) -> Start:
    """Fit valve, flow and force balance one after the other, each to the residuals of its stage.

    The effects of :data:`~ehls_ros.identification.rig_coefficients.OPTIONAL` are included if they are significant.

    Args:
        stack: the recordings.
        rig: the first guess.
        free: the coefficients to fit, by path.
        records: the recordings.

    Returns:
        The starting point of the fits with standard errors.
    """
    if "spool" in stack.channels:
        rig = _valve(stack.only(OF_VALVE), rig, free)
    if set(VOLUMES) & set(stack.channels):
        rig = _flow(stack.only((*OF_VALVE, *OF_FLOW)), rig, free, records)
    return _force(stack.only(OF_BALANCE), rig, free) if "force" in stack.channels else Start(rig, {})


def _valve(stack: Stack, rig: Rig, free: Mapping[str, Coefficient]) -> Rig:
    basic = fit(stack, rig, [free[path] for path in VALVE if path in free], OF_VALVE)
    return _with_further(stack, basic, free, OF_VALVE).rig


def _with_further(stack: Stack, basic: RigFit, free: Mapping[str, Coefficient], channels: Collection[Channel]) -> RigFit:
    """Fit further effects of the valve as well: add the one that gains most, as often as one does, then leave out the others.

    Together from the start, an effect that is absent but has a least size would keep the others from their values.
    """
    groups = [group for group in FURTHER if set(group) <= set(free)]
    best, used = basic, list[Sequence[str]]()
    while left := [group for group in groups if group not in used]:
        trials = [_added(stack, basic, best, free, group, channels) for group in left]
        gaining = min(trials, key=lambda trial: trial.comparable)
        if best.comparable - gaining.comparable < KEPT_GAIN:
            break
        best, used = gaining, [group for group in groups if set(group) <= set(gaining.paths)]
    for group in used:
        others = [other for other in used if other != group]
        if group == (DELAY,) and SECOND_ORDER in used:
            # Left out, an insignificant delay would give a wrong natural frequency for certain.
            continue
        # A neutral effect has the same compiled model as one that acts.
        other = fit(stack, without(best.rig, group), _chosen(basic, free, others), channels)
        # A large gain counts whatever the standard errors, which are large where effects can replace each other.
        if other.comparable - best.comparable > NEEDED_GAIN:
            continue
        needed = SECOND_ORDER if group == SECOND_ORDER else group[:1]
        if not _is_better(stack, other, best, [needed], KEPT_GAIN):
            best, used = other, others
    return replace(best, rig=acting(best.rig))


def _added(
    stack: Stack,
    basic: RigFit,
    best: RigFit,
    free: Mapping[str, Coefficient],
    group: Sequence[str],
    channels: Collection[Channel],
) -> RigFit:
    """Return the fit with one more effect than the best one so far; the second order brings the delay with it."""
    added = {*group, *((DELAY,) if group == SECOND_ORDER else ())} - set(best.paths)
    lag = 1.0 / read(basic.rig, BANDWIDTH)
    starts = []
    for part in DELAYS if group != HYSTERESIS else DELAYS[:1]:
        # Of the same lag in all; 2 ζ / ωn is that of the second order.
        values = {DELAY: part * lag, HYSTERESIS[0]: PLAY * free[HYSTERESIS[0]].scale, HYSTERESIS[1]: ROUND}
        values |= {SECOND_ORDER[0]: 2.0 * DAMPING / ((1.0 - part) * lag), SECOND_ORDER[1]: DAMPING}
        of_first_order = {BANDWIDTH: 1.0 / ((1.0 - part) * lag)} if group == (DELAY,) else {}
        starts.append(placed(best.rig, {**{path: values[path] for path in added}, **of_first_order}))
    together = [other for other in FURTHER if set(other) <= {*best.paths, *added}]
    return _best(stack, starts, _chosen(basic, free, together), channels)


def _chosen(basic: RigFit, free: Mapping[str, Coefficient], groups: Sequence[Sequence[str]]) -> list[Coefficient]:
    """Return the coefficients of a fit with further effects of the valve."""
    return effective([*basic.chosen, *(free[path] for group in groups for path in group)])


def effective(chosen: Sequence[Coefficient]) -> list[Coefficient]:
    """Return coefficients without the bandwidth if the valve is of second order, whose response does not depend on it."""
    second = any(c.path == SECOND_ORDER[0] for c in chosen)
    return [c for c in chosen if not (second and c.path == BANDWIDTH)]


def _flow(stack: Stack, rig: Rig, free: Mapping[str, Coefficient], records: Sequence[Record]) -> Rig:
    chambers = "volume" not in stack.channels
    paths = IN_CHAMBERS if chambers else FLOW
    chosen = [free[path] for path in (*paths, *(() if "spool" in stack.channels else (BANDWIDTH,))) if path in free]
    simple = chosen[:SIMPLEST] if chambers else chosen
    linear = [c for c in simple if c.path not in (SUPPLY_PRESSURE, BANDWIDTH)]
    recorded = [float(np.median(r.signals[SUPPLY])) for r in records if SUPPLY in r]
    pressure = _large(records, PRESSURE) or _large(records, FORCE) / rig.plant.piston_area
    given = [max(rig.plant.supply_pressure * factor, ABOVE_LOAD * pressure) for factor in SUPPLY_FACTORS]
    starts = [placed(rig, {SUPPLY_PRESSURE: start}) for start in recorded[:1] or sorted(set(given))]
    if SUPPLY_PRESSURE in free:
        rig = min((fit(stack, start, linear, VOLUMES, TRIED) for start in starts), key=lambda f: f.comparable).rig
    best = fit(stack, rig, chosen, OF_FLOW)
    if set(DROOP) <= set(free):
        drooping = [*chosen, *(free[path] for path in DROOP)]
        starts = [placed(best.rig, {DROOP[0]: DROOPED * free[DROOP[0]].scale, DROOP[1]: TYPICAL_LAG})]
        best = _better(stack, best, _best(stack, starts, drooping, OF_FLOW), [DROOP[:1]])
    if set(DEAD_ZONE) <= set(free):
        spool = free[DEAD_ZONE[0]].scale
        laps = [placed(best.rig, dict.fromkeys(DEAD_ZONE, lap * spool)) for lap in LAPS]
        lapped = [*best.chosen, *(free[path] for path in DEAD_ZONE)]
        best = _better(stack, best, _best(stack, laps, lapped, OF_FLOW), [[path] for path in DEAD_ZONE])
    if "spool" not in stack.channels:
        best = _with_further(stack, best, free, OF_FLOW)
    return best.rig


def _force(stack: Stack, rig: Rig, free: Mapping[str, Coefficient]) -> Start:
    rig = fit(stack, rig, [free[path] for path in (*BEAM, COULOMB) if path in free], OF_BALANCE).rig
    friction = [path for path in free if path.startswith("friction.") and path not in BEAM]
    starts = [rig]
    if STRIBECK_VELOCITY in free:
        velocity = read(rig, STRIBECK_VELOCITY)
        starts = [placed(rig, {STRIBECK_VELOCITY: factor * velocity}) for factor in STRIBECK_FACTORS]
    if STIFFNESS in free:
        starts += [placed(rig, {STIFFNESS: factor * read(rig, STIFFNESS)}) for factor in STIFFNESS_FACTORS]
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


def _better(stack: Stack, basic: RigFit, other: RigFit, needed: Sequence[Sequence[str]]) -> RigFit:
    """Return the fit with additional coefficients if it is better, else the basic one."""
    return other if _is_better(stack, basic, other, needed) else basic


def _is_better(
    stack: Stack, basic: RigFit, other: RigFit, needed: Sequence[Sequence[str]], least_gain: float = NEEDED_GAIN
) -> bool:
    """Return whether additional coefficients gain enough and are significant: all of one of the needed groups."""
    found = estimated(stack, other).by_path
    significant = any(all(found[path].value > MIN_SIGMAS * found[path].std for path in group) for group in needed)
    return significant and basic.comparable - other.comparable > least_gain
