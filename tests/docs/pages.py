"""The pages of the documentation and the code blocks on them."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[2]
PAGES = sorted(
    p.relative_to(ROOT)
    for p in [*(ROOT / "docs").rglob("*.md"), ROOT / "README.md", ROOT / "CONTRIBUTING.md"]
)
FENCE = re.compile(r"^( *)```(\S*)(?: title=\"([^\"]+)\")?$\n(.*?)^\1```$", re.MULTILINE | re.DOTALL)


class Block(NamedTuple):
    """A fenced block. ``title`` is what the page shows above it: a file's name, or why it is not run."""

    line: int
    language: str
    title: str
    text: str


def blocks(page: Path) -> Iterator[Block]:
    """The blocks of a page, in order."""
    text = (ROOT / page).read_text("utf-8")
    for found in FENCE.finditer(text):
        indent, language, title, body = found.groups()
        plain = re.sub(f"^{indent}", "", body, flags=re.MULTILINE)
        yield Block(text.count("\n", 0, found.start()) + 2, language, title or "", plain)
