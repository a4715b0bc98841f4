"""Both renderers draw the same world, where the camera model says, and the same bytes every time."""

from __future__ import annotations

import hashlib
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skysweep.errors import UserError
from skysweep.geometry.camera import CameraPose, Lens, project
from skysweep.geometry.frames import rotation_camera_to_enu
from skysweep.scenarios.model import DEFAULT_POSE, DEFAULT_SIZE_M, Light
from skysweep.worlds.rendering.gl import GLRenderer
from skysweep.worlds.rendering.renderer import make_renderer
from skysweep.worlds.scene import make_sun
from skysweep.worlds.world import TerrainSurface, World, WorldBuilding, WorldObject, WorldTree

LENS = Lens(320, 180, 1.2)


def flat(surface: str = "grass", height_m: float = 0.0) -> TerrainSurface:
    return TerrainSurface(np.full((2, 2), height_m), (-60.0, -60.0, 60.0, 60.0), surface)


def thing(
    kind: str, x: float, y: float, z: float = 0.0, variant: int = 0, pose: str | None = None
) -> WorldObject:
    pose = pose or DEFAULT_POSE.get(kind, "face-up")
    return WorldObject(
        kind, np.array([x, y, z]), 0.4, DEFAULT_SIZE_M[kind], pose, kind == "stop sign", variant
    )


def world(
    *objects: WorldObject,
    terrain: TerrainSurface | None = None,
    trees: tuple[WorldTree, ...] = (),
    buildings: tuple[WorldBuilding, ...] = (),
    light: Light | None = None,
) -> World:
    return World(terrain or flat(), objects, trees, buildings, light or Light(), 3)


def camera(x: float, y: float, z: float, pitch_rad: float = -np.pi / 2, yaw_rad: float = 0.7) -> CameraPose:
    return CameraPose(np.array([x, y, z]), rotation_camera_to_enu(yaw_rad, pitch_rad))


TREE = WorldTree(np.array([4.0, 0.0, 0.0]), 6.0, 1.5, "broadleaf", 1)
HOUSE = WorldBuilding(np.array([-5.0, 6.0, 0.0]), (8.0, 6.0), 3.0, 0.3, 2)


@pytest.fixture(params=["gl", "embree"])
def backend(request: pytest.FixtureRequest) -> str:
    return str(request.param)


def test_an_object_appears_where_the_camera_model_projects_it(backend: str) -> None:
    signs = [
        thing("stop sign", 3.0, 2.0),
        thing("stop sign", -5.0, -1.0, variant=1),
        thing("stop sign", 0.5, -3.0),
    ]
    renderer = make_renderer(world(*signs), backend)
    for pose in (camera(0, 0, 15), camera(-8, -4, 9, -0.9, 0.3), camera(0, -12, 8, -0.6, 1.5)):
        ids = renderer.render_ids(LENS, pose)
        expected, _ = project(
            LENS, pose, np.stack([s.position_enu_m for s in signs]) + np.array([0, 0, 0.05])
        )
        for k, (u, v) in enumerate(expected, start=1):
            rows, columns = np.nonzero(ids == k)
            assert np.hypot(columns.mean() + 0.5 - u, rows.mean() + 0.5 - v) < 1.0


def test_an_object_spans_the_pixels_that_its_size_says(backend: str) -> None:
    lens = Lens(640, 360, 0.6)
    ids = make_renderer(world(thing("red round sign", 0, 0)), backend).render_ids(lens, camera(0, 0, 12))
    expected_px = np.pi / 4 * float(lens.pixels_on_target(0.6, 11.95)) ** 2
    assert np.count_nonzero(ids) == pytest.approx(expected_px, rel=0.05)


def test_a_tree_and_a_house_hide_what_is_under_them(backend: str) -> None:
    under_tree, under_roof, open_ground = (
        thing("stop sign", 4, 0),
        thing("person", -5, 6),
        thing("stop sign", 0, -4),
    )
    scene = world(under_tree, under_roof, open_ground, trees=(TREE,), buildings=(HOUSE,))
    renderer = make_renderer(scene, backend)
    pose = camera(4, 0, 25, yaw_rad=np.pi / 2)
    ids = renderer.render_ids(LENS, pose)
    bare = renderer.render_ids(LENS, pose, occluders=False)
    assert set(np.unique(ids)) == {0, 3}
    assert set(np.unique(bare)) == {0, 1, 2, 3}
    assert np.array_equal(ids == 3, bare == 3)


