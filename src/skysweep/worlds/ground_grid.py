"""The ground as a grid of posts in square chunks, each drawn as finely as a view needs, without cracks.

Geometrical mipmapping (de Boer, 2000): a chunk leaves out posts where they lie closer together than the
picture shows, and along its edges uses the posts of the coarser neighbour.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from skysweep.arrays import F32, F64, I32
from skysweep.worlds.meshes import Mesh, make_mesh
from skysweep.worlds.world import TerrainSurface

HORIZON_M = 4000.0  # the ground goes on flat this far beyond the world
CHUNK_CELLS = 32  # a side
CHUNK_POSTS = CHUNK_CELLS + 1
SPACING_PX = 2.0  # of posts in a picture: closer ones are left out
_LEVELS = 6  # the coarsest chunk is one cell
_FLAT_POSTS = 17  # a side, of level ground

Chunks = NDArray[np.intp]  # indices, row by row from the south-west
Edges = tuple[int, int, int, int]  # levels along the south, west, north and east edge


class GroundGrid:
    """The posts of a terrain and, beyond its edges, of flat ground to the horizon.

    ``low_enu_m`` and ``high_enu_m`` (C, 3) are the corners of the chunks' bounding boxes.
    """

    def __init__(self, terrain: TerrainSurface) -> None:
        self._terrain = terrain
        west, south, east, north = terrain.bounds_enu_m
        heights = (
            np.full((_FLAT_POSTS,) * 2, terrain.heights_m[0, 0]) if terrain.is_flat else terrain.heights_m
        )
        rows, columns = heights.shape
        far = np.array([HORIZON_M, 0.25 * HORIZON_M, 0.05 * HORIZON_M])
        self.x_m = np.concatenate([west - far, np.linspace(west, east, columns), east + far[::-1]])
        self.y_m = np.concatenate([south - far, np.linspace(south, north, rows), north + far[::-1]])
        self.spacing_m = max((east - west) / (columns - 1), (north - south) / (rows - 1))
        self._rows, self._columns = (-(-(len(a) - 1) // CHUNK_CELLS) for a in (self.y_m, self.x_m))
        low, high = _extremes(np.pad(heights, len(far), mode="edge"))
        y, x = (_ends(axis) for axis in (self.y_m, self.x_m))
        self.low_enu_m, self.high_enu_m = (
            np.stack([*np.meshgrid(x[k], y[k]), z], axis=-1).reshape(-1, 3) for k, z in enumerate((low, high))
        )

    def posts(self, chunk: int) -> tuple[F32, F32]:
        """Places and normals (CHUNK_POSTS ** 2, 3) of a chunk's posts; the last one is repeated beyond it."""
        i, j = divmod(chunk, self._columns)
        rows = np.clip(np.arange(-1, CHUNK_POSTS + 1) + i * CHUNK_CELLS, 0, len(self.y_m) - 1)
        columns = np.clip(np.arange(-1, CHUNK_POSTS + 1) + j * CHUNK_CELLS, 0, len(self.x_m) - 1)
        mesh = self._mesh(rows, columns)
        inner = np.s_[1:-1, 1:-1]
        shape = len(rows), len(columns), 3
        return mesh.vertices.reshape(shape)[inner].reshape(-1, 3), mesh.normals.reshape(shape)[inner].reshape(
            -1, 3
        )

    def faces(self, chunks: Chunks, spacing_px: F64) -> list[I32]:
        """Triangles (F, 3) of posts for each of ``chunks``.

        Neighbouring posts of chunk k span ``spacing_px[k]`` (C,) in the picture.
        """
        wanted = np.floor(np.log2(SPACING_PX / np.maximum(spacing_px, 1e-9)))
        levels = np.clip(wanted, 0, _LEVELS - 1).astype(int).reshape(self._rows, self._columns)
        around = np.pad(levels, 1, mode="edge")
        south, west, north, east = around[:-2, 1:-1], around[1:-1, :-2], around[2:, 1:-1], around[1:-1, 2:]
        edges = np.maximum(levels, np.stack([south, west, north, east])).reshape(4, -1)
        own = levels.ravel()
        return [chunk_faces(int(own[k]), tuple(edges[:, k].tolist())) for k in chunks]

    def mesh_of(self, chunks: Chunks, spacing_px: F64) -> Mesh:
        """The ``faces`` of ``chunks`` as one mesh."""
        posts = [self.posts(int(k)) for k in chunks]
        vertices, normals = (np.concatenate(values) for values in zip(*posts, strict=True))
        faces = [f + n * CHUNK_POSTS**2 for n, f in enumerate(self.faces(chunks, spacing_px))]
        white, nowhere = np.ones_like(vertices), np.zeros_like(vertices)
        unknown = np.zeros(len(vertices), np.uint8)  # the renderers know the surface of each place
        return Mesh(vertices, normals, white, nowhere, np.concatenate(faces).astype(np.int32), unknown)

    def mesh(self) -> Mesh:
        """All posts as one mesh; its faces are sorted row by row."""
        return self._mesh(np.arange(len(self.y_m)), np.arange(len(self.x_m)))

    def _mesh(self, rows: NDArray[np.int_], columns: NDArray[np.int_]) -> Mesh:
        X, Y = np.meshgrid(self.x_m[columns], self.y_m[rows])
        xy = np.column_stack([X.ravel(), Y.ravel()])
        vertices = np.column_stack([xy, self._terrain.height_m(xy)])
        return make_mesh(vertices, _grid_faces(len(rows), len(columns)), (1, 1, 1))


