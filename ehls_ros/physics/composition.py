"""Compose kernels from chosen parts, compile them, and cache the machine code between processes.

Numba caches machine code per source file and does not distinguish functions passed as arguments. Therefore a small module is
generated for each choice of parts. It imports the parts, chains the hooks of the effects, and calls a builder of the package.
It has one entry function for each function built. No other file generates source text. The module is stored in the user's
cache folder. Its name is a digest of its text and the package's sources, so machine code is never stale.

A chain of effects is of one of two kinds:

* *fixed*: the effects of one rig in their order; ``p`` is one array with all parameters.
* *switched*: many effects in the order of their names, each behind a flag; ``p`` is :class:`Switched`. Another choice of
  effects needs no compilation.
"""

import hashlib
import sys
import threading
from collections.abc import Callable, Iterable, Mapping
from functools import cache
from importlib.abc import ExecutionLoader
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import numba
import numpy as np
from numba.core.compiler_lock import global_compiler_lock
from numba.core.dispatcher import Dispatcher
from numpy.typing import NDArray

from ehls_ros.arrays import Array
from ehls_ros.duals import joined
from ehls_ros.inlining import IS_PLAIN, faster_compilation, skip_scipy_check
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.effects.base import CHAMBER_HOOKS, HOOKS, LOAD_PRESSURE_HOOKS
from ehls_ros.physics.friction import FRICTION_MODELS
from ehls_ros.physics.kernel_cache import PREFIX, is_sealed, make_private, sealed, store_source
from ehls_ros.physics.rig import EffectiveRig, EffectUse, Rig
from ehls_ros.sources import import_line, sources_digest

KERNEL_SOURCES = ("physics", "control", "identification", "arrays.py", "duals", "inlining.py", "numba_internals.py")
"""Sources of the kernels."""

_IMPORTING = threading.RLock()
"""Held while a generated module is imported: another thread would get it without its functions."""


def kernel_module(source: str) -> ModuleType:
    """Import a generated module, storing it first if it is new.

    Args:
        source: text of the module; its compiled entry functions have ``cache=True``.

    Returns:
        The module. Its entry functions are compiled once; later processes load the machine code. If several processes request
        the same function at once, one compiles it and the others wait.

    Raises:
        BadInput: other users can write to the cache folder.
    """
    # All dependencies of the machine code.
    made_from = (sys.version, numba.__version__, np.__version__, sources_digest(*KERNEL_SOURCES), str(IS_PLAIN), source)
    name = PREFIX + hashlib.sha256(" ".join(made_from).encode()).hexdigest()[:16]
    with _IMPORTING:
        if name in sys.modules:
            return sys.modules[name]
        path = store_source(name, source)
        spec = spec_from_file_location(name, path, loader=_Generated(source, path))
        if spec is None or spec.loader is None:
            raise ImportError(f"{path} cannot be imported as a kernel module")
        module = module_from_spec(spec)
        sys.modules[name] = module
        spec.loader.exec_module(module)
    for entry in _entries(module):
        code = Path(entry.stats.cache_path)
        if code.parent != path.parent:
            # Numba is configured to cache elsewhere.
            make_private(code)
        _compile_in_turn(entry, _seal(module, entry), code)
    return module


def _entries(module: ModuleType) -> list[Any]:
    """Return the entry functions of a generated module, if their machine code is cached."""
    functions = [value for value in vars(module).values() if isinstance(value, Dispatcher)]
    return [f for f in functions if f.py_func.__module__ == module.__name__ and f.stats.cache_path is not None]


def _seal(module: ModuleType, entry: Any) -> Path:
    return Path(str(module.__file__)).with_name(f"{module.__name__}.{entry.py_func.__name__}.seal")


def is_compiled(module: ModuleType) -> bool:
    """Return whether the machine code of every entry function of a module is in the cache."""
    return all(is_sealed(_seal(module, entry)) for entry in _entries(module))


class _Generated(ExecutionLoader):
    """Loader of a module from its text in memory, since the file may be replaced before it is read."""

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
    """Serialise the compilation of an entry function among processes; the others load the result."""
    compile_or_load = entry.compile

    def in_turn(signature: Any) -> Any:
        # Numba's lock first, to avoid a deadlock: its holder may need the file lock of a kernel it calls.
        with global_compiler_lock, sealed(seal, code, f"{seal.stem}-*"), faster_compilation():
            skip_scipy_check()
            try:
                return compile_or_load(signature)
            except OSError:
                # The disk is full: the function is compiled but cannot be cached.
                return compile_or_load(signature)

    entry.compile = in_turn


