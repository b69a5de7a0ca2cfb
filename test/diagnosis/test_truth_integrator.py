"""The truth generator's integrator against scipy's, and the conservation laws of its equations."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy.integrate import solve_ivp, trapezoid
from tiers import tiered

from truth_generator import experiments, kernel, record
from truth_generator.effects import EFFECTS
from truth_generator.recording import nominal_sizes
from truth_generator.residuals import model_residuals

CONFIG = Path(__file__).parents[2] / "config"
RIG = yaml.safe_load((CONFIG / "rig_paper_measured.yaml").read_text(encoding="utf-8"))
DURATION = 0.3


def rig_with(model):
    return RIG | {"friction": RIG["friction"] | {"model": model}}


@pytest.fixture
def shake(monkeypatch):
    """A third of a second with break-away and reversals, which the other experiments reach only later."""

    def plan(rng, t, rig):
        x = 4e-3 * np.sin(2 * np.pi * 5 * t) * np.minimum(t / 0.1, 1.0) ** 2
        fd = 1.5e3 * np.sin(2 * np.pi * 4 * t)
        return experiments.from_motion(x, fd, rig, np.zeros_like(t))

    monkeypatch.setitem(experiments.EXPERIMENTS, "shake", plan)
    return "shake"


def sliding_level(v, friction):
    fc, fs, vs, exponent = (friction[k] for k in ("coulomb_force", "static_force", "stribeck_velocity", "stribeck_exponent"))
    return fc + (fs - fc) * np.exp(-((abs(v) / vs) ** exponent))


def paper_equations(rig):
    """Return the rates of (1)-(8) for (x, v, pL, xv, friction), or the same with LuGre."""
    plant, friction = rig["plant"], rig["friction"]
    k = np.asarray(friction["element_stiffness"])
    lugre = friction["model"] == "lugre"

    def rate(t, y, modes, u, fd, fd_rate, t0):
        x, v, p_load, xv = y[:4]
        f = y[4:]
        flow = plant["discharge_coefficient"] * plant["valve_area_gradient"] * xv
        flow *= np.sqrt((plant["supply_pressure"] - np.sign(xv) * p_load) / plant["oil_density"])
        p_rate = 4 * plant["bulk_modulus"] / plant["total_volume"]
        p_rate *= flow - plant["piston_area"] * v - plant["leakage_coefficient"] * p_load
        force = plant["piston_area"] * p_load - plant["viscous_damping"] * v - plant["spring_stiffness"] * x
        force -= f.sum() + friction["viscous_coefficient"] * v + fd + fd_rate * (t - t0)
        s = sliding_level(v, friction)
        if lugre:
            f_rate = k.sum() * (v - abs(v) * f / s)
        else:
            slip = friction["attraction_rate"] * (modes * np.asarray(friction["element_weight"]) - f / s)
            f_rate = np.where(modes == 0, k * v, slip)
        a = force / plant["moving_mass"] - plant["gravity"]
        xv_rate = plant["valve_bandwidth"] * (plant["valve_gain"] * u - xv)
        return np.concatenate([[v, a, p_rate, xv_rate], f_rate])

    return rate


def kernel_equations(rig, effects):
    """Return the kernel's equations with effects for scipy to integrate, so that only the integrators are compared."""
    p = nominal_sizes(rig)
    for name, sizes in effects.items():
        EFFECTS[name].apply(p[0], EFFECTS[name].neutral | sizes)
    plays = np.zeros(kernel.N_PLAYS)
    out = np.zeros(kernel.N_BASE + int(p["n_elements"][0]))

    def rate(t, y, modes, u, fd, fd_rate, t0):
        target = kernel.spool_target(u, t, plays, p[0])
        whole = np.zeros(kernel.N_ELEMENTS, np.int64)
        whole[: modes.size] = modes
        kernel.rhs(t, y, out, whole, True, p[0], (target, fd, fd_rate, 0.0, 0.0, t0, 313.15))
        return out.copy()

    return rate


def reference(rate, y, r, first_element, friction, at_v, scale):
    """Integrate with the recorded command and disturbance by scipy's Radau, stopping where an element sticks or slips."""
    weight = np.asarray(friction["element_weight"])
    gms = friction["model"] == "gms"
    modes = np.zeros(weight.size if gms else 1)
    u, fd = r.columns["valve_command_m"], r.columns["disturbance_force_n"]
    out = [y]

    def due(i):
        def event(t, y, modes, *held):
            if modes[i]:
                return -modes[i] * y[at_v]
            side = 1.0 if y[at_v] > 0 else -1.0
            return side * y[first_element + i] - weight[i] * sliding_level(y[at_v], friction)

        event.terminal, event.direction = True, 1
        return event

    events = [due(i) for i in range(weight.size)] if gms else None
    for j in range(u.size - 1):
        t, end = r.time[j], r.time[j + 1]
        held = (u[j], fd[j], (fd[j + 1] - fd[j]) / (end - t), t)
        while t < end:
            step = solve_ivp(
                rate, (t, end), y, "Radau", args=(modes.copy(), *held), rtol=1e-8, atol=scale * 1e-9,
                events=events,
            )  # fmt: skip
            t, y = step.t[-1], step.y[:, -1].copy()
            if step.status == 1:
                for i, times in enumerate(step.t_events):
                    if times.size:
                        modes[i] = 0 if modes[i] else np.sign(y[at_v])
                        if not modes[i]:
                            y[at_v] = 0.0
        out.append(y)
    return np.array(out), modes


