"""Foreign files are read or refused in one line, whatever they contain."""

import importlib.util
import json
import sqlite3
from contextlib import closing
from pathlib import Path
from types import ModuleType

import pytest
import yaml
from recorded_runs import loader_state, make_trajectory, record, serialized, storage_file
from tiers import tiered

from ehls_ros.errors import LONGEST, BadInput
from ehls_ros.recording.bag_reader import read_bag
from ehls_ros.recording.bag_writer import BagWriter, Storage, write_trajectory
from ehls_ros.recording.limits import TEXT, YAML_DEPTH
from ehls_ros.recording.load import load
from ehls_ros.recording.provenance import CHECKSUM_KEY, KEY, _text_checksum
from ehls_ros.recording.recording_note import NOTE
from ehls_ros.recording.recovery import recover
from ehls_ros.recording.topics import LOADER_STATE
from ehls_ros.recording.yaml_text import parse_yaml

COMPUTED = """
    ALTER TABLE messages RENAME TO old;
    CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB AS (zeroblob(1000000000)));
    INSERT INTO messages(id, topic_id, timestamp) SELECT id, topic_id, timestamp FROM old;
"""
ENDLESS = """
    ALTER TABLE messages RENAME TO old;
    CREATE VIEW messages AS
        WITH RECURSIVE endless(id) AS (SELECT 1 UNION ALL SELECT id + 1 FROM endless)
        SELECT endless.id, topic_id, timestamp, data FROM endless, old;
"""
RELABEL = """
    PRAGMA writable_schema = ON;
    UPDATE sqlite_master SET type = 'table' WHERE name = 'messages';
"""


@pytest.fixture(scope="module")
def fuzz() -> ModuleType:
    spec = importlib.util.spec_from_file_location("fuzz", Path(__file__).resolve().parents[2] / "benchmarks" / "fuzz.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize(
    ("name", "inputs"), tiered([("csv", 1000), ("yaml", 500), ("bag", 100), ("csv", 200)], ("csv", 200), unpack=True)
)
def test_damaged_files_are_read_or_refused(tmp_path: Path, fuzz: ModuleType, name: str, inputs: int):
    outcomes = fuzz.fuzz(fuzz.TARGETS[name](), inputs, 11, tmp_path)
    assert set(outcomes) == {"taken", "refused"}
    assert outcomes["taken"] > inputs / 20
    assert outcomes["refused"] > inputs / 4


@pytest.mark.parametrize(
    ("text", "line", "complaint"),
    [
        ("a: 1\nb: 2\na: 3\n", 3, "duplicate key 'a'"),
        ("plant:\n  mass: 1\n  area: 2\n  'mass': 3\n", 4, "duplicate key 'mass'"),
        ("a: &x [1]\nb: *x\n", 2, "alias *x"),
        ("a: 1\nb: &b [*b]\n", 2, "alias *b"),
        ("[" * (YAML_DEPTH + 1), 1, f"collections are nested {YAML_DEPTH + 1} deep"),
        ("[" * 200_000, 1, f"collections are nested {YAML_DEPTH + 1} deep"),
        ("- " * 200_000, 1, f"collections are nested {YAML_DEPTH + 1} deep"),
        ("a: 1\nb: 2001-99-99\n", 2, "'2001-99-99' is not a valid timestamp"),
        ("a: " + "9" * 5000, 1, "is not a valid int"),
        ("a: 0x" + "f" * 5000, 1, "is not a valid int"),
        ("a: 1" + ":59" * 500 + ".5", 1, "is not a valid float"),
        ("a: !!int ''", 1, "'' is not a valid int"),
        ("a: !!bool maybe", 1, "'maybe' is not a valid bool"),
        ("a: !!timestamp noon", 1, "'noon' is not a valid timestamp"),
        ("a: !!python/object:os.system x", 1, "could not determine a constructor"),
    ],
)
def test_yaml_that_is_not_plain_data_is_refused_with_its_line(text: str, line: int, complaint: str):
    with pytest.raises(BadInput) as caught:
        parse_yaml(text, "rig.yaml", "rig file")
    assert caught.value.where == f"rig.yaml:{line}"
    assert complaint in caught.value.what


def test_yaml_up_to_the_limits_is_read():
    assert parse_yaml("[" * YAML_DEPTH + "]" * YAML_DEPTH, "rig.yaml", "rig file") is not None
    assert parse_yaml("a: " + "1" * 309, "rig.yaml", "rig file") == {"a": int("1" * 309)}
    with pytest.raises(BadInput, match="characters"):
        parse_yaml("#" * (TEXT + 1), "rig.yaml", "rig file")


