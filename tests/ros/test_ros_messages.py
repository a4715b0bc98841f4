from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from skysweep.errors import UserError
from skysweep.geometry.camera import CameraPose, Lens
from skysweep.geometry.frames import rotation_camera_to_enu, rotation_from_euler
from skysweep.ros import messages as m
from skysweep.ros.interfaces import definition, from_cdr, make, to_cdr, type_hash
from skysweep.types import Detections, Frame, VehicleState

LENS = Lens(64, 48, 1.2)
POSE = CameraPose(np.array([1.0, 2.0, 30.0]), rotation_camera_to_enu(0.3, -np.pi / 2))
pixels = st.floats(0.0, 1000.0)
angles = st.floats(-3.0, 3.0)


def over_the_wire(message):
    return from_cdr(to_cdr(message), message.__msgtype__)


def frame(image=None, time_s=12.345678):
    return Frame(time_s, np.zeros((48, 64, 3), np.uint8) if image is None else image, POSE, LENS)


def found(rows, time_s=12.345678):
    numbers = np.array([r[:5] for r in rows], dtype=float).reshape(-1, 5)
    boxes = np.hstack([numbers[:, :2], numbers[:, :2] + numbers[:, 2:4] + 0.5])
    return Detections(time_s, boxes, numbers[:, 4], tuple(r[5] for r in rows), POSE, LENS)


rows = st.lists(
    st.tuples(pixels, pixels, pixels, pixels, st.floats(0, 1), st.sampled_from(["person", "stop sign"]))
)


@given(rows, st.sampled_from([m.detections, m.standard_detections]))
def test_detections_survive_either_form(rows, form):
    given_ = found(rows)
    message = over_the_wire(form(given_))
    assert m.detections_stamp(message) == pytest.approx(given_.time_s, abs=1e-9)
    got = m.read_detections(message, frame(), "/detections")
    assert got.class_names == given_.class_names
    np.testing.assert_allclose(got.boxes_xyxy_px, given_.boxes_xyxy_px, atol=1e-6)
    np.testing.assert_allclose(got.confidences, given_.confidences, atol=1e-6)


@pytest.mark.parametrize(
    "bad", [(5, 5, 2, 2, 1.5, "x"), (5, 5, -2, 2, 0.5, "x"), (np.nan, 5, 2, 2, 0.5, "x")]
)
@pytest.mark.parametrize("form", [m.detections, m.standard_detections])
def test_detections_that_are_not_sound_are_refused(bad, form):
    with pytest.raises(UserError, match="/model/out"):
        m.read_detections(form(found([bad])), frame(), "/model/out")


def test_the_most_confident_class_of_a_box_counts():
    message = m.detections(found([(1, 1, 5, 5, 0.3, "dog")]))
    message.detections[0].results += m.detections(found([(1, 1, 5, 5, 0.8, "person")])).detections[0].results
    assert m.read_detections(message, frame(), "t").class_names == ("person",)


@given(arrays(np.uint8, (48, 64, 3)))
def test_pictures_survive(image):
    message = over_the_wire(m.image(frame(image)))
    assert message.header.frame_id == "camera"
    np.testing.assert_array_equal(m.read_image(message, "/camera"), image)


@pytest.mark.parametrize(
    ("encoding", "pixel", "rgb"),
    [
        ("bgr8", [3, 2, 1], [1, 2, 3]),
        ("rgba8", [1, 2, 3, 9], [1, 2, 3]),
        ("bgra8", [3, 2, 1, 9], [1, 2, 3]),
        ("mono8", [7], [7, 7, 7]),
    ],
)
def test_other_encodings_and_padded_rows_become_rgb(encoding, pixel, rgb):
    row = np.array([*pixel, *pixel, 0, 0], dtype=np.uint8)
    message = make(m.IMAGE, height=3, width=2, encoding=encoding, step=len(row), data=np.tile(row, 3))
    assert m.read_image(message, "/camera").tolist() == [[rgb, rgb]] * 3


def test_an_encoding_that_is_not_read_names_topic_encoding_and_remedy():
    message = make(m.IMAGE, height=1, width=1, encoding="bayer_rggb8", step=1, data=np.zeros(1, np.uint8))
    with pytest.raises(UserError, match=r"/camera: the encoding 'bayer_rggb8'.*rgb8"):
        m.read_image(message, "/camera")


