"""Laws with which the safety gate drives the valve itself: holding the piston, and unloading it.

With the valve's opening u, its gain Kv, Kq = Cd w sqrt(ps/rho), the piston area A, and the oil's compression
E = 4 beta A / Vt [Pa/m], equations (1) and (2) give, for small load pressure p and without leakage,

    v = c u - dp/dt / E,  c = Kv Kq / A.

Position: u = (omega / c) (x_hold - x) makes x_hold - x decay at the rate omega. The valve's lag 1 / omega_v and two periods, of
sampling and transport, cost phase; the oil column resonates at omega_h = sqrt(E A / m), and a loop over it with the damping
ratio zeta is stable for omega < 2 zeta omega_h. So omega is :data:`LAG_MARGIN` times below the inverse of the lags and
:data:`COLUMN_MARGIN` times below omega_h, which leaves a factor of two at a damping ratio of 0.05. Leakage C displaces the
held piston by C p / (omega A).

Load pressure: a specimen of stiffness k moves the piston by A dp / k, so (1 + R) dp/dt = E c u with R = E A / k, and
u = -(omega / (E c)) (1 + R) p lets p decay at the rate omega, whatever the specimen. R follows from the motion since the start:
E |dx| / |dp|. Before there is any, R = 0, the gain for a rigid specimen, which is the smallest. Friction may hold the piston
near the end, and the loop swing for the gain of a soft specimen; so R is halved each time that p changes its sign.

Both openings are limited to a tenth of the rig's velocity limit, also where the load pressure helps the flow, by up to sqrt(2).
In a fast test the valve lags far behind its command, and the spool passes null long after it. So the command leads the opening
asked for by a multiple of the distance of the spool, which follows from the earlier commands and the bandwidth; the spool then
gets there within some :data:`CLOSING` periods.
"""

import math

from ehls_ros.arrays import in_python
from ehls_ros.control.rig_scale import compression, largest_speed, oil_frequency
from ehls_ros.physics.rig import Rig

LAG_MARGIN = 5.0
"""Inverse of the lags of valve and sampling over the rate of the loops."""

COLUMN_MARGIN = 20.0
"""Frequency of the oil column over the rate of the loops."""

LARGEST_SPEED = 0.1
"""Fraction of the rig's velocity limit that the piston may reach."""

LEAST_CHANGE = 0.05
"""Least change of the load pressure from which the specimen's stiffness is computed, as a fraction of the rig's limit."""

UNLOADED = 0.01
"""Load pressure at which the rig is unloaded, as a fraction of its limit."""

CLOSING = 3.0
"""Time constant of the spool's approach, in periods, if the valve is not faster by itself."""

CLOSED = 0.1
"""Opening below which the valve counts as closed, as a fraction of the largest that the laws ask for."""

SETTLED = 3.0
"""Time for which it must be unloaded, in time constants of the valve."""


class TakeOver:
    """The laws for one rig.

    Attributes:
        opening: largest opening that they ask for [m].
        unloaded: whether the load pressure has been near zero for long enough.
    """

    def __init__(self, rig: Rig, period: float) -> None:
        """Compute the gains.

        Args:
            rig: the rig behind the actuator.
            period: control period [s].
        """
        plant, limits = rig.plant, rig.limits
        speed = plant.valve_gain * in_python(largest_speed)(plant, 1.0)
        compress = in_python(compression)(plant)
        rate = min(1.0 / (LAG_MARGIN * (1.0 / plant.valve_bandwidth + 2.0 * period)), oil_frequency(plant) / COLUMN_MARGIN)
        self.opening = min(LARGEST_SPEED * limits.velocity / (math.sqrt(2.0) * speed), limits.spool)
        self._position_gain = rate / speed
        self._pressure_gain = rate / (compress * speed)
        self._compression = compress
        largest = min(limits.load_pressure, limits.force / plant.piston_area)
        self._least_change, self._least = LEAST_CHANGE * largest, UNLOADED * largest
        # The softest specimen reaches the force limit over the rig's stroke.
        self._softest = compress * (limits.position[1] - limits.position[0]) / largest
        self._bandwidth, self._settling = plant.valve_bandwidth, SETTLED / plant.valve_bandwidth
        self._lead = max(1.0 / (CLOSING * period * plant.valve_bandwidth) - 1.0, 0.0)
        self._spool = 0.0
        self.start()

    def start(self) -> None:
        """Start either law from the rig's present state."""
        self.unloaded = False
        self._closing = True
        self._held = self._start_position = self._start_pressure = math.nan
        self._low_for = 0.0
        self._share = 1.0
        self._last_pressure = math.nan

    def follow(self, command: float, elapsed: float) -> None:
        """Note a command [m] and the time for which it acts [s]."""
        self._spool += (command - self._spool) * -math.expm1(-self._bandwidth * elapsed)

    def hold(self, position: float) -> float:
        """Return the command that holds the piston [m].

        Until the valve has closed for the first time, the position to hold is that of the piston: it is held where it comes to
        rest, not where it was.

        Args:
            position: of the piston [m].
        """
        if self._closing:
            self._held, self._closing = position, abs(self._spool) > CLOSED * self.opening
        return self._command(self._position_gain * (self._held - position))

    def unload(self, pressure: float, position: float, elapsed: float) -> float:
        """Return the command that lets the load pressure decay [m].

        Args:
            pressure: load pressure [Pa].
            position: of the piston [m]; NaN if unknown.
            elapsed: time since the last call [s].
        """
        if math.isnan(self._start_pressure):
            self._start_pressure, self._start_position = pressure, position
        change = max(abs(pressure - self._start_pressure), self._least_change)
        moved = abs(position - self._start_position)
        if pressure * self._last_pressure < 0.0:
            self._share *= 0.5
        self._last_pressure = pressure
        compliance = self._share * min(self._compression * moved / change, self._softest) if math.isfinite(moved) else 0.0
        self._low_for = self._low_for + elapsed if abs(pressure) < self._least else 0.0
        self.unloaded = self._low_for >= self._settling
        return self._command(-self._pressure_gain * (1.0 + compliance) * pressure)

    def _command(self, opening: float) -> float:
        opening = min(max(opening, -self.opening), self.opening)
        return opening + self._lead * (opening - self._spool)
