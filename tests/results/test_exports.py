from __future__ import annotations

import csv
import io
import json
import re
import zipfile

import cv2
import defusedxml.ElementTree as ET
import numpy as np
import pytest
from results_data import event, tiny_records, write_run

from skysweep.errors import UserError
from skysweep.results.exports import _degrees, csv_table, found_targets, gpx, kml, kmz, write_exports
from skysweep.results.picture_files import picture_name, write_picture
from skysweep.results.run_folder import load_run

KML = "{http://www.opengis.net/kml/2.2}"
GPX = "{http://www.topografix.com/GPX/1/1}"


@pytest.fixture
def files(tiny_run, tmp_path):
    return {path.suffix: path.read_text(encoding="utf-8") for path in write_exports(tiny_run, tmp_path)}


def test_confirmed_candidates_in_their_order(tiny_run):
    found = found_targets(tiny_run)
    assert [t.name for t in found] == ["stop sign 1", "stop sign 2", "stop sign 3", "stop sign 4"]
    assert [t.confirmed_s for t in found] == [16, 40, 44, 50]
    assert found[0].confidence == 0.8
    # 10 m north and 5.5 m east of 60.449 N 22.2966 E: 111.4 km and 55.0 km a degree there
    assert found[0].latitude_deg == pytest.approx(60.4490 + 10 / 111_412, abs=2e-7)
    assert found[0].longitude_deg == pytest.approx(22.2966 + 5.5 / 55_045, abs=2e-7)


def test_a_name_that_was_told_stays_with_its_candidate(tmp_path):
    """Whatever the operator decides later; a ground team may be on its way."""
    places = {1: [5.5, 10, 0], 3: [20, 11, 0]}
    confirms = event(52, "confirmed", 1, places[1]) | {"by": "operator"}
    rejects = event(53, "rejected", 1, places[1]) | {"by": "operator"}
    told = {4: "stop sign 3", 5: "stop sign 4", 3: "stop sign 2"}
    for orders, first in (([confirms], {1: "stop sign 1"}), ([rejects], {}), ([confirms, rejects], {})):
        records = sorted([*tiny_records(), *orders], key=lambda r: r["t"])
        run = load_run(write_run(tmp_path / f"{len(orders)}{bool(first)}", records))
        assert {t.candidate: t.name for t in found_targets(run)} == told | first


def test_every_format_has_the_same_places(files):
    features = json.loads(files[".geojson"])["features"]
    from_geojson = [tuple(f["geometry"]["coordinates"]) for f in features]
    kml = ET.fromstring(files[".kml"])
    from_kml = [tuple(map(float, c.text.split(","))) for c in kml.iter(f"{KML}coordinates")]
    gpx = ET.fromstring(files[".gpx"])
    from_gpx = [(float(w.get("lon")), float(w.get("lat"))) for w in gpx.iter(f"{GPX}wpt")]
    rows = list(csv.DictReader(io.StringIO(files[".csv"])))
    from_csv = [(float(r["longitude_deg"]), float(r["latitude_deg"])) for r in rows]
    assert len(from_geojson) == 4
    assert from_geojson == from_kml == from_gpx == from_csv


def test_unchecked_candidates_are_in_every_format_and_say_so(tmp_path):
    records = [*tiny_records(), event(59, "unchecked", 6, [38, 18, 0])]
    folder = write_run(tmp_path / "run", records)
    written = {p.suffix: p.read_text(encoding="utf-8") for p in write_exports(load_run(folder), tmp_path)}
    last = json.loads(written[".geojson"])["features"][-1]["properties"]
    assert (last["name"], last["status"], last["confirmed_s"]) == ("unchecked stop sign 1", "unchecked", None)
    *confirmed, row = csv.DictReader(io.StringIO(written[".csv"]))
    assert (row["name"], row["status"], row["confirmed_s"]) == ("unchecked stop sign 1", "unchecked", "")
    assert [(r["name"], r["status"]) for r in confirmed] == [
        (f"stop sign {k}", "confirmed") for k in (1, 2, 3, 4)
    ]
    placemark = list(ET.fromstring(written[".kml"]).iter(f"{KML}Placemark"))[-1]
    assert placemark.findtext(f"{KML}name") == "unchecked stop sign 1"
    assert "not checked: have a look" in placemark.findtext(f"{KML}description")
    *flags, waypoint = ET.fromstring(written[".gpx"]).iter(f"{GPX}wpt")
    assert {flag.findtext(f"{GPX}sym") for flag in flags} == {"Flag, Red"}
    assert waypoint.findtext(f"{GPX}sym") == "Flag, Blue"
    assert "not checked: have a look" in waypoint.findtext(f"{GPX}desc")


