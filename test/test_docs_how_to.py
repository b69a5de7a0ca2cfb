"""Each how-to that adds a part is followed as a third party would follow it.

Its file goes into a separate package, known by the entry point on the page. Then all of the page's commands and Python run;
their output, as on the page, shows that the part acted.
"""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from docs_snippets import ROOT, blocks, entry_points, has_slow_blocks, members, pages
from third_party import families, install_page

FAMILIES = families()
PAGES = [page for page in pages() if members(page)]
QUICK = [f"docs/how_to/{name}.md" for name in ("reference", "friction_model")]
"""Pages whose part compiles in seconds, of each kind one."""

FOLLOWED = [
    *(pytest.param(page, (), id=Path(page).stem) for page in QUICK),
    *(
        pytest.param(page, ("--slow",), id=f"{Path(page).stem}, all of it", marks=pytest.mark.long)
        for page in PAGES
        if page not in QUICK or has_slow_blocks(page)
    ),
]


@pytest.mark.parametrize(("page", "options"), FOLLOWED)
def test_a_part_in_a_package_of_its_own_acts(page: str, options: tuple[str, ...], tmp_path: Path) -> None:
    site, folder = tmp_path / "site", tmp_path / "work"
    modules = install_page(site, page)
    folder.mkdir()
    (folder / "config").symlink_to(ROOT / "config")
    for block in blocks(page):
        if block.mark == "file" and block.language != "python":
            (folder / block.note).write_text(block.text, encoding="utf-8")
    paths = [str(site), str(ROOT / "test"), str(ROOT)]
    done = subprocess.run(
        [sys.executable, str(ROOT / "test" / "follow_page.py"), *options, page, *modules],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(paths)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize("page", PAGES, ids=lambda page: Path(page).stem)
def test_a_page_shows_file_entry_point_and_figure(page: str) -> None:
    offered = {name: group for group, own in entry_points(page).items() for name in own}
    assert offered.keys() == members(page).keys(), "each file needs its entry point, in TOML"
    for name, group in offered.items():
        folder = Path(members(page)[name].note).parent
        assert ".".join(folder.parts) == FAMILIES[group].package
    checks = [block for block in blocks(page) if block.language == "python" and block.mark in {"", "slow"}]
    asserted = any(re.search(r"^assert ", block.text, re.MULTILINE) for block in checks)
    assert asserted or any(block.mark == "output" for block in blocks(page)), "nothing shows that the part acts"


def test_the_page_on_packages_lists_all_groups() -> None:
    text = (ROOT / "docs" / "how_to" / "package.md").read_text(encoding="utf-8")
    rows = dict(re.findall(r"^\| `([\w.]+)` \|.*\| `([\w/]+)/` \|$", text, re.MULTILINE))
    assert rows == {group: family.package.replace(".", "/") for group, family in FAMILIES.items()}
    assert entry_points("docs/how_to/package.md").keys() <= FAMILIES.keys()
