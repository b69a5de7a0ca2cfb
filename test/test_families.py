"""Every family takes members from other distributions, by one rule, and refuses unusable ones."""

import importlib
import inspect
import re
import sys
from pathlib import Path

import pytest
from third_party import families, install

from ehls_ros import sources
from ehls_ros.control.references import REFERENCES
from ehls_ros.errors import BadInput
from ehls_ros.families import Family, offered

FAMILIES = families()
SINE = Path(inspect.getfile(REFERENCES.load("sine"))).read_text(encoding="utf-8")


@pytest.fixture
def site(tmp_path, monkeypatch):
    """Return a folder of packages that this process looks into."""
    monkeypatch.syspath_prepend(tmp_path)
    for family in FAMILIES.values():
        monkeypatch.setattr(family, "_loaded", {})
    offered.cache_clear()
    sources.module_digest.cache_clear()
    yield tmp_path
    offered.cache_clear()
    for name in [name for name in sys.modules if name.partition(".")[0] in {"acme_ehls", "other_ehls", "acme_alone"}]:
        del sys.modules[name]


def add(site, modules, points, name="acme_ehls"):
    """Install a distribution and make this process notice it."""
    install(site, modules, points, name)
    importlib.invalidate_caches()
    offered.cache_clear()


def own(family):
    """Return the name of one of the project's members that needs no optional library."""
    return next(name for name in family.names() if not name.startswith("py"))


def test_each_family_has_a_group_of_its_own():
    packages = {family.package for family in FAMILIES.values()}
    assert len(packages) == len(FAMILIES) >= 9
    assert all(re.fullmatch(r"ehls_ros\.[a-z_]+s", group) for group in FAMILIES)


@pytest.mark.parametrize("group", FAMILIES)
def test_a_copy_of_an_own_member_in_another_distribution_is_a_member(site, group):
    family = FAMILIES[group]
    text = Path(inspect.getfile(family.load(own(family)))).read_text(encoding="utf-8")
    add(site, {"acme_ehls.copy": text}, {group: {"acme_copy": "acme_ehls.copy"}})
    assert "acme_copy" in family.names()
    assert family.load("acme_copy").__name__ == "acme_ehls.copy"
    assert all("acme_copy" not in other.names() for other in FAMILIES.values() if other is not family)


@pytest.mark.parametrize("group", FAMILIES)
def test_a_module_that_lacks_something_is_refused_with_the_names_of_it(site, group):
    add(site, {"acme_ehls.empty": '"""Nothing."""\n'}, {group: {"empty": "acme_ehls.empty"}})
    with pytest.raises(BadInput) as caught:
        FAMILIES[group].load("empty", "here")
    assert caught.value.where == "here"
    assert "'empty' has no " in caught.value.what
    assert "empty.py" in caught.value.expected


def refused(group, name):
    with pytest.raises(BadInput) as caught:
        FAMILIES[group].load(name, "here")
    assert caught.value.where == "here"
    return str(caught.value)


def test_what_cannot_be_used_is_refused_with_the_distribution_it_comes_from(site):
    points = {"missing": "acme_ehls.missing", "inside": "acme_ehls.sine:sample", "a-name": "acme_ehls.sine"}
    add(site, {"acme_ehls.sine": SINE}, {REFERENCES.group: points})
    for name, words in {
        "missing": ("cannot be imported", "acme_ehls.missing"),
        "inside": ("acme_ehls.sine:sample", "the name of a module"),
        "a-name": ("letters, digits and underscores",),
    }.items():
        complaint = refused(REFERENCES.group, name)
        assert all(word in complaint for word in ("acme_ehls", repr(name), *words)), complaint


def test_a_broken_module_is_refused_and_keeps_no_other_from_use(site):
    modules = {"acme_ehls.sine": SINE, "acme_ehls.broken": "1/0\n", "acme_ehls.typo": "def\n"}
    points = {name: f"acme_ehls.{name}" for name in ("broken", "typo")}
    add(site, modules, {REFERENCES.group: {**points, "acme_sine": "acme_ehls.sine"}})
    assert "ZeroDivisionError: division by zero" in refused(REFERENCES.group, "broken")
    assert "SyntaxError" in refused(REFERENCES.group, "typo")
    assert REFERENCES.usable().keys() == set(REFERENCES.names()) - set(points)


def test_an_unknown_name_lists_own_and_installed_members(site):
    add(site, {"acme_ehls.sine": SINE}, {REFERENCES.group: {"acme_sine": "acme_ehls.sine"}})
    complaint = refused(REFERENCES.group, "no_such_one")
    assert all(name in complaint for name in ("acme_sine", "constant", "sine"))


def test_own_names_take_precedence_and_two_packages_must_not_offer_the_same(site):
    for name in ("acme_ehls", "other_ehls"):
        add(site, {f"{name}.sine": SINE}, {REFERENCES.group: {"sine": f"{name}.sine", "twice": f"{name}.sine"}}, name)
    assert REFERENCES.load("sine").__name__ == "ehls_ros.control.references.sine"
    complaint = refused(REFERENCES.group, "twice")
    assert "acme_ehls and by other_ehls" in complaint or "other_ehls and by acme_ehls" in complaint


def import_line(family: Family, name: str) -> str:
    """Recompute the line, as another process would."""
    sources.module_digest.cache_clear()
    return sources.import_line(family.load(name), "part")


def test_generated_text_imports_a_member_from_where_it_is(site):
    add(site, {"acme_ehls.deep.sine": SINE}, {REFERENCES.group: {"acme_sine": "acme_ehls.deep.sine"}})
    names: dict[str, object] = {}
    exec(import_line(REFERENCES, "acme_sine"), names)
    assert names["part"] is REFERENCES.load("acme_sine")
    exec(import_line(REFERENCES, "sine"), names)
    assert names["part"] is REFERENCES.load("sine")


def test_generated_text_is_another_once_a_file_of_the_members_package_is(site):
    modules = {"acme_ehls.sine": SINE, "acme_ehls.helper": "A = 1\n", "other_ehls.far": "A = 1\n", "acme_alone": SINE}
    add(site, modules, {REFERENCES.group: {"acme_sine": "acme_ehls.sine", "alone": "acme_alone"}})
    for name, file, counts in [
        ("acme_sine", "acme_ehls/sine.py", True),
        ("acme_sine", "acme_ehls/helper.py", True),
        ("acme_sine", "other_ehls/far.py", False),
        ("alone", "acme_alone.py", True),
        ("alone", "acme_ehls/helper.py", False),
    ]:
        before = import_line(REFERENCES, name)
        assert import_line(REFERENCES, name) == before
        path = site / file
        path.write_text(path.read_text(encoding="utf-8") + "# changed\n", encoding="utf-8")
        assert (import_line(REFERENCES, name) != before) == counts, (name, file)
