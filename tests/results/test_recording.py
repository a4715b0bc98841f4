from __future__ import annotations

import json

import cv2
import numpy as np
import pytest
from mcap.reader import make_reader
from results_data import tiny_records, write_run
from rosbags.highlevel import AnyReader
from scipy.spatial.transform import Rotation

from skysweep.results.foxglove import LAYOUT_FILE
from skysweep.results.picture_files import picture_name, write_picture
from skysweep.results.recording import write_recording
from skysweep.results.run_folder import FILM, PICTURES, load_run
from skysweep.results.writing import write_results


@pytest.fixture
def path(tiny_run, tmp_path):
    return write_recording(tiny_run, tmp_path / "mission.mcap")


@pytest.fixture
def messages(path):
    return messages_of(path)


def messages_of(path):
    """Time in seconds, topic and message, read with nothing but what the file itself brings."""
    with AnyReader([path]) as bag:
        return [
            (t / 1e9, connection.topic, bag.deserialize(raw, connection.msgtype))
            for connection, t, raw in bag.messages()
        ]


def picture(grey, width_px=640):
    return cv2.imencode(".jpg", np.full((width_px // 2, width_px, 3), grey, np.uint8))[1].tobytes()


@pytest.fixture
def filmed(tmp_path):
    """The tiny mission with three looks, two of them filmed, and a picture of candidate 1."""
    looks = [
        {
            "t": t,
            "kind": "look",
            "boxes_xyxy_px": [[10, 20, 30, 50]] * n,
            "confidences": [0.75] * n,
            "class_names": ["stop sign"] * n,
        }
        for t, n in ((11.2, 0), (11.6, 2), (15.0, 1))
    ]
    folder = write_run(tmp_path / "run", sorted(tiny_records() + looks, key=lambda record: record["t"]))
    for name, grey in (("11.2000", 50), ("15.0000", 200)):
        (folder / FILM).mkdir(exist_ok=True)
        write_picture(folder / FILM / f"{name}.jpg", picture(grey))
    (folder / PICTURES).mkdir()
    write_picture(folder / PICTURES / picture_name(1, 15.0), picture(100))
    return load_run(folder)


def of(messages, topic):
    return [(t, message) for t, name, message in messages if name == topic]


def test_rosbags_opens_it_with_the_schemas_of_ros(path):
    with AnyReader([path]) as bag:
        assert {c.topic: c.msgtype for c in bag.connections} == {
            "/tf": "tf2_msgs/msg/TFMessage",
            "/tf_static": "tf2_msgs/msg/TFMessage",
            "/skysweep/altitude_agl": "std_msgs/msg/Float64",
            "/skysweep/battery": "sensor_msgs/msg/BatteryState",
            "/skysweep/camera/camera_info": "sensor_msgs/msg/CameraInfo",
            "/skysweep/fix": "sensor_msgs/msg/NavSatFix",
            "/skysweep/flown_path": "nav_msgs/msg/Path",
            "/skysweep/geojson": "foxglove_msgs/msg/GeoJSON",
            "/skysweep/planned_path": "nav_msgs/msg/Path",
            "/skysweep/pose": "geometry_msgs/msg/PoseStamped",
            "/skysweep/state": "std_msgs/msg/String",
            "/skysweep/targets": "visualization_msgs/msg/MarkerArray",
            "/skysweep/vehicle": "visualization_msgs/msg/MarkerArray",
            "/skysweep/world": "visualization_msgs/msg/MarkerArray",
            "/rosout": "rcl_interfaces/msg/Log",
        }
        targets = next(c for c in bag.connections if c.topic == "/skysweep/targets")
        (quality,) = targets.ext.offered_qos_profiles
        assert quality.durability.name == "TRANSIENT_LOCAL"


def test_file_is_what_rosbag2_writes(path):
    with path.open("rb") as file:
        reader = make_reader(file)
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
    assert {s.encoding for s in summary.schemas.values()} == {"ros2msg"}
    assert {c.message_encoding for c in summary.channels.values()} == {"cdr"}
    assert all(c.metadata["topic_type_hash"].startswith("RIHS01_") for c in summary.channels.values())


def test_poses_and_fixes_follow_the_states(messages):
    poses = [(t, m.pose.position) for t, m in of(messages, "/skysweep/pose")]
    assert [t for t, _ in poses] == [0, 10, 15, 30, 35, 60, 70, 80]
    assert (poses[2][1].x, poses[2][1].y, poses[2][1].z) == (5, 10, 2)
    fixes = [m for _, m in of(messages, "/skysweep/fix")]
    assert fixes[0].latitude == pytest.approx(60.4490 + 10 / 111_412, abs=1e-6)
    assert all(np.isnan(m.altitude) for m in fixes)  # above the ellipsoid: unknown


def test_frames_chain_from_map_to_a_camera_that_looks_down(messages):
    chain = {}
    for _, m in of(messages, "/tf_static") + of(messages, "/tf")[:1]:
        chain |= {t.child_frame_id: t for t in m.transforms}
    R, frame, parents = np.eye(3), "camera", []
    while frame != "map":
        turn = chain[frame].transform.rotation
        R = Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).as_matrix() @ R
        frame = chain[frame].header.frame_id
        parents.append(frame)
    assert parents == ["gimbal", "base_link", "odom", "map"]
    assert R[:, 2] == pytest.approx([0, 0, -1])


def test_candidates_end_with_their_verdict(messages):
    _, last = of(messages, "/skysweep/targets")[-1]
    labels = {marker.text for marker in last.markers if marker.text}
    assert {"1 target confirmed", "2 target rejected"} <= labels


def test_flown_path_is_whole_at_the_end(messages):
    _, flown = of(messages, "/skysweep/flown_path")[-1]
    assert len(flown.poses) == 8


def test_same_run_gives_the_same_bytes(tiny_run, tmp_path):
    one = write_recording(tiny_run, tmp_path / "1.mcap").read_bytes()
    assert one == write_recording(tiny_run, tmp_path / "2.mcap").read_bytes()


def stamp(message):
    return message.header.stamp.sec + message.header.stamp.nanosec / 1e9


def test_pictures_have_the_time_and_boxes_of_their_look(filmed, tmp_path):
    messages = messages_of(write_recording(filmed, tmp_path / "mission.mcap"))
    shown = of(messages, "/skysweep/camera/image_raw/compressed")
    assert [t for t, _ in shown] == [11.2, 15.0]
    latency_s = filmed.scenario.camera.latency_s
    assert [stamp(m) for _, m in shown] == pytest.approx([11.2 - latency_s, 15.0 - latency_s])
    assert [round(cv2.imdecode(m.data, 0).mean()) for _, m in shown] == pytest.approx([50, 200], abs=2)
    infos = [(t, m.header) for t, m in of(messages, "/skysweep/camera/camera_info")]
    assert infos[1:] == [(t, m.header) for t, m in shown]
    found = of(messages, "/skysweep/camera/annotations")
    assert [(t, len(m.texts)) for t, m in found] == [(11.2, 0), (11.6, 2), (15.0, 1)]
    (empty,) = found[0][1].points
    assert empty.timestamp == shown[0][1].header.stamp
    assert not empty.points
    (outline,), (text,) = found[-1][1].points, found[-1][1].texts
    assert [(p.x, p.y) for p in outline.points] == [(10, 20), (30, 20), (30, 50), (10, 50)]
    assert outline.timestamp == shown[-1][1].header.stamp
    assert text.text == "stop sign 0.75"
    ((t, evidence),) = of(messages, "/skysweep/evidence/compressed")
    assert (t, evidence.format) == (15.0, "jpeg")


def test_boxes_and_camera_fit_pictures_that_were_kept_smaller(filmed, tmp_path):
    for path in (filmed.folder / FILM).iterdir():
        write_picture(path, picture(90, 320))
    messages = messages_of(write_recording(filmed, tmp_path / "mission.mcap"))
    _, found = of(messages, "/skysweep/camera/annotations")[-1]
    assert [(p.x, p.y) for p in found.points[0].points] == [(5, 10), (15, 10), (15, 25), (5, 25)]
    for _, info in of(messages, "/skysweep/camera/camera_info"):
        assert (info.width, info.height, info.k[2]) == (320, 160, 160)


def test_map_has_the_area_at_its_place_and_every_verdict(messages):
    (_, first), *rest = of(messages, "/skysweep/geojson")
    names = [f["properties"]["name"] for f in json.loads(first.geojson)["features"]]
    assert names == ["search area", "home", "planned path"]
    area = np.array(json.loads(first.geojson)["features"][0]["geometry"]["coordinates"][0])
    assert np.ptp(area[:, 1]) == pytest.approx(20 / 111_412, rel=0.01)
    assert area[:, 1].min() == pytest.approx(60.449, abs=1e-6)
    told = [(t, json.loads(m.geojson)["features"][0]["properties"]["name"]) for t, m in rest]
    assert (16.0, "1 target confirmed") in told
    assert (20.0, "2 target rejected") in told
    assert len(told) == 5


def test_what_moves_is_drawn_where_it_is(tmp_path):
    walker = {
        "class": "person",
        "position_enu_m": [5, 10],
        "motion": {"kind": "path", "waypoints_enu_m": [[35, 10]], "speed_mps": 0.5},
    }
    folder = write_run(tmp_path / "run", tiny_records(), targets=[walker])
    messages = messages_of(write_recording(load_run(folder), tmp_path / "mission.mcap"))
    places = {
        t: mark.pose.position.x
        for t, drawn in of(messages, "/skysweep/moving")
        for mark in drawn.markers
        if mark.ns == "truth"
    }
    assert places[0.0] == pytest.approx(5.0)
    assert places[10.0] == pytest.approx(10.0)
    ((_, world),) = of(messages, "/skysweep/world")
    assert [mark.ns for mark in world.markers if mark.id == 0] == ["area", "truth tracks"]


def test_vehicle_is_drawn_in_its_own_frame(messages):
    ((_, drawn),) = of(messages, "/skysweep/vehicle")
    assert {mark.header.frame_id for mark in drawn.markers} == {"base_link"}
    assert all(mark.frame_locked for mark in drawn.markers)


def test_altitude_is_above_ground(messages):
    assert [m.data for _, m in of(messages, "/skysweep/altitude_agl")][:3] == [0, 10, 2]


def _names(layout):
    return [layout] if isinstance(layout, str) else _names(layout["first"]) + _names(layout["second"])


@pytest.mark.parametrize("run", ["tiny_run", "filmed"])
def test_layout_shows_topics_of_the_recording(run, tmp_path, request):
    """Panel types are those in Foxglove's own list, and every topic and field exists in the recording."""
    write_results(request.getfixturevalue(run), tmp_path / "out")
    layout = json.loads((tmp_path / "out" / LAYOUT_FILE).read_text())
    panels = layout["configById"]
    assert sorted(_names(layout["layout"])) == sorted(panels)
    kinds = [name.partition("!")[0] for name in panels]
    assert sorted(kinds) == ["3D", "Image", "Plot", "Plot", "RosOut", "StateTransitions", "map"]
    messages = {topic: message for _, topic, message in messages_of(tmp_path / "out" / "mission.mcap")}
    for path in (path for panel in panels.values() for path in panel.get("paths", ())):
        topic, _, field = path["value"].partition(".")
        assert hasattr(messages[topic], field)
    shown = set(panels["3D!scene"]["topics"])
    if run == "filmed":
        shown |= {panels["Image!picture"]["imageMode"][key] for key in ("imageTopic", "calibrationTopic")}
        shown |= set(panels["Image!picture"]["imageMode"]["annotations"])
    assert shown <= set(messages)
