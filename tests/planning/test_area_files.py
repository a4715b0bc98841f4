import io
import json
import math
import zipfile

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from skysweep.errors import UserError
from skysweep.geometry.frames import LocalFrame
from skysweep.planning.area_files import MAX_AREA_FILE_BYTES, read_area, scenario_from_area
from skysweep.planning.flight_plan import plan_scenario
from skysweep.planning.qgc import FenceCircle, GeoFence, plan_for_qgc, write_plan
from skysweep.scenarios.files import change_scenario, load_scenario, write_scenario
from skysweep.scenarios.model import Area, Scenario

FRAME = LocalFrame(60.449, 22.2966, 0.0)
SQUARE = shapely.Polygon([(0, 0), (200, 0), (200, 100), (0, 100)], [[(50, 30), (90, 30), (90, 70), (50, 70)]])


def lon_lat(ring):
    xyz = np.column_stack([shapely.get_coordinates(ring), np.zeros(len(shapely.get_coordinates(ring)))])
    return FRAME.geodetic_from_enu(xyz)[:, 1::-1].tolist()


OUTER, HOLE = lon_lat(SQUARE.exterior), lon_lat(SQUARE.interiors[0])
POLYGON = {"type": "Polygon", "coordinates": [OUTER, HOLE]}
POINT = {"type": "Point", "coordinates": OUTER[0]}


def feature(geometry):
    return {"type": "Feature", "properties": {"name": "x"}, "geometry": geometry}


def kml(outer=OUTER, hole=HOLE, namespace='xmlns="http://www.opengis.net/kml/2.2"', count=1):
    def ring(corners):
        text = "\n".join(f"{lon},{lat},0" for lon, lat in corners)
        return f"<LinearRing><coordinates>\n{text}\n</coordinates></LinearRing>"

    placemark = (
        "<Placemark><name>Area</name><Polygon>"
        f"<outerBoundaryIs>{ring(outer)}</outerBoundaryIs><innerBoundaryIs>{ring(hole)}</innerBoundaryIs>"
        "</Polygon></Placemark>"
    )
    head = '<?xml version="1.0" encoding="UTF-8"?>'
    return f"{head}<kml {namespace}><Document>{placemark * count}</Document></kml>"


def kmz(files):
    data = io.BytesIO()
    with zipfile.ZipFile(data, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return data.getvalue()


def save(tmp_path, name, content):
    file = tmp_path / name
    if isinstance(content, (dict, list)):
        content = json.dumps(content)
    file.write_bytes(content.encode() if isinstance(content, str) else content)
    return file


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.geojson", POLYGON),
        ("a.json", feature(POLYGON)),
        (
            "a.geojson",
            {"type": "FeatureCollection", "features": [feature(POINT), feature(POLYGON), feature(None)]},
        ),
        ("a.geojson", {"type": "MultiPolygon", "coordinates": [POLYGON["coordinates"]]}),
        ("a.geojson", {"type": "GeometryCollection", "geometries": [POINT, POLYGON]}),
        ("a.geojson", {**POLYGON, "crs": {"properties": {"name": "urn:ogc:def:crs:OGC:1.3:CRS84"}}}),
        ("a.geojson", {**POLYGON, "crs": {"properties": {"name": "urn:ogc:def:crs:EPSG::4326"}}}),
        ("a.geojson", "\ufeff" + json.dumps(POLYGON)),
        ("a.kml", kml()),
        ("a.KML", kml(namespace="")),
        ("a.kmz", kmz({"files/icon.png": b"png", "doc.kml": kml()})),
        ("a.kmz", kmz({"mine.kml": kml()})),
    ],
)
def test_one_area_from_every_kind_of_file(tmp_path, name, content):
    area, frame = read_area(save(tmp_path, name, content), FRAME)
    assert frame is FRAME
    assert area.symmetric_difference(SQUARE).area < 0.01
    assert len(area.interiors) == 1


