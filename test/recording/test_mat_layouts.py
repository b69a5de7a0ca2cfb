"""MATLAB files as other programs save them: matrices, structures with time, recordings, results of simulations, objects."""

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy

from ehls_ros.cli.main import main
from ehls_ros.errors import BadInput
from ehls_ros.recording.columns import Column, ColumnMap
from ehls_ros.recording.load import READERS, load
from ehls_ros.recording.mat_file import read_here
from ehls_ros.recording.proposal import look

T = np.arange(50) / 100.0
SLOW = 0.1 + np.arange(10) / 25.0


@pytest.fixture(autouse=True)
def in_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Read in this process, which takes less time."""
    monkeypatch.setitem(READERS, ".mat", read_here)


def saved(path: Path, **variables: Any) -> Path:
    scipy.io.savemat(path / "a.mat", variables, oned_as="column")
    return path / "a.mat"


def structures(*elements: dict[str, Any]) -> Any:
    """Return a structure array."""
    array = np.empty((1, len(elements)), dtype=[(name, "O") for name in elements[0]])
    for k, element in enumerate(elements):
        array[0, k] = tuple(element.values())
    return array


# --- matrices ----------------------------------------------------------------------------------


@pytest.mark.parametrize("turned", [False, True])
def test_the_columns_of_a_matrix_go_by_number_and_its_shape_is_said(tmp_path: Path, turned: bool):
    matrix = np.column_stack([T, 2.0 * T, 3.0 * T])
    path = saved(tmp_path, data=matrix.T if turned else matrix)
    [table] = look(path)
    assert [column.header.column for column in table.columns] == ["data 1", "data 2", "data 3"]
    shape = "3 x 50" if turned else "50 x 3"
    assert table.remarks == (f"data is {shape}: data 1 to data 3 are its columns of 50 values",)
    read = load(path, ColumnMap({"time_s": Column("data 1"), "force_n": Column("data 3")}))
    np.testing.assert_array_equal(read["force_n"], 3.0 * T)
    assert read.preparation.remarks == table.remarks
    with pytest.raises(BadInput, match=r"column 'data' for force_n is missing \(found: data 1, data 2, data 3\)"):
        load(path, ColumnMap({"time_s": Column("data 1"), "force_n": Column("data")}))


def test_an_array_that_is_no_table_is_named_with_its_shape(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    path = saved(tmp_path, cube=np.zeros((2, 3, 4)), picture=np.zeros((1001, 1002)), name="a run", z=np.array([1j, 2.0]))
    assert main(["columns", str(path)]) == 2
    said = capsys.readouterr().err
    for reason in ("cube: its shape is 2 x 3 x 4", "picture: its shape is 1001 x 1002", "name: text", "z: complex numbers"):
        assert reason in said
    with pytest.raises(BadInput, match=r"column 'cube' for force_n is not numeric \(its shape is 2 x 3 x 4\)"):
        load(path, ColumnMap({"time_s": Column(rate=1.0), "force_n": Column("cube")}))


def test_a_matrix_of_7_3_is_turned_as_matlab_shows_it(tmp_path: Path):
    h5py = pytest.importorskip("h5py")
    path = tmp_path / "a.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        file["data"] = np.column_stack([T, 2.0 * T]).T
        sparse = file.create_group("sparse")
        sparse.attrs["MATLAB_sparse"], sparse["data"] = 5, T
    as_7_3(path)
    read = load(path, ColumnMap({"time_s": Column("data 1"), "force_n": Column("data 2")}))
    np.testing.assert_array_equal(read["force_n"], 2.0 * T)
    assert read.preparation.remarks == ("data is 50 x 2: data 1 to data 2 are its columns of 50 values",)
    assert read_here(path, None).wrong == {"sparse": "a sparse matrix: save full(...) of it"}


def as_7_3(path: Path) -> None:
    with path.open("r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")


# --- Simulink ----------------------------------------------------------------------------------


def test_a_structure_with_time_has_names_and_times(tmp_path: Path):
    """Laid out as Simulink's To Workspace block and its scopes save "structure with time"."""
    fast = structures({"values": 2.0 * T, "label": "Weg [m]"}, {"values": np.column_stack([T, -T]), "label": ""})
    slow = structures({"values": np.reshape(5.0 * SLOW, (1, 1, -1)), "label": "Kraft [N]"})
    path = saved(
        tmp_path, simout={"time": T, "signals": fast, "blockName": "m/S"}, ScopeData={"time": SLOW, "signals": slow}, tout=T
    )
    table = read_here(path, None)
    assert table.names == (
        *("simout.time", "Weg [m]", "simout.signals(2).values 1", "simout.signals(2).values 2"),
        *("ScopeData.time", "Kraft [N]", "tout"),
    )
    assert table.time_of == {**dict.fromkeys(table.names[1:4], "simout.time"), "Kraft [N]": "ScopeData.time"}
    joined = load(path, ColumnMap({"position_m": Column("Weg [m]"), "force_n": Column("Kraft [N]")}))
    np.testing.assert_allclose(joined["position_m"], 2.0 * joined.time_s)
    np.testing.assert_allclose(joined["force_n"], 5.0 * joined.time_s)
    assert look(path)[0].axes[1] == "ScopeData.time: 10 rows, 25 Hz, 0.1 to 0.46 s (Kraft [N])"


