"""Estimate the unmeasured states of a rig by an extended Kalman filter, and predict them over the command's delay.

    x'  = v
    m v' = Ac pL - (B0 + sigma_f) v - ks x - m g - sum F_i - R - d                (3)
    pL' = -e1 v - e2 pL + (1 + c) e3 sqrt(ps - sgn(xv) pL) xv + q                 (25)
    xv' = omega_v (Kv (1 + b) u(t - delay) - xv)                                  (4)
    x_a' = v_a
    m_a v_a' = R - kh x_a - (B0 + sigma_f) v_a,  R = kc (x - x_a) + cc (v - v_a)
    b' = -b/tau + white noise,  c' = -c/tau + white noise,  d''', q', o' = white noise

Position, load pressure, spool and force are measured, with force = Ac pL + o. The surroundings are a spring kc and a damper cc
to the actuator under test. The values of kc and cc are known. The actuator yields by x_a to the force R of the coupling, as its
mass m_a lies on the stiffness kh of its oil; by default, valve and cylinder are taken to be like the loader's. The force
of the motion that it makes of its own accord is d, since both motions superpose. A model with an immovable actuator is false at
the frequencies of both masses on coupling and oil, and a loop with a delay then oscillates at them. The states b and c are the
errors of valve gain and discharge coefficient. The states q and o are the unmodelled flow and the offset of the load cell. The
friction elements F_i follow the estimated velocity by (6) and (8). While they stick, a correction of the position also corrects
them. The velocity is observed mainly through the load pressure. Its change in a cycle resolves 0.2 um of motion, the position
sensor 5 um. The flow of a nearly closed valve contains other errors, but no information on c.

Mean and covariance are advanced together. The mean is integrated by Runge-Kutta steps of order 4 of the equations above. The
covariance is propagated by the exponential of their Jacobian. A reading that is not finite is skipped. The whole filter is
stored in one array, which a controller can keep.

Source: Anderson, Moore, Optimal Filtering, 1979, chapters 6 to 8; the delay as in Åström, Wittenmark, Computer-Controlled
Systems, 1997, section 3.2.
"""

import math
from typing import Annotated, NamedTuple

from ehls_ros.arrays import Array, copy, kernel, separate_kernel
from ehls_ros.control.controllers.base import MIN_DROP, Model
from ehls_ros.control.rig_scale import PAPER_FORCE, PAPER_PRESSURE, PAPER_SPEED, compression, largest_force, largest_speed
from ehls_ros.physics import sensors
from ehls_ros.physics.equations import applied_force, load_flow, load_pressure_rate, spool_rate
from ehls_ros.physics.friction.base import sign
from ehls_ros.physics.friction.gms import Parameters as Friction
from ehls_ros.physics.friction.gms import level as sliding_level
from ehls_ros.physics.plant import PL, XV, V, X
from ehls_ros.schema import quantity

FRICTION_MODEL = "gms"
"""Friction model in the filter. Its elements are linear in sticking and in slipping, as required for the covariance."""

EXTERNAL, EXTERNAL_RATE, EXTERNAL_CURVATURE, VALVE_GAIN, DISCHARGE, FLOW_ERROR, CELL_OFFSET = range(4, 11)
YIELD, YIELD_RATE, STATES = range(11, 14)
"""Indices in the mean of d with its two rates, b, c, q, o, x_a and v_a, and number of states. The plant's x, v, pL and xv come
first."""

MAX_ELEMENTS = 16
"""Maximum number of modelled friction elements; the force of further ones counts as external force."""

STORED_COMMANDS = 64
"""Number of sent commands that are stored."""

MAX_MEAN_STEP, MAX_MEAN_PHASE = 5e-4, 0.5
"""Longest Runge-Kutta step of the mean [s], and the largest advance of the fastest mode's phase in one [rad]."""

