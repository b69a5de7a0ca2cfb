"""The model's parts run along a recording, every effect at its place, in compiled kernels.

The simulator compiles the effects that a rig has. Here all of them are compiled once, each behind a flag, so that
trying a hypothesis costs no compilation. A part is one relation of the model with the hooks that act in it:

==============  =============================================  ==========================================================
part            integrates                                     gives, a row a sample
==============  =============================================  ==========================================================
``spool``       the spool (4) from the command                 spool displacement [m]
``flow``        what the effects of the flow remember          load flow [m^3/s], leakage [m^3/s], bulk modulus [Pa],
                                                               supply pressure [Pa]
``friction``    the friction model's forces (6), (8)           friction force [N]
``force``       what the effects on the force remember         force beyond (3) [N]
``load``        the load's motion (3) and its friction, where  position [m] and velocity [m/s] of the load, friction
                an effect parts it from the piston             force and force beyond (3) on it [N]
==============  =============================================  ==========================================================

Position, velocity, load pressure and spool come from the recording, straight between two samples. A load parted from the
piston is not measured: it moves as what the piston hands on to it and its own balance have it.
"""

import hashlib
import inspect
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from ehls_ros.arrays import Array
from ehls_ros.physics.composition import kernel_module
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.rig import EffectUse

PARTS = {
    "spool": ("received", "command"),
    "flow": ("opening", "supply_pressure", "bulk_modulus", "leakage"),
    "friction": ("friction_level",),
    "force": ("force",),
    "load": ("friction_level", "force"),
}
"""The hooks that act in each part."""


class Motion(NamedTuple):
    """What the parts are run along, each of shape (n,): see :mod:`ehls_ros.physics.plant`."""

    time: Array
    position: Array
    velocity: Array
    pressure: Array
    spool: Array
    command: Array
    disturbance: Array
    servo_position: Array
    servo_velocity: Array
    temperature: Array


PARTS_LOAD = 2
"""Flag of an effect by which the load is parted from the piston."""


class Switched(NamedTuple):
    """Effects as a part's kernel takes them: a flag for each (0, 1, or :data:`PARTS_LOAD`), the parameters of all in a row."""

    on: NDArray[np.int8]
    parameters: Array


@cache
def effects_of(part: str) -> tuple[str, ...]:
    """Return the names of the effects that act in a part through a hook."""
    return tuple(n for n in EFFECTS.names() if any(hasattr(EFFECTS.load(n), hook) for hook in PARTS[part]))


@cache
def _neutral(part: str) -> tuple[float, ...]:
    return tuple(float(value) for name in effects_of(part) for value in EFFECTS.load(name).Parameters())


def switched(part: str, effects: Sequence[EffectUse]) -> Switched:
    """Lay out the effects in use for a part's kernel; of an effect used twice, the last one counts."""
    names = effects_of(part)
    on, parameters = np.zeros(len(names), dtype=np.int8), np.array(_neutral(part), dtype=np.float64)
    uses = {use.name: use for use in effects}
    offset = 0
    for index, name in enumerate(names):
        count = len(EFFECTS.load(name).Parameters._fields)
        if name in uses:
            on[index] = PARTS_LOAD if uses[name].piston_share > 0.0 else 1
            parameters[offset : offset + count] = uses[name].parameters
        offset += count
    return Switched(on, parameters)


def remembers(part: str, effects: Sequence[EffectUse]) -> bool:
    """Tell whether one of the effects in use has states of its own in a part."""
    return any(use.name in effects_of(part) and getattr(EFFECTS.load(use.name), "STATES", 0) for use in effects)


def kernel(part: str, friction_model: str = "gms", elements: int = 1) -> ModuleType:
    """Return the compiled module of a part; its ``run`` fills rows of ``out``.

    Args:
        part: one of :data:`PARTS`.
        friction_model: for ``friction`` and ``load``, the model's name.
        elements: for these, how many forces it integrates.
    """
    rubs = part in ("friction", "load")
    return kernel_module(_source(part, friction_model, elements) if rubs else _source(part, "", 0))


