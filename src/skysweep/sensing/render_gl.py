"""OpenGL renderer through EGL: Mesa's llvmpipe on a CPU, or a GPU where there is one.

Forward shading with one shadow map around the place looked at, four-sample anti-aliasing, frustum culling by
tiles, instanced plants. Colours are squared to approximate linear light and square-rooted at the end.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import moderngl
import numpy as np
from numpy.typing import NDArray

from skysweep.errors import UserError
from skysweep.geometry.camera import CameraPose, Lens
from skysweep.sensing.meshes import Mesh, merge
from skysweep.sensing.projection import View
from skysweep.sensing.scene import PLANT_TEXTURE_SCALE, Planting, Scene, Solid
from skysweep.sensing.textures import DETAIL_M, LAYER_PX, MACRO_M, MIDDLE_M

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

SAMPLES = 4
SHADOW_PX = 4096
SHADOW_SPANS_M = (64.0, 128.0, 320.0)  # widths of the shadow map on the ground, by how much is in sight
SOLID_TILE_M = 16.0
GROUND_TILE_M = 64.0
PLANT_DETAIL_PX = (12.0, 40.0)  # crown radii from which a plant is drawn finer

_LIGHT = """
uniform sampler2DShadow shadow_map; uniform vec3 sun_direction, sun_rgb, sky_rgb, ground_rgb, haze_rgb, eye;
uniform float haze_per_m;
in vec3 v_world, v_shadow;
out vec4 colour;
float sunlit() {
    if (any(greaterThan(abs(v_shadow), vec3(0.999)))) return 1.0;
    return texture(shadow_map, v_shadow * 0.5 + 0.5);
}
vec3 hazed(vec3 rgb) { return mix(haze_rgb, rgb, exp(-distance(eye, v_world) * haze_per_m)); }
"""

_FILM = """
vec4 film(vec3 light) { return vec4(sqrt(1.6 * light / (light + 1.3)), 1.0); }
"""

_GROUND_VS = """#version 330
uniform mat4 view_projection, shadow_matrix; uniform float shadow_bias_m;
in vec3 position, normal;
out vec3 v_world, v_shadow, v_normal;
void main() {
    v_world = position; v_normal = normal;
    v_shadow = (shadow_matrix * vec4(position + shadow_bias_m * normal, 1.0)).xyz;
    gl_Position = view_projection * vec4(position, 1.0);
}"""

_GROUND_FS = f"""#version 330
uniform sampler2D detail, middle, macro;
in vec3 v_normal;
{_LIGHT}{_FILM}
void main() {{
    vec3 albedo = 4.0 * texture(detail, v_world.xy / {DETAIL_M}).rgb
        * texture(middle, v_world.yx / {MIDDLE_M}).rgb * texture(macro, v_world.xy / {MACRO_M}).rgb;
    vec3 n = normalize(v_normal);
    vec3 light = sky_rgb + sun_rgb * (max(dot(n, sun_direction), 0.0) * sunlit());
    colour = film(hazed(albedo * albedo * light));
}}"""

_WATER_FS = f"""#version 330
uniform sampler2D detail, middle, macro; uniform float time_s;
in vec3 v_normal;
{_LIGHT}{_FILM}
void main() {{
    vec2 p = v_world.xy;
    vec3 a = texture(detail, p / 2.9 + time_s * vec2(0.11, 0.05)).xyz;
    vec3 b = texture(detail, p.yx / 11.7 + time_s * vec2(-0.031, 0.043)).xyz;
    vec3 c = texture(detail, p / 47.0 + time_s * vec2(0.017, -0.008)).xyz;
    vec2 slope = (a.xy - 0.5) * 0.32 + (b.xy - 0.5) * 0.42 + (c.xy - 0.5) * 0.40;
    float crest = b.z + c.z;
    vec3 n = normalize(vec3(-slope, 1.0));
    vec3 view = normalize(eye - v_world);
    float facing = clamp(dot(n, view), 0.0, 1.0);
    float fresnel = 0.02 + 0.98 * pow(1.0 - facing, 5.0);
    vec3 r = reflect(-view, n);
    float lit = sunlit();
    vec3 tint = 2.0 * texture(macro, p / {MACRO_M}).rgb;
    vec3 body = vec3(0.012, 0.052, 0.062) * tint * tint * (0.6 + 0.7 * crest);
    body *= sky_rgb * 1.6 + sun_rgb * lit * (0.35 + 0.65 * max(dot(n, sun_direction), 0.0));
    vec3 sky = mix(haze_rgb * 1.1, sky_rgb * vec3(0.45, 0.62, 0.9), clamp(r.z, 0.0, 1.0));
    float glint = pow(max(dot(r, sun_direction), 0.0), 90.0);
    float foam = texture(middle, p / {MIDDLE_M} + time_s * vec2(0.006, 0.004)).r * smoothstep(1.0, 1.3, crest);
    vec3 rgb = mix(body, sky, fresnel) + sun_rgb * glint * lit * 0.8;
    rgb = mix(rgb, 0.75 * (sky_rgb + sun_rgb * lit * 0.7), foam);
    colour = film(hazed(rgb));
}}"""

_SOLID_VS = """#version 330
uniform mat4 view_projection, shadow_matrix; uniform float shadow_bias_m;
in vec3 position, normal, texel; in vec4 tint; in float id;
out vec3 v_world, v_shadow, v_normal, v_texel, v_tint;
flat out float v_id;
void main() {
    v_world = position; v_normal = normal; v_texel = texel; v_tint = tint.rgb; v_id = id;
    v_shadow = (shadow_matrix * vec4(position + shadow_bias_m * normal, 1.0)).xyz;
    gl_Position = view_projection * vec4(position, 1.0);
}"""

_SOLID_FS = f"""#version 330
uniform sampler2DArray layers;
in vec3 v_normal, v_texel, v_tint;
{_LIGHT}{_FILM}
void main() {{
    vec3 albedo = v_tint * texture(layers, v_texel).rgb;
    vec3 n = normalize(v_normal);
    vec3 ambient = mix(ground_rgb, sky_rgb, 0.5 + 0.5 * n.z);
    vec3 light = ambient + sun_rgb * (max(dot(n, sun_direction), 0.0) * sunlit());
    colour = film(hazed(albedo * albedo * light));
}}"""

# Plants have many small triangles: they are lit at their vertices, which halves their cost.
_PLANT_VS = f"""#version 330
uniform mat4 view_projection, shadow_matrix; uniform float haze_per_m;
uniform sampler2DShadow shadow_map; uniform vec3 sun_direction, sun_rgb, sky_rgb, ground_rgb, eye;
in vec3 position, normal, texel; in vec4 tint;
in vec4 place; in vec3 shape;  // x, y, z, yaw; radius, height, shade
out vec4 v_light; out vec3 v_texel;
flat out float v_id;
void main() {{
    mat2 turn = mat2(cos(place.w), sin(place.w), -sin(place.w), cos(place.w));
    vec3 world = vec3(turn * position.xy * shape.x, position.z * shape.y) + place.xyz;
    vec3 n = normalize(vec3(turn * normal.xy / shape.x, normal.z / shape.y));
    vec3 q = (shadow_matrix * vec4(world + 0.25 * n, 1.0)).xyz;
    float lit = any(greaterThan(abs(q), vec3(0.999))) ? 1.0 : textureLod(shadow_map, q * 0.5 + 0.5, 0.0);
    vec3 light = mix(ground_rgb, sky_rgb, 0.5 + 0.5 * n.z) + sun_rgb * (max(dot(n, sun_direction), 0.0) * lit);
    vec3 albedo = tint.rgb * shape.z;
    v_light = vec4(albedo * albedo * light, exp(-distance(eye, world) * haze_per_m));
    v_texel = vec3(texel.xy * vec2(shape.x, 0.5 * (shape.x + shape.y)) * {PLANT_TEXTURE_SCALE}, texel.z);
    v_id = 0.0;
    gl_Position = view_projection * vec4(world, 1.0);
}}"""

_PLANT_FS = f"""#version 330
uniform sampler2DArray layers; uniform vec3 haze_rgb;
in vec4 v_light; in vec3 v_texel;
out vec4 colour;
{_FILM}
void main() {{
    vec3 t = texture(layers, v_texel).rgb;
    colour = film(mix(haze_rgb, t * t * v_light.rgb, v_light.a));
}}"""

_ID_FS = """#version 330
flat in float v_id;
out vec4 colour;
void main() { float k = floor(v_id + 0.5); colour = vec4(mod(k, 256.0), floor(k / 256.0), 0.0, 255.0) / 255.0; }"""

_GROUND_ID_FS = "#version 330\nout vec4 colour;\nvoid main() { colour = vec4(0.0); }"

_DEPTH_FS = "#version 330\nvoid main() {}"


class GLRenderer:
    """Draws a scene with OpenGL 3.3 without a window. Raises UserError where EGL is not available."""

    def __init__(self, scene: Scene) -> None:
        self._context = gl = _open_context()
        self._sun = scene.sun
        self._is_water = scene.surface == "water"
        self._low, self._high = scene.bounds_enu_m
        with gl:
            gl.gc_mode = "auto"
            gl.enable(gl.DEPTH_TEST | gl.CULL_FACE)
            gl.front_face = "cw"  # pictures are drawn top row first, which mirrors every triangle
            self._programs = _compile(gl, self._is_water)
            self._ground = _Tiles(gl, [_block(t) for t in _ground_tiles(scene.ground)])
            self._solids = _Tiles(gl, [_solid_block(t) for t in _solid_tiles(scene.solids)]) if scene.solids else None
            self._plants = [_Plants(gl, p) for p in scene.plantings]
            self._textures = _upload(gl, scene)
            self._shadow = gl.depth_texture((SHADOW_PX, SHADOW_PX))
            self._shadow.compare_func = "<="
            self._shadow_target = gl.framebuffer(depth_attachment=self._shadow)
            self._shadow_place: tuple[float, tuple[int, int]] | None = None
            self._targets: dict[tuple[int, int], _Target] = {}
            self._set_light()

    def close(self) -> None:
        """Free everything; the renderer is of no use afterwards."""
        self._context.release()

    def render(self, lens: Lens, pose: CameraPose, time_s: float = 0.0) -> NDArray[np.uint8]:
        """The picture (H, W, 3) RGB; see :class:`skysweep.sensing.render.Renderer`."""
        with self._context as gl:
            self._aim_shadow(lens, pose)
            target = self._target(lens)
            view = View.of(lens, pose)
            target.drawing.use()
            target.drawing.clear(*film(self._sun.haze_rgb))
            self._shadow.use(4)
            for name in ("ground", "solid", "plant"):
                _set(self._programs[name], view_projection=view.matrix, eye=pose.position_enu_m)
            if self._is_water:
                _set(self._programs["ground"], time_s=time_s)
            self._draw("", view)
            if target.drawing is not target.resolved:
                gl.copy_framebuffer(target.resolved, target.drawing)
            return target.read_rgb()

    def render_ids(self, lens: Lens, pose: CameraPose, occluders: bool = True) -> NDArray[np.int32]:
        """Which object each pixel shows (H, W); see :class:`skysweep.sensing.render.Renderer`."""
        with self._context:
            target = self._target(lens)
            view = View.of(lens, pose)
            target.resolved.use()
            target.resolved.clear(0.0, 0.0, 0.0, 0.0)
            for name in ("ground", "solid", "plant"):
                _set(self._programs[name + "_id"], view_projection=view.matrix)
            self._draw("_id", view, occluders)
            rgba = target.read_rgba().astype(np.int32)
        return np.asarray(rgba[..., 0] + 256 * rgba[..., 1])

    def _draw(self, suffix: str, view: View, occluders: bool = True) -> None:
        if self._solids is not None:
            self._solids.draw(self._programs["solid" + suffix], view)
        if occluders:
            for plants in self._plants:
                plants.draw(self._programs["plant" + suffix], view)
            self._ground.draw(self._programs["ground" + suffix], view)

    def _target(self, lens: Lens) -> _Target:
        size = (lens.width_px, lens.height_px)
        if size not in self._targets:
            self._targets[size] = _Target(self._context, size)
        return self._targets[size]

    def _set_light(self) -> None:
        sun = self._sun
        for name in ("ground", "solid", "plant"):
            _set(
                self._programs[name],
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

    def _aim_shadow(self, lens: Lens, pose: CameraPose) -> None:
        """Draw the shadow map again when the place looked at left the middle of the last one.

        The map moves in steps, so that a pose has the same shadows whatever was looked at before.
        """
        forward = pose.R_camera_to_enu[:, 2]
        reach = max(pose.position_enu_m[2] - self._low[2] - 1.0, 1.0) / max(-forward[2], 0.35)
        in_sight = 2.2 * reach * float(np.tan(lens.hfov_rad / 2))
        span = next((s for s in SHADOW_SPANS_M if s >= 1.3 * in_sight), SHADOW_SPANS_M[-1])
        step = span / 8
        centre = pose.position_enu_m[:2] + min(reach, 0.4 * span) * forward[:2]
        cell = (round(centre[0] / step), round(centre[1] / step))
        if (span, cell) == self._shadow_place:
            return
        self._shadow_place = (span, cell)
        matrix = _shadow_matrix(self._sun.direction_enu, np.array(cell) * step, span, self._low[2], self._high[2])
        for name in ("ground", "solid", "plant"):
            _set(self._programs[name], shadow_matrix=matrix, shadow_bias_m=0.01 + 0.7 * span / SHADOW_PX)
            _set(self._programs[name + "_depth"], view_projection=matrix)
        self._shadow_target.use()
        self._shadow_target.clear()
        self._draw("_depth", View(matrix, None, SHADOW_PX / span))


class _Target:
    """Frame buffers of one picture size."""

    def __init__(self, gl: moderngl.Context, size: tuple[int, int]) -> None:
        self.size = size
        self.resolved = gl.framebuffer([gl.renderbuffer(size, 4)], gl.depth_renderbuffer(size))
        samples = min(SAMPLES, gl.max_samples)
        self.drawing = self.resolved
        if samples > 1:
            self.drawing = gl.framebuffer(
                [gl.renderbuffer(size, 4, samples=samples)], gl.depth_renderbuffer(size, samples=samples)
            )

    def read_rgba(self) -> NDArray[np.uint8]:
        width, height = self.size
        return np.frombuffer(self.resolved.read(components=4), np.uint8).reshape(height, width, 4)

    def read_rgb(self) -> NDArray[np.uint8]:
        return np.asarray(cv2.cvtColor(self.read_rgba(), cv2.COLOR_RGBA2RGB))


@dataclass(frozen=True, slots=True)
class _Block:
    """Packed vertices, faces and a bounding sphere of what is culled together."""

    vertices: NDArray[Any]
    faces: NDArray[np.int32]
    centre: F64
    radius: float


_VERTEX = np.dtype([("p", "<f4", 3), ("n", "<f4", 3), ("c", "u1", 4), ("t", "<f4", 3), ("id", "<f4")])
_PLACE_FORMAT = ("4f 3f /i", "place", "shape")
_FORMAT = ("3f 3f 4f1 3f 1f", "position", "normal", "tint", "texel", "id")


def _block(mesh: Mesh, ids: F32 | None = None) -> _Block:
    packed = np.zeros(len(mesh.vertices), _VERTEX)
    packed["p"], packed["n"], packed["t"] = mesh.vertices, mesh.normals, mesh.texture
    packed["c"][:, :3] = np.round(mesh.colours * 255)
    packed["id"] = 0.0 if ids is None else ids
    low, high = mesh.vertices.min(0).astype(float), mesh.vertices.max(0).astype(float)
    return _Block(packed, mesh.faces, 0.5 * (low + high), 0.5 * float(np.linalg.norm(high - low)))


def _solid_block(solids: list[Solid]) -> _Block:
    ids = np.concatenate([np.full(len(s.mesh.vertices), s.id, np.float32) for s in solids])
    return _block(merge([s.mesh for s in solids]), ids)


def _solid_tiles(solids: tuple[Solid, ...]) -> list[list[Solid]]:
    tiles: dict[tuple[int, int], list[Solid]] = {}
    for solid in solids:
        x, y = solid.mesh.vertices[:, :2].mean(axis=0) // SOLID_TILE_M
        tiles.setdefault((int(x), int(y)), []).append(solid)
    return list(tiles.values())


def _ground_tiles(ground: Mesh) -> list[Mesh]:
    """The ground cut into squares, so that only those in sight are drawn."""
    centres = ground.vertices[ground.faces].mean(axis=1)[:, :2]
    cells = np.floor(centres / GROUND_TILE_M).astype(np.int64)
    _, group = np.unique(cells, axis=0, return_inverse=True)
    order = np.argsort(group.ravel(), kind="stable")
    edges = np.flatnonzero(np.diff(group.ravel()[order])) + 1
    tiles = []
    for faces in np.split(ground.faces[order], edges):
        used, index = np.unique(faces, return_inverse=True)
        tiles.append(
            Mesh(
                ground.vertices[used],
                ground.normals[used],
                ground.colours[used],
                ground.texture[used],
                index.reshape(-1, 3).astype(np.int32),
            )
        )
    return tiles


class _Tiles:
    """Blocks in one buffer, drawn when in sight."""

    def __init__(self, gl: moderngl.Context, blocks: list[_Block]) -> None:
        starts = np.cumsum([0] + [len(b.vertices) for b in blocks[:-1]])
        self._gl = gl
        self._vertices = gl.buffer(np.concatenate([b.vertices for b in blocks]).tobytes())
        faces = [b.faces + s for b, s in zip(blocks, starts, strict=True)]
        self._faces = gl.buffer(np.concatenate(faces).astype(np.int32).tobytes())
        counts = np.array([b.faces.size for b in blocks])
        self._counts = counts.tolist()
        self._firsts = np.concatenate([[0], np.cumsum(counts)[:-1]]).tolist()
        self._centres = np.stack([b.centre for b in blocks])
        self._radii = np.array([b.radius for b in blocks])
        self._arrays: dict[int, moderngl.VertexArray] = {}

    def draw(self, program: moderngl.Program, view: View) -> None:
        array = self._arrays.get(program.glo)
        if array is None:
            content = [_bound(program, self._vertices, _FORMAT)]
            array = self._arrays[program.glo] = self._gl.vertex_array(program, content, self._faces)
        for k in np.flatnonzero(view.sees(self._centres, self._radii)).tolist():
            array.render(vertices=self._counts[k], first=self._firsts[k])


class _Plants:
    """Copies of one unit mesh; those in sight are drawn, in as much detail as they need."""

    def __init__(self, gl: moderngl.Context, planting: Planting) -> None:
        self._gl = gl
        self._details = [
            (gl.buffer(b.vertices.tobytes()), gl.buffer(b.faces.tobytes()), gl.buffer(reserve=planting.places.nbytes))
            for b in map(_block, planting.meshes)
        ]
        self._places = planting.places
        height, radius = planting.places[:, 5].astype(float), planting.places[:, 4].astype(float)
        self._centres = planting.places[:, :3] + np.array([0, 0, 0.5]) * height[:, None]
        self._radii = np.hypot(0.55 * height, radius)
        self._arrays: dict[tuple[int, int], moderngl.VertexArray] = {}

    def draw(self, program: moderngl.Program, view: View) -> None:
        seen = np.flatnonzero(view.sees(self._centres, self._radii))
        if len(seen) == 0:
            return
        level = np.searchsorted(PLANT_DETAIL_PX, view.pixels(self._centres[seen], self._places[seen, 4]))
        for detail, (vertices, faces, instances) in enumerate(self._details):
            places = self._places[seen[level == detail]]
            if len(places) == 0:
                continue
            array = self._arrays.get((program.glo, detail))
            if array is None:
                content = [_bound(program, vertices, _FORMAT), _bound(program, instances, _PLACE_FORMAT)]
                array = self._gl.vertex_array(program, content, faces)
                self._arrays[(program.glo, detail)] = array
            instances.write(places.tobytes())
            array.render(instances=len(places))


def _bound(program: moderngl.Program, buffer: moderngl.Buffer, layout: tuple[str, ...]) -> tuple[Any, ...]:
    """A buffer with those attributes that the program kept; the rest becomes padding."""
    sizes = {"3f": "12x", "4f": "16x", "4f1": "4x", "1f": "4x"}
    rate = [f for f in layout[0].split() if f.startswith("/")]
    formats = [f for f in layout[0].split() if not f.startswith("/")]
    kept = [n in program for n in layout[1:]]
    text = " ".join([f if k else sizes[f] for f, k in zip(formats, kept, strict=True)])
    return (buffer, text + "".join(rate), *[n for n, k in zip(layout[1:], kept, strict=True) if k])


def _open_context() -> moderngl.Context:
    try:
        return moderngl.create_context(standalone=True, backend="egl", require=330)
    except Exception as error:  # glcontext raises bare Exception
        raise UserError(
            f"The OpenGL camera cannot start ({error}): install the system packages with  "
            "apt-get install libegl1 libgl1 libgl1-mesa-dri"
        ) from error


def _compile(gl: moderngl.Context, is_water: bool) -> dict[str, moderngl.Program]:
    programs = {}
    for name, vertex, fragment in (
        ("ground", _GROUND_VS, _WATER_FS if is_water else _GROUND_FS),
        ("solid", _SOLID_VS, _SOLID_FS),
        ("plant", _PLANT_VS, _PLANT_FS),
    ):
        programs[name] = gl.program(vertex, fragment)
        programs[name + "_id"] = gl.program(vertex, _GROUND_ID_FS if name == "ground" else _ID_FS)
        programs[name + "_depth"] = gl.program(vertex, _DEPTH_FS)
    return programs


def _upload(gl: moderngl.Context, scene: Scene) -> list[Any]:
    """Texture units 0-2: ground detail, middle, macro; 3: layers."""
    textures: list[Any] = []
    for image in (scene.ground_textures.detail, scene.ground_textures.middle, scene.ground_textures.macro):
        textures.append(gl.texture(image.shape[1::-1], 4, _rgba(image).tobytes()))
    size = (LAYER_PX, LAYER_PX, len(scene.layers))
    textures.append(gl.texture_array(size, 4, np.stack([_rgba(i) for i in scene.layers]).tobytes()))
    for texture in textures:
        texture.build_mipmaps()
        texture.filter = (moderngl.LINEAR_MIPMAP_LINEAR, moderngl.LINEAR)
    return textures


def _rgba(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2RGBA))


def film(light: F64) -> F64:
    """Linear light to sRGB 0..1 with a soft shoulder, as the shaders do it."""
    return np.asarray(np.sqrt(1.6 * light / (light + 1.3)))


def _set(program: moderngl.Program, **uniforms: Any) -> None:
    """Write those uniforms that the program kept."""
    for name, value in uniforms.items():
        if name not in program:
            continue
        if isinstance(value, np.ndarray):
            program[name].write(np.ascontiguousarray(value.T, dtype=np.float32).tobytes())  # type: ignore[union-attr]
        else:
            program[name] = value


def _shadow_matrix(sun: F64, centre_xy: F64, span_m: float, low_m: float, high_m: float) -> F64:
    """(4, 4) orthographic view from the sun of a square of ``span_m`` around a place on the ground."""
    right = np.cross([0.0, 0.0, 1.0], sun)
    right = right / np.linalg.norm(right) if np.linalg.norm(right) > 1e-6 else np.array([1.0, 0.0, 0.0])
    up = np.cross(sun, right)
    centre = np.array([*centre_xy, low_m])
    depth = 0.75 * span_m + (high_m - low_m) / max(sun[2], 0.05)
    m = np.eye(4)
    m[0, :3], m[1, :3], m[2, :3] = right, up, -sun
    m[:3, 3] = -m[:3, :3] @ centre
    return np.diag([2 / span_m, 2 / span_m, 1 / depth, 1.0]) @ m
