"""Effects written from terms of a diagnosis: their formulas against the terms' tables, and the package that holds them."""

import json
import sys
from types import ModuleType

import numpy as np
import pytest
import test_effects as contract
from rig_runs import PAPER_RIG
from third_party import install

from ehls_ros.cli.main import BAD_INPUT, DONE, main
from ehls_ros.diagnosis.hypotheses import candidates
from ehls_ros.diagnosis.reading import Shape, read
from ehls_ros.diagnosis.record import prepare
from ehls_ros.diagnosis.result import Term
from ehls_ros.errors import BadInput
from ehls_ros.estimate import Estimate
from ehls_ros.experiments.effect_file import effect_text, formula_of, term_of
from ehls_ros.experiments.effect_package import add_effect
from ehls_ros.experiments.json_document import json_document
from ehls_ros.experiments.spec import load_rig
from ehls_ros.families import offered
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.effects.base import HOOKS
from ehls_ros.physics.plant import FD, INPUTS, PL, XV, V, X
from ehls_ros.schema import declarations
from ehls_ros.trajectory import Trajectory

STATE = {"position_m": X, "velocity_m_s": V, "load_pressure_pa": PL, "spool_m": XV}


def table_of(function, first, last, knots=16, *, periodic=False):
    """Return places and values of the table nearest to a function, linear between its knots."""
    at = np.linspace(first, last, knots, endpoint=not periodic)
    along = np.linspace(first, last, 2000, endpoint=not periodic)
    rows = np.eye(knots)
    places, rows = (np.append(at, last), np.column_stack([rows, rows[:, 0]])) if periodic else (at, rows)
    hats = np.column_stack([np.interp(along, places, row) for row in rows])
    return at, np.linalg.lstsq(hats, function(along), rcond=None)[0]


def term(effect, argument, table, *, period=None, direction=0.0, magnitude=False, **more):
    at, values = table
    std = np.full(len(at), 0.005 * np.ptp(values))
    unit = unit_of(effect)
    of_period = None if period is None else Estimate(period, 1e-6 * period, "s" if argument == "time_s" else "m")
    reading = read(at, values, np.diag(std**2), periodic=period is not None)
    return Term(effect, argument, magnitude, unit, at, values, std, of_period, 0.97, direction, reading, **more)


def unit_of(effect):
    return next(d.unit for d in declarations(EFFECTS.load(effect).Parameters) if d.name == "level")


def shaped(name, kind="", **numbers):
    return (Shape(name, {key: Estimate(value, 0.01 * abs(value), "") for key, value in numbers.items()}, kind),)


def drag(v):
    return -2e4 * v * np.abs(v)


def cogging(x):
    return 300.0 * np.sin(2.0 * np.pi * x / 7e-3) + 120.0 * np.cos(4.0 * np.pi * x / 7e-3)


def patch(x):
    return 500.0 * np.exp(-(((x - 0.004) / 0.005) ** 2))


def hum(t):
    return 3e-5 * np.sin(100.0 * np.pi * t + 0.5)


def restriction(xv):
    return -4e-5 * np.sign(xv) * np.abs(xv / 5e-4) ** 3


def leak(pressure):
    return np.interp(pressure, np.linspace(-4e5, 6e5, 8), 1e-6 * np.array([0.0, 0.0, 0.1, 0.5, 0.4, 0.9, 1.0, 1.0]))


def rising_friction(speed):
    return 50.0 + 3e3 * speed**1.5


def saturating(v):
    return -300.0 * np.tanh((v - 0.02) / 0.05)


def threshold(pressure):
    return 2e-6 * np.maximum(pressure - 1e5, 0.0) / 1e6


def bow(pressure):
    return 4e4 * (pressure / 6e5) ** 2


def linear(spool):
    return -0.3 * spool


def drag_beside_viscous(v):
    return -4.7e3 * v * np.abs(v) + 560.0 * v


