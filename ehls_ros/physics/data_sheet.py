"""Convert data sheet figures to the coefficients of a rig.

A cylinder's data sheet gives diameters and a valve's gives a flow at a pressure drop; the model needs neither. Each conversion
is defined once, here. Figures that no data sheet gives are assumed, with a note of the measurement that replaces them.
"""

import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal, NamedTuple, get_type_hints

from ehls_ros.errors import BadInput
from ehls_ros.physics.parameters import Plant
from ehls_ros.schema import Misfit, fitted, notes, parse, quantity, text
from ehls_ros.units import in_unit, size

DAMPING = 0.7
"""Damping ratio of a servo valve, to convert its frequency at -90° to the bandwidth of a first-order lag [1]."""

BREAK_AWAY = 1e-4
"""Travel over which static friction builds up: seals yield by about 0.1 mm [m]."""

SEALS, OVER_COULOMB, STRIBECK = 0.03, 1.3, 5e-3
"""Assumptions on seals: friction over the largest force, static over Coulomb friction, Stribeck velocity [m/s]."""

GRAVITY = 9.81
"""Gravitational acceleration [m/s^2]."""

SETTLING = 0.3
"""Assumed settling time of sliding friction to the Stribeck curve [s]."""

COUPLING_DAMPING = 1e-3
"""Assumed damping over stiffness of the coupling to the actuator under test [s]."""

LEAKING = 0.02
"""Assumed leakage at supply pressure, as a fraction of the rated flow."""


Figure = float | None


