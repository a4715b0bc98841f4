import json

import cv2
import numpy as np
import pytest
import yaml

from skysweep.detection.training.labelled import LabelledImage, write_labels
from skysweep.detection.training.reading import read_dataset, with_our_classes
from skysweep.errors import UserError


def picture(path, width=200, height=100):
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), np.full((height, width, 3), 90, np.uint8))
    return path


def coco(**changes):
    data = {
        "images": [{"id": 7, "file_name": "a.png", "width": 200, "height": 100}],
        "categories": [{"id": 3, "name": "person"}, {"id": 5, "name": "boat"}],
        "annotations": [
            {"id": 1, "image_id": 7, "category_id": 5, "bbox": [20, 10, 40, 20]},
            {"id": 2, "image_id": 7, "category_id": 3, "bbox": [0, 0, 100, 100], "iscrowd": 1},
        ],
    }
    return {**data, **changes}


def yolo(folder, label="1 0.2 0.2 0.2 0.2\n", names=("person", "boat")):
    picture(folder / "images" / "a.png")
    (folder / "labels").mkdir()
    (folder / "labels" / "a.txt").write_text(label)
    (folder / "data.yaml").write_text(yaml.safe_dump({"names": dict(enumerate(names))}))
    return folder


@pytest.mark.parametrize("place", ["annotations.json", "annotations/instances_val.json", "labels.json"])
@pytest.mark.parametrize("pictures", [".", "images"])
def test_coco_in_its_usual_places(place, pictures, tmp_path):
    picture(tmp_path / pictures / "a.png")
    (tmp_path / place).parent.mkdir(exist_ok=True)
    (tmp_path / place).write_text(json.dumps(coco()))
    data = read_dataset(tmp_path)
    assert data.class_names == ("person", "boat")
    (image,) = data.images
    assert image.class_names == ("boat",)
    np.testing.assert_allclose(image.boxes_xyxy, [[0.1, 0.1, 0.3, 0.3]])
    np.testing.assert_allclose(image.crowds_xyxy, [[0, 0, 0.5, 1]])


@pytest.mark.parametrize("named_in", ["data.yaml dict", "data.yaml list", "classes.txt"])
def test_yolo(named_in, tmp_path):
    yolo(tmp_path)
    picture(tmp_path / "images" / "sub" / "empty.jpg")
    if named_in == "data.yaml list":
        (tmp_path / "data.yaml").write_text("names: [person, boat]\n")
    if named_in == "classes.txt":
        (tmp_path / "data.yaml").unlink()
        (tmp_path / "classes.txt").write_text("person\nboat\n")
    data = read_dataset(tmp_path)
    assert data.class_names == ("person", "boat")
    found = {i.path.name: i for i in data.images}
    np.testing.assert_allclose(found["a.png"].boxes_xyxy, [[0.1, 0.1, 0.3, 0.3]])
    assert found["a.png"].class_names == ("boat",)
    assert found["empty.jpg"].class_names == ()


