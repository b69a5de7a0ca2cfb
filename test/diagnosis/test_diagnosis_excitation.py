"""Sizes that would show, of effects that do not grow in proportion to their size."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from plain_evidence import candidate

from ehls_ros.diagnosis import excitation
from ehls_ros.diagnosis.excitation import Direction, beyond_allowances


@pytest.fixture
def told(monkeypatch):
    """Return the size told for an effect whose change of the only residual is a function of its size, and shows from 1."""

    def size(change, largest):
        evidence = SimpleNamespace(
            rig=None,
            residuals=lambda comparison, model: SimpleNamespace(values={"force": np.array([change(model)])}),
            base=SimpleNamespace(values={"force": np.zeros(1)}),
            whole=lambda channel, values: values,
        )
        monkeypatch.setattr(excitation, "extended", lambda rig, hypothesis, values: float(values[0]))
        monkeypatch.setattr(excitation, "_shown_from", lambda evidence, per_size, *_: 1.0 / max(per_size["force"][0], 1e-300))
        cause = candidate("valve_dead_zone", "positive", lower=0.0, upper=largest)
        direction = Direction(cause, (0,), np.zeros(1), np.ones(1), {"force": np.ones(1)}, known=0.5)
        return beyond_allowances(evidence, None, direction, 1.0, {}, {})

    return size


def test_a_size_is_told_where_the_change_grows_like_a_power_of_it(told):
    assert told(lambda size: (size / 3.0) ** 2, 100.0) == pytest.approx(3.0, rel=0.2)


def test_a_size_beyond_a_threshold_is_told(told):
    assert 3.0 <= told(lambda size: max(size - 2.0, 0.0), 30.0) < 3.0 * 30.0 ** (1.0 / 16.0)


def test_a_size_beyond_the_range_is_told_where_none_of_it_shows(told):
    assert told(lambda size: max(size - 2.0, 0.0), 2.5) > 2.5


@pytest.mark.parametrize("change", [lambda size: math.copysign(10.0, size), lambda size: float(size >= 30.0)])
def test_no_size_is_told_of_an_effect_that_begins_abruptly_or_only_at_the_end_of_its_range(told, change):
    assert told(change, 30.0) is None
