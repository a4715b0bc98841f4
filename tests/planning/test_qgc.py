import itertools
import json
import math
import struct
from itertools import pairwise

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from skysweep.errors import UserError
from skysweep.geometry.frames import LocalFrame
from skysweep.planning.coverage import plan_coverage
from skysweep.planning.qgc import (
    MAX_WAYPOINTS,
    FenceCircle,
    GeoFence,
    RallyPoints,
    _bends,
    coverage_from_qgc,
    plan_for_qgc,
    read_plan,
    survey_polygons,
    warnings_for_file,
    write_plan,
)
from skysweep.scenarios.model import Area, CameraModel, Home, Safety, Scenario, Terrain
from skysweep.worlds.world import build_terrain

AREA = [(0, 0), (200, 0), (200, 60), (60, 60), (60, 200), (0, 200)]
FENCE = [(-50, -50), (250, -50), (250, 250), (-50, 250)]


def scenario(**changes):
    fields = {"area": Area(polygon_enu_m=AREA), "geofence_enu_m": FENCE, "camera": CameraModel(hfov_rad=0.7)}
    return Scenario(name="test", **{**fields, **changes})


def zigzag(count):
    """Waypoints that turn at each of them."""
    return [
        {
            "type": "SimpleItem",
            "command": 16,
            "frame": 3,
            "params": [0, 0, 0, None, 47.0 + 0.001 * (k % 2), 8.0 + 1e-6 * k, 30],
        }
        for k in range(count)
    ]


def planned(s):
    return plan_coverage(s.area_enu_m, s.camera.lens, 30.0, 0.2, start_xy=(0, 0))


@pytest.fixture
def plan_file(tmp_path):
    s = scenario()
    return write_plan(tmp_path / "a.plan", plan_for_qgc(s, planned(s)))


def drawn(items, **top):
    """A plan as QGroundControl saves it, with keys of its own that mean nothing to us."""
    mission = {
        "cruiseSpeed": 15,
        "firmwareType": 12,
        "globalPlanAltitudeMode": 1,
        "hoverSpeed": 5,
        "items": items,
        "plannedHomePosition": [47.0, 8.0, 500],
        "vehicleType": 2,
        "version": 2,
    }
    return {"fileType": "Plan", "groundStation": "QGroundControl", "mission": mission, "version": 1, **top}


def simple(command, frame, *params):
    altitude = {"AMSLAltAboveTerrain": None, "Altitude": 25, "AltitudeMode": 1}
    return {
        **altitude,
        "autoContinue": True,
        "command": command,
        "doJumpId": 1,
        "frame": frame,
        "params": list(params),
        "type": "SimpleItem",
    }


def read(tmp_path, data):
    file = tmp_path / "drawn.plan"
    file.write_text(data if isinstance(data, str) else json.dumps(data))
    return read_plan(file)


def test_a_plan_survives_being_written_and_read(plan_file):
    s = scenario()
    coverage = planned(s)
    again = read_plan(plan_file)
    assert again == plan_for_qgc(s, coverage)
    back = coverage_from_qgc(again, s.frame, s.camera.lens, 30.0)
    assert back.waypoints_xy_enu_m == pytest.approx(coverage.waypoints_xy_enu_m, abs=1e-4)
    assert np.array(back.transects) == pytest.approx(np.array(coverage.transects), abs=1e-4)
    assert back.spacing_m == pytest.approx(coverage.spacing_m)
    assert back.length_m == pytest.approx(coverage.length_m)


@settings(max_examples=25)
@given(
    latitude=st.floats(-80, 80),
    longitude=st.floats(-179, 179),
    radii=st.lists(st.floats(30, 300), min_size=3, max_size=8),
    altitude=st.floats(15, 80),
)
def test_any_area_anywhere_survives(tmp_path_factory, latitude, longitude, radii, altitude):
    angles = np.arange(len(radii)) * 2 * math.pi / len(radii)
    corners = [(r * math.cos(a), r * math.sin(a)) for r, a in zip(radii, angles, strict=True)]
    home = Home(latitude_deg=latitude, longitude_deg=longitude, altitude_amsl_m=100)
    s = scenario(area=Area(polygon_enu_m=corners), home=home, geofence_enu_m=None)
    coverage = plan_coverage(s.area_enu_m, s.camera.lens, altitude, 0.3)
    file = write_plan(tmp_path_factory.mktemp("plans") / "a.plan", plan_for_qgc(s, coverage, altitude))
    back = coverage_from_qgc(read_plan(file), s.frame, s.camera.lens, altitude)
    paths = [shapely.LineString(c.waypoints_xy_enu_m) for c in (coverage, back)]
    assert shapely.hausdorff_distance(*paths) < 0.03
    assert back.waypoints_xy_enu_m[[0, -1]] == pytest.approx(coverage.waypoints_xy_enu_m[[0, -1]], abs=1e-3)


