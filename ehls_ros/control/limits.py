"""Causal limit: the smallest force error of any controller on a rig, given its sensors and delay.

A command sent in a cycle acts after the delay and shows at the next sample. Until then, no law can correct the change of
force due to the disturbance. The part of this change that cannot be predicted from the past remains with any law. It is
computed here for the best linear predictor. The equations of the predictor are (1) to (3), linearised:

    x' = v,   m v' = F - (B0 + sigma_f + cc) v - (ks + kc + k) x - d,   F' = -4 beta/Vt (Ac^2 v + (Ctc + Kc) F)

F = Ac pL is the force, and d = fd - kc xd - cc vd the disturbance of the loader. Kc is the flow-pressure coefficient of the
open valve, averaged over the last half. The command is known, and with it the spool, so both cancel in the prediction error.
The readings of position, velocity, load pressure and force have white noise. Its deviation is that of the sensor and
resolution/sqrt(12), added in quadrature. The contact stiffness k of the friction is 0 during sliding. After each reversal, the
friction sticks, and k is the presliding stiffness. Both states matter: noise acts all the time, and a servo jerks at its
reversals. The limit is the lower result of the two. A rigid contact counts as sliding.

The predictor models the first or second derivative of d as a random walk of intensity q. Each q yields a Kalman filter, and
its error is the sum of two parts. The first part is due to the sensor noise; its covariance S follows from Lyapunov's
equation. The second part is due to the disturbance of the experiment, with which the filter is driven cycle by cycle. A large
q follows the disturbance but passes the noise. Therefore q and the order of the derivative are chosen to minimise the expected
largest sum in the last half. No other q yields a lower value for this disturbance. Over N correlated cycles with deviations s_i
and unforeseen changes b_i, the expected largest sum is

    int_0^inf 1 - prod_i P(|b_i + s_i z| < a)^(1/c) da,   c = sum over all j of rho_j^2

with z Gaussian and rho_j the correlation of the noise part over j cycles.

At a reversal of the motion, from sliding to sticking, the slope of the friction changes. The deviation s_v of the predicted
velocity makes the time of the reversal uncertain by s_v/|v'|. At a time t after the reversal, friction rises at the rate
k |v'| t. Its uncertainty is therefore k s_v t. The resulting force within the horizon is added to the s_i of the cycles in
which d turns.

The rig is assumed linear, with an exactly known model, Gaussian noise and a valve without limits. The predictor is linear,
with one tuning for the run. It uses only the past of the disturbance: neither a period nor the command of the actuator under
test. Lag and delay of the sensors are neglected, as are effects other than coupling and command delay. This lowers the
limit. The limit is an expectation: the largest error of a single run scatters about it by 10 to 20 %. Preview or learning can
reduce the error below the limit, down to the noise share. A further reduction requires a filter slower than this disturbance
allows.

Sources: Anderson, Moore, Optimal Filtering, 1979, chapters 4 and 6. Leadbetter, Lindgren, Rootzén, Extremes and Related
Properties of Random Sequences and Processes, 1983, chapter 4. Doubling of the Riccati equation: Chu, Fan, Lin, Wang,
International Journal of Control 77, 2004.
"""

import math
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from ehls_ros.arrays import Array
from ehls_ros.control.controllers.base import MIN_DROP
from ehls_ros.control.disturbances.base import DISPLACEMENT, FORCE, FORCE_RATE, VELOCITY
from ehls_ros.physics.parameters import Plant, Sensor
from ehls_ros.physics.rig import EffectiveRig, Rig

X, V, F, D = range(4)
"""Indices of x m/T^2, v m/T, F and d in the predictor's state, all in N. Derivatives of d times powers of T follow."""

READINGS = (("position", X), ("velocity", V), ("load_pressure", F), ("force", F))
"""Sensors of force or motion, each with the index of its state."""

ORDERS = (1, 2)
"""Derivatives of d that are modelled as a random walk."""

MIN_DEVIATION = 1e-3
"""Deviation of a perfect sensor's reading due to rounding, in the scale of the state [N]."""

MIN_POWER, MAX_POWER, TRIALS = -5.0, 3.0, 5
"""Range and number of the trial intensities before refinement, as powers of ten of the deviation of the force readings."""

LEVELS = 64
"""Number of levels for sorting the unforeseen changes."""

TINY = 1e-12
"""Smallest force distinguished from zero [N]."""

