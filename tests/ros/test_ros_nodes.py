"""Nodes in processes of their own."""

from __future__ import annotations

import importlib.util
import json
import os
import socket
import subprocess
import sys
import threading
import time
from contextlib import closing
from pathlib import Path
from urllib.request import Request, urlopen

import numpy as np
import pytest

from skysweep.errors import UserError
from skysweep.geometry.camera import CameraPose, Lens
from skysweep.mission.journal import read_journal
from skysweep.ros import messages as m
from skysweep.ros import topics
from skysweep.ros.interfaces import make, type_hash
from skysweep.ros.topics import Quality, Topic
from skysweep.scenarios.files import change_scenario, load_scenario
from skysweep.types import Frame, Setpoint
from skysweep.vehicles.template import PointVehicle

pytestmark = pytest.mark.skipif(
    importlib.util.find_spec("rclpy") is None,
    reason="ROS 2 is not installed: pip install 'skysweep[ros]' runs these tests",
)

APPEAR_S = 120.0  # a busy machine takes long to start a process
BLOB_NODE = Path(__file__).parent / "red_blob_node.py"
SKYSWEEP_ROS = ("-m", "skysweep.cli", "ros")
SMALL_PICTURES = ("--set", "camera.width_px=320", "--set", "camera.height_px=180")
LENS = Lens(320, 180, 1.4)
NOWHERE = CameraPose(np.zeros(3), np.eye(3))
DOWN = Quality(10, reliable=True, latched=False)


def eventually(condition, patience_s=APPEAR_S):
    deadline = time.monotonic() + patience_s
    while not (answer := condition()):
        assert time.monotonic() < deadline, "it did not happen"
        time.sleep(0.05)
    return answer


def picture(colour, time_s=1.0):
    image = np.full((180, 320, 3), 90, np.uint8)
    image[40:60, 100:130] = colour
    return Frame(time_s, image, NOWHERE, LENS)


def call(link, service):
    from std_srvs.srv import Trigger

    client = link.node.create_client(Trigger, service)
    assert client.wait_for_service(APPEAR_S)
    future = client.call_async(Trigger.Request())
    return eventually(lambda: future.done() and future.result())


def test_types_that_no_wheel_brings_are_published_under_their_own_name_and_hash(link):
    for topic in (topics.TF, topics.DETECTIONS):
        link.publish(topic, make(topic.type_name))
        (publisher,) = link.node.get_publishers_info_by_topic(link.node.resolve_topic_name(topic.name))
        assert publisher.topic_type == topic.type_name
        assert str(publisher.topic_type_hash) == type_hash(topic.type_name)


def test_what_is_sent_is_what_rclpy_reads(link):
    from nav_msgs.msg import Odometry

    got = []
    link.node.create_subscription(Odometry, "odometry", got.append, 10)
    link.advertise(topics.ODOMETRY)
    assert link.wait_for_listener(topics.ODOMETRY, APPEAR_S)
    link.publish(topics.ODOMETRY, m.odometry(PointVehicle([1.0, 2.0, 3.0]).state()))
    eventually(lambda: got)
    place = got[0].pose.pose.position
    assert (got[0].header.frame_id, got[0].child_frame_id) == ("odom", "base_link")
    assert (place.x, place.y, place.z) == (1.0, 2.0, 3.0)


