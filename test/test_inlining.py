"""Functions that are compiled only as parts of others, and the work that this saves numba."""

import gc
import math
import os
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import numba
import numpy as np
import pytest
from numba import njit, types

from ehls_ros import inlining
from ehls_ros.arrays import copy, in_python, kernel, kernel_no_refcount
from ehls_ros.inlining import faster_compilation

ROOT = Path(__file__).resolve().parent.parent


@kernel
def stretched(x, factor):
    return factor * math.sin(x)


@kernel
def summed(values):
    total = 0.0
    for value in values:
        total += stretched(value, 1.0 / 3.0)
    return total


@kernel_no_refcount
def running(values, out):
    for i in range(values.size):
        out[i] = summed(values[: i + 1])


@njit(error_model="numpy")
def plain_stretched(x, factor):
    return factor * math.sin(x)


@njit(error_model="numpy")
def plain_running(values, out):
    for i in range(values.size):
        total = 0.0
        for value in values[: i + 1]:
            total += plain_stretched(value, 1.0 / 3.0)
        out[i] = total


@pytest.fixture
def values():
    return np.random.default_rng(1).standard_normal(200)


@njit(error_model="numpy")
def entry(values, out):
    running(values, out)


def test_inlined_code_computes_what_numba_alone_computes_to_the_last_bit(values):
    ours, theirs = np.empty(values.size), np.empty(values.size)
    entry(values, ours)
    plain_running(values, theirs)
    assert np.array_equal(ours, theirs)


def test_it_leaves_no_function_behind_in_the_code_that_calls_it(values):
    entry(values, np.empty(values.size))
    [code] = entry.inspect_asm().values()
    calls = {line.split()[-1] for line in code.splitlines() if "call" in line.split()[:1]}
    assert not any("stretched" in call or "summed" in call or "running" in call for call in calls)


def test_it_makes_no_machine_code_of_its_own(values):
    entry(values, np.empty(values.size))
    engine = next(iter(entry.overloads.values())).library.codegen._engine
    names = [result.fndesc.llvm_func_name for f in (stretched, summed, running) for result in f.overloads.values()]
    assert names
    assert not any(engine.is_symbol_defined(name) for name in names)
    assert all(engine.is_symbol_defined(result.fndesc.llvm_func_name) for result in entry.overloads.values())


def test_it_can_be_called_from_python_and_read_as_python(values):
    assert summed(values) == pytest.approx(np.sum(np.sin(values)) / 3.0, rel=1e-12)
    assert in_python(stretched)(0.5, 2.0) == 2.0 * math.sin(0.5)


def test_a_mistake_in_the_types_is_told_where_it_is():
    @njit
    def wrong():
        return stretched("a", 1.0)

    with pytest.raises(Exception, match="stretched"):
        wrong()


def cubed(x, y):
    return x * x * x + y * y * y


def instructions(function):
    """Return the instructions of a function compiled for two floats, without their operands."""
    compiled = njit(error_model="numpy")(function)
    compiled.compile((types.float64, types.float64))
    [code] = compiled.inspect_asm().values()
    return [line.split()[0] for line in code.splitlines() if line.startswith("\t") and line[1] != "."]


def test_faster_compilation_gives_the_same_machine_code_and_asks_numba_once(monkeypatch):
    asked = []
    find = types.Function.__mro__[1].get_call_type

    def counted(function, context, arguments, keywords):
        asked.append((function, tuple(arguments)))
        return find(function, context, arguments, keywords)

    monkeypatch.setattr(types.Function.__mro__[1], "get_call_type", counted)
    plain = instructions(cubed)
    assert len(asked) > len(set(asked))
    asked.clear()
    with faster_compilation():
        swift = instructions(cubed)
    assert len(asked) == len(set(asked)) == 2
    assert swift == plain


def test_numba_and_the_garbage_collector_are_left_as_they_were():
    def fail():
        with faster_compilation(), faster_compilation():
            assert not gc.isenabled()
            raise KeyError

    assert gc.isenabled()
    with pytest.raises(KeyError):
        fail()
    assert gc.isenabled()
    assert "get_call_type" not in vars(types.Function)
    gc.disable()
    try:
        with faster_compilation():
            pass
        assert not gc.isenabled()
    finally:
        gc.enable()


def test_arrays_are_copied(values):
    target = np.empty(values.size)
    copy(values, target)
    assert np.array_equal(target, values)


def test_scipy_is_imported_only_by_code_that_needs_it():
    code = """
import sys
import numpy as np
from numba import njit
from ehls_ros.inlining import skip_scipy_check
skip_scipy_check()
assert njit(lambda x: 2.0 * x)(2.0) == 4.0
print("scipy.linalg" in sys.modules)
assert njit(lambda a, b: np.dot(a, b))(np.ones(3), np.ones(3)) == 3.0
print("scipy.linalg" in sys.modules)
"""
    assert subprocess.check_output([sys.executable, "-c", code], text=True) == "False\nTrue\n"


def test_numbas_internals_are_as_known():
    assert inlining.incompatibilities() == []
    assert not inlining.IS_PLAIN


@pytest.mark.parametrize(("module", "name", "parameters"), inlining.INTERNALS)
def test_a_missing_or_changed_internal_is_named(monkeypatch, module, name, parameters):
    *path, last = name.split(".")
    owner = import_module(module)
    for step in path:
        owner = getattr(owner, step)

    def changed(more):
        pass

    monkeypatch.setattr(owner, last, changed)
    assert inlining.incompatibilities() == [f"{module}.{name} is missing or changed"]
    monkeypatch.setattr(owner, last, None)
    assert inlining.incompatibilities() == [f"{module}.{name} is missing or changed"]


def test_versions_beyond_those_tested_are_left_alone(monkeypatch):
    monkeypatch.setattr(numba, "__version__", "0.69.0")
    assert inlining.incompatibilities() == ["version 0.69.0 is not tested"]
    assert f'"numba{inlining.TESTED}"' in (ROOT / "pyproject.toml").read_text(encoding="utf-8")


def in_plain_numba(code):
    environment = {**os.environ, inlining.PLAIN: "1", "PYTHONPATH": f"{ROOT}{os.pathsep}{ROOT / 'test'}"}
    return subprocess.check_output([sys.executable, "-c", code], text=True, env=environment, cwd=ROOT)


def test_plain_numba_computes_the_same_bits(values):
    out = np.empty(values.size)
    entry(values, out)
    code = """
import numpy as np
from test_inlining import entry, inlining
values = np.random.default_rng(1).standard_normal(200)
out = np.empty(values.size)
entry(values, out)
print(inlining.IS_PLAIN, out.tobytes().hex())
"""
    assert in_plain_numba(code) == f"True {out.tobytes().hex()}\n"


@pytest.mark.long
def test_plain_numba_simulates_the_same_trajectory():
    assert in_plain_numba(SIMULATION) == subprocess.check_output([sys.executable, "-c", SIMULATION], text=True, cwd=ROOT)


SIMULATION = """
from pathlib import Path
from ehls_ros.experiments.loop import run_in_process
from ehls_ros.experiments.spec import load_spec
spec = load_spec(Path("config/experiments/sine_fd2.yaml"))
trajectory = run_in_process(spec._replace(settings=spec.settings._replace(duration=0.2)))
print(len(trajectory), b"".join(signal.tobytes() for signal in trajectory.signals.values()).hex())
"""
