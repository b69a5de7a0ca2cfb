"""The cache of compiled kernels."""

import contextlib
import importlib.util
import io
import multiprocessing
import os
import pickle
import py_compile
import shutil
import subprocess
import sys

import pytest
from patience import PATIENCE
from tiers import tiered

from ehls_ros import sources
from ehls_ros.errors import BadInput
from ehls_ros.physics import kernel_cache
from ehls_ros.physics.composition import KERNEL_SOURCES, kernel_module
from ehls_ros.physics.simulator import parts_of, plant_kernel

SOURCE = '''"""A kernel of a test."""
from numba import njit


@njit(cache=True, error_model="numpy")
def twice(x):
    return {factor} * x
'''


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A separate cache folder for the test."""
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
    counts = sorted(child.communicate(timeout=PATIENCE)[0].split() for child in children)
    assert counts == [["0", "1"], ["1", "0"]]


def test_the_cache_folder_is_the_users(monkeypatch, tmp_path):
    monkeypatch.delenv("EHLS_CACHE_DIR", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert kernel_cache.cache_folder() == tmp_path / "ehls_ros"


@pytest.fixture
def package(tmp_path, monkeypatch):
    """A package with empty kernel sources."""
    made = tmp_path / "package"
    made.mkdir()
    for part in KERNEL_SOURCES:
        (made / part).touch() if part.endswith(".py") else (made / part).mkdir()
    monkeypatch.setattr(sources, "PACKAGE", made)
    return made


def test_changed_package_sources_make_another_module(folder, package):
    law = package / "physics" / "law.py"
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


def test_changed_compile_flags_make_another_module(folder, package):
    names = set()
    try:
        for flags in ("", "fastmath=True"):
            (package / "arrays.py").write_text(f"kernel = njit({flags})", encoding="utf-8")
            sources.sources_digest.cache_clear()
            names.add(kernel_module(SOURCE.format(factor=6.0)).__name__)
    finally:
        sources.sources_digest.cache_clear()
    assert len(names) == 2


FORKING = multiprocessing.get_context("forkserver")
FORKING.set_forkserver_preload(["ehls_ros.physics.composition"])


def in_another_process(source):
    """Return a new process's result of the kernel, and whether it compiled it; then its complaints."""
    mine, its = FORKING.Pipe(duplex=False)
    child = FORKING.Process(target=run_twice, args=(its, source, os.environ["EHLS_CACHE_DIR"], current_umask()))
    child.start()
    its.close()
    try:
        return mine.recv()
    finally:
        child.join()


def current_umask():
    mask = os.umask(0)
    os.umask(mask)
    return mask


def run_twice(answer, source, folder, umask):
    """Send the result of :func:`in_another_process`; runs in a separate process."""
    os.environ["EHLS_CACHE_DIR"] = folder
    os.umask(umask)
    out, complaints = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(complaints):
        module = kernel_module(source)
        print(module.twice(4.0), sum(module.twice.stats.cache_misses.values()))
    answer.send((out.getvalue().split(), complaints.getvalue()))


def test_the_folder_is_the_users_alone_whatever_the_umask(folder):
    before = os.umask(0)
    try:
        in_another_process(SOURCE.format(factor=3.0))
    finally:
        os.umask(before)
    assert folder.stat().st_mode & 0o777 == 0o700


@pytest.mark.parametrize(
    "content", [b"", b"def twice(x):\n    return 'not what was written'\n", None], ids=["empty", "edited", "gone"]
)
def test_a_kernel_that_is_not_as_it_was_written_is_not_run(folder, content):
    source = SOURCE.format(factor=13.0)
    assert in_another_process(source) == (["52.0", "1"], "")
    [file] = folder.glob("*.py")
    if content is None:
        file.unlink()
    else:
        file.write_bytes(content)
    (result, _), complaints = in_another_process(source)  # numba 0.59 compiles again, as the file is newer
    assert (result, complaints) == ("52.0", "")
    assert file.read_text(encoding="utf-8") == source


def test_a_kernel_is_not_run_from_byte_code_beside_it(folder):
    source = SOURCE.format(factor=17.0)
    in_another_process(source)
    [file] = folder.glob("*.py")
    planted = folder / "planted.py"
    planted.write_text(source.replace("17.0", "666.0"), encoding="utf-8")
    target = importlib.util.cache_from_source(str(file))
    # Byte code that is not checked against its source.
    py_compile.compile(str(planted), target, invalidation_mode=py_compile.PycInvalidationMode.UNCHECKED_HASH)
    planted.unlink()
    for code in folder.glob("__pycache__/*.nb?"):
        code.unlink()
    assert in_another_process(source)[0] == ["68.0", "1"]