def test_another_process_detects_what_the_same_detector_finds_here(link, start):
    from skysweep.detection.yolo import YoloDetector
    from skysweep.ros.parts import RosDetector
    from skysweep.scenarios.files import load_scenario
    from skysweep.worlds.rendering.renderer import make_renderer
    from skysweep.worlds.world import build_world

    scenario = load_scenario("clusters")
    sign = build_world(scenario, 0).objects[0].position_enu_m
    camera = CameraPose(sign + np.array([0.0, 0.0, 8.0]), np.diag([1.0, -1.0, -1.0]))
    renderer = make_renderer(build_world(scenario, 0), "auto")
    frame = Frame(5.0, renderer.render(scenario.camera.lens, camera, 5.0), camera, scenario.camera.lens)
    renderer.close()

    start(*SKYSWEEP_ROS, "detect", "--patience", APPEAR_S)
    remote = RosDetector(link, "detections", scenario.target_classes, 0.25, APPEAR_S, 40.0).detect(frame)
    here = YoloDetector("skysweep", scenario.target_classes, confidence_min=0.25).detect(frame)
    assert len(here) >= 1
    assert remote.class_names == here.class_names
    np.testing.assert_allclose(remote.boxes_xyxy_px, here.boxes_xyxy_px, atol=1e-3)
    assert remote.camera is frame.camera
    assert remote.lens is frame.lens


def test_a_detector_that_knows_nothing_of_us_answers_in_the_standard_form(link, start):
    from skysweep.ros.parts import NoMessageError, RosDetector

    blobs = start(BLOB_NODE)
    detector = RosDetector(link, "/blobs", ("stop sign",), 0.25, APPEAR_S, 20.0)
    red = detector.detect(picture((200, 20, 20), 1.0))
    assert red.boxes_xyxy_px.tolist() == [[100, 40, 130, 60]]
    assert red.confidences == pytest.approx([0.9])
    assert red.time_s == 1.0
    assert len(detector.detect(picture((90, 90, 90), 2.0))) == 0

    blobs.kill()
    blobs.wait()
    detector._answer_s = detector._patience_s = 0.5
    with pytest.raises(NoMessageError, match="/blobs: no answer to a picture"):
        detector.detect(picture((200, 20, 20), 3.0))


def test_a_mission_flies_with_somebody_elses_detector(link, start, tiny, tmp_path):
    start(BLOB_NODE)
    options = ("--detector", "/blobs", "--speed", 50, "--out", "run")
    mission = start(*SKYSWEEP_ROS, "fly", tiny, *options, *SMALL_PICTURES)
    output, _ = mission.communicate(timeout=600)
    assert mission.returncode == 0, output
    journal = read_journal(tmp_path / "run" / "journal.jsonl")
    confirmed = [record["p"] for record in journal if record["kind"] == "confirmed"]
    assert len(confirmed) == 2
    for sign in ([9, 8], [27, 12]):
        assert min(np.hypot(*np.subtract(p[:2], sign)) for p in confirmed) < 2.0


def test_a_mission_goes_on_and_comes_home_when_the_detectors_node_is_killed(link, start, tiny, tmp_path):
    blobs = start(BLOB_NODE)
    short = ("--set", "safety.detector_silent_s=1", "--set", "safety.detector_dead_s=3", *SMALL_PICTURES)
    mission = start(*SKYSWEEP_ROS, "fly", tiny, "--detector", "/blobs", "--speed", 50, "--out", "run", *short)
    state = link.listen(topics.STATE.name, [topics.STATE.type_name], APPEAR_S)
    late = {}

    def scanning():
        newest = state.newest()
        late["mode"] = newest and newest.message.data
        return late["mode"] == "SCAN"

    eventually(scanning, 180.0)
    blobs.kill()
    output, _ = mission.communicate(timeout=600)
    assert mission.returncode == 0, output
    journal = read_journal(tmp_path / "run" / "journal.jsonl")
    causes = {record["cause"] for record in journal if record["kind"] == "safety"}
    assert any("detector" in cause for cause in causes)
    assert [record["kind"] for record in journal][-2:] == ["landed", "end"]
    last = [record["p"] for record in journal if record["kind"] == "state"][-1]
    assert np.hypot(last[0] + 5, last[1] + 5) < 3.0


