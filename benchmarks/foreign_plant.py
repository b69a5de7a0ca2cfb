"""The laws on a plant of another program: a hydraulic cylinder of the multibody code Exudyn, beside a PI law.

    make setup WITH=peers
    python -m benchmarks.foreign_plant

Exudyn (J. Gerstmayr, University of Innsbruck) has its own equations of two chambers and a valve with four edges, its own dry
friction and an implicit integrator. The cylinder presses against a spring whose far end, the actuator under test, moves. The
laws are called through `ehls_ros.controller`, with the rig's numbers as the plant has them, or with wrong ones. The PI law has
the best of a grid of gains on this very task.
"""

import itertools
import math
import time
from collections.abc import Callable, Mapping
from importlib.util import find_spec
from typing import Any, NamedTuple

import numpy as np

import ehls_ros as ehls
from benchmarks.common import parser_of
from ehls_ros.arrays import Array

PERIOD, PARTS = 1e-3, 10
"""Control period [s], and number of integration steps in it."""

AREA, STROKE, HOSE, MASS = 2.5e-3, 0.2, 1e-4, 60.0
"""Piston area [m²], stroke [m], oil outside the cylinder on each side [m³], mass [kg]."""

SUPPLY, MODULUS, DENSITY = 140e5, 1.2e9, 860.0
"""Supply pressure and bulk modulus [Pa], density [kg/m³]."""

FLOW = 38e-3 / 60.0 / math.sqrt(35e5)
"""Flow of an open edge over the root of its pressure drop: 38 l/min at 35 bar [m³/s/√Pa]."""

SPOOL, BANDWIDTH = 1e-3, 2.0 * math.pi * 60.0
"""Largest spool displacement [m], bandwidth of the valve [rad/s]."""

VISCOUS, COULOMB, BREAKAWAY, STICKING, STRIBECK = 1500.0, 300.0, 100.0, 1e6, 5e-3
"""Friction: viscous [N s/m], dry [N], more at break-away [N], stiffness of sticking contact [N/m], Stribeck velocity [m/s]."""

COUPLING, DAMPING = 3e6, 3e3
"""Spring to the actuator under test [N/m], its damping [N s/m]."""

AMPLITUDE, FREQUENCY, TRAVEL, MOTION, DURATION = 10e3, 0.5, 0.01, 1.0, 4.0
"""Sine of the force [N, Hz], motion of the actuator under test [m, Hz], duration [s], the last half of which is judged."""

LAWS = ("fasmc_predictive", "fasmc_output_feedback")

GAINS = tuple(itertools.product((2e-9, 5e-9, 1e-8, 2e-8), (2e-7, 1e-6, 3e-6, 1e-5)))
"""Proportional [m/N] and integral [m/N/s] gains of the PI law."""

Law = Callable[[Mapping[str, float], tuple[float, float, float]], float]


class Result(NamedTuple):
    """Largest and rms error of the force [N], and the median time of a call of the law [s]."""

    largest: float
    rms: float
    call: float


def rig(wrong: float = 0.0) -> dict[str, Any]:
    """Return the rig file of the plant; ``wrong``: relative error of bulk modulus (low) and flow (high)."""
    # Each edge has half of the drop: Q = FLOW opening √((ps − pL)/2) = Cd w xv √((ps − pL)/ρ).
    gradient = FLOW / math.sqrt(2.0) * math.sqrt(DENSITY) / 0.62 / SPOOL
    return {
        "plant": {
            "supply_pressure": SUPPLY, "oil_density": DENSITY, "bulk_modulus": (1.0 - wrong) * MODULUS,
            "discharge_coefficient": 0.62 * (1.0 + wrong), "valve_area_gradient": gradient, "leakage_coefficient": 0.0,
            "total_volume": 2.0 * HOSE + AREA * STROKE, "moving_mass": MASS, "piston_area": AREA, "arm_length": 0.5,
            "spring_stiffness": 0.0, "viscous_damping": 0.0, "valve_bandwidth": BANDWIDTH, "valve_gain": 1.0, "gravity": 0.0,
        },
        "friction": {
            "model": "gms", "coulomb_force": COULOMB, "static_force": COULOMB + BREAKAWAY, "stribeck_velocity": STRIBECK,
            "stribeck_exponent": 1.0, "viscous_coefficient": VISCOUS, "element_stiffness": [STICKING], "element_weight": [1.0],
            "attraction_rate": 10.0 * COULOMB,
        },
        "effects": [
            {"name": "command_delay", "delay": PERIOD},
            {"name": "coupling_stiffness", "stiffness": COUPLING, "damping": DAMPING},
        ],
        "limits": {
            "spool": SPOOL, "force": SUPPLY * AREA, "load_pressure": SUPPLY, "position": [-0.5 * STROKE, 0.5 * STROKE],
            "velocity": 1.0,
        },
    }  # fmt: skip


