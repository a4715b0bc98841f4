"""Which picture of a candidate is kept, and that nothing is drawn outside of it."""

from dataclasses import dataclass

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skysweep.flights.pictures import PictureBook, label_place, labelled
from skysweep.geometry.camera import CameraPose, Lens
from skysweep.mission.journal import MemoryJournal
from skysweep.types import Detections, Frame

LENS = Lens(640, 360, 1.2)
DOWN = np.array([[1.0, 0, 0], [0, -1.0, 0], [0, 0, -1.0]])
MIDDLE = (300.0, 160.0, 340.0, 200.0)


@dataclass
class Eye:
    """Stands for the sensor: what it looked at last."""

    last_look: tuple[Frame, Detections] | None = None


def look(time_s, altitude_m, *found, grey=128):
    camera = CameraPose(np.array([0.0, 0.0, altitude_m + 2.0]), DOWN)
    image = np.full((360, 640, 3) if grey else (0, 0, 3), grey, dtype=np.uint8)
    boxes = np.array([box for box, _ in found]).reshape(-1, 4)
    confidences = np.array([c for _, c in found])
    names = ("stop sign",) * len(found)
    return Frame(time_s, image, camera, LENS), Detections(time_s, boxes, confidences, names, camera, LENS)


@pytest.fixture
def book(tmp_path):
    """A book over ground at 2 m, and a way to tell it of a sighting from ``altitude_m``."""
    eye = Eye()
    made = PictureBook(MemoryJournal(), tmp_path / "pictures", eye, lambda _x, _y: 2.0)

    def see(time_s, altitude_m, confidence, box=MIDDLE, candidate=7, grey=128):
        eye.last_look = look(time_s, altitude_m, (box, confidence), grey=grey)
        made.write(
            time_s,
            "sighting",
            candidate=candidate,
            confidence=confidence,
            altitude_agl_m=altitude_m,
        )

    made.see, made.eye, made.forget = see, eye, made._best.clear
    made.names = lambda: sorted(path.name for path in (tmp_path / "pictures").glob("*"))
    return made


def test_the_surest_picture_from_low_replaces_the_earlier_ones(book):
    for time_s, altitude_m, confidence in (
        (1, 30, 0.9),
        (4, 4, 0.7),
        (7, 4, 0.9),
        (10, 4, 0.5),
        (13, 30, 0.95),
    ):
        book.see(float(time_s), float(altitude_m), confidence)
    assert book.names() == ["candidate-7-7.0s.jpg"]


def test_a_picture_that_holds_the_whole_target_beats_a_surer_one_that_does_not(book):
    book.see(1.0, 4.0, 0.6)
    book.see(1.4, 4.0, 0.95, box=(0.0, 160.0, 30.0, 200.0))
    assert book.names() == ["candidate-7-1.0s.jpg"]


def test_a_candidate_rejected_without_a_detection_from_low_is_shown_from_low(book):
    book.see(1.0, 30.0, 0.6)
    book.eye.last_look = look(20.0, 4.0)
    book.write(20.3, "rejected", candidate=7)
    book.see(30.0, 4.0, 0.4, candidate=8)
    book.eye.last_look = look(31.0, 4.0)
    book.write(31.3, "rejected", candidate=8)
    assert book.names() == ["candidate-7-20.0s.jpg", "candidate-8-30.0s.jpg"]


def test_a_candidate_that_the_operator_rejects_from_anywhere_keeps_its_picture(book):
    book.see(1.0, 30.0, 0.6)
    book.eye.last_look = look(20.0, 4.0)
    book.write(20.3, "rejected", candidate=7, by="operator")
    assert book.names() == ["candidate-7-1.0s.jpg"]


def test_a_better_picture_after_the_announcement_is_kept_beside_the_announced_one(book):
    """At a confirmation the candidate is often half in the picture, and the next look shows all of it."""
    book.see(1.0, 4.0, 0.8, box=(0.0, 160.0, 30.0, 200.0))
    book.write(1.3, "confirmed", candidate=7)
    book.see(1.4, 4.0, 0.9)
    assert book.names() == ["candidate-7-1.0s.jpg", "candidate-7-1.4s.jpg"]
    assert book.picture_of(7).name == "candidate-7-1.4s.jpg"
    book.see(1.8, 2.0, 0.9)
    assert book.names() == ["candidate-7-1.0s.jpg", "candidate-7-1.8s.jpg"]


def test_a_flight_that_goes_on_keeps_the_announced_picture(book, tmp_path):
    book.see(1.0, 4.0, 0.5)
    earlier = [
        {"t": 1.0, "kind": "sighting", "candidate": 7, "confidence": 0.5, "altitude_agl_m": 4.0},
        {"t": 1.3, "kind": "confirmed", "candidate": 7},
    ]
    eye = Eye(look(50.0, 4.0, (MIDDLE, 0.8)))
    again = PictureBook(MemoryJournal(), tmp_path / "pictures", eye, lambda _x, _y: 2.0, earlier)
    again.write(50.0, "sighting", candidate=7, confidence=0.8, altitude_agl_m=4.0)
    assert book.names() == ["candidate-7-1.0s.jpg", "candidate-7-50.0s.jpg"]