def test_start_pause_abort_and_late_joiner(link, start, tiny, tmp_path):
    from skysweep.ros.link import Inlet

    options = ("--sensor", "statistical", "--speed", 4, "--wait", "--out", "run")
    mission = start(*SKYSWEEP_ROS, "fly", tiny, *options)
    assert not call(link, "/skysweep/mission/abort").success
    assert call(link, "/skysweep/mission/start").message == "begun"

    joined = {
        topic.name: Inlet(link, topic.full_name, topic.type_name, topic.quality)
        for topic in (topics.STATE, topics.PLANNED_PATH, topics.TARGETS, topics.TF_STATIC, topics.TF)
    }

    def newest(topic):
        arrival = joined[topic.name].newest()
        return arrival.message if arrival else None

    def mode():
        return newest(topics.STATE).data if newest(topics.STATE) else None

    eventually(lambda: mode() in ("SCAN", "CHECK"))
    assert eventually(lambda: newest(topics.TARGETS)).markers is not None
    assert len(eventually(lambda: newest(topics.PLANNED_PATH)).poses) >= 2
    fixed = eventually(lambda: newest(topics.TF_STATIC)).transforms
    moving = eventually(lambda: newest(topics.TF)).transforms
    assert {(t.header.frame_id, t.child_frame_id) for t in (*fixed, *moving)} == {
        ("map", "odom"),
        ("odom", "base_link"),
        ("base_link", "gimbal"),
        ("gimbal", "camera"),
    }
    assert call(link, "/skysweep/mission/pause").success
    eventually(lambda: mode() == "HOLD")
    assert call(link, "/skysweep/mission/start").message == "continue"
    eventually(lambda: mode() != "HOLD")
    assert call(link, "/skysweep/mission/abort").success
    output, _ = mission.communicate(timeout=120)
    assert mission.returncode == 0, output
    (end,) = [r for r in read_journal(tmp_path / "run" / "journal.jsonl") if r["kind"] == "end"]
    assert end["reason"] == "operator"


def test_a_mission_that_waits_for_nobody_is_paused_and_ended(link, start, tiny, tmp_path):
    options = ("--sensor", "statistical", "--speed", 4, "--out", "run")
    mission = start(*SKYSWEEP_ROS, "fly", tiny, *options)
    state = link.listen(topics.STATE.name, [topics.STATE.type_name], APPEAR_S)

    def mode():
        return state.newest() and state.newest().message.data

    eventually(lambda: mode() in ("SCAN", "CHECK"))
    paused = call(link, "/skysweep/mission/pause")
    assert (paused.success, paused.message) == (True, "hold")
    eventually(lambda: mode() == "HOLD")
    assert call(link, "/skysweep/mission/abort").success
    output, _ = mission.communicate(timeout=120)
    assert mission.returncode == 0, output
    assert read_journal(tmp_path / "run" / "journal.jsonl")[-1]["reason"] == "operator"


def test_the_live_page_and_the_services_steer_the_same_mission(link, start, tiny, tmp_path):
    """Its folder is the one of the parameter, and every order is given once."""
    options = ("--sensor", "statistical", "--speed", 4, "--wait", "--live", "--no-browser")
    mission = start(*SKYSWEEP_ROS, "fly", tiny, *options, "--ros-args", "-p", "out:=elsewhere")
    address = next(line for line in mission.stdout if line.startswith("http://")).strip()
    base, _, token = address.partition("/#token=")
    state = link.listen(topics.STATE.name, [topics.STATE.type_name], APPEAR_S)

    def mode():
        return state.newest() and state.newest().message.data

    def order(word):
        headers = {"authorization": f"Bearer {token}", "content-type": "application/json"}
        body = json.dumps({"word": word}).encode()
        urlopen(Request(f"{base}/api/runs/_/operator", body, headers), timeout=APPEAR_S).close()

    next(line for line in mission.stdout if "waiting for /skysweep/mission/start" in line)
    eventually(lambda: mode() == "READY")
    order("continue")
    eventually(lambda: mode() in ("SCAN", "CHECK"))
    order("hold")
    eventually(lambda: mode() == "HOLD")
    assert call(link, "/skysweep/mission/start").message == "continue"
    eventually(lambda: mode() != "HOLD")
    order("return")
    output, _ = mission.communicate(timeout=120)
    assert mission.returncode == 0, output
    journal = read_journal(tmp_path / "elsewhere" / "journal.jsonl")
    assert [r["word"] for r in journal if r["kind"] == "operator"] == ["hold", "continue", "return"]
    assert journal[-1]["reason"] == "operator"


