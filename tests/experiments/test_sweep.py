"""A sweep's table is complete and has the same bytes however it was made."""

import io
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from itertools import product

import fsspec
import numpy as np
import polars as pl
import psutil
import pytest

from skysweep.errors import UserError
from skysweep.experiments.engines import LocalEngine, make_engine
from skysweep.experiments.matrix import Matrix
from skysweep.experiments.store import SUMMARY_COLUMNS, TIMINGS
from skysweep.experiments.sweep.run import Outlook, Sweep
from skysweep.experiments.sweep.spec import matrix_of, parse_spec
from skysweep.files.folder import Folder
from skysweep.files.locking import locked
from skysweep.flights.build import build_mission
from skysweep.flights.fly import fly_in_memory, refuse_other_mission
from skysweep.flights.rig import Rig
from skysweep.mission.journal import MemoryJournal
from skysweep.mission.loop import fly
from skysweep.scenarios.files import change_scenario, load_scenario
from skysweep.vehicles.embedded import dynamics
from skysweep.worlds.world import build_world

SPEC = """
name: small
scenarios:
  - scenario:
      name: field
      area: {polygon_enu_m: [[0, 0], [24, 0], [24, 12], [0, 12]]}
      home: {position_enu_m: [-2, -2]}
      generators: [{class: stop sign, pattern: uniform, count: 1, size_m: 0.9, seed: null}]
      search: {scan_altitude_agl_m: 12}
strategies: [scan-check, {strategy: scan-only, parameters: {}}]
parameters:
  search.n_c: [1, .inf]
seeds: 10
"""

FILES = ["SHA256SUMS", "missions.parquet", "spec.yaml", "timings.parquet"]

BRITTLE = """
from skysweep.strategies import StrategySpec
from skysweep.strategies.baselines import SingleAltitude

class Brittle(SingleAltitude):
    def step(self, observation):
        if observation.time_s > 10:
            raise ZeroDivisionError("the wing\\nfell off")
        return super().step(observation)

def make(context):
    kind = Brittle if context.search.n_c == 2 else SingleAltitude
    return kind(context, context.search.scan_altitude_agl_m)

brittle = StrategySpec(make)
"""


class Here:
    """An engine without processes, which starts at once."""

    workers = 1

    def __enter__(self):
        return self

    def __exit__(self, *error):
        pass

    def run(self, work, jobs):
        for job in jobs:
            yield job, work(job)


def spec(**changes):
    text = SPEC
    for old, new in changes.items():
        text = text.replace(f"{old}: ", f"{old}: {new} #", 1)
    return parse_spec(text, "spec.yaml")


def sweep(out, engine=None, wanted=None, **options):
    flight = Sweep(wanted or spec(), out, **options)
    flight.fly(engine or Here())
    return flight


def table_bytes(out):
    return (out / "missions.parquet").read_bytes()


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    out = tmp_path_factory.mktemp("sweep") / "whole"
    sweep(out, LocalEngine(2))
    return out


def test_one_row_a_mission_with_its_summary(whole):
    table = pl.read_parquet(whole / "missions.parquet")
    assert sorted(p.name for p in whole.iterdir()) == FILES
    assert table.columns == [
        *("job", "scenario", "strategy", "seed", "sensor", "param.search.n_c", "config_hash"),
        *SUMMARY_COLUMNS,
        "error",
    ]
    assert table["job"].to_list() == list(range(30))
    assert table["error"].null_count() == 30
    matrix = matrix_of(spec())
    job, row = matrix.job(4), table.row(4, named=True)
    summary = fly_in_memory(job.scenario, job.seed, job.sensor)
    assert (row["strategy"], row["seed"], row["param.search.n_c"]) == ("scan-check", 1, np.inf)
    curve = list(zip(row.pop("pos_time_s"), row.pop("pos_value"), strict=True))
    assert curve == [tuple(point) for point in summary.pop("pos_curve")]
    for key in (*TIMINGS, "scenario"):
        summary.pop(key)
    summary |= {key: float(summary[key]) for key in ("n_c", "d_c_m")}
    assert {key: row[key] for key in summary} == summary


