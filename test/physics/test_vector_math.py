"""Exponentials and logarithms in plain arithmetic, against those of the C library."""

import math

import numpy as np
import pytest
from numba import njit

from ehls_ros.numba_internals import Inlined
from ehls_ros.physics import vector_math
from ehls_ros.physics.friction import FRICTION_MODELS
from ehls_ros.physics.rig import rig_from_mapping

COUNT = 4000


@njit(error_model="numpy")
def values(x, exponents, out):
    for i in range(x.size):
        out[0, i] = vector_math.exp2(x[i])
        out[1, i] = vector_math.exp(x[i])
        out[2, i] = vector_math.log2(x[i])
        out[3, i] = vector_math.stretched_decay(x[i], exponents[i])


def computed(x, exponents=None):
    out = np.empty((4, len(x)))
    values(np.asarray(x, dtype=np.float64), np.ones(len(x)) if exponents is None else exponents, out)
    return out


def ulps(found, exact):
    return np.max(np.abs(found - exact) / np.spacing(np.abs(exact)))


def test_powers_are_within_two_units_in_the_last_place():
    x = np.concatenate([np.linspace(-700.0, 700.0, COUNT), np.linspace(-1.0, 1.0, COUNT)])
    # One more for the reference's own rounding.
    assert ulps(computed(x)[0], np.exp2(x)) <= 3.0
    assert ulps(computed(x)[1], np.exp(x)) <= 3.0


def test_logarithms_are_within_three_units_in_the_last_place():
    x = np.concatenate([np.exp2(np.linspace(-1000.0, 1000.0, COUNT)), np.linspace(0.5, 2.0, COUNT)])
    assert ulps(computed(x)[2], np.log2(x)) <= 4.0


def test_the_decay_of_the_stribeck_curve_is_exact_to_the_rounding():
    random = np.random.default_rng(7)
    x, exponents = 10.0 ** random.uniform(-8.0, 2.0, COUNT), random.uniform(0.01, 4.0, COUNT)
    expected = [math.exp(-(a**b)) for a, b in zip(x, exponents, strict=True)]
    np.testing.assert_allclose(computed(x, exponents)[3], expected, rtol=0.0, atol=4e-16)
    in_python = [vector_math.stretched_decay(*pair) for pair in zip(x, exponents, strict=True)]
    np.testing.assert_allclose(computed(x, exponents)[3], in_python, rtol=0.0, atol=4e-16)


def test_the_decay_called_from_python_is_the_compiled_one():
    x, exponents = np.meshgrid([0.0, 1e-8, 0.3, 1.0, 7.0, 1e300, math.inf], [0.01, 1.0, 2.0, 4.0])
    called = [vector_math.stretched_decay(a, b) for a, b in zip(x.ravel().tolist(), exponents.ravel().tolist(), strict=True)]
    np.testing.assert_allclose(called, computed(x.ravel(), exponents.ravel())[3], rtol=0.0, atol=4e-16)


@pytest.mark.parametrize("model", FRICTION_MODELS.names())
def test_a_rigs_friction_level_compiles_nothing(rig_data, monkeypatch, model):
    def compiling(inlined):
        pytest.fail(f"{inlined.py_func.__qualname__} is compiled")

    monkeypatch.setattr(Inlined, "_from_python", property(lambda inlined: inlined._python or compiling(inlined)))
    rig = rig_from_mapping({**rig_data, "friction": {**rig_data["friction"], "model": model}}, "rig.yaml")
    assert rig.friction_level(0.0) >= rig.friction_level(math.inf) > 0.0


def test_what_has_no_number_stays_what_it_is():
    exp2, exp, log2, decay = computed([0.0, math.inf, math.nan])
    assert exp2[0] == exp[0] == decay[0] == 1.0
    assert log2[0] == -math.inf
    assert log2[1] == math.inf
    # Clipped to normal numbers.
    assert exp2[1] == pytest.approx(2.0**1023)
    assert decay[1] == pytest.approx(0.0, abs=1e-300)
    assert np.isnan([exp2[2], exp[2], log2[2], decay[2]]).all()
