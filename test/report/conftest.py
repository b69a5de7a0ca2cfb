"""Shared fixtures of the report tests."""

import pytest


@pytest.fixture
def written(tmp_path):
    """Write a page with a report's function and return its text."""

    def write(report):
        path = tmp_path / "report.html"
        report(path)
        return path.read_text(encoding="utf-8")

    return write


@pytest.fixture
def without_plotly(monkeypatch):
    """Generate pages without the five megabytes of plotly.js."""
    monkeypatch.setattr("ehls_ros.report.page.plotly_js", lambda: "")
