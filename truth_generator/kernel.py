"""Compiled simulation of the rig: equations (1)-(4), friction, hidden effects, sensors and the experiment's controller.

The oil is that of a double rod, equations (1) and (2) for the load pressure, or of a single rod (`area_a` above zero), both
chambers and the four edges of the valve.

One kernel serves all effects. Their sizes are fields of one record (`FIELDS`), each with a neutral value that disables the
effect. All compiled code is in this file, because numba's cache checks only the file of the cached function, not its callees'.

State (`N_BASE` values, then the friction forces): piston position and speed, load pressure, spool position and speed, position
and speed of the second body, supply pressure, inner position of the creeping spring, inner pressure of the swelling hose,
lagged speed, pressure behind the pressure sensor's lag, filtered speed of the friction memory, volume taken up by the mount,
pressures of the chambers A and B of a single rod, whose load pressure is no state.
"""

import math

import numba as nb
import numpy as np

X, V, PL, XV, WV, XB, VB, PS, ZS, ZH, VF, PM, VM, QM, PA, PB = range(16)
N_BASE = 16
N_ELEMENTS = 8
GMS, LUGRE = 0.0, 1.0
# Sensor channels.
POSITION, VELOCITY, PRESSURE, SPOOL, SUPPLY, FORCE, TEMPERATURE, PRESSURE_A, PRESSURE_B = range(9)
N_CHANNELS = 9
# Metering edges of a single rod's valve: from the supply to A, from A to the tank, from the supply to B, from B to the tank.
EDGES = ("pa", "at", "pb", "bt")
P_A, A_T, P_B, B_T = range(4)
N_PLAYS = 5
N_WAVES = 4
ATMOSPHERE = 1.0e5

# name: neutral value. Nominal values (first block) are filled in from the rig file.
FIELDS: dict[str, float] = {
    # rig file
    "supply": 0.0, "density": 0.0, "bulk": 0.0, "discharge": 0.0, "gradient": 0.0, "leakage": 0.0, "volume": 0.0,
    "mass": 0.0, "area": 0.0, "spring": 0.0, "damping": 0.0, "valve_rate": 0.0, "valve_gain": 0.0, "gravity": 0.0,
    "spool_limit": 0.0, "model": GMS, "fc": 0.0, "fs": 0.0, "vs": 0.0, "exponent": 0.0, "viscous": 0.0, "attraction": 0.0,
    "n_elements": 0.0,
    # the chambers of a single rod
    "area_a": 0.0, "area_b": 0.0, "volume_a": 0.0, "volume_b": 0.0, "hose_a": 0.0, "hose_b": 0.0, "leak_a": 0.0, "leak_b": 0.0,
    "tank": 0.0, "vapour": 0.0, "laminar_below": 1.0, "air_a": 0.0, "air_b": 0.0,
    # valve: between command and spool
    "gain_pos": 1.0, "gain_neg": 1.0, "null_command": 0.0, "pilot_dead_pos": 0.0, "pilot_dead_neg": 0.0,
    "play": 0.0, "play_spread": 0.4, "command_delay": 0.0, "second_rate": 0.0, "second_damping": 0.7, "spool_stop": 1.0e9,
    "stiction": 0.0, "slew": 0.0, "power": 1.0, "power_at": 1.0e-3, "hum": 0.0, "hum_rate": 0.0, "hum_phase": 0.0,
    "null_drift": 0.0, "null_drift_time": 1.0, "sticky": 0.0, "sticky_at": 0.0, "sticky_width": 1.0, "flow_force": 0.0,
    # valve: between spool and flow
    "null_ports": 0.0, "ports_pos": 1.0, "ports_neg": 1.0, "dead_pos": 0.0, "dead_neg": 0.0, "dead_corner": 0.0,
    "dead_smooth": 0.0,
    # flow
    "droop": 0.0, "droop_square": 0.0, "droop_time": 0.1, "air": 0.0, "air_exponent": 1.3, "air_square": 0.0,
    "air_dissolved_at": 0.0, "air_half": 0.0, "turbulent": 0.0, "turbulent_exponent": 0.5, "turning_leakage": 0.0,
    "turning_pressure": 1.0e6,
    "external": 0.0, "external_side": 1.0,
    "laminar": 0.0, "relief": 0.0, "relief_crack": 0.0, "relief_corner": 1.0, "rate_limit": 0.0, "hose": 0.0,
    "hose_time": 1.0, "seal": 0.0, "seal_speed": 1.0, "line": 0.0,
    # friction
    "asymmetry": 0.0, "viscous_asymmetry": 0.0, "per_pressure": 0.0, "per_position": 0.0, "position_scale": 0.3,
    "level_side": 0.0, "level_forward": 0.0, "viscous_forward": 0.0, "viscous_side": 0.0, "viscous_side_speed": 1.0,
    "per_chamber": 0.0, "pressure_rise": 0.0, "pressure_scale": 1.0e6,
    "pressure_power": 0.0, "pressure_exponent": 1.0, "stribeck_lorentz": 0.0, "stribeck_tanh": 0.0, "level_turning": 0.0,
    "level_turning_speed": 1.0, "pressure_log": 0.0, "pressure_log_at": 1.0e6,
    "curve_level_per_pressure": 0.0, "curve_viscous_per_pressure": 0.0, "position_bow": 0.0,
    "per_kelvin": 0.0, "linear_per_kelvin": 0.0, "vogel": 0.0, "vogel_at": 0.0, "level_per_kelvin": 0.0, "level_now": 1.0,
    "warming": 0.0, "warming_time": 30.0, "temperature": 313.15,
    # mechanics
    "hardening": 0.0, "hardening_scale": 0.15, "quintic": 0.0, "two_body": 0.0, "second_share": 0.0, "second_stiffness": 0.0,
    "second_loss": 0.0, "gap": 0.0, "load_on_second": 0.0, "stop_side": 0.0, "stop_at": 0.0, "stop_stiffness": 0.0,
    "stop_loss": 0.0, "stop_exponent": 1.0,
    # environment
    "periodic": 0.0, "periodic_rate": 0.0, "periodic_phase": 0.0, "constant": 0.0, "coupling": 0.0,
    # force balance, outside the list
    "quadratic": 0.0, "inertial_friction": 0.0, "inertial_scale": 1.0, "cogging": 0.0, "cogging_length": 1.0,
    "cogging_phase": 0.0, "cogging_speed": 1.0, "creep": 0.0, "creep_time": 1.0, "patch": 0.0, "patch_at": 0.0,
    "patch_width": 1.0, "notch": 0.0, "notch_at": 0.0, "notch_width": 1.0, "crosstalk": 0.0, "side_spring": 0.0,
    "side_preload": 0.0, "side_at": 0.0, "side": 1.0,
    # sensors
    "p_gain": 1.0, "p_bias": 0.0, "p_lag": 0.0, "x_gain": 1.0, "x_bias": 0.0, "p_quadratic": 0.0, "p_play": 0.0,
    "p_step": 0.0, "p_codes": 0.0, "x_interpolation": 0.0, "x_period": 1.0, "x_phase": 0.0, "p_per_x": 0.0, "p_per_xx": 0.0,
    "p_per_kelvin": 0.0, "a_gain": 1.0, "a_bias": 0.0, "b_gain": 1.0, "b_bias": 0.0, "swapped": 0.0,
    # form errors of the rig, which no model contains; the means are the part that the rig file's coefficients absorb
    "speed_wave": 0.0, "speed_wave_turns": 1.0, "speed_wave_at": 1.0, "speed_wave_phase": 0.0, "speed_wave_mean": 0.0,
    "speed_wave_slope": 0.0, "stroke_wave": 0.0, "memory": 0.0, "memory_time": 1.0, "memory_speed": 1.0, "memory_mass": 0.0,
    "warm_viscous": 0.0, "warm_flow": 0.0, "warm_valve": 0.0, "warm_rate": 0.0, "warm_phase": 0.0, "mount": 0.0,
    "mount_time": 1.0, "mount_pressure": 1.0, "mount_mean": 0.0, "flow_wave": 0.0, "flow_wave_turns": 1.0,
    "flow_wave_at": 1.0, "flow_wave_phase": 0.0, "flow_wave_mean": 0.0, "flow_wave_shift": 0.0,
    "flow_wave_mean_b": 0.0, "flow_exponent": 0.0, "spool_wave": 0.0,
    "spool_wave_turns": 1.0, "spool_wave_at": 1.0, "spool_wave_phase": 0.0, "spool_wave_side": 0.0,
    "spool_wave_mean_pos": 0.0, "spool_wave_mean_neg": 0.0, "spool_pace": 0.0, "spool_pace_at": 1.0, "spool_pace_mean": 0.0,
    "cell_bow": 0.0, "cell_scale": 1.0, "cell_bow_mean": 0.0, "cell_play": 0.0, "cell_play_width": 0.0, "cell_play_mean": 0.0,
    "cell_per_speed": 0.0, "cell_per_speed_mean": 0.0, "speed_per_pressure": 0.0, "speed_per_pressure_mean": 0.0,
    "temperature_offset": 0.0,
    # controller of the experiment
    "w_force": 0.0, "w_position": 0.0, "force_gain": 4.0e-5, "force_reset": 2.0, "force_filter": 40.0,
    "position_gain": 3.0, "guard": 0.27, "nominal_supply": 0.0, "nominal_area": 0.0, "nominal_bulk": 0.0, "flow_gain": 0.0,
    "reach_out": 0.0, "reach_in": 0.0, "flow_gain_out": 0.0, "flow_gain_in": 0.0,
}  # fmt: skip
ARRAYS: dict[str, int] = {
    "stiffness": N_ELEMENTS,  # N/m, of the friction elements
    "weight": N_ELEMENTS,  # 1, of the friction elements
    "delay": N_CHANNELS,  # s, of the sensors
    "noise_std": N_CHANNELS,
    "resolution": N_CHANNELS,
    "edge_gain": 4,  # 1, of EDGES
    "edge_overlap": 4,  # m
    "edge_rounding": 4,  # m
    "edge_worn": 4,  # m
    "stroke_length": N_WAVES,  # m
    "stroke_share": N_WAVES,  # 1
    "stroke_phase": 2 * N_WAVES,  # rad, to and fro
}
DTYPE = np.dtype([(name, "f8") for name in FIELDS] + [(name, "f8", (size,)) for name, size in ARRAYS.items()], align=True)
HUGE = 1.0e9