class Switched(NamedTuple):
    """Parameters of switched chains.

    Attributes:
        on: a flag for each effect, shape (effects,).
        values: the parameters of all effects, one after another, shape (parameters,).
    """

    on: NDArray[np.int8]
    values: Array


class Effects(NamedTuple):
    """Choice of effects to chain.

    Attributes:
        names: names in the order in which the effects act.
        switched: whether each effect is behind a flag.
    """

    names: tuple[str, ...] = ()
    switched: bool = False

    @property
    def states(self) -> int:
        """Number of states of all effects."""
        return sum(_states(name) for name in self.names)

    def first_state(self, name: str) -> int:
        """Return the index of the first state of an effect."""
        return sum(_states(before) for before in self.names[: self.names.index(name)])

    def piston_state(self, name: str) -> int:
        """Return the index of the displacement between piston and load, for an effect that separates them."""
        effect: Any = EFFECTS.load(name)
        return self.first_state(name) + int(effect.PISTON)

    def parameters(self, uses: Iterable[EffectUse]) -> Any:
        """Return ``p`` of the chains for the effects in use.

        If an effect is used twice, switched chains apply the last use. Values of switched chains may be duals.
        """
        if not self.switched:
            used = [use for use in uses if use.name in self.names]
            return np.array([value for use in used for value in use.parameters], dtype=np.float64)
        last = {use.name: use.parameters for use in uses}
        on = np.array([name in last for name in self.names], dtype=np.int8)
        return Switched(on, joined(v for n in self.names for v in last.get(n, _neutral(n))))


@cache
def _neutral(name: str) -> tuple[float, ...]:
    return tuple(EFFECTS.load(name).Parameters())


def _states(name: str) -> int:
    return getattr(EFFECTS.load(name), "STATES", 0)


@cache
def effects_with(*hooks: str) -> Effects:
    """Return all effects of the family that have at least one of the given hooks, switched."""
    names = (n for n in EFFECTS.names() if any(hasattr(EFFECTS.load(n), hook) for hook in hooks))
    return Effects(tuple(names), switched=True)


def effects_of(rig: Rig | EffectiveRig) -> Effects:
    """Return a rig's effects that have hooks, as a fixed chain."""
    return Effects(tuple(use.name for use in effects_in_kernel(rig)))


def effects_in_kernel(rig: Rig | EffectiveRig) -> tuple[EffectUse, ...]:
    """Return a rig's effects that have hooks on its cylinder; the others only shift parameters."""
    lacking = LOAD_PRESSURE_HOOKS if rig.cylinder.law.CHAMBERS else CHAMBER_HOOKS
    hooks = [hook for hook in (*HOOKS, *CHAMBER_HOOKS) if hook not in lacking]
    return tuple(use for use in rig.effects if any(hasattr(EFFECTS.load(use.name), hook) for hook in hooks))


def rig_elements(rig: Rig | EffectiveRig) -> int:
    """Return the number of forces that the rig's friction model integrates."""
    return FRICTION_MODELS.load(rig.friction_model).states(rig.friction)