def test_an_error_that_quotes_a_foreign_file_stays_one_short_line(tmp_path: Path):
    file = tmp_path / "data.csv"
    file.write_text('time_s,"a\nb\x1b[31m\u2028c",' + "x" * 10_000 + "\n0,1,2\n", encoding="utf-8")
    with pytest.raises(BadInput) as caught:
        load(file)
    assert str(caught.value).isprintable()
    assert len(caught.value.what) == LONGEST
    assert "a b\\x1b[31m\\u2028c" in str(caught.value)


@pytest.mark.parametrize(
    "script", [ENDLESS, ENDLESS + RELABEL, COMPUTED], ids=["endless view", "said to be a table", "computed"]
)
def test_a_database_that_computes_its_messages_is_refused(tmp_path: Path, script: str):
    bag = record(tmp_path / "theirs", [loader_state(0), loader_state(1)], "sqlite3")
    with closing(sqlite3.connect(storage_file(bag))) as database, database:
        database.executescript(script)
    with pytest.raises(BadInput, match="the file is damaged"):
        read_bag(bag)


def test_a_topic_whose_name_is_not_text_is_refused(tmp_path: Path):
    bag = record(tmp_path / "theirs", [loader_state(0)], "sqlite3")
    with closing(sqlite3.connect(storage_file(bag))) as database, database:
        database.execute("UPDATE topics SET name = x'00'")
    with pytest.raises(BadInput, match="a topic is named"):
        read_bag(storage_file(bag))


@pytest.mark.parametrize(
    "content",
    [
        "",
        "[",
        "[" * 100_000,
        "1",
        "{}",
        '{"configuration": {}, "seals": {"/a": {}}, "signals": null}',
        '{"configuration": [], "seals": {}, "signals": null}',
        '{"configuration": {}, "seals": {}, "signals": 3}',
    ],
    ids=["empty", "truncated", "deep", "number", "empty mapping", "seal", "configuration", "signals"],
)
def test_an_invalid_configuration_is_refused_even_with_a_correct_checksum(tmp_path: Path, content: str):
    write_trajectory(tmp_path / "bag", make_trajectory(3))
    metadata = tmp_path / "bag" / "metadata.yaml"
    entries = yaml.safe_load(metadata.read_text(encoding="utf-8"))
    entries["rosbag2_bagfile_information"]["custom_data"] = {KEY: content, CHECKSUM_KEY: _text_checksum(content)}
    metadata.write_text(yaml.safe_dump(entries), encoding="utf-8")
    with pytest.raises(BadInput, match="the configuration in the bag is not in the format of ehls_ros"):
        read_bag(tmp_path / "bag")


def cut_off(folder: Path, storage: Storage = "mcap") -> Path:
    """Return the bag of a recorder that was killed after a flush."""
    writer = BagWriter.create(folder / "bag", storage, {}, topics=[LOADER_STATE])
    writer.write(LOADER_STATE.name, 5, serialized(loader_state(0)))
    writer.flush()
    writer.abort()
    return folder / "bag"


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("configuration", [1]),
        ("flushed", {"/ehls/loader_state": [float("inf"), 0]}),
        ("flushed", {"/ehls/loader_state": [1]}),
        ("flushed", {"/ehls/nothing": {"messages": 1, "newest_ns": 0}}),
        ("checksum", 7),
    ],
)
def test_a_wrong_note_is_ignored(tmp_path: Path, key: str, value: object):
    bag = cut_off(tmp_path)
    note = json.loads((bag / NOTE).read_text(encoding="utf-8"))
    (bag / NOTE).write_text(json.dumps({**note, key: value}), encoding="utf-8")
    recovery = recover(bag, tmp_path / "out")
    assert (recovery.recovered, recovery.lost) == (1, 0)
    assert any("the note " in remark for remark in recovery.remarks)


@pytest.mark.parametrize("change", ["timestamp = -1", "timestamp = 'noon'", "data = 'text'", "data = 5"])
def test_a_row_that_is_not_a_message_is_not_recovered(tmp_path: Path, change: str):
    bag = cut_off(tmp_path, "sqlite3")
    with closing(sqlite3.connect(storage_file(bag))) as database, database:
        database.execute(f"UPDATE messages SET {change}")
    with pytest.raises(BadInput, match="no sound message of loader_state is left"):
        recover(bag, tmp_path / "out")
