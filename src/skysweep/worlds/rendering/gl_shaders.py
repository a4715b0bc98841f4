"""The shaders of the OpenGL renderer (GLSL 3.30). The Embree renderer computes the same with Numba."""

from __future__ import annotations

from skysweep.worlds.scene import FINE_LEAST, FINE_MOST, PICTURE_LIGHT, PLANT_TEXTURE_M, STRAY, WANDER_M
from skysweep.worlds.textures import DETAIL_M, MACRO_M, MIDDLE_M

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

GROUND_VS = """#version 330
uniform mat4 view_projection, shadow_matrix; uniform float shadow_bias_m;
in vec3 position, normal;
out vec3 v_world, v_shadow, v_normal;
void main() {
    v_world = position; v_normal = normal;
    v_shadow = (shadow_matrix * vec4(position + shadow_bias_m * normal, 1.0)).xyz;
    gl_Position = view_projection * vec4(position, 1.0);
}"""

GROUND_FS = f"""#version 330
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

# ``a``, ``b``, ``c`` are waves of three scales, ``tint`` is the macro texture, ``streaks`` the middle one.
_WATER = """
vec3 water(vec3 a, vec3 b, vec3 c, vec3 tint, float streaks, float lit) {
    vec2 slope = (a.xy - 0.5) * 0.32 + (b.xy - 0.5) * 0.42 + (c.xy - 0.5) * 0.40;
    float crest = b.z + c.z;
    vec3 n = normalize(vec3(-slope, 1.0));
    vec3 view = normalize(eye - v_world);
    float facing = clamp(dot(n, view), 0.0, 1.0);
    float fresnel = 0.02 + 0.98 * pow(1.0 - facing, 5.0);
    vec3 r = reflect(-view, n);
    tint *= 2.0;
    vec3 body = vec3(0.012, 0.052, 0.062) * tint * tint * (0.6 + 0.7 * crest);
    body *= sky_rgb * 1.6 + sun_rgb * lit * (0.35 + 0.65 * max(dot(n, sun_direction), 0.0));
    vec3 sky = mix(haze_rgb * 1.1, sky_rgb * vec3(0.45, 0.62, 0.9), clamp(r.z, 0.0, 1.0));
    float glint = pow(max(dot(r, sun_direction), 0.0), 90.0);
    float foam = streaks * smoothstep(1.0, 1.3, crest);
    vec3 rgb = mix(body, sky, fresnel) + sun_rgb * glint * lit * 0.8;
    return mix(rgb, 0.75 * (sky_rgb + sun_rgb * lit * 0.7), foam);
}
"""

WATER_FS = f"""#version 330
uniform sampler2D detail, middle, macro; uniform float time_s;
in vec3 v_normal;
{_LIGHT}{_FILM}{_WATER}
void main() {{
    vec2 p = v_world.xy;
    vec3 a = texture(detail, p / 2.9 + time_s * vec2(0.11, 0.05)).xyz;
    vec3 b = texture(detail, p.yx / 11.7 + time_s * vec2(-0.031, 0.043)).xyz;
    vec3 c = texture(detail, p / 47.0 + time_s * vec2(0.017, -0.008)).xyz;
    vec3 tint = texture(macro, p / {MACRO_M}).rgb;
    float streaks = texture(middle, p / {MIDDLE_M} + time_s * vec2(0.006, 0.004)).r;
    colour = film(hazed(water(a, b, c, tint, streaks, sunlit())));
}}"""

# A ground with several surfaces, by the codes of the four cells around a place; borders stray from those of
# cells. A CPU computes all branches, so there are few: one surface a pixel; water, picture in other programs.
COVER = f"""
uniform sampler2DArray details, middles, macros;
uniform sampler2D wander, cover;
uniform vec4 cover_frame;  // west, south, cells a metre
uniform float water_code;
vec3 scale(sampler2DArray textures, vec2 uv, float code) {{ return texture(textures, vec3(uv, code)).rgb; }}
float code_here() {{
    vec2 q = (v_world.xy - cover_frame.xy) * cover_frame.zw - 0.5;
    vec2 strays = texture(wander, v_world.xy / {WANDER_M}).rg - 0.5;
    ivec2 cell = clamp(ivec2(floor(q)) + 1, ivec2(0), textureSize(cover, 0) - 1);
    vec4 codes = floor(texelFetch(cover, cell, 0) * 255.0 + 0.5);
    vec2 f = clamp(fract(q) + {STRAY} * strays, 0.0, 1.0);
    vec4 weights = vec4(1.0 - f.x, f.x, 1.0 - f.x, f.x) * vec4(1.0 - f.yy, f.yy);
    float most = 0.0, code = 0.0;
    for (int k = 0; k < 4; k++) {{
        float weight = dot(weights, vec4(equal(codes, vec4(codes[k]))));
        code = weight > most ? codes[k] : code;
        most = max(weight, most);
    }}
    return code;
}}
"""

_PICTURE = """
uniform sampler2DArray windows;
uniform float finest_m;  // the picture's own pixel
uniform vec4 frames[3];  // west, south, side, pixel in metres; no side: there is none
vec4 pictured(out float pixel_m) {
    vec3 at = vec3(0.0, 0.0, -1.0);
    vec2 dx = dFdx(v_world.xy), dy = dFdy(v_world.xy);
    pixel_m = 1.0;
    for (int k = 2; k >= 0; k--) {
        vec2 q = v_world.xy - frames[k].xy;
        vec2 within = abs(q - 0.5 * frames[k].z);
        bool inside = max(within.x, within.y) < 0.5 * frames[k].z - frames[k].w;
        at = inside ? vec3(q / frames[k].z, float(k)) : at;
        pixel_m = inside ? frames[k].w : pixel_m;
    }
    float seen_m = sqrt(max(dot(dx, dx), dot(dy, dy)));
    return at.z < 0.0 ? vec4(0.0) : textureLod(windows, at, log2(seen_m / pixel_m));
}
"""

COVER_FS = f"""#version 330
in vec3 v_normal;
{_LIGHT}{_FILM}{COVER}
void main() {{
    float code = code_here();
    vec3 albedo = 4.0 * scale(details, v_world.xy / {DETAIL_M}, code)
        * scale(middles, v_world.yx / {MIDDLE_M}, code) * scale(macros, v_world.xy / {MACRO_M}, code);
    vec3 light = sky_rgb + sun_rgb * (max(dot(normalize(v_normal), sun_direction), 0.0) * sunlit());
    colour = film(hazed(albedo * albedo * light));
}}"""

# The picture has the tones; the surface adds detail that is finer than the picture's pixels.
PICTURE_FS = f"""#version 330
in vec3 v_normal;
{_LIGHT}{_FILM}{COVER}{_PICTURE}
void main() {{
    float code = code_here(), pixel_m;
    vec4 seen = pictured(pixel_m);
    vec3 detail = scale(details, v_world.xy / {DETAIL_M}, code);
    vec3 albedo = 4.0 * detail
        * scale(middles, v_world.yx / {MIDDLE_M}, code) * scale(macros, v_world.xy / {MACRO_M}, code);
    float texels = max(pixel_m, finest_m) / {DETAIL_M} * float(textureSize(details, 0).x);
    vec3 coarse = textureLod(details, vec3(v_world.xy / {DETAIL_M}, code), log2(texels)).rgb;
    vec3 tone = seen.rgb / max(seen.a, 0.01), fine = clamp(detail / coarse, {FINE_LEAST}, {FINE_MOST});
    fine = code == water_code ? vec3(1.0) : fine;
    vec3 shown = 1.3 * tone * tone / ((1.6 - tone * tone) * {PICTURE_LIGHT}) * fine * fine;
    vec3 light = sky_rgb + sun_rgb * (max(dot(normalize(v_normal), sun_direction), 0.0) * sunlit());
    colour = film(hazed(mix(albedo * albedo, shown, seen.a) * light));
}}"""


def lake_shader(pictured: bool) -> str:
    """Draws the water of a cover over the ground, where the ground has no picture."""
    skip = "float pixel_m; if (pictured(pixel_m).a > 0.5) discard;" if pictured else ""
    return f"""#version 330
