"""Bags of other recorders whose topics are named in a map of columns: each with a different rate, type and time stamps."""

from pathlib import Path

import numpy as np
import pytest
from recorded_runs import Message, record

from ehls_ros.errors import BadInput
from ehls_ros.recording.bag_reader import read_bag
from ehls_ros.recording.columns import Column, ColumnMap, Cylinder, read_columns
from ehls_ros.recording.load import load
from ehls_ros.recording.proposal import look, proposed_map
from ehls_ros.recording.typestore import typestore

TYPES = typestore().types
START_NS = 1_763_000_000_000_000_000


def stamped(t: float):
    seconds, nanoseconds = divmod(START_NS + round(t * 1e9), 10**9)
    return TYPES["std_msgs/msg/Header"](
        stamp=TYPES["builtin_interfaces/msg/Time"](sec=seconds, nanosec=nanoseconds), frame_id="cell"
    )


def received(t: float) -> int:
    return START_NS + round(t * 1e9)


def wrench(t: float, force: float, late: float = 0.0) -> Message:
    zero = TYPES["geometry_msgs/msg/Vector3"](x=0.0, y=0.0, z=0.0)
    content = TYPES["geometry_msgs/msg/Wrench"](force=TYPES["geometry_msgs/msg/Vector3"](x=0.0, y=0.0, z=force), torque=zero)
    fields = {"header": stamped(t), "wrench": content}
    return Message("/cell", "geometry_msgs/msg/WrenchStamped", received(t + late), fields)


def joints(t: float, position: float) -> Message:
    fields = {
        "header": stamped(t), "name": ["boom", "a longer name"], "position": np.array([9.0, position]),
        "velocity": np.zeros(0), "effort": np.zeros(0),
    }  # fmt: skip
    return Message("/joint_states", "sensor_msgs/msg/JointState", received(t), fields)


def number(topic: str, t: float, value: float) -> Message:
    return Message(topic, "std_msgs/msg/Float64", received(t), {"data": value})


def bag_of(folder: Path, storage: str = "mcap") -> Path:
    """Return a bag: a pressure of 1 kHz without stamps, stamped position of 100 Hz and force of 500 Hz, the force 5 ms late."""
    messages = [number("/pressure_bar", k / 1000, 10.0 * np.sin(k / 100)) for k in range(2000)]
    messages += [joints(k / 100, k / 100) for k in range(200)]
    messages += [wrench(k / 500, 3.0 * k / 500, late=0.005) for k in range(1000)]
    return record(folder / "theirs", messages, storage)


MAP = """
load_pressure_pa: {table: /pressure_bar, name: data, unit: bar}
position_m: {table: /joint_states, name: "position[1]", unit: mm}
force_n: {table: /cell, name: wrench.force.z, unit: kN}
"""


def mapped(folder: Path, text: str) -> ColumnMap:
    (folder / "map.yaml").write_text(text, encoding="utf-8")
    return read_columns(folder / "map.yaml")


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_topics_at_their_own_rates_come_to_one_clock(tmp_path: Path, storage: str):
    joined = load(bag_of(tmp_path, storage), mapped(tmp_path, MAP))
    t = joined.time_s
    assert 1.0 / np.median(np.diff(t)) == pytest.approx(1000.0)
    np.testing.assert_allclose(joined["load_pressure_pa"], 1e6 * np.sin(10.0 * t), atol=1.0)
    inside = t < 1.98
    np.testing.assert_allclose(joined["position_m"][inside], 1e-3 * t[inside], atol=1e-9)
    # By its stamps, although every message had 5 ms of latency.
    np.testing.assert_allclose(joined["force_n"][inside], 3e3 * t[inside], atol=1e-6)
    own = joined.preparation.interpolated
    assert {name: round(1.0 / of.period) for name, of in own.items()} == {"position_m": 100, "force_n": 500}


