"""Rigs of one's own: the laws on rigs of many sizes, drawn from a seed, beside the causal limit of each.

    python -m benchmarks.own_rigs --seed 7 --count 60 --perfect     # the laws' defaults
    python -m benchmarks.own_rigs --seed 7 --count 12 --tune 3 20   # and the numbers that `ehls tune` finds

Forces over three decades, supplies of 100 and 200 bar, valves of 20 to 200 Hz, delays of 0 to 2 cycles, noise as data sheets
have it. The controller's rig file is right. The actuator under test is the position servo behind an elastic coupling; the error
is that of the true force, the largest of the last half.
"""

import math
import secrets
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.common import parser_of
from ehls_ros.control.margins import LoopMargins
from ehls_ros.experiments.spec import Spec, spec_from_mapping
from ehls_ros.experiments.stepped_run import stepped_run
from ehls_ros.experiments.tuning.loop_margins import margins_of
from ehls_ros.experiments.tuning.task import Task
from ehls_ros.experiments.tuning.tune import Wanted, causal_limit_of, tune

PERIOD = 1e-3
"""Control period [s]."""

LAWS = ("fasmc_predictive", "fasmc_output_feedback")

DECADES = (0.1, 1.0, 10.0)
"""Sizes of the rigs, forces over those of the paper's rig."""

SUPPLIES = (1e7, 2e7)
"""Supply pressures [Pa]."""

FORCE = 18e3
"""Largest force of a rig of size 1 [N]."""

LOST = 20.0
"""Error from which the force counts as lost, % of the reference's amplitude."""


class OwnRig(NamedTuple):
    """A drawn rig with its task.

    Attributes:
        content: its file, with the delay of the command and the coupling to the actuator under test.
        reference, disturbance: the task.
        amplitude: of the reference [N].
    """

    content: dict[str, Any]
    reference: dict[str, Any]
    disturbance: dict[str, Any]
    amplitude: float