def test_parameters_win_over_options_and_names_can_be_remapped(link, start, tiny, tmp_path):
    parameters = ("-p", "sensor:=statistical", "-p", "speed:=50.0", "-p", "out:=elsewhere", "-p", "seed:=4")
    mission = start(*SKYSWEEP_ROS, "fly", tiny, "--seed", 1, "--ros-args", "-r", "__ns:=/uav1", *parameters)
    link.listen("/uav1/odometry", [m.ODOMETRY], APPEAR_S)
    output, _ = mission.communicate(timeout=200)
    assert mission.returncode == 0, output
    begin = next(r for r in read_journal(tmp_path / "elsewhere" / "journal.jsonl") if r["kind"] == "start")
    assert begin["seed"] == 4


# ---- parts, with their other end in this process ------------------------------------------------------


@pytest.fixture
def other():
    from skysweep.ros.link import RosLink

    with closing(RosLink("other", ("--ros-args", "-r", "__ns:=/other"))) as made:
        yield made


def test_pictures_of_a_topic_become_frames_with_the_pose_of_their_time(link, other):
    from skysweep.ros.parts import NoMessageError, RosCamera

    camera_topic = Topic("/drone/image", m.IMAGE, topics.LATCHED)
    red, blue = (200, 20, 20), (20, 20, 200)
    other.publish(camera_topic, m.image(picture(blue, time_s=1.0)))
    camera = RosCamera(link, "/drone/image", LENS, APPEAR_S)
    vehicle = PointVehicle([0.0, 0.0, 20.0])
    vehicle.advance(10.0)
    first = camera.capture(vehicle.state())
    assert first.image[50, 110].tolist() == list(blue)
    assert first.time_s == 10.0  # its stamp is of another clock

    vehicle.advance(1.0)
    other.publish(camera_topic, m.image(picture(red, link.now_s() - 0.2)))
    second = camera.capture(vehicle.state())
    assert second.image[50, 110].tolist() == list(red)
    assert 9.0 <= second.time_s <= 10.8
    np.testing.assert_allclose(second.camera.position_enu_m, [0.0, 0.0, 20.0])
    with pytest.raises(NoMessageError, match="/drone/image: no picture for"):
        camera.capture(vehicle.state())


def test_a_px4_sees_through_a_topic(other, tiny):
    from skysweep.flights.on_px4 import Px4Flight
    from skysweep.vehicles.embedded.at_home import embedded_vehicle
    from skysweep.vehicles.served.server import VehicleServer

    scenario = change_scenario(load_scenario(tiny), {"camera.width_px": 320, "camera.height_px": 180})
    with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as unused:
        unused.bind(("127.0.0.1", 0))
        port = unused.getsockname()[1]
    other.publish(Topic("/drone/image", m.IMAGE, topics.LATCHED), m.image(picture((200, 20, 20))))
    with (
        VehicleServer(embedded_vehicle(scenario, 0), scenario, [("127.0.0.1", port)], 10.0),
        Px4Flight(scenario, f"udpin://127.0.0.1:{port}", 30.0) as flight,
    ):
        frame = flight.open_camera("ros:/drone/image").capture(flight.vehicle.state())
        assert frame.image[50, 110].tolist() == [200, 20, 20]


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"encoding": "bayer_rggb8"}, "/drone/image: the encoding 'bayer_rggb8' is not supported"),
        ({"width": 160, "height": 90, "step": 480}, "pictures are 160x90, the scenario's camera is 320x180"),
    ],
)
def test_a_camera_that_does_not_fit_is_refused_before_take_off(link, other, change, sentence):
    from skysweep.ros.parts import RosCamera

    message = m.image(picture((200, 20, 20)))
    for name, value in change.items():
        setattr(message, name, value)
    camera_topic = Topic("/drone/image", m.IMAGE, topics.LATCHED)
    threading.Timer(0.3, other.publish, (camera_topic, message)).start()
    with pytest.raises(UserError, match=sentence):
        RosCamera(link, "/drone/image", LENS, APPEAR_S)