def wanted(moment: float) -> tuple[float, float, float]:
    """Return the reference with its derivatives."""
    w = 2.0 * math.pi * FREQUENCY
    force = AMPLITUDE * math.sin(w * moment)
    return force, w * AMPLITUDE * math.cos(w * moment), -(w**2) * force


def pi_law(proportional: float, integral: float) -> Law:
    """Return a PI law."""
    total = [0.0]

    def law(measured: Mapping[str, float], row: tuple[float, float, float]) -> float:
        error = row[0] - measured["force"]
        total[0] = min(max(total[0] + integral * error * PERIOD, -SPOOL), SPOOL)
        return min(max(proportional * error + total[0], -SPOOL), SPOOL)

    return law


def judged(law: Law) -> Result:
    """Run a law on the plant; a command acts one cycle after its readings."""
    import exudyn as exu  # noqa: PLC0415 - an optional peer
    from exudyn import itemInterface as item  # noqa: N813, PLC0415

    system = exu.SystemContainer().AddSystem()
    ground, origin = system.AddObject(item.ObjectGround()), system.AddNode(item.NodePointGround())
    start = 0.5 * STROKE
    node = system.AddNode(item.NodePoint(referenceCoordinates=[start, 0.0, 0.0]))
    body = system.AddObject(item.MassPoint(physicsMass=MASS, nodeNumber=node))
    fixed, far = (
        system.AddMarker(item.MarkerBodyPosition(bodyNumber=ground, localPosition=[x, 0.0, 0.0])) for x in (0.0, start)
    )
    moving = system.AddMarker(item.MarkerBodyPosition(bodyNumber=body))
    still = system.AddMarker(item.MarkerNodeCoordinate(nodeNumber=origin, coordinate=0))
    axes = [system.AddMarker(item.MarkerNodeCoordinate(nodeNumber=node, coordinate=axis)) for axis in range(3)]
    for axis in axes[1:]:
        system.AddObject(item.CoordinateConstraint(markerNumbers=[still, axis]))
    pressures = system.AddNode(
        item.NodeGenericODE1(referenceCoordinates=[0.0, 0.0], initialCoordinates=[0.5 * SUPPLY] * 2, numberOfODE1Coordinates=2)
    )
    rigid = 1e15
    cylinder = system.AddObject(
        item.HydraulicActuatorSimple(
            markerNumbers=[fixed, moving], nodeNumbers=[pressures], offsetLength=0.0, strokeLength=STROKE,
            chamberCrossSection0=AREA, chamberCrossSection1=AREA, hoseVolume0=HOSE, hoseVolume1=HOSE, actuatorDamping=VISCOUS,
            oilBulkModulus=MODULUS, cylinderBulkModulus=rigid, hoseBulkModulus=rigid, nominalFlow=FLOW, systemPressure=SUPPLY,
            tankPressure=0.0, useChamberVolumeChange=True,
        )
    )  # fmt: skip
    state = system.AddNode(item.NodeGenericData(initialCoordinates=[0.0] * 3, numberOfDataCoordinates=3))
    system.AddObject(
        item.CoordinateSpringDamperExt(
            markerNumbers=[still, axes[0]], nodeNumber=state, dynamicFrictionForce=COULOMB, staticFrictionOffsetForce=BREAKAWAY,
            stickingStiffness=STICKING, stickingDamping=1e3, exponentialDecayStatic=STRIBECK,
        )
    )  # fmt: skip
    spring = system.AddObject(
        item.CartesianSpringDamper(markerNumbers=[far, moving], stiffness=[COUPLING, 0, 0], damping=[DAMPING, 0, 0])
    )
    loop = _Loop(law)
    outputs = exu.OutputVariableType

    def before_step(system: Any, moment: float) -> bool:
        if loop.is_due():
            a, b = system.GetNodeOutput(pressures, outputs.Coordinates)
            position, velocity = (float(system.GetNodeOutput(node, o)[0]) for o in (outputs.Displacement, outputs.Velocity))
            loop.cycle(moment, {"position": position, "velocity": velocity, "load_pressure": a - b, "force": AREA * (a - b)})
        opening = loop.opening()
        system.SetObjectParameter(cylinder, "valveOpening0", opening)
        system.SetObjectParameter(cylinder, "valveOpening1", -opening)
        system.SetObjectParameter(spring, "offset", [TRAVEL * math.sin(2.0 * math.pi * MOTION * moment), 0.0, 0.0])
        return True

    system.SetPreStepUserFunction(before_step)
    system.Assemble()
    settings = exu.SimulationSettings()
    settings.timeIntegration.numberOfSteps = round(DURATION / PERIOD) * PARTS
    settings.timeIntegration.endTime = DURATION
    settings.timeIntegration.newton.useModifiedNewton = True
    settings.solution.file.write = False
    system.SolveDynamic(settings)
    return loop.result()