MAX_COVARIANCE_STEP, MAX_COVARIANCE_PHASE = 1e-3, 1.0
"""The same for the covariance, whose exponential is expanded to the fourth order."""

ROUNDING = 1e-9
"""Difference below which two times are equal [s]."""

GAIN_ERROR_TIME = 10.0
"""Time constant tau of the decay of unobserved errors of valve gain and discharge coefficient [s]."""

_LENGTH = STATES + MAX_ELEMENTS
_MATRIX = STATES * STATES
_EXPECTED = 4
MEMORY_SIZE = 1 + 2 * (_LENGTH + MAX_ELEMENTS) + 5 * _LENGTH + 4 * _MATRIX + STATES + 2 * STORED_COMMANDS + _EXPECTED + 1


MotionNoise = Annotated[
    float,
    quantity(
        "N s^1/2",
        "force missing in the model of the motion, root of its spectral density",
        minimum=0.0,
        maximum=1e6,
        scale="force",
    ),
]
OilNoise = Annotated[
    float,
    quantity(
        "Pa/s^1/2",
        "pressure rate missing in the model of the flow, root of its spectral density",
        minimum=0.0,
        maximum=1e9,
        scale="pressure",
    ),
]
ValveNoise = Annotated[
    float,
    quantity(
        "m/s^1/2",
        "spool rate missing in the model of the valve, root of its spectral density",
        minimum=0.0,
        maximum=1.0,
        scale="spool",
    ),
]
GainNoise = Annotated[float, quantity("1/s^1/2", "noise of the valve's gain", minimum=0.0, maximum=1e3)]
DischargeNoise = Annotated[float, quantity("1/s^1/2", "noise of the discharge coefficient", minimum=0.0, maximum=1e3)]
LeastOpening = Annotated[
    float,
    quantity("m", "smallest opening for estimating the discharge coefficient", minimum=0.0, maximum=1.0, scale="spool"),
]
FlowNoise = Annotated[float, quantity("Pa/s^3/2", "noise of the flow's error", minimum=0.0, maximum=1e12, scale="pressure")]
OffsetNoise = Annotated[float, quantity("N/s^1/2", "noise of the load cell's offset", minimum=0.0, maximum=1e6, scale="force")]
ActuatorMass = Annotated[float, quantity("kg", "moving mass of the actuator under test", above=0.0, maximum=1e5, scale="mass")]
ActuatorStiffness = Annotated[
    float,
    quantity(
        "N/m",
        "stiffness of the oil of the actuator under test",
        above=0.0,
        maximum=1e12,
        scale="force * compression / pressure",
    ),
]


class Assumptions(NamedTuple):
    """The filter's assumptions.

    Attributes:
        coupling_stiffness: kc [N/m].
        coupling_damping: cc [N s/m].
        command_delay: delay of a command to the valve [s].
        position_noise: standard deviation of a position reading, including rounding [m].
        pressure_noise: standard deviation of a load pressure reading [Pa].
        spool_noise: standard deviation of a spool reading [m].
        force_noise: standard deviation of a load cell reading [N].
        motion_noise: root of the spectral density of the force missing in (3) [N s^1/2].
        oil_noise: likewise of the pressure rate missing in (25) [Pa/s^1/2].
        valve_noise: likewise of the spool rate missing in (4) [m/s^1/2].
        external_noise: likewise of the external force's third derivative [N/s^5/2].
        gain_noise: likewise of the rate of the valve gain's error b [1/s^1/2].
        discharge_noise: likewise of the rate of the discharge coefficient's relative error c [1/s^1/2].
        least_opening: smallest valve opening for estimating c from its flow [m].
        flow_noise: root of the spectral density of the rate of the flow's error [Pa/s^3/2].
        offset_noise: likewise of the rate of the load cell's offset [N/s^1/2].
        actuator_mass: m_a [kg]; infinite for an actuator that does not yield.
        actuator_stiffness: kh [N/m].
    """

    coupling_stiffness: float
    coupling_damping: float
    command_delay: float
    position_noise: float
    pressure_noise: float
    spool_noise: float
    force_noise: float
    motion_noise: float
    oil_noise: float
    valve_noise: float
    external_noise: float
    gain_noise: float
    discharge_noise: float
    least_opening: float
    flow_noise: float
    offset_noise: float
    actuator_mass: float
    actuator_stiffness: float