def test_the_file_has_every_key_that_qgroundcontrol_asks_for(plan_file):
    data = json.loads(plan_file.read_text())
    assert (data["fileType"], data["version"], data["mission"]["version"]) == ("Plan", 1, 2)
    assert {"cruiseSpeed", "hoverSpeed", "firmwareType", "vehicleType", "plannedHomePosition"} <= set(
        data["mission"]
    )
    survey = next(i for i in data["mission"]["items"] if i["type"] == "ComplexItem")
    assert (survey["version"], survey["complexItemType"]) == (5, "survey")
    assert {"angle", "entryLocation", "flyAlternateTransects", "splitConcavePolygons", "polygon"} <= set(
        survey
    )
    style = survey["TransectStyleComplexItem"]
    assert style["version"] == 2
    assert {
        "CameraShots",
        "CameraTriggerInTurnAround",
        "HoverAndCapture",
        "Refly90Degrees",
        "TurnAroundDistance",
    } <= set(style)
    assert style["CameraCalc"]["version"] == 2
    camera = {"SensorWidth", "SensorHeight", "ImageWidth", "ImageHeight", "FocalLength", "Landscape"}
    camera |= {"FixedOrientation", "MinTriggerInterval", "ImageDensity", "FrontalOverlap", "SideOverlap"}
    assert camera | {"ValueSetIsDistance", "DistanceMode", "DistanceToSurface"} <= set(style["CameraCalc"])
    assert [i["command"] for i in data["mission"]["items"] if "command" in i] == [22, 178, 205, 20]
    assert data["geoFence"]["version"] == data["rallyPoints"]["version"] == 2


def test_the_camera_in_the_file_sees_our_footprint(plan_file):
    calc = read_plan(plan_file).surveys[0].TransectStyleComplexItem.CameraCalc.model_dump()
    lens = scenario().camera.lens
    gsd_m = calc["DistanceToSurface"] * calc["SensorWidth"] / (calc["FocalLength"] * calc["ImageWidth"])
    assert gsd_m == pytest.approx(lens.gsd_m(30.0))
    assert calc["ImageDensity"] == pytest.approx(100 * gsd_m)
    side = calc["ImageWidth"] * gsd_m * (1 - calc["SideOverlap"] / 100)
    assert calc["AdjustedFootprintSide"] == pytest.approx(side)


def test_over_hills_the_path_stays_above_the_ground_by_the_scan_altitude(tmp_path):
    s = scenario(terrain=Terrain(hills_height_m=40), home=Home(altitude_amsl_m=200))
    terrain = build_terrain(s)
    coverage = planned(s)
    file = write_plan(tmp_path / "hills.plan", plan_for_qgc(s, coverage))
    survey = read_plan(file).surveys[0].TransectStyleComplexItem
    assert survey.CameraCalc.above == "terrain"
    amsl = [item.params[6] for item in survey.Items]
    assert {item.frame for item in survey.Items} == {0}
    at = s.frame.enu_from_geodetic([(*item.params[4:6], 200.0) for item in survey.Items])[:, :2]
    home = np.array([s.home.position_enu_m])
    way = [(home[0], amsl[0]), *zip(at, amsl, strict=True), (home[0], amsl[-1])]  # as PX4 flies out and home
    above = []
    for (a, za), (b, zb) in pairwise(way):
        share = np.linspace(0, 1, 37)[:, None]
        above += (za + share[:, 0] * (zb - za) - terrain.height_m(a + share * (b - a)) - 200).tolist()
    assert min(above) > 29.0
    assert max(above[37:-37]) < 30.0 + 15.0, "it follows the ground, but for what is flown out and home"
    path = shapely.LineString(np.column_stack([at, np.array(amsl) - 200.0]))
    for profile in coverage.profiles:
        stations = path.interpolate(path.project(shapely.points(profile.xy_enu_m())))
        assert (shapely.get_z(stations) - profile.height_m).min() > -1.0, "from there all of the area is seen"
    again = coverage_from_qgc(read_plan(file), s.frame, s.camera.lens, 30.0)
    assert again.waypoints_xy_enu_m == pytest.approx(coverage.waypoints_xy_enu_m, abs=0.05)


