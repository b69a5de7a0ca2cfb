"""Contents of ``identification.json`` for a result."""

import json

import numpy as np
from made_motions import PowerCoordinates, motion

from ehls_ros.estimate import Estimate
from ehls_ros.identification.joint import JointFit
from ehls_ros.identification.result import Identification, to_json


def test_the_json_has_the_promised_keys():
    made = motion(np.ones(3), name="sweep.csv")
    fit = JointFit(
        coordinates=PowerCoordinates(),
        z=np.zeros(2),
        free=("level",),
        limited=(),
        linear_names=("constant",),
        linear=np.ones(1),
        covariance=np.eye(2),
        cost=12.5,
        blocks=3.0,
        noise=(0.7,),
        residuals=(np.zeros(3),),
    )
    rig = type("Rig", (), {"friction_model": "power law"})
    found = Identification(
        rig=rig,  # type: ignore[arg-type]
        estimates={"level": Estimate(100.0, 0.5, "N"), "gravity": Estimate(9.81, 0.01, "m/s^2")},
        correlations=np.array([[1.0, 0.25], [0.25, 1.0]]),
        not_identifiable=("viscous_damping",),
        remarks=("A sentence.",),
        static=None,
        branch=None,
        nodes=(),
        criteria={1: 3.0, 2: 1.0},
        fit=fit,
        motions=(made,),
        method="pso",
        wall_s=1.5,
        understated={"level": 2.5},
    )
    written = json.loads(json.dumps(to_json(found)))
    assert written == {
        "parameters": {
            "level": {"value": 100.0, "std": 0.5, "unit": "N"},
            "gravity": {"value": 9.81, "std": 0.01, "unit": "m/s^2"},
        },
        "understated": {"level": 2.5},
        "correlations": {"names": ["level", "gravity"], "matrix": [[1.0, 0.25], [0.25, 1.0]]},
        "not_identifiable": ["viscous_damping"],
        "remarks": ["A sentence."],
        "missing": [],
        "elements": 0,
        "criteria": {"1": 3.0, "2": 1.0},
        "method": "pso",
        "cost": 12.5,
        "noise_n": {"sweep.csv": 0.7},
        "wall_s": 1.5,
    }