@cache
def _source(part: str, friction_model: str, elements: int) -> str:
    imports, rates, jumps, states, offset = list[str](), list[str](), list[str](), 0, 0
    chains = {hook: list[str]() for hook in PARTS[part]}
    handed, driven = list[str](), list[str]()
    for index, name in enumerate(effects_of(part)):
        effect: Any = EFFECTS.load(name)
        own, count = getattr(effect, "STATES", 0), len(effect.Parameters._fields)
        digest = hashlib.sha256(Path(inspect.getfile(cast(ModuleType, effect))).read_bytes()).hexdigest()[:16]
        imports.append(f"from ehls_ros.physics.effects import {name} as effect_{index}  # {digest}")
        parameters = f"p[{offset}:{offset + count}]"
        view = f"t, y, w, z[{states}:{states + own}], {parameters}, plant"
        for hook in PARTS[part]:
            if hasattr(effect, hook):
                chains[hook].append(f"    if on[{index}] == 1:\n        value = effect_{index}.{hook}(value, {view})")
        if part == "load" and hasattr(effect, "PISTON"):
            handed.append(f"    if on[{index}] == PARTS_LOAD:\n        value = effect_{index}.force(value, {view})")
            ahead = states + effect.PISTON
            driven.append(f"    if on[{index}] == PARTS_LOAD:\n        z[{ahead}], z[{ahead + 1}] = position - y[X], velocity")
        if part == "spool" and hasattr(effect, "jump"):
            jumps.append(f"    if on[{index}]:\n        value = min(value, effect_{index}.jump(t, w, {parameters}))")
        if own:
            # What parts load and piston has no states of its own here: it is where both are.
            rates.append(
                f"    if on[{index}] == 1:\n        effect_{index}.derivatives(value, {view}, dz[{states}:{states + own}])"
            )
        if part == "spool" and hasattr(effect, "command"):
            rates.append(chains["command"][-1])
        states += own
        offset += count
    hooks = "\n\n".join(
        "\n".join(["@plain", f"def {hook}(value, t, y, w, z, p, plant, on):", *chains[hook], "    return value", ""])
        for hook in PARTS[part]
    )
    template = {"spool": _SPOOL, "flow": _FLOW, "friction": _FRICTION, "force": _FORCE, "load": _LOAD}[part]
    head = _HEAD.format(imports="\n".join(imports), hooks=hooks, rates="\n".join(rates), jumps="\n".join(jumps))
    own_sources = hashlib.sha256(Path(__file__).read_bytes()).hexdigest()[:16]
    form = {"states": states, "model": friction_model, "elements": elements}
    return f"# {own_sources}\n" + head + template.format(**form, handed="\n".join(handed), driven="\n".join(driven))


_HEAD = '''"""Part of the model along a recording, generated."""
import numpy as np
from numba import njit
from ehls_ros.physics import plant as model
from ehls_ros.physics.beam import applied_force
from ehls_ros.physics.plant import X, V, PL, XV, FRICTION, U, FD, FD_RATE, XD, VD, TEMPERATURE, START, PERIOD, INPUTS
from ehls_ros.physics.valve import load_flow, spool_rate
{imports}

# They allocate nothing: counting who holds a view of an array would cost ten times what they do.
plain = njit(error_model="numpy", _nrt=False, forceinline=True)


{hooks}

@plain
def jump(t, w, p, on):
    value = np.inf
{jumps}
    return value


@plain
def effect_rates(value, t, y, w, z, p, plant, on, dz):
    """Write the rates of the effects' own states; return the command as the last effect leaves it."""
    for i in range(dz.size):
        dz[i] = 0.0
{rates}
    return value


@plain
def inputs(k, m, period, w):
    """Set the inputs at sample k; they hold until the next."""
    w[U], w[START], w[PERIOD] = m.command[k], m.time[k], period
    after = min(k + 1, m.time.size - 1)
    w[FD], w[FD_RATE] = m.disturbance[k], (m.disturbance[after] - m.disturbance[k]) / period
    w[XD], w[VD], w[TEMPERATURE] = m.servo_position[k], m.servo_velocity[k], m.temperature[k]
    for i in range(w.size - INPUTS):
        w[INPUTS + i] = m.command[max(k - 1 - i, 0)]


@plain
def measured(k, m, y):
    """Set the plant's state at sample k."""
    y[X], y[V], y[PL], y[XV] = m.position[k], m.velocity[k], m.pressure[k], m.spool[k]


@plain
def slopes(k, m, period, rate):
    """Set the rates of the plant's state from sample k to the next."""
    after = min(k + 1, m.time.size - 1)
    rate[X] = (m.position[after] - m.position[k]) / period
    rate[V] = (m.velocity[after] - m.velocity[k]) / period
    rate[PL] = (m.pressure[after] - m.pressure[k]) / period
    rate[XV] = (m.spool[after] - m.spool[k]) / period

'''