def test_geojson_points_are_flat_and_carry_what_is_known(files):
    first = json.loads(files[".geojson"])["features"][0]
    assert len(first["geometry"]["coordinates"]) == 2
    assert first["properties"]["class_name"] == "stop sign"
    assert first["properties"]["altitude_amsl_m"] == 30.0
    assert first["properties"]["radius_95_m"] is None


def test_every_place_is_in_the_grids_of_maps_too(tiny_run, files):
    first = found_targets(tiny_run)[0]
    assert (first.mgrs, first.utm) == ("34VEN7134102129", "34V 571341 6702129")
    row = next(csv.DictReader(io.StringIO(files[".csv"])))
    assert (row["mgrs"], row["utm"]) == (first.mgrs, first.utm)
    for text in (
        json.loads(files[".geojson"])["features"][0]["properties"]["description"],
        next(ET.fromstring(files[".kml"]).iter(f"{KML}Placemark")).findtext(f"{KML}description"),
        next(ET.fromstring(files[".gpx"]).iter(f"{GPX}wpt")).findtext(f"{GPX}desc"),
    ):
        assert "MGRS 34VEN7134102129" in text


def test_geojson_has_what_caltopo_imports(files):
    for feature in json.loads(files[".geojson"])["features"]:
        properties = feature["properties"]
        assert properties["class"] == "Marker"
        assert properties["title"] == properties["name"]
        assert re.fullmatch(r"#[0-9A-F]{6}", properties["marker-color"])
        assert properties["marker-symbol"]
        assert properties["description"]


def test_a_mission_in_real_time_tells_the_utc_of_its_finds(tmp_path):
    clock = {"t": 0, "kind": "clock", "utc": "2026-05-17T11:59:50.500+02:00"}
    resumed = {"t": 43, "kind": "clock", "utc": "2026-05-18T07:00:00.000+00:00"}
    records = sorted([clock, *tiny_records(), resumed], key=lambda r: r["t"])
    run = load_run(write_run(tmp_path / "run", records))
    assert [t.utc for t in found_targets(run)] == [
        "2026-05-17T10:00:06Z",
        "2026-05-17T10:00:30Z",
        "2026-05-18T07:00:01Z",  # 44 s after take-off
        "2026-05-18T07:00:07Z",
    ]
    waypoint = next(ET.fromstring(gpx(run)).iter(f"{GPX}wpt"))
    assert [child.tag.removeprefix(GPX) for child in waypoint] == [
        "ele", "time", "name", "desc", "sym", "type",
    ]  # fmt: skip
    placemark = next(ET.fromstring(kml(run)).iter(f"{KML}Placemark"))
    assert placemark.findtext(f"{KML}TimeStamp/{KML}when") == "2026-05-17T10:00:06Z"


@pytest.mark.parametrize("utc", ["yesterday", "2026-05-17T12:00:00", 7])
def test_a_clock_that_tells_no_utc_is_damage(tmp_path, utc):
    folder = write_run(tmp_path / "run", [{"t": 0, "kind": "clock", "utc": utc}, *tiny_records()])
    with pytest.raises(UserError, match="line 1 is damaged"):
        load_run(folder)


