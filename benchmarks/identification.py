"""Identification on simulated recordings with known friction: errors, their bound, and coverage of the intervals.

    python -m benchmarks.identification --seeds 50
    python -m benchmarks.identification --truth separate --repeats 1 --seeds 200

Each seed is a closed-loop sweep and a small sine with the sensors of config/rig_paper_measured.yaml, identified from a rig
file whose friction is a rough guess. The Cramér-Rao bound is that of the force sensor's white noise, at the truth; z is the
error in standard errors, whose root mean square should be 1.
"""

import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from typing import Any

import numpy as np

from benchmarks.common import CONFIG, parser_of
from ehls_ros.arrays import Array
from ehls_ros.control.friction_estimator import FrictionEstimator
from ehls_ros.experiments.loop import run_in_process, sampled
from ehls_ros.experiments.spec import load_rig, load_spec
from ehls_ros.identification.balance import Recorded
from ehls_ros.identification.covariance import normal_covariance
from ehls_ros.identification.identify import identify
from ehls_ros.identification.joint import JointFit, Problem, Start
from ehls_ros.identification.motion import Motion
from ehls_ros.identification.uncertainty import estimates
from ehls_ros.physics.friction.gms import Parameters as Friction
from ehls_ros.physics.rig import Rig
from ehls_ros.trajectory import Trajectory

TRUTHS = {
    "paper": {},
    "separate": {"element_stiffness": (3e6, 1e6, 3e5), "element_weight": (0.35, 0.35, 0.3)},
}
GUESS = {
    "coulomb_force": 500.0,
    "static_force": 600.0,
    "stribeck_velocity": 5e-3,
    "stribeck_exponent": 1.0,
    "viscous_coefficient": 5e3,
    "element_stiffness": (1e6,),
    "element_weight": (1.0,),
    "attraction_rate": 500.0,
}
HEADINGS = {
    "median |error|": 15,
    "largest": 10,
    "paper": 8,
    "std": 9,
    "CR bound": 10,
    "|err|/CRB": 10,
    "rms z": 8,
    "95 % holds": 11,
}
PAPER = {
    "coulomb_force": 3.45,
    "static_force": 2.26,
    "stribeck_velocity": 1.89,
    "stribeck_exponent": 3.62,
    "viscous_coefficient": 1.37,
}


def recordings(rig: Rig, seed: int, repeats: int) -> dict[str, Trajectory]:
    """Run both experiments."""
    out = {}
    for offset, name in enumerate(("friction_sweep_quick" if repeats == 1 else "friction_sweep", "friction_presliding")):
        spec = load_spec(CONFIG / "experiments" / f"{name}.yaml")
        settings = spec.settings._replace(seed=2 * seed + offset)
        run = run_in_process(spec._replace(settings=settings, rig=rig, controller_rig=rig))
        out[name] = Trajectory(run.time_s, {signal: run[signal] for signal in ("position_m", "force_n")})
    return out


def given(rig: Rig, seed: int, repeats: int) -> dict[str, Trajectory]:
    """Move the rod exactly along the reference, without feedback of the sensors' noise, and record it."""
    out = {}
    random = np.random.default_rng(seed)
    for name in ("friction_sweep_quick" if repeats == 1 else "friction_sweep", "friction_presliding"):
        spec = load_spec(CONFIG / "experiments" / f"{name}.yaml")
        period = spec.settings.control_period
        x, v, a = sampled(spec.reference, period).rows(0, spec.cycles).T
        estimator = FrictionEstimator("gms", rig, period)
        elements = np.array([estimator.update(speed)[0] for speed in v])
        p, f = rig.plant, rig.friction
        force = p.moving_mass * (a + p.gravity) + (p.viscous_damping + f.viscous_coefficient) * v + p.spring_stiffness * x
        signals = {}
        for signal, sensor, values in (("position_m", "position", x), ("force_n", "force", force + elements)):
            s = rig.sensors[sensor]
            signals[signal] = np.round((values + s.noise_std * random.standard_normal(len(v))) / s.resolution) * s.resolution
        out[name] = Trajectory(np.arange(len(v), dtype=np.float64) * period, signals)
    return out


