"""Land cover and orthophoto on rendered ground: both renderers show them, alike and where they are."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tests.worlds.geotiffs import over, placed, write

from skysweep.arrays import U8
from skysweep.geometry.camera import CameraPose, Lens
from skysweep.geometry.frames import rotation_camera_to_enu
from skysweep.results.figures import _ground_of
from skysweep.scenarios.model import Light
from skysweep.worlds.rasters import GroundPicture
from skysweep.worlds.rendering.from_above import ground_from_above
from skysweep.worlds.rendering.picture_windows import MOST_WINDOWS, PictureWindows, window_px
from skysweep.worlds.rendering.renderer import make_renderer
from skysweep.worlds.world import GroundCover, TerrainSurface, World, build_world

LENS = Lens(320, 180, 1.2)
BOUNDS = (-100.0, -100.0, 100.0, 100.0)
WEST, EAST = "sand", "water"
TONES = np.array([[150, 90, 60], [60, 100, 140]], np.uint8)  # of the picture's western and eastern half


def camera(x: float, y: float, z: float, pitch_rad: float = -np.pi / 2) -> CameraPose:
    return CameraPose(np.array([x, y, z]), rotation_camera_to_enu(np.pi / 2, pitch_rad))


def halves(picture: GroundPicture | None = None, heights_m: float = 0.0) -> World:
    """Sand in the west, a lake in the east."""
    codes = np.zeros((20, 20), np.uint8)
    codes[:, 10:] = 1
    heights = np.outer(np.ones(81), heights_m * np.sin(np.linspace(0, 9, 81)))
    terrain = TerrainSurface(heights, BOUNDS, "grass", GroundCover(codes, BOUNDS, (WEST, EAST)))
    return World(terrain, (), (), (), Light(), 3, picture)


@pytest.fixture(params=["gl", "embree"])
def backend(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture(scope="module")
def picture(tmp_path_factory: pytest.TempPathFactory) -> GroundPicture:
    """An orthophoto of 0.5 m around (0, 0), a quarter of it empty."""
    colours = np.zeros((4, 300, 300), np.uint8)
    colours[:3, :, :150], colours[:3, :, 150:] = TONES[0][:, None, None], TONES[1][:, None, None]
    colours[3] = 255
    colours[:, :150, :150] = 0  # the north-west
    path = tmp_path_factory.mktemp("picture") / "ortho.tif"
    transform = placed(0.5, (300, 300), middle_enu_m=(0.0, 0.0))
    ortho = write(path, colours, transform=transform, photometric="RGB", alpha="YES")
    square = [[-60, -60], [60, -60], [60, 60], [-60, 60]]
    found = build_world(over(area=square, orthophoto=ortho), 0).ground_picture
    assert found is not None
    return found


def mean(image: U8) -> np.ndarray:
    return image.reshape(-1, 3).mean(axis=0)


def test_each_surface_lies_where_its_cells_are(backend: str) -> None:
    seen = make_renderer(halves(), backend).render(LENS, camera(0, 0, 60)).astype(int)
    warm = (seen[..., 0] - seen[..., 2]).mean(axis=0)  # by column: sand is, water is not
    assert warm[:130].min() > 20
    assert warm[190:].max() < -20


def test_a_lake_moves_with_time_and_its_shore_does_not(backend: str) -> None:
    renderer = make_renderer(halves(), backend)
    before, after = (renderer.render(LENS, camera(0, 0, 60), t) for t in (0.0, 1.3))
    assert np.array_equal(before[:, :130], after[:, :130])
    assert np.abs(before[:, 190:].astype(int) - after[:, 190:]).mean() > 1


def test_the_picture_shows_its_tones_where_it_lies(backend: str, picture: GroundPicture) -> None:
    renderer = make_renderer(halves(picture), backend)
    bare = make_renderer(halves(), backend)
    for tone, place in zip(TONES, ((-30, -30), (30, -30)), strict=True):
        seen = mean(renderer.render(LENS, camera(*place, 25)))
        assert seen == pytest.approx(tone.astype(float), abs=22)
    outside = camera(-40, 40, 20)
    assert np.abs(renderer.render(LENS, outside).astype(int) - bare.render(LENS, outside)).mean() < 2


@pytest.mark.parametrize("heights_m", [0.0, 6.0])
@pytest.mark.parametrize("pictured", [False, True])
def test_both_renderers_agree_on_what_covers_the_ground(
    heights_m: float, pictured: bool, picture: GroundPicture
) -> None:
    world = halves(picture if pictured else None, heights_m)
    gl, embree = (make_renderer(world, b) for b in ("gl", "embree"))
    for pose in (camera(0, 0, 40), camera(-50, 20, 30, -0.9)):
        assert np.abs(gl.render(LENS, pose).astype(int) - embree.render(LENS, pose)).mean() < 5


def test_a_picture_of_covered_ground_does_not_depend_on_earlier_ones(
    backend: str, picture: GroundPicture
) -> None:
    world, pose = halves(picture, 4.0), camera(5, -10, 30)
    fresh = make_renderer(world, backend).render(LENS, pose)
    renderer = make_renderer(world, backend)
    for k in range(6):
        renderer.render(LENS, camera(60 - 20 * k, -40, 15 + 20 * k, -0.4 - 0.2 * k))
    assert np.array_equal(renderer.render(LENS, pose), fresh)


def test_windows_hold_what_a_view_sees_whatever_it_sees(picture: GroundPicture) -> None:
    windows = PictureWindows(picture)
    down = windows.of(LENS, camera(3, 4, 60), 0.0)
    assert len(down) == 1
    assert down[0].rgba.shape == (window_px(LENS), window_px(LENS), 4)
    half_m = 60 * np.tan(0.6)
    assert down[0].west_m < 3 - half_m < 3 + half_m < down[0].west_m + down[0].side_m
    assert len(windows.of(LENS, camera(0, 0, 60, -0.3), 0.0)) == MOST_WINDOWS


def test_maps_show_the_picture_north_up(picture: GroundPicture) -> None:
    world = halves(picture)
    above = ground_from_above(world, (-60.0, -60.0, 60.0, 60.0), (240, 240))
    for tone, columns in zip(TONES, (slice(20, 100), slice(140, 220)), strict=True):
        assert mean(above[140:220, columns]) == pytest.approx(tone.astype(float), abs=22)
    pale = _ground_of(world, (-60.0, 60.0, -60.0, 60.0))
    assert pale is not None
    size = len(pale)
    for tone, column in zip(TONES, (size // 4, 3 * size // 4), strict=True):
        shown = (pale[3 * size // 4, column].astype(float) - 0.45 * 255) / 0.55
        assert shown == pytest.approx(tone.astype(float), abs=3)
    assert np.abs(pale[size // 4, size // 4].astype(int) - pale[3 * size // 4, size // 4]).max() > 20


def test_plain_ground_has_no_picture_on_maps() -> None:
    flat = TerrainSurface(np.zeros((2, 2)), BOUNDS, "grass")
    assert _ground_of(World(flat, (), (), (), Light(), 3), (-60.0, 60.0, -60.0, 60.0)) is None


def test_raster_files_are_not_kept_open(picture: GroundPicture) -> None:
    before = len(list(Path("/proc/self/fd").iterdir()))
    renderer = make_renderer(halves(picture), "embree")
    for x in range(-40, 41, 20):
        renderer.render(LENS, camera(x, 0, 20))
    assert len(list(Path("/proc/self/fd").iterdir())) <= before + 1
