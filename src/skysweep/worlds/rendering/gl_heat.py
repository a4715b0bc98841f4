"""Shaders for temperatures (GLSL 3.30), and the frame buffers they draw into. Embree's are in embree_heat."""

from __future__ import annotations

import moderngl
import numpy as np

from skysweep.arrays import F32
from skysweep.worlds.heat import EXTINCTION_PER_M
from skysweep.worlds.materials import OF_SURFACE, Material
from skysweep.worlds.rendering.gl_shaders import COVER, GROUND_VS
from skysweep.worlds.scene import PLANT_TEXTURE_M, Scene
from skysweep.worlds.textures import DETAIL_M, MACRO_M, MIDDLE_M

_COARSEST = "99.0"  # level of a texture's mean

# Temperature without the sun of the past hour, what that adds in its light, and variation within the surface.
_PARTS = f"""
uniform vec4 heat_first[{len(Material)}], heat_past[{len(Material)}];  // Heat.table
uniform mat3x4 past_suns; uniform vec3 heat_sun;
vec3 parts(int material, vec3 n) {{
    vec4 first = heat_first[material];
    float past = dot(heat_past[material], max(past_suns * n, 0.0));
    return vec3(first.x + first.y * (0.5 + 0.5 * n.z) + past, first.z * max(dot(n, heat_sun), 0.0), first.w);
}}
"""

_SEEN = f"""
uniform sampler2DShadow shadow_map; uniform vec3 eye; uniform float air_c;
in vec3 v_world, v_shadow;
out vec4 colour;
void show(vec3 parts, float varies) {{
    bool off = any(greaterThan(abs(v_shadow), vec3(0.999)));
    float lit = off ? 1.0 : texture(shadow_map, v_shadow * 0.5 + 0.5);
    float seen_c = parts.x + parts.y * lit + parts.z * clamp(varies, -1.0, 1.0);
    colour = vec4(air_c + (seen_c - air_c) * exp(-distance(eye, v_world) * {EXTINCTION_PER_M}));
}}
"""

_GROUND_FS = f"""#version 330
uniform sampler2D detail, middle, macro; uniform int material;
in vec3 v_normal;
{_PARTS}{_SEEN}
void main() {{
    float large = texture(macro, v_world.xy / {MACRO_M}).g;
    float fine = 4.0 * large * texture(detail, v_world.xy / {DETAIL_M}).g
        * texture(middle, v_world.yx / {MIDDLE_M}).g;
    float varies = material == {int(Material.WATER)} ? 2.0 * large - 1.0
        : fine / textureLod(detail, vec2(0.0), {_COARSEST}).g - 1.0;
    show(parts(material, normalize(v_normal)), varies);
}}"""

_COVER_FS = f"""#version 330
uniform int materials[{len(OF_SURFACE)}];  // by code of the surface
in vec3 v_normal;
{_PARTS}{_SEEN}{COVER}
void main() {{
    float code = code_here();
    int material = materials[int(code + 0.5)];
    float large = scale(macros, v_world.xy / {MACRO_M}, code).g;
    float fine = 4.0 * large * scale(details, v_world.xy / {DETAIL_M}, code).g
        * scale(middles, v_world.yx / {MIDDLE_M}, code).g;
    float varies = material == {int(Material.WATER)} ? 2.0 * large - 1.0
        : fine / textureLod(details, vec3(0.0, 0.0, code), {_COARSEST}).g - 1.0;
    show(parts(material, normalize(v_normal)), varies);
}}"""

_SOLID_VS = f"""#version 330
uniform mat4 view_projection, shadow_matrix; uniform float shadow_bias_m;
in vec3 position, normal, texel; in vec4 tint;
out vec3 v_world, v_shadow, v_texel; centroid out vec3 v_parts;  // never extrapolated
{_PARTS}
void main() {{
    v_world = position; v_texel = texel;
    v_parts = parts(int(tint.a * 255.0 + 0.5), normal);
    v_shadow = (shadow_matrix * vec4(position + shadow_bias_m * normal, 1.0)).xyz;
    gl_Position = view_projection * vec4(position, 1.0);
}}"""

