"""What covers the ground in OpenGL: the textures of its surfaces, and the windows of its picture."""

from __future__ import annotations

from collections.abc import Sequence

import moderngl
import numpy as np
from numpy.typing import NDArray

from skysweep.geometry.camera import CameraPose, Lens
from skysweep.worlds.ground_grid import GroundGrid
from skysweep.worlds.rendering import gl_shaders as shaders
from skysweep.worlds.rendering.gl_textures import filtered, filtered_array
from skysweep.worlds.rendering.picture_windows import MOST_WINDOWS, PictureWindows, Window, window_px
from skysweep.worlds.scene import Covering
from skysweep.worlds.textures import border_noise
from skysweep.worlds.world import GroundCover

_FIRST_UNIT = 5  # of textures


class Cover:
    """The programs that draw a ground with surfaces or a picture: ``land``, and ``lake`` if it has water.

    ``wet`` marks the chunks (C,) of the grid with water.
    """

    def __init__(self, gl: moderngl.Context, covering: Covering, grid: GroundGrid) -> None:
        cover, looks = covering.cover, covering.textures
        self._gl = gl
        self._windows = PictureWindows(covering.picture) if covering.picture else None
        self._shown: tuple[Window, ...] = ()
        self._array: moderngl.TextureArray | None = None
        self.land = gl.program(shaders.GROUND_VS, shaders.PICTURE_FS if self._windows else shaders.COVER_FS)
        self.lake: moderngl.Program | None = None
        self.wet = np.zeros(len(grid.low_enu_m), bool)
        if "water" in cover.names:
            self.lake = gl.program(shaders.GROUND_VS, shaders.lake_shader(self._windows is not None))
            self.wet = _chunks_with(cover, cover.names.index("water"), grid)
        self._textures: dict[str, moderngl.Texture | moderngl.TextureArray] = {
            "details": filtered_array(gl, [look.detail for look in looks]),
            "middles": filtered_array(gl, [look.middle for look in looks]),
            "macros": filtered_array(gl, [look.macro for look in looks]),
            "wander": filtered(gl, border_noise()),
            "cover": _fours(gl, cover),
        }
        west, south, east, north = cover.bounds_enu_m
        rows, columns = cover.codes.shape
        self._frame = west, south, columns / (east - west), rows / (north - south)
        for program in self.programs:
            self.bind(program)
            if "water_code" in program:
                program["water_code"] = cover.names.index("water") if self.lake else -1.0
            if "windows" in program:
                program["windows"] = _FIRST_UNIT + len(self._textures)
            if "finest_m" in program and covering.picture:
                program["finest_m"] = covering.picture.pixel_m
        for unit, texture in enumerate(self._textures.values(), start=_FIRST_UNIT):
            texture.use(unit)

    @property
    def programs(self) -> Sequence[moderngl.Program]:
        return [self.land] if self.lake is None else [self.land, self.lake]

    def bind(self, program: moderngl.Program) -> None:
        """Let a program read the surfaces."""
        for unit, name in enumerate(self._textures, start=_FIRST_UNIT):
            if name in program:
                program[name] = unit
        program["cover_frame"] = self._frame

    def show(self, lens: Lens, pose: CameraPose, ground_m: float) -> None:
        """Let the programs show the parts of the picture that a view needs."""
        if self._windows is None:
            return
        windows = self._windows.of(lens, pose, ground_m)
        size_px = window_px(lens)
        if self._array is None or self._array.size[0] != size_px:
            if self._array is not None:
                self._array.release()
            self._array = self._gl.texture_array((size_px, size_px, MOST_WINDOWS), 4)
            self._array.filter = (moderngl.LINEAR_MIPMAP_LINEAR, moderngl.LINEAR)
            self._array.repeat_x = self._array.repeat_y = False
            self._array.use(_FIRST_UNIT + len(self._textures))
            self._shown = ()
        if windows == self._shown:
            return
        for k, window in enumerate(windows):
            self._array.write(window.rgba, viewport=(0, 0, k, size_px, size_px, 1))
        self._array.build_mipmaps()
        frames = np.zeros((MOST_WINDOWS, 4), np.float32)
        for frame, w in zip(frames, windows, strict=False):
            frame[:] = w.west_m, w.south_m, w.side_m, w.pixel_m
        for program in self.programs:
            program["frames"].write(frames.tobytes())  # type: ignore[union-attr]
        self._shown = windows


def _fours(gl: moderngl.Context, cover: GroundCover) -> moderngl.Texture:
    """The codes of the cells around each corner of cells: south-west, south-east, north-west, north-east."""
    padded = np.pad(cover.codes, 1, mode="edge")
    fours = np.stack([padded[:-1, :-1], padded[:-1, 1:], padded[1:, :-1], padded[1:, 1:]], axis=2)
    texture = gl.texture(fours.shape[1::-1], 4, np.ascontiguousarray(fours).tobytes())
    texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
    return texture


def _chunks_with(cover: GroundCover, code: int, grid: GroundGrid) -> NDArray[np.bool_]:
    """The chunks (C,) with, or next to, a cell of a code."""
    west, south, east, north = cover.bounds_enu_m
    rows, columns = cover.codes.shape
    cells = np.array([columns / (east - west), rows / (north - south)])
    last = [columns - 1, rows - 1]
    low = np.clip((grid.low_enu_m[:, :2] - (west, south)) * cells - 1, 0, last).astype(int)
    high = np.clip((grid.high_enu_m[:, :2] - (west, south)) * cells + 1, 0, last).astype(int)
    has = cover.codes == code
    return np.array([has[a : b + 1, c : d + 1].any() for (c, a), (d, b) in zip(low, high, strict=True)])