def test_the_time_of_receiving_and_a_shift_can_be_asked_for(tmp_path: Path):
    text = MAP + "tables:\n  /cell: {name: received}\n  /joint_states: {name: header.stamp, offset: -0.02}\n"
    joined = load(bag_of(tmp_path), mapped(tmp_path, text))
    inside = (joined.time_s > 0.01) & (joined.time_s < 1.95)
    t = joined.time_s[inside]
    np.testing.assert_allclose(joined["force_n"][inside], 3e3 * (t - 0.005), atol=1e-6)
    np.testing.assert_allclose(joined["position_m"][inside], 1e-3 * (t + 0.02), atol=1e-9)


def test_the_clock_may_be_any_topic(tmp_path: Path):
    joined = load(bag_of(tmp_path), mapped(tmp_path, f"{MAP}base: /joint_states\n"))
    assert 1.0 / np.median(np.diff(joined.time_s)) == pytest.approx(100.0)


def test_one_topic_alone_is_not_joined_and_is_converted(tmp_path: Path):
    def scan(k: int) -> Message:
        layout = TYPES["std_msgs/msg/MultiArrayLayout"](
            dim=[TYPES["std_msgs/msg/MultiArrayDimension"](label="channel", size=2, stride=2)], data_offset=0
        )
        content = {"layout": layout, "data": np.array([50.0 + k, 20.0])}
        return Message("/daq", "std_msgs/msg/Float64MultiArray", received(k / 1000), content)

    pressures = {
        "pressure_a_pa": Column("data[0]", unit="bar", table="/daq"),
        "pressure_b_pa": Column("data[1]", unit="bar", table="/daq"),
    }
    bag = record(tmp_path / "theirs", [scan(k) for k in range(10)])
    read = load(bag, ColumnMap(pressures, cylinder=Cylinder(2e-3, 1e-3)))
    assert read.time_s == pytest.approx(np.arange(10) / 1000)
    assert read["load_pressure_pa"] == pytest.approx((2.0 * (50.0 + np.arange(10)) - 20.0) / 1.5 * 1e5)


def test_messages_out_of_order_are_sorted_by_their_stamps_and_repeated_ones_left_out(tmp_path: Path):
    times = [0.0, 0.002, 0.001, 0.003, 0.003, 0.004]
    bag = record(tmp_path / "theirs", [wrench(t, 1e3 * t, late=0.1 + 0.01 * k) for k, t in enumerate(times)])
    read = load(bag, mapped(tmp_path, "force_n: {table: /cell, name: wrench.force.z}"))
    assert read["force_n"] == pytest.approx([0.0, 1.0, 2.0, 3.0, 4.0])
    assert read.preparation.remarks == (
        "force_n: 1 messages arrived after later ones, by up to 1 ms, and are sorted by header.stamp",
        "force_n: 1 messages repeat a time and are left out",
    )


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("force_n: {name: data}", "no topic is named for force_n; expected 'table: /topic' beside its name in the map"),
        ("force_n: {table: /forse, name: data}", "topic /forse for force_n is missing (found: /cell, /joint_states,"),
        ("force_n: {table: /cell, name: force.z}", "field 'force.z' for force_n is missing (found: header.stamp.sec,"),
        ("force_n: {table: /cell, name: wrench.force}", "/cell: field 'wrench.force' for force_n is missing"),
        ("position_m: {table: /joint_states, name: position}", "position[0], velocity[0], effort[0]); expected"),
        ("position_m: {table: /joint_states, name: 'position[2]'}", "have at most 2 entries; expected a number from 0 on"),
        ("velocity_m_s: {table: /joint_states, name: 'velocity[0]'}", "its messages have at most 0 entries"),
        ("time_s: {name: t}\nforce_n: {table: /cell, name: wrench.force.z}", "each topic of a bag has separate times"),
        ("cylinder: {area_a: 1.0, area_b: 1.0}", "the map names no column; expected an entry like 'force_n: {table: /topic,"),
        (
            "tables: {/pressure_bar: {name: header.stamp}}\nforce_n: {table: /pressure_bar, name: data}",
            "/pressure_bar: its messages have no header.stamp; expected 'tables: {/pressure_bar: {name: received}}'",
        ),
    ],
)  # fmt: skip
def test_what_is_not_in_the_bag_is_named_with_its_topic(tmp_path: Path, text: str, complaint: str):
    with pytest.raises(BadInput) as error:
        load(bag_of(tmp_path), mapped(tmp_path, text))
    assert complaint in str(error.value)


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        (
            "force_n: {table: /cell, name: x, mend: true}",
            "force_n: mend is given; expected it only under 'tables', for a topic",
        ),
        ("tables: {a.csv: {name: t, mend: true}}", "mend is given; expected it only under 'tables', for a topic"),
        (f"{MAP}tables: [/cell, slow.csv]", "its tables are /cell, slow.csv; expected files alone, or topics (/name) alone"),
        (f"{MAP}base: /other", "base is '/other'; expected one of the tables /cell, /joint_states, /pressure_bar"),
    ],
)
def test_a_map_that_contradicts_itself_is_refused(tmp_path: Path, text: str, complaint: str):
    with pytest.raises(BadInput) as error:
        mapped(tmp_path, text)
    assert complaint in str(error.value)