def test_timings_stand_beside_the_table(whole):
    timings = pl.read_parquet(whole / "timings.parquet")
    assert timings["job"].to_list() == list(range(30))
    assert timings["wall_time_s"].min() > 0


def test_a_complete_sweep_is_left_alone(whole):
    before = {p: p.stat().st_mtime_ns for p in whole.iterdir()}
    assert sweep(whole).left == 0
    assert {p: p.stat().st_mtime_ns for p in whole.iterdir()} == before


@pytest.mark.parametrize(
    ("workers", "how"), [(1, signal.SIGKILL), (2, signal.SIGKILL), (2, signal.SIGINT)], ids=str
)
def test_stopped_and_continued_it_has_the_same_bytes(whole, tmp_path, workers, how):
    out, file = tmp_path / "out", tmp_path / "small.yaml"
    file.write_text(SPEC)
    command = [sys.executable, "-m", "skysweep.cli", "sweep", str(file), "--out", str(out), "--workers"]
    with subprocess.Popen([*command, str(workers)], stderr=subprocess.PIPE, text=True) as process:
        while not list(out.glob("parts/[0-9a-f]*.parquet")):  # whole ones
            assert process.poll() is None, "it ended before it could be stopped"
            time.sleep(0.005)
        children = psutil.Process(process.pid).children(recursive=True)
        process.send_signal(how)
        _, said = process.communicate()
    if how == signal.SIGINT:
        assert process.returncode == 130
        assert "the same command continues" in said
        assert "Traceback" not in said
    assert not psutil.wait_procs(children, timeout=60)[1], "workers end with the command that was killed"
    assert not (out / "missions.parquet").exists()
    flown = Sweep(spec(), out)
    assert 0 < flown.left < flown.missions, "what was flown is not flown again"
    again = subprocess.run([*command, str(3 - workers)], capture_output=True, text=True)
    assert again.returncode == 0, again.stderr
    assert f"{flown.missions - flown.left} of them flown already" in again.stderr
    assert table_bytes(out) == table_bytes(whole)
    assert not (out / "parts").exists()


def test_more_seeds_and_values_go_on_from_what_is_there(whole, tmp_path):
    sweep(tmp_path / "out", wanted=spec(seeds="2", **{"search.n_c": "[1]"}))
    more = Sweep(spec(seeds="3"), tmp_path / "out")
    assert (more.missions, more.left) == (9, 9 - 4)
    more.fly(Here())
    table = pl.read_parquet(tmp_path / "out" / "missions.parquet")
    assert table.equals(pl.read_parquet(whole / "missions.parquet").head(9))


def test_the_results_of_another_sweep_stay(whole):
    before = table_bytes(whole)
    for changes, said in [
        ({"seeds": "9"}, "seeds: 10 there, 9 here"),
        ({"search": "{scan_altitude_agl_m: 13}"}, "scan_altitude_agl_m: 12.0 there, 13.0 here"),
        ({"search.n_c": "[1]"}, r"search.n_c: \[1, .inf\] there, \[1\] here"),
        ({"name": "other\nsensor: imaging"}, "sensor: statistical there, imaging here"),
    ]:
        with pytest.raises(UserError, match=said):
            Sweep(spec(**changes), whole)
    assert table_bytes(whole) == before


def test_another_detector_file_is_another_sweep(tmp_path):
    detector = tmp_path / "mine.onnx"
    detector.write_bytes(b"one")
    wanted = parse_spec(
        SPEC.replace("search: {", f"detector: {{model: {detector}}}\n      search: {{"), "spec.yaml"
    )
    first = matrix_of(wanted).job(0).config_hash
    assert matrix_of(wanted).job(0).config_hash == first
    detector.write_bytes(b"another")
    assert matrix_of(wanted).job(0).config_hash != first


