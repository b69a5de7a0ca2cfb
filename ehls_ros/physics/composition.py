"""Putting chosen parts into one compiled kernel, and keeping the machine code between processes.

Numba caches machine code by source file, not by the functions handed to it. So the parts chosen are
written down as a small module that imports them and names them in one compiled entry function. The
module lies in the user's cache folder under a name made of its own text and of the package's sources:
any change of either makes a new module, and a cached kernel is never stale.
"""

import hashlib
import sys
from importlib.abc import ExecutionLoader
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import Any

import numba
import numpy as np
from numba.core.compiler_lock import global_compiler_lock
from numba.core.dispatcher import Dispatcher

from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.effects.base import HOOKS
from ehls_ros.physics.friction import FRICTION_MODELS
from ehls_ros.physics.kernel_cache import PREFIX, kept, make_private, sealed
from ehls_ros.physics.rig import EffectUse, Rig
from ehls_ros.sources import import_line, sources_digest


def kernel_module(source: str) -> ModuleType:
    """Import a generated module, writing it first where it is new.

    Args:
        source: text of the module; its compiled entry functions say ``cache=True``.

    Returns:
        The module. Its entry functions compile at their first call ever, and load at later ones. Of several processes
        that call one for the first time at once, one compiles and the others wait and load.

    Raises:
        BadInput: the cache folder is not the user's alone.
    """
    # Everything machine code is made from.
    made_from = (sys.version, numba.__version__, np.__version__, sources_digest("physics", "control", "arrays.py"), source)
    name = PREFIX + hashlib.sha256(" ".join(made_from).encode()).hexdigest()[:16]
    if name in sys.modules:
        return sys.modules[name]
    path = kept(name, source)
    spec = spec_from_file_location(name, path, loader=_Generated(source, path))
    if spec is None or spec.loader is None:
        raise ImportError(f"{path} cannot be imported as a kernel module")
    module = module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    for entry in vars(module).values():
        if isinstance(entry, Dispatcher) and entry.py_func.__module__ == name and entry.stats.cache_path is not None:
            code = Path(entry.stats.cache_path)
            if code.parent != path.parent:
                # Numba was told to keep it elsewhere.
                make_private(code)
            _compile_in_turn(entry, path.with_name(f"{name}.{entry.py_func.__name__}.seal"), code)
    return module


class _Generated(ExecutionLoader):
    """Runs a module's text from memory: the file may be another by the time it is read."""

    def __init__(self, source: str, path: Path) -> None:
        self._source = source
        self._path = path

    def get_source(self, fullname: str) -> str:
        return self._source

    def get_filename(self, fullname: str) -> str:
        return str(self._path)

    def is_package(self, fullname: str) -> bool:
        return False


def _compile_in_turn(entry: Any, seal: Path, code: Path) -> None:
    """Let a compiled function compile in one process at a time; who waited finds it done and loads it."""
    compile_or_load = entry.compile

    def in_turn(signature: Any) -> Any:
        # Numba's own lock first: a thread that holds it may want the file for a kernel inside the one it compiles.
        with global_compiler_lock, sealed(seal, code, f"{seal.stem}-*"):
            try:
                return compile_or_load(signature)
            except OSError:
                # The disk is full: it is compiled by now, and only cannot be kept.
                return compile_or_load(signature)

    entry.compile = in_turn


