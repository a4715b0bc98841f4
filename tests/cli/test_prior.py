"""skysweep prior, as a user meets it."""

import json

import numpy as np
import pytest
import shapely
from typer.testing import CliRunner

from skysweep.cli import app
from skysweep.planning.prior.map_files import read_map
from skysweep.results.run_folder import load_flown
from skysweep.results.searched import coverage_of_runs
from skysweep.scenarios.files import load_scenario

LKP = "22.105,60.202"
OWN = ("--lkp", LKP, "--within-m", "100,200,400,600", "--cell-m", 10)
HILLS = """\
name: hills
area:
  polygon_lat_lon_deg: [[60.195, 22.090], [60.195, 22.120], [60.209, 22.120], [60.209, 22.090]]
home: {latitude_deg: 60.2006, longitude_deg: 22.1031}
"""
SHORE = """\
name: shore
area:
  polygon_lat_lon_deg: [[60.2012, 22.104], [60.2012, 22.106], [60.2020, 22.106], [60.2020, 22.104]]
home: {latitude_deg: 60.2006, longitude_deg: 22.1031}
"""


@pytest.fixture(autouse=True)
def at_work(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def called(*arguments):
    return CliRunner().invoke(app, [str(a) for a in arguments])


def done(*arguments):
    result = called("prior", *arguments)
    assert result.exit_code == 0, result.output
    return result


def refused(word, *arguments):
    result = called("prior", *arguments)
    assert result.exit_code == 2, result.output
    assert word in result.stderr.replace("\n", " "), result.stderr


def mean_xy(cells):
    return np.sum(cells.poa[..., None] * cells.centres_xy_m, axis=(0, 1))


def test_a_lost_person_is_around_the_last_known_position(tmp_path):
    done("lost-person", *OWN, "--out", "maps/lost.npz")
    assert (tmp_path / "maps/lost.png").stat().st_size > 20_000
    lost = read_map("maps/lost.npz")
    assert (lost.frame.latitude_deg, lost.frame.longitude_deg) == (60.202, 22.105)
    assert mean_xy(lost) == pytest.approx([0, 0], abs=1.0)
    near = np.linalg.norm(lost.centres_xy_m, axis=-1) <= 200.0
    far = np.linalg.norm(lost.centres_xy_m, axis=-1) <= 400.0
    assert lost.poa[near].sum() / lost.poa[far].sum() == pytest.approx(0.5 / 0.75, abs=0.02)


def test_a_map_is_made_over_an_area(tmp_path):
    (tmp_path / "shore.yaml").write_text(SHORE)
    done("lost-person", *OWN, "--over", "shore.yaml", "--out", "lost.npz")
    cells = read_map("lost.npz")
    east, north = cells.bounds_m[2] - cells.bounds_m[0], cells.bounds_m[3] - cells.bounds_m[1]
    assert (east, north) == pytest.approx((115, 95), abs=10)


def test_a_map_over_an_area_leaves_out_the_corners_around_it(tmp_path):
    (tmp_path / "shore.yaml").write_text(SHORE.replace(", [60.2020, 22.106]", ""))  # a triangle
    lost = ("lost-person", *OWN, "--over", "shore.yaml")
    adrift = (
        "drift",
        "--lkp",
        LKP,
        "--hours",
        0.05,
        "--wind",
        "1,180",
        "--current",
        "0,90",
        "--over",
        "shore.yaml",
    )
    for words, name in ((lost, "lost-person.npz"), (adrift, "drift.npz")):
        said = done(*words).output
        cells = read_map(name)
        within = shapely.contains_xy(
            load_scenario("shore.yaml").area_enu_m, *np.moveaxis(cells.centres_xy_m, -1, 0)
        )
        assert cells.poa[~within].sum() == 0.0
        assert cells.poa[within].sum() == pytest.approx(1.0)
        assert "outside the area: " in said


def test_what_a_map_leaves_out_is_said_of_all_places(tmp_path):
    """Not of those alone within the map's bounds: 95 % and more lie beyond an area of 110 m by 90 m."""
    (tmp_path / "shore.yaml").write_text(SHORE)
    own = ("--lkp", LKP, "--within-m", "1000,2000,4000,6000")
    said = " ".join(done("lost-person", *own, "--over", "shore.yaml").stderr.split())
    assert "outside the area: all but 0.08% of where the target may be" in said
    adrift = ("drift", "--lkp", LKP, "--hours", 1, "--wind", "8,180", "--current", "0.3,180")
    said = " ".join(done(*adrift, "--over", "shore.yaml", "--lkp-std-m", 2000).stderr.split())
    assert "outside the area: all but 0." in said
    around = done("lost-person", *own)
    assert "outside the area: 5% of where the target may be" in " ".join(around.output.split())
    assert "outside" not in done(*adrift).output


def test_one_place_alone_is_no_map():
    still = ("drift", "--lkp", LKP, "--hours", 1, "--wind", "0,0", "--current", "0,0", "--lkp-std-m", 0)
    refused("leave one place to be at", *still, "--wind-std", 0, "--current-std", 0)


def test_a_mixture_of_maps_too_fine_for_their_extent_has_coarser_cells():
    done("lost-person", *OWN[:-1], 0.8, "--out", "fine.npz")
    done("lost-person", "--lkp", LKP, "--within-m", "1000,2000,4000,6000", "--out", "wide.npz")
    said = " ".join(done("mix", "fine.npz:1", "wide.npz:1").stderr.split())
    assert "as 0.8 m over all maps would be too many" in said
    mixture = read_map("mixed.npz")
    assert 3_000_000 < mixture.poa.size <= 4_000_000


def test_drift_goes_with_current_and_wind():
    """0.5 m/s to the east for two hours; the wind blows from the south and takes it to the north."""
    done(
        "drift", "--lkp", LKP, "--hours", 2, "--wind", "10,180", "--current", "0.5,90", "--leeway", "SKIFF-1"
    )
    east, north = mean_xy(read_map("drift.npz"))
    assert east == pytest.approx(3600.0, rel=0.03)
    assert north == pytest.approx(0.0315 * 10 * 7200.0, rel=0.05)
    first = read_map("drift.npz").poa
    done("drift", "--lkp", LKP, "--hours", 2, "--wind", "10,180", "--wind", "10,180", "--current", "0.5,90",
         "--leeway", "SKIFF-1")  # fmt: skip
    assert read_map("drift.npz").poa == pytest.approx(first, abs=1e-6)


def test_terrain_and_mixtures_change_maps(tmp_path):
    done("lost-person", *OWN, "--out", "lost.npz")
    trail = {"type": "LineString", "coordinates": [[22.0, 60.202], [22.2, 60.202]]}
    lake = {
        "type": "Polygon",
        "coordinates": [[[22.0, 60.1], [22.0, 60.3], [22.104, 60.3], [22.104, 60.1], [22.0, 60.1]]],
    }
    (tmp_path / "trail.geojson").write_text(json.dumps(trail))
    (tmp_path / "lake.geojson").write_text(json.dumps(lake))
    (tmp_path / "flat.yaml").write_text(HILLS)
    done("terrain", "lost.npz", "--near", "trail.geojson:20:4", "--inside", "lake.geojson:0", "--slope",
         "5:1,90:9", "--heights", "flat.yaml", "--lkp", LKP)  # fmt: skip
    lost, changed = read_map("lost.npz"), read_map("terrain.npz")
    x, y = np.moveaxis(lost.centres_xy_m, -1, 0)
    assert changed.poa[x < -60.0].sum() == 0.0
    ratio = changed.poa[x > -40.0] / lost.poa[x > -40.0]
    assert ratio[abs(y[x > -40.0]) < 18.0] == pytest.approx(4.0 * ratio[abs(y[x > -40.0]) > 30.0].max())
    done("mix", "lost.npz:1", "terrain.npz:3", "--out", "mixed.npz")
    assert read_map("mixed.npz").poa == pytest.approx(0.25 * lost.poa + 0.75 * changed.poa, abs=1e-9)
    assert "changes no cell" in done("terrain", "lost.npz", "--inside", "lake.geojson:1").stderr


def test_nothing_that_was_given_is_replaced(tmp_path):
    """A map's picture and GeoTIFF go beside it, and have its name."""
    done("lost-person", *OWN, "--out", "lost.npz")
    before = (tmp_path / "lost.npz").read_bytes()
    (tmp_path / "hills.yaml").write_text(HILLS + "terrain: {hills_height_m: 80, hills_wavelength_m: 150}\n")
    steep = ("terrain", "lost.npz", "--slope", "15:1,90:0.1", "--heights", "hills.yaml")
    refused("lost.npz: was given, and would be replaced", *steep, "--out", "lost.npz")
    refused("lost.npz: was given, and would be replaced", "mix", "lost.npz:1", "--out", "lost.npz")
    assert (tmp_path / "lost.npz").read_bytes() == before
    if (tmp_path / "lost.tif").exists():
        refused("lost.tif: was given", "mix", "lost.tif:1", "--out", "lost.npz")


def test_heights_without_a_unit_are_said_to_be_taken_for_metres(tmp_path):
    rasterio = pytest.importorskip("rasterio")
    done("lost-person", *OWN, "--out", "lost.npz")
    with rasterio.open(
        "dem.tif", "w", driver="GTiff", width=200, height=200, count=1, dtype="float32", crs="EPSG:4326",
        transform=rasterio.Affine(0.0005, 0, 22.055, 0, -0.00025, 60.227),
    ) as file:  # fmt: skip
        file.write(np.add.outer(np.arange(200.0), np.arange(200.0)).astype(np.float32)[None] * 10.0)
    slopes = ("terrain", "lost.npz", "--slope", "15:1,90:0.1", "--heights", "dem.tif")
    assert "dem.tif: tells no unit, and its heights are taken for metres" in done(*slopes).stderr.replace(
        "\n", " "
    )
    with rasterio.open("dem.tif", "r+") as file:
        file.units = ["m"]
    assert "tells no unit" not in done(*slopes).stderr


def test_slopes_are_those_of_a_scenario_of_this_place(tmp_path):
    """Hills change the map, flat ground is said to change nothing, other or too little ground is refused."""
    done("lost-person", *OWN, "--out", "lost.npz")
    (tmp_path / "flat.yaml").write_text(HILLS)
    (tmp_path / "hills.yaml").write_text(HILLS + "terrain: {hills_height_m: 80, hills_wavelength_m: 150}\n")
    (tmp_path / "shore.yaml").write_text(SHORE)
    slopes = ("terrain", "lost.npz", "--slope", "15:1,90:0.1", "--heights")
    assert "changes no cell" not in done(*slopes, "hills.yaml").stderr
    lost, changed = read_map("lost.npz"), read_map("terrain.npz")
    ratio = changed.poa[lost.poa > 0.0] / lost.poa[lost.poa > 0.0]
    assert ratio.max() == pytest.approx(10.0 * ratio.min())
    assert "check that --heights has slopes there" in done(*slopes, "flat.yaml").stderr
    (tmp_path / "terrain.npz").unlink()
    refused("clusters: its ground has no height for 100% of the map", *slopes, "clusters")
    refused("shore: its ground has no height for 9", *slopes, "shore.yaml")
    assert not (tmp_path / "terrain.npz").exists()
    done("lost-person", *OWN, "--over", "shore.yaml", "--out", "lost.npz")
    done(*slopes, "shore.yaml")


def test_the_map_after_a_mission_is_that_of_its_looks(tmp_path):
    (tmp_path / "shore.yaml").write_text(SHORE)
    flown = called("run", "shore.yaml", "--sensor", "statistical", "--out", "run")
    assert flown.exit_code == 0, flown.output
    done("lost-person", *OWN, "--out", "lost.npz")
    said = done("after", "lost.npz", "--searched", "run", "--lkp", LKP).output
    before, after = read_map("lost.npz"), read_map("after.npz")
    run = load_flown("run")
    coverage = coverage_of_runs([run], before)
    assert after.poa == pytest.approx(before.after_coverage(coverage).poa)
    assert f"{before.pos_of(coverage):.1%}" in said
    inside = [
        read_map(name, run.scenario.frame).share_within(run.scenario.area_enu_m)
        for name in ("lost.npz", "after.npz")
    ]
    assert inside[1] < 0.8 * inside[0]
    tracked = coverage_of_runs([run], before, 20.0)
    said = done("after", "lost.npz", "--searched", "run", "--sweep-width-m", 20).output
    assert f"{before.pos_of(tracked):.1%}" in said
    refused(
        "run: is the same flight as run; name each once",
        "after",
        "lost.npz",
        "--searched",
        "run",
        "--searched",
        "run/",
    )


def test_mistakes_are_told_in_one_sentence(tmp_path):
    done("lost-person", *OWN, "--out", "lost.npz")
    refused("--lkp north: is no place", "lost-person", "--lkp", "north")
    refused("is not in the table", "lost-person", "--lkp", LKP, "--category", "astronaut")
    refused(
        "--within-m: '1,2' is not understood; write 4 numbers",
        "lost-person",
        "--lkp",
        LKP,
        "--within-m",
        "1,2",
    )
    refused("farther from the map", "lost-person", "--lkp", LKP, "--over", "clusters")
    refused("make 14,400,000,000 cells", "lost-person", *OWN[:-1], 0.01)
    refused("is no .npz", "lost-person", *OWN, "--out", "map.tif")
    weather = ("--lkp", LKP, "--wind", "8,225", "--current", "0.3,90")
    refused("--hours: is -1", "drift", *weather, "--hours", -1)
    refused("area: reaches", "drift", *weather, "--hours", 1e6)
    refused("--leeway BOAT", "drift", *weather, "--hours", 1, "--leeway", "BOAT")
    refused(
        "--wind: has a speed of -8 m/s", "drift", *weather[:2], "--wind=-8,225", *weather[4:], "--hours", 1
    )
    refused("write 2 numbers", "drift", *weather, "--hours", 1, "--wind", "8")
    refused("as many as of the other", "drift", *weather, *weather[2:], "--wind", "9,9", "--hours", 1)
    refused("write at least one", "terrain", "lost.npz")
    refused("write FILE:M:FACTOR", "terrain", "lost.npz", "--near", "trail.geojson:50")
    refused("--heights: is missing", "terrain", "lost.npz", "--slope", "15:1")
    refused("write MAP:WEIGHT", "mix", "lost.npz")
    refused("'much' is not understood; write 1 number", "mix", "lost.npz:much")
    refused("weights: write numbers", "mix", "lost.npz:-1")
    refused("holds no journal.jsonl", "after", "lost.npz", "--searched", ".")
    refused("--sweep-width-m: is missing", "after", "lost.npz", "--searched", "flown.plan")
    flown = ("--searched", "flown.plan")
    for width in ("0", "nan", "inf", "-30"):
        refused(f"--sweep-width-m: is {width}", "after", "lost.npz", *flown, "--sweep-width-m", width)
    (tmp_path / "flown.plan").write_text("{}")
    refused(
        "flown.plan: is the same plan as flown.plan; name each once",
        "after", "lost.npz", *flown, *flown, "--sweep-width-m", 30,
    )  # fmt: skip
    assert not (tmp_path / "after.npz").exists()
