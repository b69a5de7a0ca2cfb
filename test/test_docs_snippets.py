"""Every command and snippet of README.md and docs/ runs, or at least parses, or states why it does neither."""

import importlib
import io
import shutil
import subprocess
import sys
import tomllib
from collections import Counter
from collections.abc import Iterator
from contextlib import redirect_stdout
from pathlib import Path
from types import ModuleType
from typing import Any

import docs_snippets
import pytest
import yaml
from docs_snippets import ROOT, SHELL, Block, Command, ParametersOf, Unknown, blocks, commands, has_slow_blocks, members, pages

from ehls_ros.cli.main import main
from ehls_ros.diagnosis.monitoring.tracking import COEFFICIENTS
from ehls_ros.experiments.campaign.plan import plan_from_mapping
from ehls_ros.experiments.monitoring.trends import check_limits
from ehls_ros.experiments.reference_files import load_programme
from ehls_ros.experiments.spec import spec_from_mapping
from ehls_ros.families import Family
from ehls_ros.fmu.plant_map import PlantMap, map_from_mapping
from ehls_ros.hardware.bridge_file import bridge_from_mapping
from ehls_ros.physics.cylinder import CYLINDERS
from ehls_ros.physics.data_sheet import sheet_from_mapping
from ehls_ros.physics.rig import rig_from_mapping
from ehls_ros.recording.columns import read_columns
from ehls_ros.schema import declarations, parse

LIBRARIES = {"docs/how_to/programme.md": "rainflow"}
"""Requirements of a page's snippets that an installation of ROS does not provide."""

_counts: Counter[str] = Counter()
_skipped: list[str] = []


@pytest.fixture(scope="module", autouse=True)
def report(request: pytest.FixtureRequest) -> Iterator[None]:
    """Print the treatment of the snippets, and the reasons for skipping the rest."""
    yield
    if _counts:
        with request.config.pluginmanager.get_plugin("capturemanager").global_and_fixture_disabled():
            print(f"\nsnippets: {', '.join(f'{n} {word}' for word, n in sorted(_counts.items()))}", *_skipped, sep="\n")


@pytest.fixture(scope="module")
def parameters_of() -> ParametersOf:
    """Nodes, launch arguments and services, from the code that writes the reference."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(ROOT / "docs" / "_ext"))
        return ParametersOf(importlib.import_module("reference_pages"))


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A copy of the repository's configuration to run a page in; files a page writes into the package are found, too."""
    for name in ("config", "examples"):
        shutil.copytree(ROOT / name, tmp_path / name)
    monkeypatch.chdir(tmp_path)
    before = set(sys.modules)
    yield tmp_path
    for name in set(sys.modules) - before:
        if str(tmp_path) in str(getattr(sys.modules[name], "__file__", "")):
            del sys.modules[name]


@pytest.mark.parametrize("page", [page for page in pages() if blocks(page)])
def test_snippets_of_a_page(page: str, folder: Path, parameters_of: ParametersOf, monkeypatch: pytest.MonkeyPatch) -> None:
    follow(page, {""}, folder, parameters_of, monkeypatch)


@pytest.mark.long
@pytest.mark.parametrize("page", [page for page in pages() if not members(page) and has_slow_blocks(page)])
def test_slow_snippets_of_a_page(page: str, folder: Path, parameters_of: ParametersOf, monkeypatch: pytest.MonkeyPatch) -> None:
    follow(page, {"", "slow"}, folder, parameters_of, monkeypatch)


def follow(page: str, marks: set[str], folder: Path, parameters_of: ParametersOf, monkeypatch: pytest.MonkeyPatch) -> None:
    """Process all blocks of a page, and run those with one of the marks."""
    if page in LIBRARIES:
        pytest.importorskip(LIBRARIES[page], reason=f"needs {LIBRARIES[page]}, which `make setup` installs")
    names: dict[str, Any] = {}
    made: list[str] = []
    printed = ""
    for block in blocks(page):
        try:
            if block.mark == "output":
                if printed:
                    docs_snippets.check_output(block, printed)
                done = "run" if printed else "parsed"
            else:
                with redirect_stdout(io.StringIO()) as out:
                    done = handle(block, marks, folder, parameters_of, made, names, monkeypatch)
                printed = out.getvalue() if done == "run" else ""
        except Unknown as error:
            pytest.fail(f"{block}: {error}", pytrace=False)
        _counts[done] += 1
        if done in {"parsed", "not run"}:
            _skipped.append(f"  {done}: {block}: {block.note or 'test_docs_how_to.py runs it'}")


def handle(
    block: Block,
    marks: set[str],
    folder: Path,
    parameters_of: ParametersOf,
    made: list[str],
    names: dict[str, Any],
    patch: pytest.MonkeyPatch,
) -> str:
    """Process a block according to its language and mark, and return the treatment in words."""
    if block.mark not in {"", "file"} and not block.note:
        raise Unknown("the mark gives no reason")
    if block.mark == "not run":
        return "not run"
    if block.mark == "file":
        save(block, folder, patch)
        made.append(block.note)
    match block.language:
        case "yaml":
            load_yaml(block, folder)
        case "toml":
            tomllib.loads(block.text)
        case "python" if block.mark == "file" and is_member(block):
            load_member(block.note)
        case "python" | "cpp" | "cmake" | "xml" if block.mark == "file":
            return "not run"
        case "python":
            code = compile(block.text, str(block), "exec")
            if not runs(block, marks):
                return "parsed"
            exec(code, names)
        case "sh" | "bash":
            return shell(block, marks, parameters_of, made)
        case "text":
            return "run"
        case language:
            raise Unknown(f"nobody knows how to run {language!r}")
    return "run"


