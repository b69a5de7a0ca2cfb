import math
import random
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest
from recorded_runs import make_trajectory

from ehls_ros.errors import BadInput
from ehls_ros.recording import csv_file
from ehls_ros.recording.columns import Column, ColumnMap, Columns
from ehls_ros.recording.csv_file import ROWS_WRITTEN, write_csv
from ehls_ros.recording.load import load
from ehls_ros.trajectory import SIGNALS, Trajectory

MUTATIONS = 300


def csv(path: Path, text: str) -> Path:
    file = path / "data.csv"
    file.write_bytes(text.encode())
    return file


def read_csv(path: Path, columns: Columns = MappingProxyType({})) -> Trajectory:
    return load(path, ColumnMap(columns))


@pytest.mark.parametrize("samples", [1, 2, 100, ROWS_WRITTEN + 1])
def test_a_trajectory_comes_back_to_the_last_bit(tmp_path: Path, samples: int):
    whole = make_trajectory(samples)
    names = list(SIGNALS) if samples < ROWS_WRITTEN else ["force_n"]
    trajectory = Trajectory(whole.time_s, {name: whole[name] for name in names})
    write_csv(tmp_path / "data.csv", trajectory)
    back = read_csv(tmp_path / "data.csv")
    assert {name: back[name].tobytes() for name in names} == {name: whole[name].tobytes() for name in names}
    assert back.time_s.tobytes() == whole.time_s.tobytes()
    assert set(back.signals) == set(names)


def test_extreme_values_come_back(tmp_path: Path):
    bound_n = np.array([0.0, -0.0, np.inf, -np.inf, 5e-324, 1.7976931348623157e308, np.nan, 0.1 + 0.2])
    write_csv(tmp_path / "data.csv", Trajectory(np.arange(8) / 3, {"force_bound_n": bound_n}))
    back = read_csv(tmp_path / "data.csv")
    assert back["force_bound_n"].tobytes() == bound_n.tobytes()
    assert back.time_s.tobytes() == (np.arange(8) / 3).tobytes()


def test_the_header_holds_the_names_of_the_contract(tmp_path: Path):
    signals = {"force_n": np.array([1.5]), "friction_elements_n": np.array([[0.1, -0.2]])}
    write_csv(tmp_path / "data.csv", Trajectory(np.array([0.0]), signals))
    text = (tmp_path / "data.csv").read_text(encoding="utf-8")
    assert text == "time_s,force_n,friction_elements_n_1,friction_elements_n_2\n0.0,1.5,0.1,-0.2\n"


@pytest.mark.parametrize(
    "text",
    [
        "time_s,force_n,position_m\n0,1,2\n0.5,3,4\n",
        "time_s;force_n;position_m\r\n0;1;2\r\n0.5;3;4\r\n",
        "time_s\tforce_n\tposition_m\n0\t1\t2\n0.5\t3\t4",
        "\ufefftime_s,force_n,position_m\n0,1,2\n0.5,3,4\n\n\n",
        ' time_s , "force_n",position_m\n 0 ,"1", 2\n5e-1,+3.0,4.\n',
        "position_m,operator,time_s,force_n\n2,run_1,0,1\n4,,.5,3\n",
    ],
    ids=["plain", "semicolons", "tabs", "byte order mark and empty end", "quotes and spaces", "other columns and order"],
)
def test_dialects_of_other_programs(tmp_path: Path, text: str):
    trajectory = read_csv(csv(tmp_path, text))
    assert trajectory.time_s.tolist() == [0.0, 0.5]
    assert {name: trajectory[name].tolist() for name in trajectory.signals} == {
        "force_n": [1.0, 3.0],
        "position_m": [2.0, 4.0],
    }


def test_an_empty_cell_is_nan(tmp_path: Path):
    trajectory = read_csv(csv(tmp_path, "time_s,force_n,position_m\n0,,2\n1,3, \n2,nan,NaN\n"))
    np.testing.assert_array_equal(trajectory["force_n"], [np.nan, 3, np.nan])
    np.testing.assert_array_equal(trajectory["position_m"], [2, np.nan, np.nan])


