"""Rigs of one's own: the laws on rigs of many sizes, drawn from a seed, beside the causal limit of each.

    python -m benchmarks.own_rigs --seed 7 --count 60

Forces over three decades, supplies of 100 and 200 bar, valves of 20 to 200 Hz, delays of 0 to 2 cycles, noise as data sheets
have it. The controller's rig file is right. The actuator under test is the position servo behind an elastic coupling; the error
is that of the true force, the largest of the last half.
"""

import math
import secrets
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.common import parser_of
from ehls_ros.experiments.spec import Spec, spec_from_mapping
from ehls_ros.experiments.stepped_run import stepped_run
from ehls_ros.experiments.tuning.tune import causal_limit_of

PERIOD = 1e-3
"""Control period [s]."""

LAWS = ("fasmc_predictive", "fasmc_output_feedback", "fasmc")

DECADES = (0.1, 1.0, 10.0)
"""Sizes of the rigs, forces over those of the paper's rig."""

SUPPLIES = (1e7, 2e7)
"""Supply pressures [Pa]."""

FORCE = 18e3
"""Largest force of a rig of size 1 [N]."""


class OwnRig(NamedTuple):
    """A drawn rig with its task.

    Attributes:
        content: its file.
        effects: delay of the command.
        reference, disturbance: the task.
        amplitude: of the reference [N].
    """

    content: dict[str, Any]
    effects: list[dict[str, Any]]
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
    delay = float(random.choice([0.0, 1.0, 2.0, random.uniform(0.0, 2.0)])) * PERIOD
    servo = {"name": "sine", "amplitude": moved, "frequency": turning / (2.0 * math.pi)}
    return OwnRig(
        content,
        [{"name": "command_delay", "delay": delay}] if delay else [],
        {"name": "sine", "amplitude": amplitude, "frequency": rate / (2.0 * math.pi)},
        {
            "name": "position_servo",
            "stiffness": coupling,
            "damping": coupling * 1e-3,
            "moving_mass": mass,
            "supply_pressure": 1.5 * supply,
            "signal": servo,
        },
        amplitude,
    )


def spec_of(rig: OwnRig, law: str, duration: float, **tuning: Any) -> Spec:
    """Return the experiment of a law on a rig whose delay and coupling it knows."""
    known = ["coupling_stiffness", *(effect["name"] for effect in rig.effects)]
    content = {
        "title": law,
        "duration": duration,
        "control_period": PERIOD,
        "rig": rig.content,
        "effects": rig.effects,
        "known_effects": known,
        "reference": rig.reference,
        "disturbance": rig.disturbance,
        "controller": {"name": law, **tuning},
    }
    return spec_from_mapping(content, law, Path())


def main() -> None:
    """Print the table."""
    parser = parser_of(__doc__)
    parser.add_argument("--seed", type=int, default=None, help="seed of the rigs; a fresh one by default")
    parser.add_argument("--count", type=int, default=60, help="number of rigs (%(default)s)")
    parser.add_argument("--duration", type=float, default=8.0, help="of each run, s (%(default)s)")
    parser.add_argument("--perfect", action="store_true", help="perfect sensors")
    parser.add_argument("--laws", nargs="+", default=LAWS, help="control laws")
    options = parser.parse_args()
    seed = secrets.randbits(32) if options.seed is None else options.seed
    print(f"seed {seed}, {options.count} rigs of {options.duration:g} s", flush=True)
    print(
        f"{'rig':>4}{'force/N':>10}{'valve/Hz':>10}{'delay/ms':>10}{'limit/N':>10}"
        + "".join(f"{law:>34}" for law in options.laws)
    )
    for number in range(options.count):
        rig = drawn(number, seed, perfect=options.perfect)
        cells, limit = [], math.nan
        for law in options.laws:
            spec = spec_of(rig, law, options.duration)
            error = stepped_run(spec).largest()
            limit = causal_limit_of(spec) if math.isnan(limit) else limit
            cells.append(f"{error:12.4g} N {100.0 * error / rig.amplitude:8.3f} % {error / limit:7.2f} x")
        plant = rig.content["plant"]
        delay = 1e3 * sum(effect["delay"] for effect in rig.effects)
        print(
            f"{number:>4}{rig.content['limits']['force']:>10.4g}{plant['valve_bandwidth'] / 2.0 / math.pi:>10.1f}{delay:>10.2f}"
            f"{limit:>10.3g}" + "".join(f"{cell:>34}" for cell in cells),
            flush=True,
        )


if __name__ == "__main__":
    main()