def test_one_inner_boundary_may_hold_several_rings(tmp_path):
    other = lon_lat(shapely.box(120, 30, 160, 70).exterior)
    two = kml().replace("</innerBoundaryIs>", "", 1)
    ring = "<LinearRing><coordinates>" + " ".join(f"{lon},{lat}" for lon, lat in other)
    two = two.replace("</Polygon>", f"{ring}</coordinates></LinearRing></innerBoundaryIs></Polygon>", 1)
    area, _ = read_area(save(tmp_path, "a.kml", two), FRAME)
    assert len(area.interiors) == 2
    assert area.area == pytest.approx(SQUARE.area - 1600.0, rel=1e-5)


def test_without_a_frame_the_area_lies_around_its_centroid(tmp_path):
    area, frame = read_area(save(tmp_path, "a.kml", kml()))
    assert math.hypot(area.centroid.x, area.centroid.y) < 0.01
    assert area.area == pytest.approx(SQUARE.area, rel=1e-5)
    assert frame.latitude_deg == pytest.approx(60.4494, abs=1e-3)


def test_a_plans_survey_is_an_area(tmp_path):
    s = Scenario(name="t", area=Area(polygon_enu_m=[(0, 0), (200, 0), (200, 100), (0, 100)]))
    file = write_plan(tmp_path / "a.plan", plan_for_qgc(s, plan_scenario(s)[0]))
    area, _ = read_area(file, s.frame)
    assert area.symmetric_difference(shapely.box(0, 0, 200, 100)).area < 0.1
    again = scenario_from_area(file)
    assert again.home.altitude_amsl_m == s.home.altitude_amsl_m
    assert again.area_enu_m.symmetric_difference(area).area < 0.1


@settings(max_examples=40)
@given(
    latitude=st.floats(-75, 75),
    longitude=st.floats(-170, 170),
    radii=st.lists(st.floats(20, 500), min_size=3, max_size=12),
)
def test_areas_survive_the_way_through_a_file(tmp_path_factory, latitude, longitude, radii):
    frame = LocalFrame(latitude, longitude, 0.0)
    angles = np.arange(len(radii)) * 2 * np.pi / len(radii)
    ring = np.column_stack([radii * np.cos(angles), radii * np.sin(angles), np.zeros(len(radii))])
    corners = frame.geodetic_from_enu(ring)[:, 1::-1].tolist()
    content = {"type": "Polygon", "coordinates": [[*corners, corners[0]]]}
    area, _ = read_area(save(tmp_path_factory.mktemp("g"), "a.geojson", content), frame)
    assert shapely.get_coordinates(area)[:-1] == pytest.approx(ring[:, :2], abs=0.05)


@pytest.mark.parametrize("latitude", [0.0, -16.8, 60.0])
def test_an_area_across_the_180th_meridian_lies_there(tmp_path, latitude):
    ring = [
        [179.999, latitude],
        [-179.999, latitude],
        [-179.999, latitude + 0.001],
        [179.999, latitude + 0.001],
    ]
    file = save(tmp_path, "a.geojson", {"type": "Polygon", "coordinates": [[*ring, ring[0]]]})
    area, frame = read_area(file)
    width_m = 0.002 * 111_320 * math.cos(math.radians(latitude))
    assert area.area == pytest.approx(width_m * 111.0, rel=0.02)
    assert abs(frame.longitude_deg) == pytest.approx(180.0, abs=1e-6)
    home = scenario_from_area(file).home
    assert abs(home.longitude_deg) == pytest.approx(179.999, abs=1e-4)


def test_an_area_becomes_a_scenario_that_can_be_planned(tmp_path):
    s = scenario_from_area(save(tmp_path, "Größe & co.kml", kml()))
    assert s.area_enu_m.area == pytest.approx(SQUARE.area, rel=1e-4)
    assert s.home.latitude_deg == pytest.approx(60.449, abs=1e-4)
    plan, estimate = plan_scenario(s)
    assert estimate.time_s > 0
    assert s.name == "Gro-e - co"
    assert np.linalg.norm(plan.waypoints_xy_enu_m[0]) < 150