class State(NamedTuple):
    """Parts of the filter, all views of one array of :data:`MEMORY_SIZE`.

    Attributes:
        started: 1 after the first measurement.
        mean: the estimate, followed by the friction elements' forces [N].
        mode: modes of the elements, as in :mod:`ehls_ros.physics.friction.base`.
        foreseen: the mean predicted to the time when the next command acts; then scratch of the controller.
        foreseen_mode: modes of the predicted mean.
        covariance: covariance of the estimate, shape (STATES, STATES).
        commands: sent spool commands, newest first [m].
        ages: times since they were sent [s].
        work: scratch, shape (5, length of the mean).
        matrices: scratch, shape (3, STATES, STATES).
        gain: scratch, shape (STATES,).
        expected: external force foreseen for the last cycle and its two derivatives, and 1 if there was one.
        yields: 1 while the actuator under test yields in the model, shape (1,).
    """

    started: Array
    mean: Array
    mode: Array
    foreseen: Array
    foreseen_mode: Array
    covariance: Array
    commands: Array
    ages: Array
    work: Array
    matrices: Array
    gain: Array
    expected: Array
    yields: Array


@kernel
def state_of(memory: Array) -> State:
    """Return the parts of a memory, shape (:data:`MEMORY_SIZE`,); all zero before the first measurement."""
    mean = 1
    foreseen = mean + _LENGTH + MAX_ELEMENTS
    covariance = foreseen + _LENGTH + MAX_ELEMENTS
    commands = covariance + _MATRIX
    work = commands + 2 * STORED_COMMANDS
    matrices = work + 5 * _LENGTH
    gain = matrices + 3 * _MATRIX
    return State(
        memory[:mean],
        memory[mean : mean + _LENGTH],
        memory[mean + _LENGTH : foreseen],
        memory[foreseen : foreseen + _LENGTH],
        memory[foreseen + _LENGTH : covariance],
        memory[covariance:commands].reshape((STATES, STATES)),
        memory[commands : commands + STORED_COMMANDS],
        memory[commands + STORED_COMMANDS : work],
        memory[work:matrices].reshape((5, _LENGTH)),
        memory[matrices:gain].reshape((3, STATES, STATES)),
        memory[gain : gain + STATES],
        memory[gain + STATES : gain + STATES + _EXPECTED],
        memory[gain + STATES + _EXPECTED : gain + STATES + _EXPECTED + 1],
    )


@kernel
def coupling_force(y: Array, p: Assumptions) -> float:
    """Return R for a mean [N]."""
    return p.coupling_stiffness * (y[X] - y[YIELD]) + p.coupling_damping * (y[V] - y[YIELD_RATE])


@kernel
def elements(friction: Friction) -> int:
    """Return the number of friction elements that are modelled."""
    return min(len(friction.element_stiffness), MAX_ELEMENTS)


@kernel
def side_gain(side: float, model: Model) -> float:
    """Return the flow per opening with a sign, over that with the coefficients of the model's plant."""
    return model.gain_positive if side > 0.0 else model.gain_negative


