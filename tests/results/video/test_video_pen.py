from __future__ import annotations

import numpy as np

from skysweep.results.video import pen
from skysweep.results.video.pen import Label

RED = (255, 0, 0)


def blank(width=60, height=40):
    return np.zeros((height, width, 3), np.uint8)


def test_a_point_lies_where_it_is_given():
    picture = blank()
    pen.disc(picture, (20.5, 10.5), 3.0, RED)
    rows, columns = np.nonzero(picture[..., 0])
    assert (columns.mean(), rows.mean()) == (20, 10)


def test_an_area_tints_only_itself_also_beyond_the_edge():
    picture = blank()
    pen.area(picture, np.array([[50.0, -20.0], [90.0, -20.0], [90.0, 20.0], [50.0, 20.0]]), RED, 0.5)
    assert picture[10, 55].tolist() == [128, 0, 0]
    assert picture[:, :48].max() == 0
    assert picture[22:].max() == 0


def test_shapes_outside_the_picture_leave_it_alone():
    picture = blank()
    far = np.array([[1e7, 1e7], [2e7, 1e7], [2e7, 2e7]])
    pen.area(picture, far, RED, 1.0)
    pen.line(picture, far, RED, 2.0)
    pen.disc(picture, (1e9, -1e9), 5.0, RED)
    assert picture.max() == 0


def test_a_text_that_is_too_long_is_cut_off():
    white = (255, 255, 255)
    drawn = pen.write(blank(200), [Label(0, 30, "a sentence that goes on and on", 14, white, most_px=60)])
    columns = np.nonzero(drawn.max(axis=(0, 2)))[0]
    assert 30 < columns.max() <= 61