# Function, the term found for it, names of the effect's parameters.
TERMS = {
    "drag": (drag, term("empirical_force", "velocity_m_s", table_of(drag, -0.2, 0.2)), "size exponent"),
    "drag_beside_viscous": (
        drag_beside_viscous,
        term("empirical_force", "velocity_m_s", table_of(drag_beside_viscous, -0.18, 0.19, 8)),
        "size exponent linear",
    ),
    "cogging": (
        cogging,
        term("empirical_force", "position_m", table_of(cogging, 0.0, 7e-3, periodic=True), period=7e-3, direction=0.01),
        "sine cosine sine_2 cosine_2 wavelength speed",
    ),
    "patch": (patch, term("empirical_friction", "position_m", table_of(patch, -0.02, 0.03)), "size place width"),
    "hum": (
        hum,
        term("empirical_spool", "time_s", table_of(hum, 0.0, 0.02, periodic=True), period=0.02),
        "sine cosine frequency",
    ),
    "restriction": (
        restriction,
        term("empirical_opening", "spool_m", table_of(restriction, -5e-4, 5e-4)),
        "size exponent",
    ),
    "saturating": (
        saturating,
        term(
            "empirical_force",
            "velocity_m_s",
            table_of(saturating, -0.2, 0.2),
            formula=shaped("step", size=-300.0, place=0.02, width=0.05),
        ),
        "size place width",
    ),
    "threshold": (
        threshold,
        term(
            "empirical_leakage",
            "load_pressure_pa",
            table_of(threshold, -4e5, 6e5),
            formula=shaped("beyond", "above", size=2e-6, at_distance=1e6, place=1e5),
        ),
        "size place",
    ),
    "bow": (bow, term("empirical_pressure_reading", "load_pressure_pa", table_of(bow, -6e5, 6e5)), "size exponent"),
    "slow_spool": (linear, term("empirical_spool", "spool_m", table_of(linear, -5e-4, 5e-4), error=True), "size exponent"),
    "leak": (leak, term("empirical_leakage", "load_pressure_pa", table_of(leak, -4e5, 6e5, 8)), "size stretch"),
    "rising_friction": (
        rising_friction,
        term("empirical_friction", "velocity_m_s", table_of(rising_friction, 0.01, 0.2, 8), magnitude=True),
        "size exponent constant",
    ),
}


@pytest.fixture(scope="module")
def effects(tmp_path_factory):
    """Write an effect from each term, and return the modules by name."""
    site = tmp_path_factory.mktemp("site")
    modules = {f"acme_terms.{name}": effect_text(name, given, "a test") for name, (_, given, _) in TERMS.items()}
    install(site, modules, {EFFECTS.group: {name: f"acme_terms.{name}" for name in TERMS}}, "acme_terms")
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(site)
        offered.cache_clear()
        yield {name: EFFECTS.load(name) for name in TERMS}
    offered.cache_clear()
    for name in TERMS:
        EFFECTS._loaded.pop(name, None)
    for name in [name for name in sys.modules if name.partition(".")[0] == "acme_terms"]:
        sys.modules.pop(name)


def evaluated(effect, given, place, /, **changed):
    """Return the change of a hook's value with the argument at a place, and the piston moving fast if direction counts."""
    found = {number.name: number.found for number in formula_of(given).numbers}
    [hook] = [name for name in HOOKS if hasattr(effect, name)]
    y, w, t, value = np.zeros(7), np.zeros(INPUTS), 0.0, 1e4 if hook == "friction_level" else 0.0
    y[V] = 10.0
    if given.error:
        y[XV] = -place
    elif given.argument == "time_s":
        t = place
    elif given.argument == "disturbance_force_n":
        w[FD] = place
    else:
        y[STATE[given.argument]] = place
    value = place if hook == "opening" else value
    p = effect.Parameters(**{**found, **changed})
    return getattr(effect, hook).py_func(value, t, y, w, np.zeros(0), p, None) - value


@pytest.mark.parametrize("name", TERMS)
def test_a_formula_gives_the_function_behind_the_table(name, effects):
    function, given, _ = TERMS[name]
    end = given.at[-1] if given.period is None else given.at[0] + given.period.value
    along = np.linspace(given.at[0], end, 101)
    values = np.array([evaluated(effects[name], given, place) for place in along])
    assert np.max(np.abs(values - function(along))) < 0.02 * np.ptp(given.values)


@pytest.mark.parametrize("name", TERMS)
def test_the_shape_of_a_term_decides_the_formula(name, effects):
    names = TERMS[name][2]
    assert [d.name for d in declarations(effects[name].Parameters)] == names.split()


@pytest.mark.parametrize("name", TERMS)
def test_the_defaults_change_nothing(name, effects):
    effect = effects[name]
    neutral = {d.name: d.default for d in declarations(effect.Parameters)}
    given = TERMS[name][1]
    assert evaluated(effect, given, given.at[3], **neutral) == 0.0


@pytest.mark.parametrize("name", TERMS)
@pytest.mark.usefixtures("effects")
def test_an_effect_keeps_the_contract_of_its_family(name):
    contract.test_an_effect_says_what_it_is(name)
    contract.test_parameters_are_declared_with_unit_range_help_and_neutral_default(name)
    contract.test_an_effect_acts_somewhere(name)
    contract.test_an_effect_needs_signals_that_there_are(name)
    contract.test_the_ways_to_fit_an_effect_start_off_the_neutral_values_and_within_range(name)
    contract.test_a_rig_file_holds_an_effect(name)