@pytest.mark.parametrize("change", [{"height": 100}, {"step": 3}, {"width": 0}])
def test_a_picture_of_another_size_than_it_says_is_refused(change):
    message = m.image(frame())
    for name, value in change.items():
        setattr(message, name, value)
    with pytest.raises(UserError, match="bytes"):
        m.read_image(message, "/camera")


def test_camera_info_gives_the_lens_back():
    info = over_the_wire(m.camera_info(0.0, LENS))
    assert (info.width, info.height) == (64, 48)
    assert 2.0 * np.arctan(info.width / (2.0 * info.k[0])) == pytest.approx(1.2)


@given(angles, angles, angles)
def test_odometry_survives(roll, pitch, yaw):
    R = rotation_from_euler(roll, pitch, yaw)
    state = VehicleState(
        3.0, np.array([1.0, -2.0, 30.0]), np.array([4.0, 5.0, 6.0]), R, POSE, 0.5, 1.0, True, 0.7
    )
    pose = m.read_odometry(over_the_wire(m.odometry(state)), "/odom")
    np.testing.assert_allclose(pose.position_enu_m, state.position_enu_m)
    np.testing.assert_allclose(pose.velocity_enu_mps, state.velocity_enu_mps, atol=1e-9)
    np.testing.assert_allclose(pose.R_body_to_enu, R, atol=1e-9)
    assert pose.position_std_m == pytest.approx(0.7)


def test_odometry_in_another_frame_or_without_numbers_is_refused():
    message = make(m.ODOMETRY, header=m.header(0.0, "utm"))
    with pytest.raises(UserError, match="'utm'"):
        m.read_odometry(message, "/odom")
    message.header.frame_id = "map"
    with pytest.raises(UserError, match="orientation"):
        m.read_odometry(message, "/odom")


@given(angles, angles)
def test_the_chain_of_frames_leads_to_the_camera(yaw, camera_yaw):
    camera = CameraPose(np.array([1.0, 2.0, 29.9]), rotation_camera_to_enu(camera_yaw, -1.2, 0.1))
    body = rotation_from_euler(0.1, -0.2, yaw)
    dynamic = m.transforms(1.0, np.array([1.0, 2.0, 30.0]), body, camera).transforms
    links = {t.child_frame_id: t for t in (*dynamic, *m.fixed_transforms().transforms)}
    R, p, name = np.eye(3), np.zeros(3), "camera"
    while name != "map":
        q, t = links[name].transform.rotation, links[name].transform.translation
        turn = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix()
        R, p, name = turn @ R, turn @ p + [t.x, t.y, t.z], links[name].header.frame_id
    np.testing.assert_allclose(R, camera.R_camera_to_enu, atol=1e-9)
    np.testing.assert_allclose(p, camera.position_enu_m, atol=1e-9)


@given(st.floats(0, 2e9))
def test_stamps_keep_the_nanosecond(time_s):
    assert m.seconds(m.stamp(time_s)) == pytest.approx(time_s, abs=1e-6)


def test_types_know_their_definition_and_hash():
    assert "geometry_msgs/TransformStamped[] transforms" in definition(m.TF)
    assert type_hash(m.TF) == "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087"


def test_a_field_that_does_not_exist_is_an_error():
    with pytest.raises(TypeError, match="altitude"):
        make("geometry_msgs/msg/Point", altitude=3.0)


def test_a_growing_path_has_the_bytes_of_the_path():
    poses = [m.pose_stamped(0.5 * k, [k, -k, 2.0 * k], np.eye(3)) for k in range(7)]
    growing = m.GrowingPath()
    for length in (1, 2, 3, 7):
        for pose in poses[growing.length : length]:
            growing.add(pose)
        assert growing.cdr(length) == to_cdr(m.path(length, poses[:length]))


def test_a_mark_that_is_drawn_again_has_the_time_of_the_drawing():
    mark = m.Mark(
        "n", 1, m.CUBE, np.array([1.0, 2.0, 3.0]), (1.0, 1.0, 1.0), (0.0, 0.0, 0.0, 1.0), frame=m.BASE
    )
    first, later = (m.markers(t, [mark], clear=True).markers for t in (1.0, 2.0))
    assert [m.seconds(each.header.stamp) for each in (*first, *later)] == [1.0, 1.0, 2.0, 2.0]
    assert [each.header.frame_id for each in later] == [m.MAP, m.BASE]
    assert later[1].pose.position.z == 3.0