# Dormand-Prince 5(4)
A21 = 1 / 5
A31, A32 = 3 / 40, 9 / 40
A41, A42, A43 = 44 / 45, -56 / 15, 32 / 9
A51, A52, A53, A54 = 19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729
A61, A62, A63, A64, A65 = 9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656
B1, B3, B4, B5, B6 = 35 / 384, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84
E1, E3, E4, E5, E6, E7 = 71 / 57600, -71 / 16695, 71 / 1920, -17253 / 339200, 22 / 525, -1 / 40
RTOL = 1.0e-9
# Per state: far below the resolution of the rig's sensors.
ATOL = np.array(
    [1e-12, 1e-10, 0.002, 1e-13, 1e-10, 1e-12, 1e-10, 0.002, 1e-12, 0.002, 1e-10, 0.002, 1e-10, 1e-13, 0.02, 0.02]
    + [1e-6] * N_ELEMENTS
)


@nb.njit(cache=True)
def softplus(a, corner):
    """Return max(a, 0) with its corner rounded over the given length."""
    if corner <= 0.0:
        return max(a, 0.0)
    z = a / corner
    if z > 35.0:
        return a
    if z < -35.0:
        return 0.0
    return corner * math.log1p(math.exp(z))


@nb.njit(cache=True)
def wave(a, turns, at, phase):
    """Return a sine over the logarithm of a magnitude: fine where it is small, coarse where it is large."""
    return math.sin(turns * math.log1p(abs(a) / at) + phase)


@nb.njit(cache=True)
def play_along(a, half):
    """Return the output of a play (backlash) of a given half-width."""
    out = np.empty_like(a)
    at = a[0]
    for i in range(a.size):
        at = min(max(at, a[i] - half), a[i] + half)
        out[i] = at
    return out


@nb.njit(cache=True)
def warmth(t, p):
    """Return the unmeasured warmth of the oil in the gaps, -1 to 1."""
    return math.sin(p.warm_rate * t + p.warm_phase)


@nb.njit(cache=True)
def own_friction(v, remembered, x, p):
    """Return the friction of the rig's form errors, N: over speed, over the stroke by direction, and due to past speed."""
    if p.speed_wave == 0.0 and p.stroke_wave == 0.0 and p.memory == 0.0:
        return 0.0
    level = 0.0
    if p.speed_wave != 0.0:
        shape = wave(v, p.speed_wave_turns, p.speed_wave_at, p.speed_wave_phase)
        level += p.speed_wave * (shape - p.speed_wave_mean - p.speed_wave_slope * abs(v))
    if p.stroke_wave != 0.0:
        first = 0 if v > 0.0 else N_WAVES
        for i in range(N_WAVES):
            turn = 6.283185307179586 * x / p.stroke_length[i] + p.stroke_phase[first + i]
            level += p.stroke_wave * p.stroke_share[i] * math.sin(turn)
    if p.memory != 0.0:
        level += p.memory * (math.tanh(abs(remembered) / p.memory_speed) - math.tanh(abs(v) / p.memory_speed))
    return level * math.tanh(v / 2.0e-3)