def emptied(content):
    return b""


def cut(content):
    return content[: len(content) // 2]


def flipped(content):
    return content[:-100] + bytes([content[-100] ^ 1]) + content[-99:]


def planted(content):
    return pickle.dumps(Planted())


class Planted:
    """Announces when it is loaded."""

    def __reduce__(self):
        return print, ("666.0 666",)


NINETEEN = SOURCE.format(factor=19.0)


@pytest.fixture(scope="module")
def filled(tmp_path_factory):
    """A cache folder with a compiled kernel."""
    folder = tmp_path_factory.mktemp("filled") / "kernels"
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("EHLS_CACHE_DIR", str(folder))
        in_another_process(NINETEEN)
    return folder


@pytest.mark.parametrize(
    ("kind", "damage"),
    tiered(
        [(kind, damage) for damage in (flipped, planted) for kind in ("nbi", "nbc", "seal")] + [("nbc", emptied), ("nbc", cut)],
        ("nbc", flipped),
        ("seal", planted),
        unpack=True,
    ),
)
def test_machine_code_that_is_not_as_it_was_left_is_compiled_anew(folder, filled, kind, damage):
    shutil.copytree(filled, folder)
    [file] = folder.rglob(f"*.{kind}")
    file.write_bytes(damage(file.read_bytes().ljust(200)))
    assert in_another_process(NINETEEN) == (["76.0", "1"], "")
    assert in_another_process(NINETEEN) == (["76.0", "0"], "")


def test_a_folder_that_others_could_write_is_emptied_with_a_reason(folder):
    source = SOURCE.format(factor=23.0)
    in_another_process(source)
    folder.chmod(0o770)
    answer, complaint = in_another_process(source)
    assert answer == ["92.0", "1"]
    assert complaint == f"{folder}: others could write it; its kernels are compiled again\n"
    assert folder.stat().st_mode & 0o777 == 0o700
    assert in_another_process(source) == (["92.0", "0"], "")


def test_a_folder_of_other_things_that_others_may_write_is_refused(folder):
    folder.mkdir()
    (folder / "thesis.tex").touch()
    folder.chmod(0o777)
    with pytest.raises(BadInput, match=r"others may write the folder of compiled kernels, which holds 'thesis.tex' too"):
        kernel_module(SOURCE.format(factor=29.0))
    assert (folder / "thesis.tex").exists()


def test_a_folder_of_somebody_else_is_refused(folder, monkeypatch):
    folder.mkdir(0o755)
    somebody = os.geteuid() + 1
    monkeypatch.setattr(os, "geteuid", lambda: somebody)
    with pytest.raises(BadInput, match=rf"belongs to user {somebody - 1}; expected a folder that only you can write"):
        kernel_module(SOURCE.format(factor=31.0))


def test_machine_code_that_numba_keeps_elsewhere_is_the_users_alone_too(folder, tmp_path):
    script = "import sys; from ehls_ros.physics.composition import kernel_module; print(kernel_module(sys.argv[1]).twice(4.0))"
    command = [sys.executable, "-c", script, SOURCE.format(factor=37.0)]
    elsewhere = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "numba")}
    assert subprocess.check_output(command, env=elsewhere, text=True) == "148.0\n"
    [code] = (tmp_path / "numba").iterdir()
    code.chmod(0o777)
    (code / "thesis.tex").touch()
    refused = subprocess.run(command, env=elsewhere, capture_output=True, text=True, check=False)
    assert "others may write the folder" in refused.stderr


def test_on_a_full_disk_a_kernel_is_compiled_and_not_kept(folder):
    source = SOURCE.format(factor=41.0)
    size = len(source) + 1
    script = (
        "import resource, sys; from ehls_ros.physics.composition import kernel_module; "
        f"resource.setrlimit(resource.RLIMIT_FSIZE, ({size}, {size})); print(kernel_module(sys.argv[1]).twice(2.0))"
    )
    done = subprocess.run([sys.executable, "-c", script, source], capture_output=True, text=True, check=False)
    assert (done.stdout, done.stderr) == ("82.0\n", "")
    assert in_another_process(source)[0] == ["164.0", "1"]


def test_models_and_effects_are_told_apart(make_rig):
    plain = plant_kernel(parts_of(make_rig()))
    assert plain is not plant_kernel(parts_of(make_rig(friction={"model": "lugre"})))
    assert plain is not plant_kernel(parts_of(make_rig(effects=[{"name": "valve_dead_zone"}])))
    # Numbers are no part of the machine code.
    assert plain is plant_kernel(parts_of(make_rig(plant={"moving_mass": 99.0})))


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
