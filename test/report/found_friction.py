"""A small identification for tests of its report: made up, without a run along a recording."""

import numpy as np

from ehls_ros.estimate import Estimate
from ehls_ros.identification.elements import ElementCoordinates
from ehls_ros.identification.joint import JointFit
from ehls_ros.identification.motion import Motion
from ehls_ros.identification.optimisers.base import Result
from ehls_ros.identification.presliding import Branch, nodes
from ehls_ros.identification.result import Identification
from ehls_ros.identification.static import StaticFit
from ehls_ros.identification.stribeck import StaticFriction
from ehls_ros.physics.friction.gms import Parameters as Friction
from ehls_ros.physics.parameters import Limits, Plant
from ehls_ros.physics.rig import Rig

FRICTION = Friction(
    coulomb_force=640.0,
    static_force=865.0,
    stribeck_velocity=2e-3,
    stribeck_exponent=1.0,
    viscous_coefficient=7000.0,
    element_stiffness=(4e6, 1e6),
    element_weight=(0.6, 0.4),
    attraction_rate=1650.0,
)
SPRING, CONSTANT = 4e4, 700.0
SPEEDS = np.array([2e-3, 4e-3, 8e-3, 2e-2, 0.15])
STATIC_RESIDUAL, STATIC_DEVIATION = 0.6, 0.3
"""Residual [N] of the class at -4 mm/s, the only one, and standard deviation of every class."""

ESTIMATES = {
    "coulomb_force": Estimate(640.8058, 0.0074, "N"),
    "static_force": Estimate(865.0, 0.38, "N"),
    "stribeck_velocity": Estimate(2.0357e-3, 3.8e-6, "m/s"),
    "stribeck_exponent": Estimate(0.87776, 1.04e-3, "1"),
    "viscous_coefficient": Estimate(7264.98, 0.11, "N s/m"),
    "attraction_rate": Estimate(1642.3, 31.0, "N/s"),
    "element_stiffness_1": Estimate(4e6, 850.0, "N/m"),
    "element_weight_1": Estimate(0.6, 4e-4, "1"),
    "gravity": Estimate(-9.81, 1e-4, "m/s^2"),
}
ALIKE = "viscous_damping and viscous_coefficient act alike; only their sum is identified, and viscous_damping is kept."


def filled(kind, **given):
    """Return a named tuple whose other fields are zero."""
    return kind(**(dict.fromkeys(kind._fields, 0.0) | given))


def make_rig(friction=FRICTION):
    plant = filled(Plant, spring_stiffness=SPRING, viscous_damping=60.0, moving_mass=70.0, gravity=9.81)
    limits = Limits(spool=0.01, force=2e4, load_pressure=7e6, position=(-0.3, 0.3), velocity=2.0)
    return Rig(
        **(dict.fromkeys(Rig._fields) | {"plant": plant, "friction_model": "gms", "friction": friction, "limits": limits})
    )


def make_motion(name, position, velocity, force, *, period=0.1, outliers=0.0):
    size = len(position)
    return filled(
        Motion,
        name=name,
        period=period,
        time=(np.arange(size) + 0.5) * period,
        position=position,
        velocity=velocity,
        acceleration=np.zeros(size),
        force=force,
        fresh=np.arange(size) == 0,
        resolved=np.ones(size, dtype=bool),
        force_noise=0.2,
        velocity_noise=1e-6,
        outliers=outliers,
    )


def make_static(converged=True):
    velocity = np.concatenate([-SPEEDS[::-1], SPEEDS])
    level = 640.0 + 225.0 * np.exp(-np.abs(velocity) / 2e-3)
    force = np.sign(velocity) * level + (7000.0 + 60.0) * velocity
    force[np.isclose(velocity, -4e-3)] += STATIC_RESIDUAL
    advice = "" if converged else "allow more evaluations"
    return StaticFit(
        friction=StaticFriction(*FRICTION[:5]),
        linear={"spring": SPRING, "constant": CONSTANT},
        settle_time=0.2,
        velocity=velocity,
        force=force,
        deviation=np.full(len(velocity), STATIC_DEVIATION),
        search=Result(np.zeros(5), 12.5, 6400, np.array([np.inf, 1e6, 1e3, 12.5, 12.5]), converged, advice),
    )


