"""Machine code of compiled functions as object files for Linux and Windows.

Numba keeps the optimised intermediate code of a compiled function with its cached machine code. Here it is translated again,
for a processor that all targets have in common. Every operation is rounded separately in both, so the numbers are the same.
"""

from functools import cache
from types import ModuleType
from typing import Any

from llvmlite import binding
from numba import float64, types
from numba.core.errors import NumbaError

PROCESSOR = "x86-64-v3"
"""Processors with AVX2 and FMA: Intel since Haswell (2013), AMD since Excavator (2015)."""

TRIPLES = {"linux": "x86_64-unknown-linux-gnu", "windows": "x86_64-w64-windows-gnu"}
"""LLVM's names of the systems."""

RUNTIME = {
    *(
        "acos",
        "asin",
        "atan",
        "atan2",
        "cos",
        "cosh",
        "exp",
        "exp2",
        "expm1",
        "floor",
        "fmod",
        "hypot",
        "ldexp",
        "log",
        "log10",
    ),
    *("log10", "log1p", "log2", "pow", "round", "sin", "sinh", "tan", "tanh", "memcpy", "memmove", "memset"),
    *("ceil", "copysign", "fabs", "fma", "rint", "sqrt", "trunc"),  # instructions of the processor
}
"""Functions of the C library that the code may call."""


def block_type() -> Any:
    """Return numba's type of a block."""
    return types.Array(float64, 1, "C")


def object_code(kernel: ModuleType, entry: str, system: str) -> bytes:
    """Return a compiled function of one block as an object file.

    Args:
        kernel: a module of :func:`ehls_ros.physics.composition.compiled`.
        entry: name of the function; its symbol is ``ehls_<entry>``.
        system: ``linux`` or ``windows``.

    Raises:
        RuntimeError: the function needs Python at run time, such as to raise an error.
    """
    module = binding.parse_bitcode(_bitcode(kernel, entry))
    wanted = _symbol(kernel, entry)
    for function in module.functions:
        if not function.is_declaration:
            function.linkage = "external" if function.name == wanted else "internal"
    for variable in module.global_variables:
        if not variable.is_declaration:
            variable.linkage = "internal"
    found = module.get_function(wanted)
    found.name = f"ehls_{entry}"
    found.visibility = "hidden"
    machine = _machine(system)
    module.triple, module.data_layout = TRIPLES[system], str(machine.target_data)
    builder = binding.create_pass_builder(machine, binding.create_pipeline_tuning_options(speed_level=2))
    passes = binding.create_new_module_pass_manager()
    passes.add_global_dead_code_eliminate_pass()
    passes.run(module, builder)
    _check(module, entry)
    code: bytes = machine.emit_object(module)
    return code


def _check(module: Any, entry: str) -> None:
    """Check that only functions of the C library remain outside."""
    outside = {part.name for part in (*module.functions, *module.global_variables) if part.is_declaration}
    strange = sorted(name for name in outside if not name.startswith("llvm.") and name not in RUNTIME)
    if strange:
        raise RuntimeError(f"the machine code of {entry} needs {', '.join(strange)}")


def _overload(kernel: ModuleType, entry: str) -> Any:
    function = getattr(kernel, entry)
    signature = (block_type(),)
    function.compile(signature)
    return function.overloads[signature]


def _bitcode(kernel: ModuleType, entry: str) -> bytes:
    code: bytes = _overload(kernel, entry).library._get_module_for_linking().as_bitcode()  # noqa: SLF001 - no public name
    return code


def _symbol(kernel: ModuleType, entry: str) -> str:
    return str(_overload(kernel, entry).fndesc.llvm_func_name)


@cache
def _machine(system: str) -> Any:
    binding.initialize_all_targets()
    binding.initialize_all_asmprinters()
    target = binding.Target.from_triple(TRIPLES[system])
    return target.create_target_machine(cpu=PROCESSOR, opt=3, reloc="pic", codemodel="default")


def is_compilable(kernel: ModuleType, entry: str) -> bool:
    """Return whether a function can be compiled: for duals, a part of the user's own may use operations without derivative."""
    try:
        _overload(kernel, entry)
    except NumbaError:
        return False
    return True
