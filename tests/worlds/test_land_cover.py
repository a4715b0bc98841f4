"""Surfaces, trees, buildings and roads from files."""

import json
import math
import re

import numpy as np
import pytest
import shapely
import shapely.affinity
from tests.worlds.geotiffs import over, placed, rasterio, slope, write

from skysweep.errors import UserError
from skysweep.planning.advice import warnings_for_plan
from skysweep.scenarios.model import MAX_TREES
from skysweep.worlds.obstacles import known_obstacles
from skysweep.worlds.world import build_terrain, build_trees, build_world, land_cover_of, mapped_buildings

SIZE = (120, 140)
CLASSES = [
    {
        "code": 1,
        "surface": "forest floor",
        "trees_per_hectare": 100,
        "height_m": [4, 6],
        "conifer_fraction": 1,
    },
    {"code": 2, "surface": "rock"},
]


def halves(dtype=np.uint8, west=1, east=2):
    codes = np.full(SIZE, west, dtype)
    codes[:, SIZE[1] // 2 :] = east
    return codes


def collection(path, *features):
    """GeoJSON of (shape in ENU metres around home, tags)."""
    frame = over().frame

    def lon_lat(xy):
        geodetic = frame.geodetic_from_enu(np.column_stack([xy, np.zeros(len(xy))]))
        return geodetic[:, [1, 0]]

    shapes = [
        {
            "type": "Feature",
            "properties": tags,
            "geometry": json.loads(shapely.to_geojson(shapely.transform(outline, lon_lat))),
        }
        for outline, tags in features
    ]
    path.write_text(json.dumps({"type": "FeatureCollection", "features": shapes}))
    return path


def test_classes_become_surfaces_and_trees(tmp_path):
    cover = write(tmp_path / "lc.tif", halves(), transform=placed(10.0, SIZE))
    scenario = over(land_cover=cover, land_cover_classes=CLASSES, surface="snow")
    terrain = build_terrain(scenario)
    assert terrain.surface_at(100, 200) == "forest floor"
    assert terrain.surface_at(500, 200) == "rock"
    assert terrain.cover.codes_at([[100, 200], [500, 200]]).tolist() == [
        terrain.cover.names.index("forest floor"),
        terrain.cover.names.index("rock"),
    ]
    trees = build_trees(scenario, terrain)
    hectares = (land_cover_of(scenario).classes == 0).mean() * 720 * 520 / 1e4
    assert len(trees) == pytest.approx(100 * hectares, rel=0.02)
    assert all(terrain.surface_at(*t.position_enu_m[:2]) == "forest floor" for t in trees)
    assert all(4 <= t.height_m <= 6 and t.kind == "conifer" for t in trees)
    assert min(math.hypot(*t.position_enu_m[:2]) for t in trees) >= 6.0, "home is clear"


def test_trees_are_those_of_the_seed_and_stand_on_the_ground(tmp_path):
    cover = write(tmp_path / "lc.tif", halves(), transform=placed(10.0, SIZE))
    dem = write(tmp_path / "dem.tif", slope(SIZE), transform=placed(10.0, SIZE))
    scenario = over(land_cover=cover, land_cover_classes=CLASSES, dem=dem)
    one, two = build_world(scenario, 1), build_world(scenario, 2)
    places = np.array([t.position_enu_m for t in one.trees])
    assert (places == [t.position_enu_m for t in two.trees]).all()
    np.testing.assert_allclose(places[:, 2], one.terrain.height_m(places[:, :2]))
    other = over(land_cover=cover, land_cover_classes=CLASSES, dem=dem, seed=9)
    assert (places[0] != build_world(other, 1).trees[0].position_enu_m).any()


def test_worldcover_is_known(tmp_path):
    cover = write(tmp_path / "lc.tif", halves(west=10, east=80), transform=placed(10.0, SIZE))
    terrain = build_terrain(over(land_cover=cover))
    assert (terrain.surface_at(100, 200), terrain.surface_at(500, 200)) == ("forest floor", "water")


@pytest.mark.parametrize(("code", "surface"), [
    (10, "forest floor"), (20, "grass"), (30, "grass"), (40, "grass"), (50, "asphalt"), (60, "sand"),
    (70, "snow"), (80, "water"), (90, "grass"), (95, "forest floor"), (100, "rock"),
])  # fmt: skip
def test_each_class_of_worldcover_is_a_surface(tmp_path, code, surface):
    cover = write(tmp_path / "lc.tif", halves(west=code, east=code), transform=placed(10.0, SIZE))
    assert build_terrain(over(land_cover=cover)).surface_at(300, 200) == surface


def test_a_class_that_nobody_told_is_refused(tmp_path):
    cover = write(tmp_path / "lc.tif", halves(east=37), transform=placed(10.0, SIZE))
    with pytest.raises(UserError, match=r"has the class 37, which terrain\.land_cover_classes does not tell"):
        build_terrain(over(land_cover=cover, land_cover_classes=CLASSES))


def test_what_a_map_leaves_open_is_the_terrain_s_surface(tmp_path):
    codes = halves()
    codes[:, 100:] = 0
    cover = write(tmp_path / "lc.tif", codes, transform=placed(10.0, SIZE), nodata=0)
    terrain = build_terrain(over(land_cover=cover, land_cover_classes=CLASSES, surface="snow"))
    assert terrain.surface_at(650, 200) == "snow"
    small = write(tmp_path / "small.tif", halves()[:20, :20], transform=placed(10.0, (20, 20)))
    scenario = over(land_cover=small, land_cover_classes=CLASSES, surface="snow")
    assert build_terrain(scenario).surface_at(0, 0) == "snow"
    assert "tells of 11% of the ground; the rest is snow" in land_cover_of(scenario).notes[0]
    empty = halves()
    empty[:, 70:] = 0
    cover = write(tmp_path / "empty.tif", empty, transform=placed(10.0, SIZE), nodata=0)
    half = land_cover_of(over(land_cover=cover, land_cover_classes=CLASSES, surface="snow"))
    assert half.covered == pytest.approx(0.5, abs=0.02)
    assert "tells of 5" in half.notes[0]


@pytest.mark.parametrize(("values", "sentence"), [
    (slope(SIZE), "is no map of classes"),
    (np.zeros((3, *SIZE), np.uint8), "is no map of classes"),
])  # fmt: skip
def test_no_land_cover(tmp_path, values, sentence):
    cover = write(tmp_path / "lc.tif", values, transform=placed(10.0, SIZE))
    with pytest.raises(UserError, match=sentence):
        build_terrain(over(land_cover=cover))
    away = write(tmp_path / "away.tif", halves(), transform=placed(10.0, SIZE, middle_enu_m=(30_000, 0)))
    with pytest.raises(UserError, match="does not overlap the area"):
        build_terrain(over(land_cover=away, land_cover_classes=CLASSES))


def test_land_cover_of_the_other_half_of_the_world_is_refused(tmp_path):
    north = rasterio.Affine(1.0, 0.0, -180.0, 0.0, -1.0, 90.0)
    cover = write(tmp_path / "north.tif", np.full((90, 360), 10, np.uint8), "EPSG:4326", north)
    with pytest.raises(UserError, match="does not overlap the area, 48"):
        build_terrain(over((-43.5, 171.0), land_cover=cover, land_cover_classes=CLASSES))


def test_more_trees_than_can_be_drawn_are_thinned_and_said(tmp_path):
    dense = [{"code": 1, "surface": "forest floor", "trees_per_hectare": 2000}, CLASSES[1]]
    cover = write(tmp_path / "lc.tif", halves(east=1), transform=placed(10.0, SIZE))
    scenario = over(land_cover=cover, land_cover_classes=dense)
    trees = build_trees(scenario, build_terrain(scenario))
    assert 0.99 * MAX_TREES < len(trees) <= MAX_TREES
    assert any(f"of which {MAX_TREES:,} are drawn" in w for w in warnings_for_plan(scenario))


def test_footprints_become_boxes_of_their_height(tmp_path):
    turned = shapely.affinity.rotate(shapely.box(100, 100, 120, 110), 30)
    flat = shapely.box(300, 100, 340, 130)
    file = collection(
        tmp_path / "b.geojson",
        (turned, {"building": "house", "height": "9 m"}),
        (flat, {"building": "retail", "building:levels": "2"}),
        (shapely.box(200, 200, 210, 210), {"building": "no"}),
        (shapely.box(5200, 200, 5210, 210), {"building": "yes"}),
    )
    house, hall = mapped_buildings(over(others={"buildings_file": str(file)}))
    assert house.size_m == pytest.approx((20, 10), abs=0.05)
    assert math.degrees(house.yaw_rad) % 180 == pytest.approx(30, abs=0.2)
    assert (house.top_m, house.is_flat) == (pytest.approx(9.0, abs=0.05), False)
    assert (hall.top_m, hall.is_flat) == (6.0, True)


@pytest.mark.parametrize(
    ("tags", "top_m"),
    [
        ({"height": "196'10\""}, 60.0),
        ({"height": "60 metres"}, 60.0),
        ({"height": "60,5"}, 60.5),
        ({"height": "~60"}, 60.0),
        ({"height": "197 feet"}, 60.05),
        ({"building:levels": "18-20"}, 60.0),
        ({"building:levels": "20;4"}, 60.0),
        ({"height": "6000 cm"}, 60.0),
        ({"height": "1e9", "building:levels": "20"}, 60.0),
        ({"height": "0.1 mi", "building:levels": "20"}, 60.0),
        ({"height": None, "building:levels": "20"}, 60.0),
    ],
)
def test_heights_are_read_as_people_write_them(tmp_path, tags, top_m):
    yard = shapely.box(100, 100, 130, 120)
    file = collection(tmp_path / "b.geojson", (yard, {"building": "yes", "roof:shape": "flat"} | tags))
    scenario = over(others={"buildings_file": str(file)})
    (house,) = mapped_buildings(scenario)
    assert house.top_m == pytest.approx(top_m, abs=0.05)
    assert not [w for w in warnings_for_plan(scenario) if "storey" in w]


def test_a_mast_is_no_part_to_leave_out(tmp_path):
    mast = shapely.box(100, 100, 101.5, 101.5)
    file = collection(tmp_path / "b.geojson", (mast, {"building": "tower", "height": "60"}))
    (box,) = mapped_buildings(over(others={"buildings_file": str(file)}))
    assert box.top_m == pytest.approx(60.0)


def test_buildings_without_a_height_are_said(tmp_path):
    flat = shapely.box(300, 100, 340, 130)
    file = collection(tmp_path / "b.geojson", (YARD, HOUSE), (flat, {"building": "yes", "height": "tall"}))
    said = [w for w in warnings_for_plan(over(others={"buildings_file": str(file)})) if "storey" in w]
    assert len(said) == 1
    assert "2 of 2 buildings in the area tell no height" in said[0]


YARD, FAR_YARD = shapely.box(100, 100, 120, 110), shapely.box(20_000, 0, 20_010, 9)
STREET = shapely.LineString([(0, 0), (600, 400)])
FAR_STREET = shapely.affinity.translate(STREET, 9000)
HOUSE, PATH = {"building": "yes"}, {"highway": "path"}


@pytest.mark.parametrize(("field", "features", "sentence"), [
    ("buildings_file", [], "holds no polygon with OpenStreetMap's tag 'building'; give buildings of this "),
    ("buildings_file", [(YARD.centroid, HOUSE)], "holds no polygon with"),
    ("buildings_file", [(YARD, {"landuse": "farmyard"})], "holds no polygon with"),
    ("buildings_file", [(FAR_YARD, HOUSE)], r"its buildings are 19\.\d km away"),
    ("roads_file", [(YARD, PATH)], "holds no line with OpenStreetMap's tag 'highway'; give roads of this "),
    ("roads_file", [(FAR_STREET, PATH)], r"its roads are 8\.\d km away"),
])  # fmt: skip
def test_files_without_anything_here_are_refused(tmp_path, field, features, sentence):
    file = collection(tmp_path / "osm.geojson", *features)
    with pytest.raises(UserError, match=rf"^{field}: .*osm\.geojson: {sentence}"):
        build_world(over(others={field: str(file)}), 0)


def test_a_part_of_a_place_may_have_no_buildings(tmp_path):
    file = collection(tmp_path / "b.geojson", (shapely.box(1600, 0, 1610, 10), HOUSE))
    scenario = over(others={"buildings_file": str(file)})
    assert mapped_buildings(scenario) == ()
    (said,) = [w for w in warnings_for_plan(scenario) if "_file" in w]
    assert re.fullmatch(r"buildings_file: its buildings are \d\.\d km away: there are none in the area", said)


def test_an_outline_without_corners_is_none(tmp_path):
    file = collection(tmp_path / "osm.geojson", (shapely.Polygon(), HOUSE))
    with pytest.raises(UserError, match=r"holds no polygon with OpenStreetMap's tag 'building'"):
        build_world(over(others={"buildings_file": str(file)}), 0)


def test_what_is_left_out_of_a_file_is_said(tmp_path):
    houses = collection(
        tmp_path / "b.geojson",
        (YARD, HOUSE),
        (YARD.centroid, {"building": "hut"}),
        (shapely.Point(9000, 0), {"building": "hut"}),
    )
    streets = collection(
        tmp_path / "r.geojson",
        (STREET, PATH),
        (YARD, {"highway": "pedestrian"}),
        (shapely.Point(300, 200), {"highway": "crossing"}),
    )
    scenario = over(others={"buildings_file": str(houses), "roads_file": str(streets)})
    assert [w for w in warnings_for_plan(scenario) if "_file" in w] == [
        "roads_file: 1 of 2 roads in the area left out: not a line",
        "buildings_file: 1 of 2 buildings in the area left out: not a polygon",
        "buildings_file: 1 of 1 buildings in the area tell no height and no storeys: taken for one storey "
        "each",
    ]


def test_an_l_becomes_two_boxes_that_hold_it(tmp_path):
    l_shape = shapely.Polygon([(100, 100), (130, 100), (130, 110), (110, 110), (110, 125), (100, 125)])
    file = collection(tmp_path / "b.geojson", (l_shape, {"building": "yes", "height": "20 ft"}))
    boxes = mapped_buildings(over(others={"buildings_file": str(file)}))
    assert len(boxes) == 2
    together = shapely.union_all([box.outline() for box in boxes])
    assert together.buffer(0.1).covers(l_shape)
    assert together.area == pytest.approx(l_shape.area, rel=0.02)


def test_buildings_occlude_and_are_kept_clear_of(tmp_path):
    file = collection(
        tmp_path / "b.geojson", (shapely.box(100, 100, 140, 130), {"building": "yes", "height": "12"})
    )
    scenario = over(others={"buildings_file": str(file)})
    known = known_obstacles(scenario)
    assert known.top_within_m(np.array([[120.0, 115.0]]), 0.0) == pytest.approx([12.0])
    assert known.hide(np.array([120.0, 132.0, 0.0]), np.array([120.0, 60.0, 30.0]))
    (building,) = build_world(scenario, 0).buildings
    assert building.flat_roof


def test_no_tree_stands_in_a_building(tmp_path):
    cover = write(tmp_path / "lc.tif", halves(east=1), transform=placed(10.0, SIZE))
    hall = shapely.box(100, 100, 300, 300)
    file = collection(tmp_path / "b.geojson", (hall, {"building": "yes"}))
    classes = [CLASSES[0] | {"trees_per_hectare": 500}, CLASSES[1]]
    scenario = over(land_cover=cover, land_cover_classes=classes, others={"buildings_file": str(file)})
    trees = np.array([t.position_enu_m[:2] for t in build_trees(scenario, build_terrain(scenario))])
    assert not shapely.contains_xy(hall.buffer(-0.1), trees).any()


def test_roads_have_width_and_surface(tmp_path):
    line = shapely.LineString([(-50, 200), (650, 200)])
    file = collection(
        tmp_path / "r.geojson",
        (line, {"highway": "primary"}),
        (shapely.LineString([(300, -50), (300, 150)]), {"highway": "track"}),
        (shapely.LineString([(500, -50), (500, 150)]), {"highway": "service", "tunnel": "yes"}),
        (shapely.LineString([(400, -50), (400, 150)]), {"highway": "residential", "width": "12"}),
    )
    cover = write(tmp_path / "lc.tif", halves(east=1), transform=placed(10.0, SIZE))
    scenario = over(land_cover=cover, land_cover_classes=CLASSES, others={"roads_file": str(file)})
    terrain = build_terrain(scenario)
    assert [terrain.surface_at(100, 200 + d) for d in (-6, -3.5, 0, 3.5, 6)] == [
        "forest floor", "asphalt", "asphalt", "asphalt", "forest floor",
    ]  # fmt: skip
    assert terrain.surface_at(300, 100) == "sand"
    assert terrain.surface_at(405, 100) == "asphalt"
    assert terrain.surface_at(500, 100) == "forest floor"
    trees = build_trees(scenario, terrain)
    assert all(terrain.surface_at(*t.position_enu_m[:2]) == "forest floor" for t in trees)


def test_empty_columns_of_a_table_are_no_tags(tmp_path):
    road = shapely.LineString([(0, 200), (600, 200)])
    file = collection(
        tmp_path / "r.geojson",
        (road, {"highway": "residential", "tunnel": None, "surface": "", "width": None}),
        (shapely.LineString([(0, 100), (600, 100)]), {"highway": None, "waterway": "river"}),
    )
    told = json.loads(file.read_text())
    told["features"].append({"type": "Feature", "properties": {"highway": "path"}, "geometry": None})
    file.write_text(json.dumps(told))
    terrain = build_terrain(over(surface="snow", others={"roads_file": str(file)}))
    assert [terrain.surface_at(300, y) for y in (100, 200)] == ["snow", "asphalt"]
    footprints = collection(
        tmp_path / "b.geojson",
        (shapely.box(100, 100, 120, 110), {"building": "house", "landuse": None}),
        (shapely.box(200, 0, 400, 200), {"building": None, "landuse": "meadow"}),
    )
    (house,) = mapped_buildings(over(others={"buildings_file": str(footprints)}))
    assert house.size_m == pytest.approx((20, 10), abs=0.05)


def test_ground_across_the_180th_meridian(tmp_path):
    home = (-16.8, 179.999)
    size = (300, 300)
    for west in (179.985, -180.015):
        transform = rasterio.Affine(1e-4, 0, west, 0, -1e-4, home[0] + 0.015)
        codes = np.ones(size, np.uint8)
        codes[:, 160:] = 2  # from 180.001 on
        cover = write(tmp_path / "lc.tif", codes, crs="EPSG:4326", transform=transform)
        terrain = build_terrain(over(home=home, land_cover=cover, land_cover_classes=CLASSES))
        assert [terrain.surface_at(x, 100.0) for x in (50.0, 500.0)] == ["forest floor", "rock"]


def test_roads_alone_lie_on_the_terrain_s_surface(tmp_path):
    file = collection(
        tmp_path / "r.geojson", (shapely.LineString([(0, 0), (600, 400)]), {"highway": "primary"})
    )
    terrain = build_terrain(over(surface="snow", others={"roads_file": str(file)}))
    assert (terrain.surface_at(300, 200), terrain.surface_at(300, 100)) == ("asphalt", "snow")


@pytest.mark.parametrize(("text", "sentence"), [
    ("{", "is not JSON"),
    ('{"type": "Point", "coordinates": [1, 2]}', "is no collection of features"),
    ('{"type": "FeatureCollection", "features": [3]}', "feature 1 has no shape"),
    ('{"type": "FeatureCollection", "features": [{"type": "Feature", "properties": {"building": "yes"}, '
     '"geometry": {"type": "Point", "coordinates": [392146, 6764629]}}]}', "feature 1 is not in longitude"),
    ('{"type": "FeatureCollection", "crs": {"type": "name", "properties": {"name": "EPSG:3067"}}, '
     '"features": []}', "is not WGS 84"),
])  # fmt: skip
def test_no_geojson(tmp_path, text, sentence):
    (tmp_path / "b.geojson").write_text(text)
    for field in ("buildings_file", "roads_file"):
        with pytest.raises(
            UserError, match=rf"^{field}: .*b\.geojson.*{sentence}|^{field}: .*ends too early"
        ):
            build_world(over(others={field: str(tmp_path / "b.geojson")}), 0)


def picture(size=SIZE):
    row, column = np.mgrid[: size[0], : size[1]]
    return np.stack([column, row, np.full(size, 7)]).astype(np.uint8)


@pytest.mark.parametrize(
    ("crs", "pixel", "turned_deg"), [("EPSG:3067", 10.0, 0.0), ("EPSG:3857", 25.0, 40.0)]
)
def test_the_ground_s_picture_lies_where_it_should(tmp_path, crs, pixel, turned_deg):
    transform = placed(pixel, SIZE, crs, turned_deg)
    scenario = over(orthophoto=write(tmp_path / "o.tif", picture(), crs, transform, photometric="RGB"))
    shown = build_world(scenario, 0).ground_picture
    assert shown.bounds_enu_m == pytest.approx((-60, -60, 660, 460), abs=0.01)
    west, south, east, north = 0.0, 0.0, 600.0, 400.0
    seen = shown.read(west, south, east, north, 60, 40)
    assert seen.shape == (40, 60, 4)
    x, y = np.meshgrid(np.arange(60) * 10.0 + 5.0, 400.0 - np.arange(40) * 10.0 - 5.0)
    flat = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    geodetic = scenario.frame.geodetic_from_enu(flat)
    px, py = rasterio.warp.transform("EPSG:4326", crs, geodetic[:, 1], geodetic[:, 0])
    t = transform
    columns, rows = np.linalg.solve([[t.a, t.b], [t.d, t.e]], [np.array(px) - t.c, np.array(py) - t.f])
    assert np.abs(seen[..., 0].ravel() - (columns - 0.5)).max() < 1.1
    assert np.abs(seen[..., 1].ravel() - (rows - 0.5)).max() < 1.1
    assert (seen[..., 2:] == [7, 255]).all()


def test_where_there_is_no_picture_it_is_clear(tmp_path):
    small = picture((20, 20))
    mask = np.full((20, 20), 255, np.uint8)
    mask[:10] = 0
    values = np.concatenate([small, mask[None]])
    file = write(tmp_path / "o.tif", values, transform=placed(10.0, (20, 20)), photometric="RGB", alpha="yes")
    shown = build_world(over(orthophoto=file), 0).ground_picture
    seen = shown.read(0.0, 0.0, 600.0, 400.0, 600, 400)
    assert (seen[390, 10] == 0).all()
    assert seen[150, 300, 3] == 0, "clear in the file"
    assert seen[250, 300, 3] == 255
    assert 0.9 * 20_000 < (seen[..., 3] > 0).sum() < 1.1 * 20_000
    assert not shown.read(5000.0, 0.0, 5100.0, 100.0, 8, 8).any()


def middle_of(file):
    """The picture's red and green (40, 60, 2) where the file shows something."""
    shown = build_world(over(orthophoto=file), 0).ground_picture
    seen = shown.read(0.0, 0.0, 600.0, 400.0, 60, 40)
    return seen[..., :2].astype(float)


@pytest.mark.parametrize(("bits", "gain"), [(12, 16), (10, 4)])
def test_a_picture_of_fewer_bits_than_16_is_scaled_by_them(tmp_path, bits, gain):
    eight = write(tmp_path / "8.tif", picture(), transform=placed(10.0, SIZE))
    values = picture().astype(np.uint16) * gain
    more = write(tmp_path / "more.tif", values, transform=placed(10.0, SIZE), nbits=bits)
    np.testing.assert_allclose(middle_of(more), middle_of(eight), atol=2.0)


def test_a_picture_of_16_bits_is_scaled_by_what_it_shows(tmp_path):
    """Reflectances from 2000 to 2260 fill the range in all bands alike; nodata and one glint do not count."""
    values = 2000 + picture().astype(np.uint16)
    values[:, :5] = 0
    values[:, 60, 60] = 65535
    file = write(tmp_path / "o.tif", values, transform=placed(10.0, SIZE), nodata=0, photometric="RGB")
    red_green = middle_of(file)
    low, high = np.percentile(values[:, values[0] > 0], [1, 99])
    steps = np.diff(red_green[20, :, 0])
    assert np.median(steps) == pytest.approx(255 / (high - low), abs=0.6)
    assert (steps[5:-5] >= 0).sum() >= len(steps[5:-5]) - 2, "wraps"
    assert 100 < red_green[20, 30, 0] < 200
    again = middle_of(file)
    np.testing.assert_array_equal(again, red_green)


def test_a_picture_without_colours_is_refused(tmp_path):
    file = write(tmp_path / "o.tif", picture().astype(np.float32), transform=placed(10.0, SIZE))
    with pytest.raises(UserError, match=r"terrain\.orthophoto: .* has float32 values, not colours of 8 or"):
        build_world(over(orthophoto=file), 0)
    flat = write(tmp_path / "flat.tif", np.full((3, *SIZE), 900, np.uint16), transform=placed(10.0, SIZE))
    with pytest.raises(UserError, match="shows the same value everywhere"):
        build_world(over(orthophoto=flat), 0)
    away = write(tmp_path / "away.tif", picture(), transform=placed(10.0, SIZE, middle_enu_m=(0, 20_000)))
    with pytest.raises(UserError, match=r"does not overlap the area, 1\d\.\d km away"):
        build_world(over(orthophoto=away), 0)


def test_how_much_of_the_ground_is_pictured_is_said(tmp_path):
    """A square of 600 m on its corner, over ground of 720 x 520 m: what its box covers does not count."""
    turned = placed(6.0, (100, 100), turned_deg=45.0)
    file = write(tmp_path / "o.tif", picture((100, 100)), transform=turned, photometric="RGB")
    (said,) = [w for w in warnings_for_plan(over(orthophoto=file)) if "pictures" in w]
    ground = shapely.box(-60, -60, 660, 460)
    diamond = shapely.affinity.rotate(shapely.box(0, -100, 600, 500), 45.0)
    share = diamond.intersection(ground).area / ground.area
    assert f"terrain.orthophoto: pictures {share:.0%} of the ground" in said
    whole = write(tmp_path / "w.tif", picture(), transform=placed(10.0, SIZE), photometric="RGB")
    assert not [w for w in warnings_for_plan(over(orthophoto=whole)) if "orthophoto" in w]


def test_a_picture_without_overviews_is_said(tmp_path):
    size, path = 6000, tmp_path / "large.tif"
    with rasterio.open(
        path, "w", driver="GTiff", width=size, height=size, count=3, dtype="uint8", crs="EPSG:3067",
        transform=placed(0.2, (size, size)), tiled=True, SPARSE_OK=True, photometric="RGB",
    ) as file:  # fmt: skip
        file.write(np.full((3, 256, 256), 90, np.uint8), window=rasterio.windows.Window(2900, 2900, 256, 256))

    def said():
        return [w for w in warnings_for_plan(over(orthophoto=path)) if "has no overviews" in w]

    assert len(said()) == 1
    with rasterio.open(path, "r+") as file:
        file.build_overviews([2, 4, 8, 16], rasterio.enums.Resampling.average)
    assert said() == []
    shown = build_world(over(orthophoto=path), 0).ground_picture
    assert shown.read(0.0, 0.0, 600.0, 400.0, 60, 40)[..., :3].max() > 80


def test_a_picture_larger_than_memory_is_read_in_windows(tmp_path):
    import tracemalloc

    size = 60_000  # 10.8 GB
    path = tmp_path / "huge.tif"
    with rasterio.open(
        path, "w", driver="GTiff", width=size, height=size, count=3, dtype="uint8", crs="EPSG:3067",
        transform=placed(0.1, (size, size)), tiled=True, SPARSE_OK=True, BIGTIFF="YES", photometric="RGB",
    ) as file:  # fmt: skip
        window = rasterio.windows.Window(30_000, 30_000, 512, 512)
        file.write(np.full((3, 512, 512), 90, np.uint8), window=window)
    shown = build_world(over(orthophoto=path), 0).ground_picture
    tracemalloc.start()
    seen = shown.read(301.0, 150.0, 341.0, 190.0, 400, 400)
    assert (seen[:80, 50:350, :3] == 90).all()
    assert tracemalloc.get_traced_memory()[1] < 50e6
    tracemalloc.stop()
