"""``skysweep plan``: what it says of terrain, radio and sun, its advice, and the gaps of a mission."""

from __future__ import annotations

import json
import re

import pytest
from typer.testing import CliRunner

from skysweep.cli import app
from skysweep.planning.flight_plan import plan_scenario
from skysweep.scenarios.files import load_scenario

RUNNER = CliRunner()


def plan(*words: str):
    return RUNNER.invoke(app, ["plan", *words])


@pytest.fixture(scope="module")
def run_folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "wilderness"
    done = RUNNER.invoke(app, ["run", "person-wilderness", "--sensor", "statistical", "--out", str(folder)])
    assert done.exit_code == 0
    return folder


def test_a_plan_says_what_is_seen_and_where_the_sun_stands(tmp_path):
    done = plan("person-wilderness", "--out", str(tmp_path), "--at", "2026-06-21T10:30Z", "--json")
    assert done.exit_code == 0
    record = json.loads(done.stdout)
    assert record["seen_share"] == 1.0
    assert record["unseen"] == []
    assert record["height_agl_m"]["lowest_out_and_home"] > 2.0
    assert record["sun"]["elevation_deg"] > 40.0
    assert "each of" in plan("person-wilderness", "--out", str(tmp_path)).stdout


def test_a_drawn_plan_is_not_replaced_by_the_one_made_from_it(tmp_path, monkeypatch):
    """``--out plan`` is the default, and the plan's name that of the file."""
    monkeypatch.chdir(tmp_path)
    assert plan("clusters").exit_code == 0
    drawn = (tmp_path / "plan" / "clusters.plan").read_bytes()
    refused = plan("plan/clusters.plan", "--altitude", "25")
    assert refused.exit_code == 2
    assert "plan/clusters.plan: was given, and would be replaced" in refused.stderr.replace("\n", " ")
    assert (tmp_path / "plan" / "clusters.plan").read_bytes() == drawn
    assert plan("plan/clusters.plan", "--altitude", "25", "--out", "lower").exit_code == 0


def test_advice_is_a_table_with_one_best_row():
    done = plan("clusters", "--advise", "--json")
    assert done.exit_code == 0
    record = json.loads(done.stdout)
    assert record["best"] in record["options"]
    shown = plan("clusters", "--advise", "--pod", "0.9").stdout
    assert "expected POD" in shown
    assert "best: " in shown
    assert "plan it: skysweep plan clusters --altitude " in shown


def test_advice_compares_each_flight_once_and_says_why_some_cannot_be(tmp_path):
    scenario = tmp_path / "mine.yaml"
    scenario.write_text(
        "name: mine\narea: {polygon_enu_m: [[0, 0], [290, 0], [290, 280], [0, 280]]}\n"
        "camera: {hfov_rad: 1.0}\nvehicle: {cruise_speed_mps: 10, battery_wh: 11}\n"
        "search: {scan_speed_mps: 10}\n"
    )
    options = json.loads(plan(str(scenario), "--advise", "--json").stdout)["options"]
    assert len({(o["altitude_agl_m"], round(o["speed_mps"], 3)) for o in options}) == len(options)
    shown = plan(str(scenario), "--advise").stdout
    assert "no flight: vehicle.battery_wh: 11 Wh do not last" in shown
    assert "best: " in shown


def test_the_command_that_is_advised_plans_what_was_advised(tmp_path):
    advice = ["clusters", "--advise", "--hfov", "0.8", "--heading", "37"]
    done = plan(*advice)
    advised = re.search(r"plan it: skysweep plan (.*)", done.stdout).group(1).split()
    assert advised[:5] == ["clusters", "--heading", "37", "--hfov", "0.8"]
    planned = json.loads(plan(*advised, "--out", str(tmp_path), "--json").stdout)
    best = json.loads(plan("clusters", "--advise", "--hfov", "0.8", "--heading", "37", "--json").stdout)[
        "best"
    ]
    assert planned["path_length_m"] == best["path_length_m"]
    assert planned["pixels_on_target"] == best["pixels_on_target"]


def test_the_warnings_of_the_best_flight_are_told(tmp_path):
    words = (
        "name: mine\narea: {polygon_enu_m: [[0, 0], [290, 0], [290, 280], [0, 280]]}\n"
        "safety: {no_fly_enu_m: [[[100, -50], [200, -50], [200, 400], [100, 400]]]}\n"
        "wind: {mean_speed_mps: 10}\n"
    )
    (tmp_path / "mine.yaml").write_text(words)
    done = plan(str(tmp_path / "mine.yaml"), "--advise")
    assert "warning: safety.no_fly_enu_m: the path leads" in done.stderr
    assert (
        "warning: wind.mean_speed_mps: is 10, above safety.wind_max_mps (9): nothing takes off" in done.stderr
    )


def test_the_gaps_of_a_run_are_a_scenario_that_flies(tmp_path, run_folder):
    done = plan("--gaps", str(run_folder), "--pod", "0.9", "--out", str(tmp_path / "again"), "--json")
    assert done.exit_code == 0
    record = json.loads(done.stdout)
    assert len(record["gaps"]) > 1
    again = load_scenario(record["yaml"])
    path, _ = plan_scenario(again)
    assert path.length_m == pytest.approx(record["path_length_m"], rel=1e-6)
    whole, _ = plan_scenario(load_scenario("person-wilderness"))
    assert path.length_m < 0.8 * whole.length_m
    flown = RUNNER.invoke(
        app, ["run", record["yaml"], "--sensor", "statistical", "--out", str(tmp_path / "second")]
    )
    assert flown.exit_code == 0


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["clusters", "--pod", "0.5"], "--pod: belongs to --advise and --gaps"),
        (["clusters", "--advise", "--pod", "1.5"], "--pod: 1.5 is no probability"),
        (["clusters", "--gaps", "somewhere"], "--gaps: flies a run's own scenario"),
        (["--gaps", "somewhere", "--at", "noon"], "--gaps: flies a run's own scenario"),
        (["--gaps", "somewhere", "--uavs", "3"], "--gaps: flies a run's own scenario"),
        (["clusters", "--prior", "map.csv", "--advise"], "--advise, --at: are of transects"),
        (["clusters", "--prior", "map.csv", "--at", "noon"], "--advise, --at: are of transects"),
        (["--gaps", "nowhere"], "nowhere: has no config.yaml"),
        (["clusters", "--at", "noon"], "--at: 'noon' is no date and time"),
        (["--advise"], "SOURCE: is missing"),
        (["clusters", "--advise", "--out", "here"], "--out, --at: belong to a plan, which --advise writes"),
    ],
)
def test_what_does_not_go_together_is_one_sentence(words, sentence):
    done = plan(*words)
    assert done.exit_code == 2
    assert sentence in done.stderr


def test_a_plan_is_that_of_the_scenarios_strategy(tmp_path):
    words = (
        "name: mine\narea: {polygon_enu_m: [[0, 0], [60, 0], [60, 40], [0, 40]]}\nsearch: {strategy: %s}\n"
    )
    path_m = {}
    for strategy in ("scan-only", "low-only", "nobody"):
        scenario = tmp_path / f"{strategy}.yaml"
        scenario.write_text(words % strategy)
        done = plan(str(scenario), "--out", str(tmp_path / strategy), "--json")
        if done.exit_code == 0:
            path_m[strategy] = json.loads(done.stdout)["path_length_m"]
    assert done.exit_code == 2
    assert "there is no strategy 'nobody'" in done.stderr
    assert path_m["low-only"] > 3.0 * path_m["scan-only"]