def test_nobody_another_type_and_silence_are_one_sentence_each(link, other):
    from skysweep.ros.parts import RosCamera

    with pytest.raises(UserError, match=r"/nothing: nobody published this topic within 0.2 s"):
        RosCamera(link, "/nothing", LENS, 0.2)
    other.advertise(Topic("/words", "std_msgs/msg/String", DOWN))
    with pytest.raises(UserError, match="/words: is of type std_msgs/msg/String; publish sensor_msgs"):
        RosCamera(link, "/words", LENS, APPEAR_S)
    other.advertise(Topic("/mute", m.IMAGE, DOWN))
    eventually(lambda: link.node.get_publishers_info_by_topic("/mute"))
    with pytest.raises(UserError, match=r"/mute: has a publisher but no message came for 0.5 s"):
        RosCamera(link, "/mute", LENS, 0.5)


def test_a_vehicle_is_where_the_odometry_says_and_flies_there(link, other):
    from skysweep.ros.parts import RosPoseVehicle

    odometry = Topic("/rtk/odometry", m.ODOMETRY, topics.LATCHED)
    own = PointVehicle([0.0, 0.0, 0.0])
    own.takeoff(10.0)
    own.advance(20.0)
    message = m.odometry(own.state())
    message.pose.pose.position.x += 3.0
    other.publish(odometry, message)
    vehicle = RosPoseVehicle(own, link, "/rtk/odometry", APPEAR_S)
    state = vehicle.state()
    np.testing.assert_allclose(state.position_enu_m, [3.0, 0.0, 10.0])
    np.testing.assert_allclose(state.camera.position_enu_m, [3.0, 0.0, 10.0])

    vehicle.command(Setpoint(np.array([50.0, 0.0, 10.0]), 5.0, 0.0))
    vehicle.advance(60.0)
    np.testing.assert_allclose(own.state().position_enu_m, [47.0, 0.0, 10.0], atol=0.1)
    assert vehicle.state().silent_s == pytest.approx(60.0)


# ---- what is not installed ------------------------------------------------------------------------------


def test_a_middleware_that_is_not_installed_is_said(tmp_path):
    result = subprocess.run(
        [sys.executable, *SKYSWEEP_ROS, "detect"],
        env=os.environ | {"RMW_IMPLEMENTATION": "rmw_nothing_cpp"},
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert result.returncode == 2
    assert "RMW_IMPLEMENTATION=rmw_nothing_cpp: this middleware is not installed" in result.stderr


def test_a_workspace_with_the_sources_of_vision_msgs_is_no_package(start, tmp_path):
    (tmp_path / "vision_msgs" / "msg").mkdir(parents=True)
    detecting = start(*SKYSWEEP_ROS, "detect", "--patience", 1)
    output, _ = detecting.communicate(timeout=200)
    assert detecting.returncode == 2
    assert "nobody published this topic within 1 s" in output


def test_figures_come_from_a_real_detector(start):
    start(BLOB_NODE)
    options = ("--width", 320, "--height", 180, "--seconds", 3, "--patience", APPEAR_S)
    remap = ("--ros-args", "-r", "detections:=/blobs")
    measuring = start(*SKYSWEEP_ROS, "measure", *options, *remap)
    output, _ = measuring.communicate(timeout=200)
    assert measuring.returncode == 0, output
    assert "320x180 at 10 Hz: publishing takes" in output
    assert " of 30 pictures answered" in output
    assert "nan ms" not in output