def test_stamps_that_nobody_set_are_refused(tmp_path: Path):
    bag = record(tmp_path / "theirs", [wrench(0.0, 1.0, late=k / 1000) for k in range(50)])
    with pytest.raises(BadInput, match=r"its 50 messages have only 1 different times \(header.stamp\); .*name: received"):
        load(bag, mapped(tmp_path, "force_n: {table: /cell, name: wrench.force.z}"))


def test_without_a_map_such_a_bag_asks_for_one(tmp_path: Path):
    with pytest.raises(BadInput, match=r"loader_state is missing .*a map of columns that names topics \(ehls columns "):
        read_bag(bag_of(tmp_path))


def test_the_proposed_map_names_topics_and_leaves_open_what_they_do_not_say(tmp_path: Path):
    def pressure(k: int) -> Message:
        fields = {"header": stamped(k / 100), "fluid_pressure": 1e5 * k, "variance": 0.0}
        return Message("/boom/pressure_a", "sensor_msgs/msg/FluidPressure", received(k / 100 + 0.002 * (k % 3)), fields)

    picture = Message("/camera", "std_msgs/msg/UInt8MultiArray", received(0.0), {
        "layout": TYPES["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0), "data": np.zeros(70_000, np.uint8),
    })  # fmt: skip
    messages = [picture, *(pressure(k) for k in range(5)), *(number("/weg_mm", k / 100, k) for k in range(5))]
    tables = look(record(tmp_path / "theirs", [*messages, *(wrench(k / 100, k) for k in range(5))]))
    read = {table.name: round(table.rate) for table in tables if table.columns}
    assert read == {"/boom/pressure_a": 100, "/cell": 100, "/weg_mm": 100}
    text = proposed_map(tables).text
    assert "# --- /camera\n# left out: a message has 70016 bytes; expected at most 65536" in text
    assert mapped(tmp_path, text) == ColumnMap({
        "pressure_a_pa": Column("fluid_pressure", unit="Pa", table="/boom/pressure_a"),
        "position_m": Column("data", unit="mm", table="/weg_mm"),
    })  # fmt: skip
    [force] = [line for line in text.splitlines() if "wrench.force.z" in line]
    assert force.startswith("# ")
    assert "0 to 4" in force


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
@pytest.mark.parametrize("source", ["header.stamp", "received"])
def test_a_clock_of_sender_and_recorder_that_was_set_back_is_refused(tmp_path: Path, storage: str, source: str):
    """Sorted by the time of reception, the samples before and after the step would lie between each other."""
    times = [k / 500 - (0.1013 if k >= 200 else 0.0) for k in range(400)]
    bag = record(tmp_path / "theirs", [wrench(t, k) for k, t in enumerate(times)], storage)
    text = f"force_n: {{table: /cell, name: wrench.force.z}}\ntables: {{/cell: {{name: {source}}}}}"
    complaint = f"{source} goes back by 99.3 ms from message 200 to 201: its clock was set back by about 101.3 ms, and that of"
    with pytest.raises(BadInput, match=complaint):
        load(bag, mapped(tmp_path, text))
    read = load(bag, mapped(tmp_path, text.replace("}}", ", mend: true}}")))
    np.testing.assert_allclose(read["force_n"], 500.0 * read.time_s, atol=1e-3)
    assert any("was set back by 101.3 ms at message 201; this is mended" in remark for remark in read.preparation.remarks)
    [table] = look(bag)
    assert "header.stamp goes back by 99.3 ms from message 200 to 201" in table.remarks[0]


def test_messages_that_were_written_in_another_order_are_sorted(tmp_path: Path):
    """As after the merging of bags."""
    times = [*range(200, 400), *range(200)]
    bag = record(tmp_path / "theirs", [wrench(k / 500, k) for k in times])
    read = load(bag, mapped(tmp_path, "force_n: {table: /cell, name: wrench.force.z}"))
    assert read["force_n"].tolist() == list(range(400))
    assert read.preparation.remarks == ()


def test_a_clock_of_one_topic_that_differs_is_refused_and_given_ones_are_a_remark(tmp_path: Path):
    def late(k: int) -> Message:
        return wrench(k / 500 - 90.0, k, late=90.0)

    bag = record(tmp_path / "theirs", [each for k in range(400) for each in (late(k), joints(k / 500, k))])
    text = "force_n: {table: /cell, name: wrench.force.z}\nposition_m: {table: /joint_states, name: 'position[boom]'}\n"
    with pytest.raises(BadInput) as error:
        load(bag, mapped(tmp_path, text))
    assert "header.stamp of /joint_states is 0 ms before its reception and header.stamp of /cell is 90 s" in str(error.value)
    assert "expected one clock: 'tables: {/cell: {name: received}}' in the map, or an offset" in str(error.value)
    for mended in ("{name: received}", "{name: header.stamp, offset: 90.0}"):
        read = load(bag, mapped(tmp_path, f"{text}tables: {{/cell: {mended}}}"))
        assert len(read) > 390


def test_senders_that_differ_in_their_frame_alone_are_chosen_by_it(tmp_path: Path):
    def pressure(k: int) -> Message:
        header = stamped(k / 1000)
        header.frame_id = "left" if k % 2 else "right"
        fields = {"header": header, "fluid_pressure": 1e5 * (k % 2), "variance": 0.0}
        return Message("/p", "sensor_msgs/msg/FluidPressure", received(k / 1000), fields)

    bag = record(tmp_path / "theirs", [pressure(k) for k in range(40)])
    with pytest.raises(BadInput) as error:
        load(bag, mapped(tmp_path, "load_pressure_pa: {table: /p, name: fluid_pressure}"))
    assert (
        "/p: header.frame_id is 'right' in message 1 and 'left' in message 2; 20 of 40 messages differ from the first; "
        'expected one sender for load_pressure_pa: a frame in brackets, such as name: "fluid_pressure[right]"'
    ) in str(error.value)
    read = load(bag, mapped(tmp_path, 'load_pressure_pa: {table: /p, name: "fluid_pressure[left]"}'))
    assert read["load_pressure_pa"].tolist() == [1e5] * 20
    assert read.preparation.remarks == ("load_pressure_pa: 20 of 40 messages have no fluid_pressure[left] and are left out",)
    [table] = look(bag)
    assert [c.header.column for c in table.columns][:2] == ["fluid_pressure[left]", "fluid_pressure[right]"]
    with pytest.raises(BadInput, match=r"fluid_pressure\[top\]' for .* is missing: header.frame_id is 'left', 'right'"):
        load(bag, mapped(tmp_path, 'load_pressure_pa: {table: /p, name: "fluid_pressure[top]"}'))


def test_frames_that_are_no_labels_do_not_matter(tmp_path: Path):
    def force(k: int) -> Message:
        message = wrench(k / 1000, k)
        message.fields["header"].frame_id = f"frame {k:04}"
        return message

    bag = record(tmp_path / "theirs", [force(k) for k in range(200)])
    assert len(load(bag, mapped(tmp_path, "force_n: {table: /cell, name: wrench.force.z}"))) == 200