def test_a_power_and_a_wave_continue_beyond_the_data(effects):
    assert evaluated(effects["drag"], TERMS["drag"][1], 0.4) == pytest.approx(-2e4 * 0.4**2, rel=0.02)
    inside, beyond = (evaluated(effects["cogging"], TERMS["cogging"][1], x) for x in (1e-3, 1e-3 + 9 * 7e-3))
    assert beyond == pytest.approx(inside, rel=1e-6)


def test_a_table_over_two_periods_gives_the_wave_of_one():
    twice = term("empirical_force", "position_m", table_of(cogging, 0.0, 14e-3, periodic=True), period=14e-3)
    found = {number.name: number.found for number in formula_of(twice).numbers}
    assert found["wavelength"] == pytest.approx(7e-3)
    assert found["sine"] == pytest.approx(300.0, rel=0.05)
    assert found["cosine_2"] == pytest.approx(120.0, rel=0.1)
    assert len(found) == 5


def test_a_stretched_table_has_the_same_values_at_stretched_places(effects):
    given = TERMS["leak"][1]
    stretched = evaluated(effects["leak"], given, 2.0 * given.at[5], stretch=2.0)
    assert stretched == pytest.approx(given.values[5], rel=1e-3)
    assert evaluated(effects["leak"], given, 5.0 * given.at[-1]) == pytest.approx(given.values[-1], rel=1e-3)


def test_the_fits_start_from_the_values_found_and_from_the_data(effects):
    rig = load_rig(PAPER_RIG)
    t = np.arange(4000) * 1e-3
    position, command = 0.05 * np.sin(2.0 * np.pi * t), 1e-4 * np.cos(2.0 * np.pi * t)
    record = prepare(Trajectory(t, {"position_m": position, "valve_command_m": command}), rig, "made")
    for found, wavelengths in ((None, [7e-3]), (0.0123, [7e-3, 0.0123])):
        tried, _ = candidates(record, rig, [], lambda of, found=found: found)
        own = next(c for c in tried if c.name == "cogging")
        np.testing.assert_allclose(own.starts[:, own.free.index("wavelength")], wavelengths, rtol=1e-6)
    bump = next(c for c in tried if c.name == "patch")
    assert len(bump.starts) == 7
    assert np.ptp(bump.starts[:, bump.free.index("place")]) > 0.08


def test_a_term_is_read_back_from_the_document():
    given = TERMS["cogging"][1]
    again = term_of(json.loads(json.dumps(json_document({"verdict": "unknown", "term": given}))), "here")
    assert effect_text("cogging", again, "x") == effect_text("cogging", given, "x")


def test_a_term_in_proportion_to_a_second_signal_has_it_as_a_factor():
    seal = term(
        "empirical_leakage",
        "velocity_m_s",
        table_of(lambda v: 1e-6 * np.abs(v), 0.0, 0.2),
        magnitude=True,
        factor="load_pressure_pa",
        factor_reach=5e5,
    )
    effect = module_of("seal", seal)
    y = np.zeros(7)
    y[V], y[PL] = -0.1, 2e5
    found = {number.name: number.found for number in formula_of(seal).numbers}
    got = effect.leakage.py_func(0.0, 0.0, y, np.zeros(INPUTS), np.zeros(0), effect.Parameters(**found), None)
    assert got == pytest.approx(1e-7 * 2e5 / 5e5, rel=0.02)


def test_a_memory_is_a_state_of_the_effect():
    hose = term(
        "empirical_leakage",
        "load_pressure_pa",
        table_of(lambda p: 1e-12 * p, -4e5, 4e5),
        lag=Estimate(0.2, 0.01, "s"),
    )
    hysteresis = term(
        "empirical_force",
        "position_m",
        table_of(lambda x: 1e5 * x, -1e-3, 1e-3),
        play=Estimate(2e-3, 1e-4, "m"),
    )
    y, w, rates = np.zeros(7), np.zeros(INPUTS), np.zeros(1)
    y[PL], y[X] = 3e5, 5e-3
    lagged, playing = module_of("hose", hose), module_of("hysteresis", hysteresis)
    assert lagged.STATES == playing.STATES == 1
    p = lagged.Parameters(**{number.name: number.found for number in formula_of(hose).numbers})
    assert lagged.leakage.py_func(0.0, 0.0, y, w, np.array([1e5]), p, None) == pytest.approx(2e-7, rel=0.02)
    lagged.derivatives.py_func(0.0, 0.0, y, w, np.array([1e5]), p, None, rates)
    assert rates[0] == pytest.approx(2e5 / 0.2)
    p = playing.Parameters(**{number.name: number.found for number in formula_of(hysteresis).numbers})
    assert playing.force.py_func(0.0, 0.0, y, w, np.array([0.0]), p, None) == pytest.approx(1e5 * 1e-3, rel=0.02)
    playing.derivatives.py_func(0.0, 0.0, y, w, np.array([0.0]), p, None, rates)
    assert rates[0] == pytest.approx(5e3 * 4e-3)


