"""Links in README.md, docs/ and examples/ point to existing files, lines and headings; every page is in the site."""

import importlib
import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest
from markdown_it import MarkdownIt
from markdown_it.token import Token

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
PAGES = [
    *(path for path in DOCS.rglob("*.md") if not path.is_relative_to(DOCS / "reference")),
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    *(ROOT / "examples").rglob("*.md"),
]


class Link(NamedTuple):
    """A link: its page, line and target."""

    page: Path
    line: int
    target: str

    def __str__(self) -> str:
        return f"{self.page.relative_to(ROOT)}:{self.line} {self.target}"


def tokens(path: Path) -> list[Token]:
    return MarkdownIt().enable("table").parse(path.read_text(encoding="utf-8"))


def links(path: Path) -> Iterator[Link]:
    for token in tokens(path):
        for child in token.children or ():
            target = child.attrGet("href") or child.attrGet("src")
            if target:
                yield Link(path, (token.map or [0])[0] + 1, str(target))


def headings(path: Path) -> set[str]:
    """Return the anchors of a page's headings, as MyST and code hosts make them."""
    found = tokens(path)
    titles = [found[i + 1].content for i, token in enumerate(found) if token.type == "heading_open"]
    return {re.sub(r"[^\w\- ]", "", title.replace("`", "").lower()).replace(" ", "-") for title in titles}


@pytest.fixture(scope="module")
def reference(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The generated pages."""
    folder = tmp_path_factory.mktemp("reference")
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(DOCS / "_ext"))
        importlib.import_module("reference_pages").write(folder)
    return folder


def wrong(link: Link, reference: Path) -> str:
    """Return the fault of a link; empty if it is right."""
    name, _, fragment = link.target.partition("#")
    path = (link.page.parent / name).resolve() if name else link.page
    if path.is_relative_to(DOCS / "reference"):
        path = reference / path.relative_to(DOCS / "reference")
    if not path.exists():
        return f"{name} is not there"
    if line := re.fullmatch(r"L(\d+)", fragment):
        return "" if int(line[1]) <= len(path.read_text(encoding="utf-8").splitlines()) else "the file is shorter"
    return "" if not fragment or fragment in headings(path) else f"no heading #{fragment}"


@pytest.mark.parametrize("page", PAGES, ids=lambda path: str(path.relative_to(ROOT)))
def test_links_point_to_existing_targets(page: Path, reference: Path) -> None:
    inside = [link for link in links(page) if not re.match(r"https?://", link.target)]
    assert not [f"{link}: {what}" for link in inside if (what := wrong(link, reference))]


@pytest.mark.parametrize("target", ["no_such.md", "design.md#no-such-heading", "../ehls_ros/arrays.py#L99999", "#nowhere"])
def test_a_dead_link_is_detected(target: str, reference: Path) -> None:
    assert wrong(Link(DOCS / "index.md", 1, target), reference)


def test_every_page_is_in_the_site() -> None:
    listed = re.findall(r"```\{toctree\}\n(.*?)```", (DOCS / "index.md").read_text(encoding="utf-8"), re.DOTALL)
    names = {line for block in listed for line in block.splitlines() if line and not line.startswith(":")}
    written = {str(path.relative_to(DOCS).with_suffix("")) for path in PAGES if path.is_relative_to(DOCS)}
    assert names == (written - {"index"}) | {"reference/index"}