def test_a_ridge_on_the_way_out_and_home_is_followed():
    """It lies between home and the area, and is higher than the scan."""
    heights = np.zeros((30, 60))  # over area and home, west to east
    heights[:, 8:23] = np.interp(np.arange(15), [0, 6, 8, 14], [0.0, 60.0, 60.0, 0.0])
    s = scenario(
        terrain=Terrain(heightmap_m=heights.tolist()),
        home=Home(position_enu_m=(-200, 40), altitude_amsl_m=500),
        geofence_enu_m=None,
    )
    assert build_terrain(s).height_m(np.array([[-200.0, 40.0], [100.0, 40.0]])) == pytest.approx([0.0, 0.0])
    plan = plan_for_qgc(s, planned(s))
    survey = plan.surveys[0].TransectStyleComplexItem
    assert plan.mission.items[0].params[6] == pytest.approx(30.0, abs=1.0)
    path = np.array([item.params[4:] for item in survey.Items])
    xy = s.frame.enu_from_geodetic(np.column_stack([path[:, :2], np.full(len(path), s.frame.altitude_m)]))
    above = np.array([(-200.0, 40.0, 30.0), *np.column_stack([xy[:, :2], path[:, 2] - 500.0])])
    clearances = []
    for start, end in itertools.pairwise(above):
        along = start + np.linspace(0.0, 1.0, 100)[:, None] * (end - start)
        clearances.append(along[:, 2] - build_terrain(s).height_m(along[:, :2]))
    assert np.concatenate(clearances).min() > 30.0 - 1.0
    assert np.concatenate(clearances).max() < 30.0 + 12.0
    assert above[-1, :2] == pytest.approx((-200.0, 40.0), abs=0.1), "home, where it lands"
    assert not [*warnings_for_file(s, plan)]
    drawn = [(lat, lon) for lat, lon in survey.VisualTransectPoints]
    assert len(drawn) < len(survey.Items), "the ways are none of the transects"
    again = coverage_from_qgc(plan, s.frame, s.camera.lens, 30.0)
    assert again.waypoints_xy_enu_m == pytest.approx(planned(s).waypoints_xy_enu_m, abs=0.05)


def test_far_from_home_heights_above_the_sea_count_the_curve_of_the_earth():
    """A plain at sea level lies 4.5 m below the home's horizon after 7.6 km; paths led that much lower."""
    away_m = 7500.0
    s = scenario(
        area=Area(polygon_enu_m=((away_m, 0), (away_m + 300, 0), (away_m + 300, 120), (away_m, 120))),
        terrain=Terrain(heightmap_m=(np.linspace(0.0, -1.0, 50)[None].repeat(2, axis=0)).tolist()),
        home=Home(altitude_amsl_m=100.0),
        geofence_enu_m=None,
    )
    survey = plan_for_qgc(s, planned(s)).surveys[0].TransectStyleComplexItem
    places = np.array([item.params[4:] for item in survey.Items])
    enu = s.frame.enu_from_geodetic(places + np.array([0.0, 0.0, s.frame.altitude_m - 100.0]))
    agl_m = enu[:, 2] - build_terrain(s).height_m(enu[:, :2])
    assert agl_m.min() > 30.0 - 0.05
    assert places[:, 2].max() > 130.0 + 3.0


def test_near_the_ceiling_the_path_keeps_closer_to_the_ground():
    low = scenario(terrain=Terrain(hills_height_m=40), home=Home(altitude_amsl_m=200))
    high = scenario(
        terrain=Terrain(hills_height_m=40),
        home=Home(altitude_amsl_m=200),
        safety=Safety(altitude_max_agl_m=31.0),
    )
    files = [plan_for_qgc(s, planned(s)) for s in (low, high)]
    points = [len(f.surveys[0].TransectStyleComplexItem.Items) for f in files]
    assert points[1] > points[0]
    assert not [*warnings_for_file(low, files[0])]