_REMEMBERED = """
@plain
def remember(k, m, period, steps, w, slope, p, plant, on, y, rates, stage):
    \"\"\"Move the effects' own states from sample k to the next by Runge-Kutta steps.\"\"\"
    step = period / steps
    for part in range(steps):
        t = m.time[k] + part * step
        for turn in range(4):
            ahead = 0.0 if turn == 0 else (step if turn == 3 else 0.5 * step)
            for i in range(FRICTION):
                stage[i] = y[i] + ahead * slope[i]
            for i in range({states}):
                stage[FRICTION + i] = y[FRICTION + i] + (ahead * rates[turn - 1, i] if turn else 0.0)
            effect_rates(w[U], t + ahead, stage, w, stage[FRICTION:], p, plant, on, rates[turn])
        for i in range(FRICTION):
            y[i] += step * slope[i]
        for i in range({states}):
            y[FRICTION + i] += step / 6.0 * (rates[0, i] + 2.0 * rates[1, i] + 2.0 * rates[2, i] + rates[3, i])

"""

_SPOOL = """
@plain
def follow(arrived, t, step, y, z, w, slope, p, plant, on, stage, own, rate, summed):
    \"\"\"Move the spool and the effects' own states by a Runge-Kutta step, the measured state straight on.\"\"\"
    spool, moved = y[XV], 0.0
    for i in range({states}):
        summed[i] = 0.0
    total = 0.0
    for turn in range(4):
        ahead = 0.0 if turn == 0 else (step if turn == 3 else 0.5 * step)
        stage[X], stage[V], stage[PL] = y[X] + ahead * slope[X], y[V] + ahead * slope[V], y[PL] + ahead * slope[PL]
        stage[XV] = spool + ahead * moved
        for i in range({states}):
            own[i] = z[i] + ahead * rate[i] if turn else z[i]
        moved = spool_rate(stage[XV], effect_rates(arrived, t + ahead, stage, w, own, p, plant, on, rate), plant)  # (4)
        share = 1.0 if turn == 0 or turn == 3 else 2.0
        total += share * moved
        for i in range({states}):
            summed[i] += share * rate[i]
    y[X], y[V], y[PL] = y[X] + step * slope[X], y[V] + step * slope[V], y[PL] + step * slope[PL]
    y[XV] = spool + step / 6.0 * total
    for i in range({states}):
        z[i] += step / 6.0 * summed[i]


@njit(cache=True, error_model="numpy", nogil=True)
def run(m, fresh, period, steps, history, plant, friction, p, on, out):
    \"\"\"Without steps, commands stand still between their jumps and (4) is followed exactly.\"\"\"
    y, z, w, slope = np.zeros(FRICTION), np.zeros({states}), np.zeros(INPUTS + history), np.zeros(FRICTION)
    stage, own, rate, summed = np.zeros(FRICTION), np.zeros({states}), np.zeros({states}), np.zeros({states})
    whole = np.exp(-plant.valve_bandwidth * period)
    for k in range(m.time.size):
        spool = y[XV]
        measured(k, m, y)
        y[XV] = spool
        if fresh[k]:
            measured(k, m, y)
            z[:] = 0.0
        out[k, 0] = y[XV]
        inputs(k, m, period, w)
        slopes(k, m, period, slope)
        now, last, tolerance = m.time[k], m.time[k] + period, 1e-9 * period
        while last - now > tolerance:
            until = min(jump(now + tolerance, w, p, on), last) if history else last
            # Asked amid the piece, where no rounding can take it past a jump.
            arrived = received(w[U], 0.5 * (now + until), y, w, z, p, plant, on) if history else w[U]
            if steps == 0:
                held = plant.valve_gain * command(arrived, now, y, w, z, p, plant, on)
                left = whole if until - now == period else np.exp(-plant.valve_bandwidth * (until - now))
                y[XV] = held + (y[XV] - held) * left  # (4)
            else:
                pieces = max(1, int(np.ceil((until - now) / period * steps - 1e-6)))
                step = (until - now) / pieces
                for piece in range(pieces):
                    follow(arrived, now + piece * step, step, y, z, w, slope, p, plant, on, stage, own, rate, summed)
            now = until
"""

