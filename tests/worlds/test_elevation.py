"""Elevation models as they come: the ground is right, or one sentence says what is wrong."""

import math
import re
import resource
import time

import numpy as np
import pyproj
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.worlds.geotiffs import AREA, LATITUDE_DEG, over, placed, rasterio, slope, write

from skysweep.errors import UserError
from skysweep.planning.advice import warnings_for_plan
from skysweep.worlds.world import build_terrain, elevation_of

SIZE = (120, 140)
NO_DATUM = "+proj=tmerc +lon_0=24 +k=1 +x_0=500000 +ellps=intl +units=m"
PLACES = np.array([[0.0, 0.0], [10.0, 390.0], [300.0, 200.0], [599.0, 1.0], [571.0, 333.0]])


def heights_in_file(scenario, transform, crs, of_pixel, xy=PLACES):
    """The height ENU above that at home of places, found with rasterio's own transformation."""
    geodetic = scenario.frame.geodetic_from_enu(np.column_stack([xy, np.zeros(len(xy))]))
    x, y = rasterio.warp.transform("EPSG:4326", crs, geodetic[:, 1], geodetic[:, 0])
    t = transform
    columns, rows = np.linalg.solve([[t.a, t.b], [t.d, t.e]], [np.array(x) - t.c, np.array(y) - t.f])
    amsl = of_pixel(columns, rows)
    geodetic[:, 2] = amsl - amsl[0] + scenario.home.altitude_amsl_m
    return scenario.frame.enu_from_geodetic(geodetic)[:, 2], amsl[0]


def plane(column, row):
    return 100.0 + 0.3 * column - 0.2 * row


@pytest.mark.parametrize(
    ("crs", "pixel", "turned_deg", "upside_down"),
    [
        ("EPSG:3067", 10.0, 0.0, False),
        ("EPSG:32635", 10.0, 0.0, True),
        ("EPSG:4326", 1 / 7200, 0.0, False),
        ("EPSG:3857", 25.0, 0.0, False),
        ("EPSG:3067", 10.0, 33.0, False),
        ("EPSG:2180", 9.0, -120.0, True),
    ],
)
def test_any_projection_and_position(tmp_path, crs, pixel, turned_deg, upside_down):
    transform = placed(pixel, SIZE, crs, turned_deg, upside_down)
    scenario = over(dem=write(tmp_path / "dem.tif", slope(SIZE), crs, transform))
    expected, home_amsl_m = heights_in_file(scenario, transform, crs, plane)
    np.testing.assert_allclose(build_terrain(scenario).height_m(PLACES), expected, atol=0.02)
    elevation = elevation_of(scenario)
    assert elevation.home_amsl_m == pytest.approx(home_amsl_m, abs=0.02)
    assert elevation.notes == ()


def test_heights_above_the_ellipsoid_are_refused(tmp_path):
    dem = write(tmp_path / "dem.tif", slope(SIZE), "EPSG:4979", placed(1 / 7200, SIZE, "EPSG:4326"))
    with pytest.raises(UserError, match=r"heights above the ellipsoid, up to 100 m off .* gdalwarp"):
        elevation_of(over(dem=dem))