def truth(friction: Friction, elements: int) -> dict[str, float]:
    """Return the true coefficients by the names of the estimates."""
    out = {name: float(getattr(friction, name)) for name in (*PAPER, "attraction_rate")}
    if elements == 1:
        out["element_stiffness_1"] = sum(friction.element_stiffness)
    if elements == len(friction.element_stiffness):
        for i in range(elements):
            out[f"element_stiffness_{i + 1}"] = friction.element_stiffness[i]
            out[f"element_weight_{i + 1}"] = friction.element_weight[i]
    return out


def least_covariance(fit: JointFit, motions: Sequence[Motion]) -> Array:
    """Return the Cramér-Rao bound of a fit's coefficients for the force sensor's white noise alone.

    Args:
        fit: the fit, for its coefficients and the fitted blocks.
        motions: its recordings.
    """
    recorded = Recorded(tuple(motions), tuple(np.isfinite(r) for r in fit.residuals), fit.linear_names)
    problem = Problem(recorded, Start(fit.coordinates, None, fit.free), fit.z, [m.force_noise for m in motions])
    return normal_covariance(problem.design(problem.free(fit.z)), len(fit.free))


def bound(found: Any, rig: Rig) -> dict[str, float]:
    """Return the Cramér-Rao bound of each coefficient for the force sensor's noise alone."""
    fit = found.fit
    covariance = least_covariance(fit, found.motions)
    return {name: e.std for name, e in estimates(fit._replace(covariance=covariance), rig).by_name.items()}


def one(kind: str, repeats: int, motion: str, seed: int) -> dict[str, Any]:
    """Record and identify once."""
    measured = load_rig(CONFIG / "rig_paper_measured.yaml")
    rig = measured._replace(friction=measured.friction._replace(**TRUTHS[kind]))
    data = (recordings if motion == "loop" else given)(rig, seed, repeats)
    guess = rig._replace(friction=rig.friction._replace(**GUESS))
    start = time.perf_counter()
    found = identify(data, guess)
    wall = time.perf_counter() - start
    elements = len(found.rig.friction.element_stiffness)
    true, least = truth(rig.friction, elements), bound(found, guess)
    rows = {
        name: (
            (found.estimates[name].value - value) / value,
            found.estimates[name].std / value,
            least.get(name, np.nan) / value,
        )
        for name, value in true.items()
        if name in found.estimates
    }
    return {"rows": rows, "elements": elements, "wall": wall}


def main() -> None:
    """Print the table."""
    parser = parser_of(__doc__)
    parser.add_argument("--seeds", type=int, default=50, help="how many (%(default)s)")
    parser.add_argument("--repeats", type=int, choices=(1, 6), default=6, help="repeats of the sweep (%(default)s)")
    parser.add_argument("--truth", choices=tuple(TRUTHS), default="paper", help="friction of the simulated rig (%(default)s)")
    parser.add_argument(
        "--motion",
        choices=("loop", "given"),
        default="loop",
        help="loop: a position loop moves the rod, shaken by its sensors' noise; given: the rod follows the reference exactly",
    )
    options = parser.parse_args()
    one(options.truth, 1, options.motion, 0)
    with ProcessPoolExecutor(mp_context=get_context("spawn")) as pool:
        runs = list(pool.map(partial(one, options.truth, options.repeats, options.motion), range(options.seeds)))
    counts = [run["elements"] for run in runs]
    print(f"{options.truth} friction, motion {options.motion}, {options.repeats} repeats, {options.seeds} seeds")
    print("elements found: " + ", ".join(f"{n} in {counts.count(n)} runs" for n in sorted(set(counts))))
    walls = [run["wall"] for run in runs]
    print(f"identification: median {np.median(walls):.1f} s, {min(walls):.1f} to {max(walls):.1f} s")
    print(f"{'':24s}" + "".join(f"{heading:>{width}s}" for heading, width in HEADINGS.items()))
    for name in dict.fromkeys(name for run in runs for name in run["rows"]):
        error, std, least = np.array([run["rows"][name] for run in runs if name in run["rows"]]).T
        held = np.mean(np.abs(error) <= 1.96 * std)
        print(
            f"{name:24s}{100 * np.median(np.abs(error)):13.4f} %{100 * np.max(np.abs(error)):8.3f} %"
            f"{PAPER.get(name, np.nan):8.2f}{100 * np.median(std):7.3f} %{100 * np.median(least):8.4f} %"
            f"{np.median(np.abs(error) / least):10.2f}{np.sqrt(np.mean((error / std) ** 2)):8.2f}{100 * held:9.0f} %"
        )


if __name__ == "__main__":
    main()
