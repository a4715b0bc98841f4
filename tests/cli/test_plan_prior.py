"""skysweep plan --prior, as a user meets it."""

import json

import numpy as np
import pytest
import shapely
from typer.testing import CliRunner

from skysweep.cli import app
from skysweep.planning.prior.flown import path_of_plan
from skysweep.planning.prior.map_files import read_map
from skysweep.planning.qgc import read_plan
from skysweep.scenarios.files import load_scenario

BOUNDS = (22.10, 60.20, 22.11, 60.205)
START = "22.101,60.201"
SCENARIO = """\
name: shore
area:
  polygon_lat_lon_deg: [[60.2005, 22.101], [60.2005, 22.109], [60.2045, 22.109], [60.2045, 22.101]]
home: {latitude_deg: 60.2006, longitude_deg: 22.1011}
targets:
  - {class: person, position_enu_m: [100, 100]}
"""


@pytest.fixture(autouse=True)
def at_work(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    row, column = np.mgrid[0:50, 0:50]
    poa = np.exp(-((row - 20) ** 2 + (column - 30) ** 2) / 60.0)
    np.savez("map.npz", poa=poa, bounds_lon_lat_deg=BOUNDS)
    (tmp_path / "shore.yaml").write_text(SCENARIO)


def plan(*arguments):
    return CliRunner().invoke(app, ["plan", *map(str, arguments)])


def done(*arguments):
    result = plan(*arguments)
    assert result.exit_code == 0, result.output
    return result.output


def refused(word, *arguments):
    result = plan(*arguments)
    assert result.exit_code == 2, result.output
    assert word in result.stderr.replace("\n", " "), result.stderr


def search(*more, out="out"):
    return ("--prior", "map.npz", "--budget-m", 6000, "--sweep-width-m", 15, "--start", START,
            "--out", out, *more)  # fmt: skip


def test_a_map_alone_makes_plans_a_picture_a_report_and_the_map_after(tmp_path):
    said = done(*search("--uavs", 2))
    assert {p.name for p in (tmp_path / "out").iterdir()} == {
        "map-1.plan",
        "map-2.plan",
        "map.png",
        "sortie.json",
        "after.npz",
    }
    assert "expected POS" in said
    report = json.loads((tmp_path / "out/sortie.json").read_text())
    assert len(report["path_lengths_m"]) == 2
    assert max(report["path_lengths_m"]) <= 3000.0
    assert 0.5 * report["bound"] < report["pos"] <= report["bound_from_start"] <= report["bound"]
    pos = report["curve"]["pos"]
    assert pos == sorted(pos)
    assert pos[-1] == report["pos"]
    for k in (1, 2):
        first = read_plan(tmp_path / f"out/map-{k}.plan").waypoints[0]
        assert (first.longitude_deg, first.latitude_deg) == pytest.approx((22.101, 60.201), abs=1e-6)
    before, after = read_map("map.npz"), read_map("out/after.npz")
    best = before.poa > 0.3 * before.poa.max()
    assert after.poa[best].sum() < 0.8 * before.poa[best].sum()


def test_the_next_sortie_goes_where_the_last_one_was_not(tmp_path):
    done(*search())
    done(*search("--searched", "out/map-1.plan", out="next"))
    done("--prior", "out/after.npz", *search(out="same")[2:])
    first, following, same = (
        json.loads((tmp_path / name / "sortie.json").read_text())["pos"] for name in ("out", "next", "same")
    )
    assert following < first
    assert following == pytest.approx(same, rel=0.05)


def test_the_map_that_was_given_is_not_replaced_by_the_one_after(tmp_path):
    done(*search(out="plan"))
    before = (tmp_path / "plan" / "after.npz").read_bytes()
    refused("plan/after.npz: was given, and would be", *search("--prior", "plan/after.npz", out="plan"))
    assert (tmp_path / "plan" / "after.npz").read_bytes() == before


def test_a_map_that_is_a_geotiff_by_its_name_alone_reads_no_other_file(tmp_path):
    rasterio = pytest.importorskip("rasterio")
    bounds = rasterio.Affine(0.003, 0, 22.1, 0, -0.001, 60.204)
    of_file = {
        "width": 3,
        "height": 3,
        "count": 1,
        "dtype": "float64",
        "crs": "EPSG:4326",
        "transform": bounds,
    }
    with rasterio.open("secret.tif", "w", driver="GTiff", **of_file) as file:
        file.write(np.ones((1, 3, 3)))
    assert plan(*search("--prior", "secret.tif")).exit_code == 0
    (tmp_path / "map.tif").write_text(
        '<VRTDataset rasterXSize="3" rasterYSize="3"><SRS>EPSG:4326</SRS>'
        "<GeoTransform>22.1, 0.003, 0, 60.204, 0, -0.001</GeoTransform>"
        '<VRTRasterBand dataType="Float64" band="1"><SimpleSource>'
        f'<SourceFilename relativeToVRT="0">{tmp_path}/secret.tif</SourceFilename>'
        "<SourceBand>1</SourceBand></SimpleSource></VRTRasterBand></VRTDataset>"
    )
    refused("map.tif: is no GeoTIFF", *search("--prior", "map.tif"))


def test_a_scenario_says_area_start_and_sweep_width(tmp_path):
    said = done("shore.yaml", "--prior", "map.npz", "--budget-m", 5000, "--altitude", 25)
    assert "sweep width" in said
    report = json.loads((tmp_path / "plan/sortie.json").read_text())
    assert 20.0 < report["sweep_width_m"] < 77.9  # of the picture
    first = read_plan(tmp_path / "plan/shore-1.plan").waypoints[0]
    assert (first.latitude_deg, first.longitude_deg) == pytest.approx((60.2006, 22.1011), abs=1e-6)


def test_how_much_of_a_map_lies_outside_the_area_is_said(tmp_path):
    """Also where rounding would make it all."""
    poa = np.zeros((50, 50))
    poa[20:25, 20:25], poa[0, 0] = 1.0, 25.0 * 249.0
    np.savez("far.npz", poa=poa, bounds_lon_lat_deg=BOUNDS)
    said = plan("shore.yaml", *search("--prior", "far.npz"))
    assert said.exit_code == 0, said.output
    warned = said.stderr.replace("\n", " ")
    assert "far.npz: all but 0.4% of the map lies outside the area and is left out" in warned


@pytest.mark.parametrize(
    "kept",
    [
        "safety: {no_fly_enu_m: [[[100, 80], [300, 80], [300, 240], [100, 240]]]}\n"
        "area: {polygon_enu_m: [[0, 0], [440, 0], [440, 440], [0, 440]]}\n",
        "geofence_enu_m: [[-20, -20], [460, -20], [460, 460], [280, 460], [280, 120], [200, 120], "
        "[200, 460], [-20, 460]]\n"
        "area: {polygon_enu_m: [[0, 0], [440, 0], [440, 440], [300, 440], [300, 100], [180, 100], "
        "[180, 440], [0, 440]]}\n",
    ],
)
def test_no_leg_leads_where_nobody_may_fly(tmp_path, kept):
    """Round a no-fly area, inside a fence with a bay; a mission takes the plan."""
    home = "home: {latitude_deg: 60.2006, longitude_deg: 22.1011}\n"
    (tmp_path / "kept.yaml").write_text(f"name: kept\n{home}{kept}")
    scenario = load_scenario("kept.yaml")
    done("kept.yaml", *search(out="kept"))
    line = shapely.LineString(path_of_plan("kept/kept-1.plan", scenario.frame))
    assert line.length <= 6000.0 + 0.1
    for ring in scenario.safety.no_fly_enu_m:
        assert line.intersection(shapely.Polygon(ring)).length < 0.1
    if scenario.geofence_enu_m is not None:
        assert line.difference(shapely.Polygon(scenario.geofence_enu_m)).length < 0.1
    report = json.loads((tmp_path / "kept/sortie.json").read_text())
    assert report["pos"] > 0.5 * report["bound"]


def test_what_lies_where_nobody_may_fly_is_left_out_and_said(tmp_path):
    (tmp_path / "kept.yaml").write_text(
        SCENARIO + "safety: {no_fly_enu_m: [[[250, 100], [450, 100], [450, 350], [250, 350]]]}\n"
    )
    said = plan("kept.yaml", *search())
    assert said.exit_code == 0, said.output
    assert "of the map in the area lies in or behind no-fly areas or outside the geofence" in " ".join(
        said.stderr.split()
    )
    refused(
        "lies in a no-fly area or outside the geofence; start elsewhere",
        "kept.yaml",
        *search("--start", "22.107,60.2025"),
    )
    poa = np.zeros((50, 50))
    poa[25:28, 31:33] = 1.0
    np.savez("map.npz", poa=poa, bounds_lon_lat_deg=BOUNDS)
    refused("only where nobody may fly", "kept.yaml", *search())


def test_what_no_way_leads_to_draws_no_plan(tmp_path):
    """A no-fly strip from fence to fence, and as likely on either side: all of the budget is flown here."""
    fence = "geofence_enu_m: [[-20, -20], [460, -20], [460, 460], [-20, 460]]\n"
    strip = fence + "safety: {no_fly_enu_m: [[[200, -60], [240, -60], [240, 500], [200, 500]]]}\n"
    (tmp_path / "split.yaml").write_text(SCENARIO + strip)
    row, column = np.mgrid[0:50, 0:50]
    here, there = (np.exp(-((row - 22) ** 2 + (column - c) ** 2) / 12.0) for c in (10, 35))
    found = []
    for poa in (here, here + there):
        np.savez("map.npz", poa=poa, bounds_lon_lat_deg=BOUNDS)
        done("split.yaml", *search("--budget-m", 900, "--start", "22.102,60.201"))
        found.append(json.loads((tmp_path / "out" / "sortie.json").read_text()))
    assert found[1]["pos"] == pytest.approx(found[0]["pos"], abs=1e-6)
    assert found[0]["pos"] > 0.5


@pytest.mark.parametrize("south_m", [-20, 20])
def test_behind_a_strip_that_a_way_leads_round_counts_wherever_home_is(tmp_path, south_m):
    """No fence is drawn. From within the area's bounding box the other side counted as unreachable."""
    strip = "safety: {no_fly_enu_m: [[[-5, 195], [445, 195], [445, 205], [-5, 205]]]}\n"
    scenario = SCENARIO.replace("home: {", f"home: {{position_enu_m: [200, {south_m}], ")
    (tmp_path / "strip.yaml").write_text(scenario + strip)
    said = plan("strip.yaml", *search())
    assert said.exit_code == 0, said.output
    assert "is left out" not in said.stderr


def test_a_start_beyond_the_hills_that_are_known_is_refused(tmp_path):
    (tmp_path / "hilly.yaml").write_text(SCENARIO + "terrain: {hills_height_m: 30}\n")
    refused("--start 22.15,60.2025: leads up to 2", "hilly.yaml", *search("--start", "22.15,60.2025"))


def test_a_width_from_beyond_the_calibration_is_called_a_guess():
    known = ("--prior", "map.npz", "--budget-m", 3000, "--out", "out")
    assert "is a guess" not in plan("shore.yaml", *known).stderr
    said = " ".join(plan("shore.yaml", *known, "--altitude", 119).stderr.split())
    assert "--sweep-width-m: is missing, and the sensor's is a guess. The sensor model was" in said


def test_a_budget_that_is_not_flown_is_said(tmp_path):
    poa = np.zeros((50, 50))
    poa[20:23, 30:33] = 1.0
    np.savez("map.npz", poa=poa, bounds_lon_lat_deg=BOUNDS)
    assert "of the budget; bound of all of it 100.0%" in done(*search("--budget-m", 90000))
    report = json.loads((tmp_path / "out/sortie.json").read_text())
    assert report["unused_m"] == pytest.approx(90000 - sum(report["path_lengths_m"]))
    assert report["bound_of_budget"] >= report["bound"] >= report["pos"] > 0.99


def test_a_mission_that_was_flown_counts_as_searched(tmp_path):
    where_it_is_most_probable = "[[60.2012, 22.104], [60.2012, 22.108], [60.2028, 22.108], [60.2028, 22.104]]"
    (tmp_path / "near.yaml").write_text(
        f"name: near\narea: {{polygon_lat_lon_deg: {where_it_is_most_probable}}}\n"
        "home: {latitude_deg: 60.2006, longitude_deg: 22.1011}\n"
    )
    flown = CliRunner().invoke(app, ["run", "near.yaml", "--sensor", "statistical", "--out", "run"])
    assert flown.exit_code == 0, flown.output
    known = ("--prior", "map.npz", "--budget-m", 6000)
    done("shore.yaml", *known, "--out", "out")
    done("shore.yaml", *known, "--searched", "run", "--out", "next")
    first, following = (
        json.loads((tmp_path / name / "sortie.json").read_text())["pos"] for name in ("out", "next")
    )
    assert following < first - 0.01


def test_mistakes_are_told_in_one_sentence(tmp_path):
    refused("SOURCE: is missing")
    refused("--budget-m: is missing", "--prior", "map.npz", "--start", START)
    refused("--sweep-width-m: is missing", "--prior", "map.npz", "--budget-m", 500, "--start", START)
    refused("--start: is missing", "--prior", "map.npz", "--budget-m", 500, "--sweep-width-m", 9)
    refused("write LON,LAT", *search("--start", "north"))
    refused("write LON,LAT", *search("--start", "nan,nan"))
    refused("no such file", *search("--prior", "other.npz"))
    refused("--uavs: is 0", *search("--uavs", 0))
    refused("--budget-m: is -1", *search("--budget-m", -1))
    refused("--sweep-width-m: is nan; write metres above 0", *search("--sweep-width-m", "nan"))
    refused("do not reach the map", *search("--start", "23,60.2"))
    refused("write LON,LAT, the longitude first", *search("--start", "60.201,22.101"))
    refused("write LON,LAT, the longitude first", *search("--start", "-157.9,-60.2"))
    refused("holds no journal.jsonl", *search("--searched", "."))
    refused("no such file", *search("--searched", "other.plan"))
    np.savez("far.npz", poa=np.ones((5, 5)), bounds_lon_lat_deg=(10.0, 50.0, 10.1, 50.1))
    refused("far.npz: does not overlap the area", "shore.yaml", *search("--prior", "far.npz"))
    refused("leave them out", *search("--sidelap", 0.3))
    refused("--prior", "shore.yaml", "--budget-m", 500)
    assert not (tmp_path / "out").exists()


def test_as_json_it_tells_what_it_wrote(tmp_path):
    result = plan(*search("--json"))
    assert result.exit_code == 0, result.output
    told = json.loads(result.stdout)
    assert [tmp_path / name for name in told["plans"]] == sorted((tmp_path / "out").glob("*.plan"))
    written = json.loads((tmp_path / told["report"]).read_text())
    assert {key: told[key] for key in written} == written