@nb.njit(cache=True)
def stribeck_bump(v, p):
    """Return the fraction of the rise from Coulomb to static friction that is left at a speed."""
    if p.stribeck_lorentz != 0.0:
        return 1.0 / (1.0 + (v / p.vs) ** 2)
    if p.stribeck_tanh != 0.0:
        return 1.0 - math.tanh(abs(v) / p.vs)
    return math.exp(-((abs(v) / p.vs) ** p.exponent))


@nb.njit(cache=True)
def pressed_level(s, p_load, p):
    """Return the level s of friction under a load pressure, N."""
    if p.per_pressure != 0.0:
        s += p.per_pressure * (math.sqrt(p_load * p_load + 4.0e10) - 2.0e5)
    if p.curve_level_per_pressure != 0.0:
        s *= 1.0 + p.curve_level_per_pressure * abs(p_load)
    if p.pressure_rise != 0.0:
        s += p.pressure_rise * (1.0 - math.exp(-abs(p_load) / p.pressure_scale))
    if p.pressure_power != 0.0:
        s += p.pressure_power * (1.0e-6 * math.sqrt(p_load * p_load + 1.0e8)) ** p.pressure_exponent
    if p.pressure_log != 0.0:
        s += p.pressure_log * math.log(1.0 + abs(p_load) / p.pressure_log_at)
    if p.per_chamber != 0.0:
        s += p.per_chamber * p_load
    return s


@nb.njit(cache=True)
def sliding_level(v, side, x, p_load, p):
    """Return s, the steady-state friction of sliding in one direction without the viscous part, N."""
    s = p.fc + (p.fs - p.fc) * stribeck_bump(v, p)
    if p.per_position != 0.0:
        s *= 1.0 + p.per_position * p.position_scale * math.tanh(x / p.position_scale)
    if p.position_bow != 0.0:
        s *= 1.0 + p.position_bow * x * x
    s = pressed_level(s, p_load, p)
    if p.patch != 0.0:
        z = (x - p.patch_at) / p.patch_width
        s += p.patch * math.exp(-z * z)
    if p.asymmetry != 0.0:
        s += side * p.asymmetry
    if p.level_turning != 0.0:
        s += p.level_turning * math.tanh(v / p.level_turning_speed)
    if p.level_side != 0.0:
        s *= 1.0 + side * p.level_side
    if p.level_forward != 0.0 and side > 0.0:
        s += p.level_forward
    s *= p.level_now
    return max(s, 0.05 * p.fc)


@nb.njit(cache=True)
def ports_opening(xv, p):
    """Return the opening of the valve's ports at a spool position, m."""
    x = xv + p.null_ports
    if p.dead_pos != 0.0 or p.dead_neg != 0.0:
        x = softplus(x - p.dead_pos, p.dead_corner) - softplus(-x - p.dead_neg, p.dead_corner)
    if p.dead_smooth > 0.0:
        x -= p.dead_smooth * math.tanh(x / p.dead_smooth)
    if p.ports_pos != 1.0 or p.ports_neg != 1.0:
        x *= p.ports_pos if x > 0.0 else p.ports_neg
    return x


@nb.njit(cache=True)
def orifice_flow(xv, ps, p_load, p):
    """Return the flow to the cylinder, (1), m^3/s."""
    x = ports_opening(xv, p)
    if p.flow_wave != 0.0:
        x *= 1.0 + p.flow_wave * (wave(x, p.flow_wave_turns, p.flow_wave_at, p.flow_wave_phase) - p.flow_wave_mean)
    side = 1.0 if x > 0.0 else -1.0
    drop = ps - side * p_load
    root = math.sqrt(drop) if drop >= 0.0 else -math.sqrt(-drop)
    if p.flow_exponent != 0.0:
        root *= (abs(drop) / p.supply + 1.0e-6) ** p.flow_exponent
    if p.laminar != 0.0:  # Re is proportional to opening times root; below the transition Cd is proportional to Re
        re = abs(x) * abs(root) / (p.laminar * math.sqrt(p.supply))
        x *= re / math.sqrt(1.0 + re * re)
    conductance = p.discharge * p.gradient * x / math.sqrt(p.density)
    if p.line != 0.0:  # the pressure drop of a turbulent restriction in series is line * Q^2
        conductance /= math.sqrt(1.0 + p.line * conductance * conductance)
    return conductance * root


@nb.njit(cache=True)
def edge_flow(edge, x, drop, p):
    """Return the flow through a metering edge along its pressure drop, m^3/s.

    x: displacement that opens the edge. A rounded edge opens along a hyperbola; a worn one lets more through at its corner.
    """
    past, radius = x - p.edge_overlap[edge], p.edge_rounding[edge]
    reach = math.hypot(past, radius)
    opening = 0.5 * (reach + past) if past >= 0.0 else 0.5 * radius * radius / (reach - past)
    worn = p.edge_worn[edge]
    if worn != 0.0:
        opening += 0.5 * worn * math.exp(-abs(past) / (2.0 * worn))
    opening *= p.edge_gain[edge]
    if p.flow_wave != 0.0:
        shift, mean = (p.flow_wave_shift, p.flow_wave_mean_b) if edge >= P_B else (0.0, p.flow_wave_mean)
        opening *= 1.0 + p.flow_wave * (wave(opening, p.flow_wave_turns, p.flow_wave_at, p.flow_wave_phase + shift) - mean)
    if p.laminar != 0.0:
        re = opening * math.sqrt(abs(drop) / p.supply) / p.laminar
        opening *= re / math.sqrt(1.0 + re * re)
    conductance = p.discharge * p.gradient * opening * math.sqrt(2.0 / p.density)
    if p.line != 0.0:
        conductance /= math.sqrt(1.0 + p.line * conductance * conductance)
    if p.flow_exponent != 0.0:
        conductance *= (abs(drop) / p.supply + 1.0e-6) ** p.flow_exponent
    return conductance * drop * (drop * drop + p.laminar_below * p.laminar_below) ** -0.25


@nb.njit(cache=True)
def give(pressure, volume, at_zero, air, hose, p):
    """Return the volume that a chamber takes up per pressure, m^3/Pa: oil, air and hose, or a cavity below vapour pressure."""
    if pressure < p.vapour:
        return at_zero / p.bulk
    bulk = air_modulus(pressure, air, p) if air > 0.0 else p.bulk
    return volume / bulk + hose


