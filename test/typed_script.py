"""A user's script that only mypy runs: the public names have complete types."""

from typing import assert_type

import numpy as np
from numpy.typing import NDArray

import ehls_ros as ehls

rig = assert_type(ehls.rig("rig_paper"), ehls.Rig)
read = assert_type(ehls.load("x.csv", {"position_m": {"name": "x", "unit": "mm"}}), ehls.Recording)
assert_type(read["force_n"], NDArray[np.float64])
run = assert_type(ehls.simulate("sine_fd2", rig=rig, duration=2.0, controller={"name": "fasmc", "k": 3.0}), ehls.Simulation)
assert_type(run.metrics.max_error_n, float)
assert_type(run.spec, ehls.Spec)
found = assert_type(ehls.diagnose(read, rig, baseline=[run, "old.csv"]), ehls.DiagnosisResult)
seen = assert_type(ehls.monitor([read, run], rig, limits={"coulomb_force": 800.0}), ehls.MonitorResult)
assert_type(found.causes[0].parameters["offset"], ehls.Estimate)
assert_type(found.extended, ehls.Rig)
friction = assert_type(ehls.identify([read, "slow.csv"], "rig.yaml", elements=3), ehls.FrictionResult)
whole = assert_type(ehls.identify("slow.csv", rig, whole_rig=True), ehls.RigResult)
assert_type(whole.estimates["plant.moving_mass"].std, float)
table = assert_type(ehls.campaign({"base": run.spec, "vary": {"controller.k": [6.0, 12.0]}}, jobs=1), ehls.CampaignResult)
assert_type(table.max_error_n, NDArray[np.float64])
