"""Rigs of one's own: the laws on rigs of many sizes, drawn from a seed, beside the causal limit of each.

    python -m benchmarks.own_rigs --seed 7 --count 60 --perfect     # the laws' defaults
    python -m benchmarks.own_rigs --seed 7 --count 12 --tune 3 20   # and the numbers that `ehls tune` finds
    python -m benchmarks.own_rigs --seed 7 --count 60 --commission --laws fasmc_predictive  # wrong files, commissioned
    python -m benchmarks.own_rigs --seed 7 --count 60 --perfect --single-rod                # cylinders with one rod

Forces over three decades, supplies of 100 and 200 bar, valves of 20 to 200 Hz, delays of 0 to 2 cycles, noise as data sheets
have it. The controller's rig file is right. The actuator under test is the position servo behind an elastic coupling; the error
is that of the true force, the largest of the last half.
"""

import copy
import math
import secrets
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.common import parser_of
from benchmarks.emulated import EmulatedDevice
from ehls_ros.control.margins import LoopMargins
from ehls_ros.errors import BadInput, WorkFailed
from ehls_ros.experiments.commissioning.conduct import STEPS
from ehls_ros.experiments.commissioning.first_run import LAW
from ehls_ros.experiments.commissioning.session import Session
from ehls_ros.experiments.commissioning.step import Known, after
from ehls_ros.experiments.spec import Spec, spec_from_mapping
from ehls_ros.experiments.stepped_run import stepped_run
from ehls_ros.experiments.tuning.loop_margins import margins_of
from ehls_ros.experiments.tuning.task import Task, servo_of
from ehls_ros.experiments.tuning.tune import USUAL, Wanted, causal_limit_of, tune, with_numbers
from ehls_ros.hardware.calibration import Calibration, Input, Output
from ehls_ros.physics.rig import CHAMBER_SENSED, Rig, rig_from_mapping, rig_to_mapping

PERIOD = 1e-3
"""Control period [s]."""

LAWS = ("fasmc_predictive", "fasmc_output_feedback")

DECADES = (0.1, 1.0, 10.0)
"""Sizes of the rigs, forces over those of the paper's rig."""

SUPPLIES = (1e7, 2e7)
"""Supply pressures [Pa]."""

FORCE = 18e3
"""Largest force of a rig of size 1 [N]."""

SEEDS = 3
"""Number of seeds of the sensors' noise with which a law is judged."""

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
    content: dict[str, Any] = {
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
            **servo_of(rig_from_mapping(content, "drawn rig"), servo),
            "moving_mass": mass,
            "supply_pressure": 1.5 * supply,
        },
        amplitude,
    )


def with_single_rod(rig: OwnRig, number: int, seed: int) -> OwnRig:
    """Return a rig with a single rod of the same mean area, and edges nearly in the ratio of its areas.

    Args:
        rig: the rig.
        number: its number.
        seed: the seed.
    """
    random = np.random.default_rng([seed, number, 1])
    content, ratio = copy.deepcopy(rig.content), float(random.uniform(1.2, 2.2))
    plant = content["plant"]
    mean = plant.pop("piston_area")
    height = plant.pop("total_volume") / (2.0 * mean)
    areas = {"a": 2.0 * mean * ratio / (1.0 + ratio), "b": 2.0 * mean / (1.0 + ratio)}
    cylinder: dict[str, Any] = {"model": "two_chamber", "tank_pressure": float(random.uniform(0.5e5, 4e5))}
    for side, area in areas.items():
        cylinder |= {f"area_{side}": area, f"volume_{side}": area * height}
    gains = {"pa": 1.0, "at": 1.0, "pb": 1.0 / ratio, "bt": 1.0 / ratio}
    valve = {f"gain_{edge}": gain * float(random.uniform(0.95, 1.05)) for edge, gain in gains.items()}
    content |= {"cylinder": cylinder, "valve": {"model": "four_edges", **valve}}
    sensors = content["sensors"]
    if "load_pressure" in sensors:
        reading = sensors.pop("load_pressure")
        sensors |= {"pressure_a": reading, "pressure_b": reading}
    pull = -rig_from_mapping(content, "drawn rig").forces()[0]
    amplitude = rig.amplitude * pull / content["limits"]["force"]
    return rig._replace(content=content, reference={**rig.reference, "amplitude": amplitude}, amplitude=amplitude)


