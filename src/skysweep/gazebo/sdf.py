"""SDF 1.6, which both Gazebos read, as element trees."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import ArrayLike

VERSION = "1.6"


def tag(name: str, content: object = None, /, *children: ET.Element, **attributes: str) -> ET.Element:
    """An element; ``content`` is its text: a string, a number, a flag or a row of numbers."""
    element = ET.Element(name, attributes)
    if content is not None:
        element.text = _text(content)
    element.extend(children)
    return element


def pose(position_m: ArrayLike = (0, 0, 0), roll_pitch_yaw_rad: ArrayLike = (0, 0, 0)) -> ET.Element:
    """A pose in the parent's frame."""
    return tag("pose", [*np.asarray(position_m, dtype=float), *np.asarray(roll_pitch_yaw_rad, dtype=float)])


def mesh(uri: str) -> ET.Element:
    """A geometry from a mesh file."""
    return tag("geometry", None, tag("mesh", None, tag("uri", uri)))


def static_model(name: str, parts: Iterable[ET.Element]) -> ET.Element:
    """A model that never moves, made of visuals and collisions."""
    return tag("model", None, tag("static", True), tag("link", None, *parts, name="link"), name=name)


def include(model: str, position_m: ArrayLike = (0, 0, 0)) -> ET.Element:
    """Places a model of the folder ``models`` in the world, under its own name."""
    return tag("include", None, tag("uri", f"model://{model}"), tag("name", model), pose(position_m))


def write_sdf(path: Path, content: ET.Element) -> None:
    """Writes one world or model."""
    _write_xml(path, tag("sdf", None, content, version=VERSION))


def write_model(folder: Path, model: ET.Element, description: str) -> None:
    """Writes ``model.sdf`` and ``model.config``; the folder's name is the model's."""
    write_sdf(folder / "model.sdf", model)
    config = tag(
        "model",
        None,
        tag("name", folder.name),
        tag("version", "1.0"),
        tag("sdf", "model.sdf", version=VERSION),
        tag("author", None, tag("name", "skysweep"), tag("email", "none")),
        tag("description", description),
    )
    _write_xml(folder / "model.config", config)


def _write_xml(path: Path, root: ET.Element) -> None:
    ET.indent(root)
    path.parent.mkdir(parents=True, exist_ok=True)
    ET.ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)


def _text(content: object) -> str:
    if isinstance(content, str):
        return content
    if isinstance(content, bool):
        return str(content).lower()
    return " ".join(f"{float(x):.9g}" for x in np.atleast_1d(np.asarray(content, dtype=float)))
