"""Measuring steps of a commissioning: sensors at rest, signs by a nudge, the rig identified from a rich motion, the coupling.

Each step moves the rig no more than its sentence in the table of steps says. It returns the rig with the numbers found; a
contradiction between rig and files ends it with the remedy.
"""

import math
from collections.abc import Callable

import numpy as np

from ehls_ros.arrays import Array, in_python
from ehls_ros.control.controller import Controller
from ehls_ros.control.controllers import pid
from ehls_ros.control.controllers.base import model_of, saturate
from ehls_ros.control.disturbances.position_servo import STEADY, steady_gain, swinging_gain
from ehls_ros.control.local_plant import double_rod_of, speed_of
from ehls_ros.control.references import multi_sine
from ehls_ros.control.rig_scale import compression, largest_speed, oil_frequency, tuned_for, viscous_friction
from ehls_ros.estimate import Estimate
from ehls_ros.experiments.analysis import identify_whole_rig
from ehls_ros.experiments.catalogue import largest_force, room_of
from ehls_ros.experiments.commissioning.session import TRIP_LEVEL, Session, Stopped
from ehls_ros.experiments.commissioning.step import Contradiction, Finding, Known, Outcome
from ehls_ros.experiments.spec import COUPLING
from ehls_ros.identification.rig_coefficients import read, uses
from ehls_ros.physics import sensors
from ehls_ros.physics.data_sheet import COUPLING_DAMPING
from ehls_ros.physics.parameters import Limits, Sensor
from ehls_ros.physics.rig import CHAMBER_SENSED, SENSED, Rig, effects_from_list
from ehls_ros.progress import Update
from ehls_ros.recording.topics import READINGS
from ehls_ros.trajectory import SIGNALS, Trajectory
from ehls_ros.units import size

REST = 3.0
"""Duration of the step at rest [s], the last half of which is judged."""

OTHER_UNITS = ("bar", "MPa", "psi", "kPa")
"""Units in which a pressure may have been wired."""

SUPPLY_WITHIN = 0.3
"""Relative difference of the supply pressure from the rig file's above which they contradict each other."""

NUDGES = (0.02, 0.04, 0.08, 0.16, 0.3)
"""Openings of a nudge over the largest spool command, tried until the piston moves."""

PULSE, PAUSE = 0.3, 0.2
"""Duration of a nudge to one side, and of the rest after it [s]."""

MOVED, SIGMAS = 1e-3, 20.0
"""Travel of a nudge that shows its sign: over the stroke, and over the noise of a reading."""

LOOK = 1.0
"""Time at rest before each motion, in which the rig settles [s]."""

LOADED, FORCE_RATIO = 0.01, (0.5, 2.0)
"""Load over the largest force from which force and pressure are compared, and the ratios that a rig may have."""

FEWEST = 50
"""Fewest samples of a nudge that the gate ended from which signs are told."""

TRAVEL = 0.05
"""Travel over the stroke at which a nudge ends."""

MOTION, HARMONICS, LOWEST = 20.0, 24, 0.15
"""Rich motion: duration [s], number of sines and lowest frequency [Hz]."""

ROOM_PART, SPEED_PART = 0.4, 0.4
"""Largest travel of that motion over the room to the nearer end, and largest velocity over the loader's."""

MOTION_FORCE = 0.5
"""Largest force that a motion needs over that left beside the weight: mass and friction are not known yet, the oil swings."""

LEAST_DAMPING = 0.01
"""Rate at which the oil's swing is damped at least, over its natural frequency, however little damping the file has."""

DITHER, DITHER_FORCE, HELD = 0.01, 0.1, 6
"""Random part of the command over its largest value, the rms of its force over that left beside the weight above which it is
smaller, and number of cycles for which it is held; it shows valve and oil."""

CREEP, CREEP_FREQUENCY, CREEP_PARTS = 20.0, 0.5, (2e-3, 0.1)
"""Slow motion: duration [s], frequency of its sine [Hz], and velocity at first and at last over the loader's. Only slow motion
shows how friction changes from sticking to sliding."""

PRESSING, PRESS_PART, PRESS_FREQUENCY = 20.0, 0.4, 0.1
"""Slow sine of the force against the actuator under test: duration [s], amplitude over the largest force, frequency [Hz]."""