def test_few_samples_of_many_signals_are_still_rows(tmp_path: Path):
    signals = structures({"values": np.arange(12.0).reshape(3, 4), "label": "x"})
    table = read_here(saved(tmp_path, simout={"time": [0.0, 1.0, 2.0], "signals": signals}), None)
    assert table.values["x 4"].tolist() == [3.0, 7.0, 11.0]


def test_paths_of_a_structure_with_time_serve_older_maps(tmp_path: Path):
    signals = structures({"values": 2.0 * T, "label": "Weg"})
    path = saved(tmp_path, simout={"time": T, "signals": signals}, force=3.0 * T)
    given = {"time_s": Column("simout.time"), "position_m": Column("simout.signals.values"), "force_n": Column("force")}
    read = load(path, ColumnMap(given))
    np.testing.assert_allclose(read["position_m"], 2.0 * T)
    np.testing.assert_allclose(read["force_n"], 3.0 * T)


def test_structures_with_times_of_their_own_are_several_axes(tmp_path: Path):
    path = saved(tmp_path, fast={"t": T, "x": 2.0 * T, "gain": 3.0}, slow={"Zeit_ms": 1e3 * SLOW, "F": 5.0 * SLOW})
    table = read_here(path, None)
    assert table.time_of == {"fast.x": "fast.t", "slow.F": "slow.Zeit_ms"}
    assert table.remarks == (
        "fast.t: taken as times in s; time_s in the map, with the name of one and its unit, states another",
    )
    joined = load(path, ColumnMap({"position_m": Column("fast.x"), "force_n": Column("slow.F")}))
    np.testing.assert_allclose(joined["position_m"], 2.0 * joined.time_s)
    np.testing.assert_allclose(joined["force_n"], 5.0 * joined.time_s)


# --- ControlDesk -------------------------------------------------------------------------------