def compiled(
    build: Callable[..., Any],
    entries: Mapping[str, str],
    members: Mapping[str, Any] | None = None,
    numbers: Mapping[str, int] | None = None,
    effects: Effects | None = None,
    *,
    threads: bool = False,
) -> ModuleType:
    """Compile or load the functions that a builder returns for chosen parts.

    Args:
        build: builder at the top level of a module. Its keyword arguments are the members, the numbers and, with effects,
            ``chains`` (:class:`~ehls_ros.physics.plant.Chains`). It returns an object with a compiled function per entry.
        entries: arguments of each entry function as text, by name.
        members: modules by keyword, such as a friction model, and functions at the top level of a module.
        numbers: integers by keyword.
        effects: the effects to chain.
        threads: whether the entry functions release the interpreter lock.

    Returns:
        A module with the entry functions, callable from Python and from compiled code.
    """
    members, numbers = members or {}, numbers or {}
    module = sys.modules[build.__module__]
    lines = [
        f'"""{build.__module__}.{build.__name__}, generated."""',
        "from math import inf",
        "from numba import njit",
        "from ehls_ros.arrays import kernel_no_refcount",
        "from ehls_ros.physics.plant import Chains",
        import_line(module, "builder"),
        *(_import(member, keyword) for keyword, member in members.items()),
        *([] if effects is None else _chains(effects)),
    ]
    keywords = [f"{name}={name}" for name in members] + [f"{name}={number}" for name, number in numbers.items()]
    keywords += [] if effects is None else ["chains=chains"]
    lines += [f"built = builder.{build.__name__}({', '.join(keywords)})"]
    for entry, arguments in entries.items():
        lines += [
            f"{entry}_built = built.{entry}",
            f'@njit(cache=True, error_model="numpy", nogil={threads}, no_cfunc_wrapper=True)',
            f"def {entry}({arguments}):",
            f"    return {entry}_built({arguments})",
        ]
    return kernel_module("\n".join(lines) + "\n")


def _import(member: Any, name: str) -> str:
    """Return the import line of a part; the name of a generated module contains a digest already."""
    return f"import {member.__name__} as {name}" if member.__name__.startswith(PREFIX) else import_line(member, name)


def _chains(effects: Effects) -> list[str]:
    """Return the source lines that chain the hooks of the effects."""
    lines, rates, jumps, states, first = list[str](), list[str](), list[str](), 0, 0
    chains: dict[str, list[str]] = {hook: [] for hook in (*HOOKS, "joint_force", "coupling_force", *CHAMBER_HOOKS)}
    needed = 0
    for index, name in enumerate(effects.names):
        effect = EFFECTS.load(name)
        own, count = _states(name), len(effect.Parameters._fields)
        row = "p.values" if effects.switched else "p"
        values = ", ".join(f"{row}[{place}]" for place in range(first, first + count))
        parameters = f"effect_{index}.Parameters({values})"
        view = f"t, y, w, z[{states}:{states + own}], {parameters}, plant"
        flag = [f"    if p.on[{index}] != 0:"] if effects.switched else []
        indent = "        " if effects.switched else "    "
        lines.append(_import(effect, f"effect_{index}"))
        for hook in HOOKS:
            if hasattr(effect, hook):
                chains[hook] += [*flag, f"{indent}value = effect_{index}.{hook}(value, {view})"]
        for hook in CHAMBER_HOOKS:
            if hasattr(effect, hook):
                chains[hook] += [*flag, f"{indent}value = effect_{index}.{hook}(value, pressure, {view})"]
        if hasattr(effect, "PISTON"):
            chains["joint_force"] += [*flag, f"{indent}value = effect_{index}.force(value, {view})"]
        if getattr(effect, "COUPLES", False):
            chains["coupling_force"] += [*flag, f"{indent}value = effect_{index}.force(value, {view})"]
        if hasattr(effect, "jump"):
            jumps += [*flag, f"{indent}value = min(value, effect_{index}.jump(t, w, {parameters}))"]
        if own:
            rates += [*flag, f"{indent}effect_{index}.derivatives(value, {view}, dz[{states}:{states + own}])"]
            needed = len(rates)
        if hasattr(effect, "command"):
            rates += [*flag, f"{indent}value = effect_{index}.command(value, {view})"]
        states += own
        first += count
    at_rest = [f"    for i in range({states}):", "        dz[i] = 0.0"] if effects.switched else []
    for hook, calls in chains.items():
        arguments = "value, pressure, t" if hook in CHAMBER_HOOKS else "value, t"
        lines += ["@kernel_no_refcount", f"def {hook}({arguments}, y, w, z, p, plant):", *calls, "    return value"]
    lines += ["@kernel_no_refcount", "def jump(t, w, p):", "    value = inf", *jumps, "    return value"]
    lines += ["@kernel_no_refcount", "def rates(value, t, y, w, z, p, plant, dz):", *at_rest, *rates[:needed], "    return"]
    unused = () if jumps else ("received", "jump")
    keywords = (f"{name}={None if name in unused else name}" for name in (*chains, "jump", "rates"))
    return [*lines, f"chains = Chains({', '.join(keywords)})"]