@pytest.mark.parametrize("shipped", ["own_model_path", "own_sensor_path"])
def test_shipped_files_are_in_the_keys_of_missions_that_read_them(shipped, tmp_path, monkeypatch):
    readers = {
        "own_model_path": {("scan-only", "imaging"), ("belief", "imaging")},
        "own_sensor_path": {("scan-only", "statistical"), ("belief", "statistical"), ("belief", "imaging")},
    }
    clusters = load_scenario("clusters")

    def keys():
        missions = product(("scan-only", "belief"), ("imaging", "statistical"))
        return {
            (strategy, sensor): Matrix.of(
                [("c", change_scenario(clusters, {"search.strategy": strategy}))], [0], sensor, []
            )
            .job(0)
            .config_hash
            for strategy, sensor in missions
        }

    before = keys()
    other = tmp_path / "other"
    other.write_bytes(b"of another release")
    monkeypatch.setattr(f"skysweep.experiments.matrix.{shipped}", lambda _: other)
    after = keys()
    assert {mission for mission in before if before[mission] != after[mission]} == readers[shipped]


def test_a_failed_mission_is_a_row_and_can_be_flown_again(tmp_path, monkeypatch):
    theirs = tmp_path / "theirs"
    info = theirs / "brittle-1.0.dist-info"
    info.mkdir(parents=True)
    (theirs / "brittle.py").write_text(BRITTLE)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: brittle\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[skysweep.strategies]\nbrittle = brittle:brittle\n")
    monkeypatch.syspath_prepend(str(theirs))
    wanted = parse_spec(
        SPEC.replace("[scan-check,", "[brittle,").replace("[1, .inf]", "[1, 2]").replace(": 10\n", ": 2\n"),
        "spec.yaml",
    )
    flight = sweep(tmp_path / "out", LocalEngine(1), wanted)
    table = pl.read_parquet(tmp_path / "out" / "missions.parquet")
    failed = table.filter(pl.col("error").is_not_null())
    assert failed.select("strategy", "param.search.n_c", "seed").rows() == [
        ("brittle", 2.0, s) for s in (0, 1)
    ]
    (error,) = set(failed["error"])
    assert "step raises ZeroDivisionError: the wing fell off at brittle.py:" in error
    assert all(failed[metric].null_count() == 2 for metric in SUMMARY_COLUMNS)
    assert table["mission_time_s"].null_count() == 2
    assert flight.errors() == failed["error"].to_list()
    again = Sweep(wanted, tmp_path / "out", retry_failed=True)
    assert again.left == 2
    before = table_bytes(tmp_path / "out")
    again.fly(Here())
    assert table_bytes(tmp_path / "out") == before
    (theirs / "brittle.py").write_text(BRITTLE.replace("> 10", "> 1e9"))
    sys.modules.pop("brittle")
    with pytest.raises(UserError, match="the plan or the strategy differs"):
        sweep(tmp_path / "out", wanted=wanted, retry_failed=True)
    sweep(tmp_path / "mended", wanted=wanted)
    mended = pl.read_parquet(tmp_path / "mended" / "missions.parquet")
    assert mended["error"].null_count() == mended["mission_time_s"].count() == len(mended) == 6
    sys.modules.pop("brittle", None)


def test_results_may_live_at_a_url(whole, tmp_path):
    for url in (f"file://{tmp_path}/out", "memory://skysweep/out"):
        sweep(url, wanted=spec(seeds="1"))
        assert Sweep(spec(seeds="1"), url).left == 0
        files, root = fsspec.core.url_to_fs(url)
        names = sorted(path.rpartition("/")[2] for path in files.ls(root, detail=False))
        assert names == FILES
        table = pl.read_parquet(io.BytesIO(files.cat_file(f"{root}/missions.parquet")))
        assert table.equals(pl.read_parquet(whole / "missions.parquet").head(3))


