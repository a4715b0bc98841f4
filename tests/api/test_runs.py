"""Missions, plans, worlds and sweeps from Python."""

import importlib
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import polars as pl
import pytest

import skysweep as ss
from skysweep.api.runs import KeptFrame
from skysweep.results.picture_files import write_picture

OWN = """
import skysweep as ss


class Never:
    def __init__(self, context):
        pass

    def step(self, seen):
        return ss.Command(ss.Mode.SCAN, None, (ss.Event(ss.EventKind.FINISHED),))

    def snapshot(self):
        return {}

    def restore(self, snapshot):
        pass
"""
SMALL = ss.make_scenario(
    name="small",
    area={"polygon_enu_m": [[0, 0], [24, 0], [24, 12], [0, 12]]},
    home={"position_enu_m": [-5, -5]},
    targets=[{"class": "stop sign", "position_enu_m": [12, 6], "size_m": 0.9}],
    detector={"rate_hz": 2},
    search={"scan_altitude_agl_m": 15, "check_altitude_agl_m": 6},
)


class KnowsDogs:
    class_names = ("dog",)

    def __init__(self, scenario):
        pass

    def detect(self, frame): ...


def timeless(summary):
    return {k: v for k, v in summary.items() if k not in ("wall_time_s", "real_time_factor")}