class DataSheet(NamedTuple):
    """Data sheet figures of cylinder, valve, pump and load; a usual value is assumed in place of None."""

    bore: Annotated[float, quantity("mm", "piston diameter (cylinder: 'bore' or 'piston Ø')", minimum=1.0, maximum=1e3)]
    rod: Annotated[float, quantity("mm", "rod diameter (cylinder: 'rod Ø')", minimum=0.0, maximum=1e3)]
    rods: Annotated[Literal["two", "one"], text("two: through both heads, so that both areas are equal; one: on one side")]
    stroke: Annotated[float, quantity("mm", "whole stroke (cylinder: type code)", minimum=0.1, maximum=1e5)]
    supply_pressure: Annotated[
        float, quantity("bar", "pressure at the valve's port P (pump or relief valve)", minimum=1.0, maximum=2e3)
    ]
    rated_flow: Annotated[float, quantity("l/min", "flow at full opening (valve: 'rated flow')", minimum=1e-2, maximum=1e5)]
    rated_drop: Annotated[
        float, quantity("bar", "pressure drop at which that flow is rated (valve: beside it)", minimum=0.1, maximum=1e3)
    ]
    drop_over: Annotated[
        Literal["valve", "edge"],
        text("that drop is over the whole valve, P to A and B to T, as of servo valves (70 bar), or over one metering edge"),
    ] = "valve"
    rated_input: Annotated[
        str, text("input at full opening, such as 40 mA or 10 V (valve: 'rated current' or 'command signal')")
    ] = ""
    spool_travel: Annotated[
        Figure,
        quantity("mm", "spool travel at full opening (valve: seldom given)", minimum=1e-3, maximum=100.0, typical=1.0),
    ] = None
    bandwidth: Annotated[
        Figure, quantity("Hz", "bandwidth (valve: frequency response)", minimum=0.1, maximum=2e3, typical=60.0)
    ] = None
    bandwidth_at: Annotated[
        Literal["-90 deg", "-3 dB"], text("where that was read: at -90 deg of phase or at -3 dB of amplitude")
    ] = "-90 deg"
    moving_mass: Annotated[Figure, quantity("kg", "mass of piston, rod and load", minimum=0.1, maximum=1e6, typical=100.0)] = (
        None
    )
    rod_points: Annotated[Literal["level", "up", "down"], text("where the rod moves while the position grows")] = "level"
    spring: Annotated[Figure, quantity("N/mm", "stiffness of a spring at the load", minimum=0.0, maximum=1e7, typical=0.0)] = (
        None
    )
    arm: Annotated[Figure, quantity("m", "lever arm of the load", minimum=1e-3, maximum=100.0, typical=0.5)] = None
    damping: Annotated[Figure, quantity("N s/m", "damper at the load", minimum=0.0, maximum=1e7, typical=0.0)] = None
    friction: Annotated[
        Figure, quantity("N", "friction of slow sliding (cylinder: 'friction'; or a slow stroke)", minimum=1e-3, maximum=1e7)
    ] = None
    dead_volume: Annotated[
        Figure, quantity("cm^3", "oil in hoses, manifold and dead ends of both sides together", minimum=0.0, maximum=1e6)
    ] = None
    cylinder: Annotated[
        Literal["double_rod", "two_chamber"],
        text(
            "model of the cylinder, double_rod: one pressure on the mean area, for diagnosis and identification too; "
            "two_chamber: a pressure on each area, for simulation and control"
        ),
    ] = "double_rod"
    hose_a: Annotated[
        Figure, quantity("cm^3", "oil in hose, manifold and dead end of the side without rod, A", minimum=0.0, maximum=1e6)
    ] = None
    hose_b: Annotated[
        Figure, quantity("cm^3", "oil in hose, manifold and dead end of the rod side, B", minimum=0.0, maximum=1e6)
    ] = None
    flow_pa: Annotated[
        Figure, quantity("l/min", "rated flow from P to A, if it differs from rated_flow", minimum=1e-2, maximum=1e5)
    ] = None
    flow_at: Annotated[Figure, quantity("l/min", "rated flow from A to T, likewise", minimum=1e-2, maximum=1e5)] = None
    flow_pb: Annotated[Figure, quantity("l/min", "rated flow from P to B, likewise", minimum=1e-2, maximum=1e5)] = None
    flow_bt: Annotated[Figure, quantity("l/min", "rated flow from B to T, likewise", minimum=1e-2, maximum=1e5)] = None
    tank_pressure: Annotated[
        Figure, quantity("bar", "pressure at the valve's port T", minimum=0.0, maximum=1e3, typical=0.0)
    ] = None
    oil_density: Annotated[
        Figure, quantity("kg/m^3", "density of the oil (oil: at 15 °C)", minimum=300.0, maximum=3e3, typical=860.0)
    ] = None
    bulk_modulus: Annotated[
        Figure, quantity("MPa", "bulk modulus of oil, hoses and air together", minimum=1.0, maximum=1e5, typical=1000.0)
    ] = None
    leakage: Annotated[
        Figure, quantity("l/min", "leakage past piston and spool at supply pressure", minimum=0.0, maximum=1e3)
    ] = None
    delay: Annotated[
        Figure,
        quantity("ms", "time from the reading to the valve's input: cycles, field bus, converters", minimum=0.0, maximum=50.0),
    ] = None
    coupling: Annotated[
        Figure,
        quantity("N/mm", "stiffness between rod and actuator under test, once they are connected", minimum=1e-3, maximum=1e6),
    ] = None
    position_noise: Annotated[
        Figure, quantity("µm", "rms noise of the position reading, or its resolution / 3.5", minimum=0.0, maximum=1e4)
    ] = None
    pressure_noise: Annotated[
        Figure, quantity("kPa", "rms noise of the load pressure's reading, or its resolution / 3.5", minimum=0.0, maximum=1e4)
    ] = None
    force_noise: Annotated[
        Figure, quantity("N", "rms noise of the load cell's reading, or its resolution / 3.5", minimum=0.0, maximum=1e6)
    ] = None


OF_CHAMBERS = ("hose_a", "hose_b", "flow_pa", "flow_at", "flow_pb", "flow_bt", "tank_pressure")
"""Figures that only a cylinder of two chambers has."""

NOISES: Mapping[str, str] = {"position": "position_noise", "load_pressure": "pressure_noise", "force": "force_noise"}
"""Figure with the noise of each sensor."""

HINTS: Mapping[str, Any] = get_type_hints(DataSheet, include_extras=True)
"""Type and declaration of each figure."""

Origin = Literal["given", "computed", "assumed"]


class Source(NamedTuple):
    """A value with its origin.

    Attributes:
        value: the value in the SI unit of the rig file.
        origin: a data sheet figure, computed from such figures, or assumed.
        basis: the figure or the relation; for an assumption, also the measurement that replaces it.
    """

    value: Any
    origin: Origin
    basis: str


def mean_area(bore: float, rod: float, rods: str) -> float:
    """Return the piston area of the model [m^2]: the annulus of a double rod, or the mean of both areas of a single rod.

    Args:
        bore: piston diameter [m].
        rod: rod diameter [m].
        rods: ``two`` or ``one``.
    """
    a, b = areas(bore, rod, rods)
    return 0.5 * (a + b)


