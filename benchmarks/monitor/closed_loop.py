"""Effects that begin while the adaptive controller runs, in the package's simulator.

truth_generator has a separate controller, which does not adapt. Here FASMC runs, whose disturbance estimate absorbs the change
of the rig; the plant is the package's, so that the loop is tested and not the physics.
"""

import time
import traceback
from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks.common import EXPERIMENTS, MEASURED_RIG
from benchmarks.diagnosis.cases import rig
from benchmarks.monitor.hidden import AFTER, OFFLINE, ONSET, offline, shortest, watch
from benchmarks.monitor.streams import Rng, part
from benchmarks.monitor.watching import Timed, powers
from ehls_ros.experiments.loop import run_in_stretches
from ehls_ros.experiments.monitoring.monitor import Monitor, Parameters
from ehls_ros.experiments.spec import Spec, load_spec
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.rig import EffectUse, Rig
from ehls_ros.trajectory import Trajectory

EXPERIMENT = EXPERIMENTS / "irregular_fd2.yaml"
SEEN = ("valve_command_m", "spool_m", "load_pressure_pa", "supply_pressure_pa", "position_m", "velocity_m_s", "force_n",
        "disturbance_force_n", "oil_temperature_k")  # fmt: skip
"""Signals given to the monitor, as in truth_generator's recordings."""

Sizes = dict[str, float]


def _between(rng: Rng, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _signed(rng: Rng, low: float, high: float) -> float:
    return _between(rng, low, high) * (1.0 if rng.random() < 0.5 else -1.0)


SIZES: dict[str, Callable[[Rng, Rig], Sizes]] = {
    "bulk_modulus_shift": lambda rng, of: {"factor": 1.0 / _between(rng, 1.15, 3.0)},
    "constant_load": lambda rng, of: {"force": _signed(rng, 20.0, 500.0)},
    "coulomb_asymmetry": lambda rng, of: {"offset": _signed(rng, 0.04, 0.4) * of.friction.coulomb_force},
    "coulomb_shift": lambda rng, of: {"offset": _signed(rng, 0.05, 0.6) * of.friction.coulomb_force},
    "entrained_air": lambda rng, of: {"chambers": _between(rng, 8e-3, 0.12)},
    "external_leakage": lambda rng, of: {"each": _between(rng, 1e-12, 2e-11)},
    "internal_leakage_shift": lambda rng, of: {"added": _between(rng, 0.3, 4.0) * of.plant.leakage_coefficient},
    "mass_shift": lambda rng, of: {"factor": 1.0 + _signed(rng, 0.05, 0.5)},
    "pressure_dependent_friction": lambda rng, of: {"slope": _between(rng, 2e-5, 2e-4)},
    "spring_rate_shift": lambda rng, of: {"added": _signed(rng, 0.01, 0.4) * of.plant.spring_stiffness},
    "turbulent_leakage": lambda rng, of: {"coefficient": _between(rng, 1e-9, 2e-8)},
    "valve_bandwidth_shift": lambda rng, of: {"factor": 1.0 / _between(rng, 1.1, 2.5)},
    "valve_dead_zone": lambda rng, of: dict.fromkeys(("positive", "negative"), _between(rng, 5e-6, 6e-5)),
    "valve_gain_asymmetry": lambda rng, of: {"command_positive": _signed(rng, 0.02, 0.3)},
    "valve_gain_shift": lambda rng, of: {"gain": 1.0 + _signed(rng, 0.02, 0.4)},
    "valve_hysteresis": lambda rng, of: {"width": _between(rng, 3e-6, 8e-5)},
    "valve_null_bias": lambda rng, of: {"command": _signed(rng, 3e-6, 1e-4)},
    "viscous_asymmetry": lambda rng, of: {"asymmetry": _signed(rng, 0.03, 0.4) * of.friction.viscous_coefficient},
    "viscous_shift": lambda rng, of: {"added": _signed(rng, 0.03, 0.5) * of.friction.viscous_coefficient},
}
"""Draws the sizes of effects that can begin within a run: those of the plant without additional states."""


def spec_of(rng: Rng, seed: int, of: Rig, duration: float) -> Spec:
    """Return an experiment under the adaptive controller, against a disturbance.

    Args:
        rng: draws reference and disturbance.
        seed: of the noise.
        of: the rig in the loop; the controller has the one of the rig file.
        duration: its duration [s].
    """
    spec = load_spec(EXPERIMENT, MEASURED_RIG)
    reference = spec.reference.parameters._replace(amplitude=rng.uniform(3e3, 6e3), seed=int(rng.integers(2**31)))
    signal = spec.disturbance.signal
    moved = signal.parameters._replace(amplitude=rng.uniform(0.5e3, 2e3), frequency=rng.uniform(0.3, 1.2))
    return spec._replace(
        rig=of,
        controller_rig=rig(),
        settings=spec.settings._replace(duration=duration, seed=seed),
        reference=spec.reference._replace(parameters=reference),
        disturbance=spec.disturbance._replace(signal=signal._replace(parameters=moved)),
    )


def with_effect(name: str, sizes: Sizes) -> Rig:
    """Return the rig with an effect; without sizes, one of no size."""
    given = rig()
    return given._replace(effects=(*given.effects, EffectUse(name, EFFECTS.load(name).Parameters()._replace(**sizes))))


def recorded(spec: Spec, later: Rig) -> Trajectory:
    """Run an experiment whose rig changes to another one."""
    found = [
        (stretch.time_s.copy(), {name: stretch.signals[name].copy() for name in SEEN if name in stretch.signals})
        for stretch in run_in_stretches(spec, [(ONSET, later)])
    ]
    signals = {name: np.concatenate([signals[name] for _, signals in found]) for name in found[0][1]}
    return Trajectory(np.concatenate([time_s for time_s, _ in found]), signals)


def run(seed: int, number: int) -> dict[str, Any]:
    """Watch a rig in closed loop in which an effect begins.

    Returns:
        The result, JSON-compatible.
    """
    row: dict[str, Any] = {"seed": seed, "number": number, "onset": ONSET, "experiment": "closed loop"}
    began = time.perf_counter()
    try:
        rng = np.random.default_rng([seed, number, 23])
        order = np.random.default_rng([seed, number // len(SIZES), 24]).permutation(len(SIZES))
        name = sorted(SIZES)[int(order[number % len(SIZES)])]
        sizes = SIZES[name](rng, rig())
        row |= {"effect": name, "hidden": sizes}
        spec = spec_of(rng, int(rng.integers(2**31)), with_effect(name, {}), ONSET + AFTER)
        recording = recorded(spec, with_effect(name, sizes))
        row["offline"] = offline(part(recording, ONSET, ONSET + OFFLINE))
        row["bound"] = shortest(recording, ONSET, name, OFFLINE) if name in row["offline"] else None
        examiner = Timed()
        row["alarms"] = watch(recording, ONSET, Monitor(rig(), Parameters(), examiner), examiner)
        row["powers"] = powers(recording, rig())
    except Exception:  # noqa: BLE001
        # An exception in one case is a result, and must not end a long run.
        row["error"] = traceback.format_exc(limit=-6)
    return row | {"wall_s": time.perf_counter() - began}