def test_plain_waypoints_become_the_path_in_order(tmp_path):
    plan = read(
        tmp_path,
        drawn(
            [
                simple(22, 3, 15, 0, 0, None, 47.0, 8.0, 25),
                simple(16, 3, 0, 0, 0, None, 47.001, 8.0, 25),
                simple(16, 0, 0, 0, 0, None, 47.001, 8.001, 525),
                simple(178, 2, 1, 5, -1, 0, 0, 0, 0),
                simple(16, 10, 0, 0, 0, None, 47.002, 8.001, 25),
                simple(20, 2, 0, 0, 0, 0, 0, 0, 0),
            ]
        ),
    )
    points = plan.waypoints
    assert [(p.latitude_deg, p.longitude_deg) for p in points] == [
        (47.001, 8.0),
        (47.001, 8.001),
        (47.002, 8.001),
    ]
    assert [(p.altitude_m, p.above) for p in points] == [(25, "home"), (525, "sea level"), (25, "terrain")]
    s = scenario(home=Home(latitude_deg=47, longitude_deg=8, altitude_amsl_m=500), geofence_enu_m=None)
    coverage = coverage_from_qgc(plan, s.frame, s.camera.lens, 25.0)
    assert coverage.waypoints_xy_enu_m[0] == pytest.approx([0.0, 111.2], abs=0.1)
    assert coverage.waypoints_xy_enu_m[1] == pytest.approx([76.05, 111.2], abs=0.1)
    assert len(coverage.transects) == 2


@pytest.mark.parametrize(
    ("camera", "above"),
    [
        ({"version": 2, "DistanceMode": 1}, "home"),
        ({"version": 2, "DistanceMode": 2}, "sea level"),
        ({"version": 2, "DistanceMode": 3}, "terrain"),
        ({"version": 2, "DistanceMode": 4}, "terrain"),
        ({"version": 1, "DistanceToSurfaceRelative": True}, "home"),
        ({"version": 1, "DistanceToSurfaceRelative": False}, "sea level"),
    ],
)
def test_a_surveys_altitude_says_above_what(tmp_path, camera, above):
    style = {
        "CameraCalc": {
            "AdjustedFootprintFrontal": 20,
            "AdjustedFootprintSide": 15,
            "CameraName": "Manual (no camera specs)",
            "DistanceToSurface": 40,
            **camera,
        },
        "CameraShots": 0,
        "CameraTriggerInTurnAround": True,
        "FollowTerrain": False,
        "HoverAndCapture": False,
        "Items": [],
        "Refly90Degrees": False,
        "TurnAroundDistance": 10,
        "VisualTransectPoints": [
            *[[latitude, 8] for latitude in (46.9999, 47, 47.001, 47.0011)],
            *[[latitude, 8.0002] for latitude in (47.0011, 47.001, 47, 46.9999)],
        ],
        "version": camera["version"],
    }
    survey = {
        "TransectStyleComplexItem": style,
        "angle": 0,
        "complexItemType": "survey",
        "entryLocation": 0,
        "flyAlternateTransects": False,
        "polygon": [[47, 8], [47.001, 8], [47.001, 8.0002], [47, 8.0002]],
        "splitConcavePolygons": False,
        "type": "ComplexItem",
        "version": 5,
    }
    plan = read(tmp_path, drawn([survey]))
    assert {(p.altitude_m, p.above) for p in plan.waypoints} == {(40, above)}
    frame = scenario(home=Home(latitude_deg=47, longitude_deg=8)).frame
    coverage = coverage_from_qgc(plan, frame, CameraModel().lens, 40.0)
    assert (len(coverage.waypoints_xy_enu_m), len(coverage.transects)) == (4, 2)
    assert coverage.spacing_m == 15
    assert np.cos(np.radians(2 * coverage.heading_deg)) == pytest.approx(1.0)
    assert survey_polygons(plan)[0].bounds == (8, 47, 8.0002, 47.001)


