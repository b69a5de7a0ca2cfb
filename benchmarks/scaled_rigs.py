"""The laws' default tuning on rigs of other sizes: area, mass, volume, flow, friction and stiffness n times the paper's.

    python -m benchmarks.scaled_rigs [--sizes 0.1 1 10]

Reference and disturbance are n times as large too, so the error over n would be the same if the tuning followed the rig.
Besides the defaults for the rig, each law runs with the numbers of the paper's rig given explicitly, which are not scaled. The
two laws with a filter run on the rig with sensors, with a command delay of 1 ms, against the position servo.
"""

from pathlib import Path
from typing import Any

from benchmarks.common import parser_of, print_heading, print_row
from ehls_ros.control.controllers import CONTROLLERS
from ehls_ros.experiments.files import config_folder
from ehls_ros.experiments.loop import run_in_process
from ehls_ros.experiments.metrics import Metrics, evaluate
from ehls_ros.experiments.run_failure import Implausible
from ehls_ros.experiments.spec import Spec, load_rig, spec_from_mapping
from ehls_ros.physics.rig import Rig, rig_to_mapping

EXTENSIVE = (
    "piston_area", "moving_mass", "total_volume", "valve_area_gradient", "leakage_coefficient", "spring_stiffness",
    "viscous_damping",
)  # fmt: skip
"""Coefficients of the plant that grow with the rig; pressures, times and the stroke do not."""

SLIDING = ("coulomb_force", "static_force", "viscous_coefficient", "attraction_rate")
"""Those of the friction; the elements' stiffness grows too."""

FORCE, DISTURBANCE = 10e3, 8e3
"""Amplitudes on the paper's rig [N]; the disturbance is above fd2's 5 kN, so that on ten times the rig D exceeds 50 kN."""


def similar(rig: Rig, size: float) -> Rig:
    """Return a rig that is ``size`` times as large."""
    plant, friction = rig.plant, rig.friction
    force = rig.sensors.get("force")
    sensors = dict(rig.sensors)
    if force is not None:
        sensors["force"] = force._replace(noise_std=size * force.noise_std, resolution=size * force.resolution)
    return rig._replace(
        plant=plant._replace(**{name: size * getattr(plant, name) for name in EXTENSIVE}),
        friction=friction._replace(
            element_stiffness=tuple(size * each for each in friction.element_stiffness),
            **{name: size * getattr(friction, name) for name in SLIDING},
        ),
        sensors=sensors,
        limits=rig.limits._replace(force=size * rig.limits.force),
    )


def case(law: str, size: float, duration: float = 10.0, **tuning: Any) -> Spec:
    """Return the experiment of a law on a rig.

    Args:
        law: name of the controller.
        size: of the rig over the paper's.
        duration: of the run [s].
        **tuning: parameters of the law in place of the defaults for the rig.
    """
    filtered = law != "fasmc"
    rig = similar(load_rig(config_folder() / ("rig_paper_measured.yaml" if filtered else "rig_paper.yaml")), size)
    force = {"name": "force", "signal": {"name": "sine", "amplitude": size * DISTURBANCE, "frequency": 1.0}}
    servo = {"name": "position_servo", "signal": {"name": "sine", "amplitude": 0.125, "frequency": 0.25}}
    told = {"effects": [{"name": "command_delay", "delay": 1e-3}], "known_effects": ["command_delay", "coupling_stiffness"]}
    return spec_from_mapping(
        {
            "title": f"{law} on {size:g} times the paper's rig",
            "duration": duration,
            "rig": rig_to_mapping(rig),
            "reference": {"name": "sine", "amplitude": size * FORCE, "frequency": 0.5},
            "disturbance": servo if filtered else force,
            "controller": {"name": law, **tuning},
            **(told if filtered else {}),
        },
        law,
        Path(),
    )


def largest(spec: Spec) -> Metrics | None:
    """Run an experiment; None if it reached physically impossible values."""
    try:
        return evaluate(run_in_process(spec))
    except Implausible:
        return None


def main() -> None:
    """Print the table."""
    parser = parser_of(__doc__)
    parser.add_argument("--sizes", type=float, nargs="+", default=[0.1, 1.0, 10.0], help="of the rigs over the paper's")
    sizes = parser.parse_args().sizes
    print_heading("largest error, last half, N", *(f"{size:g} ×" for size in sizes))
    for law in ("fasmc", "fasmc_output_feedback", "fasmc_predictive"):
        typed = CONTROLLERS.load(law).Parameters()._asdict()
        for words, tuning in (("defaults for the rig", {}), ("the paper's rig's numbers", typed)):
            found = [largest(case(law, size, **tuning)) for size in sizes]
            print_row(f"{law}, {words}", *("lost" if m is None else f"{m.max_error_n:.4g}" for m in found))
            for size, metrics in zip(sizes, found, strict=True):
                for warning in () if metrics is None else metrics.warnings:
                    print(f"    {size:g}: {warning}")


if __name__ == "__main__":
    main()