@kernel
def rates(y: Array, mode: Array, command: float, supply: float, model: Model, p: Assumptions, rate: Array) -> None:
    """Write the derivative of a mean.

    Args:
        y: the mean, in the layout of :class:`State`.
        mode: modes of the friction elements.
        command: spool command that has arrived at the valve [m].
        supply: supply pressure [Pa].
        model: model of the rig.
        p: the filter's assumptions.
        rate: output, as long as ``y``.
    """
    plant, friction = model.plant, model.friction
    level = sliding_level(y[V], friction)
    resisting = friction.viscous_coefficient * y[V]
    for i in range(elements(friction)):
        force = y[STATES + i]
        resisting += force
        if mode[i] == 0.0:
            rate[STATES + i] = friction.element_stiffness[i] * y[V]  # (6)
        else:
            rate[STATES + i] = friction.attraction_rate * (mode[i] * friction.element_weight[i] - force / level)  # (8)
    coupled = coupling_force(y, p)
    held = p.actuator_stiffness * y[YIELD] + (plant.viscous_damping + friction.viscous_coefficient) * y[YIELD_RATE]
    side = 1.0 if y[XV] >= 0.0 else -1.0
    flow = side_gain(side, model) * (1.0 + y[DISCHARGE]) * load_flow(y[XV], side, y[PL], supply, plant)
    rate[X] = y[V]
    rate[V] = (applied_force(y[X], y[V], y[PL], y[EXTERNAL], -coupled, plant) - resisting) / plant.moving_mass
    rate[PL] = load_pressure_rate(flow, y[V], y[PL], 0.0, plant.bulk_modulus, plant) + y[FLOW_ERROR]
    rate[XV] = spool_rate(y[XV], (1.0 + y[VALVE_GAIN]) * command, plant)
    rate[YIELD], rate[YIELD_RATE] = y[YIELD_RATE], (coupled - held) / p.actuator_mass
    rate[EXTERNAL], rate[EXTERNAL_RATE] = y[EXTERNAL_RATE], y[EXTERNAL_CURVATURE]
    rate[VALVE_GAIN] = -y[VALVE_GAIN] / GAIN_ERROR_TIME
    rate[DISCHARGE] = -y[DISCHARGE] / GAIN_ERROR_TIME
    rate[EXTERNAL_CURVATURE] = rate[FLOW_ERROR] = rate[CELL_OFFSET] = 0.0


@kernel
def switch(y: Array, mode: Array, friction: Friction) -> None:
    """Release elements at their break-away force, and make slipping ones stick at a reversal."""
    level, direction = sliding_level(y[V], friction), sign(y[V])
    for i in range(elements(friction)):
        if mode[i] == 0.0:
            most = friction.element_weight[i] * level
            if direction * y[STATES + i] > most:
                mode[i], y[STATES + i] = direction, direction * most
        elif mode[i] * y[V] < 0.0:
            mode[i] = 0.0


@kernel
def fastest_mode(model: Model, p: Assumptions) -> float:
    """Return the largest of the valve's bandwidth and the frequencies of both pistons, all elements sticking [rad/s]."""
    plant = model.plant
    actuator = math.sqrt((p.coupling_stiffness + p.actuator_stiffness) / p.actuator_mass)
    stiffness = plant.spring_stiffness + p.coupling_stiffness + compression(plant) * plant.piston_area
    for i in range(elements(model.friction)):
        stiffness += model.friction.element_stiffness[i]
    return max(math.sqrt(stiffness / plant.moving_mass), actuator, plant.valve_bandwidth)


@separate_kernel
def move(
    y: Array, mode: Array, command: float, supply: float, duration: float, model: Model, p: Assumptions, work: Array
) -> None:
    """Advance a mean under one command; arguments as those of :func:`rates`, ``duration`` [s], ``work`` of :class:`State`."""
    longest = min(MAX_MEAN_STEP, MAX_MEAN_PHASE / fastest_mode(model, p))
    steps = max(1, math.ceil((duration - ROUNDING) / longest))
    step = duration / steps
    length = STATES + elements(model.friction)
    stage, k1, k2, k3, k4 = work[0], work[1], work[2], work[3], work[4]
    for _ in range(steps):
        rates(y, mode, command, supply, model, p, k1)
        for i in range(length):
            stage[i] = y[i] + 0.5 * step * k1[i]
        rates(stage, mode, command, supply, model, p, k2)
        for i in range(length):
            stage[i] = y[i] + 0.5 * step * k2[i]
        rates(stage, mode, command, supply, model, p, k3)
        for i in range(length):
            stage[i] = y[i] + step * k3[i]
        rates(stage, mode, command, supply, model, p, k4)
        for i in range(length):
            y[i] += step / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i])
        switch(y, mode, model.friction)