PRESSINGS, PRESSED = 3, 0.5
"""Most such recordings, and least range of the force over the wanted one at which no further one follows."""

PRESS_BANDWIDTH, PRESS_OPENING = 10.0, 0.3
"""Bandwidth of the force loop with a coupling as stiff as the oil [1/s]; largest opening over the largest spool command."""

ACTUATOR_YIELDS = 1.0 / math.sqrt(3.0)
"""Standard error of the compliance of the actuator under test that holds its position, over that of its oil: with an integral
part it yields by nothing, with a proportional loop by up to twice that, and any value between is as likely."""

BLOCKS, SLIDING, CORRELATED = 400, 0.6, 20.0
"""Number of blocks over which force and position are averaged; velocity over the largest from which a block counts as sliding;
number of neighbouring blocks with the same error of form."""


def at_rest(session: Session, known: Known, progress: Update) -> Outcome:
    """Measure the noise of the sensors with the valve closed, and compare the supply pressure."""
    recording = session.record(None, REST)
    rig = known.rig
    findings, described = [], dict(rig.sensors)
    for signal in session.measured:
        values = recording[READINGS[signal]]
        if not np.all(np.isfinite(values)):
            missing = f"{signal} is at the end of its converter's range, or not a number"
            raise Contradiction(missing, "bridge file", f"a wired sensor, or a wider range of channels.{signal}")
        values = values[len(values) // 2 :]
        given, resolution = described.get(signal, Sensor()), session.resolution(signal)
        # The difference of neighbours is free of slow drift; the converter's rounding is told apart by its step.
        power = 0.5 * float(np.var(np.diff(values))) - resolution**2 / 12.0
        noise = math.sqrt(max(power, 0.0))
        if noise > 0.0:
            unit = SIGNALS[READINGS[signal]].unit
            estimate = Estimate(noise, noise / math.sqrt(len(values)), unit)
            findings.append(Finding(f"sensors.{signal}.noise_std", given.noise_std or math.nan, estimate))
        described[signal] = given._replace(noise_std=noise, resolution=resolution)
    _check_supply(recording, rig)
    return Outcome(rig._replace(sensors=described), tuple(findings), (), {"at_rest": recording})


def _check_supply(recording: Trajectory, rig: Rig) -> None:
    if "supply_pressure_pa" not in recording:
        return
    mean, given = float(np.mean(recording["supply_pressure_pa"])), rig.plant.supply_pressure
    if abs(mean / given - 1.0) <= SUPPLY_WITHIN:
        return
    unit = next((unit for unit in OTHER_UNITS if abs(mean * size(unit) / given - 1.0) <= SUPPLY_WITHIN), "")
    remedy = f"channels.supply_pressure.scale {size(unit):g} times as large ({unit})" if unit else "a running pump"
    what = f"supply_pressure reads {mean:.4g} Pa, the rig file has {given:.4g} Pa"
    raise Contradiction(what, "bridge file", f"{remedy}, or another supply_pressure in the rig file")


def nudge(session: Session, known: Known, progress: Update) -> Outcome:
    """Open the valve a little to each side, compare the signs of the readings, and find their steps."""
    rig, limits = known.rig, known.rig.limits
    stroke = limits.position[1] - limits.position[0]
    noise = rig.sensors.get("position", Sensor()).noise_std
    needed = max(MOVED * stroke, SIGMAS * noise)
    # Before any motion, as a gate that finds force and pressure to disagree does not open.
    _check_force(session.record(None, LOOK), session, rig)
    for number, part in enumerate(NUDGES):
        progress(number, len(NUDGES))
        try:
            recording = _nudged(session, part * limits.spool, stroke)
        except Stopped as stopped:
            # A reversed sensor makes the gate close the valve.
            if len(stopped.recording) > FEWEST:
                _check_signs(stopped.recording, session, _change(stopped.recording, "position_m"))
            raise
        moved = _change(recording, "position_m")
        if abs(moved) >= needed:
            _check_signs(recording, session, moved)
            sentence = f"an opening of {100.0 * part:g} % moves the piston by {1e3 * abs(moved):.3g} mm in {PULSE:g} s"
            return Outcome(_with_steps(rig, recording, session), (), (sentence,), {"nudge": recording})
    what = f"an opening of {100.0 * NUDGES[-1]:g} % moves the piston by {1e3 * abs(moved):.3g} mm only"
    raise Contradiction(what, "rig", "a running pump, an open shut-off valve, and a wired command and position")


def _check_force(recording: Trajectory, session: Session, rig: Rig) -> None:
    """Compare the force with the load pressure times the piston area, where there is enough of it.

    Raises:
        Contradiction: their ratio is not near 1.
    """
    if not {"force_n", "load_pressure_pa"} <= set(recording.signals):
        return
    force, by_pressure = recording["force_n"], rig.plant.piston_area * recording["load_pressure_pa"]
    if max(np.max(np.abs(force)), np.max(np.abs(by_pressure))) < LOADED * largest_force(rig):
        return
    ratio = float(force @ by_pressure / (by_pressure @ by_pressure))
    if FORCE_RATIO[0] <= ratio <= FORCE_RATIO[1]:
        return
    what = f"the force is {ratio:.3g} times load pressure times piston area"
    sign = ratio < 0.0 and FORCE_RATIO[0] <= -ratio <= FORCE_RATIO[1]
    remedy = "with the other sign" if sign else "in the unit of the channel"
    raise Contradiction(what, "bridge file", f"channels.force.scale or {_scale_of('load_pressure', session)} {remedy}")


def _scale_of(signal: str, session: Session) -> str:
    """Return the keys of a bridge file that scale a signal."""
    return f"channels.{signal}.scale" if signal in session.wired else " or ".join(f"channels.{s}.scale" for s in CHAMBER_SENSED)


def _with_steps(rig: Rig, recording: Trajectory, session: Session) -> Rig:
    """Return the rig with the steps of its sensors' readings, of which a moving one shows the smallest.

    A sensor may round to larger steps than its converter. At rest, its reading then stays on one of them and hides the noise.
    """
    described = dict(rig.sensors)
    for signal in described.keys() & set(session.wired):
        changes = np.abs(np.diff(recording[READINGS[signal]]))
        changes = changes[changes > 0.5 * session.resolution(signal)]
        if changes.size:
            sensor, resolution = described[signal], float(np.min(changes))
            noise = math.sqrt(max(sensor.reading_std**2 - resolution**2 / 12.0, 0.0))
            described[signal] = sensor._replace(noise_std=noise, resolution=resolution)
    return rig._replace(sensors=described)


def _nudged(session: Session, opening: float, stroke: float) -> Trajectory:
    """Return the recording of a pulse to either side; each ends early after :data:`TRAVEL`."""
    pulse, pause = round(PULSE / session.period), round(PAUSE / session.period)
    start = [math.nan, math.nan]

    def law(m: Array, cycle: int) -> float:
        side, within = divmod(cycle, pulse + pause)
        if within >= pulse or side > 1:
            return 0.0
        if within == 0:
            start[side] = float(m[sensors.POSITION])
        if abs(float(m[sensors.POSITION]) - start[side]) > TRAVEL * stroke:
            return 0.0
        # Smooth, as after a step a reading without noise would seem frozen until it answers.
        shape = math.sin(math.pi * within / pulse) ** 2
        return opening * shape if side == 0 else -opening * shape

    return session.record(law, 2.0 * (PULSE + PAUSE))


def _change(recording: Trajectory, signal: str) -> float:
    """Return the change of a signal under a positive command; of the position, the travel."""
    values, command = recording[signal], recording["valve_command_m"]
    side = np.where(np.abs(command) > 0.5 * np.max(np.abs(command)), np.sign(command), 0.0)
    if signal == "position_m":
        steps = np.diff(values)
        return _slope(side[1:], steps) * np.count_nonzero(side > 0.0)
    return _slope(side, values)


def _slope(side: Array, values: Array) -> float:
    columns = np.stack((side, np.ones(len(side))), axis=1)
    return float(np.linalg.lstsq(columns, values, rcond=None)[0][0])


def _check_signs(recording: Trajectory, session: Session, moved: float) -> None:
    """Compare the signs of position, load pressure, spool and force with the command's.

    Raises:
        Contradiction: one of them is reversed.
    """
    signs = {"position": moved}
    for signal in ("spool_position", "load_pressure", "force"):
        if signal in session.measured:
            signs[signal] = _change(recording, READINGS[signal])
    reversed_ones = [signal for signal, change in signs.items() if change < 0.0]
    if not reversed_ones:
        return
    if len(reversed_ones) == len(signs) or set(reversed_ones) == set(signs) - {"spool_position"}:
        what = "a positive command moves the piston towards negative positions, and the load pressure agrees"
        remedy = "command.scale with the other sign, or the valve's ports exchanged"
        raise Contradiction(what, "bridge file", remedy)
    what = f"under a positive command, {', '.join(reversed_ones)} changes to the negative side, unlike the other readings"
    remedy = ", ".join(f"{_scale_of(signal, session)} with the other sign" for signal in reversed_ones)
    if not set(reversed_ones) <= set(session.wired):
        remedy += ", or both pressures exchanged"
    raise Contradiction(what, "bridge file", remedy)


def motion(session: Session, known: Known, progress: Update) -> Outcome:
    """Move the piston by sines of many frequencies with a random part of the command, then slowly, and identify the rig."""
    rig = known.rig
    if not {"force", "load_pressure"} & set(session.measured):
        raise Contradiction("neither force nor load pressure is wired", "bridge file", "a channel for one of both")
    recordings = dict[str, Trajectory]()
    for name, moving, duration in (("motion", _rich_motion, MOTION), ("slow_motion", _slow_motion, CREEP)):
        resting = _load_pressure(session.record(None, LOOK), rig)
        recordings[name] = session.record(moving(session, rig, resting), duration)
    found = identify_whole_rig(recordings, rig, seed=0, progress=progress)
    findings = tuple(Finding(path, _given(rig, path), estimate) for path, estimate in found.estimates.items())
    unknown = tuple(f"{path} is not identified: {why}" for path, why in found.not_identifiable.items())
    return Outcome(found.rig, findings, (*found.remarks, *unknown), recordings)


def _load_pressure(recording: Trajectory, rig: Rig) -> float:
    """Return the mean load pressure [Pa]; at rest, it carries the weight."""
    if "load_pressure_pa" in recording:
        return float(np.mean(recording["load_pressure_pa"]))
    return float(np.mean(recording["force_n"])) / rig.plant.piston_area


def _rich_motion(session: Session, rig: Rig, resting: float) -> Callable[[Array, int], float]:
    times = _times(session, MOTION)
    unit = multi_sine.sample(times, multi_sine.Parameters(1.0, LOWEST, HARMONICS))
    speed = SPEED_PART * speed_of(rig)
    scale = min(ROOM_PART * room_of(rig) / np.max(np.abs(unit[:, 0])), speed / np.max(np.abs(unit[:, 1])))
    left = _force_left(rig, resting)
    scale *= _allowed(rig, scale * unit, left)
    random = np.random.default_rng(0)
    dither = np.repeat(random.choice([-1.0, 1.0], len(times) // HELD + 1), HELD)[: len(times)]
    # Force of the mass that swings on the oil, driven by a velocity that is random from one value held to the next.
    lasting = HELD * session.period / (2.0 * _damping(rig))
    swing = rig.plant.moving_mass * oil_frequency(rig.plant) ** 2 * DITHER * speed_of(rig) * math.sqrt(lasting)
    size = DITHER * min(1.0, DITHER_FORCE * left / swing)
    return _following(session, rig, resting, scale * unit, size * rig.limits.spool * dither)


def _slow_motion(session: Session, rig: Rig, resting: float) -> Callable[[Array, int], float]:
    """Return a sine whose velocity grows exponentially, so that each velocity has as many periods as any other."""
    times, turn = _times(session, CREEP), 2.0 * math.pi * CREEP_FREQUENCY
    first, last = (part * speed_of(rig) for part in CREEP_PARTS)
    last = min(last, ROOM_PART * room_of(rig) * turn)
    rate = math.log(last / first) / CREEP + 1j * turn
    wave = first / turn * np.exp(rate * times)
    wanted = np.stack([(rate**derivative * wave).imag for derivative in range(3)], axis=1)
    allowed = _allowed(rig, wanted, _force_left(rig, resting))
    return _following(session, rig, resting, allowed * wanted, np.zeros(len(times)))


def _force_left(rig: Rig, resting: float) -> float:
    """Return the force left up to the gate's limit beside the weight, which the load pressure at rest carries [N]."""
    return max(TRIP_LEVEL * largest_force(rig) - rig.plant.piston_area * abs(resting), 0.0)


def _allowed(rig: Rig, course: Array, left: float) -> float:
    """Return the factor, at most 1, on a course from mid-stroke (cycles, 3) for which its force stays within that left [N]."""
    plant, most = rig.plant, MOTION_FORCE * left
    position, velocity, acceleration = course.T
    moving: Array = plant.moving_mass * acceleration + viscous_friction(rig) * velocity + plant.spring_stiffness * position
    unrubbed: float = most - rig.friction._asdict().get("coulomb_force", 0.0)
    return min(1.0, max(unrubbed, 0.1 * most) / float(np.max(np.abs(moving))))


def _damping(rig: Rig) -> float:
    """Return the rate at which the oil's swing is damped by leakage and friction [1/s]."""
    return max(swinging_gain(rig, rig.plant.moving_mass), LEAST_DAMPING * oil_frequency(rig.plant))


def _times(session: Session, duration: float) -> Array:
    return session.period * np.arange(round(duration / session.period) + 1, dtype=np.float64)


def _following(session: Session, rig: Rig, resting: float, course: Array, added: Array) -> Callable[[Array, int], float]:
    """Return the command by which the piston follows a course around mid-stroke.

    Args:
        session: the session.
        rig: the rig.
        resting: load pressure at rest [Pa].
        course: position, velocity and acceleration from mid-stroke in each cycle, shape (cycles, 3).
        added: what is added to the command, shape (cycles,) [m].
    """
    limits: Limits = rig.limits
    times = session.period * np.arange(len(course))
    middle = 0.5 * (limits.position[0] + limits.position[1])
    tuning = tuned_for(pid.Parameters, rig)
    calm = STEADY * _damping(rig)
    tuning = tuning._replace(proportional=min(tuning.proportional, calm), integral=min(tuning.integral, 0.25 * calm**2))
    loop = Controller("pid", tuning, model_of(rig, session.period), None, rig.cylinder.model, rig.valve.model)
    start = [math.nan]

    def law(m: Array, cycle: int) -> float:
        if cycle == 0:
            start[0] = float(m[sensors.POSITION])
        # From where the piston is to mid-stroke in the first second, so that no step is asked for.
        blend = min(times[cycle], 1.0)
        wanted = blend * course[cycle]
        wanted[0] += start[0] + (middle - start[0]) * blend
        unloaded = m.copy()
        # A command that makes up for a changing load takes from the oil the damping by leakage and valve. The weight is
        # constant; without it, the piston sinks faster than the loop may correct.
        unloaded[sensors.LOAD_PRESSURE] = resting
        unloaded[len(SENSED) :] = np.nan
        return float(loop.step(unloaded, wanted, np.zeros(2)) + blend * added[cycle])

    return law


def coupling(session: Session, known: Known, progress: Update) -> Outcome:
    """Press against the actuator under test, which holds still, and measure the stiffness of the coupling between both."""
    rig = known.rig
    if not {"force", "position"} <= set(session.wired):
        raise Contradiction("force or position is not wired", "bridge file", "channels for both, or the coupling by hand")
    oil_stiffness = in_python(compression)(rig.plant) * rig.plant.piston_area
    softer = 1.0
    for trial in range(PRESSINGS):
        progress(trial, PRESSINGS)
        session.record(None, LOOK)
        recording = session.record(_pressing(session, rig, softer), PRESSING, presses=True)
        stiffness = _stiffness(recording, rig)
        if float(np.ptp(recording["force_n"])) > PRESSED * 2.0 * PRESS_PART * largest_force(rig):
            break
        # While friction sticks, its stiffness counts too: the next loop is slow enough.
        softer = max(1.0 + oil_stiffness / stiffness.value, softer)
    stiffness = _without_actuator(stiffness, rig, oil_stiffness)
    path = f"effects.{COUPLING}.stiffness"
    finding = Finding(path, _given(rig, path), stiffness)
    damping = COUPLING_DAMPING * stiffness.value
    told = effects_from_list([{"name": COUPLING, "stiffness": stiffness.value, "damping": damping}], "commissioning")
    others = tuple(use for use in rig.effects if use.name != COUPLING)
    return Outcome(rig._replace(effects=others + told), (finding,), (), {"coupling": recording})


def _pressing(session: Session, rig: Rig, softer: float) -> Callable[[Array, int], float]:
    """Return a slow sine of the force.

    Args:
        session: the session.
        rig: the rig.
        softer: stiffness of the oil over that of oil and coupling in series; 1 is stable with any coupling.
    """
    plant, limit = double_rod_of(rig).rig.plant, rig.limits.spool
    amplitude, turn = PRESS_PART * largest_force(rig), 2.0 * math.pi * PRESS_FREQUENCY
    oil_stiffness = in_python(compression)(plant) * plant.piston_area
    # Opening per error of the force.
    gain = softer * PRESS_BANDWIDTH / oil_stiffness * limit / (in_python(largest_speed)(plant, limit) * plant.valve_gain)
    start = [math.nan]

    def law(m: Array, cycle: int) -> float:
        if cycle == 0:
            start[0] = float(m[sensors.FORCE])
        wanted = start[0] + amplitude * math.sin(turn * cycle * session.period)
        passed: float = saturate(gain * (wanted - float(m[sensors.FORCE])), PRESS_OPENING * limit)
        return passed

    return law


def _stiffness(recording: Trajectory, rig: Rig) -> Estimate:
    """Return the stiffness of coupling and actuator: the slope of the force over the position where the friction slips [N/m].

    Raises:
        Contradiction: the piston hardly moves, or the force does not grow with the position.
    """
    position, force = recording["position_m"], recording["force_n"]
    # Means over blocks, whose differences give the direction of motion.
    block = max(len(position) // BLOCKS, 1)
    blocks = len(position) // block
    x, f = (values[: blocks * block].reshape(blocks, block).mean(axis=1) for values in (position, force))
    velocity = np.gradient(x)
    sliding = np.abs(velocity) > SLIDING * np.max(np.abs(velocity))
    columns = np.stack((x, np.sign(velocity), velocity, np.ones(blocks)), axis=1)[sliding]
    solution, *_ = np.linalg.lstsq(columns, f[sliding], rcond=None)
    left = f[sliding] - columns @ solution
    # Neighbouring blocks have similar errors: those of form, not of noise.
    independent = max(len(left) / CORRELATED, 1.0)
    covariance = np.linalg.pinv(columns.T @ columns) * float(np.mean(left**2)) * len(left) / independent
    slope, deviation = float(solution[0]), math.sqrt(float(covariance[0, 0]))
    stiffness = slope - rig.plant.spring_stiffness
    if not stiffness > 3.0 * deviation:
        what = f"the force grows by {slope:.3g} N/m with the position, {deviation:.2g} N/m uncertain"
        raise Contradiction(what, "rig", "a rod connected to the actuator under test, which holds its position")
    return Estimate(stiffness, deviation, "N/m")


def _without_actuator(both: Estimate, rig: Rig, oil_stiffness: float) -> Estimate:
    """Return the stiffness of the coupling alone, as the laws and the simulated rig have it beside the actuator's oil.

    Args:
        both: stiffness of coupling and actuator in series [N/m].
        rig: the rig. The actuator is taken to be like its loader, and to hold its position by a proportional loop, which makes
            up for the leakage.
        oil_stiffness: stiffness of its oil [N/m].
    """
    plant, half = rig.plant, 0.5 / both.value
    # Where it is as stiff as the coupling or less, no more than half of the compliance counts as the actuator's.
    leaking = plant.leakage_coefficient > 0.0
    yields = min(plant.leakage_coefficient / (steady_gain(rig) * plant.piston_area**2), half) if leaking else 0.0
    stiffness = 1.0 / (1.0 / both.value - yields)
    deviation = math.hypot(both.std / both.value**2, ACTUATOR_YIELDS * min(1.0 / oil_stiffness, half))
    return Estimate(stiffness, stiffness**2 * deviation, both.unit)


def _given(rig: Rig, path: str) -> float:
    """Return a coefficient of the rig file; NaN if it belongs to an effect that the rig has not."""
    return read(rig, path) if uses(rig, path) else math.nan
