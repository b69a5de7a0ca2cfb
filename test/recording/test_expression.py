"""Signals computed from several columns: arithmetic only, so that a foreign map can do no harm."""

from pathlib import Path

import numpy as np
import pytest

from ehls_ros.errors import BadInput
from ehls_ros.recording.columns import read_columns
from ehls_ros.recording.expression import MAX_LENGTH, expression
from ehls_ros.recording.load import load

A, B = np.array([3.0, -2.0]), np.array([1.0, 4.0])


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("pA - pB", A - B),
        ("(2.0e-3*pA - 1.2e-3*pB)/2.0e-3", (2.0e-3 * A - 1.2e-3 * B) / 2.0e-3),
        ("-`p A`**2 + +pB", -(A**2) + B),
        ("`p A` * 1e5", A * 1e5),
        (" pA / (pA - pA)", [np.inf, -np.inf]),
    ],
)
def test_arithmetic_of_columns(text: str, values: np.ndarray):
    found = expression(text).of({"pA": A, "p A": A, "pB": B})
    np.testing.assert_array_equal(found, values)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "1 + 2",
        "pA.__class__",
        "().__class__.__bases__[0].__subclasses__()",
        "__import__('os').system('true')",
        "abs(pA)",
        "pA[0]",
        "pA if pB else 1",
        "lambda: pA",
        "(pA := 1)",
        "pA @ pB",
        "pA < pB",
        "not pA",
        "'a' * pA",
        "pA + 1j",
        "pA; pB",
        "pA\n+ pB\n",
        "[pA for pB in pA]",
        "f'{pA}'",
        "(" * 150 + "pA" + ")" * 150 + "(",
        "pA" + "+1" * MAX_LENGTH,
        "pA + 1e999",
        "pA \x00",
        "`pA",
    ],
)
def test_anything_else_is_refused(text: str):
    with pytest.raises(ValueError, match=r"^it "):
        expression(text)


def test_a_large_power_of_numbers_costs_nothing():
    assert not np.isfinite(expression("pA * 9**9**9**9").of({"pA": A})).any()


DATA = "time_s,pA [bar],pB [bar],I [mA]\n0,30,10,4\n1,20,25,20\n"


def mapped(folder: Path, text: str):
    (folder / "data.csv").write_text(DATA)
    (folder / "map.yaml").write_text(text)
    return load(folder / "data.csv", read_columns(folder / "map.yaml"))


def test_a_map_derives_a_signal_in_its_unit(tmp_path: Path):
    found = mapped(tmp_path, 'load_pressure_pa: {expression: "`pA [bar]` - 0.5*`pB [bar]`", unit: bar}')
    assert found["load_pressure_pa"].tolist() == [25e5, 7.5e5]


def test_two_values_of_a_current_and_what_they_mean(tmp_path: Path):
    found = mapped(tmp_path, 'valve_command_m: {name: "I [mA]", unit: mA, range: [4, 20], means: [-1.0e-3, 1.0e-3]}')
    assert found["valve_command_m"] == pytest.approx([-1.0e-3, 1.0e-3])


@pytest.mark.parametrize(
    ("entry", "complaint"),
    [
        ('{expression: "pA.real"}', "expression is 'pA.real': it is more than columns, numbers"),
        ('{name: a, expression: "pA"}', "both name and expression are given"),
        ("{unit: bar}", "key 'name' is missing"),
        ("{name: a, rate: 100}", "rate is 100; expected a positive rate in Hz, only for time_s"),
        ("{name: a, range: [4, 4], means: [0, 1]}", r"range is \[4.0, 4.0\]; expected two different numbers in both"),
        ("{name: a, range: [4, 20]}", r"means is \[\]; expected two different numbers in both"),
        ("{name: a, range: [4, 20], means: [0, 1], scale: 2}", "scale is given beside a range"),
        ('{expression: "pC - pA"}', r"column 'pC' for load_pressure_pa is missing \(found: time_s, pA \[bar\]"),
    ],
)
def test_an_entry_that_says_too_little_or_too_much(tmp_path: Path, entry: str, complaint: str):
    with pytest.raises(BadInput, match=complaint):
        mapped(tmp_path, f"load_pressure_pa: {entry}")