NEGLIGIBLE = 1e-12
"""Fraction below which decayed terms are neglected."""

WARM_UP = 500
"""Number of cycles before the last half for settling of the filter."""

MAX_SEARCH_CYCLES = 20000
"""Maximum number of cycles in the search for the best intensity; the limit then covers the whole last half."""

MAX_DOUBLINGS = 40
"""Maximum number of doublings of the number of cycles in a sum."""

SEARCH_TOLERANCE = 0.1
"""Tolerance of the search for the best intensity, in powers of ten."""


class CausalLimit(NamedTuple):
    """The causal limit.

    Attributes:
        largest: expected largest force error of the last half [N].
        rms: rms of the force error of the same predictor [N]. Optimisation for the rms would reduce it by up to a third.
        noise_share: expected largest error of the same predictor due to sensor noise alone [N]. It remains with a foreseen or
            learnt disturbance.
        unforeseen: largest noise-free change of the force that is not predicted from the past of the disturbance [N].
        reversal: deviation of the force within the horizon due to friction at a reversal [N].
        horizon: time from a reading to the first sample that the resulting command can change [s].
        order: derivative of the disturbance that the best predictor models as a random walk.
        intensity: root of the spectral density of that derivative's rate [N/s^(order + 1/2)].
        sticking: whether the limit is that of sticking friction.
    """

    largest: float
    rms: float
    noise_share: float
    unforeseen: float
    reversal: float
    horizon: float
    order: int
    intensity: float
    sticking: bool


class _Case(NamedTuple):
    """Common data of all predictors for one rig and disturbance.

    Attributes:
        dynamics: rates of x, v, F per cycle, with d as last column, shape (3, 4).
        reads: state that each sensor reads, shape (sensors,).
        deviations: standard deviations of the readings [N], shape (sensors,).
        ahead: cycles of the horizon.
        disturbance: d at each cycle and its change over it, shape (n, 2) [N].
        late: number of cycles of the last half.
        turning: whether d turns within the horizon of a cycle of the last half, shape (late,).
        contact: contact stiffness of the friction times T^2/m.
    """

    dynamics: Array
    reads: Array
    deviations: Array
    ahead: int
    disturbance: Array
    late: int
    turning: NDArray[np.bool_]
    contact: float


class _Outcome(NamedTuple):
    """Results of one predictor [N], as in :class:`CausalLimit`."""

    largest: float
    rms: float
    noise_share: float
    unforeseen: float
    reversal: float


def causal_limit(
    rig: Rig, period: float, disturbance: Array, *, flow_pressure: float = 0.0, velocity_read: bool = True
) -> CausalLimit:
    """Return the causal limit of a rig under a disturbance.

    Args:
        rig: the actual rig, including the effects ``command_delay`` and ``coupling_stiffness``, if any.
        period: control period [s].
        disturbance: force [N], force rate [N/s], displacement [m] and velocity [m/s] of the actuator under test, shape (n, 4).
            All values are finite. The error is evaluated in the last half.
        flow_pressure: mean flow-pressure coefficient Kc of the valve, see :func:`flow_pressure` [m^3/(s Pa)]; 0 if closed.
        velocity_read: whether controllers may use the velocity reading.

    Returns:
        The limit; infinite if no predictor follows the disturbance with finite numbers.

    Raises:
        ValueError: there are fewer than 8 cycles, or one is not finite.
    """
    if len(disturbance) < 8 or not np.all(np.isfinite(disturbance)):
        raise ValueError("expected at least 8 rows of finite numbers")
    case = _case(rig.effective(), period, disturbance, flow_pressure, velocity_read=velocity_read)
    held = case.dynamics.copy()
    held[V, X] -= case.contact
    sticking = case._replace(dynamics=held)
    found = [_best(sticking, order) for order in ORDERS]
    found.append(_best(case, min(found, key=lambda best: best.outcome.largest).order))
    best = min(found, key=lambda one: one.outcome.largest)
    outcome = best.outcome if case.late <= MAX_SEARCH_CYCLES else _tried(best.case, best.order, best.intensity)
    density = best.intensity * period ** -(best.order + 0.5)
    return CausalLimit(*outcome, case.ahead * period, best.order, density, best.case is sticking)