def areas(bore: float, rod: float, rods: str) -> tuple[float, float]:
    """Return the piston areas in the chambers A and B [m^2]; arguments as of :func:`mean_area`."""
    whole, ring = 0.25 * math.pi * bore**2, 0.25 * math.pi * (bore**2 - rod**2)
    return (ring, ring) if rods == "two" else (whole, ring)


def area_gradient(flow: float, drop: float, opening: float, discharge_coefficient: float, oil_density: float) -> float:
    """Return the valve's area gradient [m], area per spool displacement, from its rated flow by the orifice law (1).

    Args:
        flow: rated flow [m^3/s].
        drop: pressure drop over both metering edges together at that flow [Pa].
        opening: spool displacement at that flow [m].
        discharge_coefficient: Cd [1].
        oil_density: rho [kg/m^3].
    """
    return flow / (discharge_coefficient * opening * math.sqrt(drop / oil_density))


def lag_bandwidth(frequency: float, at: str) -> float:
    """Return the bandwidth of a first-order lag [rad/s] with the delay of the valve.

    Args:
        frequency: frequency of that phase or amplitude in the Bode plot [Hz].
        at: ``-3 dB``, the bandwidth of a first-order lag; or ``-90 deg``, the natural frequency of a second-order valve, whose
            delay for slow commands is 2 ζ / ω.
    """
    natural = 2.0 * math.pi * frequency
    return natural if at == "-3 dB" else natural / (2.0 * DAMPING)


def answer(name: str, written: Any) -> Any:
    """Return the figure from an answer to a question of :class:`DataSheet`.

    Args:
        name: the field.
        written: the answer, a text with a unit or a value as in a YAML file.

    Raises:
        Misfit: the answer is not a valid figure.
    """
    unit = notes(DataSheet)[name].unit
    return fitted(HINTS[name], in_unit(written, unit) if unit and isinstance(written, str) else written)


def sheet_from_mapping(data: Any, where: str) -> DataSheet:
    """Return the data sheet from the checked content of a file of answers.

    Args:
        data: the parsed file; figures may have units, such as ``210 bar``.
        where: the file or terminal, for error messages.

    Raises:
        BadInput: an answer is missing, unknown or out of range, or the rod is as thick as the bore; the first is reported.
    """
    if not isinstance(data, Mapping):
        raise BadInput(f"it contains {data!r}", where, f"a mapping with {', '.join(DataSheet._fields)}")
    read = dict(data)
    for name in read.keys() & HINTS.keys():
        try:
            read[name] = answer(name, read[name])
        except Misfit as misfit:
            what = f"{name} is {misfit.value!r}"
            raise BadInput(what, where, f"{misfit.expected}{notes(DataSheet)[name].explained()}") from None
    sheet = parse(DataSheet, read, where)
    if sheet.rod >= sheet.bore:
        what = f"rod is {sheet.rod:g} mm, bore is {sheet.bore:g} mm"
        raise BadInput(what, where, "a rod thinner than the bore; are they swapped?")
    if sheet.cylinder == "double_rod":
        for name in OF_CHAMBERS:
            if getattr(sheet, name) is not None:
                raise BadInput(f"{name} is {getattr(sheet, name):g}", where, f"no {name}, or cylinder: two_chamber")
    return sheet


