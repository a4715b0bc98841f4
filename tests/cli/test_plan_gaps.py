"""``skysweep plan --gaps``: what it says and writes of missions that missed something."""

from __future__ import annotations

import json

import pytest
from typer.testing import CliRunner

from skysweep.cli import app
from skysweep.planning.flight_plan import plan_scenario
from skysweep.scenarios.files import load_scenario

RUNNER = CliRunner()

MINE = """
name: mine
area: {polygon_enu_m: [[0, 0], [200, 0], [200, 150], [0, 150]]}
home: {latitude_deg: 60.449, longitude_deg: 22.2966, position_enu_m: [-8, -8]}
targets: [{class: person, position_enu_m: [50, 50], motion: {kind: walk}}]
camera: {width_px: 640, height_px: 360, hfov_rad: 1.2}
"""
SMALL = "{polygon_enu_m: [[0, 0], [60, 0], [60, 55], [0, 55]]}"
HALFWAY = """
import skysweep as ss

class Halfway:
    @staticmethod
    def cover_altitude_agl_m(search):
        return (search.scan_altitude_agl_m + search.check_altitude_agl_m) / 2

    def __init__(self, context):
        pass

    def step(self, seen):
        return ss.Command(ss.Mode.SCAN, None, (ss.Event(ss.EventKind.FINISHED),))

    def snapshot(self):
        return {}

    def restore(self, snapshot):
        pass
"""


def skysweep(*words):
    done = RUNNER.invoke(app, list(map(str, words)))
    assert done.exit_code == 0, done.output
    return done


@pytest.fixture
def flown(tmp_path, monkeypatch):
    """Flies MINE with more in it, and returns the run's folder."""
    (tmp_path / "halfway_of_gaps.py").write_text(HALFWAY)
    monkeypatch.chdir(tmp_path)

    def fly(name, **sections):
        scenario = tmp_path / f"{name}.yaml"
        lines = [line for line in MINE.splitlines() if line.split(":")[0] not in sections]
        scenario.write_text("\n".join([*lines, *(f"{k}: {v}" for k, v in sections.items())]))
        skysweep("run", scenario, "--sensor", "statistical", "--out", tmp_path / name)
        return tmp_path / name

    return fly


def gaps(*runs, out):
    words = [word for run in runs for word in ("--gaps", run)]
    done = skysweep("plan", *words, "--out", out, "--json")
    return json.loads(done.stdout), " ".join(done.stderr.split())


def test_a_plan_of_gaps_says_what_it_takes_and_what_cannot_be_flown(tmp_path, flown):
    run = flown(
        "first",
        search="{strategy: scan-only, scan_speed_mps: 3}",
        vehicle="{battery_wh: 11}",
        safety="{no_fly_enu_m: [[[80, 90], [130, 90], [130, 140], [80, 140]]]}",
    )
    record, said = gaps(run, out=tmp_path / "out")
    assert record["batteries"] > 1
    assert f"the whole plan takes {record['batteries']} (" in said
    assert "Targets may move: the POD counts where they were when looked for" in said
    assert record["no_fly"]["area_m2"] > 1000.0
    shown = skysweep("plan", "--gaps", run, "--out", tmp_path / "shown").stdout
    assert f"{record['batteries']} (" in shown
    assert "below too, and cannot be flown" in shown
    assert "around area, path, home and take-off" in shown


def test_all_flights_over_an_area_count(tmp_path, flown):
    first = flown("first", search="{strategy: scan-only}", vehicle="{battery_wh: 11}")
    record, said = gaps(first, out=tmp_path / "gaps")
    assert "search.plan" not in said
    skysweep(
        *("run", record["yaml"], "--sensor", "statistical", "--out", tmp_path / "second"),
        *("--set", "vehicle.batteries=9", "--seed", "1"),
    )
    _, said = gaps(tmp_path / "second", out=tmp_path / "alone")
    assert "second: flew search.plan alone; if others flew before, name them, too" in said
    both, said = gaps(first, tmp_path / "second", out=tmp_path / "both")
    assert "search.plan" not in said
    assert both["mean_pod"] > record["mean_pod"] + 0.1
    left_m2 = [sum(gap["area_m2"] for gap in of["gaps"]) for of in (both, record)]
    assert left_m2[0] < 0.2 * left_m2[1]
    again = RUNNER.invoke(app, ["plan", "--gaps", str(first), "--gaps", str(first)])
    assert again.exit_code == 2
    assert "is the same flight as" in again.stderr


@pytest.mark.parametrize(("strategy", "height_m"), [("low-only", 4.0), ("halfway_of_gaps:Halfway", 17.0)])
def test_gaps_are_flown_from_where_the_area_is_covered(tmp_path, flown, strategy, height_m):
    run = flown("first", search=f"{{strategy: '{strategy}'}}", vehicle="{battery_wh: 20}", area=SMALL)
    record, said = gaps(run, out=tmp_path / "gaps")
    assert f"search.strategy: {strategy} flies no drawn plan; gaps.yaml flies scan-only" in said
    again = load_scenario(record["yaml"])
    assert (again.search.strategy, again.search.scan_altitude_agl_m) == ("scan-only", height_m)
    assert plan_scenario(again)[0].length_m == pytest.approx(record["path_length_m"])
    words = ("--sensor", "statistical", "--out", tmp_path / "second")
    skysweep("run", record["yaml"], *words, "--set", "vehicle.battery_wh=200", "--set", "vehicle.batteries=3")
    both, _ = gaps(run, tmp_path / "second", out=tmp_path / "both")
    assert both["mean_pod"] > 0.85


def test_a_drawn_plan_that_a_strategy_ignores_is_warned_of(tmp_path, flown):
    run = flown("first", search="{strategy: scan-only}", vehicle="{battery_wh: 11}")
    record, _ = gaps(run, out=tmp_path / "gaps")
    mine = tmp_path / "own.yaml"
    mine.write_text(f"{MINE}search: {{strategy: 'halfway_of_gaps:Halfway', plan: {record['plan']}}}\n")
    for words in (("plan", mine), ("run", mine, "--sensor", "statistical", "--out", tmp_path / "own")):
        said = " ".join(skysweep(*words).stderr.split())
        assert "search.plan: is not flown: halfway_of_gaps:Halfway covers the area from 17 m" in said


def test_nothing_is_below_only_where_nothing_is(tmp_path, flown):
    inside = "{polygon_enu_m: [[9, 9], [29, 9], [29, 19], [9, 19]]}"
    run = flown("first", search="{strategy: scan-only, sidelap: 0.6}", area=inside)
    done = skysweep("plan", "--gaps", run, "--pod", "0.0001", "--out", tmp_path / "out")
    assert "none with a POD below 0.01 %" in " ".join(done.stdout.split())
    assert "small" not in done.stdout
    assert not (tmp_path / "out").exists()