def test_what_is_written_reads_the_same_in_both_formats(tmp_path):
    written = LabelledImage(
        picture(tmp_path / "images" / "000000.png"),
        np.array([[0.1, 0.2, 0.3, 0.6], [0.5, 0.5, 1.0, 1.0]]),
        ("boat", "person"),
        np.zeros((0, 4)),
        np.array([[0.0, 0.0, 0.05, 0.1]]),
        ("buoy",),
        31.5,
    )
    empty = LabelledImage(
        picture(tmp_path / "images" / "000001.png"),
        np.zeros((0, 4)),
        (),
        np.zeros((0, 4)),
        np.zeros((0, 4)),
        (),
    )
    write_labels(tmp_path, ["person", "boat"], [written, empty], (200, 100), {"seed": 4})
    as_coco = read_dataset(tmp_path)
    assert as_coco.images[0].decoy_names == ("buoy",)
    assert as_coco.images[0].altitude_agl_m == 31.5
    (tmp_path / "annotations.json").unlink()
    as_yolo = read_dataset(tmp_path)
    for data in (as_coco, as_yolo):
        assert data.class_names == ("person", "boat")
        assert [i.class_names for i in data.images] == [("boat", "person"), ()]
        np.testing.assert_allclose(data.images[0].boxes_xyxy, written.boxes_xyxy, atol=1e-5)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"annotations": [{"image_id": 8, "category_id": 5, "bbox": [0, 0, 1, 1]}]},
            "image_id 8 is no image's id",
        ),
        (
            {"annotations": [{"image_id": 7, "category_id": 9, "bbox": [0, 0, 1, 1]}]},
            "category_id 9 is no category",
        ),
        (
            {"annotations": [{"image_id": 7, "category_id": 5, "bbox": [0, 0, 1]}]},
            "write x, y, width, height",
        ),
        (
            {"annotations": [{"image_id": 7, "category_id": 5, "bbox": [0, 0, -1, 5]}]},
            "write x, y, width, height",
        ),
        ({"annotations": [{"image_id": 7, "category_id": 5, "bbox": [0, 0, float("nan"), 5]}]}, "write x, y"),
        (
            {"annotations": [{"image_id": 7, "category_id": 5, "bbox": [200, 0, 9, 5]}]},
            "outside the picture of 200 x 100",
        ),
        ({"annotations": [{"image_id": 7}]}, "not COCO detection annotations"),
        ({"categories": None}, "not COCO detection annotations"),
        (
            {"images": [{"id": 7, "file_name": "b.png", "width": 200, "height": 100}]},
            "b.png is neither beside",
        ),
        ({"images": 2 * coco()["images"]}, "images: two have the same id"),
        ({"categories": 2 * coco()["categories"]}, "categories: two have the same id"),
    ],
)
def test_malformed_coco(changes, message, tmp_path):
    picture(tmp_path / "a.png")
    (tmp_path / "annotations.json").write_text(json.dumps(coco(**changes)))
    with pytest.raises(UserError, match=message):
        read_dataset(tmp_path)


@pytest.mark.parametrize(
    ("label", "message"),
    [
        ("1 20 20 40 40", "line 1: boxes are shares"),
        ("0 0.5 0.5 0.1 0.1\n2 0.5 0.5 0.1 0.1", "line 2: class 2 is none of the 2"),
        ("1 0.5 0.5 0.1", "line 1: write  class"),
        ("person 0.5 0.5 0.1 0.1", "line 1: write  class"),
        ("1 0.5 0.5 0.1 0.1 0.9", "line 1: write  class .* outline, and nothing else"),
        ("1 nan 0.5 0.1 0.1", "line 1: boxes are shares"),
        ("inf 0.5 0.5 0.1 0.1", "line 1: class inf is none of the 2"),
        ("nan 0.5 0.5 0.1 0.1", "line 1: class nan is none of the 2"),
    ],
)
def test_malformed_yolo(label, message, tmp_path):
    with pytest.raises(UserError, match=message):
        read_dataset(yolo(tmp_path, label))


@pytest.mark.parametrize("names", ["{1: stop sign, 2: person}", "{0: boat, b: person}"])
def test_names_whose_numbers_leave_a_gap(names, tmp_path):
    (yolo(tmp_path) / "data.yaml").write_text(f"names: {names}\n")
    with pytest.raises(UserError, match=r"names has the numbers .* write every number from 0 on"):
        read_dataset(tmp_path)


@pytest.mark.parametrize(
    ("size", "message"),
    [
        ((0, 0), "has width 0 and height 0, but the picture is 200 x 100"),
        ((400, 100), "has width 400 and height 100, but the picture is 200 x 100"),
        ((100, 200), "has width 100 and height 200, but the picture is 200 x 100"),
    ],
)
def test_coco_of_pictures_of_another_shape(size, message, tmp_path):
    picture(tmp_path / "a.png")
    images = [{"id": 7, "file_name": "a.png", "width": size[0], "height": size[1]}]
    (tmp_path / "annotations.json").write_text(json.dumps(coco(images=images)))
    with pytest.raises(UserError, match=message):
        read_dataset(tmp_path)