@settings(max_examples=40)
@given(
    latitude_deg=st.floats(-70, 70),
    longitude_deg=st.floats(-179, 179),
    pixel_m=st.floats(3, 40),
    turned_deg=st.floats(-180, 180),
    upside_down=st.booleans(),
    kind=st.sampled_from(["utm", "degrees", "mercator"]),
    slopes=st.tuples(st.floats(-0.9, 0.9), st.floats(-0.9, 0.9)),
)
def test_anywhere_on_earth(
    tmp_path_factory, latitude_deg, longitude_deg, pixel_m, turned_deg, upside_down, kind, slopes
):
    zone = int((longitude_deg + 180) // 6) + 1
    crs = {
        "utm": f"EPSG:{32600 + zone + (100 if latitude_deg < 0 else 0)}",
        "degrees": "EPSG:4326",
        "mercator": "EPSG:3857",
    }[kind]
    stretch = 1.0 / math.cos(math.radians(latitude_deg))
    pixel = {"utm": pixel_m, "degrees": pixel_m / 111_320 * stretch, "mercator": pixel_m * stretch}[kind]
    size = (math.ceil(1500 / pixel_m),) * 2
    if kind == "degrees":
        size = (math.ceil(1500 / pixel_m * stretch),) * 2
    home = (latitude_deg, longitude_deg)
    transform = placed(pixel, size, crs, turned_deg, upside_down, home=home)
    path = tmp_path_factory.mktemp("dem") / "dem.tif"
    scenario = over(home, dem=write(path, slope(size, *slopes, 4000.0), crs, transform))
    expected, _ = heights_in_file(
        scenario, transform, crs, lambda column, row: 4000.0 + slopes[0] * column + slopes[1] * row
    )
    np.testing.assert_allclose(build_terrain(scenario).height_m(PLACES), expected, atol=0.05)


@pytest.mark.parametrize("marked", ["nodata", "nan", "nothing"])
def test_small_holes_are_interpolated_and_said(tmp_path, marked):
    heights = slope(SIZE)
    heights[50:55, 60:65] = np.nan if marked == "nan" else -9999.0
    nodata = -9999.0 if marked == "nodata" else None
    transform = placed(10.0, SIZE)
    scenario = over(dem=write(tmp_path / "dem.tif", heights, transform=transform, nodata=nodata))
    whole = over(dem=write(tmp_path / "whole.tif", slope(SIZE), transform=transform))
    filled, true = build_terrain(scenario), build_terrain(whole)
    assert np.abs(filled.heights_m - true.heights_m).max() < 1.0
    (note,) = elevation_of(scenario).notes
    assert "has no height" in note
    assert "interpolated" in note


def test_another_band_does_not_fill_a_hole(tmp_path):
    """Where any band had a value, the hole's own number was taken for ground, 200 m below the true one."""
    heights = np.stack([slope(SIZE), np.ones(SIZE, np.float32)])
    heights[0, 50:70, 60:80] = -99.0
    dem = write(tmp_path / "two.tif", heights, transform=placed(10.0, SIZE), nodata=-99.0)
    with pytest.raises(UserError, match="has a hole at the area"):
        build_terrain(over(dem=dem))


@pytest.mark.parametrize(
    ("crs", "bounds"),
    [
        ("EPSG:4326", (-180.0, -90.0, 180.0, 90.0)),
        ("EPSG:4326", (0.0, -90.0, 360.0, 90.0)),
        ("EPSG:3857", (-2.0037e7, -2.0037e7, 2.0037e7, 2.0037e7)),
        ("ESRI:54008", (-2.0037e7, -1.0e7, 2.0037e7, 1.0e7)),
    ],
)
@pytest.mark.parametrize("home", [(61.0, 25.0), (-43.5, 171.0), (10.0, -75.0)])
def test_a_map_of_the_world_covers_every_area(tmp_path, crs, bounds, home):
    west, south, east, north = bounds
    rows, columns = 360, 720
    world = rasterio.Affine((east - west) / columns, 0.0, west, 0.0, (south - north) / rows, north)
    scenario = over(home, dem=write(tmp_path / "w.tif", np.full((rows, columns), 50.0), crs, world))
    assert np.ptp(build_terrain(scenario).heights_m) < 0.1
    (note,) = elevation_of(scenario).notes
    assert "has a height every" in note
    assert "hills between them are not known" in note


@pytest.mark.parametrize("longitude_deg", [180.0, 179.9999, -179.9999])
def test_a_crs_that_ends_within_the_area_is_refused(tmp_path, longitude_deg):
    """Mercator at the 180th meridian, where the area fell apart into pieces half a world away."""
    world = rasterio.Affine(4.0e7 / 720, 0.0, -2.0037e7, 0.0, -4.0e7 / 360, 2.0037e7)
    dem = write(tmp_path / "w.tif", np.full((360, 720), 50.0), "EPSG:3857", world)
    with pytest.raises(UserError, match=r"its CRS ends within the area.*another CRS"):
        build_terrain(over((-16.75, longitude_deg), dem=dem))


def test_half_a_world_away_is_that_far_away(tmp_path):
    rows, columns = 90, 360
    north = rasterio.Affine(1.0, 0.0, -180.0, 0.0, -1.0, 90.0)
    dem = write(tmp_path / "north.tif", np.full((rows, columns), 50.0), "EPSG:4326", north)
    with pytest.raises(UserError, match=r"does not overlap the area, 48\d\d\.\d km away"):
        build_terrain(over((-43.5, 171.0), dem=dem))


def test_large_holes_in_the_area_are_refused(tmp_path):
    heights = slope(SIZE)
    heights[50:70, 60:80] = np.nan
    scenario = over(dem=write(tmp_path / "dem.tif", heights, transform=placed(10.0, SIZE)))
    with pytest.raises(UserError, match=r"^terrain\.dem: .*dem\.tif: has a hole at the area, 2\d\d m wide"):
        build_terrain(scenario)


def test_large_holes_beside_the_area_are_no_matter(tmp_path):
    heights = slope((140, 160))
    heights[:, 136:] = np.nan  # from 560 m on from the raster's middle, which is at [0, 200]
    transform = placed(10.0, (140, 160), middle_enu_m=(0.0, 200.0))
    area = [[0, 0], [500, 0], [500, 400], [0, 400]]
    scenario = over(area=area, dem=write(tmp_path / "dem.tif", heights, transform=transform))
    assert np.isfinite(build_terrain(scenario).heights_m).all()


@pytest.mark.parametrize("unit", ["ft", "US survey foot", "dem_unit", "crs"])
def test_feet(tmp_path, unit):
    feet = slope(SIZE) / np.float32(0.3048)
    crs = "EPSG:3067"
    if unit == "crs":  # a compound one with heights in US survey feet
        crs = rasterio.CRS.from_wkt(pyproj.CRS("EPSG:3067+6360").to_wkt())
    told = {"dem_unit": "feet"} if unit == "dem_unit" else {}
    named = unit if unit in ("ft", "US survey foot") else None
    dem = write(tmp_path / "dem.tif", feet, crs, placed(10.0, SIZE), unit=named)
    metres = over(dem=write(tmp_path / "metres.tif", slope(SIZE), transform=placed(10.0, SIZE)))
    np.testing.assert_allclose(
        build_terrain(over(dem=dem, **told)).heights_m, build_terrain(metres).heights_m, atol=0.01
    )


def test_heights_that_nobody_can_read_are_refused(tmp_path):
    home = (44.95, -93.2)  # Minneapolis, in a state plane of feet
    transform = placed(30.0, SIZE, "EPSG:26851", home=home)
    feet = write(tmp_path / "feet.tif", slope(SIZE), "EPSG:26851", transform)
    scenario = over(home, dem=feet)
    with pytest.raises(
        UserError, match=r"lies in feet and does not say .* write terrain\.dem_unit \(--dem-unit\)$"
    ):
        build_terrain(scenario)
    build_terrain(over(home, dem=feet, dem_unit="feet"))
    odd = write(tmp_path / "odd.tif", slope(SIZE), transform=placed(10.0, SIZE), unit="fathom")
    with pytest.raises(
        UserError, match=r"has heights in 'fathom'; .* write terrain\.dem_unit \(--dem-unit\)$"
    ):
        build_terrain(over(dem=odd))


def test_smaller_than_the_area_is_refused_by_how_much(tmp_path):
    dem = write(
        tmp_path / "dem.tif", slope((60, 50)), transform=placed(10.0, (60, 50), middle_enu_m=(250, 200))
    )
    with pytest.raises(
        UserError, match=r"ends 1\d\d m short of the area and lacks [12]\d\.\d% of it; give a "
    ):
        build_terrain(over(dem=dem))


def test_home_beside_it_is_said(tmp_path):
    dem = write(tmp_path / "dem.tif", slope(SIZE), transform=placed(10.0, SIZE))
    away = {"latitude_deg": LATITUDE_DEG, "longitude_deg": 25.0, "position_enu_m": [-900.0, 0.0]}
    with pytest.raises(UserError, match=r"ends 5\d\d m short of home; give a larger one, or move home$"):
        build_terrain(over(dem=dem, others={"home": away}))


def test_a_home_that_was_forgotten_is_said(tmp_path):
    dem = write(tmp_path / "dem.tif", slope(SIZE), transform=placed(10.0, SIZE))
    with pytest.raises(
        UserError, match=r"or write home's latitude_deg and longitude_deg \(now 60\.449, 22\.2966"
    ):
        build_terrain(over(dem=dem, others={"home": {}}))


def with_zeros(level_m, step_m=0.3):
    heights = slope(SIZE, step_m, -step_m / 2, level_m)
    heights[30:60, 40:80] = 0.0
    return heights


def test_zeros_amid_high_ground_are_refused(tmp_path):
    dem = write(tmp_path / "dem.tif", with_zeros(800.0), transform=placed(10.0, SIZE))
    sentence = (
        r"dem\.tif: \d\d\.\d% of the ground is exactly 0 amid heights of 8\d\d m and more; "
        r"mark missing heights with  rio edit-info --nodata 0 dem\.tif$"
    )
    with pytest.raises(UserError, match=sentence):
        build_terrain(over(dem=dem))


def test_zeros_that_may_be_water_below_a_cliff_are_said(tmp_path):
    dem = write(tmp_path / "dem.tif", with_zeros(80.0), transform=placed(10.0, SIZE))
    (note,) = elevation_of(over(dem=dem)).notes
    assert re.search(
        r"is exactly 0 amid heights of \d\d m and more; unless that is water, mark missing", note
    )


def test_the_sea_is_no_hole(tmp_path):
    heights = np.maximum(slope(SIZE, 1.0, 0.0, -50.0), 0.0)
    dem = write(tmp_path / "dem.tif", heights, transform=placed(10.0, SIZE))
    assert elevation_of(over(dem=dem)).notes == ()


def test_whether_the_file_states_its_unit_is_known(tmp_path):
    transform = placed(10.0, SIZE)
    silent = write(tmp_path / "silent.tif", slope(SIZE), transform=transform)
    stated = write(tmp_path / "stated.tif", slope(SIZE), transform=transform, unit="metre")
    assert not elevation_of(over(dem=silent)).states_unit
    assert elevation_of(over(dem=stated)).states_unit
    assert elevation_of(over(dem=silent, dem_unit="metres")).states_unit


def test_a_missing_margin_is_drawn_on_and_said(tmp_path):
    size = (52, 72)  # 60 m too narrow on every side
    dem = write(tmp_path / "dem.tif", slope(size), transform=placed(10.0, size, "EPSG:3067"))
    area = [[0, 0], [600, 0], [600, 400], [0, 400]]
    full = over(area=area, dem=dem)
    smaller = write(tmp_path / "less.tif", slope((44, 64)), transform=placed(10.0, (44, 64), "EPSG:3067"))
    cut = over(area=area, dem=smaller)
    assert elevation_of(full).notes == () or "ends up to" in elevation_of(full).notes[0]
    (note,) = elevation_of(cut).notes
    assert "before the ground around the area does" in note
    assert np.isfinite(build_terrain(cut).heights_m).all()
    np.testing.assert_allclose(
        build_terrain(cut).height_m(PLACES) - build_terrain(full).height_m(PLACES), 0.0, atol=0.1
    )


def test_somewhere_else(tmp_path):
    there = placed(10.0, SIZE, middle_enu_m=(40_000.0, 0.0))
    with pytest.raises(UserError, match=r"does not overlap the area, 3\d\.\d km away"):
        build_terrain(over(dem=write(tmp_path / "dem.tif", slope(SIZE), transform=there)))


def test_without_a_place(tmp_path):
    nowhere = write(tmp_path / "no-crs.tif", slope(SIZE), None, placed(10.0, SIZE))
    with pytest.raises(UserError, match=r"no-crs\.tif: does not say where it lies; save it as a GeoTIFF"):
        build_terrain(over(dem=nowhere))
    local = write(tmp_path / "local.tif", slope(SIZE), 'LOCAL_CS["x",UNIT["metre",1]]', placed(10.0, SIZE))
    for what in (local, write(tmp_path / "no-datum.tif", slope(SIZE), NO_DATUM, placed(10.0, SIZE))):
        with pytest.raises(UserError, match=r"its CRS is local or tells no datum; save it again in one with"):
            build_terrain(over(dem=what))
    with pytest.warns(rasterio.errors.NotGeoreferencedWarning):
        plain = write(tmp_path / "plain.tif", slope(SIZE))
    with pytest.raises(UserError, match="does not say where it lies"):
        build_terrain(over(dem=plain))


def test_no_elevation_model(tmp_path):
    (tmp_path / "dem.tif").write_bytes(b"no raster")
    with pytest.raises(UserError, match="is no GeoTIFF"):
        build_terrain(over(dem=tmp_path / "dem.tif"))
    with pytest.raises(UserError, match=r"gone\.tif: there is no such file"):
        build_terrain(over(dem=tmp_path / "gone.tif"))
    picture = write(tmp_path / "rgb.tif", np.zeros((3, *SIZE), np.uint8), transform=placed(10.0, SIZE))
    with pytest.raises(UserError, match="is a picture, not heights"):
        build_terrain(over(dem=picture))


def test_scaled_integers(tmp_path):
    decimetres = np.round(10.0 * slope(SIZE)).astype(np.int16)
    dem = write(tmp_path / "dem.tif", decimetres, transform=placed(10.0, SIZE))
    with rasterio.open(dem, "r+") as file:
        file.scales = (0.1,)
    metres = over(dem=write(tmp_path / "metres.tif", slope(SIZE), transform=placed(10.0, SIZE)))
    np.testing.assert_allclose(
        build_terrain(over(dem=dem)).heights_m, build_terrain(metres).heights_m, atol=0.11
    )


def test_a_fine_one_is_averaged_and_said(tmp_path, monkeypatch):
    monkeypatch.setattr("skysweep.worlds.elevation.MAX_POSTS", 400)
    scenario = over(dem=write(tmp_path / "dem.tif", slope(SIZE), transform=placed(10.0, SIZE)))
    expected, _ = heights_in_file(scenario, placed(10.0, SIZE), "EPSG:3067", plane)
    terrain = build_terrain(scenario)
    assert terrain.heights_m.size < 800
    np.testing.assert_allclose(terrain.height_m(PLACES), expected, atol=0.2)
    assert "is read every" in elevation_of(scenario).notes[0]


def test_only_the_window_of_ten_gigabytes_is_read(tmp_path):
    size, block = 50_000, 200
    transform = placed(2.0, (size, size))
    path = tmp_path / "huge.tif"
    first = size // 2 - 2 * block
    with rasterio.open(
        path, "w", driver="GTiff", width=size, height=size, count=1, dtype="float32", crs="EPSG:3067",
        transform=transform, tiled=True, SPARSE_OK=True, BIGTIFF="YES", nodata=-1,
    ) as file:  # fmt: skip
        row, column = np.mgrid[first : first + 4 * block, first : first + 4 * block] + 0.5
        heights = (100.0 + 0.3 * (column - first) - 0.2 * (row - first)).astype(np.float32)
        file.write(heights, 1, window=rasterio.windows.Window(first, first, 4 * block, 4 * block))
    scenario = over(dem=path)
    before_kb, started = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.perf_counter()
    expected, _ = heights_in_file(
        scenario, transform, "EPSG:3067", lambda c, r: 100.0 + 0.3 * (c - first) - 0.2 * (r - first)
    )
    np.testing.assert_allclose(build_terrain(scenario).height_m(PLACES), expected, atol=0.02)
    assert time.perf_counter() - started < 10.0
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before_kb < 500_000


def test_the_same_twice_and_anew_when_the_file_changes(tmp_path):
    dem = write(tmp_path / "dem.tif", slope(SIZE), transform=placed(10.0, SIZE))
    first, again = build_terrain(over(dem=dem)), build_terrain(over(dem=dem))
    assert (first.heights_m == again.heights_m).all()
    write(dem, slope((121, 141)) * 2, transform=placed(10.0, (121, 141)))
    assert np.ptp(build_terrain(over(dem=dem)).heights_m) > 1.5 * np.ptp(first.heights_m)


def test_home_may_be_away_from_the_origin(tmp_path):
    dem = write(tmp_path / "dem.tif", slope(SIZE), transform=placed(10.0, SIZE))
    scenario = over(dem=dem, others={"home": {"latitude_deg": LATITUDE_DEG, "longitude_deg": 25.0,
                    "altitude_amsl_m": 100.0, "position_enu_m": AREA[2]}})  # fmt: skip
    assert build_terrain(scenario).height_at_m(*AREA[2]) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(
    ("altitude_amsl_m", "told"),
    [
        (100.0, None),
        (400.0, r"^home\.altitude_amsl_m: is 400 m, but terrain\.dem has \d+\.\d m there; write that$"),
        (31.0, r"has 10\d\.\d m there; its heights are probably in feet: write terrain\.dem_unit: feet$"),
    ],
)
def test_another_altitude_of_home_is_said(tmp_path, altitude_amsl_m, told):
    dem = write(tmp_path / "dem.tif", slope(SIZE, 0.02, 0.0), transform=placed(10.0, SIZE))
    scenario = over(altitude_amsl_m=altitude_amsl_m, dem=dem)
    said = [w for w in warnings_for_plan(scenario) if w.startswith("home.altitude")]
    assert len(said) == (told is not None)
    assert told is None or re.search(told, said[0])
