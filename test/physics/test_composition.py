"""Where compiled kernels are kept."""

import os
import subprocess
import sys

import pytest

from ehls_ros import sources
from ehls_ros.physics import composition
from ehls_ros.physics.composition import kernel_module, plant_source

SOURCE = '''"""A kernel of a test."""
from numba import njit


@njit(cache=True, error_model="numpy")
def twice(x):
    return {factor} * x
'''


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A cache folder of the test's own."""
    monkeypatch.setenv("EHLS_CACHE_DIR", str(tmp_path / "kernels"))
    return tmp_path / "kernels"


def test_another_source_is_another_module(folder):
    two, three = kernel_module(SOURCE.format(factor=2.0)), kernel_module(SOURCE.format(factor=3.0))
    assert (two.twice(1.0), three.twice(1.0)) == (2.0, 3.0)
    assert two.__name__ != three.__name__
    assert kernel_module(SOURCE.format(factor=2.0)) is two
    assert len(list(folder.glob("*.py"))) == 2


CHILD = """
import sys
from ehls_ros.physics.composition import kernel_module
twice = kernel_module(sys.argv[1]).twice
print("ready", flush=True)
sys.stdin.readline()
assert twice(1.0) == 7.0
print(sum(twice.stats.cache_misses.values()), sum(twice.stats.cache_hits.values()))
"""


def test_of_two_processes_that_need_a_kernel_at_once_one_compiles_and_the_other_loads(folder):
    command = [sys.executable, "-c", CHILD, SOURCE.format(factor=7.0)]
    children = [subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) for _ in range(2)]
    assert [child.stdout.readline() for child in children] == ["ready\n"] * 2
    for child in children:
        child.stdin.write("\n")
        child.stdin.flush()
    counts = sorted(child.communicate(timeout=60.0)[0].split() for child in children)
    assert counts == [["0", "1"], ["1", "0"]]


def test_the_cache_folder_is_the_users(monkeypatch, tmp_path):
    monkeypatch.delenv("EHLS_CACHE_DIR", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert composition.cache_folder() == tmp_path / "ehls_ros"


def test_changed_package_sources_make_another_module(folder, tmp_path, monkeypatch):
    for part in ("physics", "control"):
        (tmp_path / "package" / part).mkdir(parents=True)
    law = tmp_path / "package" / "physics" / "law.py"
    monkeypatch.setattr(sources, "PACKAGE", tmp_path / "package")
    names = []
    try:
        for text in ("a = 1", "a = 2", "a = 1"):
            law.write_text(text, encoding="utf-8")
            sources.sources_digest.cache_clear()
            names.append(kernel_module(SOURCE.format(factor=5.0)).__name__)
    finally:
        sources.sources_digest.cache_clear()
    assert names[0] != names[1]
    assert names[0] == names[2]


def test_models_and_effects_are_told_apart(make_rig):
    plain = plant_source(make_rig())
    assert plain != plant_source(make_rig(friction={"model": "lugre"}))
    assert plain != plant_source(make_rig(effects=[{"name": "valve_dead_zone"}]))
    # Numbers are no part of the machine code.
    assert plain == plant_source(make_rig(plant={"moving_mass": 99.0}))


def test_a_folder_that_cannot_be_written_gives_way(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("in the way", encoding="utf-8")
    monkeypatch.setenv("EHLS_CACHE_DIR", str(tmp_path / "file" / "kernels"))
    module = kernel_module(SOURCE.format(factor=7.0))
    assert module.twice(2.0) == 14.0
    assert not str(module.__file__).startswith(str(tmp_path))


def test_processes_that_start_at_once_share_one_module(folder):
    script = (
        "import sys, ehls_ros.physics.composition as c\n"
        "module = c.kernel_module(sys.argv[1])\n"
        "print(module.__name__, module.twice(4.0))"
    )
    command = [sys.executable, "-c", script, SOURCE.format(factor=11.0)]
    started = [subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=os.environ.copy()) for _ in range(2)]
    answers = {process.communicate()[0] for process in started}
    assert [process.returncode for process in started] == [0, 0]
    assert len(answers) == 1
    assert next(iter(answers)).split()[1] == "44.0"
    assert len(list(folder.glob("*.py"))) == 1