@pytest.mark.long
@pytest.mark.parametrize("model", ["gms", "lugre"])
def test_with_nothing_hidden_it_is_the_papers_model(shake, model):
    rig = rig_with(model)
    r = record(rig, {}, shake, seed=1, duration=DURATION, noise=0, internals=True)
    chosen = [kernel.X, kernel.V, kernel.PL, kernel.XV, *range(kernel.N_BASE, r.states.shape[1])]
    states = r.states[:, chosen]
    assert np.abs(states[:, 1]).max() > 0.08
    assert np.sum(np.diff(np.sign(states[:, 1])) != 0) >= 2  # the motion reversed
    scale = np.abs(states).max(axis=0)
    ours, _ = reference(paper_equations(rig), states[0], r, 4, rig["friction"], 1, scale)
    assert np.abs(ours - states).max(axis=0) / scale == pytest.approx(0.0, abs=2e-6)
    assert np.abs(r.columns["force_n"] - RIG["plant"]["piston_area"] * states[:, 2]).max() < 1e-9


@pytest.mark.parametrize(
    ("name", "sizes"),
    tiered(
        [
            ("valve_second_order", {"natural_frequency": 200.0, "damping_ratio": 0.3}),
            ("entrained_air", {"fraction": 0.05}),
            ("hinge_backlash", {"gap": 3e-4}),
        ],
        ("entrained_air", {"fraction": 0.05}),
        unpack=True,
    ),
)
def test_with_an_effect_the_integrator_keeps_its_tolerance(shake, name, sizes):
    rig = rig_with("lugre" if name == "hinge_backlash" else "gms")
    r = record(rig, {name: sizes}, shake, seed=1, duration=DURATION, noise=0, internals=True)
    scale = np.maximum(np.abs(r.states).max(axis=0), 1e-6)
    at_v = kernel.VB if name == "hinge_backlash" else kernel.V
    rate = kernel_equations(rig, {name: sizes})
    theirs, _ = reference(rate, r.states[0], r, kernel.N_BASE, rig["friction"], at_v, scale)
    assert np.abs(theirs - r.states).max(axis=0) / scale == pytest.approx(0.0, abs=1e-5)


def test_oil_is_neither_made_nor_lost():
    plant = RIG["plant"]
    r = record(RIG, {}, "rich", seed=3, duration=20, noise=0, rate=4000)
    c = r.columns
    flow = plant["discharge_coefficient"] * plant["valve_area_gradient"] * c["spool_m"]
    flow *= np.sqrt((plant["supply_pressure"] - np.sign(c["spool_m"]) * c["load_pressure_pa"]) / plant["oil_density"])
    leaked = plant["leakage_coefficient"] * trapezoid(c["load_pressure_pa"], r.time)
    swept = plant["piston_area"] * np.ptp(c["position_m"][[0, -1]]) * np.sign(c["position_m"][-1] - c["position_m"][0])
    squeezed = plant["total_volume"] / (4 * plant["bulk_modulus"]) * (c["load_pressure_pa"][-1] - c["load_pressure_pa"][0])
    moved = trapezoid(np.abs(flow), r.time)
    assert (trapezoid(flow, r.time) - leaked - swept - squeezed) / moved == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("model", ["gms", "lugre"])
def test_work_done_is_stored_or_lost_and_friction_gives_none(model):
    rig = rig_with(model)
    plant = rig["plant"]
    r = record(rig, {}, "rich", seed=3, duration=20, noise=0, rate=4000, internals=True)
    x, v, p_load = (r.states[:, i] for i in (kernel.X, kernel.V, kernel.PL))
    rub = r.states[:, kernel.N_BASE :].sum(axis=1)

    def work(force):
        return trapezoid(force * v, r.time)

    stored = (
        0.5 * plant["moving_mass"] * v**2 + 0.5 * plant["spring_stiffness"] * x**2 + plant["moving_mass"] * plant["gravity"] * x
    )
    lost = work((plant["viscous_damping"] + rig["friction"]["viscous_coefficient"]) * v) + work(rub)
    given = work(plant["piston_area"] * p_load) - work(r.columns["disturbance_force_n"])
    turnover = trapezoid(np.abs(plant["piston_area"] * p_load * v), r.time)
    assert (given - lost - stored[-1] + stored[0]) / turnover == pytest.approx(0.0, abs=1e-5)
    taken = np.cumsum(rub * v) * (r.time[1] - r.time[0])
    elastic = 0.5 * rig["friction"]["static_force"] ** 2 / sum(rig["friction"]["element_stiffness"])
    assert (taken - np.maximum.accumulate(taken)).min() > -1.2 * elastic


def test_the_command_is_followed_as_equation_4_has_it():
    valve = model_residuals(RIG, record(RIG, {}, "rich", seed=3, duration=10, noise=0))["valve"][0]
    assert np.abs(valve).max() < 1e-11
