from __future__ import annotations

import csv
import io
import json

import defusedxml.ElementTree as ET
import pytest
from results_data import event, tiny_records, write_run

from skysweep.results.exports import found_targets, write_exports
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