def spec_of(rig: OwnRig, law: str, duration: float, known: Rig | None = None) -> Spec:
    """Return the experiment of a law on a rig, with the law's defaults for the rig that it knows: the true one or ``known``."""
    content = {
        "title": law,
        "duration": duration,
        "control_period": PERIOD,
        "rig": rig.content,
        **({} if known is None else {"controller_rig": rig_to_mapping(known)}),
        "reference": rig.reference,
        "disturbance": rig.disturbance,
        "controller": law,
    }
    return spec_from_mapping(content, law, Path())


WRONG = 0.2
"""Largest relative error of a coefficient of a wrong rig file."""

WRONG_NUMBERS = (
    "bulk_modulus", "discharge_coefficient", "leakage_coefficient", "moving_mass", "spring_stiffness", "valve_bandwidth",
)  # fmt: skip
"""Coefficients of the plant that are wrong there, each by itself; those of the friction are too, by one factor."""


class Found(NamedTuple):
    """A commissioned rig.

    Attributes:
        known: the rig as found, and the numbers of the law as tuned.
        covered: number of findings whose 95 % interval holds the truth.
        told: number of findings with a truth.
        trouble: reason if a step ended early; otherwise empty.
    """

    known: Known
    covered: int
    told: int
    trouble: str


def commissioned(rig: OwnRig, seed: int, wanted: Wanted) -> Found:
    """Commission a rig whose file is wrong, has no sensors, and tells neither delay nor coupling."""
    random = np.random.default_rng(seed)
    wrong = copy.deepcopy(rig.content) | {"effects": [], "sensors": {}}
    for name in WRONG_NUMBERS:
        wrong["plant"][name] *= random.uniform(1.0 - WRONG, 1.0 + WRONG)
    factor = random.uniform(1.0 - WRONG, 1.0 + WRONG)
    for name in ("coulomb_force", "static_force", "viscous_coefficient"):
        wrong["friction"][name] *= factor
    file = rig_from_mapping(wrong, "wrong file")
    calibration = _wiring(file)
    known, covered, told = Known(file, {}, wanted), 0, 0
    for step in STEPS:
        coupled = step.name in ("coupling", "first_run")
        device = EmulatedDevice(_emulated(rig, seed, coupled=coupled), calibration)
        session = Session(device, calibration, known.rig, PERIOD, lockstep=True)
        try:
            outcome = step.run(session, known, lambda done, total, doing="": None)
        except (BadInput, WorkFailed) as error:
            return Found(known, covered, told, f"{step.name}: {error}")
        known = after(known, outcome)
        for finding in outcome.findings:
            true = _truth(rig, finding.path)
            if true is not None:
                told += 1
                holds = abs(finding.found.value - true) <= 1.96 * finding.found.std
                covered += holds
                if not holds:
                    found = finding.found
                    print(f"    {finding.path}: {found.value:.5g} +- {found.std:.2g}, true {true:.5g} {found.unit}", flush=True)
        if step.name == "first_run":
            print("".join(f"    {sentence}\n" for sentence in outcome.sentences[: len(outcome.recordings)]), end="", flush=True)
    return Found(known, covered, told, "")


def _wiring(rig: Rig) -> Calibration:
    """Return converters of 16 bits (18 for the position) whose ranges suit the rig."""
    ends, limits = (-10.0, 10.0), rig.limits
    inputs = {
        "position": Input(0, scale=0.06 * (limits.position[1] - limits.position[0]), range=ends, bits=18),
        "spool_position": Input(2, scale=limits.spool / 8.0, range=ends),
        "force": Input(3, scale=limits.force / 8.0, range=ends),
        "supply_pressure": Input(4, scale=rig.plant.supply_pressure / 7.0, range=ends),
    }
    pressures = CHAMBER_SENSED if rig.cylinder.law.CHAMBERS else ("load_pressure",)
    for place, signal in zip((1, 5), pressures, strict=False):
        inputs[signal] = Input(place, scale=limits.load_pressure / 8.0, range=ends)
    return Calibration(inputs, Output(0, scale=limits.spool / 8.0, range=ends))