_PLANT_VS = f"""#version 330
uniform mat4 view_projection, shadow_matrix;
in vec3 position, normal, texel; in vec4 tint;
in vec4 place; in vec3 shape;  // x, y, z, yaw; radius, height, shade
out vec3 v_world, v_shadow, v_texel; centroid out vec3 v_parts;  // never extrapolated
{_PARTS}
void main() {{
    mat2 turn = mat2(cos(place.w), sin(place.w), -sin(place.w), cos(place.w));
    vec3 sized = position * shape.xxy;
    v_world = vec3(turn * sized.xy, sized.z) + place.xyz;
    vec3 n = normalize(vec3(turn * normal.xy / shape.x, normal.z / shape.y));
    v_shadow = (shadow_matrix * vec4(v_world + 0.25 * n, 1.0)).xyz;
    v_parts = parts(int(tint.a * 255.0 + 0.5), n);
    v_texel = vec3((sized.xy + sized.z * vec2(0.61, 0.73)) / {PLANT_TEXTURE_M}, texel.z);
    gl_Position = view_projection * vec4(v_world, 1.0);
}}"""

_TEXTURED_FS = f"""#version 330
uniform sampler2DArray layers;
in vec3 v_texel; centroid in vec3 v_parts;
{_SEEN}
void main() {{
    float mean = textureLod(layers, vec3(0.0, 0.0, v_texel.z), {_COARSEST}).g;
    show(v_parts, texture(layers, v_texel).g / mean - 1.0);
}}"""


def heat_programs(gl: moderngl.Context, scene: Scene) -> dict[str, moderngl.Program]:
    """Programs by the names of those for colours, with "_heat" behind; their temperatures are set."""
    ground = _COVER_FS if scene.covering else _GROUND_FS
    programs = {
        "ground_heat": gl.program(GROUND_VS, ground),
        "solid_heat": gl.program(_SOLID_VS, _TEXTURED_FS),
        "plant_heat": gl.program(_PLANT_VS, _TEXTURED_FS),
    }
    heat = scene.heat
    for program in programs.values():
        program["heat_first"].write(np.ascontiguousarray(heat.table[:, :4]).tobytes())  # type: ignore[union-attr]
        program["heat_past"].write(np.ascontiguousarray(heat.table[:, 4:]).tobytes())  # type: ignore[union-attr]
        columns = heat.past_suns_enu.T.astype(np.float32)
        program["past_suns"].write(np.ascontiguousarray(columns).tobytes())  # type: ignore[union-attr]
        program["heat_sun"] = tuple(heat.sun_enu.tolist())
        program["air_c"] = heat.air_c
    if scene.covering is None:
        programs["ground_heat"]["material"] = int(OF_SURFACE[scene.terrain.surface])
    else:
        materials = np.zeros(len(OF_SURFACE), np.int32)
        names = scene.covering.cover.names
        materials[: len(names)] = [OF_SURFACE[name] for name in names]
        programs["ground_heat"]["materials"].write(materials.tobytes())  # type: ignore[union-attr]
    return programs


class HeatTarget:
    """Frame buffers of one picture size for temperatures."""

    def __init__(self, gl: moderngl.Context, size: tuple[int, int], samples: int) -> None:
        self._size = size
        self._resolved = gl.framebuffer([gl.renderbuffer(size, 1, dtype="f4")])
        self.drawing = gl.framebuffer(
            [gl.renderbuffer(size, 1, samples=samples, dtype="f4")],
            gl.depth_renderbuffer(size, samples=samples),
        )

    def read(self, gl: moderngl.Context) -> F32:
        """(H, W), the mean of all samples."""
        gl.copy_framebuffer(self._resolved, self.drawing)
        width, height = self._size
        read = np.frombuffer(self._resolved.read(components=1, dtype="f4"), np.float32)
        return read.reshape(height, width).copy()