@nb.njit(cache=True)
def chamber_rates(t, y, dy, p):
    """Write the rates of both chambers' pressures and of the pressure at port P."""
    a, b, ps, v = max(y[PA], p.vapour), max(y[PB], p.vapour), y[PS], y[V]
    x = ports_opening(y[XV], p)
    warm = 1.0 + p.warm_flow * warmth(t, p) if p.warm_flow != 0.0 else 1.0
    to_a, to_b = warm * edge_flow(P_A, x, ps - a, p), warm * edge_flow(P_B, -x, ps - b, p)
    off_a, off_b = warm * edge_flow(A_T, -x, a - p.tank, p), warm * edge_flow(B_T, x, b - p.tank, p)
    across = a - b
    past = p.leakage * across
    if p.turbulent != 0.0:  # laminar below about 0.2 MPa
        past += p.turbulent * across / (across * across + 4.0e10) ** (0.5 - 0.5 * p.turbulent_exponent)
    if p.seal != 0.0:
        past += p.seal * across * v * v / (v * v + p.seal_speed * p.seal_speed)
    stored_a = to_a - off_a - past - p.leak_a * (a - p.tank) - p.area_a * v
    stored_b = to_b - off_b + past - p.leak_b * (b - p.tank) + p.area_b * v
    dy[PA] = stored_a / give(y[PA], p.volume_a + p.area_a * y[X], p.volume_a, p.air_a, p.hose_a, p)
    dy[PB] = stored_b / give(y[PB], p.volume_b - p.area_b * y[X], p.volume_b, p.air_b, p.hose_b, p)
    taken = to_a + to_b
    dy[PS] = (p.supply - p.droop * taken - p.droop_square * taken * taken - ps) / p.droop_time


@nb.njit(cache=True)
def load_pressure(y, p):
    """Return the load pressure: the state of a double rod; the driving force of a single rod over its mean area."""
    if p.area_a == 0.0:
        return y[PL]
    return (p.area_a * max(y[PA], p.vapour) - p.area_b * max(y[PB], p.vapour)) / p.area


@nb.njit(cache=True)
def supply_pressure(y, p):
    """Return the pressure at port P, Pa."""
    return y[PS] if p.droop + p.droop_square != 0.0 or p.area_a > 0.0 else p.supply


@nb.njit(cache=True)
def load_flow_rate(t, y, dy, ps, p):
    """Write the rate of a double rod's load pressure, (1) and (2), and of the pressure at port P."""
    v, p_load = y[V], y[PL]
    q = orifice_flow(y[XV], ps, p_load, p)
    if p.warm_flow != 0.0:
        q *= 1.0 + p.warm_flow * warmth(t, p)
    if p.droop + p.droop_square != 0.0:
        dy[PS] = (p.supply - p.droop * abs(q) - p.droop_square * q * q - ps) / p.droop_time
    q -= p.area * v + p.leakage * p_load
    if p.turbulent != 0.0:  # laminar below about 0.2 MPa
        q -= p.turbulent * p_load / (p_load * p_load + 4.0e10) ** (0.5 - 0.5 * p.turbulent_exponent)
    if p.turning_leakage != 0.0:
        q -= p.turning_leakage * p_load / math.sqrt(abs(p_load) + p.turning_pressure)
    if p.external != 0.0:  # one rod seal leaks to the tank; half of that leakage appears in the load flow
        q -= 0.5 * p.external * p.external_side * max(0.5 * (ps + p.external_side * p_load), 0.0)
    if p.relief != 0.0:
        q -= p.relief * (
            softplus(p_load - p.relief_crack, p.relief_corner) - softplus(-p_load - p.relief_crack, p.relief_corner)
        )
    if p.seal != 0.0:
        q -= p.seal * p_load * v * v / (v * v + p.seal_speed * p.seal_speed)
    if p.hose != 0.0:
        dy[ZH] = (p_load - y[ZH]) / p.hose_time
        q -= p.hose * dy[ZH]
    if p.mount != 0.0:  # rubber: delayed, and stiffer with increasing load
        dy[QM] = (p.mount * p.mount_pressure * math.asinh(p_load / p.mount_pressure) - y[QM]) / p.mount_time
        q -= dy[QM]
    bulk = p.bulk
    if p.air != 0.0 or p.air_half != 0.0:
        bulk = 0.5 * (air_modulus(0.5 * (ps + p_load), p.air, p) + air_modulus(0.5 * (ps - p_load), p.air, p))
    pressure_rate = 4.0 * bulk / p.volume * q
    if p.mount != 0.0:  # the rig file's modulus includes its mean compliance
        pressure_rate /= 1.0 - 4.0 * p.nominal_bulk / p.volume * p.mount * p.mount_mean
    if p.rate_limit != 0.0:
        r = pressure_rate / p.rate_limit
        pressure_rate /= (1.0 + r * r) ** 0.5
    dy[PL] = pressure_rate


@nb.njit(cache=True)
def air_modulus(pressure, air, p):
    """Return the bulk modulus of oil with a part of free air, polytropically compressed, at a gauge pressure, Pa."""
    absolute = max(pressure, 0.0) + ATMOSPHERE
    if p.air_half > 0.0:  # half of the oil's modulus at that pressure
        return p.bulk * absolute / (absolute + p.air_half)
    if p.air_dissolved_at > 0.0:  # Henry: less is free the higher the pressure
        air *= max(1.0 - max(pressure, 0.0) / p.air_dissolved_at, 0.0)
    shrunk = air * (ATMOSPHERE / absolute) ** (1.0 / p.air_exponent)
    volume = 1.0 - air + shrunk
    if p.air_square != 0.0:
        volume *= volume
    return volume / ((1.0 - air) / p.bulk + shrunk / (p.air_exponent * absolute))