def rig_values(sheet: DataSheet) -> dict[str, dict[str, Source]]:
    """Return the values of a rig file by section and key, in the order of the file.

    Args:
        sheet: the figures.

    Returns:
        The keys of ``effects`` are names of effects with a parameter, such as ``command_delay.delay``; those of ``sensors`` are
        names of signals, with the noise.
    """
    plant = _plant(sheet)
    value = {key: source.value for key, source in plant.items()}
    travel = _figure(sheet, "spool_travel", "only its product with valve_area_gradient counts, unless the spool is recorded")
    pressure, area = value["supply_pressure"], value["piston_area"]
    opened = value["discharge_coefficient"] * value["valve_area_gradient"] * travel.value
    fastest = opened * math.sqrt(pressure / value["oil_density"]) / area
    half = 0.5 * sheet.stroke * size("mm")
    limits = {
        "spool": travel,
        "force": Source(pressure * area, "computed", "supply_pressure · piston_area"),
        "load_pressure": Source(pressure, "computed", "supply_pressure"),
        "position": Source([-half, half], "computed", "the stroke with 0 in its middle"),
        "velocity": Source(fastest, "computed", "flow at full opening and supply_pressure, over piston_area"),
    }
    sensors = {sensor: _figure(sheet, name) for sensor, name in NOISES.items() if getattr(sheet, name) is not None}
    effects = {} if sheet.delay is None else {"command_delay.delay": _figure(sheet, "delay")}
    if sheet.coupling is not None:
        stiffness = _figure(sheet, "coupling")
        damping = Source(COUPLING_DAMPING * stiffness.value, "assumed", f"{1e3 * COUPLING_DAMPING:g} ms times the stiffness")
        effects |= {"coupling_stiffness.stiffness": stiffness, "coupling_stiffness.damping": damping}
    friction = _friction(sheet, pressure * area, fastest)
    rest = {"friction": friction, "effects": effects, "sensors": sensors, "limits": limits}
    if sheet.cylinder == "double_rod":
        return {"plant": plant, **rest}
    cylinder = _chambers(sheet)
    a, b = cylinder["area_a"].value, cylinder["area_b"].value
    limits["force"] = Source(pressure * a, "computed", "supply_pressure · area_a")
    limits["load_pressure"] = Source(pressure * a / area, "computed", "limits.force over the mean area")
    out = math.sqrt(2.0 * pressure * a / (a**3 + b**3))
    limits["velocity"] = Source(
        opened * out / math.sqrt(value["oil_density"]), "computed", "outward at full opening without load, equal edges"
    )
    kept = {key: source for key, source in plant.items() if key not in ("piston_area", "total_volume")}
    return {"plant": kept, "cylinder": cylinder, "valve": _edges(sheet), **rest}


def _chambers(sheet: DataSheet) -> dict[str, Source]:
    """Return the values of a cylinder of two chambers."""
    stroke, found = sheet.stroke * size("mm"), dict[str, Source]()
    for side, area in zip("ab", areas(sheet.bore * size("mm"), sheet.rod * size("mm"), sheet.rods), strict=True):
        basis = "π/4 bore²" if side == "a" and sheet.rods == "one" else "π/4 (bore² - rod²)"
        found[f"area_{side}"] = Source(area, "computed", basis)
        half, hose = 0.5 * area * stroke, getattr(sheet, f"hose_{side}")
        volume = Source(2.0 * half, "assumed", f"area_{side} · stroke; measure hose and manifold")
        if hose is not None:
            volume = Source(half + hose * size("cm^3"), "computed", f"area_{side} · stroke / 2 + hose_{side}")
        elif sheet.dead_volume is not None:
            own = 0.5 * sheet.dead_volume * size("cm^3")
            volume = Source(half + own, "computed", f"area_{side} · stroke / 2 + dead_volume / 2")
        found[f"volume_{side}"] = volume
    return {**found, "tank_pressure": _figure(sheet, "tank_pressure", "a gauge at port T")}


def _edges(sheet: DataSheet) -> dict[str, Source]:
    """Return the gains of the four metering edges, relative to ``rated_flow``."""
    given = {edge: getattr(sheet, f"flow_{edge}") for edge in ("pa", "at", "pb", "bt")}
    return {
        f"gain_{edge}": Source(1.0, "assumed", "all edges pass rated_flow")
        if flow is None
        else Source(flow / sheet.rated_flow, "computed", f"flow_{edge} / rated_flow")
        for edge, flow in given.items()
    }