_FLOW = (
    _REMEMBERED
    + """
@njit(cache=True, error_model="numpy", nogil=True)
def run(m, fresh, period, steps, history, plant, friction, p, on, out):
    y, w, slope = np.zeros(FRICTION + {states}), np.zeros(INPUTS), np.zeros(FRICTION)
    rates, stage = np.zeros((4, {states})), np.zeros(FRICTION + {states})
    for k in range(m.time.size):
        measured(k, m, y)
        if fresh[k]:
            y[FRICTION:] = 0.0
        t, z = m.time[k], y[FRICTION:]
        inputs(k, m, period, w)
        spool = opening(y[XV], t, y, w, z, p, plant, on)
        supply = supply_pressure(plant.supply_pressure, t, y, w, z, p, plant, on)
        out[k, 0] = load_flow(spool, 1.0 if spool >= 0.0 else -1.0, y[PL], supply, plant)  # (1)
        out[k, 1] = leakage(plant.leakage_coefficient * y[PL], t, y, w, z, p, plant, on)
        out[k, 2] = bulk_modulus(plant.bulk_modulus, t, y, w, z, p, plant, on)
        out[k, 3] = supply
        if steps:
            slopes(k, m, period, slope)
            remember(k, m, period, steps, w, slope, p, plant, on, y, rates, stage)
"""
)

_FORCE = (
    _REMEMBERED
    + """
@njit(cache=True, error_model="numpy", nogil=True)
def run(m, fresh, period, steps, history, plant, friction, p, on, out):
    y, w, slope = np.zeros(FRICTION + {states}), np.zeros(INPUTS), np.zeros(FRICTION)
    rates, stage = np.zeros((4, {states})), np.zeros(FRICTION + {states})
    for k in range(m.time.size):
        measured(k, m, y)
        if fresh[k]:
            y[FRICTION:] = 0.0
        inputs(k, m, period, w)
        out[k, 0] = force(0.0, m.time[k], y, w, y[FRICTION:], p, plant, on)
        if steps:
            slopes(k, m, period, slope)
            remember(k, m, period, steps, w, slope, p, plant, on, y, rates, stage)
"""
)