def test_fences_rally_points_and_foreign_keys_are_kept(tmp_path, plan_file):
    plan = read_plan(plan_file)
    circle = FenceCircle.model_validate(
        {"inclusion": False, "circle": {"center": [60.45, 22.3], "radius": 20.0}}
    )
    fences = GeoFence(polygons=plan.geoFence.polygons, circles=[circle])
    more = plan.model_copy(
        update={"geoFence": fences, "rallyPoints": RallyPoints(points=[(60.4, 22.3, 15.0)])}
    )
    again = read_plan(write_plan(tmp_path / "more.plan", more))
    assert again == more
    assert not again.geoFence.circles[0].inclusion
    foreign = read(tmp_path, drawn([simple(16, 3, 0, 0, 0, None, 47.0, 8.0, 25)], customKey={"a": None}))
    kept = json.loads(write_plan(tmp_path / "kept.plan", foreign).read_text())
    assert kept["customKey"] == {"a": None}
    assert kept["mission"]["items"][0]["AMSLAltAboveTerrain"] is None


@pytest.fixture(scope="module")
def mavsdk_importer():
    """MAVSDK's own importer, native; it asks for a system, so one heartbeat is played to it."""
    pytest.importorskip(
        "mavsdk", minversion="4.0", reason="MAVSDK is not installed: its importer stays untested"
    )
    from mavsdk.component_type import ComponentType
    from mavsdk.mavsdk import Configuration, Mavsdk
    from mavsdk.plugins.mission_raw import MissionRaw

    heartbeat = bytes([9, 0, 1, 1, 0]) + struct.pack("<IBBBBB", 0, 2, 12, 0, 3, 3)
    checksum = 0xFFFF
    for byte in heartbeat + bytes([50]):  # CRC-16/MCRF4XX with the message's extra byte
        low = byte ^ (checksum & 0xFF)
        low = (low ^ (low << 4)) & 0xFF
        checksum = ((checksum >> 8) ^ (low << 8) ^ (low << 3) ^ (low >> 4)) & 0xFFFF
    mavsdk = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
    mavsdk.add_any_connection("raw://")
    mavsdk.pass_received_raw_bytes(b"\xfe" + heartbeat + struct.pack("<H", checksum))
    yield MissionRaw(mavsdk.first_autopilot(5.0)).import_qgroundcontrol_mission
    mavsdk.destroy()


def test_mavsdk_imports_what_we_write(mavsdk_importer, tmp_path):
    s = scenario()
    coverage = planned(s)
    plan = plan_for_qgc(s, coverage).model_copy(
        update={"rallyPoints": RallyPoints(points=[(60.449, 22.297, 20.0)])}
    )
    imported = mavsdk_importer(str(write_plan(tmp_path / "a.plan", plan)))
    commands = [item.command for item in imported.mission_items]
    assert commands == [22, 178, 205, *[16] * len(coverage.waypoints_xy_enu_m), 20]
    waypoints = [i for i in imported.mission_items if i.command == 16]
    geodetic = np.array([(i.x / 1e7, i.y / 1e7, s.home.altitude_amsl_m) for i in waypoints])
    assert s.frame.enu_from_geodetic(geodetic)[:, :2] == pytest.approx(coverage.waypoints_xy_enu_m, abs=0.02)
    assert {(i.frame, i.z) for i in waypoints} == {(3, 30.0)}
    assert [item.command for item in imported.geofence_items] == [5001] * 4
    assert [item.z for item in imported.rally_items] == [20.0]


