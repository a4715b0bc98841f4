"""The ground in OpenGL: the chunks in sight, in one buffer and one call."""

from __future__ import annotations

from collections import OrderedDict

import moderngl
import numpy as np
from numpy.typing import NDArray

from skysweep.arrays import I32
from skysweep.worlds.ground_grid import CHUNK_POSTS, Chunks, GroundGrid
from skysweep.worlds.rendering.gl_batches import bound
from skysweep.worlds.rendering.projection import Projection

_HELD = 256  # chunks, at least
_POSTS = CHUNK_POSTS**2
_LAYOUT = ("3f 3f", "position", "normal")
_CHUNK_BYTES = _POSTS * 24


class Ground:
    """Draws a ``GroundGrid``; the posts of the chunks drawn last stay in memory."""

    def __init__(self, gl: moderngl.Context, grid: GroundGrid) -> None:
        self._gl = gl
        self._grid = grid
        self._faces = gl.buffer(reserve=_CHUNK_BYTES, dynamic=True)
        self._arrays: dict[int, moderngl.VertexArray] = {}
        self._vertices = gl.buffer(reserve=_HELD * _CHUNK_BYTES)
        self._room = _HELD
        self._held: OrderedDict[int, int] = OrderedDict()  # places of chunks, the longest unused first

    def draw(
        self, program: moderngl.Program, view: Projection, among: NDArray[np.bool_] | None = None
    ) -> None:
        """Draw the chunks in sight, of all or of those marked (C,)."""
        grid = self._grid
        low, high = grid.low_enu_m, grid.high_enu_m
        seen = view.sees_boxes(low, high)
        chunks = np.flatnonzero(seen if among is None else seen & among)
        if len(chunks) == 0:
            return
        spacing_px = view.pixels(view.nearest(low, high), np.full(len(low), grid.spacing_m))
        firsts = _POSTS * self._places(chunks)
        faces = np.concatenate(
            [f + first for f, first in zip(grid.faces(chunks, spacing_px), firsts, strict=True)],
            dtype=np.int32,
        )
        self._faces.orphan(faces.nbytes)
        self._faces.write(faces)
        array = self._arrays.get(program.glo)
        if array is None:
            content = [bound(program, self._vertices, _LAYOUT)]
            array = self._arrays[program.glo] = self._gl.vertex_array(program, content, self._faces)
        array.render(vertices=faces.size)

    def _make_room(self, chunks: int) -> None:
        """Room for that many chunks, all of it empty."""
        for array in self._arrays.values():
            array.release()
        self._vertices.release()
        self._arrays.clear()
        self._held.clear()
        self._vertices = self._gl.buffer(reserve=chunks * _CHUNK_BYTES)
        self._room = chunks

    def _places(self, chunks: Chunks) -> I32:
        """Where the chunks lie in the buffer; those missing are put there."""
        if len(chunks) > self._room:
            self._make_room(2 * len(chunks))
        places = np.empty(len(chunks), np.int32)
        for k in chunks.tolist():
            if k in self._held:
                self._held.move_to_end(k)
        for n, k in enumerate(chunks.tolist()):
            place = self._held.get(k)
            if place is None:
                place = len(self._held) if len(self._held) < self._room else self._held.popitem(last=False)[1]
                self._held[k] = place
                data = np.hstack(self._grid.posts(k)).astype(np.float32)
                self._vertices.write(data.tobytes(), offset=place * _CHUNK_BYTES)
            places[n] = place
        return places
