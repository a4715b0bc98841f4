"""A sensor adapted to a scenario, with the real renderer; what the detector sees is a bent sensor's draws."""

from collections import Counter
from operator import attrgetter

import numpy as np
import pytest
from typer.testing import CliRunner

from skysweep.api.scenarios import load_scenario
from skysweep.cli import app
from skysweep.experiments.calibration import of_scenario
from skysweep.experiments.calibration.of_scenario import (
    FAR,
    GROUND,
    NEAR,
    SHIFTS,
    TREE,
    Fitted,
    Tally,
    WorldJob,
    fit,
    look_around,
)
from skysweep.geometry.camera import CameraPose
from skysweep.geometry.frames import rotation_camera_to_enu
from skysweep.sensing.statistical.model import StatisticalModel, model_for
from skysweep.sensing.statistical.posed import PosedSensor
from skysweep.types import Detections
from skysweep.worlds.world import build_world

BEFORE, NOW = attrgetter("before"), attrgetter("now")
PERSON, ROCK = ("person", "lying"), ("rock", "face-up")
RUNNER = CliRunner()


def scenario(folder):
    path = folder / "mine.yaml"
    path.write_text(
        """
name: mine
area: {polygon_enu_m: [[0, 0], [80, 0], [80, 60], [0, 60]]}
terrain: {surface: grass}
forests: [{trees_per_hectare: 60, seed: 1}]
generators:
  - {class: person, pattern: uniform, count: 4, poses: [lying], seed: null}
  - {class: rock, pattern: uniform, count: 10, seed: null}
camera: {hfov_rad: 1.2}
search: {scan_altitude_agl_m: 25, check_altitude_agl_m: 12}
"""
    )
    return load_scenario(path)


def tally(
    reported, at=lambda shift: 1 / (1 + np.exp(-2 * shift)), looks=400, objects=400, band=FAR, at_log=3.0
):
    """Rocks that are reported as persons with chance ``at`` of a shift, all at one scale."""
    key, draws = (ROCK, "person"), of_scenario._SENSORS * of_scenario._DRAWS
    drawn = Counter({(key, band, k): round(draws * looks * at(shift)) for k, shift in enumerate(SHIFTS)})
    drawn[(GROUND, "person"), band, SHIFTS.index(0.0)] = draws * 10
    looked = Counter({(ROCK, band): looks, (GROUND, band): 40})
    scales = {(ROCK, band): looks * at_log, (GROUND, band): 40 * at_log}
    return Tally(
        Counter({band: 40}),
        {band: (9.0, 9.0)},
        Counter({(ROCK, band): objects, (GROUND, band): 40}),
        looked,
        scales,
        Counter({(key, band): reported}),
        drawn,
    )


def shift_of(tallies):
    return fit(tallies, StatisticalModel.load()).shifts[ROCK, "person"]


def test_a_shift_is_found_and_drawn_towards_nothing():
    model = StatisticalModel.load()
    more = round(400 / (1 + np.exp(-1.0)))
    assert shift_of([tally(more)]) == ((3.0,), (pytest.approx(0.5, abs=0.05),))
    _, (few,) = shift_of([tally(more, objects=4)])
    assert 0.0 < few < 0.35  # many looks at few rocks tell less
    fitted = fit([tally(200)], model)
    assert fitted.shifts[ROCK, "person"][1] == (0.0,)
    assert fitted.shifts[PERSON, "person"] == ((0.0,), (0.0,))  # none was seen


def test_from_afar_and_from_near_are_two_shifts_with_a_line_between():
    more, fewer = (round(400 / (1 + np.exp(-by))) for by in (1.0, -1.0))
    model = StatisticalModel.load()
    fitted = fit([tally(more, at_log=np.log(10.0)), tally(fewer, band=NEAR, at_log=np.log(40.0))], model)
    places, shifts = fitted.shifts[ROCK, "person"]
    assert np.exp(places) == pytest.approx([10.0, 40.0])
    assert shifts == pytest.approx((0.5, -0.5), abs=0.05)
    before, after = (
        next(k for k in m.kinds if (k.kind, k.reported_as) == ("rock", "person")).score
        for m in (model, of_scenario._adapted(model, fitted))
    )
    by_pixels = dict(zip(model.pixels, np.subtract(after, before), strict=True))
    assert by_pixels[4.0] == by_pixels[10.0] == pytest.approx(0.5, abs=0.05)
    assert by_pixels[20.0] == pytest.approx(0.0, abs=0.06)
    assert by_pixels[220.0] == pytest.approx(-0.5, abs=0.05)


