import math
import random
from contextlib import suppress
from datetime import datetime, timezone

import numpy as np
import pytest
from drone_pictures import DJI, ELEMENTS, attributes, dji, jpeg
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from skysweep.detection.photos.exif import taken_of
from skysweep.detection.photos.pixels import read_picture
from skysweep.detection.photos.pose_table import read_poses
from skysweep.detection.photos.taken import Taken
from skysweep.detection.photos.xmp import properties
from skysweep.errors import UserError
from skysweep.geometry.camera import CameraPose, Lens
from skysweep.geometry.frames import rotation_camera_to_enu

GREY = np.full((48, 64, 3), 90, np.uint8)


def taken(folder, **tags):
    path = folder / "a.jpg"
    path.write_bytes(jpeg(GREY, **tags))
    return taken_of(path)


def test_dji(tmp_path):
    found = taken(tmp_path, xmp=dji(-114.2, -90, 87.5, 60.1, -22.5), make="DJI", focal_35_mm=24)
    assert (found.latitude_deg, found.longitude_deg) == (60.1, -22.5)
    assert (found.heading_deg, found.pitch_deg, found.roll_deg) == (-114.2, -90.0, 0.0)
    assert (found.height_m, found.altitude_amsl_m, found.over_ground_m) == (87.5, 187.5, 87.5)
    # 24 mm along the film's diagonal of 43.27 mm; 80 px are this picture's diagonal
    assert found.hfov_rad == pytest.approx(2 * math.atan(32 / (24 / math.hypot(36, 24) * 80)))


def test_a_picture_from_the_take_off_place_has_a_height_of_0(tmp_path):
    assert taken(tmp_path, xmp=dji(0, 0, 0.0, 60.1, -22.5), make="DJI").height_m == 0.0


def test_older_autel_looks_down_at_0(tmp_path):
    xmp = attributes(
        'xmlns:Camera="http://pix4d.com/camera/1.0"', Camera__Pitch=30, Camera__Yaw=12, Camera__Roll=1
    )
    found = taken(tmp_path, xmp=xmp, make="Autel Robotics", place=(47.5, -122.25, -3.0))
    assert (found.pitch_deg, found.heading_deg, found.roll_deg) == (-60.0, 12.0, 1.0)
    assert found.latitude_deg == pytest.approx(47.5, abs=1e-6)
    assert found.longitude_deg == pytest.approx(-122.25, abs=1e-6)
    assert found.altitude_amsl_m == -3.0
    assert taken(tmp_path, xmp=xmp, make="Nobody").pitch_deg is None  # 0 may be the horizon


def flir(namespace, uri, **values):
    """Elements with fractions, as FLIR writes them."""
    elements = "".join(f"<{namespace}:{k}>{v}</{namespace}:{k}>" for k, v in values.items())
    return ELEMENTS.format(namespaces=f'xmlns:{namespace}="{uri}"', elements=elements).encode()


def test_teledyne_flir_counts_from_the_airframe(tmp_path):
    """As a Teal 2 wrote it."""
    xmp = flir(
        "exif", "http://ns.adobe.com/exif/1.0/",
        CameraPitch="-86831/1600", CameraRoll="16501/1000000", CameraYaw="359986359/1000000",
        PlatformPitch="-785007/200000", PlatformRoll="-1044397/1000000", PlatformYaw="31901593/100000",
        CameraHorizontalFOV="33993099/500000",
    )  # fmt: skip
    found = taken(tmp_path, xmp=xmp, make="Teledyne FLIR", place=(40.710335, -111.89434, 1320.5))
    assert found.pitch_deg == pytest.approx(-54.269375 - 3.925035)
    assert found.heading_deg % 360.0 == pytest.approx(359.986359 + 319.01593 - 360.0)
    assert found.roll_deg == pytest.approx(0.016501 - 1.044397)
    assert math.degrees(found.hfov_rad) == pytest.approx(67.986198)
    assert found.altitude_amsl_m == pytest.approx(1320.5)
    alone = flir("exif", "http://ns.adobe.com/exif/1.0/", CameraPitch="-86831/1600")
    assert taken(tmp_path, xmp=alone, make="Teledyne FLIR").pitch_deg is None


@pytest.mark.parametrize(("told", "height_m"), [("61250/1000", 61.25), ("0/1000", None), ("7/0", None)])
def test_flir_has_the_height_from_the_autopilot(told, height_m, tmp_path):
    """As a Duo Pro R writes it; its angles are the aircraft's."""
    uri = "http://ns.flir.com/xmp/1.0/"
    xmp = flir("FLIR", uri, MAVRelativeAltitude=told, MAVYaw="9000/100", MAVPitch="-250/100", MAVRoll="0/100")
    found = taken(tmp_path, xmp=xmp, make="FLIR", place=(47.5, 8.5, 500.0))
    assert found.height_m == height_m
    assert (found.heading_deg, found.pitch_deg, found.roll_deg) == (None, None, None)