_FRICTION = """
from ehls_ros.physics.friction import {model} as law

FORCES = FRICTION + {elements}
MOST_EVENTS = 4
MOST_TURNS = 16
STEEP, FINE = 0.1, 6


@plain
def level_at(t, y, w, z, p, plant, friction, on):
    \"\"\"Return the Stribeck level [N].\"\"\"
    return friction_level(law.level(y[V], friction), t, y, w, z, p, plant, on)  # (7)


@plain
def others(t, y, w, extra, plant):
    \"\"\"Return every other force on the mass [N].\"\"\"
    return applied_force(y[X], y[V], y[PL], model.disturbance_force(t, w), extra, plant)


@plain
def ahead(y, forces, slope, level, begun, step, mode, friction, rate, middle, end):
    \"\"\"Write the forces a step on by the midpoint rule, the measured state straight on; level grows evenly.\"\"\"
    for i in range(FRICTION):
        end[i] = y[i] + step * slope[i]
    law.rates(y[V], begun, forces, mode, friction, rate)  # (6), (8)
    for i in range({elements}):
        middle[i] = forces[i] + 0.5 * step * rate[i]
    law.rates(0.5 * (y[V] + end[V]), 0.5 * (begun + level), middle, mode, friction, rate)
    for i in range({elements}):
        end[FRICTION + i] = forces[i] + step * rate[i]


@njit(cache=True, error_model="numpy", nogil=True)
def run(m, fresh, period, steps, weights, start, plant, friction, p, on, extra, out):
    y, mode, w, slope = np.zeros(FRICTION), np.zeros({elements}), np.zeros(INPUTS), np.zeros(FRICTION)
    z, dz, forces = np.zeros({states}), np.zeros({states}), np.zeros({elements})
    rate, middle, end = np.zeros({elements}), np.zeros({elements}), np.zeros(FORCES)
    for k in range(m.time.size):
        measured(k, m, y)
        inputs(k, m, period, w)
        slopes(k, m, period, slope)
        t = m.time[k]
        # The Stribeck curve is steep where the motion turns.
        steep = abs(slope[V]) * period > STEEP * (abs(y[V]) + friction.stribeck_velocity)
        parts = max(steps, FINE) if steep else steps
        step = period / parts
        if fresh[k]:
            z[:] = 0.0
            mode[:] = 0.0
            level = level_at(t, y, w, z, p, plant, friction, on)
            # The forces a stretch begins with are not known; together they balance the others as far as they can.
            balance = min(max(start[k], -level), level)
            for i in range({elements}):
                forces[i] = balance * weights[i]
        level = level_at(t, y, w, z, p, plant, friction, on)
        out[k, 0] = law.force(y[V], others(t, y, w, extra[k], plant), level, forces, mode, friction)
        for part in range(parts):
            left, events = step, 0
            while left > 1e-6 * step:
                if law.event(y[V], others(t, y, w, extra[k], plant), level, forces, mode, friction) > 0.0:
                    law.switch(y[V], others(t, y, w, extra[k], plant), level, forces, mode, friction)
                before = law.event(y[V], others(t, y, w, extra[k], plant), level, forces, mode, friction)
                for i in range(FRICTION):
                    end[i] = y[i] + left * slope[i]
                later = level_at(t + left, end, w, z, p, plant, friction, on)
                ahead(y, forces, slope, later, level, left, mode, friction, rate, middle, end)
                taken = left
                after = law.event(end[V], others(t + taken, end, w, extra[k], plant), later, end[FRICTION:], mode, friction)
                if after > 0.0 and before < 0.0 and events < MOST_EVENTS:
                    events += 1
                    low, high = 0.0, left
                    full = later
                    for turn in range(MOST_TURNS):
                        # Of several elements the one nearest to its limit need not be the first there: halve in between.
                        share = after / (after - before) if turn % 2 == 0 else 0.5
                        # A little behind the estimate, so that both ends of the bracket close in.
                        taken = min(max(high - (high - low) * share + 1e-4 * left, low), high)
                        value = level + (full - level) * taken / left
                        ahead(y, forces, slope, value, level, taken, mode, friction, rate, middle, end)
                        applied = others(t + taken, end, w, extra[k], plant)
                        found = law.event(end[V], applied, value, end[FRICTION:], mode, friction)
                        if found > 0.0:
                            high, after = taken, found
                        else:
                            low, before = taken, min(found, -1e-12)
                        if high - low < 1e-3 * left:
                            break
                    taken = max(high, 1e-6 * step)
                    later = level + (full - level) * taken / left
                    ahead(y, forces, slope, later, level, taken, mode, friction, rate, middle, end)
                if {states}:
                    effect_rates(w[U], t, y, w, z, p, plant, on, dz)
                    for i in range({states}):
                        z[i] += taken * dz[i]
                for i in range(FRICTION):
                    y[i] = end[i]
                for i in range({elements}):
                    forces[i] = end[FRICTION + i]
                t += taken
                left -= taken
                level = later
"""