BILLION_LAUGHS = '<!DOCTYPE l [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;&a;">]><kml><name>&b;</name></kml>'
FOREIGN_ENTITY = '<!DOCTYPE l SYSTEM "file:///etc/hostname"><kml></kml>'
BOW_TIE = [[22.0, 60.0], [22.01, 60.01], [22.01, 60.0], [22.0, 60.01], [22.0, 60.0]]


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.shp", b"", "no area file; give one that ends in .geojson"),
        ("a.geojson", {"type": "FeatureCollection", "features": []}, "no polygon"),
        ("a.geojson", {"type": "FeatureCollection", "features": [feature(POLYGON)] * 2}, "2 polygons"),
        ("a.geojson", {"type": "MultiPolygon", "coordinates": [[OUTER], [HOLE]]}, "2 polygons"),
        ("a.geojson", {"type": "FeatureCollection"}, "list of shapes"),
        ("a.geojson", {"type": "Topology"}, "Topology"),
        ("a.geojson", [1, 2], "not of GeoJSON"),
        ("a.geojson", {"type": "Polygon", "coordinates": [OUTER[:2]]}, "at least 4"),
        ("a.geojson", {"type": "Polygon", "coordinates": [["a", "b"]]}, "at least 4"),
        ("a.geojson", {"type": "Polygon", "coordinates": None}, "at least 4"),
        (
            "a.geojson",
            {"type": "Polygon", "coordinates": [[[p[0] * 1e4, p[1] * 1e5] for p in OUTER]]},
            "WGS 84",
        ),
        (
            "a.geojson",
            {"type": "Polygon", "coordinates": [[[1e999, 0], [0, 1], [1, 1], [1e999, 0]]]},
            "JSON number",
        ),
        ("a.geojson", {"type": "Polygon", "coordinates": [BOW_TIE]}, "not simple"),
        ("a.geojson", {"type": "Polygon", "coordinates": [[[0, 0], [9, 0], [9, 9], [0, 0]]]}, "km2"),
        ("a.geojson", {"type": "Polygon", "coordinates": [[OUTER[0]] * 4]}, "not simple|km2"),
        ("a.geojson", {**POLYGON, "crs": {"properties": {"name": "EPSG:3067"}}}, "EPSG:3067"),
        ("a.geojson", {**POLYGON, "crs": "x"}, "crs"),
        ("a.geojson", json.dumps(POLYGON)[:100], "truncated"),
        (
            "a.geojson",
            '{"type": "GeometryCollection", "geometries": [' * 300 + "]}" * 300,
            "deeply|no polygon",
        ),
        ("a.geojson", "[" * 500_000, "deeply"),
        ("a.geojson", b"\xff\xfe", "UTF-8"),
        ("a.geojson", '{"type": "Polygon", "coordinates": [[]]}', "has no corners"),
        ("a.kml", kml(count=3), "3 polygons"),
        ("a.kml", kml()[:300], "is not KML"),
        ("a.kml", kml(outer=OUTER[:2]), "at least 4"),
        ("a.kml", kml(outer=[["x", "y"]] * 4), "at least 4"),
        ("a.kml", kml(outer=[["nan", "nan"]] * 4), "WGS 84|at least 4"),
        ("a.kml", BILLION_LAUGHS, "DTD or entities"),
        ("a.kml", FOREIGN_ENTITY, "DTD or entities"),
        ("a.kml", "<a>" * 100_000, "is not KML"),
        ("a.kml", "", "is not KML"),
        ("a.kmz", b"PK\x03\x04 broken", "no readable KMZ"),
        ("a.kmz", kmz({"a.txt": "x"}), "no .kml file"),
        ("a.kmz", kmz({"doc.kml": BILLION_LAUGHS}), "DTD or entities"),
        ("a.kmz", kmz({"doc.kml": b" " * (MAX_AREA_FILE_BYTES + 1)}), "unpacks to more than 10 MB"),
    ],
)
def test_what_is_no_area_is_told_in_one_sentence(tmp_path, name, content, words):
    with pytest.raises(UserError, match=words) as refusal:
        read_area(save(tmp_path, name, content))
    assert name in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_a_missing_file_is_told(tmp_path):
    with pytest.raises(UserError, match="no such file"):
        read_area(tmp_path / "none.kml")