@lru_cache(maxsize=1024)
def chunk_faces(level: int, edges: Edges) -> I32:
    """Triangles (F, 3) of every 2 ** level-th post of a chunk; each edge keeps the posts of its own level."""
    kept = np.arange(0, CHUNK_POSTS, 2**level)
    rows, columns = (a.ravel() for a in np.meshgrid(kept, kept, indexing="ij"))
    r, c = rows.copy(), columns.copy()
    south, west, north, east = (2**edge for edge in edges)
    r = np.where(columns == 0, rows // west * west, np.where(columns == CHUNK_CELLS, rows // east * east, r))
    c = np.where(
        rows == 0, columns // south * south, np.where(rows == CHUNK_CELLS, columns // north * north, c)
    )
    faces = (r * CHUNK_POSTS + c)[_grid_faces(len(kept), len(kept))].astype(np.int32)
    a, b, d = faces.T
    return np.ascontiguousarray(faces[(a != b) & (b != d) & (d != a)])


@lru_cache(maxsize=64)
def _grid_faces(rows: int, columns: int) -> I32:
    """Two triangles a cell, row by row, counter-clockwise from above."""
    i, j = np.meshgrid(np.arange(rows - 1), np.arange(columns - 1), indexing="ij")
    a = (i * columns + j).ravel()
    first = np.column_stack([a, a + 1, a + columns + 1])
    second = np.column_stack([a, a + columns + 1, a + columns])
    return np.stack([first, second], axis=1).reshape(-1, 3).astype(np.int32)


def _extremes(heights: F64) -> tuple[F64, F64]:
    """Lowest and highest post of each chunk, edges included."""
    starts = [np.arange(0, n - 1, CHUNK_CELLS) for n in heights.shape]
    found = []
    for ufunc in (np.minimum, np.maximum):
        values = heights
        for axis, first in enumerate(starts):
            ends = np.take(values, np.minimum(first + CHUNK_CELLS, values.shape[axis] - 1), axis=axis)
            values = ufunc(ufunc.reduceat(values, first, axis=axis), ends)
        found.append(values)
    return found[0], found[1]


def _ends(axis_m: F64) -> tuple[F64, F64]:
    first = np.arange(0, len(axis_m) - 1, CHUNK_CELLS)
    return axis_m[first], axis_m[np.minimum(first + CHUNK_CELLS, len(axis_m) - 1)]
