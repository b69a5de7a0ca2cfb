"""Every companion with every law: it runs, or is refused before the run with the reason."""

import inspect
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ehls_ros.control.companions import COMPANIONS
from ehls_ros.control.controllers import CONTROLLERS
from ehls_ros.control.controllers.base import model_of
from ehls_ros.control.learning.smoothing import PreviewLaw
from ehls_ros.errors import BadInput
from ehls_ros.experiments.loop import run_in_process
from ehls_ros.experiments.spec import Spec, company_of, spec_from_mapping

CONFIG = Path(__file__).parents[2] / "config"

PERIOD = 0.25
"""Period of the load cycle, of which a run has six [s]."""

PAIRS = [
    pytest.param(companion, law, id=f"{companion}-{law}") for companion in COMPANIONS.names() for law in CONTROLLERS.names()
]


def spec_of(companion: str, law: str) -> Spec:
    """Return a short experiment with a companion, whose load cycles repeat if it has a period."""
    repeats: dict[str, Any] = {"period": PERIOD} if "period" in COMPANIONS.load(companion).Parameters._fields else {}
    data = {
        "rig": "rig_paper.yaml",
        "known_effects": ["coupling_stiffness"],
        "duration": 6.0 * PERIOD,
        "reference": {"name": "sine", "amplitude": 500.0, "frequency": 1.0 / PERIOD},
        "disturbance": {"name": "position_servo", "signal": {"name": "sine", "amplitude": 0.01, "frequency": 1.0 / PERIOD}},
        "controller": {"name": law},
        "companions": [{"name": companion, **repeats}],
    }
    return spec_from_mapping(data, "pair", CONFIG)


def ready(companion: str, law: str) -> Spec | str:
    """Return the experiment once its companion is built, or the reason for refusing the pair."""
    try:
        spec = spec_of(companion, law)
        company_of(spec, model_of(spec.controller_rig, spec.settings.control_period), "pair")
    except BadInput as error:
        return str(error)
    return spec


@pytest.mark.parametrize(("companion", "law"), PAIRS)
def test_a_pair_is_accepted_or_refused_with_both_names(companion: str, law: str):
    found = ready(companion, law)
    if isinstance(found, str):
        assert companion in found
        assert law in found
    else:
        assert CONTROLLERS.load(law).FOLLOWS == "force"


@pytest.mark.parametrize("law", CONTROLLERS.names())
def test_a_law_with_a_filter_says_what_it_assumes_as_smoothers_ask(law: str):
    """A smoother runs the law's filter; one with different arguments ended the first cycle in a compiler error."""
    assumptions = getattr(CONTROLLERS.load(law), "assumptions", None)
    if assumptions is None:
        pytest.skip("it has no filter")
    asked = list(inspect.signature(PreviewLaw.assumptions).parameters)[1:]
    assert list(inspect.signature(assumptions.py_func).parameters) == asked


@pytest.mark.long
@pytest.mark.parametrize(("companion", "law"), PAIRS)
def test_an_accepted_pair_runs(companion: str, law: str):
    spec = ready(companion, law)
    if isinstance(spec, str):
        pytest.skip(spec)
    assert np.all(np.isfinite(run_in_process(spec).signals["force_error_n"]))