@given(st.binary(max_size=300), st.sampled_from([".geojson", ".kml", ".kmz", ".plan"]))
@settings(max_examples=100)
def test_no_bytes_break_the_reader(tmp_path_factory, data, suffix):
    file = tmp_path_factory.mktemp("bytes") / f"x{suffix}"
    file.write_bytes(data)
    with pytest.raises(UserError):
        read_area(file)


HOME = "home: {latitude_deg: 60.449, longitude_deg: 22.2966, altitude_amsl_m: 0}\n"


@pytest.mark.parametrize("suffix", [".geojson", ".kml"])
def test_a_scenario_names_its_area_file_beside_it(tmp_path, suffix):
    (tmp_path / f"field{suffix}").write_text(json.dumps(feature(POLYGON)) if suffix == ".geojson" else kml())
    mine = tmp_path / "mine.yaml"
    mine.write_text(f"name: mine\narea: {{file: field{suffix}}}\n{HOME}")
    scenario = load_scenario(mine)
    assert scenario.area_enu_m.symmetric_difference(SQUARE).area < 0.01
    (tmp_path / f"field{suffix}").unlink()
    assert load_scenario(write_scenario(scenario, tmp_path / "config.yaml")) == scenario


def test_an_area_file_can_be_set(tmp_path):
    (tmp_path / "field.kml").write_text(kml())
    scenario = Scenario(name="a", area=Area(polygon_enu_m=[(0, 0), (9, 0), (9, 9)]))
    file = {"file": str(tmp_path / "field.kml")}
    changed = change_scenario(scenario, {"area": file, "home.altitude_amsl_m": 0})
    assert changed.area_enu_m.symmetric_difference(SQUARE).area < 0.01


@pytest.mark.parametrize(
    ("area", "home", "words"),
    [
        ("{file: none.kml}", HOME, "mine.yaml: area.file: .*none.kml: "),
        ("{file: two.kml}", HOME, "mine.yaml: area.file: .*two.kml: holds 2 polygons"),
        ("{file: field.txt}", HOME, "area.file: .*field.txt: is no area file"),
        ("{file: field.kml}", "home: {latitude_deg: 10}\n", "home: lies .* km from the area"),
        ("{file: 7}", HOME, "area.file: is 7; write"),
        ("{file: field.kml, polygon_enu_m: [[0, 0], [9, 0], [9, 9]]}", HOME, "write exactly one of"),
        ("{file: field.kml, holes_enu_m: [[[0, 0], [9, 0], [9, 9]]]}", HOME, "area.file: .* stands alone"),
    ],
)
def test_an_area_file_that_does_not_do_is_one_sentence(tmp_path, area, home, words):
    (tmp_path / "field.kml").write_text(kml())
    (tmp_path / "two.kml").write_text(kml(count=2))
    (tmp_path / "mine.yaml").write_text(f"name: mine\narea: {area}\n{home}")
    with pytest.raises(UserError, match=words):
        load_scenario(tmp_path / "mine.yaml")


def test_a_plans_fence_is_kept_and_a_circle_is_nowhere_less_strict(tmp_path):
    s = Scenario(name="fenced", area=Area(polygon_enu_m=[(0, 0), (200, 0), (200, 100), (0, 100)]))
    home = s.home
    lat_lon = s.frame.geodetic_from_enu([[150.0, 50.0, 0.0]])[0][:2]
    circle = FenceCircle(inclusion=False, circle={"center": tuple(map(float, lat_lon)), "radius": 20.0})
    plan = plan_for_qgc(s, plan_scenario(s)[0])
    plan = plan.model_copy(update={"geoFence": GeoFence(circles=[circle], polygons=plan.geoFence.polygons)})
    drawn = scenario_from_area(write_plan(tmp_path / "a.plan", plan))
    (ring,) = drawn.safety.no_fly_enu_m
    kept_out, middle = shapely.Polygon(ring), shapely.Point(150.0, 50.0)
    assert kept_out.contains(middle.buffer(19.95))
    assert middle.buffer(20.5).contains(kept_out)
    assert drawn.home.latitude_deg == pytest.approx(home.latitude_deg, abs=1e-6)
    again = plan_for_qgc(drawn, plan_scenario(drawn)[0]).geoFence
    assert [p.inclusion for p in again.polygons] == [False]
