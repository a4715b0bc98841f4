"""OpenGL renderer through EGL: a GPU, or Mesa's llvmpipe on a CPU.

Forward shading with one shadow map around the place looked at, four-sample anti-aliasing at edges, frustum
culling by tiles, instanced plants. Colours are squared to approximate linear light, and the square root is
taken at the end.
"""

from __future__ import annotations

import weakref
from typing import Any, Final

import cv2
import moderngl
import numpy as np

from skysweep.arrays import F32, F64, I32, U8
from skysweep.errors import UserError
from skysweep.geometry.camera import CameraPose, Lens, rays_enu
from skysweep.worlds.rendering import gl_shaders as shaders
from skysweep.worlds.rendering.gl_batches import Movers, Plants, Tiles, solid_blocks
from skysweep.worlds.rendering.gl_cover import Cover
from skysweep.worlds.rendering.gl_ground import Ground
from skysweep.worlds.rendering.gl_heat import HeatTarget, heat_programs
from skysweep.worlds.rendering.gl_textures import filtered, filtered_array
from skysweep.worlds.rendering.projection import Projection
from skysweep.worlds.scene import Scene

Rectangle = tuple[int, int, int, int]  # left, first row, width, height

_KINDS = ("ground", "solid", "plant")
SAMPLES = 4
SHADOW_PX = 4096
SHADOW_SPANS_M = (64.0, 128.0, 320.0, 1280.0)  # widths of the shadow map on the ground
_SHADOWED = (1.3, 1.3, 0.5, 0.0)  # of what is in sight: the least such span is used
_STEEP = 0.2  # descent of a line of sight that meets the ground well before the horizon
_RUGGED_SHARE = 0.5  # of the picture: above it, the whole picture is drawn with all samples