def horizon_cycles(delay: float, period: float) -> int:
    """Return the cycles from a reading to the first sample that the resulting command can change.

    Args:
        delay: delay of the command [s].
        period: control period [s].
    """
    return math.floor(delay / period + 1e-7) + 1


def flow_pressure(spool: Array, load_pressure: Array, plant: Plant) -> float:
    """Return the mean flow-pressure coefficient of the valve, -dQL/dpL of (1) [m^3/(s Pa)].

    Args:
        spool: spool displacement [m], shape (n,).
        load_pressure: pL [Pa], shape (n,).
        plant: the rig's coefficients.
    """
    drop = np.maximum(plant.supply_pressure - np.sign(spool) * load_pressure, MIN_DROP * plant.supply_pressure)
    per_root = plant.discharge_coefficient * plant.valve_area_gradient / (2.0 * math.sqrt(plant.oil_density))
    return float(np.mean(per_root * np.abs(spool) / np.sqrt(drop)))  # (1)


def expected_largest(changes: Array, deviations: Array, counts: Array) -> float:
    """Return the expected largest |change + deviation * Gaussian| over independent cycles.

    Args:
        changes: known part of a cycle's error, shape (levels,).
        deviations: standard deviation of its random part in the same unit, not all 0, shape (levels,).
        counts: number of such cycles, not necessarily whole, shape (levels,).
    """
    limit = float(np.max(np.abs(changes) + 8.0 * deviations))
    amplitude = np.linspace(0.0, limit, 257)[:, np.newaxis]
    scale = math.sqrt(2.0) * np.maximum(deviations, NEGLIGIBLE * limit)
    inside = 0.5 * (scipy.special.erf((amplitude - changes) / scale) + scipy.special.erf((amplitude + changes) / scale))
    with np.errstate(divide="ignore"):
        below = np.exp(np.log(np.clip(inside, 0.0, 1.0)) @ counts)
    return float(scipy.integrate.trapezoid(1.0 - below, amplitude[:, 0]))


def _case(rig: EffectiveRig, period: float, disturbance: Array, flow_pressure: float, *, velocity_read: bool) -> _Case:
    plant, mass = rig.plant, rig.plant.moving_mass
    delay, stiffness, damping = _surroundings(rig)
    ahead, late = horizon_cycles(delay, period), len(disturbance) // 2
    rows = disturbance[-min(len(disturbance), late + ahead + WARM_UP) :]
    value = rows[:, FORCE] - stiffness * rows[:, DISPLACEMENT] - damping * rows[:, VELOCITY]
    change = (rows[:, FORCE_RATE] - stiffness * rows[:, VELOCITY]) * period
    turns = np.zeros(len(rows))
    turns[1:] = change[1:] * change[:-1] < 0.0
    contact = float(rig.friction_law.stiffness(rig.friction))
    to_force = {"position": mass / period**2, "velocity": mass / period, "load_pressure": plant.piston_area, "force": 1.0}
    used = [(name, state) for name, state in READINGS if velocity_read or name != "velocity"]
    return _Case(
        dynamics=_dynamics(rig, period, stiffness, damping, flow_pressure),
        reads=np.asarray([state for _, state in used]),
        deviations=np.asarray([max(_noise(rig, name) * to_force[name], MIN_DEVIATION) for name, _ in used]),
        ahead=ahead,
        disturbance=np.stack((value, change), axis=1),
        late=late,
        turning=np.convolve(turns, np.ones(ahead))[len(rows) - late : len(rows)] > 0.0,
        contact=contact * period**2 / mass if math.isfinite(contact) else 0.0,
    )


def _surroundings(rig: EffectiveRig) -> tuple[float, float, float]:
    """Return command delay [s], coupling stiffness [N/m] and coupling damping [N s/m]; the last of several delays applies."""
    delay, stiffness, damping = 0.0, 0.0, 0.0
    for use in rig.effects:
        if use.name == "command_delay":
            delay = use.parameters.delay
        elif use.name == "coupling_stiffness":
            stiffness, damping = stiffness + use.parameters.stiffness, damping + use.parameters.damping
    return delay, stiffness, damping


def _noise(rig: EffectiveRig, name: str) -> float:
    """Return the standard deviation of a reading including its rounding, in the reading's unit."""
    sensor = rig.sensors.get(name, Sensor())
    return sensor.reading_std / sensor.gain