@pytest.mark.parametrize("by", ["Raster", "XIndex"])
def test_a_recording_of_controldesk_has_names_units_and_rasters(tmp_path: Path, by: str):
    """Laid out as dSPACE ControlDesk exports recordings of one or several rasters."""
    x = structures({"Name": "", "Data": T, "Raster": "1ms"}, {"Name": "", "Data": SLOW, "Raster": "slow"})

    def signal(name: str, place: str, data: Any, raster: int, unit: str) -> dict[str, Any]:
        of = {"Raster": ("1ms", "slow")[raster]} if by == "Raster" else {"XIndex": float(raster + 1)}
        return {"Name": name, "Path": place, "Data": data, "Unit": unit, **of}

    y = structures(
        signal("Weg", "Model Root/A", 2e3 * T, 0, "mm"),
        signal("Out1", "Model Root/B", 5.0 * SLOW, 1, "N"),
        signal("Out1", "Model Root/C", 7.0 * T, 0, ""),
    )
    path = saved(tmp_path, rec1={"X": x, "Y": y, "Description": "a run", "Capture": {"Version": 2.0}})
    table = read_here(path, None)
    assert table.names == ("rec1.X(1).Data", "rec1.X(2).Data", "Weg", "Model Root/B/Out1", "Model Root/C/Out1")
    assert table.units["Weg"] == "mm"
    joined = load(path, ColumnMap({"position_m": Column("Weg", unit="mm"), "force_n": Column("Model Root/B/Out1")}))
    np.testing.assert_allclose(joined["position_m"], 2.0 * joined.time_s)
    np.testing.assert_allclose(joined["force_n"], 5.0 * joined.time_s)


def test_a_structure_array_of_7_3_is_followed(tmp_path: Path):
    h5py = pytest.importorskip("h5py")
    path = tmp_path / "a.mat"
    with h5py.File(path, "w", userblock_size=512) as file:

        def references(*values: Any) -> np.ndarray:
            made = []
            for value in values:
                text = isinstance(value, str)
                data = np.array([[ord(letter)] for letter in value], dtype=np.uint16) if text else np.atleast_2d(value)
                place = file.create_dataset(f"#refs#/{len(file.require_group('#refs#'))}", data=data)
                place.attrs["MATLAB_class"] = np.bytes_("char" if text else "double")
                made.append([place.ref])
            return np.array(made, dtype=h5py.ref_dtype)

        rec, x = file.create_group("rec"), file.create_group("rec/X")
        x["Data"] = np.atleast_2d(T)
        y = rec.create_group("Y")
        y["Name"], y["Data"] = references("Weg [m]", "Kraft [N]"), references(2.0 * T, 5.0 * T)
    as_7_3(path)
    read = load(path, ColumnMap({"position_m": Column("Weg [m]"), "force_n": Column("Kraft [N]")}))
    np.testing.assert_allclose(read["force_n"], 5.0 * read.time_s)


# --- Modelica ----------------------------------------------------------------------------------


def characters(lines: list[str], transposed: bool) -> np.ndarray:
    width = max(map(len, lines))
    letters = np.array([list(line.ljust(width)) for line in lines])
    return np.array(["".join(row) for row in (letters.T if transposed else letters)])


@pytest.mark.parametrize("transposed", [False, True])
def test_a_result_of_a_modelica_tool_has_names_signs_and_units(tmp_path: Path, transposed: bool):
    """Laid out as Dymola writes results, and in the transposed form, which OpenModelica has as well."""
    data = np.column_stack([[0.0, 0.1, 0.1, 0.2], [0.0, 1.0, 5.0, 6.0]])
    info = np.array([[0, 1, 0, -1], [2, 2, 0, -1], [2, -2, 0, -1], [1, 2, 0, 0]])
    names, texts = ["Time", "body.x", "body.minus_x", "body.m"], ["Time in [s]", "Position [mm|m]", "", "Mass [kg]"]
    scipy.io.savemat(
        tmp_path / "a.mat",
        {
            "Aclass": characters(["Atrajectory", "1.1", "", "binTrans" if transposed else "binNormal"], transposed=False),
            "name": characters(names, transposed),
            "description": characters(texts, transposed),
            "dataInfo": info.T if transposed else info,
            "data_1": np.ones((2, 2)),
            "data_2": data.T if transposed else data,
        },
        format="4",
    )
    path = tmp_path / "a.mat"
    table = read_here(path, None)
    assert table.names == ("Time", "body.x", "body.minus_x")
    assert table.units == {"Time": "s", "body.x": "mm"}
    assert table.remarks == (
        "1 rows before events, which repeat a time, are left out",
        "1 parameters and constants are left out",
    )
    read = load(path, ColumnMap({"position_m": Column("body.minus_x")}))
    assert (read.time_s.tolist(), read["position_m"].tolist()) == ([0.0, 0.1, 0.2], [0.0, -5.0, -6.0])


