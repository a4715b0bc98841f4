"""Vertex buffers of the OpenGL renderer: blocks that are culled together and drawn in one call."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import moderngl
import numpy as np
from numpy.typing import ArrayLike, NDArray

from skysweep.arrays import F64, I32
from skysweep.worlds.meshes import Mesh, merge
from skysweep.worlds.rendering.projection import Projection
from skysweep.worlds.scene import Mover, Planting, Solid

SOLID_TILE_M = 16.0
_CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])  # of a box: low or high
PLANT_TILE_M = 64.0
PLANT_SHOWS_PX = 0.5  # crown radius from which a plant is drawn
PLANT_DETAIL_PX = (8.0, 40.0)  # crown radii from which a plant is drawn finer


@dataclass(frozen=True, slots=True)
class Block:
    """Packed vertices, faces and bounding box of triangles that are culled together."""

    vertices: NDArray[Any]
    faces: I32
    low: F64
    high: F64


_VERTEX = np.dtype([("p", "<f4", 3), ("n", "<f4", 3), ("c", "u1", 4), ("t", "<f4", 3), ("id", "<f4")])
_PLACE_LAYOUT = ("4f 3f /i", "place", "shape")
_LAYOUT = ("3f 3f 4f1 3f 1f", "position", "normal", "tint", "texel", "id")


def _block(mesh: Mesh, ids: ArrayLike = 0.0) -> Block:
    packed = np.zeros(len(mesh.vertices), _VERTEX)
    packed["p"], packed["n"], packed["t"] = mesh.vertices, mesh.normals, mesh.texture
    packed["c"][:, :3] = np.round(mesh.colours * 255)
    packed["c"][:, 3] = mesh.material
    packed["id"] = ids
    return Block(packed, mesh.faces, mesh.vertices.min(0).astype(float), mesh.vertices.max(0).astype(float))


def solid_blocks(solids: list[Solid]) -> list[Block]:
    """Solids packed with their neighbours, so that only blocks in sight are drawn."""
    tiles: dict[tuple[int, int], list[Solid]] = {}
    for solid in solids:
        x, y = solid.mesh.vertices[:, :2].mean(axis=0) // SOLID_TILE_M
        tiles.setdefault((int(x), int(y)), []).append(solid)
    return [
        _block(
            merge([s.mesh for s in tile]), np.concatenate([np.full(len(s.mesh.vertices), s.id) for s in tile])
        )
        for tile in tiles.values()
    ]


class Tiles:
    """Blocks in one buffer, drawn when in sight."""

    def __init__(self, gl: moderngl.Context, blocks: list[Block]) -> None:
        self._gl = gl
        self._counts = [b.faces.size for b in blocks]
        self._boxes = np.array([(b.low, b.high) for b in blocks]).reshape(-1, 2, 3)
        self._centres = self._boxes.mean(axis=1)
        self._radii = 0.5 * np.linalg.norm(self._boxes[:, 1] - self._boxes[:, 0], axis=1)
        if not blocks:
            return
        starts = np.cumsum([0] + [len(b.vertices) for b in blocks[:-1]])
        self._vertices = gl.buffer(np.concatenate([b.vertices for b in blocks]).tobytes())
        faces = [b.faces + s for b, s in zip(blocks, starts, strict=True)]
        self._faces = gl.buffer(np.concatenate(faces).astype(np.int32).tobytes())
        self._firsts = np.cumsum([0, *self._counts[:-1]]).tolist()
        self._arrays: dict[int, moderngl.VertexArray] = {}

    def draw(self, program: moderngl.Program, view: Projection) -> None:
        if not self._counts:
            return
        array = self._arrays.get(program.glo)
        if array is None:
            content = [bound(program, self._vertices, _LAYOUT)]
            array = self._arrays[program.glo] = self._gl.vertex_array(program, content, self._faces)
        for k in self._seen(view).tolist():
            array.render(vertices=self._counts[k], first=self._firsts[k])

    def corners(self, view: Projection) -> F64:
        """Corners (N, 3) of the bounding boxes of all blocks in sight."""
        return self._boxes[self._seen(view)][:, _CORNERS, range(3)].reshape(-1, 3)

    def _seen(self, view: Projection) -> NDArray[np.intp]:
        return np.flatnonzero(view.sees(self._centres, self._radii))


class Movers:
    """Objects that move: each in its part of one buffer, written anew where it is in sight."""

    def __init__(self, gl: moderngl.Context, movers: tuple[Mover, ...]) -> None:
        self._gl, self._movers = gl, movers
        if not movers:
            return
        blocks = [_block(m.mesh, m.id) for m in movers]
        self._radii = np.array([m.radius_m for m in movers])
        self._firsts = np.cumsum([0, *(len(b.vertices) for b in blocks)]).tolist()
        self._counts = [b.faces.size for b in blocks]
        self._first_faces = np.cumsum([0, *self._counts]).tolist()
        faces = np.concatenate([b.faces + s for b, s in zip(blocks, self._firsts, strict=False)])
        self._faces = gl.buffer(faces.astype(np.int32).tobytes())
        self._vertices = gl.buffer(reserve=self._firsts[-1] * _VERTEX.itemsize)
        self._written_s = [math.nan] * len(movers)
        self._arrays: dict[int, moderngl.VertexArray] = {}
        self.move(0.0)

    def move(self, time_s: float) -> None:
        """Have all where they are at this time."""
        if self._movers:
            self._time_s = time_s
            self._places = np.array([m.place(time_s) for m in self._movers])

    def is_in_sight(self, view: Projection) -> bool:
        return bool(self._movers) and len(self._seen(view)) > 0

    def corners(self, view: Projection) -> F64:
        """Corners (N, 3) of boxes that hold all in sight."""
        if not self._movers:
            return np.empty((0, 3))
        seen = self._seen(view)
        reach = (2.0 * _CORNERS - 1.0) * self._radii[seen, None, None]
        return np.asarray((self._places[seen, None] + reach).reshape(-1, 3))

    def draw(self, program: moderngl.Program, view: Projection) -> None:
        if not self._movers:
            return
        array = self._arrays.get(program.glo)
        if array is None:
            content = [bound(program, self._vertices, _LAYOUT)]
            array = self._arrays[program.glo] = self._gl.vertex_array(program, content, self._faces)
        for k in self._seen(view).tolist():
            if self._written_s[k] != self._time_s:
                packed = _block(self._movers[k].at(self._time_s), self._movers[k].id).vertices
                self._vertices.write(packed.tobytes(), self._firsts[k] * _VERTEX.itemsize)
                self._written_s[k] = self._time_s
            array.render(vertices=self._counts[k], first=self._first_faces[k])

    def _seen(self, view: Projection) -> NDArray[np.intp]:
        return np.flatnonzero(view.sees(self._places, self._radii))


class Plants:
    """Copies of one unit mesh; those in sight are drawn at the level of detail they need."""

    def __init__(self, gl: moderngl.Context, planting: Planting) -> None:
        self._gl = gl
        cells = np.floor(planting.places[:, :2] / PLANT_TILE_M)
        order = np.lexsort(cells.T)
        firsts = np.flatnonzero(np.r_[True, np.diff(cells[order], axis=0).any(axis=1)])
        self._places = planting.places[order]
        blocks, n_bytes = map(_block, planting.meshes), self._places.nbytes
        self._details = [
            (gl.buffer(b.vertices.tobytes()), gl.buffer(b.faces.tobytes()), gl.buffer(reserve=n_bytes))
            for b in blocks
        ]
        height, radius = self._places[:, 5].astype(float), self._places[:, 4].astype(float)
        self._centres = self._places[:, :3] + np.array([0, 0, 0.5]) * height[:, None]
        self._radii = np.hypot(0.55 * height, radius)
        self._low = np.minimum.reduceat(self._centres - self._radii[:, None], firsts)
        self._high = np.maximum.reduceat(self._centres + self._radii[:, None], firsts)
        self._in_cell = np.diff(np.r_[firsts, len(order)])
        self._arrays: dict[tuple[int, int], moderngl.VertexArray] = {}

    def is_in_sight(self, view: Projection) -> bool:
        return len(self._seen(view)) > 0

    def draw(self, program: moderngl.Program, view: Projection) -> None:
        seen = self._seen(view)
        radii_px = view.pixels(self._centres[seen], self._places[seen, 4])
        seen, radii_px = seen[radii_px >= PLANT_SHOWS_PX], radii_px[radii_px >= PLANT_SHOWS_PX]
        level = np.searchsorted(PLANT_DETAIL_PX, radii_px)
        for detail, (vertices, faces, instances) in enumerate(self._details):
            places = self._places[seen[level == detail]]
            if len(places) == 0:
                continue
            array = self._arrays.get((program.glo, detail))
            if array is None:
                content = [bound(program, vertices, _LAYOUT), bound(program, instances, _PLACE_LAYOUT)]
                array = self._gl.vertex_array(program, content, faces)
                self._arrays[(program.glo, detail)] = array
            instances.write(places.tobytes())
            array.render(instances=len(places))

    def _seen(self, view: Projection) -> NDArray[np.intp]:
        """Which of the plants in the cells in sight are in sight."""
        near = np.flatnonzero(np.repeat(view.sees_boxes(self._low, self._high), self._in_cell))
        return near[view.sees(self._centres[near], self._radii[near])]


def bound(program: moderngl.Program, buffer: moderngl.Buffer, layout: tuple[str, ...]) -> tuple[Any, ...]:
    """A buffer with the attributes that the program kept; the rest becomes padding."""
    sizes = {"3f": "12x", "4f": "16x", "4f1": "4x", "1f": "4x"}
    rate = [f for f in layout[0].split() if f.startswith("/")]
    formats = [f for f in layout[0].split() if not f.startswith("/")]
    kept = [n in program for n in layout[1:]]
    text = " ".join([f if k else sizes[f] for f, k in zip(formats, kept, strict=True)])
    return (buffer, text + "".join(rate), *[n for n, k in zip(layout[1:], kept, strict=True) if k])