@nb.njit(cache=True)
def rhs(t, y, dy, modes, spool_free, p, c):  # noqa: PLR0912 - one branch per effect
    """Write the derivative of the state.

    c: spool target, disturbance and its rate, servo displacement and its rate, time at which these apply, temperature.
    """
    target, fd0, fd_rate, servo0, servo_rate, t0, temperature = c
    for i in range(N_BASE):
        dy[i] = 0.0
    x, v, p_load, xv = y[X], y[V], load_pressure(y, p), y[XV]
    ps = supply_pressure(y, p)

    # (4) valve
    if p.hum != 0.0:
        target += p.hum * math.sin(p.hum_rate * t + p.hum_phase)
    if p.flow_force != 0.0:  # the jet closes the valve, in proportion to opening and pressure drop
        target -= p.flow_force * xv * max(ps - (p_load if xv > 0.0 else -p_load), 0.0) / p.supply
    if p.second_rate != 0.0:
        rate = y[WV]
        dy[WV] = p.second_rate * (p.second_rate * (target - xv) - 2.0 * p.second_damping * y[WV])
    else:
        rate = p.valve_rate * (target - xv)
    if p.spool_pace != 0.0:  # bandwidth of the spool servo depends on the remaining travel
        r = (target - xv) / p.spool_pace_at
        rate *= 1.0 + p.spool_pace * (r * r / (1.0 + r * r) - p.spool_pace_mean)
    if p.slew != 0.0:
        r = rate / p.slew
        rate /= (1.0 + r * r * r * r) ** 0.25
    if p.sticky != 0.0:
        z = (xv - p.sticky_at) / p.sticky_width
        rate *= 1.0 - p.sticky * math.exp(-z * z)
    if p.stiction != 0.0 and not spool_free:
        rate = 0.0
    if (xv >= p.spool_stop and rate > 0.0) or (xv <= -p.spool_stop and rate < 0.0):
        rate = 0.0
        dy[WV] = -2.0e3 * y[WV]
    dy[XV] = rate

    # (1), (2) flow
    if p.area_a == 0.0:
        load_flow_rate(t, y, dy, ps, p)
    else:
        chamber_rates(t, y, dy, p)

    # (3) load
    two, on_second = p.two_body != 0.0, p.load_on_second != 0.0
    xl, vl = (y[XB], y[VB]) if on_second else (x, v)
    load = p.damping * vl + p.spring * xl + fd0 + fd_rate * (t - t0)
    weight = p.mass * p.gravity
    viscous = p.viscous
    if p.per_kelvin != 0.0:
        viscous *= math.exp(-p.per_kelvin * (temperature - p.temperature))
    if p.linear_per_kelvin != 0.0:
        viscous *= 1.0 - p.linear_per_kelvin * (temperature - p.temperature)
    if p.vogel != 0.0:
        viscous *= math.exp(p.vogel / (temperature - p.vogel_at) - p.vogel / (p.temperature - p.vogel_at))
    if p.curve_viscous_per_pressure != 0.0:
        viscous *= 1.0 + p.curve_viscous_per_pressure * abs(p_load)
    if p.viscous_forward != 0.0 and vl > 0.0:
        viscous += p.viscous_forward
    if p.viscous_side != 0.0:
        viscous += p.viscous_side * math.tanh(vl / p.viscous_side_speed)
    if p.viscous_asymmetry != 0.0:
        viscous += p.viscous_asymmetry if vl > 0.0 else -p.viscous_asymmetry
    if p.warm_viscous != 0.0:
        viscous *= 1.0 + p.warm_viscous * warmth(t, p)
    load += viscous * vl
    if p.memory != 0.0:
        dy[VM] = (vl - y[VM]) / p.memory_time
    own = own_friction(vl, y[VM], xl, p)
    if own != 0.0:
        load += own
    n = int(p.n_elements)
    for i in range(n):
        load += y[N_BASE + i]
    if p.hardening != 0.0:
        z = xl / p.hardening_scale
        shape = 6.0 * (math.sinh(z) - z) if p.hardening > 0.0 else 3.0 * (z - math.atan(z))
        load += p.hardening * p.hardening_scale**3 * shape
    if p.quintic != 0.0:
        load += p.quintic * xl**5
    if p.stop_side != 0.0:
        depth = softplus(p.stop_side * xl - p.stop_at, 1.0e-4)
        load += p.stop_side * p.stop_stiffness * depth**p.stop_exponent * max(1.0 + p.stop_loss * p.stop_side * vl, 0.0)
    if p.periodic != 0.0:
        phase = p.periodic_rate * t + p.periodic_phase
        load += p.periodic * (math.sin(phase) + 0.1 * math.sin(2.0 * phase + 1.0))
    load += p.constant
    if p.coupling != 0.0:
        load -= p.coupling * (servo0 + servo_rate * (t - t0) - xl)
    if p.quadratic != 0.0:
        load += p.quadratic * vl * abs(vl)
    if p.inertial_friction != 0.0:
        dy[VF] = (v - y[VF]) / 5.0e-3
        load += p.inertial_friction * math.tanh(vl / 2.0e-3) * math.tanh(dy[VF] * math.tanh(vl / 2.0e-3) / p.inertial_scale)
    if p.cogging != 0.0:
        tooth = 6.283185307179586 * xl / p.cogging_length + p.cogging_phase
        load += p.cogging * (math.sin(tooth) + 0.4 * math.sin(2.0 * tooth)) * math.tanh(vl / p.cogging_speed)
    if p.creep != 0.0:
        dy[ZS] = (xl - y[ZS]) / p.creep_time
        load += p.creep * (xl - y[ZS])
    if p.notch != 0.0:
        z = (xl - p.notch_at) / p.notch_width
        load += p.notch * 2.3316 * z * math.exp(-z * z)  # the factor makes `notch` the largest force
    if p.crosstalk != 0.0:
        fd = fd0 + fd_rate * (t - t0)
        load += p.crosstalk * fd * fd
    if p.side_spring != 0.0 or p.side_preload != 0.0:
        depth = p.side * (xl - p.side_at)
        engaged = 0.5 * (1.0 + math.tanh(depth / 3.0e-4))
        load += p.side * (p.side_preload * engaged + p.side_spring * softplus(depth, 3.0e-4))

    drive = p.area * p_load
    dy[X] = v
    if two:
        second = p.second_share * p.mass
        first = p.mass - second
        stretch = x - y[XB]
        hinge = p.second_stiffness * stretch
        touch = 1.0
        if p.gap > 0.0:
            corner, half = 0.05 * p.gap, 0.5 * p.gap
            hinge = p.second_stiffness * (softplus(stretch - half, corner) - softplus(-stretch - half, corner))
            touch = 1.0 / (1.0 + math.exp(min(max((half - abs(stretch)) / corner, -50.0), 50.0)))
        hinge += p.second_loss * touch * (v - y[VB])
        dy[XB] = y[VB]
        if on_second:
            dy[V] = (drive - hinge) / first
            dy[VB] = (hinge - load - weight) / second
        else:
            dy[V] = (drive - load - hinge - first * p.gravity) / first
            dy[VB] = (hinge - second * p.gravity) / second
    else:
        dy[V] = (drive - load - weight) / (p.mass + p.memory * p.memory_mass)
    if p.p_lag != 0.0:
        dy[PM] = (p_load - y[PM]) / p.p_lag

    # friction elements, (6)-(8)
    if p.model == LUGRE:
        side = 1.0 if vl > 0.0 else -1.0
        dy[N_BASE] = p.stiffness[0] * (vl - abs(vl) * y[N_BASE] / sliding_level(vl, side, xl, p_load, p))
    else:
        s, side = 0.0, 0.0
        for i in range(n):
            if modes[i] == 0:
                dy[N_BASE + i] = p.stiffness[i] * vl
            else:
                if side != modes[i]:
                    side = float(modes[i])
                    s = sliding_level(vl, side, xl, p_load, p)
                dy[N_BASE + i] = p.attraction * (side * p.weight[i] - y[N_BASE + i] / s)