@pytest.fixture
def own(tmp_path, monkeypatch):
    """The working folder, with a module of the user's own."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    (tmp_path / "own_never.py").write_text(OWN)
    yield tmp_path
    sys.modules.pop("own_never", None)


@pytest.mark.parametrize("sensor", ["statistical", "imaging"])
def test_written_or_not_it_is_the_same_mission(tmp_path, sensor):
    kept = ss.run(SMALL, sensor=sensor, seed=3, out=tmp_path / "run")
    loose = ss.run(SMALL, sensor=sensor, seed=3)
    assert timeless(kept.summary) == timeless(loose.summary)
    assert timeless(ss.load_run(tmp_path / "run").summary) == timeless(kept.summary)
    assert kept.track.equals(loose.track)
    assert kept.candidates.equals(loose.candidates)
    assert [e["kind"] for e in loose.events] == [e["kind"] for e in kept.events]
    assert [(f.candidate, f.time_s) for f in kept.frames] == [(f.candidate, f.time_s) for f in loose.frames]
    for mine, theirs in zip(kept.frames, loose.frames, strict=True):
        np.testing.assert_array_equal(mine.image, theirs.image)
    assert bool(kept.frames) == (sensor == "imaging")
    assert loose.folder is None
    assert kept.folder == tmp_path / "run"


def test_of_an_announced_picture_and_a_better_one_of_later_the_later_is_given(tmp_path):
    ss.run(SMALL, sensor="statistical", out=tmp_path / "run")
    (tmp_path / "run" / "pictures").mkdir()
    for name in ("candidate-1-9.5s.jpg", "candidate-1-10.0s.jpg", "candidate-2-3.0s.jpg"):
        _, jpeg = cv2.imencode(".jpg", np.zeros((36, 64, 3), np.uint8))
        write_picture(tmp_path / "run" / "pictures" / name, jpeg.tobytes())
    frames = ss.load_run(tmp_path / "run").frames
    assert [(frame.candidate, frame.time_s) for frame in frames] == [(2, 3.0), (1, 10.0)]


def test_pictures_stand_for_runs_and_plans_in_notebooks():
    run, plan = ss.run(SMALL, sensor="statistical"), ss.plan(SMALL)
    assert run._repr_png_().startswith(b"\x89PNG")
    assert plan._repr_png_().startswith(b"\x89PNG")
    assert repr(run).startswith("Run(small, scan-check, seed 0: 1 of 1 targets confirmed in ")
    assert plan.waypoints.shape == (len(plan.waypoints), 2)
    assert isinstance(plan.advice, tuple)
    assert repr(KeptFrame(3, 1.25, b"")) == "KeptFrame(candidate 3, t = 1.2 s)"


def test_nothing_is_said_where_there_is_no_terminal(capfd):
    ss.run(SMALL, sensor="statistical")
    assert capfd.readouterr() == ("", "")


def test_a_world_on_its_own():
    world = ss.build_world(SMALL)
    [target] = world.targets
    above = ss.camera_pose(target.position_enu_m + np.array([0.0, 0.0, 6.0]), heading_deg=90.0)
    picture = world.render(above)
    assert (picture.shape, picture.dtype) == ((360, 640, 3), np.uint8)
    seen = [world.detect(above) for _ in range(20)]
    assert sum(len(found) for found in seen) > 10
    again = ss.build_world(SMALL)
    np.testing.assert_array_equal(again.detect(above).boxes_xyxy_px, seen[0].boxes_xyxy_px)
    middle_px = np.concatenate([f.boxes_xyxy_px.reshape(-1, 2, 2).mean(axis=1) for f in seen])
    assert np.abs(np.median(middle_px, axis=0) - [320, 180]).max() < 30
    found = ss.load_detector(classes=["stop sign"]).detect(picture)
    assert "stop sign" in found.class_names


def test_a_pose_looks_where_its_angles_say():
    north = ss.camera_pose((0, 0, 5), heading_deg=0.0, pitch_deg=0.0)
    np.testing.assert_allclose(north.R_camera_to_enu[:, 2], [0, 1, 0], atol=1e-12)
    down = ss.camera_pose((0, 0, 5), heading_deg=90.0)
    np.testing.assert_allclose(down.R_camera_to_enu[:, 2], [0, 0, -1], atol=1e-12)
    np.testing.assert_allclose(-down.R_camera_to_enu[:, 1], [1, 0, 0], atol=1e-12)  # the picture's top


def test_a_researcher_compares_a_strategy(own, capfd):
    sys.path.append(str(own))
    from own_never import Never

    missions = ss.sweep(SMALL, ["scan-check", Never], seeds=5)
    assert missions.height == 10
    assert missions["error"].null_count() == 10
    assert set(missions["strategy"]) == {"scan-check", "own_never:Never"}
    difference = ss.compare(missions, "mission_time_s", "scan-check", "own_never:Never")
    assert difference.n_pairs == 5
    assert 0.0 < difference.low <= difference.mean <= difference.high
    times = missions.filter(pl.col("strategy") == "scan-check")["mission_time_s"]
    estimate = ss.estimate(times)
    assert (estimate.n, estimate.mean) == (5, pytest.approx(times.mean()))
    assert not list(own.glob("sweep*"))
    assert capfd.readouterr() == ("", "")


def test_a_kept_sweep_goes_on_and_knows_another_code(own):
    name = "own_never:Never"
    first = ss.sweep(SMALL, name, seeds=2, out=own / "kept")
    assert ss.sweep(SMALL, name, seeds=2, out=own / "kept").equals(first)
    (own / "own_never.py").write_text(OWN + "\n# changed\n")
    with pytest.raises(
        ss.UserError, match=r"own_never\.py was changed since it was imported; restart Python"
    ):
        ss.sweep(SMALL, name, seeds=2, out=own / "kept")
    importlib.reload(sys.modules["own_never"])
    with pytest.raises(ss.UserError, match="holds the results of another sweep"):
        ss.sweep(SMALL, name, seeds=2, out=own / "kept")


def test_parameters_are_varied_and_paired():
    missions = ss.sweep(SMALL, seeds=[1, 2], parameters={"search.n_c": [1, np.inf]})
    assert missions["param.search.n_c"].to_list() == [1.0, np.inf, 1.0, np.inf]
    with pytest.raises(ss.UserError, match="several missions have the same seed"):
        ss.compare(missions.drop("param.search.n_c"), "recall", "scan-check", "scan-check")


def table(rows: list[tuple[str, str, int, float, float | None]]) -> pl.DataFrame:
    columns = ["scenario", "strategy", "seed", "param.search.n_c", "recall"]
    return pl.DataFrame(rows, schema=columns, orient="row")


ONE = table([("hill", "a", 0, np.inf, 1.0)])


def test_copies_of_a_seed_are_one_pair():
    """Two scenarios, three seeds, four values of n_c, which means nothing: six pairs."""
    rows = [
        (scenario, strategy, seed, n_c, recall - 0.1 * seed * (strategy == "scan-only"))
        for scenario, recall in (("hill", 0.9), ("lake", 0.8))
        for strategy in ("scan-check", "scan-only")
        for seed in range(3)
        for n_c in (1.0, 2.0, 3.0, np.inf)
    ]
    many = ss.compare(table(rows), "recall", "scan-check", "scan-only")
    few = ss.compare(table([row for row in rows if row[3] == 1.0]), "recall", "scan-check", "scan-only")
    assert many.n_pairs == few.n_pairs == 6
    assert many.p == few.p == 0.125
    assert (many.mean, many.low, many.high) == pytest.approx((few.mean, few.low, few.high))


def test_a_seed_is_averaged_over_what_both_flew():
    rows = [
        *(("hill", "a", seed, n_c, n_c / 10) for seed in range(2) for n_c in (1.0, 3.0, 7.0)),
        *(("hill", "b", seed, n_c, 0.0) for seed in range(2) for n_c in (1.0, 3.0)),
        ("hill", "b", 0, 7.0, None),
    ]
    found = ss.compare(table(rows), "recall", "a", "b")
    assert (found.n_pairs, found.mean) == (2, pytest.approx(0.2))
    found = ss.compare(table(rows), "recall", 3, 1, by="param.search.n_c")  # 7 is in no pair
    assert (found.n_pairs, found.mean) == (2, pytest.approx(0.1))


def test_differences_that_cancel_are_none():
    rows = [
        ("hill", strategy, seed, n_c, value)
        for strategy, values in (("a", (0.3, 0.6)), ("b", (0.1, 0.8)))
        for seed in range(9)
        for n_c, value in enumerate(values, 1)
    ]
    assert (0.3 - 0.1) + (0.6 - 0.8) != 0.0
    found = ss.compare(table(rows), "recall", "a", "b")
    assert (found.mean, found.n_zero, found.p) == (0.0, 9, 1.0)


@pytest.mark.parametrize(
    ("call", "sentence"),
    [
        (lambda: ss.run("clusterz"), "did you mean 'clusters'"),
        (lambda: ss.run(42), "scenario: is 42; give a name"),
        (lambda: ss.run(SMALL, sensor="stat"), "there is no sensor 'stat'"),
        (lambda: ss.run(SMALL, "scan-chek"), "there is no strategy 'scan-chek'"),
        (lambda: ss.run(SMALL, 3), "strategy: is 3; give a strategy's name"),
        (lambda: ss.run(SMALL, seed=-1), "seed: is -1; write a whole number"),
        (lambda: ss.run(SMALL, seed=1.5), r"seed: is 1\.5; write a whole number"),
        (lambda: ss.run(SMALL, seed=True), "seed: is True; write a whole number"),
        (lambda: ss.run(SMALL, out=3), "out: is 3; write the path of a new folder"),
        (lambda: ss.run(SMALL, vehicle=3, sensor="statistical"), "vehicle: is 3; give a vehicle"),
        (lambda: ss.run(SMALL, vehicle=lambda: 3, sensor="statistical"), "vehicle: cannot be made"),
        (lambda: ss.run(SMALL, vehicle=lambda *_: 3, sensor="statistical"), "vehicle: int has no state and"),
        (lambda: ss.run(SMALL, camera=3), "camera: is 3; give a camera"),
        (lambda: ss.run(SMALL, detector=3), "detector: is 3; give a detector"),
        (lambda: ss.run(SMALL, detector=lambda _: 3, sensor="statistical"), "takes no pictures"),
        (
            lambda: ss.run(SMALL, detector=KnowsDogs),
            "KnowsDogs knows the classes dog, and the mission searches ",
        ),
        (lambda: ss.run(SMALL, renderer="opengl"), "backend: 'opengl' is unknown"),
        (lambda: ss.make_scenario(name="x"), "x: area: is missing"),
        (lambda: ss.change_scenario(SMALL, {"search.nc": 1}), "did you mean 'n_c'"),
        (lambda: ss.load_run("nowhere"), "has no config.yaml"),
        (lambda: ss.camera_pose("x"), "pose: write numbers"),
        (lambda: ss.camera_pose((1, 2)), "write three numbers"),
        (lambda: ss.build_world(SMALL).render(3), "pose: is 3; make one with camera_pose"),
        (lambda: ss.load_detector("nowhere.onnx"), "nowhere.onnx"),
        (lambda: ss.load_detector(classes="boat"), r"write a list, such as \['boat'\]"),
        (lambda: ss.load_detector().detect(np.zeros((4, 4))), r"image: is an array \(4, 4\) of float64"),
        (lambda: ss.run(SMALL, watch=3), r"watch: is 3; give a function of \(state, mode, detections\)"),
        (lambda: ss.change_scenario(SMALL, [("search.n_c", 1)]), "changes: is .*; write a dict of dotted"),
        (
            lambda: ss.change_scenario(SMALL, {"search.n_c": None}),
            "search.n_c: is empty; write a valid number",
        ),
        (lambda: ss.write_scenario("clusters", "new.yaml"), "scenario: is 'clusters'; give a Scenario"),
        (lambda: ss.sweep(SMALL, seeds=0), "seeds: is 0"),
        (lambda: ss.sweep(SMALL, out=""), "out: is ''; write a folder or a URL, or leave it out"),
        (lambda: ss.sweep(SMALL, out=5), "out: is 5; write a folder or a URL, or leave it out"),
        (lambda: ss.sweep(SMALL, "scan-chk"), "there is no strategy 'scan-chk'"),
        (lambda: ss.sweep([SMALL, SMALL]), "two are called 'small'"),
        (lambda: ss.sweep(SMALL, workers=0), "workers: is 0"),
        (lambda: ss.sweep(SMALL, lambda *_: 3), "cannot be found by its name"),
        (lambda: ss.sweep(SMALL, parameters={"search.nc": [1]}), "a scenario has no such parameter"),
        (lambda: ss.estimate(["a"]), "values: are no numbers"),
        (lambda: ss.compare(pl.DataFrame({"a": [1]}), "b", "x", "y"), "b: is no column; write one of a"),
        (lambda: ss.compare({"a": [1]}, "b", "x", "y"), "missions: is a dict; give the table that sweep"),
        (
            lambda: ss.compare(ONE, "recall", 1, 2, by="strategy"),
            "1: no mission has this strategy; write one",
        ),
        (lambda: ss.compare(ONE, "param.search.n_c", "a", "a"), "is no number, or infinite; compare one"),
    ],
)
def test_every_mistake_is_one_sentence(call, sentence):
    with pytest.raises(ss.UserError, match=sentence) as caught:
        call()
    assert "\n" not in str(caught.value)


def test_a_run_folder_of_an_own_strategy_is_gone_on_with_or_refused(own):
    def skysweep(*words):
        command = [sys.executable, "-m", "skysweep.cli", *words]
        return subprocess.run(command, capture_output=True, text=True, cwd=own)

    ss.write_scenario(SMALL, own / "small.yaml")
    flown = skysweep("run", "small.yaml", "--strategy", "own_never:Never", "--sensor", "statistical")
    assert flown.returncode == 0, flown.stderr
    folder = Path("runs/small-own_never.Never-seed0")
    journal = own / folder / "journal.jsonl"
    whole = journal.read_bytes()
    lines = whole.splitlines(keepends=True)
    journal.write_bytes(b"".join(lines[: len(lines) // 2]))
    (own / folder / "summary.json").unlink()
    broken_off = journal.read_bytes()
    (own / "own_never.py").write_text(OWN + "\n# changed\n")
    refused = skysweep("resume", str(folder))
    assert refused.returncode == 2
    assert "the mission was begun with strategy" in refused.stderr
    assert "Traceback" not in refused.stderr
    (own / "own_never.py").write_text(OWN)
    assert journal.read_bytes() == broken_off
    assert skysweep("resume", str(folder)).returncode == 0
    assert journal.read_bytes() == whole