def plant_source(rig: Rig) -> str:
    """Return the text of the kernel module for a rig's friction model and effects.

    The module's ``advance(t, y, mode, plant, friction, inputs, effects, step, steps, work)`` moves the plant on;
    ``sense(cycle, t, y, plant, inputs, effects, state, noise, truth, measured)`` reads its sensors; ``hold(w, ...)``
    is that of :mod:`ehls_ros.physics.plant`; ``EFFECT_STATES`` counts the effects' own states.
    """
    elements = rig_elements(rig)
    imports, rates, jumps, states, offset = list[str](), list[str](), list[str](), 0, 0
    chains = {hook: list[str]() for hook in HOOKS}
    for index, use in enumerate(effects_in_kernel(rig)):
        effect = EFFECTS.load(use.name)
        own = getattr(effect, "STATES", 0)
        count = len(use.parameters)
        parameters = f"p[{offset}:{offset + count}]"
        view = f"t, y, w, z[{states}:{states + own}], {parameters}, plant"
        imports.append(import_line(effect, f"effect_{index}"))
        for hook in HOOKS:
            if hasattr(effect, hook):
                chains[hook].append(f"    value = effect_{index}.{hook}(value, {view})")
        if hasattr(effect, "jump"):
            jumps.append(f"    value = min(value, effect_{index}.jump(t, w, {parameters}))")
        if own:
            rates.append(f"    effect_{index}.derivatives(value, {view}, dz[{states}:{states + own}])")
        if hasattr(effect, "command"):
            rates += chains["command"][-1:]
        states += own
        offset += count
    hooks = "\n\n".join(
        "\n".join(["@kernel", f"def {hook}(value, t, y, w, z, p, plant):", *chains[hook], "    return value", ""])
        for hook in HOOKS
    )
    return _PLANT.format(
        friction=import_line(FRICTION_MODELS.load(rig.friction_model), "friction_model"),
        imports="\n".join(imports),
        hooks=hooks,
        jumps="\n".join(jumps),
        late="received, jump" if jumps else "None, None",
        rates="\n".join(rates) if states else "    pass",
        elements=elements,
        states=states,
    )


def effects_in_kernel(rig: Rig) -> tuple[EffectUse, ...]:
    """Return a rig's effects that have hooks; the parameters of these are the kernel's ``effects``."""
    return tuple(use for use in rig.effects if any(hasattr(EFFECTS.load(use.name), hook) for hook in HOOKS))


def rig_elements(rig: Rig) -> int:
    """Return how many forces the rig's friction model integrates."""
    return FRICTION_MODELS.load(rig.friction_model).states(rig.friction)


_PLANT = '''"""Plant kernel, generated."""
from math import inf
from numba import njit
from ehls_ros.arrays import kernel
from ehls_ros.physics import integration, plant as model, sensors
{friction}
{imports}

EFFECT_STATES = {states}


{hooks}

@kernel
def jump(t, w, p):
    value = inf
{jumps}
    return value


@kernel
def effect_rates(value, t, y, w, z, p, plant, dz):
{rates}


parts = model.Parts(
    friction_model, {elements}, {late},
    command, opening, supply_pressure, bulk_modulus, leakage, friction_level, force, piston_velocity, effect_rates,
)
evaluate, switch = model.system(parts)
run = integration.integrator(evaluate, switch, size=model.FRICTION + {elements} + EFFECT_STATES)
move = model.mover(run, parts)


@kernel
def observe(cycle, t, y, plant, inputs, effects, state, noise, truth, measured):
    z = y[model.FRICTION + {elements}:]
    supply = supply_pressure(plant.supply_pressure, t, y, inputs, z, effects, plant)
    sensors.true_signals(y, inputs[model.TEMPERATURE], supply, plant, truth)
    truth[sensors.POSITION] = piston_position(y[model.X], t, y, inputs, z, effects, plant)
    truth[sensors.VELOCITY] = piston_velocity(y[model.V], t, y, inputs, z, effects, plant)
    sensors.measure(cycle, truth, noise, state, measured)


@njit(cache=True, error_model="numpy")
def advance(t, y, mode, plant, friction, inputs, effects, step, steps, work):
    return move(t, y, mode, plant, friction, inputs, effects, step, steps, work)


@njit(cache=True, error_model="numpy")
def sense(cycle, t, y, plant, inputs, effects, state, noise, truth, measured):
    observe(cycle, t, y, plant, inputs, effects, state, noise, truth, measured)


@njit(cache=True, error_model="numpy")
def hold(w, start, command, force, force_rate, displacement, velocity):
    model.hold(w, start, command, force, force_rate, displacement, velocity)
'''