def _plant(sheet: DataSheet) -> dict[str, Source]:
    fitted = "`ehls identify --whole-rig` measures it"
    pressure, density = _figure(sheet, "supply_pressure"), _figure(sheet, "oil_density", "the oil's data sheet")
    travel = _figure(sheet, "spool_travel").value
    area = mean_area(sheet.bore * size("mm"), sheet.rod * size("mm"), sheet.rods)
    swept = area * sheet.stroke * size("mm")
    flow, drop = sheet.rated_flow * size("l/min"), sheet.rated_drop * size("bar")
    edges, over = (2.0, "2 · rated_drop") if sheet.drop_over == "edge" else (1.0, "rated_drop")
    discharge = notes(Plant)["discharge_coefficient"].typical
    volume = Source(2.0 * swept, "assumed", "twice piston_area · stroke; measure hoses and manifold")
    if sheet.dead_volume is not None:
        volume = Source(swept + sheet.dead_volume * size("cm^3"), "computed", "piston_area · stroke + dead_volume")
    leaking = Source(
        LEAKING * flow / pressure.value, "assumed", f"{100 * LEAKING:g} % of rated_flow at supply_pressure; {fitted}"
    )
    if sheet.leakage is not None:
        leaking = Source(sheet.leakage * size("l/min") / pressure.value, "computed", "leakage / supply_pressure")
    lag = "" if sheet.bandwidth_at == "-3 dB" else f" / (2 · {DAMPING:g}), as late as a second-order valve"
    bandwidth = _figure(sheet, "bandwidth")
    measured = f"; the spool's response to a chirp shows it, or {fitted}" if sheet.bandwidth is None else ""
    gravity = {"level": 0.0, "up": GRAVITY, "down": -GRAVITY}[sheet.rod_points]
    opening = (
        f": {travel:g} m at {sheet.rated_input}, of which the gain in a map of columns follows" if sheet.rated_input else ""
    )
    return {
        "supply_pressure": pressure,
        "oil_density": density,
        "bulk_modulus": _figure(sheet, "bulk_modulus", fitted),
        "discharge_coefficient": Source(discharge, "assumed", "sharp edges; valve_area_gradient makes up for it"),
        "valve_area_gradient": Source(
            area_gradient(flow, edges * drop, travel, discharge, density.value),
            "computed",
            f"rated_flow / (discharge_coefficient · spool_travel · sqrt({over} / oil_density)), equation (1)",
        ),
        "leakage_coefficient": leaking,
        "total_volume": volume,
        "moving_mass": _figure(sheet, "moving_mass", "weigh piston, rod and load"),
        "piston_area": Source(
            area,
            "computed",
            "π/4 (bore² - rod²)"
            if sheet.rods == "two"
            else "mean of π/4 bore² and π/4 (bore² - rod²), see docs/how_to/rig_data.md",
        ),
        "arm_length": _figure(sheet, "arm", "a tape measure"),
        "spring_stiffness": _figure(sheet, "spring", fitted),
        "viscous_damping": _figure(sheet, "damping", "counts together with viscous_coefficient"),
        "valve_bandwidth": bandwidth._replace(
            value=lag_bandwidth(bandwidth.value / size("Hz"), sheet.bandwidth_at),
            origin="assumed" if sheet.bandwidth is None else "computed",
            basis=f"2 π · {bandwidth.basis}{lag}{measured}",
        ),
        "valve_gain": Source(1.0, "computed", f"the command is a spool displacement{opening}"),
        "gravity": Source(gravity, "given", f"the rod moves {sheet.rod_points} while the position grows"),
    }


def _friction(sheet: DataSheet, largest: float, fastest: float) -> dict[str, Source]:
    """Return the friction values; ``largest`` is the largest force [N], ``fastest`` the largest velocity [m/s]."""
    replaced = "slow strokes both ways and `ehls identify` measure it"
    coulomb = Source(SEALS * largest, "assumed", f"{100 * SEALS:g} % of the largest force; {replaced}")
    if sheet.friction is not None:
        coulomb = _figure(sheet, "friction")
    static = OVER_COULOMB * coulomb.value
    assumed = {
        "static_force": (static, f"{OVER_COULOMB:g} coulomb_force"),
        "stribeck_velocity": (STRIBECK, "usual of seals"),
        "stribeck_exponent": (1.0, "usual of seals"),
        "viscous_coefficient": (coulomb.value / fastest, "coulomb_force at the largest velocity"),
        "element_stiffness": ([static / BREAK_AWAY], f"static_force over {1e3 * BREAK_AWAY:g} mm"),
        "element_weight": ([1.0], "one element"),
        "attraction_rate": (coulomb.value / SETTLING, f"coulomb_force in {SETTLING:g} s"),
    }
    return {
        "coulomb_force": coulomb,
        **{key: Source(value, "assumed", f"{basis}; {replaced}") for key, (value, basis) in assumed.items()},
    }


def _figure(sheet: DataSheet, name: str, replaced: str = "") -> Source:
    """Return a figure in its SI unit, or the usual value if it is missing.

    Args:
        sheet: the figures.
        name: name of the figure.
        replaced: measurement that replaces the usual value.
    """
    note, figure = notes(DataSheet)[name], getattr(sheet, name)
    used = note.typical if figure is None else figure
    basis = f"{used:g} {note.unit}"
    value = used * size(note.unit)
    return (
        Source(value, "assumed", "; ".join(filter(None, [basis, replaced])))
        if figure is None
        else Source(value, "given", basis)
    )
