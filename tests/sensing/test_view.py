"""Any camera's pictures in the pixels that the calibrated detector sees."""

import onnx
import pytest

from skysweep.detection.model_files import own_model_path
from skysweep.scenarios.model import CameraModel, DetectorModel
from skysweep.sensing.statistical.model import StatisticalModel
from skysweep.sensing.statistical.view import View

MODEL = StatisticalModel.load()
ANY_SIZE = "skysweep"  # the shipped detector's input is as large as the picture


@pytest.fixture(scope="module")
def fixed_size(tmp_path_factory):
    """The shipped detector with an input of 640 x 640, as most detectors are exported."""
    path = tmp_path_factory.mktemp("models") / "fixed.onnx"
    model = onnx.load(own_model_path())
    for axis in (2, 3):
        model.graph.input[0].type.tensor_type.shape.dim[axis].dim_value = 640
    onnx.save(model, path)
    return str(path)


def view_of(detector, width_px, height_px, tiles=1, hfov_rad=1.4) -> View:
    camera = CameraModel(width_px=width_px, height_px=height_px, hfov_rad=hfov_rad)
    return MODEL.view_of(camera, DetectorModel(model=detector, tiles=tiles))


def test_the_calibrated_camera_is_seen_as_it_was():
    view = view_of(ANY_SIZE, 640, 360)
    assert (view.scale, view.enlarged, view.as_high) == (1.0, 1.0, 1.0)
    assert view.focal_px == MODEL.camera.lens.focal_px
    assert view.tiles_px.tolist() == [[0, 0, 640, 360]]


@pytest.mark.parametrize(
    ("width_px", "height_px", "tiles", "scale"),
    [
        (1280, 720, 1, 0.5),
        (3840, 2160, 1, 1 / 6),
        (3840, 2160, 6, 640 / 768),
        (1280, 720, 2, 640 / 712),
        (1920, 1920, 1, 1 / 3),  # the calibrated one left some of the input grey
    ],
)
def test_a_larger_picture_is_shrunk_to_an_input_of_fixed_size(fixed_size, width_px, height_px, tiles, scale):
    view = view_of(fixed_size, width_px, height_px, tiles)
    assert view.scale == pytest.approx(scale)
    assert view.enlarged == 1.0
    assert view.pixels_on_target(0.9, 30.0) == pytest.approx(
        scale * CameraModel(width_px=width_px, hfov_rad=1.4).lens.pixels_on_target(0.9, 30.0)
    )
    assert len(view.tiles_px) == tiles**2
    assert view.tiles_px[-1, 2:].tolist() == pytest.approx([scale * width_px, scale * height_px])


def test_a_detector_of_any_size_sees_a_large_picture_as_it_is():
    view = view_of(ANY_SIZE, 3840, 2160)
    assert view.scale == pytest.approx(1.0, rel=0.01)
    assert view.as_high == pytest.approx(1 / 6, rel=0.01)  # its pixels show a sixth of the ground's width


def test_pixels_that_are_enlarged_count_less_than_their_number():
    view = view_of(ANY_SIZE, 640, 360, tiles=2)
    assert view.enlarged == pytest.approx(640 / 356)
    assert 1.0 < view.scale < view.enlarged


def test_a_halved_picture_is_seen_as_one_of_half_the_size():
    wide, narrow = CameraModel(width_px=1280, height_px=720, hfov_rad=1.4), MODEL.camera.lens
    view = MODEL.view_of(wide, DetectorModel(), smallest_m=0.9)
    (below_m,) = view.below_m
    assert view.pixels_on_target(0.9, below_m) == pytest.approx(DetectorModel().halve_above_px)
    assert view.at(below_m) is view
    low = view.at(below_m - 0.1)
    assert low.tiles_px.tolist() == [[0, 0, 640, 360]]
    assert (low.scale, low.as_high, low.focal_px) == pytest.approx((0.5, 1.0, narrow.focal_px))
    assert MODEL.view_of(wide, DetectorModel(halve_above_px=float("inf")), 0.9).at(0.1).scale == 1.0


def test_halving_what_is_shrunk_to_a_fixed_input_anyway_changes_nothing(fixed_size):
    wide = CameraModel(width_px=3840, height_px=2160, hfov_rad=1.4)
    view = MODEL.view_of(wide, DetectorModel(model=fixed_size), smallest_m=1.75)
    for height_m in (1.0, 80.0, 500.0):
        assert view.at(height_m).scale == pytest.approx(1 / 6)
        assert view.at(height_m).focal_px == pytest.approx(MODEL.camera.lens.focal_px)


def test_altitudes_of_false_reports_are_those_of_equal_ground_a_pixel_through_any_lens():
    view = view_of(ANY_SIZE, 640, 360, hfov_rad=0.7)
    assert view.as_high == pytest.approx(MODEL.camera.lens.focal_px / view.focal_px)