def test_newer_autel_misspells_as_dji_does(tmp_path):
    xmp = attributes(
        'xmlns:drone="http://www.dji.com/drone-dji/1.0/"',
        drone__GpsLatitude=47.6,
        drone__GpsLongtitude=16.4,
        drone__GimbalPitchDegree=-45,
        drone__GimbalYawDegree=10,
        drone__CalibratedFocalLength=4000,
        drone__CalibratedOpticalCenterX=2736,
    )
    found = taken(tmp_path, xmp=xmp, make="Autel Robotics", focal_35_mm=50)
    assert (found.longitude_deg, found.pitch_deg) == (16.4, -45.0)
    assert found.hfov_rad == pytest.approx(2 * math.atan(2736 / 4000))  # though the picture is smaller


def test_parrot_as_elements(tmp_path):
    xmp = ELEMENTS.format(
        namespaces='xmlns:drone-parrot="http://www.parrot.com/drone-parrot/1.0/" '
        'xmlns:Camera="http://pix4d.com/camera/1.0/"',
        elements="<drone-parrot:CameraPitchDegree>-51.98</drone-parrot:CameraPitchDegree>"
        "<drone-parrot:CameraYawDegree>146.5</drone-parrot:CameraYawDegree>"
        "<Camera:Pitch>38.0</Camera:Pitch><Camera:AboveGroundAltitude>42.75</Camera:AboveGroundAltitude>",
    ).encode()
    found = taken(tmp_path, xmp=xmp, make="Parrot", place=(1.0, 2.0, 30.0))
    assert (found.pitch_deg, found.heading_deg) == (-51.98, 146.5)
    assert (found.over_ground_m, found.altitude_amsl_m) == (42.75, 30.0)


def test_a_structure_as_skydio_has_it():
    told = properties(
        ELEMENTS.format(
            namespaces='xmlns:s="https://www.skydio.com/drone-skydio/1.0/"',
            elements='<s:CameraOrientationNED rdf:parseType="Resource"><s:Pitch>-59.7</s:Pitch>'
            "</s:CameraOrientationNED>",
        ).encode()
    )
    assert told["CameraOrientationNED.Pitch"] == "-59.7"


def test_time_is_utc_where_a_receiver_tells_it(tmp_path):
    there = {7: (9.0, 30.0, 15.5), 29: "2024:05:01"}
    found = taken(tmp_path, taken="2024:05:01 11:30:15", gps=there)
    assert found.utc == datetime(2024, 5, 1, 9, 30, 15, tzinfo=timezone.utc)
    alone = taken(tmp_path, taken="2024:05:01 11:30:15")
    assert (alone.utc, alone.time_s) == (None, found.time_s)


def test_no_fix_yet_is_no_place(tmp_path):
    assert taken(tmp_path, xmp=dji(0, -90, 50, 0.0, 0.0)).latitude_deg is None
    both = taken(tmp_path, xmp=dji(0, -90, 50, 0.0, 0.0), place=(0.0, 0.0, 0.0))
    assert (both.latitude_deg, both.longitude_deg) == (None, None)


def test_a_lens_behind_digital_zoom_is_not_known(tmp_path):
    assert taken(tmp_path, focal_35_mm=24, digital_zoom=1.0).hfov_rad is not None
    assert taken(tmp_path, focal_35_mm=24, digital_zoom=2.0).hfov_rad is None


def test_a_height_that_is_told_comes_before_one_that_the_file_measured():
    told = Taken(height_m=100.0).filled_from(Taken(altitude_agl_m=50.0, pitch_deg=-90.0))
    assert (told.over_ground_m, told.pitch_deg) == (100.0, -90.0)


def test_pixels_are_whole_and_bytes(tmp_path):
    path = tmp_path / "a.jpg"
    path.write_bytes(jpeg(GREY, orientation=6))
    assert read_picture(path).shape == (64, 48, 3)
    assert read_picture(path, upright=False).shape == (48, 64, 3)
    noise = np.random.default_rng(0).integers(0, 256, (48, 64, 3), np.uint8)
    path.write_bytes(jpeg(noise)[:-1000])
    with pytest.raises(UserError, match=r"a\.jpg: is damaged"):
        read_picture(path)
    deep = tmp_path / "thermal.png"
    Image.fromarray(np.full((48, 64), 30_000, np.uint16)).save(deep)
    with pytest.raises(UserError, match=r"thermal\.png: has more than 8 bits a channel"):
        read_picture(deep)


def test_a_bomb_of_entities_is_no_xmp():
    packet = attributes(DJI, drone_dji__GimbalPitchDegree="-90")
    bomb = b'<!DOCTYPE x [<!ENTITY a "aaaa">]>'
    assert properties(packet)["GimbalPitchDegree"] == "-90"
    assert properties(packet.replace(b"<rdf:RDF", bomb + b"<rdf:RDF")) == {}