def is_member(block: Block) -> bool:
    """Return whether a block is the file of a family's member."""
    return block in members(block.page).values()


def runs(block: Block, marks: set[str]) -> bool:
    """Return whether a block is run here; test_docs_how_to.py runs those of a page that adds a member."""
    return not members(block.page) and block.mark in marks


def save(block: Block, folder: Path, patch: pytest.MonkeyPatch) -> None:
    """Write a block to its file, and make the package it belongs to search there, too."""
    path = folder / block.note
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(block.text, encoding="utf-8")
    if is_member(block):
        package = importlib.import_module(".".join(Path(block.note).parent.parts))
        patch.setattr(package, "__path__", [*package.__path__, str(path.parent)])


def load_member(file: str) -> None:
    """Load a member of a family as the family does; its parameters must be declared by the project's rules."""
    package = importlib.import_module(".".join(Path(file).parent.parts))
    family = next(value for value in vars(package).values() if isinstance(value, Family))
    member: ModuleType = family.load(Path(file).stem)
    for declared in declarations(member.Parameters):
        assert declared.unit, declared.name
        assert declared.description, declared.name
        assert declared.minimum is not None, declared.name
        assert declared.maximum is not None, declared.name


def load_yaml(block: Block, folder: Path) -> None:
    """Load a block with the loader of its kind; a part of an experiment or rig file is inserted into one of the project's."""
    data, where = yaml.safe_load(block.text), str(block)
    example = yaml.safe_load((ROOT / "config" / "rig_paper.yaml").read_text(encoding="utf-8"))
    keys = set(data)
    if "vary" in keys:
        plan_from_mapping(data, where, folder)
    elif "backend" in keys:
        bridge_from_mapping(data, where)
    elif keys <= set(example):
        rig_from_mapping({**example, **data}, where)
    elif "cylinder" in keys and "bore" not in keys:
        law = CYLINDERS.load(data["cylinder"]["model"])
        derived = law.derived(parse(law.Parameters, {k: v for k, v in data["cylinder"].items() if k != "model"}, where))
        plant = {key: value for key, value in example["plant"].items() if key not in derived}
        rig_from_mapping({**example, "plant": plant, **data}, where)
    elif "bore" in keys:
        sheet_from_mapping(data, where)
    elif "controller" in keys:
        spec_from_mapping(data, where, folder)
    elif "blocks" in keys:
        load_programme(folder / block.note)
    elif keys <= set(PlantMap._fields):
        map_from_mapping(data, where)
    elif keys <= set(COEFFICIENTS):
        check_limits(data, rig_from_mapping(example, where), where)
    else:
        path = folder / (block.note or "columns.yaml")
        path.write_text(block.text, encoding="utf-8")
        read_columns(path)


def shell(block: Block, marks: set[str], parameters_of: ParametersOf, made: list[str]) -> str:
    """Parse every command, and run those of `ehls` if the block is to be run."""
    for command in commands(block):
        options = docs_snippets.check(command, parameters_of, made)
        made.append(str(getattr(options, "out", "")))
        if runs(block, marks):
            if options is None:
                raise Unknown(f"{command.shown} is not run by this test: mark the block with why it is only parsed")
            run(command)
    return "run" if runs(block, marks) else "parsed"


def run(command: Command) -> None:
    """Run an `ehls` command; a campaign, which starts workers, in a separate process."""
    words = command.words[1:]
    if words[0] == "campaign" and "--spec" not in words:
        subprocess.run([sys.executable, "-m", "ehls_ros.cli.main", *words], check=True, capture_output=True)
    else:
        assert main(words) == 0, command.shown


# --- the checks themselves ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "line",
    [
        "ehls experimnt config/experiments/sine_fd2.yaml",
        "ehls experiment config/experiments/sine_fd2.yaml --no-such-option",
        "ehls experiment config/experiments/no_such.yaml",
        "ehls experiment not_on_the_page.yaml",
        "make nothing",
        "make setup WITH=no_such",
        "python benchmarks/no_such.py",
        "python benchmarks/fuzz.py --no-such-option",
        "python -m pytest test/no_such.py",
        "ros2 run ehls_ros no_node",
        "ros2 run ehls_ros fasmc_node --ros-args -p kk:=1.0",
        "ros2 param set /ehls/fasmc_node k -1.0",
        "ros2 launch ehls_ros ehls.launch.py nothing:=sim",
        "ros2 service call /ehls/emergency_stop std_srvs/srv/SetBool",
        "ros2 topic hz /ehls/no_topic",
        "ros2 service call /rig2/emergency_stop std_srvs/srv/SetBool",
        "ros2 topic hz /rig3/loader_state",
        "rm -rf build",
    ],
)
def test_a_wrong_command_is_noticed(line: str, parameters_of: ParametersOf) -> None:
    (command,) = commands(Block("page", 1, SHELL, line, "", ""))
    with pytest.raises(Unknown):
        docs_snippets.check(command, parameters_of, [])


@pytest.mark.parametrize(
    ("text", "fits"), [("a  1.0 N\nb … s", True), ("a 1.1 N", False), ("b 2 s\na 1.0 N", False), ("a …", True)]
)
def test_output_is_compared_line_by_line(text: str, fits: bool) -> None:
    block = Block("page", 1, "text", text, "output", "")
    try:
        docs_snippets.check_output(block, "title\n  a 1.0 N\n  b 2 s\n")
    except Unknown:
        assert not fits
    else:
        assert fits