class GLRenderer:
    """A ``Renderer`` with OpenGL 3.3, without a window. Raises UserError if EGL is not available."""

    backend: Final = "gl"

    def __init__(self, scene: Scene) -> None:
        self._context = gl = _open_context()
        self._free = weakref.finalize(self, gl.release)  # frees everything in it; nothing is freed otherwise
        self._scene = scene
        self._sun = scene.sun
        self._terrain = scene.terrain
        self._low, self._high = scene.bounds_enu_m
        with gl:
            gl.enable(gl.DEPTH_TEST | gl.CULL_FACE)
            gl.front_face = "cw"  # pictures are drawn top row first, which mirrors every triangle
            self._cover = Cover(gl, scene.covering, scene.ground) if scene.covering else None
            self._programs = _compile(gl, scene.terrain.surface == "water", self._cover)
            self._objects = Tiles(gl, solid_blocks([s for s in scene.solids if s.id > 0]))
            self._movers = Movers(gl, scene.movers)
            self._buildings = Tiles(gl, solid_blocks([s for s in scene.solids if s.id == 0]))
            self._plants = [Plants(gl, p) for p in scene.plantings]
            self._ground = Ground(gl, scene.ground)
            self._textures = _upload(gl, scene)
            self._shadow = gl.depth_texture((SHADOW_PX, SHADOW_PX))
            self._shadow.compare_func = "<="
            self._shadow_target = gl.framebuffer(depth_attachment=self._shadow)
            self._shadow_of: tuple[float, tuple[int, int], float | None] | None = None
            self._targets: dict[tuple[int, int], _Target] = {}
            self._heat_targets: dict[tuple[int, int], HeatTarget] = {}
            lakes = [self._cover.lake] if self._cover and self._cover.lake else []
            self._lit = [*(self._programs[name] for name in _KINDS), *lakes]
            self._set_light()

    def close(self) -> None:
        self._free()

    def render(self, lens: Lens, pose: CameraPose, time_s: float = 0.0) -> U8:
        with self._context as gl:
            self._movers.move(time_s)
            self._aim_shadow(lens, pose, time_s)
            target = self._target(lens)
            view = Projection.of(lens, pose)
            self._shadow.use(4)
            for program in self._lit:
                _set(program, view_projection=view.matrix, eye=pose.position_enu_m, time_s=time_s)
            if self._cover is not None:
                self._cover.show(lens, pose, self._terrain.height_at_m(*pose.position_enu_m[:2]))
            rugged = self._rugged(lens, pose, view)
            if rugged != target.whole:
                target.resolved.use()
                target.resolved.clear()
                self._draw_ground(view)
            if rugged is not None:
                target.drawing.scissor = target.resolved.scissor = rugged
                target.drawing.use()
                target.drawing.clear(*film(self._sun.haze_rgb))
                self._draw("", view)
                gl.copy_framebuffer(target.resolved, target.drawing)
                target.resolved.scissor = target.whole
            return target.read_rgb()

    def render_heat_c(self, lens: Lens, pose: CameraPose, time_s: float = 0.0) -> F32:
        with self._context as gl:
            self._prepare_heat(gl)
            self._movers.move(time_s)
            self._aim_shadow(lens, pose, time_s)
            view = Projection.of(lens, pose)
            self._shadow.use(4)
            for name in _KINDS:
                _set(self._programs[name + "_heat"], view_projection=view.matrix, eye=pose.position_enu_m)
            size = (lens.width_px, lens.height_px)
            if size not in self._heat_targets:
                self._heat_targets[size] = HeatTarget(gl, size, min(SAMPLES, gl.max_samples))
            target = self._heat_targets[size]
            target.drawing.use()
            target.drawing.clear(self._scene.heat.sky_c)
            self._draw("_heat", view)
            return target.read(gl)

    def _prepare_heat(self, gl: moderngl.Context) -> None:
        """Compile the programs for temperatures when the first are wanted."""
        if "ground_heat" in self._programs:
            return
        programs = heat_programs(gl, self._scene)
        if self._cover is not None:
            self._cover.bind(programs["ground_heat"])
        for program in programs.values():
            _set(program, shadow_map=4, detail=0, middle=1, macro=2, layers=3)
        self._programs |= programs
        self._lit += programs.values()
        self._shadow_of = None

    def render_ids(self, lens: Lens, pose: CameraPose, occluders: bool = True, time_s: float = 0.0) -> I32:
        with self._context:
            self._movers.move(time_s)
            target = self._target(lens)
            view = Projection.of(lens, pose)
            target.resolved.use()
            target.resolved.clear(0.0, 0.0, 0.0, 0.0)
            for name in _KINDS:
                _set(self._programs[name + "_id"], view_projection=view.matrix)
            self._draw("_id", view, occluders)
            rgba = target.read_rgba().astype(np.int32)
        return np.asarray(rgba[..., 0] + 256 * rgba[..., 1])

    def _draw(self, suffix: str, view: Projection, occluders: bool = True) -> None:
        self._objects.draw(self._programs["solid" + suffix], view)
        self._movers.draw(self._programs["solid" + suffix], view)
        if occluders:
            self._buildings.draw(self._programs["solid" + suffix], view)
            for plants in self._plants:
                plants.draw(self._programs["plant" + suffix], view)
            if suffix:
                self._ground.draw(self._programs["ground" + suffix], view)
            else:
                self._draw_ground(view)

    def _draw_ground(self, view: Projection) -> None:
        self._ground.draw(self._programs["ground"], view)
        if self._cover is not None and self._cover.lake is not None:
            self._context.depth_func = "<="
            self._ground.draw(self._cover.lake, view, self._cover.wet)
            self._context.depth_func = "<"

    def _rugged(self, lens: Lens, pose: CameraPose, view: Projection) -> Rectangle | None:
        """The part of the picture that has edges.

        The rest is flat ground: one sample a pixel shows it as well as four (but for rounding) in two thirds
        of the time.
        """
        whole = (0, 0, lens.width_px, lens.height_px)
        if (
            not self._terrain.is_flat
            or any(plants.is_in_sight(view) for plants in self._plants)
            or rays_enu(lens, pose, lens.corners_px)[:, 2].max() > -_STEEP
        ):
            return whole
        edged = self._objects, self._movers, self._buildings
        corners = np.concatenate([things.corners(view) for things in edged])
        if len(corners) == 0:
            return None
        size_px = np.array(whole[2:])
        low, high = 0.5 * (view.frame(corners) + 1.0) * size_px
        low, high = np.maximum(np.floor(low) - 1, 0), np.minimum(np.ceil(high) + 1, size_px)
        if np.prod(high - low) > _RUGGED_SHARE * np.prod(size_px):
            return whole
        return int(low[0]), int(low[1]), int(high[0] - low[0]), int(high[1] - low[1])

    def _target(self, lens: Lens) -> _Target:
        size = (lens.width_px, lens.height_px)
        if size not in self._targets:
            self._targets[size] = _Target(self._context, size)
        return self._targets[size]

    def _set_light(self) -> None:
        sun = self._sun
        for program in self._lit:
            _set(
                program,
                sun_direction=sun.direction_enu,
                sun_rgb=sun.sun_rgb,
                sky_rgb=sun.sky_rgb,
                ground_rgb=sun.ground_rgb,
                haze_rgb=sun.haze_rgb,
                haze_per_m=3.912 / sun.visibility_m,  # Koschmieder: contrast of 2 % at the visibility
                shadow_map=4,
            )
        _set(self._programs["ground"], detail=0, middle=1, macro=2)
        _set(self._programs["solid"], layers=3)
        _set(self._programs["plant"], layers=3)
        for unit, texture in enumerate(self._textures):
            texture.use(unit)

    def _aim_shadow(self, lens: Lens, pose: CameraPose, time_s: float) -> None:
        """Redraw the shadow map when the place looked at has left the middle of the last one, or things move.

        The map moves in steps, so that the shadows of a pose do not depend on earlier poses.
        """
        eye, forward = pose.position_enu_m, pose.R_camera_to_enu[:, 2]
        reach = max(eye[2] - self._terrain.height_m(eye[:2])[0], 1.0) / max(-forward[2], 0.35)
        in_sight = 2.2 * reach * float(np.tan(lens.hfov_rad / 2))
        span = next(s for s, share in zip(SHADOW_SPANS_M, _SHADOWED, strict=True) if s >= share * in_sight)
        step = span / 8
        aim = eye[:2] + min(reach, 0.4 * span) * forward[:2]
        cell = (round(aim[0] / step), round(aim[1] / step))
        place = np.array(cell) * step
        centre = np.array([*place, self._terrain.height_m(place)[0]])
        matrix = _shadow_matrix(self._sun.direction_enu, centre, span, self._high[2] - self._low[2])
        view = Projection(matrix, None, SHADOW_PX / span)
        shadow_of = span, cell, time_s if self._movers.is_in_sight(view) else None
        if shadow_of == self._shadow_of:
            return
        self._shadow_of = shadow_of
        for program in self._lit:
            _set(program, shadow_matrix=matrix, shadow_bias_m=0.01 + 0.7 * span / SHADOW_PX)
        for name in _KINDS:
            _set(self._programs[name + "_depth"], view_projection=matrix)
        self._shadow_target.use()
        self._shadow_target.clear()
        self._draw("_depth", view)