class _Loop:
    """Controller and valve between the plant's integration steps."""

    def __init__(self, law: Law) -> None:
        self._law, self._step, self._command, self._next, self._spool = law, 0, 0.0, 0.0, 0.0
        self._errors, self._calls = list[float](), list[float]()

    def is_due(self) -> bool:
        return self._step % PARTS == 0

    def cycle(self, moment: float, measured: Mapping[str, float]) -> None:
        row = wanted(moment)
        self._errors.append(measured["force"] - row[0])
        self._command = self._next
        readings = {**measured, "spool_position": self._spool, "supply_pressure": SUPPLY}
        begin = time.perf_counter()
        self._next = self._law(readings, row)
        self._calls.append(time.perf_counter() - begin)

    def opening(self) -> float:
        """Move the spool by one integration step, and return its opening, -1 to 1."""
        self._step += 1
        self._spool += (self._command - self._spool) * -math.expm1(-BANDWIDTH * PERIOD / PARTS)
        return min(max(self._spool / SPOOL, -1.0), 1.0)

    def result(self) -> Result:
        late: Array = np.array(self._errors[len(self._errors) // 2 :])
        return Result(float(np.max(np.abs(late))), float(np.sqrt(np.mean(late**2))), float(np.median(self._calls)))


def main() -> None:
    """Print the table."""
    parser_of(__doc__).parse_args()
    if find_spec("exudyn") is None:
        raise SystemExit("exudyn is not installed: make setup WITH=peers")
    print(f"{'':48}{'largest':>12}{'rms':>10}{'a call':>12}")

    def show(name: str, found: Result) -> None:
        print(f"{name:48}{found.largest:10.1f} N{found.rms:8.1f} N{1e6 * found.call:9.1f} us", flush=True)

    best = min(((judged(pi_law(*gains)), gains) for gains in GAINS), key=lambda entry: entry[0].rms)
    show("PI, {:g} m/N and {:g} m/N/s".format(*best[1]), best[0])
    for law, wrong, companions in itertools.product(LAWS, (0.0, 0.2), ([], ["adaptation"])):
        controller = ehls.controller(rig(wrong), law, period=PERIOD, companions=companions)
        told = f"{100.0 * wrong:g} % wrong" if wrong else "told truly"
        show(", ".join((law, told, *companions)), judged(controller.step))


if __name__ == "__main__":
    main()
