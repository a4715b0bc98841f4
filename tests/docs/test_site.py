"""What the site takes from outside docs/. Building it, which checks its links, is a step of tools/test.sh."""

from __future__ import annotations

import runpy

import pytest
from pages import ROOT

import skysweep as ss

hooks = runpy.run_path(str(ROOT / "tools" / "site_hooks.py"))
REPOSITORY = "https://github.com/skysweep/skysweep/blob/main"


@pytest.mark.parametrize(
    ("source", "page", "link", "on_the_site"),
    [
        ("README.md", "index.md", "docs/paper.md#sensitivity", "paper.md#sensitivity"),
        ("README.md", "index.md", "CONTRIBUTING.md", "contributing.md"),
        ("README.md", "index.md", "LICENSE", f"{REPOSITORY}/LICENSE"),
        ("docs/sweeps.md", "sweeps.md", "../examples/belief.yaml", f"{REPOSITORY}/examples/belief.yaml"),
        ("docs/tutorials/area.md", "tutorials/area.md", "../scenarios.md", "../scenarios.md"),
        ("docs/tutorials/area.md", "tutorials/area.md", "../../README.md", "../index.md"),
        (
            "docs/sweeps.md",
            "sweeps.md",
            "../examples/missing.yaml",
            "../examples/missing.yaml",
        ),  # mkdocs refuses it
        ("docs/sweeps.md", "sweeps.md", "https://example.org/a.md", "https://example.org/a.md"),
        ("docs/sweeps.md", "sweeps.md", "#the-spec", "#the-spec"),
    ],
)
def test_links_lead_to_the_site_or_to_the_repository(source, page, link, on_the_site):
    assert hooks["with_links"](f"see [it]({link}).", source, page) == f"see [it]({on_the_site})."


def test_links_in_code_stay():
    code = "```python\nnames[0](docs/paper.md)\n```\n"
    assert hooks["with_links"](code, "README.md", "index.md") == code


@pytest.mark.parametrize(
    ("html", "fetched"),
    [
        ('<script src="https://cdn.example/x.js"></script>', True),
        ('<link rel="stylesheet" href="//fonts.example/css">', True),
        ('<img alt="x" src=https://example.org/x.png>', True),
        ('<a href="https://example.org">', False),
        ('<script src="assets/x.js"></script><img src="images/a.png">', False),
        ('<link rel="canonical" href="https://example.org/">', False),
    ],
)
def test_what_a_browser_would_fetch_is_seen(html, fetched):
    assert bool(hooks["LOADED"].search(html)) == fetched


def test_every_command_is_in_the_reference():
    page = hooks["command_reference"]()
    for command in ("run", "compare paper", "scenarios validate", "prior lost-person", "calibrate validate"):
        assert f"## skysweep {command}\n" in page
    assert "| `SCENARIO` | required | Name of a shipped scenario or path of a YAML file. |" in page
    assert "```bash\nskysweep run clusters\n" in page


def test_every_public_name_is_in_the_reference():
    page = (ROOT / "docs" / "reference" / "python.md").read_text("utf-8")
    missing = [
        name for name in ss.__all__ if f"::: skysweep.{name}\n" not in page and f"`{name}`" not in page
    ]
    assert missing == []