@pytest.mark.parametrize(
    ("out", "said"),
    [
        ("nonsense://x/y", "nonsense"),
        ("/proc/none/here", "cannot be read or written"),
        ("{tmp}/file/out", "cannot be read or written"),
    ],
)
def test_where_nothing_can_be_written_nothing_is_flown(tmp_path, out, said):
    (tmp_path / "file").touch()

    def refuse(_error):
        pytest.fail("a mission was flown")

    with pytest.raises(UserError, match=said):
        Sweep(spec(), out.format(tmp=tmp_path)).fly(Here(), on_done=refuse)


def test_a_table_without_spec_and_a_damaged_part_are_said(whole, tmp_path):
    (tmp_path / "missions.parquet").write_bytes(table_bytes(whole))
    with pytest.raises(UserError, match=r"no spec\.yaml"):
        Sweep(spec(), tmp_path)
    (tmp_path / "missions.parquet").unlink()
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "broken.parquet").write_bytes(b"PAR1")
    with pytest.raises(UserError, match=r"broken\.parquet: is damaged"):
        Sweep(spec(), tmp_path)


def test_the_digests_are_those_that_sha256sum_checks(whole):
    subprocess.run(["sha256sum", "--check", "--strict", "SHA256SUMS"], cwd=whole, check=True)


def test_a_table_of_a_sweep_without_digests_is_taken_as_it_is_and_gets_them(whole, tmp_path):
    sweep(tmp_path / "out", wanted=spec(seeds="1"))
    (tmp_path / "out" / "SHA256SUMS").unlink()
    assert sweep(tmp_path / "out", wanted=spec(seeds="2")).missions == 6
    subprocess.run(["sha256sum", "--check", "--strict", "SHA256SUMS"], cwd=tmp_path / "out", check=True)


@pytest.mark.parametrize("content", ["", "\n", "0123  spec.yaml\n", f"{'0' * 64}  spec.yaml"])
def test_damaged_digests_are_said_as_what_they_are(whole, tmp_path, content):
    shutil.copytree(whole, tmp_path / "out")
    (tmp_path / "out" / "SHA256SUMS").write_text(content)
    with pytest.raises(UserError, match="SHA256SUMS: is damaged"):
        sweep(tmp_path / "out")


def test_a_mission_and_a_sweep_share_no_folder(whole, tmp_path):
    (tmp_path / "journal.jsonl").write_text("")
    with pytest.raises(UserError, match="holds a mission; write another --out"):
        sweep(tmp_path)
    with pytest.raises(UserError, match="holds the missions of a sweep"):
        refuse_other_mission(whole)


def walls(out):
    """Wall times by mission."""
    timings = pl.read_parquet(out / "timings.parquet")
    return dict(timings.select("config_hash", "wall_time_s").iter_rows())


def test_lost_timings_cost_no_mission(whole, tmp_path):
    shutil.copytree(whole, tmp_path / "out")
    (tmp_path / "out" / "timings.parquet").unlink()
    sweep(tmp_path / "out")
    assert table_bytes(tmp_path / "out") == table_bytes(whole)
    sweep(tmp_path / "out", wanted=spec(seeds="11"))
    assert sum(wall is None for wall in walls(tmp_path / "out").values()) == 30


def test_timings_stay_with_their_missions_when_a_growing_sweep_is_cut_off(tmp_path, monkeypatch):
    """A full disk between both tables: the numbers of missions are others once a value is added."""
    sweep(tmp_path / "out", wanted=spec(seeds="2"))
    before, grown = walls(tmp_path / "out"), spec(**{"seeds": "2", "search.n_c": "[1, 2, .inf]"})
    write = Folder.write

    def write_until(self, file, content):
        if file == "missions.parquet":
            raise UserError("the disk is full")
        write(self, file, content)

    monkeypatch.setattr(Folder, "write", write_until)
    with pytest.raises(UserError, match="full"):
        sweep(tmp_path / "out", wanted=grown)
    monkeypatch.undo()
    sweep(tmp_path / "out", wanted=grown)
    assert before.items() <= walls(tmp_path / "out").items()