def test_kmz_has_a_picture_of_each_target_that_is_cut_out_around_it(tmp_path):
    look = {
        "t": 15.2,
        "kind": "look",
        "boxes_xyxy_px": [[10, 10, 30, 30], [400, 200, 440, 240]],
        "confidences": [0.3, 0.8],
        "class_names": ["stop sign", "stop sign"],
    }
    records = tiny_records()
    records.insert(8, look)  # before the sighting of 15 s
    folder = write_run(tmp_path / "run", records)
    (folder / "pictures").mkdir()
    image = np.zeros((640, 1280, 3), dtype=np.uint8)
    image[400:480, 800:880] = (0, 0, 255)  # where the second box is, twice as large
    _, jpeg = cv2.imencode(".jpg", image)
    write_picture(folder / "pictures" / picture_name(1, 15.0), jpeg.tobytes())
    run = load_run(folder)
    assert found_targets(run)[0].picture == "pictures/candidate-1-15.0s.jpg"
    with zipfile.ZipFile(io.BytesIO(kmz(run))) as archive:
        assert archive.namelist() == ["doc.kml", "pictures/candidate-1.jpg"]
        first, *others = ET.fromstring(archive.read("doc.kml")).iter(f"{KML}Placemark")
        crop = cv2.imdecode(np.frombuffer(archive.read("pictures/candidate-1.jpg"), np.uint8), 1)
    assert '<img src="pictures/candidate-1.jpg"' in first.findtext(f"{KML}description")
    assert not any("<img" in p.findtext(f"{KML}description") for p in others)
    assert crop.shape[:2] == (256, 256)  # 0.1 of the width on each side
    red = crop[..., 2] > 128
    assert np.argwhere(red).mean(axis=0) == pytest.approx([128, 128], abs=3)
    assert red.mean() == pytest.approx((80 / 256) ** 2, rel=0.1)
    assert kmz(run) == kmz(run)


def test_a_name_that_a_spreadsheet_would_compute_is_text(tmp_path):
    name = "=HYPERLINK(1)"
    records = [r | {"class_name": name} if r["kind"] == "sighting" else r for r in tiny_records()]
    run = load_run(write_run(tmp_path / "run", records))
    row = next(csv.DictReader(io.StringIO(csv_table(run).decode())))
    assert (row["name"], row["class_name"]) == (f"'{name} 1", f"'{name}")


def test_gpx_elements_stand_in_the_order_of_the_schema(files):
    waypoint = next(ET.fromstring(files[".gpx"]).iter(f"{GPX}wpt"))
    assert [child.tag.removeprefix(GPX) for child in waypoint] == ["ele", "name", "desc", "sym", "type"]


@pytest.mark.parametrize("name", ["boat\x1b[31m", "a\x00b", "\ud800", "\ufffe", "<&>"])
def test_whatever_a_class_is_called_every_format_can_be_read(tmp_path, name):
    records = [r | {"class_name": name} if r["kind"] == "sighting" else r for r in tiny_records()]
    run = load_run(write_run(tmp_path / "run", records))
    files = {path.suffix: path.read_text(encoding="utf-8") for path in write_exports(run, tmp_path)}
    kml, gpx = ET.fromstring(files[".kml"]), ET.fromstring(files[".gpx"])
    row = next(csv.DictReader(io.StringIO(files[".csv"])))
    assert row["name"] == next(kml.iter(f"{KML}Placemark")).findtext(f"{KML}name")
    assert row["name"] == next(gpx.iter(f"{GPX}wpt")).findtext(f"{GPX}name")
    assert row["class_name"] == run.candidates[0].class_name
    assert row["class_name"].isprintable()


@pytest.mark.parametrize(
    ("angle_deg", "written"), [(4e-5, "0.0000400"), (-0.0008, "-0.0008000"), (180.0, "-180.0000000")]
)
def test_degrees_are_decimals(angle_deg, written):
    """The schema of GPX has neither exponents nor a longitude of 180."""
    assert _degrees(angle_deg) == written