def make_fit(residuals, friction=FRICTION):
    coordinates = ElementCoordinates(len(friction.element_stiffness))
    names = ("viscous", "spring", "constant")
    return JointFit(
        coordinates=coordinates,
        z=coordinates.pack(friction),
        free=coordinates.names,
        limited=(),
        linear_names=names,
        linear=np.array([7060.0, SPRING, CONSTANT]),
        covariance=np.eye(len(coordinates.names) + len(names)),
        cost=100.0,
        blocks=321.4,
        noise=tuple(0.3 * (1 + i) for i in range(len(residuals))),
        residuals=tuple(residuals),
    )


def make_motions(blocks=400):
    """A sweep and a small sine with their residuals; the sine's elements pull with 500 N against the motion."""
    phase = np.linspace(0.0, 8.0 * np.pi, blocks)
    sign = np.sign(np.cos(phase) + 1e-9)
    motions, residuals = [], []
    for name, size in (("sweep.csv", 0.2), ("sine.csv", 1.2e-3)):
        position, velocity = 0.05 + size * np.sin(phase), size * np.cos(phase)
        left = 0.25 * np.sin(37.0 * phase)
        left[: blocks // 4] = np.nan
        force = SPRING * position + CONSTANT + 7060.0 * velocity + 500.0 * sign + np.nan_to_num(left)
        motions.append(make_motion(name, position, velocity, force, outliers=0.0123 if size > 0.1 else 0.0))
        residuals.append(left)
    return motions, residuals


def make_branch():
    way = np.linspace(0.0, 2.4e-3, 50)
    return Branch(way, 1e3 * np.tanh(2e3 * way), 10)


def ends(friction=FRICTION):
    stiffness = np.array(friction.element_stiffness)
    return 2.0 * np.array(friction.element_weight) * friction.static_force / stiffness, stiffness


def make_found(**changed):
    """A complete result without uncertain coefficients; changes are fields by name."""
    motions, residuals = make_motions()
    correlations = np.eye(len(ESTIMATES))
    correlations[1, 2] = correlations[2, 1] = -0.9962
    correlations[0, 3] = correlations[3, 0] = 0.52
    correlations[0, 4] = correlations[4, 0] = 1e-3
    found = Identification(
        **(
            dict.fromkeys(Identification._fields)
            | {
                "rig": make_rig(),
                "estimates": dict(ESTIMATES),
                "correlations": correlations,
                "not_identifiable": ("viscous_damping",),
                "remarks": ("2 friction elements explain the loop (Bayesian information criterion …).", ALIKE),
                "static": make_static(),
                "branch": make_branch(),
                "nodes": tuple(nodes(*ends())),
                "criteria": {1: 912.3, 2: 3.0, 3: 9.4, 4: 1250.0},
                "fit": make_fit(residuals),
                "motions": tuple(motions),
                "method": "least_squares",
                "wall_s": 9.87,
            }
        )
    )
    return found._replace(**changed)


def without_presliding():
    """Result of a sweep alone."""
    motions, residuals = make_motions()
    names = [name for name in ESTIMATES if not name.startswith("element")]
    return make_found(
        estimates={name: ESTIMATES[name] for name in names},
        correlations=np.eye(len(names)),
        not_identifiable=("viscous_damping", "element_stiffness", "element_weight"),
        remarks=("No presliding is recorded: stiffness and weight of the elements are the rig file's.", ALIKE),
        branch=None,
        nodes=(),
        criteria={},
        fit=make_fit(residuals[:1]),
        motions=tuple(motions[:1]),
    )


def without_sliding():
    """Result of a small sine alone."""
    motions, residuals = make_motions()
    names = ["coulomb_force", "attraction_rate", "element_stiffness_1", "gravity"]
    return make_found(
        estimates={name: ESTIMATES[name] for name in names},
        correlations=np.eye(len(names)),
        not_identifiable=("viscous_coefficient", "viscous_damping", "stribeck_velocity"),
        remarks=("Nothing slides steadily.", "viscous_coefficient has a standard error of 74 %.", ALIKE),
        static=None,
        fit=make_fit(residuals[1:])._replace(noise=(0.6,)),
        motions=tuple(motions[1:]),
    )
