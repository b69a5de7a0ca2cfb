"""Functions that are compiled only as parts of others."""

import math

import numpy as np
import pytest
from numba import njit

from ehls_ros.arrays import in_python, kernel, lean


@kernel
def stretched(x, factor):
    return factor * math.sin(x)


@kernel
def summed(values):
    total = 0.0
    for value in values:
        total += stretched(value, 1.0 / 3.0)
    return total


@lean
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
