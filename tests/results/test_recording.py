from __future__ import annotations

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from scipy.spatial.transform import Rotation

from skysweep.results.recording import write_recording


@pytest.fixture
def path(tiny_run, tmp_path):
    return write_recording(tiny_run, tmp_path / "mission.mcap")


@pytest.fixture
def messages(path):
    """Time in seconds, topic and message, read with nothing but what the file itself brings."""
    with AnyReader([path]) as bag:
        return [
            (t / 1e9, connection.topic, bag.deserialize(raw, connection.msgtype))
            for connection, t, raw in bag.messages()
        ]


def of(messages, topic):
    return [(t, message) for t, name, message in messages if name == topic]


def test_rosbags_opens_it_with_the_schemas_of_ros(path):
    with AnyReader([path]) as bag:
        assert {c.topic: c.msgtype for c in bag.connections} == {
            "/tf": "tf2_msgs/msg/TFMessage",
            "/tf_static": "tf2_msgs/msg/TFMessage",
            "/skysweep/battery": "sensor_msgs/msg/BatteryState",
            "/skysweep/camera/camera_info": "sensor_msgs/msg/CameraInfo",
            "/skysweep/fix": "sensor_msgs/msg/NavSatFix",
            "/skysweep/flown_path": "nav_msgs/msg/Path",
            "/skysweep/planned_path": "nav_msgs/msg/Path",
            "/skysweep/pose": "geometry_msgs/msg/PoseStamped",
            "/skysweep/state": "std_msgs/msg/String",
            "/skysweep/targets": "visualization_msgs/msg/MarkerArray",
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
    assert fixes[1].altitude == pytest.approx(40, abs=0.01)


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
