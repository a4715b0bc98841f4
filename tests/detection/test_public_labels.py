import json
from contextlib import suppress

import numpy as np
import pytest
from drone_pictures import dji, jpeg
from hypothesis import given, settings
from hypothesis import strategies as st
from test_labelled import picture

from skysweep.detection.photos.pose_table import read_poses
from skysweep.detection.training.class_map import ours, parse_renames, refuse_unused
from skysweep.detection.training.reading import read_dataset, with_our_classes, with_poses
from skysweep.errors import UserError


def visdrone(folder, text):
    picture(folder / "images" / "a.jpg")
    (folder / "annotations").mkdir()
    (folder / "annotations" / "a.txt").write_text(text)
    return folder


ROWS = """684,8,273,116,0,0,0,0
20,10,40,20,1,1,0,0
100,50,10,20,1,2,0,1
0,0,10,10,0,4,0,0
50,50,10,10,1,11,0,0
120,60,20,10,1,5,0,0,
"""


def test_visdrone_honours_ignored_regions(tmp_path):
    data = with_our_classes(read_dataset(visdrone(tmp_path, ROWS)), {})
    assert data.layout == "VisDrone"
    assert "others" not in data.class_names
    (image,) = data.images
    assert image.class_names == ("person", "person", "car")  # pedestrian, people, van
    np.testing.assert_allclose(image.boxes_xyxy[0], [0.1, 0.1, 0.3, 0.3])
    assert len(image.crowds_xyxy) == 3  # the region, the car of score 0, and "others"


def test_visdrone_leaves_out_what_cannot_be_found(tmp_path):
    """Labels in an ignored region, beyond the picture, and without area."""
    rows = (
        "0,0,50,50,0,0,0,0\n5,5,20,20,1,1,0,0\n300,5,20,20,1,1,0,0\n60,5,0,20,1,1,0,0\n100,50,10,20,1,1,0,0\n"
    )
    (image,) = read_dataset(visdrone(tmp_path, rows)).images
    np.testing.assert_allclose(image.boxes_xyxy, [[0.5, 0.5, 0.55, 0.7]])
    assert image.class_names == ("pedestrian",)


def test_visdrone_in_folders(tmp_path):
    picture(tmp_path / "images" / "one" / "a.jpg")
    (tmp_path / "annotations" / "one").mkdir(parents=True)
    (tmp_path / "annotations" / "one" / "a.txt").write_text("100,50,10,20,1,1,0,0\n")
    (image,) = read_dataset(tmp_path).images
    assert image.class_names == ("pedestrian",)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1,2,3,4,1,1,0,0\n1,2,3\n", "line 2: write left,top"),
        ("1,2,3,4,1,12,0,0\n", "category 12 is none of 0 to 11"),
    ],
)
def test_malformed_visdrone(text, message, tmp_path):
    with pytest.raises(UserError, match=message):
        read_dataset(visdrone(tmp_path, text))


@settings(max_examples=100)
@given(st.text(alphabet="0123456789,.-\n abc", max_size=80))
def test_any_text_as_visdrone_is_read_or_refused(tmp_path_factory, text):
    folder = tmp_path_factory.mktemp("v")
    with suppress(UserError):
        read_dataset(visdrone(folder, f"1,2,3,4,1,1,0,0\n{text}"))


def test_seadronessee_has_heights_and_an_ignored_class(tmp_path):
    picture(tmp_path / "images" / "val" / "7.png")
    (tmp_path / "annotations").mkdir()
    meta = {"altitude": 40.5, "height_above_takeoff(meter)": 38.0, "gimbal_pitch": 45.0}
    labels = {
        "images": [{"id": 7, "file_name": "7.png", "width": 200, "height": 100, "meta": meta}],
        "categories": [
            {"id": 0, "name": "ignored"},
            {"id": 1, "name": "swimmer"},
            {"id": 3, "name": "jetski"},
        ],
        "annotations": [
            {"id": k, "image_id": 7, "category_id": c, "bbox": [20 * k, 10, 10, 10]}
            for k, c in enumerate((0, 1, 3))
        ],
    }
    (tmp_path / "annotations" / "instances_val.json").write_text(json.dumps(labels))
    data = with_our_classes(read_dataset(tmp_path), {})
    assert data.class_names == ("person", "boat")
    (image,) = data.images
    assert (image.class_names, len(image.crowds_xyxy), image.altitude_agl_m) == (("person", "boat"), 1, 38.0)


