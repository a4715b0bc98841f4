import io
import math

import cv2
import numpy as np
import pytest
from drone_pictures import dji, jpeg
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from skysweep.detection.photos.exif import taken_of
from skysweep.detection.photos.taken import Taken
from skysweep.detection.training.compositing import (
    Cutting,
    Studio,
    _view,
    blur_of,
    cutting_onto,
    noise_of,
)
from skysweep.detection.training.dataset import render_dataset
from skysweep.detection.training.photo_pictures import _upright, photos_in, pictures_of, shares_of
from skysweep.detection.training.random_worlds import CLUTTERED, SIDE_PX
from skysweep.detection.training.reading import read_dataset
from skysweep.errors import UserError
from skysweep.geometry.camera import CameraPose, Lens, project
from skysweep.geometry.frames import rotation_camera_to_enu
from skysweep.scenarios.model import DEFAULT_SIZE_M

RED = (200, 20, 20)
BOX = (500, 300, 560, 340)  # of what is labelled, in pixels of a photo


def meadow(seed=0, size=(800, 1200)):
    rng = np.random.default_rng(seed)
    coarse = rng.uniform(40, 160, (size[0] // 16, size[1] // 16, 1)) * [0.7, 1.0, 0.5]
    image = cv2.resize(coarse, size[::-1], interpolation=cv2.INTER_CUBIC) + rng.normal(0, 4, (*size, 3))
    return np.clip(image, 0, 255).astype(np.uint8)


@pytest.fixture
def unlabelled(tmp_path):
    folder = tmp_path / "DCIM"
    folder.mkdir()
    for k in range(3):
        (folder / f"{k}.jpg").write_bytes(jpeg(meadow(k)))
    return folder


@pytest.fixture
def labelled(tmp_path):
    """A YOLO folder: a red pedestrian, a blue car and a region that is ignored."""
    folder = tmp_path / "labelled"
    for name in ("images", "labels"):
        (folder / name).mkdir(parents=True)
    image = meadow(9)
    rows = []
    for index, (left, top, right, bottom), colour in (
        (0, BOX, RED),
        (1, (700, 300, 760, 330), (20, 20, 200)),
        (2, (300, 100, 460, 180), (255, 255, 255)),
    ):
        image[top:bottom, left:right] = colour
        x, y = (left + right) / 2400, (top + bottom) / 1600
        rows.append(f"{index} {x} {y} {(right - left) / 1200} {(bottom - top) / 800}\n")
    Image.fromarray(image).save(folder / "images" / "a.png")
    (folder / "labels" / "a.txt").write_text("".join(rows))
    (folder / "classes.txt").write_text("pedestrian\ncar\nignored regions\n")
    return folder


def test_labels_follow_what_they_mark(labelled, tmp_path):
    data = read_dataset(render_dataset(tmp_path / "out", 16, seed=1, photos=[labelled], workers=1))
    of_photo = data.images[8:]
    names = {name for image in of_photo for name in image.class_names}
    decoys = {name for image in of_photo for name in image.decoy_names}
    assert (names, decoys) == ({"person"}, {"car"})
    n_labels = 0
    for image in of_photo:
        picture = cv2.imread(str(image.path))[..., ::-1].astype(int)
        for box in image.boxes_xyxy * SIDE_PX:
            left, top, right, bottom = np.rint(box).astype(int)
            red = (picture[..., 0] > 110) & (picture[..., 1:].max(axis=2) < 90)
            ys, xs = np.nonzero(red)
            np.testing.assert_allclose(box, [xs.min(), ys.min(), xs.max() + 1, ys.max() + 1], atol=2.5)
            assert red[top:bottom, left:right].mean() > 0.7
            n_labels += 1
        assert (picture.min(axis=2) > 200).mean() < 0.001  # what is ignored is grey
    assert n_labels >= 8


def test_renaming_and_photos_together(labelled, unlabelled):
    photos = photos_in([labelled, unlabelled], {"pedestrian": "boat", "car": "person"})
    assert [photo.class_names for photo in photos] == [("boat", "person"), (), (), ()]
    assert [photo.decoy_names for photo in photos] == [()] * 4


def test_with_clutter_cars_keep_their_labels(labelled):
    (photo,) = photos_in([labelled], {}, CLUTTERED.classes)
    assert (photo.class_names, photo.decoy_names) == (("person", "car"), ())


def test_unlabelled_photos_are_empty_or_hold_what_is_rendered(unlabelled, tmp_path):
    out = tmp_path / "out"
    (out / "images").mkdir(parents=True)
    photos = photos_in([unlabelled], {})
    shares = shares_of(photos, 18, seed=4)
    assert sorted(share.index for share in shares) == [0, 1, 2]
    assert [share.count for share in shares] == [6, 6, 6]
    images = [image for share in shares for image in pictures_of(out, share, share.first, 4, "train")]
    assert [image.path.name for image in images] == [f"{k:06d}.jpg" for k in range(18)]
    pasted = [bool(image.class_names or image.decoy_names) for image in images]
    assert 7 <= sum(pasted) <= 16
    assert {name for image in images for name in image.class_names} == {"stop sign", "person", "boat"}


def test_fewer_pictures_than_photos(unlabelled):
    shares = shares_of(photos_in([unlabelled], {}), 2, seed=0)
    assert [(share.first, share.count) for share in shares] == [(0, 1), (1, 1)]


@pytest.mark.parametrize(
    "label",
    ["all/train/labels/0.txt", "photo.txt", "photo.XML", "_annotations.csv", "all/_annotations.coco.json"],
)
def test_labels_in_an_unknown_layout_are_not_taken_for_none(label, tmp_path):
    """Their targets would count as ground that shows none."""
    (tmp_path / "all" / "train" / "images").mkdir(parents=True)
    picture = tmp_path / ("all/train/images/0.jpg" if "train" in label else "photo.jpg")
    picture.write_bytes(jpeg(meadow()))
    assert photos_in([tmp_path], {})
    (tmp_path / label).parent.mkdir(exist_ok=True)
    (tmp_path / label).write_text("0 0.5 0.5 0.1 0.1")
    with pytest.raises(UserError, match=f"{label} looks like labels"):
        photos_in([tmp_path], {})


def test_photos_that_would_not_be_used_are_refused(unlabelled, tmp_path):
    with pytest.raises(UserError, match=r"0.jpg: is a file; write the path of the folder that it is in"):
        photos_in([unlabelled / "0.jpg"], {})
    with pytest.raises(UserError, match="--pictures 1: half of them are made of photos; write at least 2"):
        render_dataset(tmp_path / "out", 1, photos=[unlabelled])
    with pytest.raises(UserError, match="--class hiker=person: no class has that name; there are none"):
        photos_in([unlabelled], {"hiker": "person"})


def test_one_seed_makes_one_data_set(unlabelled, tmp_path):
    """Whatever the number of workers; and the renders are those of a data set without photos."""
    first, second = (
        render_dataset(tmp_path / name, 4, seed=3, photos=[unlabelled], workers=workers)
        for name, workers in (("a", 1), ("b", 2))
    )
    without = render_dataset(tmp_path / "c", 2, seed=3, workers=1)
    for k in range(4):
        name = f"images/{k:06d}.jpg"
        assert (first / name).read_bytes() == (second / name).read_bytes()
        if k < 2:
            assert (first / name).read_bytes() == (without / name).read_bytes()
    assert (first / "annotations.json").read_text() == (second / "annotations.json").read_text()


@pytest.mark.parametrize("height_m", [20.0, 45.0])
def test_a_thing_is_as_large_as_the_height_says(height_m, tmp_path):
    """Straight down from a known height, a label is as many pixels long as lens and cut-out make of it."""
    path = tmp_path / "a.jpg"
    path.write_bytes(jpeg(meadow(), dji(0, -90, height_m, 47, 8), make="DJI", focal_35_mm=24))
    taken, rng = taken_of(path), np.random.default_rng(5)
    lens = Lens(1200, 800, taken.hfov_rad)
    photo, shares = meadow(), []
    studio = Studio(photo, "train", rng)
    while len(shares) < 6:
        view = cutting_onto((1200, 800), taken, rng)
        if view is None or view.thing not in ("stop sign", "boat"):
            continue
        assert view.pose.position_enu_m[2] == pytest.approx(height_m)
        _, image = studio.paste(path, view.cutting.of(photo), view)
        sizes = [
            (b[2:] - b[:2]).max() * SIDE_PX
            for b, n in zip(image.boxes_xyxy, image.class_names, strict=True)
            if n == view.thing
        ]
        if sizes:
            expected = float(lens.pixels_on_target(DEFAULT_SIZE_M[view.thing], height_m)) / view.cutting.scale
            shares.append(max(sizes) / expected)
    assert 0.7 < np.median(shares) < 1.4  # of the usual size; standing signs are longer from the side


@settings(max_examples=60)
@given(
    st.floats(-90, -35), st.floats(-5, 5), st.floats(50, 84), st.floats(1, 3),
    st.floats(0, 1), st.floats(0, 1), st.floats(5, 100),
)  # fmt: skip
def test_the_cut_out_has_a_camera_of_its_own(pitch_deg, roll_deg, hfov_deg, scale, x, y, height_m):
    """The ground in its middle is seen in its middle, as large as in the photo."""
    size = (1600, 1200)
    lens = Lens(*size, math.radians(hfov_deg))
    R = rotation_camera_to_enu(math.pi / 2, math.radians(pitch_deg), math.radians(roll_deg))
    camera = CameraPose(np.array([0.0, 0.0, height_m]), R)
    cutting = Cutting.with_at(np.array([x, y]) * size, np.array([160.0, 160.0]), scale, size)
    view = _view(cutting, lens, camera, np.zeros(3), "person", False)
    middle = (cutting.middle_px - np.array(size) / 2) / lens.focal_px
    at, _ = project(view.lens, view.pose, camera.position_enu_m + 50 * (R @ [*middle, 1.0]))
    np.testing.assert_allclose(at[0], [SIDE_PX / 2] * 2, atol=1e-6)
    beside = camera.position_enu_m + 50 * (R @ [middle[0] + 0.002, middle[1], 1.0])
    moved_px = np.linalg.norm(project(view.lens, view.pose, beside)[0][0] - at[0])
    in_photo_px = 0.002 * lens.focal_px / scale
    slant = math.hypot(1.0, *middle)
    assert in_photo_px / slant <= moved_px * 1.02
    assert moved_px <= in_photo_px * slant * 1.02


@pytest.mark.parametrize("orientation", [3, 6, 8])
def test_a_photo_stored_turned_is_seen_upright_and_by_its_own_lens(orientation, tmp_path):
    """800 x 1200 pixels on the sensor, whatever the file says is up."""
    path = tmp_path / "turned.jpg"
    path.write_bytes(
        jpeg(meadow(), dji(0.0, -90.0, 30.0, 47.0, 8.0, 90.0), focal_35_mm=24, orientation=orientation)
    )
    image, taken = _upright(path)
    sideways = orientation != 3
    assert image.shape == ((1200, 800, 3) if sideways else (800, 1200, 3))
    focal_px = image.shape[1] / 2.0 / math.tan(taken.hfov_rad / 2.0)
    assert focal_px == pytest.approx(1200 / 2.0 / math.tan(taken_of(path).hfov_rad / 2.0))
    assert taken.roll_deg == 0.0


def test_a_photo_of_the_sky_stays_empty():
    level = Taken(height_m=50.0, pitch_deg=30.0, roll_deg=0.0, hfov_rad=math.radians(60))
    assert cutting_onto((1600, 1200), level, np.random.default_rng(0)) is None


@pytest.mark.parametrize("sigma_px", [0.8, 1.2, 2.0])
def test_blur_is_measured(sigma_px):
    edges = np.zeros((SIDE_PX, SIDE_PX, 3), np.float32)
    for k in range(0, SIDE_PX, 64):
        edges[:, k : k + 32] = 200
    blurred = cv2.GaussianBlur(edges, (0, 0), sigma_px).astype(np.uint8)
    assert blur_of(blurred) == pytest.approx(sigma_px, rel=0.25)


@pytest.mark.parametrize("sigma", [2.0, 6.0])
def test_noise_is_measured(sigma):
    rng = np.random.default_rng(1)
    grey = 120 + rng.normal(0, sigma, (SIDE_PX, SIDE_PX, 1)) + np.zeros(3)
    assert noise_of(np.rint(grey).astype(np.uint8)) == pytest.approx(sigma, rel=0.2)


def test_a_grey_photo_gets_grey_targets(tmp_path):
    photo = np.repeat(meadow()[..., 1:2], 3, axis=2)
    rng = np.random.default_rng(2)
    studio = Studio(photo, "train", rng)
    for _ in range(3):
        view = cutting_onto((1200, 800), Taken(), rng)
        picture, _ = studio.paste(tmp_path / "a.jpg", view.cutting.of(photo), view)
        assert np.ptp(picture.astype(int), axis=2).max() <= 1


def broken(folder):
    (folder / "b.jpg").write_bytes(b"no picture")


def truncated(folder):
    content = jpeg(meadow())
    (folder / "b.jpg").write_bytes(content[: len(content) // 2])


def tiny(folder):
    (folder / "b.jpg").write_bytes(jpeg(meadow(size=(64, 320))))


def deep(folder):
    Image.fromarray(np.full((400, 400), 30_000, np.uint16)).save(folder / "b.png")


def huge(folder):
    content = io.BytesIO()
    Image.new("L", (12_000, 9_000)).save(content, "png")
    (folder / "b.png").write_bytes(content.getvalue())


@pytest.mark.parametrize(
    ("spoil", "sentence"),
    [
        (lambda folder: None, "photos: there are no pictures; write the path of a folder of photos"),
        (broken, r"b\.jpg: not a readable picture; take it out"),
        (truncated, r"b\.jpg: the picture is damaged; take it out"),
        (tiny, r"b\.jpg: is 320 x 64 pixels; photos need 320 on each side"),
        (huge, r"b\.png: has more than 89 million pixels; save it smaller"),
        (lambda folder: folder.rmdir(), "--photos .*photos: is not there; write the path"),
        (deep, r"b\.png: has more than 8 bits a channel; save it as JPEG"),
    ],
)
def test_photos_that_cannot_be_used(spoil, sentence, tmp_path):
    folder = tmp_path / "photos"
    folder.mkdir()
    spoil(folder)
    with pytest.raises(UserError, match=sentence) as raised:
        render_dataset(tmp_path / "out", 2, photos=[folder], workers=1)
    assert "\n" not in str(raised.value)
    assert not (tmp_path / "out").exists()


def test_a_label_without_a_picture(labelled, tmp_path):
    (labelled / "labels" / "gone.txt").write_text("")
    with pytest.raises(UserError, match=r"gone\.txt: there is no picture .*gone\.\*"):
        render_dataset(tmp_path / "out", 2, photos=[labelled], workers=1)