def test_a_sign_looks_red_on_grass(backend: str) -> None:
    renderer = make_renderer(world(thing("stop sign", 0, 0)), backend)
    image, ids = renderer.render(LENS, camera(0, 0, 4)), renderer.render_ids(LENS, camera(0, 0, 4))
    red = image[..., 0].astype(int) - image[..., 1]
    assert np.median(red[ids == 1]) > 60
    assert np.median(red[ids == 0]) < 10


def test_things_cast_shadows_away_from_the_sun(backend: str) -> None:
    light = Light(sun_elevation_deg=30, sun_heading_deg=90)  # from the east
    bare, planted = (make_renderer(world(trees=t, light=light), backend) for t in ((), (TREE,)))
    pose = camera(4 - 6.0, 0, 20, yaw_rad=np.pi / 2)
    loss = bare.render(LENS, pose).astype(int).sum(axis=2) - planted.render(LENS, pose).astype(int).sum(
        axis=2
    )
    west, east = loss[:, :160], loss[:, 200:]  # the crown itself is right of the middle, its shadow left
    assert np.count_nonzero(west > 60) > 300
    assert np.count_nonzero(west > 60) > 1.5 * np.count_nonzero(east > 60) - 400


def test_terrain_lifts_things_and_tilts_what_lies(backend: str) -> None:
    heights = np.tile(np.linspace(0, 30, 13), (13, 1))  # rises to the east, 1 in 4
    slope = TerrainSurface(heights, (-60.0, -60.0, 60.0, 60.0), "rock")
    sign = thing("red round sign", 10, 0, z=float(slope.height_m([(10, 0)])[0]))
    pose = camera(10, 0, 30)
    ids = make_renderer(world(sign, terrain=slope), backend).render_ids(LENS, pose)
    u, v = project(LENS, pose, sign.position_enu_m)[0][0]
    rows, columns = np.nonzero(ids == 1)
    assert np.hypot(columns.mean() + 0.5 - u, rows.mean() + 0.5 - v) < 1.0


def test_both_renderers_agree() -> None:
    scene = world(
        thing("stop sign", 0, 1),
        thing("person", 2, -1),
        thing("boat", -4, 0),
        trees=(TREE,),
        buildings=(HOUSE,),
    )
    gl, embree = (make_renderer(scene, b) for b in ("gl", "embree"))
    for pose in (camera(0, 0, 12), camera(0, -15, 9, -0.7)):
        difference = gl.render(LENS, pose).astype(int) - embree.render(LENS, pose)
        assert np.abs(difference).mean() < 5
        assert np.mean(gl.render_ids(LENS, pose) != embree.render_ids(LENS, pose)) < 0.005


@pytest.mark.parametrize("surface", ["grass", "forest floor", "rock", "sand", "snow", "water", "asphalt"])
def test_every_surface_has_detail_from_near_and_from_far(surface: str) -> None:
    renderer = make_renderer(world(terrain=flat(surface)), "gl")
    for altitude_m in (3.0, 12.0, 60.0):
        image = renderer.render(LENS, camera(0, 0, altitude_m)).astype(float)
        assert image.std(axis=(0, 1)).max() > 1.5
        assert 20 < image.mean() < 240


def test_water_moves_with_time_and_land_does_not() -> None:
    for surface, moves in (("water", True), ("sand", False)):
        renderer = make_renderer(world(terrain=flat(surface)), "gl")
        then, now = (renderer.render(LENS, camera(0, 0, 10), t) for t in (0.0, 2.0))
        assert np.array_equal(then, now) is not moves


SCENE = world(thing("stop sign", 0, 1), thing("boat", -4, 0, variant=1001), trees=(TREE,), buildings=(HOUSE,))


