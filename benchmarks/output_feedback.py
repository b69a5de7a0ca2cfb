"""Residual error of `fasmc_output_feedback` with a rig's sensors, and the cost of each imperfection and each wrong number.

The paper's four experiments, config/experiments/measured_*.yaml. The error is that of the true force, the largest of the last
half, in N. With several seeds of the sensors' noise, their median and largest, otherwise that of seed 0.
`python -m benchmarks.output_feedback --seeds 8`
"""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from benchmarks.common import MEASURED, experiment, largest, parser_of
from ehls_ros.experiments.loop import simulator_of
from ehls_ros.experiments.spec import Spec
from ehls_ros.experiments.stepped_run import Cycles, stepped_run
from ehls_ros.physics.parameters import Sensor
from ehls_ros.physics.rig import Rig, effects_from_list
from ehls_ros.physics.simulator import Simulator

OFF = (0.9, 1.1)
SLIPPERY = {
    "coulomb_force": 1e-3,
    "static_force": 1e-3,
    "element_stiffness": (1.0, 1.0, 1.0),
    "attraction_rate": 1e-3,
}
"""Friction that is viscous only."""

COEFFICIENTS = (
    ("friction", "level"),
    ("friction", "viscous_coefficient"),
    ("friction", "element_stiffness"),
    ("plant", "bulk_modulus"),
    ("plant", "moving_mass"),
    ("plant", "discharge_coefficient"),
    ("plant", "valve_bandwidth"),
    ("plant", "piston_area"),
)

Variant = Callable[[Spec], Cycles]


def with_sensors(spec: Spec, change: Callable[[Sensor], Sensor]) -> Spec:
    """Return an experiment whose sensors are changed."""
    sensors = {signal: change(sensor) for signal, sensor in spec.rig.sensors.items()}
    return spec._replace(rig=spec.rig._replace(sensors=sensors))


def perfect(sensor: Sensor) -> Sensor:
    """Return a sensor without noise and resolution."""
    return sensor._replace(noise_std=0.0, resolution=0.0)


def tuned(spec: Spec, **changes: float) -> Spec:
    """Return an experiment with other numbers of the law."""
    return spec._replace(controller=spec.controller._replace(parameters=spec.controller.parameters._replace(**changes)))


def delayed(spec: Spec, cycles: float, *, known: bool) -> Spec:
    """Return an experiment with another delay of the command."""
    delay = cycles * spec.settings.control_period
    effects = effects_from_list([{"name": "command_delay", "delay": delay}], "benchmark") if cycles else ()
    changed = spec._replace(rig=spec.rig._replace(effects=effects))
    return tuned(changed, command_delay=delay) if known else changed


def off(spec: Spec, section: str, name: str, factor: float) -> Spec:
    """Return an experiment on a rig with one coefficient off."""

    def scaled(value: Any) -> Any:
        return tuple(factor * one for one in value) if isinstance(value, tuple) else factor * value

    names = ("coulomb_force", "static_force") if name == "level" else (name,)
    part = getattr(spec.rig, section)
    part = part._replace(**{key: scaled(getattr(part, key)) for key in names})
    return spec._replace(rig=spec.rig._replace(**{section: part}))


def slippery(spec: Spec) -> Spec:
    """Return an experiment with viscous friction only, also in the controller's model."""

    def rig(one: Rig) -> Rig:
        return one._replace(friction=one.friction._replace(**SLIPPERY))

    return spec._replace(rig=rig(spec.rig), controller_rig=rig(spec.controller_rig))


def as_an_exact_sine(spec: Spec) -> Cycles:
    """Run an experiment whose servo follows its command exactly."""
    settings = spec.settings
    plant = Simulator(spec.loader_rig(), settings.control_period, settings.integration_step)
    return stepped_run(spec, plant=plant)


class _Weakened:
    """A plant whose commands are changed or lost on the way from the controller."""

    def __init__(self, plant: Simulator, gain: float, lost: int) -> None:
        self._plant, self._gain, self._lost, self._held = plant, gain, lost, 0.0
        self.truth, self.acting = plant.truth, plant.acting
        self.measure, self.trouble = plant.measure, plant.trouble

    def advance(self, command: float, *row: float) -> int:
        """Advance by a cycle."""
        if not self._lost or self._plant.cycle % self._lost:
            self._held = self._gain * command
        return self._plant.advance(self._held, *row)


