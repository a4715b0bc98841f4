"""Meshes as Wavefront OBJ with one material for each texture and colour; z is up, metres.

Gazebo has no vertex colours. A face gets the mean colour of its corners, rounded to keep the number of
materials small.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from skysweep.gazebo.look import GazeboLook
from skysweep.types import U8
from skysweep.worlds.meshes import Mesh

COLOUR_STEPS = 13  # levels of each colour channel


def write_mesh(folder: Path, name: str, mesh: Mesh, layers: U8, look: GazeboLook) -> None:
    """Writes ``name``.obj, its .mtl and the textures it uses into ``folder``.

    ``layers`` (L, H, W, 3) are the textures that the mesh's vertices name.
    """
    folder.mkdir(parents=True, exist_ok=True)
    colours = np.round(mesh.colours[mesh.faces].mean(axis=1) * COLOUR_STEPS).astype(np.int64)
    layer = mesh.texture[mesh.faces[:, 0], 2].astype(np.int64)
    kinds, kind_of = np.unique(np.column_stack([layer, colours]), axis=0, return_inverse=True)
    materials = []
    for index, (number, *colour) in enumerate(kinds.tolist()):
        image = layers[number]
        tint = look.tint(np.array(colour) / COLOUR_STEPS, image)
        plain = bool(image.min() == 255)
        materials.append(material(f"m{index}", tint, None if plain else f"layer{number}.png"))
        if not plain:
            write_picture(folder / f"layer{number}.png", look.texture(image))
    (folder / f"{name}.mtl").write_text("".join(materials))
    uv = mesh.texture[:, :2] * [1.0, -1.0]  # our textures start at the top
    write_obj(folder / f"{name}.obj", mesh, uv, kind_of.ravel())


def write_obj(path: Path, mesh: Mesh, uv: NDArray[np.floating], kind_of: NDArray[np.int_]) -> None:
    """Writes one mesh with texture coordinates (V, 2) and a material number (F,) for each face."""
    with path.open("w") as file:
        file.write(f"mtllib {path.stem}.mtl\no {path.stem}\n")
        for word, rows in (("v", mesh.vertices), ("vt", uv), ("vn", mesh.normals)):
            file.write(
                "".join(f"{word} " + " ".join(f"{x:.5f}" for x in row) + "\n" for row in rows.tolist())
            )
        for kind in np.unique(kind_of).tolist():
            file.write(f"usemtl m{kind}\n")
            faces = (mesh.faces[kind_of == kind] + 1).tolist()
            file.write("".join(f"f {a}/{a}/{a} {b}/{b}/{b} {c}/{c}/{c}\n" for a, b, c in faces))


def material(name: str, colour: NDArray[np.float64], picture: str | None) -> str:
    """A matt material in MTL syntax."""
    rgb = " ".join(f"{c:.4f}" for c in colour)
    texture = f"map_Kd {picture}\n" if picture else ""
    return f"newmtl {name}\nKa {rgb}\nKd {rgb}\nKs 0 0 0\nNs 0\nd 1\nillum 1\n{texture}"


def write_picture(path: Path, image: U8) -> None:
    """Writes an RGB picture (H, W, 3) as PNG. Unlike OpenCV's own writer it raises OSError."""
    _, png = cv2.imencode(".png", cv2.cvtColor(image, cv2.COLOR_RGB2BGR))
    path.write_bytes(png.tobytes())
