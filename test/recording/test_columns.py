from pathlib import Path

import pytest

from ehls_ros.errors import BadInput
from ehls_ros.recording.columns import Column, read_columns


def test_a_map_is_read(tmp_path: Path):
    (tmp_path / "map.yaml").write_text(
        "time_s: {name: t}\nposition_m: {name: x mm, scale: 1e-3, offset: -1}\nfriction_slipping_12: {name: s}\n",
        encoding="utf-8",
    )
    assert read_columns(tmp_path / "map.yaml") == {
        "time_s": Column("t", 1.0, 0.0),
        "position_m": Column("x mm", 0.001, -1.0),
        "friction_slipping_12": Column("s"),
    }


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", ": it contains None; expected a mapping like 'position_m: {name: x, scale: 0.001, offset: 0.0}'"),
        ("- time_s", ": it contains ['time_s']; expected a mapping like"),
        ("time_s: [", ":2: map of columns is not valid YAML ("),
        ("position_m: {name: x}\nposition_m: {name: y}", ":2: map of columns is not valid YAML (duplicate key 'position_m')"),
        ("position_mm: {name: x}", ": name 'position_mm' is unknown; expected one of time_s, valve_command_m,"),
        ("friction_elements_n_0: {name: x}", ": name 'friction_elements_n_0' is unknown; expected one of"),
        ("force_n_1: {name: x}", ": name 'force_n_1' is unknown; expected one of"),
        ("position_m: x", ", position_m: it is 'x'; expected a mapping like"),
        ("position_m: {scale: 2}", ", position_m: key 'name' is missing; expected"),
        ("position_m: {name: x, unit: mm}", ", position_m: key 'unit' is unknown; expected one of name, scale, offset"),
        ("position_m: {name: x, scale: mm}", ", position_m: scale is 'mm'; expected a valid number"),
        ("position_m: {name: x, scale: .inf}", ", position_m: scale is inf; expected a finite number"),
        ("position_m: {name: x, scale: 0}", ", position_m: scale is 0; expected a factor other than 0"),
    ],
)
def test_an_error_names_its_place(tmp_path: Path, text: str, complaint: str):
    file = tmp_path / "map.yaml"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(BadInput) as caught:
        read_columns(file)
    assert str(caught.value).startswith(f"{file}{complaint}")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("content", [None, b"position_m: {name: \xff}"])
def test_a_map_that_cannot_be_read_is_bad_input(tmp_path: Path, content: bytes | None):
    if content is not None:
        (tmp_path / "map.yaml").write_bytes(content)
    with pytest.raises(BadInput, match=r"cannot be read|not text"):
        read_columns(tmp_path / "map.yaml")