@kernel
def arrived(t: float, delay: float, state: State) -> tuple[float, float]:
    """Return the command acting at the time ``t`` from now, and the end of its action [m, s]."""
    until = math.inf
    for i in range(STORED_COMMANDS):
        arrival = delay - state.ages[i]
        if arrival <= t + ROUNDING:
            return state.commands[i], until
        until = arrival
    return state.commands[STORED_COMMANDS - 1], until


@kernel
def linearise(state: State, command: float, supply: float, model: Model, p: Assumptions, jacobian: Array) -> None:
    """Write the Jacobian of the equations at the mean, including the stiffness of sticking elements."""
    plant, friction, y = model.plant, model.friction, state.mean
    damping = plant.viscous_damping + friction.viscous_coefficient
    stiffness = plant.spring_stiffness + p.coupling_stiffness
    for i in range(elements(friction)):
        if state.mode[i] == 0.0:
            stiffness += friction.element_stiffness[i]
    hydraulic = 4.0 * plant.bulk_modulus / plant.total_volume
    side = 1.0 if y[XV] >= 0.0 else -1.0
    drop = supply - side * y[PL]
    size = max(abs(drop), MIN_DROP * plant.supply_pressure)
    discharge = side_gain(side, model) * plant.discharge_coefficient
    nominal_gain = discharge * plant.valve_area_gradient * math.sqrt(size / plant.oil_density)
    # Beyond the supply pressure the flow reverses, and with it the effect of opening and discharge coefficient.
    passed = math.copysign(nominal_gain, drop)
    jacobian[:] = 0.0
    jacobian[X, V] = jacobian[YIELD, YIELD_RATE] = jacobian[PL, FLOW_ERROR] = 1.0
    jacobian[EXTERNAL, EXTERNAL_RATE] = jacobian[EXTERNAL_RATE, EXTERNAL_CURVATURE] = 1.0
    jacobian[V, X] = -stiffness / plant.moving_mass
    jacobian[V, V] = -(damping + p.coupling_damping) / plant.moving_mass
    jacobian[V, PL] = plant.piston_area / plant.moving_mass
    jacobian[V, EXTERNAL] = -1.0 / plant.moving_mass
    jacobian[V, YIELD] = p.coupling_stiffness / plant.moving_mass
    jacobian[V, YIELD_RATE] = p.coupling_damping / plant.moving_mass
    jacobian[YIELD_RATE, X] = p.coupling_stiffness / p.actuator_mass
    jacobian[YIELD_RATE, V] = p.coupling_damping / p.actuator_mass
    jacobian[YIELD_RATE, YIELD] = -(p.coupling_stiffness + p.actuator_stiffness) / p.actuator_mass
    jacobian[YIELD_RATE, YIELD_RATE] = -(damping + p.coupling_damping) / p.actuator_mass
    jacobian[PL, V] = -hydraulic * plant.piston_area
    throttled = (1.0 + y[DISCHARGE]) * nominal_gain * abs(y[XV]) / (2.0 * size)
    jacobian[PL, PL] = -hydraulic * (plant.leakage_coefficient + throttled)
    jacobian[PL, XV] = hydraulic * (1.0 + y[DISCHARGE]) * passed
    opened = y[XV] if abs(y[XV]) >= p.least_opening else 0.0
    jacobian[PL, DISCHARGE] = hydraulic * passed * opened
    jacobian[XV, XV] = -plant.valve_bandwidth
    jacobian[XV, VALVE_GAIN] = plant.valve_bandwidth * plant.valve_gain * command
    jacobian[VALVE_GAIN, VALVE_GAIN] = jacobian[DISCHARGE, DISCHARGE] = -1.0 / GAIN_ERROR_TIME


