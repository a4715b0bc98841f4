"""Temperatures by material, sun and weather, and both renderers' pictures of them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skysweep.geometry.camera import CameraPose, Lens, project
from skysweep.geometry.frames import rotation_camera_to_enu
from skysweep.scenarios.model import Light, PathMotion, Wind
from skysweep.worlds.heat import Heat, heat_of
from skysweep.worlds.materials import Material
from skysweep.worlds.motion import Placing, track_of
from skysweep.worlds.rendering.renderer import make_renderer
from skysweep.worlds.world import GroundCover, TerrainSurface, World, WorldBuilding, WorldObject, WorldTree

LENS = Lens(320, 256, 0.554)
BOUNDS = (-60.0, -60.0, 60.0, 60.0)
NIGHT = Light(sun_elevation_deg=-20, sun_heading_deg=345, air_temperature_c=8.0)
DAY = Light(sun_elevation_deg=50, sun_heading_deg=180, air_temperature_c=20.0)
UP = (0.0, 0.0, 1.0)


def level_c(heat: Heat, material: Material, lit: bool = True, normal: tuple[float, ...] = UP) -> float:
    base, recent, _ = heat.parts(np.array([material]), np.array([normal], np.float32))[0]
    return float(base + recent * lit)


def at(light: Light, wind_mps: float = 2.0) -> Heat:
    return heat_of(light, wind_mps, 60.45)


def test_at_night_bodies_and_what_stores_heat_are_warm_and_what_does_not_is_cold() -> None:
    c = {m: level_c(at(NIGHT), m) for m in Material}
    assert 20 < c[Material.SKIN] < 32
    assert 2 < c[Material.CLOTHES] - c[Material.GRASS] < 10
    assert c[Material.SHORT_COAT] > c[Material.COAT] > c[Material.FLEECE] > c[Material.ROOF]
    assert c[Material.ROCK] > c[Material.GRASS] + 3
    assert c[Material.ASPHALT] > c[Material.GRASS] + 2
    assert c[Material.ROOF] < c[Material.GRASS] < c[Material.WALL]
    assert abs(c[Material.LEAVES] - NIGHT.air_temperature_c) < 4


def test_by_day_the_sun_heats_dry_and_dark_things_most() -> None:
    c = {m: level_c(at(DAY), m) for m in Material}
    assert (
        c[Material.ROOF] > c[Material.ASPHALT] > c[Material.ROCK] > c[Material.GRASS] > DAY.air_temperature_c
    )
    assert 35 < c[Material.ASPHALT] < 60
    assert abs(c[Material.WATER] - DAY.air_temperature_c) < 5
    assert level_c(at(DAY), Material.SNOW) <= 0.0


def test_rock_keeps_the_warmth_of_the_day_longer_than_sand() -> None:
    evening, morning = (
        at(Light(sun_elevation_deg=-3, sun_heading_deg=heading, air_temperature_c=12))
        for heading in (310, 50)
    )
    for material, least, most in ((Material.ROCK, 0.0, 12.0), (Material.SAND, -8.0, 0.0)):
        assert least < level_c(evening, material) - 12.0 < most
    assert level_c(evening, Material.ROCK) > level_c(morning, Material.ROCK) + 1


def test_a_wall_in_the_sun_is_warmer_than_one_that_faces_away() -> None:
    south, north = (level_c(at(DAY), Material.WALL, normal=(0.0, y, 0.0)) for y in (-1.0, 1.0))
    assert south > north + 4


def test_wind_and_clouds_take_contrast_away() -> None:
    calm, windy = (level_c(at(NIGHT, wind_mps=w), Material.CLOTHES) for w in (0.5, 8.0))
    assert calm > windy + 1
    clear, cloudy = (
        at(Light(sun_elevation_deg=50, sun_heading_deg=180, air_temperature_c=20, cloud_cover=c))
        for c in (0.0, 1.0)
    )
    assert level_c(clear, Material.ASPHALT) > level_c(cloudy, Material.ASPHALT) + 10


@given(
    st.floats(-90, 90),
    st.floats(0, 359),
    st.floats(-40, 50),
    st.floats(0, 1),
    st.floats(0, 25),
    st.floats(-90, 90),
)
def test_temperatures_are_always_those_of_this_world(
    elevation: float, heading: float, air_c: float, cloud: float, wind_mps: float, latitude_deg: float
) -> None:
    light = Light(
        sun_elevation_deg=elevation, sun_heading_deg=heading, air_temperature_c=air_c, cloud_cover=cloud
    )
    heat = heat_of(light, wind_mps, latitude_deg)
    for material in Material:
        for normal in (UP, (1.0, 0.0, 0.0), (0.0, 0.0, -1.0)):
            assert min(air_c - 40, 0.0) <= level_c(heat, material, normal=normal) < air_c + 90


def person(
    x: float, y: float, kind: str = "person", size_m: float = 1.75, walks: bool = False
) -> WorldObject:
    track = None
    if walks:
        motion = PathMotion(kind="path", waypoints_enu_m=[(x + 20, y)], speed_mps=1.0)
        area = np.array([0])  # unused by a path
        track = track_of(motion, Placing(x, y, 0.4), Wind(), area, np.random.default_rng(0))
    return WorldObject(kind, np.array([x, y, 0.0]), 0.4, size_m, "lying", kind == "person", 5, None, track)


def scene(light: Light, terrain: TerrainSurface | None = None) -> World:
    terrain = terrain or TerrainSurface(np.zeros((2, 2)), BOUNDS, "grass")
    objects = (
        person(0, 0),
        person(-3, 2, "rock", 1.0),
        person(3, -2, "sheep", 1.2),
        person(-2, -3, walks=True),
    )
    tree = WorldTree(np.array([5.0, 3.0, 0.0]), 6.0, 1.5, "broadleaf", 1)
    house = WorldBuilding(np.array([-9.0, 7.0, 0.0]), (8.0, 6.0), 3.0, 0.3, 2)
    return World(terrain, objects, (tree,), (house,), light, 3)


def covered() -> TerrainSurface:
    codes = np.zeros((20, 20), np.uint8)
    codes[:, 10:] = 1
    heights = np.outer(np.ones(61), 2.0 * np.sin(np.linspace(0, 9, 61)))
    return TerrainSurface(heights, BOUNDS, "grass", GroundCover(codes, BOUNDS, ("rock", "water")))


def looking(x: float, y: float, z: float, pitch_rad: float = -np.pi / 2) -> CameraPose:
    return CameraPose(np.array([x, y, z]), rotation_camera_to_enu(0.7, pitch_rad))


@pytest.mark.parametrize(("light", "mean_k"), [(NIGHT, 0.15), (DAY, 0.5)])
@pytest.mark.parametrize("terrain", [None, covered()], ids=["flat", "covered"])
def test_both_renderers_agree(light: Light, mean_k: float, terrain: TerrainSurface | None) -> None:
    gl, embree = (make_renderer(scene(light, terrain), b) for b in ("gl", "embree"))
    for pose in (looking(0, 0, 30), looking(-12, -18, 12, -0.6)):
        a, b = (r.render_heat_c(LENS, pose, 2.0) for r in (gl, embree))
        assert a.shape == b.shape == (256, 320)
        assert a.dtype == b.dtype == np.float32
        assert np.median(np.abs(a - b)) < 0.1
        assert np.abs(a - b).mean() < mean_k
    gl.close()


@pytest.mark.parametrize("backend", ["gl", "embree"])
def test_a_person_at_night_is_warm_where_the_camera_model_says(backend: str) -> None:
    world, pose = scene(NIGHT), looking(1, -1, 30)
    renderer = make_renderer(world, backend)  # type: ignore[arg-type]
    picture = renderer.render_heat_c(LENS, pose)
    ids = renderer.render_ids(LENS, pose)
    (u, v), _ = (a[0] for a in project(LENS, pose, np.array([0.0, 0.0, 0.1])))
    assert ids[int(v), int(u)] == 1
    ground = np.median(picture[ids == 0])
    assert np.median(picture[ids == 1]) > ground + 3
    assert picture[ids == 1].max() > ground + 8  # head and hands
    renderer.render(LENS, pose)
    assert np.array_equal(renderer.render_heat_c(LENS, pose), picture)


@pytest.mark.parametrize("backend", ["gl", "embree"])
def test_above_the_horizon_is_the_cold_sky(backend: str) -> None:
    renderer = make_renderer(scene(NIGHT), backend)  # type: ignore[arg-type]
    picture = renderer.render_heat_c(LENS, looking(0, 0, 30, 0.3))
    assert picture[0] == pytest.approx(at(NIGHT).sky_c, abs=0.01)
    assert at(NIGHT).sky_c < NIGHT.air_temperature_c - 10