def test_every_attribute_of_a_term_enters_its_effect():
    # A further one has to be written into the effect, or such a term refused.
    assert Term._fields == (
        "effect", "argument", "magnitude", "unit", "at", "values", "std", "period", "closed", "direction", "reading", "formula",
        "factor", "factor_reach", "error", "factor_error", "lag", "play",
    )  # fmt: skip


def module_of(name, given):
    """Return the effect of a term as a module that is not installed."""
    module = ModuleType(name)
    source = effect_text(name, given, "a test")
    exec(compile(source, f"{name}.py", "exec"), module.__dict__)
    return module


def document(path, name):
    path.write_text(json.dumps(json_document({"verdict": "unknown", "term": TERMS[name][1]})), encoding="utf-8")
    return str(path)


def test_effects_are_written_one_after_another_into_one_package(tmp_path, capsys):
    package = tmp_path / "acme-rigs"
    for name in ("drag", "patch"):
        found = document(tmp_path / f"{name}.json", name)
        assert main(["effect", "new", name, "--from", found, "--package", str(package), "--json"]) == DONE
        answer = json.loads(capsys.readouterr().out.splitlines()[-1])
        assert answer["effect"] == str(package / "acme_rigs" / f"{name}.py")
        assert answer["found"]["name"] == name
    project = (package / "pyproject.toml").read_text(encoding="utf-8")
    assert project.count("[project.entry-points") == 1
    assert 'drag = "acme_rigs.drag"' in project
    assert 'patch = "acme_rigs.patch"' in project
    assert (package / "acme_rigs" / "__init__.py").exists()
    before = (package / "acme_rigs" / "drag.py").read_text(encoding="utf-8")
    compile(before, "drag.py", "exec")
    assert max(map(len, before.splitlines())) <= 128
    assert main(["effect", "new", "drag", "--from", str(tmp_path / "patch.json"), "--package", str(package)]) == BAD_INPUT
    assert (package / "acme_rigs" / "drag.py").read_text(encoding="utf-8") == before


def test_a_package_that_is_there_keeps_its_lines(tmp_path):
    project = tmp_path / "pyproject.toml"
    lines = '[project]\nname = "ours"\nversion = "3"  # ours\n\n[project.entry-points."ehls_ros.verbs"]\nwash = "ours.wash"\n'
    project.write_text(lines, encoding="utf-8")
    (tmp_path / "src" / "ours").mkdir(parents=True)
    added = add_effect(tmp_path, "drag", "x = 1\n")
    assert added.effect == tmp_path / "src" / "ours" / "drag.py"
    assert project.read_text(encoding="utf-8").startswith(lines)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["effect", "new", "coulomb_shift", "--from", "drag.json"], "has an effect 'coulomb_shift' already"),
        (["effect", "new", "Drag force", "--from", "drag.json"], "lower-case letters"),
        (["effect", "new", "drag", "--from", "none.json"], "cannot be read"),
        (["effect", "new", "drag", "--from", "consistent.json"], "no term was found in the data (verdict: consistent)"),
        (["effect", "new", "drag", "--from", "broken.json"], "no JSON"),
        (["effect", "new", "drag", "--from", "other.json"], "not the result of a diagnosis"),
    ],
)
def test_refusals_say_what_is_wrong(arguments, said, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    document(tmp_path / "drag.json", "drag")
    for name, text in (("consistent", '{"verdict": "consistent", "term": null}'), ("broken", "{"), ("other", "[1]")):
        (tmp_path / f"{name}.json").write_text(text, encoding="utf-8")
    assert main(arguments) == BAD_INPUT
    assert said in capsys.readouterr().err
    assert not (tmp_path / "my_effects").exists()


def test_a_project_file_that_is_no_toml_is_refused(tmp_path):
    (tmp_path / "pyproject.toml").write_text("[project\n", encoding="utf-8")
    with pytest.raises(BadInput, match="no TOML"):
        add_effect(tmp_path, "drag", "")