class _Target:
    """Frame buffers of one picture size."""

    def __init__(self, gl: moderngl.Context, size: tuple[int, int]) -> None:
        self.size = size
        self.whole: Rectangle = (0, 0, *size)
        self.resolved = gl.framebuffer([gl.renderbuffer(size, 4)], gl.depth_renderbuffer(size))
        samples = min(SAMPLES, gl.max_samples)
        self.drawing = gl.framebuffer(
            [gl.renderbuffer(size, 4, samples=samples)], gl.depth_renderbuffer(size, samples=samples)
        )

    def read_rgba(self) -> U8:
        width, height = self.size
        return np.frombuffer(self.resolved.read(components=4), np.uint8).reshape(height, width, 4)

    def read_rgb(self) -> U8:
        return np.asarray(cv2.cvtColor(self.read_rgba(), cv2.COLOR_RGBA2RGB))


def gl_device() -> str:
    """The name of the device that OpenGL draws with. Raises UserError if EGL is not available."""
    context = _open_context()
    try:
        return str(context.info["GL_RENDERER"])
    finally:
        context.release()


def _open_context() -> moderngl.Context:
    try:
        return moderngl.create_context(require=330, standalone=True, **{"backend": "egl"})  # type: ignore[arg-type]
    except Exception as error:  # glcontext raises bare Exception
        raise UserError(
            f"The OpenGL camera cannot start ({error}): install the system packages with  "
            "apt-get install libegl1 libgl1 libgl1-mesa-dri"
        ) from error


def _compile(gl: moderngl.Context, is_water: bool, cover: Cover | None) -> dict[str, moderngl.Program]:
    programs = {}
    ground = shaders.WATER_FS if is_water else shaders.GROUND_FS
    for name, vertex, fragment, ids in (
        ("ground", shaders.GROUND_VS, ground, shaders.GROUND_ID_FS),
        ("solid", shaders.SOLID_VS, shaders.SOLID_FS, shaders.ID_FS),
        ("plant", shaders.PLANT_VS, shaders.PLANT_FS, shaders.ID_FS),
    ):
        programs[name] = gl.program(vertex, fragment)
        programs[name + "_id"] = gl.program(vertex, ids)
        programs[name + "_depth"] = gl.program(vertex, shaders.DEPTH_FS)
    if cover is not None:
        programs["ground"] = cover.land
    return programs


def _upload(gl: moderngl.Context, scene: Scene) -> list[Any]:
    """Texture units 0-2: ground detail, middle, macro; 3: layers."""
    ground = scene.ground_textures
    single = [filtered(gl, image) for image in (ground.detail, ground.middle, ground.macro)]
    return [*single, filtered_array(gl, list(scene.layers))]


def film(light: F64) -> F64:
    """Linear light to sRGB 0..1 with a soft shoulder, as the shaders do it."""
    return np.asarray(np.sqrt(1.6 * light / (light + 1.3)))


def _set(program: moderngl.Program, **uniforms: Any) -> None:
    """Write the uniforms that the program kept."""
    for name, value in uniforms.items():
        if name not in program:
            continue
        if isinstance(value, np.ndarray):
            program[name].write(np.ascontiguousarray(value.T, dtype=np.float32).tobytes())  # type: ignore[union-attr]
        else:
            program[name] = value


def _shadow_matrix(sun: F64, centre: F64, span_m: float, relief_m: float) -> F64:
    """(4, 4) orthographic view from the sun of a square of ``span_m`` around a place on the ground."""
    right = np.cross([0.0, 0.0, 1.0], sun)
    right = right / np.linalg.norm(right) if np.linalg.norm(right) > 1e-6 else np.array([1.0, 0.0, 0.0])
    up = np.cross(sun, right)
    depth = 0.75 * span_m + relief_m / max(sun[2], 0.05)
    m = np.eye(4)
    m[0, :3], m[1, :3], m[2, :3] = right, up, -sun
    m[:3, 3] = -m[:3, :3] @ centre
    return np.diag([2 / span_m, 2 / span_m, 1 / depth, 1.0]) @ m