@nb.njit(cache=True)
def crossed(y, modes, p, out):
    """Mark the friction elements that change between stick and slip; return whether any does."""
    on_second = p.load_on_second != 0.0
    v, x = (y[VB], y[XB]) if on_second else (y[V], y[X])
    found, s = False, -1.0
    side = 1.0 if v > 0.0 else -1.0
    for i in range(int(p.n_elements)):
        out[i] = 0
        if modes[i] != 0:
            if modes[i] * v < 0.0:
                out[i], found = 1, True
        elif v != 0.0 and side * y[N_BASE + i] > 0.0:
            if s < 0.0:
                s = sliding_level(v, side, x, load_pressure(y, p), p)
            if side * y[N_BASE + i] > p.weight[i] * s:
                out[i], found = 1, True
    return found


@nb.njit(cache=True)
def switch(y, modes, p, marked):
    """Switch the marked elements between stick and slip."""
    at = VB if p.load_on_second != 0.0 else V
    turned = False
    for i in range(int(p.n_elements)):
        if marked[i]:
            if modes[i] == 0:
                modes[i] = 1 if y[at] > 0.0 else -1
            else:
                modes[i] = 0
                turned = True
    if turned:  # located where the speed is zero up to rounding
        y[at] = 0.0


@nb.njit(cache=True)
def dormand_prince(t, h, y, k, stage, new, n, modes, spool_free, p, c):
    """Take one step from y with its derivative in k[0]; return the error in units of the tolerance."""
    for i in range(n):
        stage[i] = y[i] + h * A21 * k[0, i]
    rhs(t + h / 5, stage, k[1], modes, spool_free, p, c)
    for i in range(n):
        stage[i] = y[i] + h * (A31 * k[0, i] + A32 * k[1, i])
    rhs(t + 3 * h / 10, stage, k[2], modes, spool_free, p, c)
    for i in range(n):
        stage[i] = y[i] + h * (A41 * k[0, i] + A42 * k[1, i] + A43 * k[2, i])
    rhs(t + 4 * h / 5, stage, k[3], modes, spool_free, p, c)
    for i in range(n):
        stage[i] = y[i] + h * (A51 * k[0, i] + A52 * k[1, i] + A53 * k[2, i] + A54 * k[3, i])
    rhs(t + 8 * h / 9, stage, k[4], modes, spool_free, p, c)
    for i in range(n):
        stage[i] = y[i] + h * (A61 * k[0, i] + A62 * k[1, i] + A63 * k[2, i] + A64 * k[3, i] + A65 * k[4, i])
    rhs(t + h, stage, k[5], modes, spool_free, p, c)
    for i in range(n):
        new[i] = y[i] + h * (B1 * k[0, i] + B3 * k[2, i] + B4 * k[3, i] + B5 * k[4, i] + B6 * k[5, i])
    rhs(t + h, new, k[6], modes, spool_free, p, c)
    worst = 0.0
    for i in range(n):
        e = h * (E1 * k[0, i] + E3 * k[2, i] + E4 * k[3, i] + E5 * k[4, i] + E6 * k[5, i] + E7 * k[6, i])
        worst = max(worst, abs(e) / (ATOL[i] + RTOL * max(abs(y[i]), abs(new[i]))))
    return worst


@nb.njit(cache=True)
def advance(t, end, h, y, n, modes, spool_free, p, c, work, marked):  # noqa: PLR0912 - the loop is the algorithm
    """Integrate y in place from t to end with the inputs c; return the next step size, negative on failure.

    A friction element changes between stick and slip only at the end of a step. A step past a change is repeated up to the
    change, which is located on the step's cubic interpolant.
    """
    k, stage, new, trial = work[:7], work[7], work[8], work[9]
    rhs(t, y, k[0], modes, spool_free, p, c)
    changes = 0
    for _ in range(100000):
        left = end - t
        if left <= 1.0e-12:
            return h
        step = min(h, left)
        if left - step < 0.1 * step:
            step = left
        error = dormand_prince(t, step, y, k, stage, new, n, modes, spool_free, p, c)
        if not error <= 1.0 and step > 1.0e-9:  # also if it is NaN
            h = step * (max(0.2, 0.9 * error**-0.2) if error < 1.0e12 else 0.1)
            continue
        if not error < 1.0e12:
            return -1.0
        grown = step * min(5.0, 0.9 * max(error, 1.0e-6) ** -0.2)
        h = max(grown, h) if step < h else grown
        if p.model == GMS and changes < 500 and crossed(new, modes, p, marked):
            changes += 1
            low, high = 0.0, 1.0
            for _bisection in range(45):
                z = 0.5 * (low + high)
                for i in range(n):
                    d = new[i] - y[i]
                    trial[i] = y[i] + z * d + z * (z - 1.0) * ((1.0 - 2.0 * z) * d + step * ((z - 1.0) * k[0, i] + z * k[6, i]))
                if crossed(trial, modes, p, marked):
                    high = z
                else:
                    low = z
            for i in range(n):
                d = new[i] - y[i]
                trial[i] = (
                    y[i]
                    + high * d
                    + high * (high - 1.0) * ((1.0 - 2.0 * high) * d + step * ((high - 1.0) * k[0, i] + high * k[6, i]))
                )
            crossed(trial, modes, p, marked)
            step *= high
            if step > 1.0e-13:
                if high < 1.0:
                    dormand_prince(t, step, y, k, stage, new, n, modes, spool_free, p, c)
                for i in range(n):
                    y[i] = new[i]
                t += step
            switch(y, modes, p, marked)
            rhs(t, y, k[0], modes, spool_free, p, c)
            continue
        t += step
        for i in range(n):
            y[i] = new[i]
            k[0, i] = k[6, i]
        if p.spool_stop < HUGE and abs(y[XV]) > p.spool_stop:
            y[XV] = p.spool_stop if y[XV] > 0.0 else -p.spool_stop
            rhs(t, y, k[0], modes, spool_free, p, c)
    return -1.0


@nb.njit(cache=True)
def temperature_at(t, p):
    """Return the oil's temperature, K."""
    return p.temperature + p.temperature_offset + p.warming * (1.0 - math.exp(-t / p.warming_time))