def digest(backend: str) -> str:
    renderer = make_renderer(SCENE, backend)
    poses = (camera(30, 0, 12), camera(0, 0, 12), camera(0, -15, 9, -0.7))
    return hashlib.sha256(b"".join(renderer.render(LENS, p, 1.5).tobytes() for p in poses)).hexdigest()


def test_the_same_bytes_in_this_and_in_another_process(backend: str) -> None:
    here = digest(backend)
    code = f"import sys; sys.path.insert(0, {str(__file__.rsplit('/', 1)[0])!r}); import test_render; "
    code += f"print(test_render.digest({backend!r}))"
    there = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout.split()[-1]
    assert here == digest(backend) == there


def test_a_picture_does_not_depend_on_what_was_looked_at_before() -> None:
    fresh, used = make_renderer(SCENE, "gl"), make_renderer(SCENE, "gl")
    for pose in (camera(40, 30, 80), camera(-30, 0, 5), camera(9, 0, 20)):
        used.render(LENS, pose)
    assert np.array_equal(fresh.render(LENS, camera(0, 0, 12)), used.render(LENS, camera(0, 0, 12)))


@pytest.mark.parametrize("surface", ["grass", "water"])
def test_edges_alone_are_smoothed_and_nothing_else_shows_it(
    surface: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = world(
        thing("stop sign", 2.0, 1.0, pose="standing"), thing("red bucket", -3.0, 1.0), terrain=flat(surface)
    )
    views = [camera(0, 0, 20), camera(2, 1, 4), camera(-40, 30, 10), camera(0, 0, 9, -1.2, 2.0)]
    views.append(camera(30, 0, 3, -0.2, np.pi))  # up to the horizon
    renderer = make_renderer(seen, "gl")
    pictures = [renderer.render(LENS, view) for view in views]
    monkeypatch.setattr(GLRenderer, "_rugged", lambda self, lens, pose, view: (0, 0, 320, 180))
    smoothed = [renderer.render(LENS, view) for view in views]
    assert any((a != b).any() for a, b in zip(pictures, smoothed, strict=True)), "one way only was tried"
    for a, b in zip(pictures, smoothed, strict=True):
        assert np.abs(a.astype(int) - b).max() <= 4


def test_an_unknown_backend_is_refused() -> None:
    with pytest.raises(UserError, match="auto, gl or embree"):
        make_renderer(world(), "vulkan")  # type: ignore[arg-type]


def test_without_egl_the_gl_backend_says_what_to_install_and_auto_falls_back() -> None:
    code = (
        "import moderngl, logging\n"
        "def refuse(**_): raise Exception('libEGL.so not found')\n"
        "moderngl.create_context = refuse\n"
        f"import sys; sys.path.insert(0, {str(__file__.rsplit('/', 1)[0])!r})\n"
        "from test_render import SCENE, make_renderer, UserError\n"
        "try: make_renderer(SCENE, 'gl')\n"
        "except UserError as e: print(e)\n"
        "print(type(make_renderer(SCENE)).__name__)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "apt-get install libegl1 libgl1 libgl1-mesa-dri" in done.stdout
    assert done.stdout.split()[-1] == "EmbreeRenderer"
    assert done.stderr.count("Falling back to Embree") == 1


@settings(max_examples=20)
@given(elevation=st.floats(3, 90), heading=st.floats(0, 359.9), visibility=st.floats(50, 20000))
def test_light_is_always_usable(elevation: float, heading: float, visibility: float) -> None:
    sun = make_sun(Light(sun_elevation_deg=elevation, sun_heading_deg=heading, visibility_m=visibility))
    assert np.linalg.norm(sun.direction_enu) == pytest.approx(1.0)
    for rgb in (sun.sun_rgb, sun.sky_rgb, sun.ground_rgb, sun.haze_rgb):
        assert np.isfinite(rgb).all()
        assert (rgb >= 0).all()
    level_ground = sun.sun_rgb * sun.direction_enu[2] + sun.sky_rgb
    assert 0.7 < level_ground.mean() < 2.5