def test_no_candidate_is_dropped(book):
    for k in range(60):
        book.see(float(k), 4.0, 0.8, candidate=k)
    assert len(book.names()) == 60


def test_a_mission_flown_again_leaves_its_pictures_alone(book):
    looks = ((1.0, 30.0, 0.6), (5.0, 4.0, 0.6), (9.0, 4.0, 0.62))
    for look_ in looks:
        book.see(*look_)
    assert book.names() == ["candidate-7-5.0s.jpg"]
    book.forget()
    for look_ in looks:
        book.see(*look_, grey=0)
        assert book.names() == ["candidate-7-5.0s.jpg"]


def test_a_mission_flown_again_keeps_the_announced_picture_and_the_better_one_of_later(book):
    cut, whole = (1.0, 4.0, 0.8, (0.0, 160.0, 30.0, 200.0)), (1.4, 4.0, 0.9)
    for grey in (128, 0):
        book.see(*cut, grey=grey)
        book.write(1.0, "confirmed", candidate=7)
        book.see(*whole, grey=grey)
        book.forget()
        assert book.names() == ["candidate-7-1.0s.jpg", "candidate-7-1.4s.jpg"]
    assert book._announced[7].name == "candidate-7-1.0s.jpg"


def test_a_flight_that_goes_on_keeps_a_better_picture_of_its_earlier_part(tmp_path):
    earlier = [{"t": 1.0, "kind": "sighting", "candidate": 7, "confidence": 0.9, "altitude_agl_m": 4.0}]
    eye = Eye(look(50.0, 4.0, (MIDDLE, 0.8)))
    book = PictureBook(MemoryJournal(), tmp_path, eye, lambda _x, _y: 2.0, earlier)
    book.write(50.0, "sighting", candidate=7, confidence=0.8, altitude_agl_m=4.0)
    assert list(tmp_path.iterdir()) == []


sides = st.integers(64, 4000)


@given(st.tuples(sides, sides), st.data())
def test_a_label_is_inside_the_picture_wherever_its_box_is(picture_px, data):
    width, height = picture_px
    label_px = data.draw(st.tuples(st.integers(1, width), st.integers(1, height)))
    x0 = data.draw(st.integers(-50, width + 50))
    y0 = data.draw(st.integers(-50, height + 50))
    box = (x0, y0, x0 + data.draw(st.integers(1, 500)), y0 + data.draw(st.integers(1, 500)))
    x, y = label_place(box, label_px, picture_px)
    assert 0 <= x <= width - label_px[0]
    assert 0 <= y <= height - label_px[1]


@pytest.mark.parametrize(
    "box", [(620.0, 2.0, 639.0, 20.0), (0.0, 340.0, 12.0, 359.0), (600.0, 1.0, 639.0, 359.0)]
)
def test_a_label_at_the_edge_has_as_many_letters_as_in_the_middle(box):
    def white(place):
        _, found = look(0.0, 4.0, (place, 0.87))
        image = labelled(np.full((360, 640, 3), 90, np.uint8), found, 0, "")
        return int((image.min(axis=2) > 200).sum())

    assert white(box) == pytest.approx(white(MIDDLE), rel=0.1)
    assert white(MIDDLE) > 500


@pytest.mark.parametrize(
    "box", [(0.0, 330.0, 60.0, 359.0), (580.0, 330.0, 639.0, 359.0), (2.0, 1.0, 90.0, 30.0)]
)
def test_no_words_hide_the_candidate(box):
    _, found = look(0.0, 4.0, (box, 0.87))
    blank = np.full((360, 640, 3), 90, np.uint8)
    image, silent = (labelled(blank, found, 0, words) for words in ("16.6 m above ground, 4:52", ""))
    x0, y0, x1, y1 = (round(2 * v) for v in box)
    assert (image[y0:y1, x0:x1] == silent[y0:y1, x0:x1]).all()
    assert (image != silent).any()


def test_the_picture_is_whole_and_only_enlarged():
    frame, found = look(0.0, 4.0, (MIDDLE, 0.87))
    assert labelled(frame.image, found, 0, "words").shape == (720, 1280, 3)
    large = cv2.resize(frame.image, (1920, 1080))
    assert labelled(large, look(0.0, 4.0)[1], None, "words").shape == (1080, 1920, 3)


def test_labels_can_be_read_on_snow():
    _, found = look(0.0, 4.0, (MIDDLE, 0.87))
    image = labelled(np.full((360, 640, 3), 255, np.uint8), found, 0, "4.0 m above ground")
    assert (image.max(axis=2) < 50).sum() > 5000