def test_the_columns_map_renames_and_scales(tmp_path: Path):
    # The layout of a positioning axis: time, reference, position, motor voltage.
    text = "t,qg,qm,vir\n0,10,20,-1.5\n1,11,21,2\n2,12,22,0\n"
    columns = {
        "time_s": Column("t", scale=1e-3),
        "position_m": Column("qm", scale=1e-3, offset=-0.5),
        "force_n": Column("vir", scale=35.15),
        "valve_command_m": Column("vir", scale=2.0),
    }
    trajectory = read_csv(csv(tmp_path, text), columns)
    assert trajectory.time_s.tolist() == [0.0, 0.001, 0.002]
    assert trajectory["position_m"].tolist() == [20 * 1e-3 - 0.5, 21 * 1e-3 - 0.5, 22 * 1e-3 - 0.5]
    assert trajectory["force_n"].tolist() == [-1.5 * 35.15, 2 * 35.15, 0.0]
    assert trajectory["valve_command_m"].tolist() == [-3.0, 4.0, 0.0]
    assert len(trajectory.signals) == 3


def test_a_mapped_column_takes_precedence_over_one_with_the_contract_name(tmp_path: Path):
    file = csv(tmp_path, "time_s,force_n,cell_kn,spool_m\n0,1,2,3\n")
    trajectory = read_csv(file, {"force_n": Column("cell_kn", scale=1000.0)})
    assert {name: trajectory[name].tolist() for name in trajectory.signals} == {"force_n": [2000.0], "spool_m": [3.0]}


def test_columns_of_the_friction_elements_become_one_signal(tmp_path: Path):
    file = csv(tmp_path, "time_s,friction_elements_n_2,f1\n0,2,1\n1,4,3\n")
    trajectory = read_csv(file, {"friction_elements_n_1": Column("f1")})
    assert trajectory["friction_elements_n"].tolist() == [[1, 2], [3, 4]]


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", ": column time_s is missing (found: none); expected a column time_s, or a map of columns (ehls columns "),
        ("t,force_n\n0,1\n", ": column time_s is missing (found: t, force_n); expected a column time_s, or a map"),
        ("0.0,1.0\n0.1,1.0\n", ": column time_s is missing (found: column 1, column 2); expected"),
        (
            "time_s,f\n0,1\n",
            ": no signal is among the columns time_s, f; expected a signal by its name in the data contract, or",
        ),
        ("time_s,force_n\n", ": there is no sample; expected at least one sample"),
        ("time_s,force_n,force_n\n0,1,1\n", ": column 'force_n' occurs more than once; expected one column"),
        ("time_s,force_n\n0,1\n1,abc\n", ", line 3: column 'force_n' is 'abc'; expected a number"),
        ("time_s,force_n\n0,1_000\n", ", line 2: column 'force_n' is '1_000'; expected a number with a decimal point"),
        ("time_s;force_n\n0,1;1.5\n0,2;2,5\n", ", line 2: column 'force_n' is '1.5'; expected a number with a decimal comma"),
        ("time_s;force_n\n0,1;1,5\n0,2;1.002,5\n", ", line 3: column 'force_n' is '1.002,5'; expected a number with"),
        ("time_s,force_n\n0,0,1,5\n", ", line 2: the row has 4 cells; expected 2, as in the header"),
        ("time_s,force_n\n0,1\n1\n", ", line 3: the row has 1 cells; expected 2, as in the header"),
        ("time_s,force_n\n0,1\n\n1,2\n", ", line 3: the row has 0 cells; expected 2, as in the header"),
        ("time_s,force_n\n0,1\n,2\n", ", line 3: time_s is nan; expected a finite time"),
        ("time_s,force_n\n0,1\ninf,2\n", ", line 3: time_s is inf; expected a finite time"),
        ("time_s,force_n\n0,1\n1,inf\n", ", line 3: force_n is inf; expected a finite number, or an empty cell"),
        ("time_s,spool_m\n0,1e999\n1,0\n", ", line 2: "),  # infinite to pandas from 3.1 on, before that no number
        ("time_s,position_m\n0,1\n1,-Infinity\n", ", line 3: position_m is -inf; expected a finite number"),
        ("time_s,force_n\n0,1\n2,2\n1,3\n", ", line 4: time_s is 1.0 after 2.0; expected a time that increases with every row"),
        (
            "time_s,force_n\n0,1\n0,2\n1,3\n1,4\n0.5,5\n",
            ", line 6: time_s is 0.5 after 1.0; 2 rows repeat the time before, 1 go back; expected a time that increases",
        ),
        ('time_s,force_n\n0,"1\n', ", line 2: the row has 1 cells; expected 2, as in the header"),
        ("time_s,friction_elements_n_1,friction_elements_n_3\n0,1,2\n", ": friction_elements_n has columns 1, 3; expected"),
        ("time_s,friction_elements_n,friction_elements_n_1\n0,1,2\n", ": friction_elements_n has columns 1; expected"),
    ],
)
def test_an_error_names_its_place(tmp_path: Path, text: str, complaint: str):
    file = csv(tmp_path, text)
    with pytest.raises(BadInput) as caught:
        read_csv(file)
    assert str(caught.value).startswith(f"{file}{complaint}")
    assert "\n" not in str(caught.value)