def weakened(spec: Spec, gain: float = 1.0, lost: int = 0) -> Cycles:
    """Run an experiment with another command gain, or in which every ``lost``-th command is lost."""
    plant: Any = _Weakened(simulator_of(spec), gain, lost)
    return stepped_run(spec, plant=plant)


def noiseless(sensor: Sensor) -> Sensor:
    """Return a sensor without noise."""
    return sensor._replace(noise_std=0.0)


def unrounded(sensor: Sensor) -> Sensor:
    """Return a sensor without resolution."""
    return sensor._replace(resolution=0.0)


def noisier(sensor: Sensor) -> Sensor:
    """Return a sensor with twice the noise."""
    return sensor._replace(noise_std=2.0 * sensor.noise_std)


def on(change: Callable[[Spec], Spec], run: Variant = stepped_run) -> Variant:
    """Return the run of a changed experiment."""
    return lambda spec: run(change(spec))


def variants() -> Mapping[str, tuple[Variant, ...]]:
    """Return the rows of the table; of several variants the largest error counts."""
    ideal = partial(with_sensors, change=perfect)
    rows: dict[str, tuple[Variant, ...]] = {
        "perfect sensors": (on(ideal),),
        "noise without resolution": (on(partial(with_sensors, change=unrounded)),),
        "resolution without noise": (on(partial(with_sensors, change=noiseless)),),
        "no delay": (on(partial(delayed, cycles=0.0, known=True)),),
        "no delay, perfect sensors": (on(lambda spec: delayed(ideal(spec), 0.0, known=True)),),
        "viscous friction only, perfect sensors": (on(lambda spec: slippery(ideal(spec))),),
        "servo as an exact sine": (as_an_exact_sine,),
        "servo as an exact sine, perfect sensors": (on(ideal, as_an_exact_sine),),
        "told that perfect sensors are perfect": (on(lambda spec: tuned(ideal(spec), external_noise=1e10)),),
    }
    for section, name in COEFFICIENTS:
        rows[f"{name} 10 % off"] = tuple(on(partial(off, section=section, name=name, factor=factor)) for factor in OFF)
    for known in (True, False):
        for cycles in (0.5, 1.5, 2.0):
            what = "known" if known else "not known"
            rows[f"delay of {cycles:g} cycles, {what}"] = (on(partial(delayed, cycles=cycles, known=known)),)
    for gain in (0.5, 2.0, 2.5):
        rows[f"loop gain {gain:g}"] = (partial(weakened, gain=gain),)
    rows["twice the noise"] = (on(partial(with_sensors, change=noisier)),)
    rows["every tenth command lost"] = (partial(weakened, lost=10),)
    for stiffness in (1e6, 4e6):
        rows[f"coupling stiffness assumed {stiffness:g} N/m"] = (on(partial(tuned, coupling_stiffness=stiffness)),)
    return rows


def main() -> None:
    """Print the table."""
    parser = parser_of(__doc__)
    parser.add_argument("--seeds", type=int, default=8, help="runs of the row with several seeds")
    parser.add_argument("--only", default="", help="part of a row's name")
    options = parser.parse_args()
    print(f"{'':42}" + "".join(f"{name.removeprefix('measured_'):>18}" for name in MEASURED))
    if not options.only:
        text = f"{f'{options.seeds} seeds: seed 0, median (largest)':42}"
        for spec in map(experiment, MEASURED):
            runs = (spec._replace(settings=spec.settings._replace(seed=seed)) for seed in range(options.seeds))
            errors = [stepped_run(one).largest() for one in runs]
            text += f"{f'{errors[0]:.1f} {largest(errors)}':>18}"
        print(text, flush=True)
    for name, runs_of in variants().items():
        if options.only in name:
            found = (max(run(spec).largest() for run in runs_of) for spec in map(experiment, MEASURED))
            print(f"{name:42}" + "".join(f"{error:18.1f}" for error in found), flush=True)


if __name__ == "__main__":
    main()