@kernel
def multiply(a: Array, b: Array, product: Array) -> None:
    """Write the product of two square matrices, the first of which is sparse."""
    size = len(a)
    for i in range(size):
        for j in range(size):
            product[i, j] = 0.0
        for k in range(size):
            factor = a[i, k]
            if factor != 0.0:
                for j in range(size):
                    product[i, j] += factor * b[k, j]


@separate_kernel
def spread(state: State, command: float, supply: float, duration: float, model: Model, p: Assumptions) -> None:
    """Advance the covariance by ``duration`` [s]."""
    covariance, jacobian, transition, product = state.covariance, state.matrices[0], state.matrices[1], state.matrices[2]
    linearise(state, command, supply, model, p, jacobian)
    # exp(A T) = I + A T (I + A T/2 (I + A T/3 (I + A T/4)))
    transition[:] = 0.0
    for i in range(STATES):
        transition[i, i] = 1.0
    for order in range(4, 0, -1):
        multiply(jacobian, transition, product)
        for i in range(STATES):
            for j in range(STATES):
                transition[i, j] = product[i, j] * duration / order
            transition[i, i] += 1.0
    multiply(transition, covariance, product)
    for i in range(STATES):
        for j in range(i + 1):
            total = 0.0
            for k in range(STATES):
                total += product[i, k] * transition[j, k]
            covariance[i, j] = covariance[j, i] = total
    covariance[V, V] += (p.motion_noise / model.plant.moving_mass) ** 2 * duration
    covariance[YIELD_RATE, YIELD_RATE] += (p.motion_noise / p.actuator_mass) ** 2 * duration
    covariance[PL, PL] += p.oil_noise**2 * duration
    covariance[XV, XV] += p.valve_noise**2 * duration
    covariance[EXTERNAL_CURVATURE, EXTERNAL_CURVATURE] += p.external_noise**2 * duration
    covariance[VALVE_GAIN, VALVE_GAIN] += p.gain_noise**2 * duration
    covariance[DISCHARGE, DISCHARGE] += p.discharge_noise**2 * duration
    covariance[FLOW_ERROR, FLOW_ERROR] += p.flow_noise**2 * duration
    covariance[CELL_OFFSET, CELL_OFFSET] += p.offset_noise**2 * duration


@separate_kernel
def advance(supply: float, model: Model, p: Assumptions, state: State) -> None:
    """Advance mean and covariance by a period under the commands that arrived in it."""
    for i in range(STORED_COMMANDS):
        state.ages[i] += model.period
    longest = min(MAX_COVARIANCE_STEP, MAX_COVARIANCE_PHASE / fastest_mode(model, p))
    t = -model.period
    while t < -ROUNDING:
        command, until = arrived(t, p.command_delay, state)
        duration = min(until, 0.0, t + longest) - t
        spread(state, command, supply, duration, model, p)
        move(state.mean, state.mode, command, supply, duration, model, p, state.work)
        t += duration


@separate_kernel
def correct(reading: float, signal: int, scale: float, offset: float, noise: float, state: State) -> None:
    """Correct the filter by one reading of ``scale`` times the mean at ``signal`` plus ``offset`` times o.

    ``noise`` is the standard deviation of the reading. A reading that is not finite is skipped.
    """
    mean, covariance, gain = state.mean, state.covariance, state.gain
    innovation = reading - scale * mean[signal] - offset * mean[CELL_OFFSET]
    if not math.isfinite(innovation):
        return
    for i in range(STATES):
        gain[i] = scale * covariance[i, signal] + offset * covariance[i, CELL_OFFSET]
    variance = scale * gain[signal] + offset * gain[CELL_OFFSET] + noise * noise
    for i in range(STATES):
        mean[i] += gain[i] * innovation / variance
    for i in range(STATES):
        for j in range(i + 1):
            covariance[i, j] -= gain[i] * gain[j] / variance
            covariance[j, i] = covariance[i, j]