def test_yolo_beside_the_pictures_and_in_a_split(tmp_path):
    picture(tmp_path / "flat" / "a.png")
    (tmp_path / "flat" / "a.txt").write_text("0 0.5 0.5 0.2 0.2\n")
    (tmp_path / "flat" / "classes.txt").write_text("human\n")
    assert with_our_classes(read_dataset(tmp_path / "flat"), {}).images[0].class_names == ("person",)
    picture(tmp_path / "set" / "train" / "images" / "a.png")
    (tmp_path / "set" / "train" / "labels").mkdir()
    (tmp_path / "set" / "train" / "labels" / "a.txt").write_text("0 0.5 0.5 0.2 0.2\n")
    (tmp_path / "set" / "data.yaml").write_text("names: [boat]\n")
    assert read_dataset(tmp_path / "set" / "train").class_names == ("boat",)


def test_a_yolo_folder_of_splits_is_read_whole(tmp_path):
    (tmp_path / "data.yaml").write_text("names: [boat, person]\n")
    for split, label in (("train", "0 0.5 0.5 0.2 0.2\n"), ("valid", "1 0.5 0.5 0.2 0.2\n")):
        picture(tmp_path / split / "images" / "a.png")
        (tmp_path / split / "labels").mkdir()
        (tmp_path / split / "labels" / "a.txt").write_text(label)
    data = read_dataset(tmp_path)
    assert data.class_names == ("boat", "person")
    found = [(i.path.parent.parent.name, i.class_names) for i in data.images]
    assert found == [("train", ("boat",)), ("valid", ("person",))]


def test_labels_where_no_picture_has_any_are_not_taken_for_none(tmp_path):
    picture(tmp_path / "all" / "set" / "images" / "a.png")
    (tmp_path / "all" / "set" / "labels").mkdir()
    (tmp_path / "all" / "set" / "labels" / "a.txt").write_text("0 0.5 0.5 0.2 0.2\n")
    (tmp_path / "data.yaml").write_text("names: [boat]\n")
    with pytest.raises(UserError, match="no picture has a label file, such as"):
        read_dataset(tmp_path)


def test_boxes_count_in_the_picture_as_it_is_shown(tmp_path):
    """On its side: 200 x 100 pixels are stored, and 100 x 200 shown."""
    turned = jpeg(np.full((100, 200, 3), 90, np.uint8), orientation=6)
    folder = visdrone(tmp_path, "20,10,40,20,1,1,0,0\n")
    (folder / "images" / "a.jpg").write_bytes(turned)
    np.testing.assert_allclose(read_dataset(folder).images[0].boxes_xyxy, [[0.2, 0.05, 0.6, 0.15]])


def test_names_are_mapped_and_overridden():
    assert [ours(name) for name in ("Pedestrian", "awning-tricycle", "life_saving_appliances")] == [
        "person",
        "awning tricycle",
        "life saving appliances",
    ]
    assert parse_renames(["swimmer=Person", "ferry=Vessel"]) == {"swimmer": "person", "ferry": "boat"}
    told = parse_renames(["people=Ignored", "Life-Saving Appliances = buoy"])
    assert (ours("People", told), ours("life_saving_appliances", told)) == ("ignored", "buoy")
    with pytest.raises(UserError, match="--class people: write NAME=OURS"):
        parse_renames(["people"])
    with pytest.raises(UserError, match="--class peple=ignored: no class has that name; there are People"):
        refuse_unused(parse_renames(["peple=ignored"]), ["People"])
    refuse_unused(told, ["People", "life-saving appliances"])


def test_height_and_ground_come_from_the_file_or_before_it_from_a_table(tmp_path):
    visdrone(tmp_path, ROWS)
    grey = np.full((100, 200, 3), 90, np.uint8)
    xmp = dji(10, -90, 50.0, 60.0, 22.0)
    (tmp_path / "images" / "a.jpg").write_bytes(jpeg(grey, xmp, focal_35_mm=24))
    told = with_poses(read_dataset(tmp_path)).images[0]
    assert told.altitude_agl_m == 50.0
    table = tmp_path / "poses.csv"
    table.write_text("file,height_m\na.jpg,100\n")
    higher = with_poses(read_dataset(tmp_path), read_poses(table)).images[0]
    assert (higher.altitude_agl_m, higher.ground_m2) == (100.0, pytest.approx(4 * told.ground_m2))