@pytest.mark.parametrize("name", ["SHA256SUMS", "missions.parquet", "timings.parquet"])
def test_killed_while_it_writes_the_table_it_goes_on(whole, tmp_path, monkeypatch, name):
    sweep(tmp_path / "out", wanted=spec(seeds="1"))
    flight = Sweep(spec(), tmp_path / "out")

    class Killed(Exception):
        pass

    write = Folder.write

    def write_until(self, file, content):
        write(self, file, content)
        if file == name and (flight._folder.names("parts") or name == "SHA256SUMS"):
            raise Killed

    monkeypatch.setattr(Folder, "write", write_until)
    with pytest.raises(Killed):
        flight.fly(Here())
    monkeypatch.undo()
    sweep(tmp_path / "out")
    assert table_bytes(tmp_path / "out") == table_bytes(whole)
    subprocess.run(["sha256sum", "--check", "--strict", "SHA256SUMS"], cwd=tmp_path / "out", check=True)


def test_it_asks_with_an_estimate_before_anything_is_written(tmp_path):
    estimates = []

    def refuse(estimate):
        estimates.append(estimate)
        raise UserError("no")

    with pytest.raises(UserError, match="no"):
        Sweep(spec(), tmp_path / "out").fly(Here(), refuse)
    assert estimates[0].missions == 30 - 16
    assert estimates[0].workers == 1
    assert 0.01 < estimates[0].mission_s < 60
    assert not (tmp_path / "out").exists()
    assert Outlook(7200, 2, 3.0).seconds == 10_800


def test_stopped_before_the_estimate_it_keeps_what_was_flown(tmp_path):
    flown = []

    def stop(error):
        flown.append(error)
        if len(flown) == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        Sweep(spec(), tmp_path / "out").fly(Here(), on_done=stop)
    assert Sweep(spec(), tmp_path / "out").left == 30 - 3


@pytest.mark.parametrize(
    ("sensor", "change", "said"),
    [
        ("statistical", "detector.confidence_min: [0.05]", r"confidence_min is 0\.05, below 0\.1"),
        ("statistical", "detector.model: [gone.onnx]", r"gone\.onnx: there is no such model file"),
        (
            "statistical",
            "search.scan_altitude_agl_m: [30, 110]",
            r"^search: the sensor model was calibrated for 4 to 220 pixels on target, not 1.68 and .* it "
            r"reports nothing of fewer than 3\.2 pixels; write another altitude of search, or "
            r"another camera$",
        ),
        ("statistical", "camera.gimbal.pitch_deg: [-30]", "for 0 to 50 degrees off the vertical, not 60"),
        ("imaging", "detector.model: [gone.onnx]", r"gone\.onnx: there is no such model file"),
    ],
)
def test_what_no_sensor_can_see_with_is_refused_before_anything_flies(tmp_path, sensor, change, said):
    text = SPEC.replace("search.n_c: [1, .inf]", change) + f"sensor: {sensor}\n"
    with pytest.raises(UserError, match=said):
        Sweep(parse_spec(text, "spec.yaml"), tmp_path / "out").fly(Here())
    assert not (tmp_path / "out").exists()


def command(*arguments):
    from typer.testing import CliRunner

    from skysweep.cli import app

    return CliRunner().invoke(app, [str(a) for a in arguments])


def test_results_that_would_not_last_are_refused(tmp_path):
    (tmp_path / "small.yaml").write_text(SPEC)
    result = command("sweep", tmp_path / "small.yaml", "--out", "memory://lost")
    assert result.exit_code == 2
    assert "--out memory://lost: is lost" in result.stderr


def test_at_a_file_url_the_report_lies_beside_the_table(whole):
    result = command("report", f"file://{whole}")
    assert result.exit_code == 0, result.stderr
    assert (whole / "report" / "report.html").exists()