@nb.njit(cache=True)
def true_signals(t, y, p, out):
    """Write the readings of perfect sensors."""
    out[POSITION] = y[X]
    out[VELOCITY] = y[V]
    p_load = load_pressure(y, p)
    out[PRESSURE] = y[PM] if p.p_lag != 0.0 else p_load
    out[SPOOL] = y[XV]
    out[SUPPLY] = supply_pressure(y, p)
    out[FORCE] = p.area * p_load
    out[TEMPERATURE] = temperature_at(t, p)
    first, second = (PRESSURE_B, PRESSURE_A) if p.swapped != 0.0 else (PRESSURE_A, PRESSURE_B)
    out[first], out[second] = max(y[PA], p.vapour), max(y[PB], p.vapour)


@nb.njit(cache=True)
def sense(t, dt, tick, history, now, p, unit_noise, zero, held, memory, last, out):  # noqa: PLR0912 - one branch per effect
    """Write the sensor readings at t, with faults, then noise, then resolution.

    history: true signals at the control ticks up to `tick`; now: at t. zero: drifting zero of the pressure sensor. held: bits
    of pressure and position that are stuck at their last value. memory: the plays of the pressure sensor and the load cell.
    """
    for ch in range(N_CHANNELS):
        value = now[ch]
        if p.delay[ch] > 0.0:
            back = t - p.delay[ch]
            j = int(back / dt)
            if back <= 0.0:
                value = history[0, ch]
            elif j >= tick:
                part = (back - tick * dt) / max(t - tick * dt, 1.0e-12)
                value = history[tick, ch] + part * (now[ch] - history[tick, ch])
            else:
                value = history[j, ch] + (back / dt - j) * (history[j + 1, ch] - history[j, ch])
        if ch == PRESSURE:
            if p.p_play > 0.0:
                memory[0] = min(max(memory[0], value - p.p_play), value + p.p_play)
                value = memory[0]
            value = value * p.p_gain + p.p_bias + p.p_quadratic * value * value + zero
            value += p.p_per_x * now[POSITION] + p.p_per_xx * now[POSITION] * now[POSITION]
            value += p.p_per_kelvin * (now[TEMPERATURE] - p.temperature)
        elif ch == PRESSURE_A:
            value = value * p.a_gain + p.a_bias
        elif ch == PRESSURE_B:
            value = value * p.b_gain + p.b_bias
        elif ch == POSITION:
            if p.x_interpolation != 0.0:
                z = 6.283185307179586 * value / p.x_period + p.x_phase
                value += p.x_interpolation * (math.sin(z) + 0.3 * math.sin(2.0 * z + 0.7))
            value = value * p.x_gain + p.x_bias
        elif ch == FORCE:
            given = value
            if p.cell_bow != 0.0:
                z = given / p.cell_scale
                value += p.cell_bow * given * (z * z / (1.0 + z * z) - p.cell_bow_mean)
            if p.cell_play != 0.0:
                memory[1] = min(max(memory[1], given - p.cell_play_width), given + p.cell_play_width)
                value += p.cell_play * (memory[1] - p.cell_play_mean * given)
            if p.cell_per_speed != 0.0:
                value += p.cell_per_speed * (now[VELOCITY] - p.cell_per_speed_mean * given)
        elif ch == VELOCITY and p.speed_per_pressure != 0.0:
            value += p.speed_per_pressure * (now[PRESSURE] - p.speed_per_pressure_mean * value)
        value += p.noise_std[ch] * unit_noise[ch]
        if p.resolution[ch] > 0.0:
            value = math.floor(value / p.resolution[ch] + 0.5) * p.resolution[ch]
        if ch == PRESSURE and p.p_step > 0.0:
            code = math.floor(value / p.p_step + 0.5)
            if p.p_codes > 0.0 and (code * 5.0 + p.p_codes) % 8.0 < 1.0:
                code += 1.0
            value = code * p.p_step
        if (ch == PRESSURE and held & 1) or (ch == POSITION and held & 2):
            value = last[ch]
        last[ch] = value
        out[ch] = value


@nb.njit(cache=True)
def spool_target(u, t, plays, p):
    """Return the target spool position of a command; plays: state of the plays in the valve's first stage."""
    u = min(max(u, -p.spool_limit), p.spool_limit)
    if p.play > 0.0:
        mean = 0.0
        for i in range(N_PLAYS):
            half = p.play * (1.0 + p.play_spread * (i - 2))  # 0.2 ... 1.8 of the mean
            plays[i] = min(max(plays[i], u - half), u + half)
            mean += plays[i] / N_PLAYS
        u = mean
    if p.pilot_dead_pos != 0.0 or p.pilot_dead_neg != 0.0:
        u = softplus(u - p.pilot_dead_pos, 0.1 * p.pilot_dead_pos) - softplus(-u - p.pilot_dead_neg, 0.1 * p.pilot_dead_neg)
    if p.power != 1.0:
        z = u / p.power_at
        u *= (z * z / (1.0 + z * z / 16.0) + 1.0e-4) ** (0.5 * (p.power - 1.0))
    u *= p.gain_pos if u > 0.0 else p.gain_neg
    if p.spool_wave != 0.0:
        phase = p.spool_wave_phase + (p.spool_wave_side if u > 0.0 else 0.0)
        mean = p.spool_wave_mean_pos if u > 0.0 else p.spool_wave_mean_neg
        u *= 1.0 + p.spool_wave * (wave(u, p.spool_wave_turns, p.spool_wave_at, phase) - mean)
    if p.warm_valve != 0.0:
        u *= 1.0 + p.warm_valve * warmth(t, p)
    u += p.null_command + p.null_drift * (1.0 - math.exp(-t / p.null_drift_time))
    return p.valve_gain * u


@nb.njit(cache=True)
def pushed(want, seen):
    """Return the load pressure against a motion, Pa."""
    return seen[PRESSURE] if want > 0.0 else -seen[PRESSURE]


@nb.njit(cache=True)
def spare_pressure(want, seen, p):
    """Return the force that a single rod has left for a motion, over its mean area, Pa."""
    return (p.reach_out - seen[FORCE] if want > 0.0 else p.reach_in + seen[FORCE]) / p.nominal_area