uniform float time_s;
in vec3 v_normal;
{_LIGHT}{_FILM}{_WATER}{COVER}{_PICTURE if pictured else ""}
void main() {{
    {skip}
    if (code_here() != water_code) discard;
    vec2 p = v_world.xy;
    vec3 a = scale(details, p / 2.9 + time_s * vec2(0.11, 0.05), water_code);
    vec3 b = scale(details, p.yx / 11.7 + time_s * vec2(-0.031, 0.043), water_code);
    vec3 c = scale(details, p / 47.0 + time_s * vec2(0.017, -0.008), water_code);
    vec3 tint = scale(macros, p / {MACRO_M}, water_code);
    float streaks = scale(middles, p / {MIDDLE_M} + time_s * vec2(0.006, 0.004), water_code).r;
    colour = film(hazed(water(a, b, c, tint, streaks, sunlit())));
}}"""


SOLID_VS = """#version 330
uniform mat4 view_projection, shadow_matrix; uniform float shadow_bias_m;
in vec3 position, normal, texel; in vec4 tint; in float id;
out vec3 v_world, v_shadow, v_normal, v_texel, v_tint;
flat out float v_id;
void main() {
    v_world = position; v_normal = normal; v_texel = texel; v_tint = tint.rgb; v_id = id;
    v_shadow = (shadow_matrix * vec4(position + shadow_bias_m * normal, 1.0)).xyz;
    gl_Position = view_projection * vec4(position, 1.0);
}"""

SOLID_FS = f"""#version 330
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
PLANT_VS = f"""#version 330
uniform mat4 view_projection, shadow_matrix; uniform float haze_per_m;
uniform sampler2DShadow shadow_map; uniform vec3 sun_direction, sun_rgb, sky_rgb, ground_rgb, eye;
in vec3 position, normal, texel; in vec4 tint;
in vec4 place; in vec3 shape;  // x, y, z, yaw; radius, height, shade
out vec4 v_light; out vec3 v_texel;
flat out float v_id;
void main() {{
    mat2 turn = mat2(cos(place.w), sin(place.w), -sin(place.w), cos(place.w));
    vec3 sized = position * shape.xxy;
    vec3 world = vec3(turn * sized.xy, sized.z) + place.xyz;
    vec3 n = normalize(vec3(turn * normal.xy / shape.x, normal.z / shape.y));
    vec3 q = (shadow_matrix * vec4(world + 0.25 * n, 1.0)).xyz;
    float lit = any(greaterThan(abs(q), vec3(0.999))) ? 1.0 : textureLod(shadow_map, q * 0.5 + 0.5, 0.0);
    vec3 light = mix(ground_rgb, sky_rgb, 0.5 + 0.5 * n.z);
    light += sun_rgb * (max(dot(n, sun_direction), 0.0) * lit);
    vec3 albedo = tint.rgb * shape.z;
    v_light = vec4(albedo * albedo * light, exp(-distance(eye, world) * haze_per_m));
    v_texel = vec3((sized.xy + sized.z * vec2(0.61, 0.73)) / {PLANT_TEXTURE_M}, texel.z);
    v_id = 0.0;
    gl_Position = view_projection * vec4(world, 1.0);
}}"""

PLANT_FS = f"""#version 330
uniform sampler2DArray layers; uniform vec3 haze_rgb;
in vec4 v_light; in vec3 v_texel;
out vec4 colour;
{_FILM}
void main() {{
    vec3 t = texture(layers, v_texel).rgb;
    colour = film(mix(haze_rgb, t * t * v_light.rgb, v_light.a));
}}"""

ID_FS = """#version 330
flat in float v_id;
out vec4 colour;
void main() {
    float k = floor(v_id + 0.5);
    colour = vec4(mod(k, 256.0), floor(k / 256.0), 0.0, 255.0) / 255.0;
}"""

GROUND_ID_FS = "#version 330\nout vec4 colour;\nvoid main() { colour = vec4(0.0); }"

DEPTH_FS = "#version 330\nvoid main() {}"