FIRST_VELOCITY = 0.01
"""Standard deviation of the velocity at the first measurement on the paper's rig [m/s], scaled with the rig's speed."""

FIRST_FORCE, FIRST_FORCE_RATE, FIRST_FORCE_CURVATURE = 1e3, 1e5, 1e6
"""Standard deviations of the external force about balance and of its rates [N, N/s, N/s^2]. They scale with the rig's force."""

FIRST_GAIN, FIRST_DISCHARGE, FIRST_FLOW, FIRST_OFFSET = 0.1, 0.1, 1e7, 100.0
"""Standard deviations of the errors of valve gain and discharge coefficient [1], flow [Pa/s] and load cell [N].

The third scales with the rig's supply pressure, the last with the rig's force.
"""


@separate_kernel
def start(measured: Array, model: Model, p: Assumptions, state: State) -> None:
    """Start at rest from the first measurement, with the external force in balance."""
    plant, y, covariance = model.plant, state.mean, state.covariance
    force, pressure = largest_force(plant) / PAPER_FORCE, plant.supply_pressure / PAPER_PRESSURE
    speed = largest_speed(plant, model.spool_limit) / PAPER_SPEED
    y[X], y[PL], y[XV] = measured[sensors.POSITION], measured[sensors.LOAD_PRESSURE], measured[sensors.SPOOL]
    y[EXTERNAL] = applied_force(y[X], 0.0, y[PL], 0.0, -p.coupling_stiffness * y[X], plant)
    deviations = (
        p.position_noise,
        FIRST_VELOCITY * speed,
        p.pressure_noise,
        p.spool_noise,
        FIRST_FORCE * force,
        FIRST_FORCE_RATE * force,
        FIRST_FORCE_CURVATURE * force,
        FIRST_GAIN,
        FIRST_DISCHARGE,
        FIRST_FLOW * pressure,
        FIRST_OFFSET * force,
    )
    for i in range(len(deviations)):
        covariance[i, i] = deviations[i] ** 2
    state.started[0] = 1.0


@kernel
def let_yield(p: Assumptions, state: State) -> None:
    """Begin or end the yielding of the actuator under test in the model, without a step of the force on the piston.

    It begins in balance with the piston. A yielding that is not modelled is part of d.
    """
    yields = 1.0 if math.isfinite(p.actuator_mass) else 0.0
    if yields == state.yields[0]:
        return
    y, covariance = state.mean, state.covariance
    before = coupling_force(y, p)
    part = yields * p.coupling_stiffness / (p.coupling_stiffness + p.actuator_stiffness)
    y[YIELD], y[YIELD_RATE] = part * y[X], part * y[V]
    y[EXTERNAL] += before - coupling_force(y, p)
    for i in range(STATES):
        covariance[YIELD, i] = covariance[i, YIELD] = covariance[YIELD_RATE, i] = covariance[i, YIELD_RATE] = 0.0
    state.yields[0] = yields


@kernel
def yielding_mass(mass: float, state: State) -> float:
    """Return the mass of the actuator under test in the model [kg]; a foreseen external force includes its yielding."""
    return math.inf if state.expected[3] == 1.0 else mass


@kernel
def supply_of(measured: Array, model: Model) -> float:
    """Return the measured supply pressure, or the nominal one if there is no reading [Pa]."""
    supply = measured[sensors.SUPPLY_PRESSURE]
    return supply if math.isfinite(supply) else model.plant.supply_pressure