@settings(max_examples=150)
@given(st.integers(0, 2**32 - 1), st.integers(1, 40))
def test_damaged_pictures_are_told_or_refused(tmp_path_factory, seed, n):
    path = tmp_path_factory.getbasetemp() / "damaged.jpg"
    data = bytearray(
        jpeg(GREY, dji(10, -60, 40, 60, 22), make="DJI", place=(1, 2, 3), taken="2024:05:01 11:30:15")
    )
    draws = random.Random(seed)
    for _ in range(n):
        data[draws.randrange(len(data))] = draws.randrange(256)
    path.write_bytes(bytes(data[: draws.choice([len(data), draws.randrange(len(data))])]))
    with suppress(UserError):
        found = taken_of(path)
        assert isinstance(found, Taken)
        found.ground_m2(64, 48)


def test_ground_of_a_nadir_picture_is_its_footprint_and_the_horizon_has_an_end():
    lens = Lens(640, 480, 1.2)
    down = CameraPose(np.zeros(3), rotation_camera_to_enu(0.3, -np.pi / 2))
    assert lens.seen_ground_m2(down, 30.0) == pytest.approx(np.prod(lens.footprint_m(30.0)))
    ahead = CameraPose(np.zeros(3), rotation_camera_to_enu(0.3, 0.0))
    reach_m = 30.0 / math.tan(math.radians(10.0))
    assert 0 < lens.seen_ground_m2(ahead, 30.0) < 2 * reach_m**2


def test_poses_by_file_and_by_time(tmp_path):
    path = tmp_path / "poses.csv"
    path.write_text("\ufefffile, latitude_deg ,heading_deg,hfov_deg\nflight\\a.JPG,60.5,,90\n")  # Excel's
    pictures = [tmp_path / "flight" / "A.jpg", tmp_path / "a.jpg"]
    told, nothing = read_poses(path).of_pictures(pictures, tmp_path)
    assert nothing == Taken()
    assert (told.latitude_deg, told.heading_deg) == (60.5, None)
    assert told.hfov_rad == pytest.approx(math.pi / 2)
    path.write_text("time_s,heading_deg,height_m\n4,10,40\n2,350,20\n")
    table = read_poses(path)
    between = table.at(3.0)
    assert (between.heading_deg % 360, between.height_m) == (0.0, 30.0)
    assert (table.at(1.9), table.at(4.1), table.at(4.0).height_m) == (None, None, 40.0)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no column file or time_s"),
        ("file,yaw\na.jpg,3\n", "the column 'yaw' is not known"),
        ("file,pitch_deg\na.jpg,-91\n", "line 2, pitch_deg: is '-91'; write a number from -90 to 90"),
        ("file,pitch_deg\na.jpg,inf\n", "line 2, pitch_deg"),
        ("time_s,height_m\nnan,3\n", "line 2, time_s"),
        ("file,pitch_deg\na.jpg\n", "line 2 has not 2 cells"),
        ("time_s,file\n,\n", "line 2 has neither"),
        ("file,pitch_deg\na.jpg,-90\nA.jpg,-80\n", "line 3 repeats file A.jpg; write one row for each"),
        ("time_s,pitch_deg\n1,-90\n1.0,-80\n", "line 3 repeats time_s 1.0; write one row for each"),
        ('file\n"a\n', "is no CSV"),
    ],
)
def test_a_mistake_in_poses_is_one_sentence(text, message, tmp_path):
    path = tmp_path / "poses.csv"
    path.write_text(text)
    with pytest.raises(UserError, match=message):
        read_poses(path)


def test_cards_with_pictures_of_one_name(tmp_path):
    path, cards = tmp_path / "poses.csv", [tmp_path / card / "DJI_0001.JPG" for card in ("100", "101")]
    path.write_text("file,height_m\n101/DJI_0001.JPG,2\n100/DJI_0001.JPG,1\n")
    assert [told.height_m for told in read_poses(path).of_pictures(cards, tmp_path)] == [1.0, 2.0]
    path.write_text("file,height_m\nDJI_0001.JPG,1\n")
    with pytest.raises(UserError, match=r"may be of .*100/DJI_0001.JPG or of .*; write file with the folder"):
        read_poses(path).of_pictures(cards, tmp_path)
    path.write_text("file,height_m\nDJI_0001.JPG,1\n100/DJI_0001.JPG,1\n")
    with pytest.raises(UserError, match="are both rows of"):
        read_poses(path).of_pictures(cards[:1], tmp_path)


@pytest.mark.parametrize("text", ["file,height_m\nb.jpg,3\n", "time_s,height_m\n1,3\n", "file,height_m\n"])
def test_a_table_of_no_picture_is_refused(text, tmp_path):
    path = tmp_path / "poses.csv"
    path.write_text(text)
    with pytest.raises(UserError, match=r"no row names a picture of .*; write a column file with names such"):
        read_poses(path).of_pictures([tmp_path / "a.jpg"], tmp_path)


@settings(max_examples=150)
@given(st.text(alphabet='file,time_sheading_deg\n"0123.-\x00é', max_size=120))
def test_any_text_as_poses_is_read_or_refused(tmp_path_factory, text):
    path = tmp_path_factory.getbasetemp() / "poses.csv"
    path.write_text(f"file,heading_deg\n{text}", "utf-8")
    with suppress(UserError):
        read_poses(path)