def test_rates_where_nothing_is():
    seen = tally(200)
    seen.reported[(GROUND, "person"), FAR] = 4
    times = fit([seen], StatisticalModel.load()).times
    assert times[GROUND, "person"] == ((3.0,), (pytest.approx(np.log(0.5)),))  # (4 + 2) / (10 + 2)
    assert times[TREE, "person"] == ((0.0,), (0.0,))


class Bent:
    """In place of a detector: draws of a sensor whose rocks are reported more often, and persons less."""

    def __init__(self, world, scenario, model):
        shifts = {(thing, "person"): ((0.0,), (by,)) for thing, by in ((ROCK, 1.0), (PERSON, -1.0))}
        self._sensor = PosedSensor(scenario, world, of_scenario._adapted(model, Fitted(shifts, {})), 7)

    def detect(self, frame):
        return self._sensor.detect(frame.camera, np.zeros(3))


def test_another_world_than_the_model_s_is_found(tmp_path, monkeypatch):
    mine, tallies = scenario(tmp_path), []
    model = model_for(mine)
    for index in range(3):
        world = build_world(mine, of_scenario._FIRST_SEED + index)
        monkeypatch.setattr(of_scenario, "make_detector", lambda *_, w=world, **__: Bent(w, mine, model))
        tallies.append(look_around(WorldJob(mine, model, index, 30, 0)))
    shifts = fit(tallies, model).shifts
    assert min(shifts[ROCK, "person"][1]) > 0.3
    assert max(shifts[PERSON, "person"][1]) < -0.2
    parts = [part for part in of_scenario._parts(tallies, model) if "rock, face-up, from " in part.part]
    assert len(parts) == 2
    before, now = (sum(abs(value(part) - part.measured) for part in parts) for value in (BEFORE, NOW))
    assert now < 0.5 * before


def test_what_a_report_is_of(tmp_path):
    mine = scenario(tmp_path)
    world = build_world(mine, 0)
    view = of_scenario._View(mine, world)
    number = view.things.index(PERSON)
    down = rotation_camera_to_enu(0.0, -np.pi / 2)
    pose = CameraPose(world.objects[number].position_enu_m + np.array([0.0, 0.0, 25.0]), down)
    middle = np.array([320.0, 180.0])
    far = np.array([[20.0, 20.0], [22.0, 22.0]])
    boxes = np.array([[*(m - 5), *(m + 5)] for m in (middle, middle + 2, *far)])
    found = Detections(0.0, boxes, np.full(4, 0.5), ("person",) * 4, pose, mine.camera.lens)
    keys = Counter(view.assigned(pose, found))
    assert keys.pop((PERSON, "person")) == 1  # two boxes on one person count once
    assert sum(keys.values()) >= 1
    assert number in view.inside(pose)


def test_poses_are_those_of_a_search(tmp_path):
    mine = scenario(tmp_path)
    view, rng = of_scenario._View(mine, build_world(mine, 0)), np.random.default_rng(1)
    heights = [view.pose(rng)[1] for _ in range(60)]
    assert min(heights) >= 12.0
    assert max(heights) == 25.0
    assert 15 < sum(h == 25.0 for h in heights) < 45
    assert all(h == 25.0 or h <= np.sqrt(12.0 * 25.0) for h in heights)


def test_from_the_command_line_to_a_mission(tmp_path):
    scenario(tmp_path)
    out = tmp_path / "adapted.yaml"
    asked = ["calibrate", "--scenario", str(tmp_path / "mine.yaml"), "--pictures", "12", "--workers", "1"]
    result = RUNNER.invoke(app, [*asked, "--out", str(out)])
    assert result.exit_code == 0, result.output
    assert "person, lying" in result.output
    adapted = StatisticalModel.load(out)
    assert adapted.scenario.name == "mine"
    assert adapted.scenario.pictures == 12
    flown = ["run", str(tmp_path / "mine.yaml"), "--sensor", "statistical", "--out", str(tmp_path / "run")]
    result = RUNNER.invoke(app, [*flown, "--set", f"detector.statistical_model={out}"])
    assert result.exit_code == 0, result.output
    assert not out.with_suffix(".png").exists()


@pytest.mark.parametrize(
    ("given", "names"),
    [
        (["--model", "skysweep"], "--model"),
        (["--camera", "clusters"], "--camera"),
        (["--tiles", "2"], "--tiles"),
        (["--pictures", "5"], "--pictures 5"),
        (["--pictures", "folder"], "--pictures folder"),
    ],
)
def test_what_a_scenario_says_already_is_refused(tmp_path, given, names):
    out = ["--out", str(tmp_path / "s.yaml")]
    result = RUNNER.invoke(app, ["calibrate", "--scenario", "clusters", *given, *out])
    assert result.exit_code == 2
    assert names in result.output
