"""The site just built by `make docs`, in a browser: no page is wider than a telephone or a laptop."""

import importlib
import shutil
from collections.abc import Iterator
from typing import Any

import pytest
from docs_snippets import ROOT

LISTINGS = "source"
"""Folder of the pages that show files of the repository; they all have the same layout."""

SITE = ROOT / "build" / "docs"
WIDTHS = (390, 1366)
TOO_WIDE = "document.documentElement.scrollWidth - document.documentElement.clientWidth"

pytestmark = [pytest.mark.long, pytest.mark.skipif(not SITE.is_dir(), reason="`make docs` builds the site")]


@pytest.fixture(scope="module")
def tab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """A tab of a browser."""
    if not any(map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))):
        pytest.skip("needs Chromium")
    # Needs websockets, which only a site's builder has beside the browser.
    browser = importlib.import_module("headless_browser").browser
    with browser(tmp_path_factory.mktemp("profile")) as chromium, chromium.tab("about:blank") as tab:
        yield tab


@pytest.mark.parametrize("width", WIDTHS)
def test_no_page_scrolls_sideways(tab: Any, width: int) -> None:
    tab.resize(width, 800)
    pages, wide = [page for page in SITE.rglob("*.html") if LISTINGS not in page.relative_to(SITE).parts], {}
    assert pages, "there is no site"
    for page in [*pages, next((SITE / LISTINGS).rglob("*.html"))]:
        tab.go(page.as_uri())
        if (excess := tab.evaluate(TOO_WIDE)) > 0:
            wide[str(page.relative_to(SITE))] = excess
    assert wide == {}, "pages are wider than the window, by so many pixels"


def test_nothing_comes_from_elsewhere(tab: Any) -> None:
    tab.requested.clear()
    tab.go((SITE / "index.html").as_uri())
    tab.go((SITE / "concepts.html").as_uri())
    assert {address.partition(":")[0] for address in tab.requested} <= {"file", "data"}
    assert tab.complaints == []