def test_when_every_mission_fails_so_does_the_command(tmp_path, monkeypatch):
    def fail(_job):
        raise UserError("no")

    import skysweep.experiments.engines
    import skysweep.experiments.sweep.run

    monkeypatch.setattr(skysweep.experiments.sweep.run, "fly_in_memory", lambda *_: fail(None))
    monkeypatch.setattr(skysweep.experiments.engines, "make_engine", lambda *_: Here())
    (tmp_path / "small.yaml").write_text(SPEC.replace("seeds: 10", "seeds: 1"))
    result = command("sweep", tmp_path / "small.yaml", "--out", tmp_path / "out")
    assert result.exit_code == 1
    assert "3 of 3 missions failed: no" in result.stderr
    assert (tmp_path / "out" / "missions.parquet").exists()


@pytest.mark.parametrize(("option", "code", "said"), [([], 2, "add --yes"), (["--yes"], 0, "table: ")])
def test_a_long_sweep_needs_yes(tmp_path, option, code, said, monkeypatch):
    from typer.testing import CliRunner

    import skysweep.cli.sweep
    from skysweep.cli import app

    monkeypatch.setattr(skysweep.cli.sweep, "ASK_ABOVE_S", 0.0)
    (tmp_path / "small.yaml").write_text(SPEC.replace("seeds: 10", "seeds: 6"))
    command = ["sweep", str(tmp_path / "small.yaml"), "--out", str(tmp_path / "out"), *option]
    result = CliRunner().invoke(app, command)
    assert result.exit_code == code, result.stderr
    assert "3 configurations x 6 seeds = 18 missions" in result.stderr
    assert said in result.stderr
    assert (tmp_path / "out" / "missions.parquet").exists() == (code == 0)


def test_options_that_do_not_go_together():
    for options, said in [
        (("cloud",), "local, ray"),
        (("local", "auto"), "--engine ray"),
        (("ray", "auto", 3), "--workers"),
    ]:
        with pytest.raises(UserError, match=said):
            make_engine(*options)


def test_ray_that_is_not_installed_is_an_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(UserError, match=r"install it with  tools/setup\.sh ray"):
        make_engine("ray")


def test_a_worker_that_is_killed_ends_the_sweep_with_a_sentence():
    with pytest.raises(UserError, match="give the same command again"):
        list(LocalEngine(1).run(os._exit, [1]))


def test_the_same_seed_is_the_same_world_and_noise_for_every_strategy_and_parameter():
    """Common random numbers: neither strategy nor parameters shift a random stream."""
    wanted = spec(**{"search.n_c": "[1, .inf]\n  search.scan_altitude_agl_m: [8, 14]"})
    jobs = [j for j in matrix_of(wanted).jobs(range(10)) if j.seed == 0]
    assert len(jobs) == 5
    worlds = [[(*o.position_enu_m, o.variant) for o in _world(j).objects] for j in jobs]
    assert all(world == worlds[0] for world in worlds)
    noises = [_noise(j) for j in jobs]
    common = set.intersection(*(set(noise) for noise in noises))
    assert max(common) > 20.0
    for time_s in common:
        assert len({noise[time_s] for noise in noises}) == 1


def _world(job):
    return build_world(job.scenario, job.seed)


def _noise(job):
    """Time -> GNSS error and the state of the stream behind gusts and errors, of a whole mission."""
    mission = build_mission(job.scenario, job.seed, Rig(job.sensor))
    seen = {}

    def watch(state, _mode, _new):
        snapshot = mission.vehicle.snapshot()
        at = dynamics.STATE.fields["position_error"][1] // 8
        seen[round(state.time_s, 3)] = json.dumps([snapshot["random"], snapshot["state"][at : at + 3]])

    fly(mission, MemoryJournal(), watch)
    return seen


def test_while_one_sweep_flies_another_into_its_folder_is_refused(tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    with locked(out), pytest.raises(UserError, match="another skysweep is writing it"):
        Sweep(spec(seeds="1"), out).fly(LocalEngine(1))
    late = Sweep(spec(seeds="1"), out)
    Sweep(spec(seeds="2"), out).fly(LocalEngine(1))
    with pytest.raises(UserError, match="holds the results of another sweep"):
        late.fly(LocalEngine(1))
    assert Sweep(spec(seeds="2"), out).left == 0