def drawn(number: int, seed: int, *, perfect: bool = False) -> OwnRig:
    """Return a rig of the seed.

    Args:
        number: its number; sizes and supplies alternate.
        seed: the seed.
        perfect: whether its sensors are perfect.
    """
    random = np.random.default_rng([seed, number])

    def between(low: float, high: float) -> float:
        return float(math.exp(random.uniform(math.log(low), math.log(high))))

    size, supply = DECADES[number % 3], SUPPLIES[number // 3 % 2]
    force = FORCE * size * between(0.6, 1.6)
    area, stroke = force / supply, 0.3 * size ** (1.0 / 3.0) * between(0.5, 2.0)
    speed, modulus = between(0.2, 1.0), between(0.6e9, 1.4e9)
    volume = area * stroke * between(1.1, 2.0)
    oil_column = 2.0 * math.pi * between(30.0, 120.0)
    mass = 4.0 * modulus * area**2 / (volume * oil_column**2)
    spool = between(0.3e-3, 3e-3)
    flow = speed * area
    gradient = flow / (0.62 * spool * math.sqrt(supply / 860.0))
    coulomb = force * between(0.01, 0.05)
    static, elements = coulomb * between(1.1, 1.6), int(random.integers(1, 4))
    weight = np.sort(random.dirichlet(np.full(elements, 2.0)))[::-1]
    # Seals yield by some 0.1 mm before they slip; the softest element slips last.
    yielding = between(3e-5, 2e-4)
    stiffness = static * weight / np.geomspace(yielding, yielding * between(1.0, 5.0), elements)
    noise = between(0.5, 2.0)
    reading = {
        "position": {"noise_std": 4e-6 * stroke * noise, "resolution": 1e-5 * stroke},
        "load_pressure": {"noise_std": 1.5e-4 * supply * noise, "resolution": 1.5e-4 * supply},
        "spool_position": {"noise_std": 1e-4 * spool * noise, "resolution": 1e-4 * spool},
        "force": {"noise_std": 1e-4 * force * noise, "resolution": 2e-4 * force},
    }
    coupling = force / (between(0.01, 0.05) * stroke)
    amplitude, rate = force * random.uniform(0.3, 0.55), 2.0 * math.pi * between(0.3, 1.5)
    # The actuator under test moves at up to a third of the loader's speed and within a quarter of its stroke.
    turning = 2.0 * math.pi * between(0.4, 2.0)
    moved = min(0.3 * speed / turning, 0.25 * stroke)
    content = {
        "plant": {
            "supply_pressure": supply,
            "oil_density": 860.0,
            "bulk_modulus": modulus,
            "discharge_coefficient": 0.62,
            "valve_area_gradient": gradient,
            "leakage_coefficient": between(0.005, 0.05) * flow / supply,
            "total_volume": volume,
            "moving_mass": mass,
            "piston_area": area,
            "arm_length": 0.5,
            "spring_stiffness": float(random.choice([0.0, 0.3 * force / stroke])),
            "viscous_damping": 0.0,
            "valve_bandwidth": 2.0 * math.pi * between(20.0, 200.0),
            "valve_gain": 1.0,
            "gravity": float(random.choice([0.0, 9.81])),
        },
        "friction": {
            "model": "gms",
            "coulomb_force": coulomb,
            "static_force": static,
            "stribeck_velocity": between(1e-3, 1e-2),
            "stribeck_exponent": random.uniform(0.8, 2.0),
            "viscous_coefficient": coulomb / speed * between(0.3, 3.0),
            "element_stiffness": stiffness.tolist(),
            "element_weight": weight.tolist(),
            "attraction_rate": coulomb * between(1.0, 10.0),
        },
        "effects": [],
        "sensors": {} if perfect else reading,
        "limits": {
            "spool": spool,
            "force": force,
            "load_pressure": supply,
            "position": [-0.5 * stroke, 0.5 * stroke],
            "velocity": 2.0 * speed,
        },
    }
    coupled = {"name": "coupling_stiffness", "stiffness": coupling, "damping": coupling * 1e-3}
    delay = float(random.choice([0.0, 1.0, 2.0, random.uniform(0.0, 2.0)])) * PERIOD
    servo = {"name": "sine", "amplitude": moved, "frequency": turning / (2.0 * math.pi)}
    content["effects"] = [{"name": "command_delay", "delay": delay}, coupled]
    return OwnRig(
        content,
        {"name": "sine", "amplitude": amplitude, "frequency": rate / (2.0 * math.pi)},
        {
            "name": "position_servo",
            "moving_mass": mass,
            "supply_pressure": 1.5 * supply,
            "signal": servo,
        },
        amplitude,
    )


def spec_of(rig: OwnRig, law: str, duration: float, **tuning: Any) -> Spec:
    """Return the experiment of a law on a rig whose delay and coupling it knows."""
    content = {
        "title": law,
        "duration": duration,
        "control_period": PERIOD,
        "rig": rig.content,
        "reference": rig.reference,
        "disturbance": rig.disturbance,
        "controller": {"name": law, **tuning},
    }
    return spec_from_mapping(content, law, Path())


class Outcome(NamedTuple):
    """Result of a law on a rig: its error over the reference's amplitude, and the margins of its loop."""

    error: float
    margins: LoopMargins

    def text(self, rig: OwnRig, limit: float) -> str:
        """Return a cell of the table."""
        gain = min(self.margins.gain_db, self.margins.fall_db)
        part = 100.0 * self.error / rig.amplitude
        return f"{self.error:.4g} N {part:.3f} % {self.error / limit:.2f} x {gain:.1f} dB {self.margins.phase_deg:.0f} deg"


def outcome(spec: Spec) -> Outcome:
    """Run an experiment with another seed of the sensors' noise than the one tuned for."""
    other = spec._replace(settings=spec.settings._replace(seed=spec.settings.seed + 100))
    return Outcome(stepped_run(other).largest(), margins_of(spec))


def tuned(spec: Spec, margins: Sequence[float]) -> Spec:
    """Return an experiment with the numbers found for it."""
    return tune(Task({}, spec, ()), wanted=Wanted(*margins), uncertainty=0.0).spec


def summary(name: str, outcomes: Sequence[Outcome], rigs: Sequence[OwnRig], limits: Sequence[float]) -> str:
    """Return a line with median and worst of a law."""
    ratios = [found.error / limit for found, limit in zip(outcomes, limits, strict=True)]
    parts = [100.0 * found.error / rig.amplitude for found, rig in zip(outcomes, rigs, strict=True)]
    lost = sum(not part < LOST for part in parts)
    figures = ", ".join(
        f"{label} median {np.median(values):.3g}, worst {max(values):.3g}"
        for label, values in (("error/limit", ratios), ("% of amplitude", parts))
    )
    return f"{name}: {figures}, lost {lost} of {len(rigs)}"


def main() -> None:
    """Print the table."""
    parser = parser_of(__doc__)
    parser.add_argument("--seed", type=int, default=None, help="seed of the rigs; a fresh one by default")
    parser.add_argument("--count", type=int, default=60, help="number of rigs (%(default)s)")
    parser.add_argument("--duration", type=float, default=5.0, help="of each run, s (%(default)s)")
    parser.add_argument("--perfect", action="store_true", help="perfect sensors")
    parser.add_argument("--laws", nargs="+", default=LAWS, help="control laws")
    parser.add_argument("--tune", nargs=2, type=float, metavar=("DB", "DEG"), help="tune each law too, with these margins")
    options = parser.parse_args()
    seed = secrets.randbits(32) if options.seed is None else options.seed
    print(f"seed {seed}, {options.count} rigs of {options.duration:g} s", flush=True)
    rigs, limits, found = list[OwnRig](), list[float](), dict[str, list[Outcome]]()
    for number in range(options.count):
        rig = drawn(number, seed, perfect=options.perfect)
        plant, delay = rig.content["plant"], 1e3 * rig.content["effects"][0]["delay"]
        specs = {law: spec_of(rig, law, options.duration) for law in options.laws}
        limit = causal_limit_of(next(iter(specs.values())))
        valve = plant["valve_bandwidth"] / 2.0 / math.pi
        force = rig.content["limits"]["force"]
        print(f"{number}: {force:.4g} N, valve {valve:.1f} Hz, delay {delay:.2f} ms, limit {limit:.3g} N", flush=True)
        if options.tune:
            specs |= {f"{law}, tuned": tuned(spec, options.tune) for law, spec in specs.items()}
        rigs.append(rig)
        limits.append(limit)
        for name, spec in specs.items():
            result = outcome(spec)
            found.setdefault(name, []).append(result)
            print(f"    {name:32}{result.text(rig, limit)}", flush=True)
    for name, outcomes in found.items():
        print(summary(name, outcomes, rigs, limits))


if __name__ == "__main__":
    main()