@kernel
def expect(foreseen: Array, period: float, state: State) -> None:
    """Update the external force by its foreseen change.

    The mean has been predicted with a constant second derivative. The further change of the foreseen force over the last cycle
    is added; the filter estimates only the remainder. With the first foreseen force, its rates replace the estimated ones.

    Args:
        foreseen: the force [N] and its two derivatives; NaN if not foreseen.
        period: time since the last cycle [s].
        state: changed in place.
    """
    expected, y = state.expected, state.mean
    known = math.isfinite(foreseen[0] + foreseen[1] + foreseen[2])
    if known and expected[3] == 1.0:
        y[EXTERNAL] += foreseen[0] - expected[0] - period * (expected[1] + 0.5 * period * expected[2])
        y[EXTERNAL_RATE] += foreseen[1] - expected[1] - period * expected[2]
        y[EXTERNAL_CURVATURE] += foreseen[2] - expected[2]
    elif expected[3] == 0.0 and known:
        y[EXTERNAL_RATE] = foreseen[1]
        y[EXTERNAL_CURVATURE] = foreseen[2]
    elif expected[3] == 1.0:
        y[EXTERNAL_CURVATURE] = 0.0
    expected[3] = 1.0 if known else 0.0
    for i in range(3):
        expected[i] = foreseen[i] if known else 0.0


@separate_kernel
def observe(measured: Array, foreseen: Array, model: Model, p: Assumptions, state: State) -> bool:
    """Process one more measurement, a period after the last.

    Args:
        measured: readings in the order of ``SENSED``, shape (7,); the velocity is not used.
        foreseen: external force foreseen for now [N] and its two derivatives; NaN if nothing is foreseen.
        model: model of the rig, with the time since the last measurement as period.
        p: the filter's assumptions.
        state: changed in place.

    Returns:
        Whether there is an estimate. It requires one measurement with position, load pressure and spool.
    """
    if state.started[0] == 0.0:
        sum_read = measured[sensors.POSITION] + measured[sensors.LOAD_PRESSURE] + measured[sensors.SPOOL]
        if not math.isfinite(sum_read):
            return False
        start(measured, model, p, state)
        let_yield(p, state)
        expect(foreseen, model.period, state)
        state.mean[EXTERNAL_RATE], state.mean[EXTERNAL_CURVATURE] = state.expected[1], state.expected[2]
        return True
    let_yield(p, state)
    advance(supply_of(measured, model), model, p, state)
    expect(foreseen, model.period, state)
    position = state.mean[X]
    correct(measured[sensors.POSITION], X, 1.0, 0.0, p.position_noise, state)
    correct(measured[sensors.LOAD_PRESSURE], PL, 1.0, 0.0, p.pressure_noise, state)
    correct(measured[sensors.FORCE], PL, model.plant.piston_area, 1.0, p.force_noise, state)
    correct(measured[sensors.SPOOL], XV, 1.0, 0.0, p.spool_noise, state)
    for i in range(elements(model.friction)):
        if state.mode[i] == 0.0:
            state.mean[STATES + i] += model.friction.element_stiffness[i] * (state.mean[X] - position)
    return True


@separate_kernel
def foresee(supply: float, model: Model, p: Assumptions, state: State) -> None:
    """Predict the mean to the time when a command sent now acts, and store it in ``state.foreseen``."""
    copy(state.mean, state.foreseen)
    copy(state.mode, state.foreseen_mode)
    t = 0.0
    while t < p.command_delay - ROUNDING:
        command, until = arrived(t, p.command_delay, state)
        duration = min(until, p.command_delay) - t
        move(state.foreseen, state.foreseen_mode, command, supply, duration, model, p, state.work)
        t += duration


@kernel
def send(command: float, state: State) -> None:
    """Store a command [m] sent now."""
    for i in range(STORED_COMMANDS - 1, 0, -1):
        state.commands[i], state.ages[i] = state.commands[i - 1], state.ages[i - 1]
    state.commands[0], state.ages[0] = command, 0.0