def _emulated(rig: OwnRig, seed: int, *, coupled: bool) -> Spec:
    """Return the experiment of the emulated rig; of its delay, a cycle is that of the device."""
    content = copy.deepcopy(rig.content)
    delay, coupling = content["effects"]
    left = delay["delay"] - PERIOD
    content["effects"] = [{**delay, "delay": left}] * (left > 0.0) + [coupling] * coupled
    still = {"name": "constant", "value": 0.0}
    held = {"disturbance": {**rig.disturbance, "signal": still}} if coupled else {}
    made = {"rig": content, "reference": still, "controller": "fasmc", "control_period": PERIOD, "seed": seed, **held}
    return spec_from_mapping(made, "emulated rig", Path())


def _truth(rig: OwnRig, path: str) -> float | None:
    """Return the true value of a number of the rig file; None if it has none."""
    section, _, name = path.partition(".")
    if section == "effects":
        effect, _, name = name.partition(".")
        return next((use.get(name) for use in rig.content["effects"] if use["name"] == effect), None)
    value = rig.content.get(section, {}).get(name)
    return float(np.sum(value)) if isinstance(value, int | float | list) else None


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
    """Return the median error over other seeds of the sensors' noise than those tuned for."""
    seeds = (spec.settings.seed + 100 + number for number in range(SEEDS))
    errors = [stepped_run(spec._replace(settings=spec.settings._replace(seed=seed))).largest() for seed in seeds]
    return Outcome(float(np.median(errors)), margins_of(spec))


def retuned(spec: Spec, margins: Sequence[float]) -> Spec:
    """Return an experiment with the numbers found for the rig that its controller knows, which alone is known to the tuning."""
    believed = spec._replace(rig=spec.controller_rig)
    found = tune(Task(believed, ()), wanted=Wanted(*margins), uncertainty=0.0)
    return with_numbers(spec, found.chosen.numbers)


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
    parser.add_argument("--single-rod", action="store_true", help="cylinders with one rod")
    parser.add_argument("--laws", nargs="+", default=LAWS, help="control laws")
    parser.add_argument("--commission", action="store_true", help="commission each rig first, with a wrong file, and tune it")
    about = "tune each law with these margins; with --commission they are those asked for there"
    parser.add_argument("--tune", nargs=2, type=float, metavar=("DB", "DEG"), help=about)
    options = parser.parse_args()
    seed = secrets.randbits(32) if options.seed is None else options.seed
    print(f"seed {seed}, {options.count} rigs of {options.duration:g} s", flush=True)
    rigs, limits, found = list[OwnRig](), list[float](), dict[str, list[Outcome]]()
    for number in range(options.count):
        rig = drawn(number, seed, perfect=options.perfect)
        if options.single_rod:
            rig = with_single_rod(rig, number, seed)
        if options.commission:
            # The device takes a cycle to pass a command on.
            rig.content["effects"][0]["delay"] = max(rig.content["effects"][0]["delay"], PERIOD)
        plant, delay = rig.content["plant"], 1e3 * rig.content["effects"][0]["delay"]
        specs = {law: spec_of(rig, law, options.duration) for law in options.laws}
        limit = causal_limit_of(next(iter(specs.values())))
        valve = plant["valve_bandwidth"] / 2.0 / math.pi
        force = rig.content["limits"]["force"]
        print(f"{number}: {force:.4g} N, valve {valve:.1f} Hz, delay {delay:.2f} ms, limit {limit:.3g} N", flush=True)
        if options.commission:
            measured = commissioned(rig, seed + number, Wanted(*options.tune or USUAL))
            print(f"    commissioned: {measured.covered} of {measured.told} intervals hold {measured.trouble}", flush=True)
            known = measured.known
            specs = {f"{law}, commissioned": spec_of(rig, law, options.duration, known.rig) for law in options.laws}
            if LAW in options.laws:
                specs[f"{LAW}, and tuned"] = with_numbers(specs[f"{LAW}, commissioned"], known.numbers)
        elif options.tune:
            specs |= {f"{name}, tuned": retuned(spec, options.tune) for name, spec in specs.items()}
        rigs.append(rig)
        limits.append(limit)
        for name, spec in specs.items():
            result = outcome(spec)
            found.setdefault(name, []).append(result)
            print(f"    {name:42}{result.text(rig, limit)}", flush=True)
    for name, outcomes in found.items():
        print(summary(name, outcomes, rigs, limits))


if __name__ == "__main__":
    main()