def _dynamics(rig: EffectiveRig, period: float, stiffness: float, damping: float, flow_pressure: float) -> Array:
    plant, mass = rig.plant, rig.plant.moving_mass
    rates = np.zeros((3, 4))
    rates[X, V] = rates[V, F] = 1.0
    rates[V, D] = -1.0
    rates[V, X] = -(plant.spring_stiffness + stiffness) * period**2 / mass  # (3)
    rates[V, V] = -(plant.viscous_damping + rig.friction.viscous_coefficient + damping) * period / mass
    hydraulic = 4.0 * plant.bulk_modulus / plant.total_volume
    rates[F, V] = -hydraulic * plant.piston_area**2 * period**2 / mass  # (2)
    rates[F, F] = -hydraulic * (plant.leakage_coefficient + flow_pressure) * period
    return rates


class _Best(NamedTuple):
    """Best predictor of an order: the case, its order, its intensity [N per cycle^1/2], and its results."""

    case: _Case
    order: int
    intensity: float
    outcome: _Outcome


def _best(whole: _Case, order: int) -> _Best:
    """Return the predictor of an order with the smallest largest error."""
    case = _newest(whole)
    unit = float(np.sum(case.deviations[case.reads == F] ** -2.0)) ** -0.5
    outcomes: dict[float, _Outcome] = {}

    def largest(power: float) -> float:
        outcomes[float(power)] = outcome = _tried(case, order, unit * 10.0 ** float(power))
        return outcome.largest

    powers = np.linspace(MIN_POWER, MAX_POWER, TRIALS)
    best = int(np.argmin([largest(power) for power in powers]))
    around = powers[max(best - 1, 0)], powers[min(best + 1, TRIALS - 1)]
    scipy.optimize.minimize_scalar(largest, bounds=around, method="bounded", options={"xatol": SEARCH_TOLERANCE})
    power = min(outcomes, key=lambda tried: outcomes[tried].largest)
    return _Best(whole, order, unit * 10.0**power, outcomes[power])


def _newest(case: _Case) -> _Case:
    """Return the case reduced to the newest cycles, at most :data:`MAX_SEARCH_CYCLES`, for the search."""
    late = min(case.late, MAX_SEARCH_CYCLES)
    return case._replace(
        disturbance=case.disturbance[-(late + case.ahead + WARM_UP) :], late=late, turning=case.turning[-late:]
    )


def _tried(case: _Case, order: int, intensity: float) -> _Outcome:
    """Return a predictor's results; infinite if it diverges for lack of numerical precision."""
    with np.errstate(all="ignore"):
        outcome = _outcome(case, order, intensity)
    return outcome if math.isfinite(outcome.largest) else _Outcome(math.inf, math.inf, math.inf, math.inf, math.inf)


def _outcome(case: _Case, order: int, intensity: float) -> _Outcome:
    """Return the results of the predictor of an order and an intensity."""
    predictor = _predictor(case, order, intensity)
    covariance = _sum(predictor.recursion, (predictor.gain * case.deviations**2) @ predictor.gain.T)
    ahead = np.linalg.matrix_power(predictor.transition, case.ahead)
    force, speed = ahead[F], ahead[V]
    variance = float(force @ covariance @ force)
    weight = covariance @ force
    correlated = 2.0 * float(weight @ _sum(predictor.recursion.T, np.outer(force, force)) @ weight) / variance**2 - 1.0
    # The force due to a unit slope of d within the horizon, times the uncertainty of the friction's slope.
    reversal = abs(float(force[D + 1])) * case.contact * math.sqrt(float(speed @ covariance @ speed))
    deviations = np.sqrt(variance + np.where(case.turning, reversal**2, 0.0))
    changes = np.abs(_unforeseen(case, predictor))
    level, spread, counts = _levels(changes, deviations)
    return _Outcome(
        largest=expected_largest(level, spread, counts / correlated),
        rms=math.sqrt(float(np.mean(changes**2 + deviations**2))),
        noise_share=expected_largest(np.zeros(len(level)), spread, counts / correlated),
        unforeseen=float(np.max(changes)),
        reversal=reversal,
    )


class _Predictor(NamedTuple):
    """Stationary Kalman filter; its state is x, v, F, d and the derivatives of d.

    Attributes:
        transition: transition of the state over a cycle, shape (n, n).
        gain: gain of the innovations, shape (n, sensors).
        left: factor of the error remaining after a correction, shape (n, n).
        recursion: recursion of the corrected error from cycle to cycle, shape (n, n).
    """

    transition: Array
    gain: Array
    left: Array
    recursion: Array