@nb.njit(cache=True)
def control(dt, k, seen, f_ref, x_ref, v_ref, memory, p):
    """Return the command: PI on force and P on position, summed as a reference speed and converted to a spool displacement.

    The force of a double rod is that of its load pressure, that of a single rod is read by the load cell.
    memory: filtered force error, its integral.
    """
    single = p.area_a > 0.0
    want = v_ref[k]
    if p.w_force != 0.0:
        e = f_ref[k] - (seen[FORCE] if single else p.nominal_area * seen[PRESSURE])
        memory[0] += dt * p.force_filter * (e - memory[0])
        memory[1] = min(max(memory[1] + dt * memory[0] / p.force_reset, -2.0e3), 2.0e3)
        want += p.w_force * p.force_gain * (memory[0] + memory[1])
    if p.w_position != 0.0:
        want += p.w_position * p.position_gain * (x_ref[k] - seen[POSITION])
    ahead = seen[POSITION] + 0.02 * seen[VELOCITY]  # keep off the cylinder's ends
    if ahead > p.guard:
        want = min(want, 0.0) - 8.0 * (ahead - p.guard)
    elif ahead < -p.guard:
        want = max(want, 0.0) - 8.0 * (ahead + p.guard)
    push = 1.0 - spare_pressure(want, seen, p) / p.nominal_supply if single else pushed(want, seen) / p.nominal_supply
    if push > 0.75:  # limit the pressure against a rigid obstacle
        want *= max((0.87 - push) / 0.12, -0.5)
    want = min(max(want, -1.6), 1.6)
    drop = spare_pressure(want, seen, p) if single else p.nominal_supply - pushed(want, seen)
    gain = p.flow_gain
    if single:
        gain = p.flow_gain_out if want > 0.0 else p.flow_gain_in
    u = want * p.nominal_area / (gain * math.sqrt(max(drop, 0.03 * p.nominal_supply)))
    return min(max(u, -p.spool_limit), p.spool_limit)


@nb.njit(cache=True)
def ticks_of(delay, dt):
    """Return a delay as whole ticks and a remainder."""
    whole = int(delay / dt + 1.0e-9)
    part = max(delay - whole * dt, 0.0)
    return whole, part if part >= 1.0e-9 else 0.0


@nb.njit(cache=True)
def become(y, before, now, target, plays, sensor_memory):
    """Initialise the states that were unused before a change of the rig, for a bumpless transition."""
    if before.p_lag == 0.0:
        y[PM] = y[PL]
    if before.droop + before.droop_square == 0.0:
        y[PS] = before.supply
    if before.hose == 0.0:
        y[ZH] = y[PL]
    if before.creep == 0.0:
        y[ZS] = y[X]
    if before.second_rate == 0.0:
        y[WV] = 0.0
    if before.play == 0.0:
        plays[:] = target / before.valve_gain
    if before.p_play == 0.0:
        sensor_memory[0] = y[PL]
    if before.two_body == 0.0 and now.two_body != 0.0:
        y[XB], y[VB] = y[X], y[V]
        force = now.area * y[PL]
        if now.load_on_second != 0.0:  # the hinge carries the load
            y[XB] -= force / now.second_stiffness + math.copysign(0.5 * now.gap, force)
        else:
            y[XB] -= now.second_share * now.mass * now.gravity / now.second_stiffness


@nb.njit(cache=True)
def simulate(  # noqa: PLR0912 - the loop is the algorithm
    rigs, begins, y, modes, dt, f_ref, x_ref, v_ref, fd, servo, hold, control_noise, zero, held,
    at, noise, same_times, signals, commands, disturbances, displacements, states,
):  # fmt: skip
    """Run an experiment; return the number of control ticks completed.

    rigs, begins: records of the rig, and the tick from which each applies, the first 0.
    At the control ticks, one more than the run has: f_ref, x_ref, v_ref, fd, servo, zero, held; also control_noise.
    at: times of the recording's samples, with noise; same_times: whether they equal the ticks. The rest is output.
    """
    n_ticks = f_ref.size - 1
    p, piece = rigs[0], 0
    n = N_BASE + int(p.n_elements)
    history = np.empty((n_ticks + 1, N_CHANNELS))
    u = np.empty(n_ticks)
    work = np.zeros((10, N_BASE + N_ELEMENTS))
    marked = np.zeros(N_ELEMENTS, np.int64)
    seen, now, last, last_recorded = np.zeros(N_CHANNELS), np.zeros(N_CHANNELS), np.zeros(N_CHANNELS), np.zeros(N_CHANNELS)
    force_memory, sensor_memory, plays = np.zeros(2), np.zeros(2), np.zeros(N_PLAYS)
    whole, part = ticks_of(p.command_delay, dt)
    h, row, spool_free = 2.0e-4, 0, True
    sensor_memory[0] = load_pressure(y, p)
    sensor_memory[1] = p.area * sensor_memory[0]
    target = spool_target(0.0, 0.0, plays, p)
    for k in range(n_ticks):
        t, end = k * dt, (k + 1) * dt
        while piece + 1 < begins.size and k >= begins[piece + 1]:
            piece += 1
            become(y, p, rigs[piece], target, plays, sensor_memory)
            p = rigs[piece]
            whole, part = ticks_of(p.command_delay, dt)
        true_signals(t, y, p, history[k])
        sense(t, dt, k, history, history[k], p, control_noise[k], zero[k], held[k], sensor_memory, last, seen)
        u[k] = control(dt, k, seen, f_ref, x_ref, v_ref, force_memory, p)
        fd_rate = 0.0 if hold else (fd[k + 1] - fd[k]) / dt
        servo_rate = 0.0 if hold else (servo[k + 1] - servo[k]) / dt
        temperature = history[k, TEMPERATURE]
        if p.level_per_kelvin != 0.0:
            p.level_now = math.exp(-p.level_per_kelvin * (temperature - p.temperature))
        arrival = t + part
        arrived = False
        while t < end - 1.0e-12:
            if not arrived and t >= arrival - 1.0e-12:
                arrived = True
                target = spool_target(u[k - whole] if k >= whole else 0.0, t, plays, p)
            if p.stiction != 0.0:  # stuck until the pilot force is large, then free until it is small
                miss = abs(target - y[XV])
                spool_free = miss > (0.2 * p.stiction if spool_free else p.stiction)
            stop = end
            if not arrived:
                stop = min(stop, arrival)
            if row < at.size and at[row] <= t + 1.0e-12:
                if same_times:
                    signals[row] = seen
                else:
                    true_signals(t, y, p, now)
                    sense(t, dt, k, history, now, p, noise[row], zero[k], held[k], sensor_memory, last_recorded, signals[row])
                commands[row] = u[k]
                disturbances[row] = fd[k] + fd_rate * (t - k * dt)
                displacements[row] = servo[k] + servo_rate * (t - k * dt)
                if states.size > 0:
                    for i in range(n):
                        states[row, i] = y[i]
                row += 1
            if row < at.size and not same_times:
                stop = min(stop, max(at[row], t + 1.0e-9))
            h = advance(
                t, stop, h, y, n, modes, spool_free, p,
                (target, fd[k], fd_rate, servo[k], servo_rate, k * dt, temperature), work, marked,
            )  # fmt: skip
            if h < 0.0 or not abs(y[X]) < 10.0:
                return k
            t = stop
    return n_ticks
