"""The building blocks of a report, and the self-contained HTML page made of them."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined

from skysweep import __version__

_MIME = {".png": "image/png", ".svg": "image/svg+xml", ".jpg": "image/jpeg"}


@dataclass(frozen=True, slots=True)
class Grid:
    """A table. The rows ``best`` stand out; ``words`` aligns all columns left."""

    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    caption: str = ""
    best: Sequence[int] = ()
    words: bool = False


@dataclass(frozen=True, slots=True)
class Picture:
    """An image as a data URI, with steps below its caption. A wide one gets a row of its own."""

    data_uri: str
    caption: str
    wide: bool = False
    steps: Sequence[tuple[str, str]] = ()


@dataclass(frozen=True, slots=True)
class Section:
    """One part of a report, in the order: paragraphs, steps, grids, pictures, verbatim text."""

    title: str
    paragraphs: Sequence[str] = ()
    steps: Sequence[tuple[str, str]] = ()
    grids: Sequence[Grid] = ()
    pictures: Sequence[Picture] = ()
    verbatim: str = ""
    folded: bool = False


def picture(path: Path, caption: str, wide: bool = False) -> Picture:
    """An image file as a picture."""
    return Picture(data_uri(path.read_bytes(), _MIME[path.suffix]), caption, wide)


def data_uri(content: bytes, kind: str) -> str:
    """The content of a file of this MIME type as a URI."""
    return f"data:{kind};base64,{base64.b64encode(content).decode('ascii')}"


def write_page(
    path: Path, title: str, lead: str, sections: Sequence[Section], tiles: Sequence[tuple[str, str]] = ()
) -> Path:
    """Write one HTML page that needs no other file and no network."""
    environment = Environment(
        loader=PackageLoader("skysweep.results.reporting", "."),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    page = environment.get_template("page.html.j2")
    html = page.render(title=title, lead=lead, tiles=tiles, sections=sections, version=__version__)
    path.write_text(html, encoding="utf-8")
    return path