def _predictor(case: _Case, order: int, intensity: float) -> _Predictor:
    size = D + order + 1
    rates = np.zeros((size, size))
    rates[:D, : D + 1] = case.dynamics
    for state in range(D, size - 1):
        rates[state, state + 1] = 1.0
    # Van Loan: transition and covariance over a cycle by one exponential.
    both = np.zeros((2 * size, 2 * size))
    both[:size, :size], both[size:, size:] = -rates, rates.T
    both[size - 1, 2 * size - 1] = intensity**2
    exponential = scipy.linalg.expm(both)
    transition = np.ascontiguousarray(exponential[size:, size:].T)
    added = transition @ exponential[:size, size:]
    reading = np.eye(size)[case.reads]
    information = reading.T @ (reading / case.deviations[:, np.newaxis] ** 2)
    predicted = _riccati(transition, information, 0.5 * (added + added.T))
    seen = predicted @ reading.T
    gain = np.linalg.solve(reading @ seen + np.diag(case.deviations**2), seen.T).T
    left = np.eye(size) - gain @ reading
    return _Predictor(transition, gain, left, left @ transition)


def _riccati(transition: Array, information: Array, added: Array) -> Array:
    """Return the stationary covariance of the prediction, doubling the number of cycles in each step."""
    a, g, h, one = transition.T, information, added, np.eye(len(transition))
    for _ in range(MAX_DOUBLINGS):
        solved = np.linalg.solve(one + g @ h, np.hstack((a, g)))
        within, through = solved[:, : len(a)], solved[:, len(a) :]
        more = a.T @ h @ within
        g = g + a @ through @ a.T
        h, a = h + 0.5 * (more + more.T), a @ within
        if np.max(np.abs(more)) <= NEGLIGIBLE * np.max(np.abs(h)):
            break
    return h


def _sum(step: Array, first: Array) -> Array:
    """Return the sum over j of step^j first (step^j)', the solution of Lyapunov's equation."""
    total, power = first, step
    for _ in range(MAX_DOUBLINGS):
        more = power @ total @ power.T
        total, power = total + more, power @ power
        if np.max(np.abs(more)) <= NEGLIGIBLE * np.max(np.abs(total)):
            break
    return total


def _unforeseen(case: _Case, predictor: _Predictor) -> Array:
    """Return the noise-free effect of d on the force over the horizon beyond its prediction, shape (late,) [N]."""
    transition, cycles = predictor.transition, len(case.disturbance)
    # The filter starts in mid-run with the known value and slope of d, and follows deviations from this trend.
    value, change = case.disturbance[0]
    trend = np.stack((value + change * np.arange(cycles), np.full(cycles, change)), axis=1)
    moved = np.zeros((cycles, len(transition)))
    moved[:, :D] = (case.disturbance - trend) @ transition[:D, D : D + 2].T
    # errors[k + 1] = recursion errors[k] + left moved[k]: sums over 1, 2, 4, ... cycles.
    errors = np.zeros_like(moved)
    errors[1:] = moved[:-1] @ predictor.left.T
    power, stride = predictor.recursion, 1
    while stride < cycles and np.max(np.abs(power)) > NEGLIGIBLE:
        errors[stride:] += errors[:-stride] @ power.T
        power, stride = power @ power, 2 * stride
    kept = cycles - case.ahead
    ahead = errors[:kept]
    for cycle in range(case.ahead):
        ahead = ahead @ transition.T + moved[cycle : cycle + kept]
    return ahead[-case.late :, F]


def _levels(changes: Array, deviations: Array) -> tuple[Array, Array, Array]:
    """Return the cycles sorted into levels of their change, each with mean change, deviation and count."""
    usual = float(np.min(deviations))
    top = float(np.max(changes))
    level = np.minimum((changes * (LEVELS / max(top, TINY))).astype(np.int64), LEVELS - 1)
    level += np.where(deviations > usual, LEVELS, 0)
    counts = np.bincount(level, minlength=2 * LEVELS)
    filled = counts > 0
    means = np.bincount(level, changes, 2 * LEVELS)[filled] / counts[filled]
    spread = np.where(np.arange(2 * LEVELS) < LEVELS, usual, float(np.max(deviations)))[filled]
    return means, spread, counts[filled].astype(np.float64)