_LOAD = """
from ehls_ros.physics.friction import {model} as law
from ehls_ros.diagnosis.kernels import PARTS_LOAD


@plain
def handed_on(value, t, y, w, z, p, plant, on):
    \"\"\"Return the force on the load that the piston hands on, less the pressure's and the piston's weight [N].\"\"\"
{handed}
    return value


@plain
def drive(position, velocity, y, z, on):
    \"\"\"Set the states of the effect that parts load and piston to where the piston is.\"\"\"
{driven}


@plain
def balance(pushed, t, y, w, z, p, plant, friction, on):
    \"\"\"Return Stribeck level and the forces on the load without friction, pushed of them handed on [N].\"\"\"
    level = friction_level(law.level(y[V], friction), t, y, w, z, p, plant, on)  # (7)
    extra = pushed + force(0.0, t, y, w, z, p, plant, on)
    return level, applied_force(y[X], y[V], y[PL], model.disturbance_force(t, w), extra, plant)


@plain
def settle(k, m, t, y, w, z, p, plant, piston_weight, on):
    \"\"\"Lay the load where what the piston hands on is what the pressure pushes with, both at the piston's velocity.\"\"\"
    low, high, wide = 0.0, 0.0, 1e-6
    while wide < 1.0:
        y[X] = m.position[k] - wide
        drive(m.position[k], y[V], y, z, on)
        reaches = handed_on(0.0, t, y, w, z, p, plant, on) + piston_weight > 0.0
        y[X] = m.position[k] + wide
        drive(m.position[k], y[V], y, z, on)
        low, high = -wide, wide
        if reaches and handed_on(0.0, t, y, w, z, p, plant, on) + piston_weight < 0.0:
            break
        wide *= 4.0
    for turn in range(40):
        ahead = 0.5 * (low + high)
        y[X] = m.position[k] - ahead
        drive(m.position[k], y[V], y, z, on)
        if handed_on(0.0, t, y, w, z, p, plant, on) + piston_weight > 0.0:
            high = ahead
        else:
            low = ahead


@njit(cache=True, error_model="numpy", nogil=True)
def run(m, fresh, period, steps, weights, piston_mass, guide, plant, friction, p, on, out):
    \"\"\"Piston and load by the midpoint rule, the piston drawn to where it was measured as fast as guide [1/s].

    Friction changes at the ends of steps; elements that break away start at their limits.
    \"\"\"
    y, mode, w, slope = np.zeros(FRICTION), np.zeros({elements}), np.zeros(INPUTS), np.zeros(FRICTION)
    z, dz, forces = np.zeros({states}), np.zeros({states}), np.zeros({elements})
    rate, middle, stage = np.zeros({elements}), np.zeros({elements}), np.zeros(FRICTION)
    step = period / steps
    both, weight = piston_mass + plant.moving_mass, piston_mass * plant.gravity
    position, velocity = 0.0, 0.0
    for k in range(m.time.size):
        inputs(k, m, period, w)
        slopes(k, m, period, slope)
        if fresh[k]:
            measured(k, m, y)
            z[:] = 0.0
            mode[:] = 0.0
            settle(k, m, m.time[k], y, w, z, p, plant, weight, on)
            position, velocity = m.position[k], m.velocity[k]
            drive(position, velocity, y, z, on)
            pushed = handed_on(0.0, m.time[k], y, w, z, p, plant, on)
            level, applied = balance(pushed, m.time[k], y, w, z, p, plant, friction, on)
            applied -= friction.viscous_coefficient * y[V] + plant.moving_mass * slope[V]
            for i in range({elements}):
                forces[i] = min(max(applied, -level), level) * weights[i]
        for part in range(steps):
            passed = part * step
            t = m.time[k] + passed
            y[PL] = m.pressure[k] + passed * slope[PL]
            drive(position, velocity, y, z, on)
            pulled = guide * (2.0 * (m.velocity[k] + passed * slope[V] - velocity)
                + guide * (m.position[k] + passed * slope[X] - position)) * both
            pushed = handed_on(0.0, t, y, w, z, p, plant, on)
            there, speed = position + 0.5 * step * velocity, velocity + 0.5 * step * (pulled - pushed - weight) / piston_mass
            level, applied = balance(pushed, t, y, w, z, p, plant, friction, on)
            if law.event(y[V], applied, level, forces, mode, friction) > 0.0:
                for i in range({elements}):
                    middle[i] = mode[i]
                y[V] = law.switch(y[V], applied, level, forces, mode, friction)
                for i in range({elements}):
                    if middle[i] == 0.0 and mode[i] != 0.0:
                        forces[i] = min(max(forces[i], -weights[i] * level), weights[i] * level)
            resisting = law.force(y[V], applied, level, forces, mode, friction)
            if part == 0:
                out[k, 0], out[k, 1], out[k, 2] = y[X], y[V], resisting
                out[k, 3] = force(0.0, t, y, w, z, p, plant, on)
            effect_rates(w[U], t, y, w, z, p, plant, on, dz)
            law.rates(y[V], level, forces, mode, friction, rate)
            half = passed + 0.5 * step
            stage[X] = y[X] + 0.5 * step * y[V]
            stage[V] = y[V] + 0.5 * step * (applied - resisting) / plant.moving_mass
            stage[PL] = m.pressure[k] + half * slope[PL]
            for i in range({elements}):
                middle[i] = forces[i] + 0.5 * step * rate[i]
            for i in range({states}):
                z[i] += step * dz[i]
            drive(there, speed, stage, z, on)
            pulled = guide * (2.0 * (m.velocity[k] + half * slope[V] - speed)
                + guide * (m.position[k] + half * slope[X] - there)) * both
            pushed = handed_on(0.0, t + 0.5 * step, stage, w, z, p, plant, on)
            position += step * speed
            velocity += step * (pulled - pushed - weight) / piston_mass
            level, applied = balance(pushed, t + 0.5 * step, stage, w, z, p, plant, friction, on)
            resisting = law.force(stage[V], applied, level, middle, mode, friction)
            law.rates(stage[V], level, middle, mode, friction, rate)
            y[X] += step * stage[V]
            y[V] += step * (applied - resisting) / plant.moving_mass
            for i in range({elements}):
                forces[i] += step * rate[i]
"""