def test_a_mapped_column_that_is_missing_is_named(tmp_path: Path):
    with pytest.raises(BadInput, match=r"'qm' for position_m is missing \(found: time_s, qmm\); .*; did you mean 'qmm'\?"):
        read_csv(csv(tmp_path, "time_s,qmm\n0,1\n"), {"position_m": Column("qm")})


@pytest.mark.parametrize("name", ["", "nothing.csv"])
def test_a_file_that_cannot_be_read_or_made_is_bad_input(tmp_path: Path, name: str):
    with pytest.raises(BadInput, match="the file cannot be read"):
        csv_file.read_csv(tmp_path / name)
    with pytest.raises(BadInput, match="the output cannot be created"):
        write_csv(tmp_path / name / "nowhere" / "data.csv", make_trajectory(1))


def understood(text: str) -> dict[str, list[float]] | None:
    """Return the columns of a purely numeric file, parsed the slow way; None for any other file."""
    lines = text.removesuffix("\n").split("\n")
    header = lines[0].split(",")
    columns: dict[str, list[float]] = {name: [] for name in header}
    for line in lines[1:]:
        cells = line.split(",")
        if len(cells) != len(header) or len(columns) != len(header):
            return None
        for name, cell in zip(header, cells, strict=True):
            try:
                columns[name].append(float(cell) if cell else math.nan)
            except ValueError:
                return None
    return columns


def test_a_damaged_file_is_refused_or_read_literally(tmp_path: Path):
    dice = random.Random(5)
    whole = "time_s,force_n,position_m\n" + "".join(f"{k / 1000},{dice.gauss(0, 1):.6g},{k * k}\n" for k in range(30))
    refused = 0
    for _ in range(MUTATIONS):
        text = bytearray(whole.encode())
        position = dice.randrange(len(text))
        match dice.randrange(4):
            case 0:
                del text[position:]
            case 1:
                del text[position : position + dice.choice([1, 5, 50])]
            case 2:
                text[position] = dice.choice(b',;.-e_"\n\r \x00\xff9')
            case _:
                text[position:position] = dice.choice([b",", b"\n", b'"', b"1", b"abc", bytes([dice.randrange(256)])])
        (tmp_path / "data.csv").write_bytes(text)
        try:
            trajectory = read_csv(tmp_path / "data.csv")
        except BadInput:
            refused += 1
            continue
        expected = understood(text.decode(errors="replace"))
        if expected is not None:
            np.testing.assert_array_equal(trajectory.time_s, expected.pop("time_s"))
            for name in trajectory.signals:
                np.testing.assert_array_equal(trajectory[name], expected[name])
        assert (np.diff(trajectory.time_s) > 0).all()
    assert 0.3 * MUTATIONS < refused < 0.9 * MUTATIONS
