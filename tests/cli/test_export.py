"""skysweep export, as a user meets it."""

from __future__ import annotations

import contextlib
import json
import socket
import sys
from pathlib import Path

import defusedxml.ElementTree as ET
import pytest
from typer.testing import CliRunner

from skysweep.cli import app

SCENARIO = """\
name: mine
area:
  polygon_enu_m: [[0, 0], [60, 0], [60, 40], [0, 40]]
home:
  position_enu_m: [-5, -5]
camera: {hfov_rad: 1.2}
targets:
  - {class: stop sign, position_enu_m: [20, 20], size_m: 0.9}
"""


def called(*arguments):
    return CliRunner().invoke(app, [str(a) for a in arguments])


def done(*arguments):
    result = called("export", *arguments)
    assert result.exit_code == 0, result.output
    return result


def refused(word, *arguments):
    result = called("export", *arguments)
    assert result.exit_code == 2, result.output
    assert word in result.stderr.replace("\n", " "), result.stderr
    assert len(result.stderr.strip().splitlines()) == 1


@pytest.fixture(scope="module")
def flown(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("flown")
    (folder / "mine.yaml").write_text(SCENARIO)
    result = called("run", folder / "mine.yaml", "--sensor", "statistical", "--out", folder / "run")
    assert result.exit_code == 0, result.output
    return folder / "run"


@pytest.fixture
def broken_off(flown, tmp_path) -> Path:
    """The first half of it, with a torn last line."""
    folder = tmp_path / "broken off"
    folder.mkdir()
    (folder / "config.yaml").write_bytes((flown / "config.yaml").read_bytes())
    journal = (flown / "journal.jsonl").read_bytes()
    (folder / "journal.jsonl").write_bytes(journal[: len(journal) // 2])
    return folder


@pytest.mark.parametrize("form", ["cot", "kmz", "gpx", "geojson", "kml", "csv", "geotiff"])
def test_every_format_of_a_finished_and_of_a_broken_off_mission(form, flown, broken_off, tmp_path):
    if form == "geotiff":
        pytest.importorskip("rasterio")
    for folder in (flown, broken_off):
        out = tmp_path / f"{folder.name}.{form}"
        result = done(folder, "--format", form, "--out", out)
        assert out.stat().st_size > 0
        assert str(out) in result.stdout.replace("\n", "")
        assert ("so far" in result.stderr) == (folder == broken_off)


def test_the_default_place_is_the_run_folder(broken_off):
    for form in ("kmz", "cot", "geojson"):
        done(broken_off, "--format", form)
    assert {p.name for p in broken_off.iterdir()} >= {"targets.kmz", "targets.cot", "targets.geojson"}
    assert json.loads((broken_off / "targets.geojson").read_text())["type"] == "FeatureCollection"


def test_events_go_to_an_address_and_a_finished_mission_is_followed_to_its_end(flown):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(2.0)
        address = f"udp://127.0.0.1:{receiver.getsockname()[1]}"
        assert "1 events sent" in done(flown, "--format", "cot", "--to", address).stdout
        done(flown, "--format", "cot", "--to", address, "--follow")
        events = []
        with contextlib.suppress(TimeoutError):
            while True:
                events.append(ET.fromstring(receiver.recv(65_536)))
    once, followed = (event for event in events if event.get("type") != "t-x-d-d")  # of what was rejected
    assert once.get("uid") == followed.get("uid")
    assert once.find("detail/contact").get("callsign") == "stop sign 1"


def test_what_does_not_go_together_is_refused(flown, tmp_path):
    to = ("--to", "udp://127.0.0.1:6969")
    refused("write --format cot", flown, "--format", "kmz", *to)
    refused("leave --out out", flown, "--format", "cot", *to, "--out", tmp_path / "x")
    refused("--follow: needs an address", flown, "--format", "cot", "--follow")
    refused("write udp://HOST:PORT", flown, "--format", "cot", "--to", "somewhere")
    refused("has no config.yaml", tmp_path, "--format", "kml")
    refused("cannot be read or written", flown, "--format", "kml", "--out", tmp_path / "no" / "folder.kml")


def test_a_damaged_journal_is_refused_with_the_remedy(flown, broken_off):
    journal = broken_off / "journal.jsonl"
    lines = journal.read_bytes().split(b"\n")
    lines[5] = lines[5].replace(b"TAKEOFF", b"LANDING")
    journal.write_bytes(b"\n".join(lines))
    refused("line 6 is damaged", broken_off, "--format", "kml")
    refused("line 6 is damaged", broken_off, "--format", "cot", "--to", "udp://127.0.0.1:6969", "--follow")


def test_without_rasterio_the_extra_is_named(flown, monkeypatch):
    monkeypatch.setitem(sys.modules, "rasterio", None)
    refused("tools/setup.sh geo", flown, "--format", "geotiff")


def test_the_help_has_examples():
    text = called("export", "--help").stdout
    assert "skysweep export runs/my-search --format kmz" in " ".join(text.split())
