from __future__ import annotations

import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from skysweep.results.recording import write_recording


@pytest.fixture
def messages(tiny_run, tmp_path):
    path = write_recording(tiny_run, tmp_path / "mission.mcap")
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        return [
            (schema.name, channel.topic, m.log_time, decoded)
            for schema, channel, m, decoded in reader.iter_decoded_messages()
        ]


def test_schemas_are_foxgloves(messages):
    assert {(topic, name) for name, topic, _, _ in messages} == {
        ("/tf", "foxglove.FrameTransform"),
        ("/vehicle/pose", "foxglove.PoseInFrame"),
        ("/vehicle/fix", "foxglove.LocationFix"),
        ("/camera/calibration", "foxglove.CameraCalibration"),
        ("/scene", "foxglove.SceneUpdate"),
        ("/log", "foxglove.Log"),
    }


def test_poses_and_fixes_follow_the_states(messages):
    poses = [(t, m.pose.position) for _, topic, t, m in messages if topic == "/vehicle/pose"]
    assert [t / 1e9 for t, _ in poses] == [0, 10, 15, 30, 35, 60, 70, 80]
    assert (poses[2][1].x, poses[2][1].y, poses[2][1].z) == (5, 10, 2)
    fixes = [m for _, topic, _, m in messages if topic == "/vehicle/fix"]
    assert fixes[0].latitude == pytest.approx(60.4490 + 10 / 111_412, abs=1e-6)
    assert fixes[1].altitude == pytest.approx(40, abs=0.01)


def test_camera_looks_down(messages):
    camera = next(m for _, topic, _, m in messages if topic == "/tf" and m.child_frame_id == "camera")
    q = camera.rotation
    assert 1 - 2 * (q.x**2 + q.y**2) == pytest.approx(-1)


def test_candidates_end_with_their_verdict(messages):
    last = {}
    for _, topic, _, m in messages:
        if topic == "/scene":
            last |= {e.id: e.texts[0].text for e in m.entities if e.id.startswith("candidate")}
    assert last["candidate 1"] == "1 confirmed"
    assert last["candidate 2"] == "2 rejected"


def test_same_run_gives_the_same_bytes(tiny_run, tmp_path):
    one = write_recording(tiny_run, tmp_path / "1.mcap").read_bytes()
    assert one == write_recording(tiny_run, tmp_path / "2.mcap").read_bytes()
