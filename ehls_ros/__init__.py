"""Electro-hydraulic load simulator: plant, friction, force control and the ROS 2 graph around them.

For scripts and notebooks, ``import ehls_ros as ehls``: the names in ``__all__`` are stable, everything else may change. A name
is loaded when it is first used, so that the import costs nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ehls_ros.api.campaign import CampaignResult, campaign
    from ehls_ros.api.control import SteppedController, SteppedPlant, controller, plant
    from ehls_ros.api.diagnosis import DiagnosisResult, diagnose
    from ehls_ros.api.identification import FrictionResult, RigResult, identify
    from ehls_ros.api.monitoring import MonitorResult, monitor
    from ehls_ros.api.recordings import Recording, load
    from ehls_ros.api.simulation import Simulation, rig, save_rig, simulate
    from ehls_ros.api.tuning import TuningResult, tune
    from ehls_ros.api.verification import VerificationResult, verify
    from ehls_ros.errors import BadInput, WorkFailed
    from ehls_ros.estimate import Estimate
    from ehls_ros.experiments.metrics import Metrics, evaluate
    from ehls_ros.experiments.spec import Spec
    from ehls_ros.physics.rig import Rig
    from ehls_ros.physics.simulator import Simulator

__version__ = "0.2.0"

__all__ = [
    "BadInput",
    "CampaignResult",
    "DiagnosisResult",
    "Estimate",
    "FrictionResult",
    "Metrics",
    "MonitorResult",
    "Recording",
    "Rig",
    "RigResult",
    "Simulation",
    "Simulator",
    "Spec",
    "SteppedController",
    "SteppedPlant",
    "TuningResult",
    "VerificationResult",
    "WorkFailed",
    "campaign",
    "controller",
    "diagnose",
    "evaluate",
    "identify",
    "load",
    "monitor",
    "plant",
    "rig",
    "save_rig",
    "simulate",
    "tune",
    "verify",
]

_HOME = {
    "ehls_ros.api.campaign": ("CampaignResult", "campaign"),
    "ehls_ros.api.control": ("SteppedController", "SteppedPlant", "controller", "plant"),
    "ehls_ros.api.diagnosis": ("DiagnosisResult", "diagnose"),
    "ehls_ros.api.identification": ("FrictionResult", "RigResult", "identify"),
    "ehls_ros.api.monitoring": ("MonitorResult", "monitor"),
    "ehls_ros.api.recordings": ("Recording", "load"),
    "ehls_ros.api.simulation": ("Simulation", "rig", "save_rig", "simulate"),
    "ehls_ros.api.tuning": ("TuningResult", "tune"),
    "ehls_ros.api.verification": ("VerificationResult", "verify"),
    "ehls_ros.errors": ("BadInput", "WorkFailed"),
    "ehls_ros.estimate": ("Estimate",),
    "ehls_ros.experiments.metrics": ("Metrics", "evaluate"),
    "ehls_ros.experiments.spec": ("Spec",),
    "ehls_ros.physics.rig": ("Rig",),
    "ehls_ros.physics.simulator": ("Simulator",),
}
"""The public names by module."""


def __getattr__(name: str) -> Any:
    for module, names in _HOME.items():
        if name in names:
            return getattr(import_module(module), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return [*globals(), *__all__]