def test_a_modelica_file_of_another_kind_is_bad_input(tmp_path: Path):
    kind = characters(["AlinearSystem", "1.0", "", "binNormal"], transposed=False)
    scipy.io.savemat(tmp_path / "a.mat", {"Aclass": kind, "ABCD": np.eye(3)}, format="4")
    with pytest.raises(BadInput, match="it is a Modelica file of kind 'AlinearSystem'; expected the result of a simulation"):
        load(tmp_path / "a.mat")


# --- objects -----------------------------------------------------------------------------------


def element(kind: int, content: bytes) -> bytes:
    return struct.pack("<II", kind, len(content)) + content + b"\0" * (-len(content) % 8)


def matlab_object(name: str, of_class: str) -> bytes:
    """Return an object as the saved element of a class that MATLAB does not document."""
    numbers = element(6, struct.pack("<II", 13, 0)) + element(5, struct.pack("<ii", 6, 1)) + element(1, b"")
    numbers += element(6, struct.pack("<6I", 3_707_764_736, 2, 1, 1, 1, 1))
    texts = [element(1, text.encode()) for text in (name, "MCOS", of_class)]
    return element(14, element(6, struct.pack("<II", 17, 0)) + b"".join(texts) + element(14, numbers))


@pytest.fixture
def objects(tmp_path: Path) -> Path:
    path = saved(tmp_path, x=T)
    with path.open("ab") as stream:
        stream.write(matlab_object("ts", "timeseries") + matlab_object("when", "datetime"))
    return path


def test_an_object_is_not_numbers_and_its_export_is_named(objects: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["columns", str(objects)]) == 0
    shown = capsys.readouterr().out
    assert '# "ts" is not a column of numbers: a MATLAB object (timeseries): ts.Time and ts.Data, saved as arrays' in shown
    assert '# "when" is not a column of numbers: a MATLAB object (datetime): posixtime(when), saved as arrays' in shown
    given = ColumnMap({"time_s": Column(rate=100.0), "force_n": Column("ts")})
    with pytest.raises(BadInput, match=r"column 'ts' for force_n is not numeric \(a MATLAB object \(timeseries\): ts.Time"):
        load(objects, given)


@pytest.mark.parametrize("newest", [False, True])
def test_a_file_of_objects_is_bad_input(tmp_path: Path, newest: bool):
    path = tmp_path / "a.mat"
    if newest:
        h5py = pytest.importorskip("h5py")
        with h5py.File(path, "w", userblock_size=512) as file:
            file["ts"] = np.array([[3_707_764_736, 2, 1, 1, 1, 1]], dtype=np.uint32)
            file["ts"].attrs["MATLAB_class"], file["ts"].attrs["MATLAB_object_decode"] = np.bytes_("timeseries"), np.int32(3)
        as_7_3(path)
    else:
        scipy.io.savemat(path, {})
        with path.open("ab") as stream:
            stream.write(matlab_object("ts", "timeseries"))
    said = r"its variables are MATLAB objects \(ts: timeseries\); expected arrays, such as ts.Time and ts.Data, saved as arrays"
    for given in (None, ColumnMap({"force_n": Column("ts")})):
        with pytest.raises(BadInput, match=said):
            load(path, given)
    with pytest.raises(BadInput, match=said):
        look(path)


@pytest.mark.parametrize("begin", [b"# Created by Octave 8.4.0, Mon May 04 12:00:00 2026 UTC\n", b"Octave-1-L\0\1\0\0\0x"])
def test_a_format_of_octave_is_named(tmp_path: Path, begin: bytes):
    (tmp_path / "a.mat").write_bytes(begin.ljust(200, b" "))
    with pytest.raises(BadInput, match="it is in a format of Octave; expected a MAT file, as by `save -v7` in Octave"):
        load(tmp_path / "a.mat")