def test_mavsdk_refuses_what_is_no_plan(mavsdk_importer, tmp_path):
    (tmp_path / "b.plan").write_text('{"fileType": "Plan"}')
    with pytest.raises(Exception, match="FAILED_TO_PARSE_QGC_PLAN"):
        mavsdk_importer(str(tmp_path / "b.plan"))


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.9, 0.999])
def test_a_truncated_plan_is_told_as_one(plan_file, share):
    text = plan_file.read_text().rstrip()
    plan_file.write_text(text[: int(share * len(text))])
    with pytest.raises(UserError, match=r"a\.plan: line \d+ .*save the plan again"):
        read_plan(plan_file)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda d: d.update(fileType="Mission"), 'fileType is not "Plan"'),
        (lambda d: d.update(version=2), "version"),
        (lambda d: d["mission"].update(version=1), r"mission\.version"),
        (lambda d: d["mission"].pop("items"), r"mission\.items: field required"),
        (lambda d: d["mission"]["items"][0].pop("frame"), r"mission\.items\[0\]\.frame"),
        (lambda d: d["mission"]["items"][0]["params"].pop(), r"mission\.items\[0\]\.params"),
        (
            lambda d: d["mission"]["items"][3].update(complexItemType="StructureScan"),
            r"items\[3\].*StructureScan",
        ),
        (lambda d: d["mission"]["items"][3].pop("TransectStyleComplexItem"), "TransectStyleComplexItem"),
        (lambda d: d["mission"]["items"][3]["polygon"][0].__setitem__(0, 91.0), r"polygon\[0\]\[0\]"),
        (lambda d: d["mission"].update(plannedHomePosition=[0, 0]), "plannedHomePosition"),
        (
            lambda d: d["geoFence"]["polygons"][0].update(polygon=[[0, 0]]),
            r"geoFence\.polygons\[0\]\.polygon",
        ),
        (lambda d: d["mission"].update(hoverSpeed=float("nan")), "NaN is no JSON number"),
    ],
)
def test_a_wrong_plan_names_file_and_field(plan_file, change, words):
    data = json.loads(plan_file.read_text())
    change(data)
    plan_file.write_text(json.dumps(data))
    with pytest.raises(UserError, match=rf"a\.plan: .*{words}"):
        read_plan(plan_file)


@given(
    st.recursive(
        st.none() | st.booleans() | st.floats() | st.text(),
        lambda c: (
            st.lists(c)
            | st.dictionaries(st.sampled_from(["fileType", "mission", "items", "version", "type", "Plan"]), c)
        ),
    )
)
@settings(max_examples=100)
def test_no_json_breaks_the_reader(tmp_path_factory, data):
    file = tmp_path_factory.mktemp("any") / "x.plan"
    file.write_text(json.dumps({"fileType": "Plan", "version": 1, "mission": data}))
    with pytest.raises(UserError):
        read_plan(file)


def test_deep_huge_missing_and_foreign_files_are_refused(tmp_path):
    with pytest.raises(UserError, match="deeply"):
        read(tmp_path, "[" * 200_000)
    with pytest.raises(UserError, match="no such file"):
        read_plan(tmp_path / "none.plan")
    with pytest.raises(UserError, match="folder"):
        read_plan(tmp_path)
    (tmp_path / "x.plan").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(UserError, match="UTF-8"):
        read_plan(tmp_path / "x.plan")
    with pytest.raises(UserError, match="larger than 20 MB"):
        read(tmp_path, " " * 20_000_001)


def test_a_plan_without_a_path_is_told(tmp_path):
    plan = read(tmp_path, drawn([simple(22, 3, 15, 0, 0, None, 47.0, 8.0, 25)]))
    with pytest.raises(UserError, match=r"mission\.items: there is no path"):
        coverage_from_qgc(plan, scenario().frame, CameraModel().lens, 30.0)


def test_writing_to_no_place_is_told_and_leaves_nothing(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(UserError, match="cannot be made or written to"):
        write_plan(tmp_path / "file" / "a.plan", read(tmp_path, drawn([])))


def test_a_zigzag_of_as_many_waypoints_as_may_be_is_planned(tmp_path):
    path = tmp_path / "a.plan"
    path.write_text(json.dumps(drawn(zigzag(MAX_WAYPOINTS))))
    plan = read_plan(path)
    coverage = coverage_from_qgc(plan, LocalFrame(47.0, 8.0, 500.0), CameraModel().lens, 30.0)
    assert len(coverage.waypoints_xy_enu_m) == MAX_WAYPOINTS


def test_more_waypoints_are_refused(tmp_path):
    path = tmp_path / "a.plan"
    path.write_text(json.dumps(drawn(zigzag(MAX_WAYPOINTS + 1))))
    with pytest.raises(
        UserError, match=r"a\.plan: mission\.items: has 10,001 waypoints; draw at most 10,000"
    ):
        read_plan(path)


@given(st.lists(st.tuples(st.integers(-9, 9), st.integers(-9, 9)), min_size=2, max_size=30))
def test_the_bends_of_a_path_keep_it_within_the_tolerance(points):
    path = np.array(points, dtype=float)
    kept = path[_bends(path, 0.5)]
    assert (kept[0] == path[0]).all()
    assert (kept[-1] == path[-1]).all()
    assert shapely.distance(shapely.LineString(kept), shapely.points(path)).max() <= 0.5 + 1e-9