def test_coco_of_pictures_that_were_made_smaller(tmp_path):
    picture(tmp_path / "a.png", 67, 33)
    (tmp_path / "annotations.json").write_text(json.dumps(coco()))
    np.testing.assert_allclose(read_dataset(tmp_path).images[0].boxes_xyxy, [[0.1, 0.1, 0.3, 0.3]])


def test_nothing_there(tmp_path):
    with pytest.raises(UserError, match="no such data set"):
        read_dataset(tmp_path / "gone")
    with pytest.raises(UserError, match="neither annotations nor labels"):
        read_dataset(tmp_path)
    (tmp_path / "annotations.json").write_text("{broken")
    with pytest.raises(UserError, match="not JSON"):
        read_dataset(tmp_path)


def test_two_annotation_files_need_a_choice(tmp_path):
    for name in ("a.json", "b.json"):
        (tmp_path / name).write_text(json.dumps(coco()))
    with pytest.raises(UserError, match=r"more than one annotation file \(a.json, b.json\)"):
        read_dataset(tmp_path)


def test_unnamed_classes(tmp_path):
    (yolo(tmp_path) / "data.yaml").unlink()
    with pytest.raises(UserError, match=r"class names are unknown; write data\.yaml"):
        read_dataset(tmp_path)


def test_names_count_lines(tmp_path):
    yolo(tmp_path)
    (tmp_path / "data.yaml").unlink()
    (tmp_path / "classes.txt").write_text("person\n\nboat\n")
    with pytest.raises(UserError, match=r"classes\.txt: line 2 is empty"):
        read_dataset(tmp_path)
    (tmp_path / "classes.txt").write_text("person\nboat\n\n")
    assert read_dataset(tmp_path).class_names == ("person", "boat")


def test_labels_in_capitals_and_boxes_without_area(tmp_path):
    yolo(tmp_path, "1 0.2 0.2 0.2 0.2\n0 0.5 0.5 0 0.1\n")
    (tmp_path / "labels" / "a.txt").rename(tmp_path / "labels" / "a.TXT")
    (image,) = read_dataset(tmp_path).images
    assert image.class_names == ("boat",)


def test_outlines_are_the_boxes_around_them(tmp_path):
    """As of segmentation, and of oriented boxes; and editors may begin a file with a byte order mark."""
    yolo(tmp_path, "\ufeff1 0.1 0.2 0.3 0.2 0.25 0.5\n0 0.5 0.5 0.6 0.5 0.6 0.7 0.5 0.7\n")
    (image,) = read_dataset(tmp_path).images
    np.testing.assert_allclose(image.boxes_xyxy, [[0.1, 0.2, 0.3, 0.5], [0.5, 0.5, 0.6, 0.7]])


def test_key_points_are_no_outlines(tmp_path):
    yolo(tmp_path, "0 0.5 0.5 0.2 0.1 0.45 0.48 0.55 0.48 0.45 0.52 0.55 0.52\n")
    with (tmp_path / "data.yaml").open("a") as described:
        described.write("\nkpt_shape: [4, 2]\n")
    with pytest.raises(UserError, match=r"data\.yaml: the labels hold key points \(kpt_shape\)"):
        read_dataset(tmp_path)


def test_a_crowd_is_of_its_class(tmp_path):
    picture(tmp_path / "a.png")
    (tmp_path / "annotations.json").write_text(json.dumps(coco()))
    (image,) = with_our_classes(read_dataset(tmp_path), {}).images
    assert (len(image.crowds_of("person")), len(image.crowds_of("boat"))) == (1, 0)
    (image,) = with_our_classes(read_dataset(tmp_path), {"boat": "ignored"}).images
    assert (len(image.crowds_of("person")), len(image.crowds_of("boat"))) == (2, 1), "ignored for any class"
