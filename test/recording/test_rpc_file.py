"""RPC III time histories, written here by their description, and their headers made wrong."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ehls_ros.cli.main import main
from ehls_ros.errors import BadInput
from ehls_ros.recording.columns import Column, ColumnMap
from ehls_ros.recording.load import load
from ehls_ros.recording.rpc_file import read_rpc

SCALES = (0.25, 2.0, 1.0)
RATE = 200.0


def signals(count: int) -> np.ndarray:
    """Return values of three channels in their units, all of which 16 bits hold exactly."""
    k = np.arange(count)
    return np.array([0.25 * (k % 997 - 400), 2.0 * (k * k % 501), -1.0 * (k % 32000)])


def written(path: Path, values: np.ndarray, *, filled: bool = True, order: str = "<", **changes: Any) -> Path:
    """Write a time history in the order of the format's description: groups of channels of frames.

    Args:
        path: folder.
        values: in the units of the channels, shape (channels, points), with what half frames hold.
        filled: whether the last group is filled with zeros.
        order: byte order of numpy.
        changes: keywords that differ; None leaves one out.
    """
    frame, group = max(changes.get("PTS_PER_FRAME", 256), 1), max(changes.get("PTS_PER_GROUP", 1024), 1)
    kind = {"FLOATING_POINT": "f4", "DOUBLE_PRECISION": "f8"}.get(changes.get("DATA_TYPE"), "i2")
    frames = -(-values.shape[1] // frame)
    header = {
        "FILE_TYPE": "TIME_HISTORY",
        "TIME_TYPE": "RESPONSE",
        "DATA_TYPE": "SHORT_INTEGER",
        "DELTA_T": f"{1.0 / RATE:.6E}",
        "PTS_PER_FRAME": frame,
        "PTS_PER_GROUP": group,
        "CHANNELS": len(values),
        "FRAMES": frames,
        "HALF_FRAMES": 0,
        "INT_FULL_SCALE": 32752,
        "DATE": "04-May-2026 12:00:00",
    }
    for k in range(len(values)):
        described = {"DESC": ('"Weg"', "Kraft", "Kraft")[k], "UNITS": ("mm", "kN", "NONE")[k], "SCALE": f"{SCALES[k]:.6E}"}
        header |= {f"{key}.CHAN_{k + 1}": value for key, value in described.items()}
    header = {key: value for key, value in (header | changes).items() if value is not None}
    blocks = -(-(len(header) + 3) // 4)
    first = {"FORMAT": header.pop("FORMAT", "BINARY"), "NUM_HEADER_BLOCKS": blocks, "NUM_PARAMS": len(header) + 3}
    first |= {key: header.pop(key) for key in ("NUM_HEADER_BLOCKS", "NUM_PARAMS") if key in header}
    text = b"".join(key.encode().ljust(32, b"\0") + str(v).encode().ljust(96, b"\0") for key, v in (first | header).items())
    raw = values / np.array(SCALES[: len(values)])[:, None] if kind == "i2" else values
    raw = np.pad(raw, ((0, 0), (0, frames * frame - raw.shape[1]))).astype(order + kind)
    content = text.ljust(512 * blocks, b"\0")
    for begin in range(0, raw.shape[1], group):
        part = raw[:, begin : begin + group]
        content += np.pad(part, ((0, 0), (0, (group - part.shape[1]) * filled))).astype(raw.dtype).tobytes()
    (path / "a.rsp").write_bytes(content)
    return path / "a.rsp"


@pytest.mark.parametrize(
    "more",
    [
        {},
        {"filled": False},
        {"order": ">", "FORMAT": "BINARY_IEEE_BIG_END"},
        {"FORMAT": "BINARY_IEEE_LITTLE_END", "DATA_TYPE": None},
        {"DATA_TYPE": "FLOATING_POINT"},
        {"DATA_TYPE": "DOUBLE_PRECISION"},
        {"PTS_PER_FRAME": 512, "PTS_PER_GROUP": 512},
        {"PTS_PER_FRAME": 256, "PTS_PER_GROUP": 4096},
    ],
)
def test_values_are_those_written_whatever_the_groups(tmp_path: Path, more: Mapping[str, Any]):
    expected = signals(2560)
    table = read_rpc(written(tmp_path, expected, **more))
    assert table.names == ("Weg", "Kraft (channel 2)", "Kraft (channel 3)", "time")
    for name, values in zip(table.names, expected, strict=False):
        np.testing.assert_array_equal(table.values[name], values)
    np.testing.assert_allclose(table.values["time"], np.arange(2560) / RATE)
    assert table.units == {"Weg": "mm", "Kraft (channel 2)": "kN", "time": "s"}
    assert table.remarks == ("time is counted from DELTA_T of 0.005 s",)


def test_a_map_needs_no_time(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    path = written(tmp_path, signals(1024)).rename(tmp_path / "a.DRV")
    assert main(["columns", str(path)]) == 0
    assert 'position_m: {name: "Weg", unit: "mm"}' in capsys.readouterr().out
    read = load(path, ColumnMap({"position_m": Column("Weg", unit="mm")}))
    np.testing.assert_allclose(read["position_m"], 1e-3 * signals(1024)[0])
    assert read.time_s[-1] == pytest.approx(1023 / RATE)


@pytest.mark.parametrize("counted", [False, True])
def test_half_frames_contain_no_data(tmp_path: Path, counted: bool):
    padded = np.pad(signals(1024), ((0, 0), (128, 128)), mode="edge")
    table = read_rpc(written(tmp_path, padded, filled=not counted, HALF_FRAMES=1, FRAMES=5 if counted else 4))
    np.testing.assert_array_equal(table.values["Weg"], signals(1024)[0])
    assert table.values["time"][0] == 0.0
    assert table.remarks[1:] == ("the first and last 128 values are half frames, which contain no data, and are left out",)


@pytest.mark.parametrize("mode", ["constant", "edge"])
def test_what_fills_the_last_group_is_left_out_whichever_channel_is_read(tmp_path: Path, mode: Any):
    path = written(tmp_path, np.pad(signals(1500), ((0, 0), (0, 36)), mode=mode))
    for pick in (None, lambda names, time_of=None: ["Weg", "time"]):
        table = read_rpc(path, pick)
        assert len(table.values["Weg"]) == len(table.values["time"]) == 1500
        assert table.remarks[1:] == (
            "the last 36 values of each channel are constant, as they fill the last group, and are left out",
        )


def test_a_number_of_samples_in_the_header_is_used(tmp_path: Path):
    table = read_rpc(written(tmp_path, signals(1500), SAMPLES=1400))
    assert len(table.values["Weg"]) == 1400


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"CHANNELS": 100}, "its header states "),
        ({"CHANNELS": 4_000_000_000}, "CHANNELS is 4000000000; expected an integer from 1 to 1024"),
        ({"FRAMES": 10**15}, "FRAMES is 1000000000000000; expected an integer from 1 to"),
        ({"FRAMES": 4000}, "its header states 6144000 bytes of data (3 channels, 1024000 points of 2 bytes), and 6144 follow"),
        ({"PTS_PER_FRAME": 0}, "PTS_PER_FRAME is 0"),
        ({"PTS_PER_GROUP": 0}, "PTS_PER_GROUP is 0"),
        ({"PTS_PER_GROUP": -1024}, "PTS_PER_GROUP is -1024"),
        ({"FRAMES": "many"}, "FRAMES is 'many'; expected a number"),
        ({"FRAMES": None}, "FRAMES is missing in its header"),
        ({"DELTA_T": 0.0}, "DELTA_T is 0; expected the sampling period, in s"),
        ({"DELTA_T": "nan"}, "DELTA_T is 'nan'; expected a number"),
        ({"SCALE.CHAN_2": "x"}, "SCALE.CHAN_2 is 'x'; expected a number"),
        ({"NUM_HEADER_BLOCKS": 4000}, "its header has 4000 blocks of 512 bytes, and the file has "),
        ({"NUM_HEADER_BLOCKS": 10**9}, "NUM_HEADER_BLOCKS is 1000000000; expected an integer from 1 to 4096"),
        ({"NUM_PARAMS": 10**9}, "NUM_PARAMS is 1000000000"),
        ({"FORMAT": "ASCII"}, "FORMAT is ASCII; expected BINARY or BINARY_IEEE_LITTLE_END or BINARY_IEEE_BIG_END"),
        ({"FILE_TYPE": "FATIGUE"}, "FILE_TYPE is FATIGUE; expected TIME_HISTORY"),
        ({"DATA_TYPE": "LONG_INTEGER"}, "DATA_TYPE is LONG_INTEGER; expected SHORT_INTEGER or FLOATING_POINT or"),
    ],
)
def test_a_wrong_header_is_bad_input_before_anything_is_read(tmp_path: Path, changes: dict[str, Any], complaint: str):
    path = written(tmp_path, signals(1024), **changes)
    with pytest.raises(BadInput) as caught:
        read_rpc(path)
    assert f"{path}: {complaint}" in str(caught.value)


@pytest.mark.parametrize("length", [0, 100, 300, 1000, 5000, -600])
def test_a_truncated_file_is_bad_input(tmp_path: Path, length: int):
    path = written(tmp_path, signals(1024))
    path.write_bytes(path.read_bytes()[:length])
    with pytest.raises(BadInput, match=r"it does not begin with FORMAT|, and (the file has )?\d+ (bytes|follow)"):
        load(path, ColumnMap({"position_m": Column("Weg", unit="mm")}))
