"""A mission that is killed at any of its lines ends as if nothing had happened."""

import fcntl
import json
import os
import re
import shutil
import signal
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest
import typer
import yaml
from typer.testing import CliRunner

import skysweep
from skysweep.cli import app
from skysweep.cli.missions import flying
from skysweep.errors import UserError
from skysweep.files.line_file import LineFile
from skysweep.flights.fly import fly_to_folder
from skysweep.flights.resume import begun_scenario, resume_folder
from skysweep.flights.rig import Rig
from skysweep.mission.journal import FileJournal, read_journal
from skysweep.planning.flight_plan import plan_scenario
from skysweep.planning.qgc import plan_for_qgc, write_plan
from skysweep.results.run_folder import load_run
from skysweep.scenarios.files import change_scenario
from skysweep.scenarios.model import Scenario

SHORT = {
    "name": "short",
    "area": {"polygon_enu_m": [[0, 0], [8, 0], [8, 6], [0, 6]]},
    "home": {"position_enu_m": [-12, -3]},
    "targets": [{"class": "stop sign", "position_enu_m": [4, 3], "size_m": 0.9}],
    "camera": {"hfov_rad": 1.2},
    "search": {"n_c": 1, "scan_altitude_agl_m": 8},
}
RESULTS = ("journal.jsonl", "config.yaml", "targets.geojson", "targets.csv", "map.png")
WALL = ("wall_time_s", "real_time_factor", "crc")  # the last one is of the others


def fly_short(folder, sensor="statistical", **people):
    return fly_to_folder(Scenario.model_validate(SHORT), 2, folder, Rig(sensor, **people))


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The folder of the mission that nobody breaks off."""
    folder = tmp_path_factory.mktemp("whole") / "run"
    fly_short(folder)
    return folder


def killed_after(n_lines, work, *args):
    """Work in a process of its own that kills itself, as by kill -9, when it has written ``n_lines``."""
    child = os.fork()
    if child == 0:
        write, written = FileJournal.write, 0

        def write_and_die(self, *args, **fields):
            nonlocal written
            write(self, *args, **fields)
            written += 1
            if written == n_lines:
                os.kill(os.getpid(), signal.SIGKILL)

        FileJournal.write = write_and_die
        work(*args)
        os._exit(0)
    _, status = os.waitpid(child, 0)
    assert os.WIFSIGNALED(status), "it was over before it was killed"
    assert os.WTERMSIG(status) == signal.SIGKILL


def summary_of(folder):
    summary = json.loads((folder / "summary.json").read_text())
    return {key: value for key, value in summary.items() if key not in WALL}


def assert_same(folder, whole, results=RESULTS):
    assert summary_of(folder) == summary_of(whole)
    for name in results:
        assert (folder / name).read_bytes() == (whole / name).read_bytes(), name


def cut(whole, folder, n_lines):
    """A copy of the mission as a kill after ``n_lines`` leaves it."""
    folder.mkdir()
    shutil.copy(whole / "config.yaml", folder)
    lines = (whole / "journal.jsonl").read_bytes().splitlines(keepends=True)
    (folder / "journal.jsonl").write_bytes(b"".join(lines[:n_lines]))
    return folder


def test_killed_at_every_line_it_ends_the_same(whole, tmp_path, monkeypatch):
    """The journal decides everything else; the whole results are compared in the next test."""
    monkeypatch.setattr("skysweep.flights.resume.finish", lambda *_: {})
    expected = (whole / "journal.jsonl").read_bytes()
    n_lines = expected.count(b"\n")
    assert n_lines > 60
    for k in range(1, n_lines):
        folder = tmp_path / f"killed-{k}"
        killed_after(k, fly_short, folder)
        assert (folder / "journal.jsonl").read_bytes() == b"".join(expected.splitlines(keepends=True)[:k])
        resume_folder(folder)
        assert (folder / "journal.jsonl").read_bytes() == expected, f"killed at line {k}"


def test_results_are_those_of_the_mission_that_nobody_broke_off(whole, tmp_path):
    killed_after(30, fly_short, tmp_path / "run")
    resume_folder(tmp_path / "run")
    assert_same(tmp_path / "run", whole)


def test_it_can_be_resumed_again_and_again(whole, tmp_path):
    folder = tmp_path / "run"
    killed_after(20, fly_short, folder)
    for n_lines in (15, 25):
        killed_after(n_lines, resume_folder, folder)
    assert len(read_journal(folder / "journal.jsonl")) == 60
    resume_folder(folder)
    assert_same(folder, whole)


def test_killed_while_it_wrote_results_it_writes_them(whole, tmp_path):
    folder = tmp_path / "run"
    shutil.copytree(whole, folder)
    (folder / "summary.json").unlink()
    (folder / "map.png").unlink()
    resume_folder(folder)
    assert_same(folder, whole)


def test_a_complete_mission_is_left_alone(whole, tmp_path):
    folder = tmp_path / "run"
    shutil.copytree(whole, folder)
    before = {path: path.stat().st_mtime_ns for path in folder.iterdir()}
    written = json.loads((whole / "summary.json").read_text())
    assert written | resume_folder(folder) == written
    assert {path: path.stat().st_mtime_ns for path in folder.iterdir()} == before


def test_a_torn_line_is_written_again(whole, tmp_path):
    folder = cut(whole, tmp_path / "run", 25)
    with (folder / "journal.jsonl").open("ab") as journal:
        journal.write(b'{"t": 3.5, "kind": "sta')
    resume_folder(folder)
    assert_same(folder, whole)


def test_a_damaged_journal_goes_on_from_its_sound_lines(whole, tmp_path):
    folder = cut(whole, tmp_path / "run", 40)
    journal = folder / "journal.jsonl"
    damaged = journal.read_bytes().replace(b'"kind": "plan"', b'"kind": "plam"')
    journal.write_bytes(damaged)
    with pytest.raises(UserError, match=r"line 3 is damaged, 2 before it are sound; .*--from-sound-lines"):
        resume_folder(folder)
    assert journal.read_bytes() == damaged
    resume_folder(folder, from_sound_lines=True)
    assert_same(folder, whole)
    assert (folder / "journal.jsonl.damaged").read_bytes() == damaged


def test_what_the_operator_said_after_the_damage_is_told(whole, tmp_path):
    folder, told = cut(whole, tmp_path / "run", 40), []
    order = b'{"t": 30.0, "kind": "operator", "word": "reject", "candidate": 4, "chain": "00000000"}\n'
    journal = folder / "journal.jsonl"
    journal.write_bytes(journal.read_bytes().replace(b'"kind": "plan"', b'"kind": "plam"') + order)
    resume_folder(folder, Rig(say=told.append), from_sound_lines=True)
    assert [
        line for line in told if "what the operator said after it is left out: reject 4; say it again" in line
    ]


def test_a_damaged_first_line_is_not_taken_for_a_flight_that_never_began(whole, tmp_path):
    folder = cut(whole, tmp_path / "run", 40)
    journal = folder / "journal.jsonl"
    damaged = journal.read_bytes().replace(b'"kind": "setup"', b'"kind": "setuq"')
    journal.write_bytes(damaged)
    with pytest.raises(UserError, match="line 1 is damaged, without which the flight cannot be gone on with"):
        resume_folder(folder, from_sound_lines=True)
    assert journal.read_bytes() == damaged


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"version": "0.0.9"}, r"begun by skysweep 0\.0\.9, and this is .*; install that one to resume it"),
        ({"model": "another"}, r"begun with model another, and now it is [0-9a-f]{64}; put back what it was"),
        ({"seed": 3}, r"flown again, the mission differs in line \d+"),
    ],
)
def test_what_differs_from_the_begun_mission_is_refused(whole, tmp_path, change, told):
    folder = cut(whole, tmp_path / "run", 60)
    journal = folder / "journal.jsonl"
    first, *rest = read_journal(journal)
    journal.unlink()
    with closing(FileJournal(journal)) as again:
        for line in [first | change, *rest]:
            again.write(line.pop("t"), line.pop("kind"), **line)
    content = journal.read_bytes()
    with pytest.raises(UserError, match=told):
        resume_folder(folder)
    assert journal.read_bytes() == content


def test_another_scenario_in_the_folder_is_refused(whole, tmp_path):
    folder = cut(whole, tmp_path / "run", 60)
    config = yaml.safe_load((folder / "config.yaml").read_text())
    config["search"]["scan_altitude_agl_m"] += 0.5
    (folder / "config.yaml").write_text(yaml.safe_dump(config))
    for read in (resume_folder, load_run, begun_scenario):
        with pytest.raises(UserError, match=r"config\.yaml: is not the file that the mission began with"):
            read(folder)


def test_a_plan_or_sensor_file_that_was_changed_is_refused(tmp_path):
    scenario = Scenario.model_validate(SHORT)
    plan = write_plan(tmp_path / "field.plan", plan_for_qgc(scenario, plan_scenario(scenario)[0]))
    sensor = tmp_path / "sensor.yaml"
    sensor.write_text((Path(skysweep.__file__).parent / "sensing/statistical/visible.yaml").read_text())
    files = {"search.plan": str(plan), "detector.statistical_model": str(sensor)}
    whole = tmp_path / "whole"
    summary = fly_to_folder(change_scenario(scenario, files), 2, whole, Rig("statistical"))
    folder = cut(whole, tmp_path / "run", 60)
    journal = (folder / "journal.jsonl").read_bytes()

    text = sensor.read_text()
    sensor.write_text(re.sub(r"^fade_scale: .*$", "fade_scale: 9.0", text, flags=re.M))
    with pytest.raises(UserError, match=r"begun with model [0-9a-f]{64}, and now it is [0-9a-f]{64}"):
        resume_folder(folder)
    sensor.write_text(text)

    drawn = plan.read_text()
    plan.write_text(drawn.replace('"hoverSpeed": 5.0', '"hoverSpeed": 4.0'))
    for go_on in (resume_folder, begun_scenario):
        with pytest.raises(UserError, match=r"field\.plan: is not the plan that the mission was begun with"):
            go_on(folder)
    assert (folder / "journal.jsonl").read_bytes() == journal
    told = CliRunner().invoke(app, ["report", str(whole), "--out", str(tmp_path / "out")])
    assert "field.plan: is missing, or not the plan that was flown" in told.stderr
    without = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert without["scan_only_time_s"] is None
    assert without["mission_time_s"] == summary["mission_time_s"]

    plan.write_text(drawn)
    assert resume_folder(folder)["scan_only_time_s"] == summary["scan_only_time_s"] > 0.0
    assert_same(folder, whole)


def test_the_folder_of_a_simulated_mission_connects_no_vehicle(whole, tmp_path):
    folder = cut(whole, tmp_path / "run", 60)
    with pytest.raises(UserError, match="the mission was simulated; resume it with  skysweep resume"):
        begun_scenario(folder)


@pytest.mark.parametrize(
    ("number", "change"),
    [
        (1, {"threads": None}),
        (1, {"replays": "perhaps"}),
        (5, {"t": [1.0]}),
        (5, {"kind": "look", "confidences": [0.5]}),
        (5, {"kind": "snapshot", "strategy": 3}),
    ],
)
def test_a_sealed_line_that_no_mission_writes_is_refused(whole, tmp_path, number, change):
    folder = cut(whole, tmp_path / "run", 0)
    lines = read_journal(whole / "journal.jsonl")[:40]
    lines[number - 1] |= change
    (folder / "journal.jsonl").unlink()
    with closing(LineFile(folder / "journal.jsonl", "")) as file:
        for line in lines:
            file.append(line, sync=False)
    for go_on in (resume_folder, begun_scenario):
        with pytest.raises(UserError, match=rf"journal\.jsonl: line {number} was not written by a mission"):
            go_on(folder)


def test_a_journal_with_a_line_missing_doubled_or_elsewhere_is_refused(whole, tmp_path):
    folder = copied(whole, tmp_path / "run")
    (folder / "summary.json").unlink()
    lines = (whole / "journal.jsonl").read_bytes().splitlines(keepends=True)
    n = len(lines)
    orders = [[*range(k), *range(k + 1, n)] for k in range(n - 1)]
    orders += [[*range(k + 1), *range(k, n)] for k in range(n)]
    orders += [[*range(k), k + 1, k, *range(k + 2, n)] for k in range(n - 1)]
    for order in orders:
        content = b"".join(lines[k] for k in order)
        (folder / "journal.jsonl").write_bytes(content)
        for read in (load_run, resume_folder):
            with pytest.raises(UserError, match=r"line \d+ is damaged"):
                read(folder)
        assert (folder / "journal.jsonl").read_bytes() == content


@pytest.mark.parametrize("n_left", [-1, 30])
def test_a_journal_that_lost_its_end_does_not_agree_with_the_summary(whole, tmp_path, n_left):
    folder = copied(whole, tmp_path / "run")
    lines = (whole / "journal.jsonl").read_bytes().splitlines(keepends=True)
    (folder / "journal.jsonl").write_bytes(b"".join(lines[:n_left]))
    for read in (load_run, resume_folder):
        with pytest.raises(
            UserError, match=r"\d+ sound lines, but summary\.json was made from others; .*--from"
        ):
            read(folder)
    assert load_run(folder, from_sound_lines=True).left_out == ("summary.json with the wall time",)
    resume_folder(folder, from_sound_lines=True)
    assert_same(folder, whole)


def test_a_summary_that_says_nothing_is_not_that_of_a_complete_mission(whole, tmp_path):
    folder = copied(whole, tmp_path / "run")
    (folder / "summary.json").write_text("{}")
    with pytest.raises(
        UserError, match=r"summary\.json: is damaged; delete it, and 'skysweep report .*' writes"
    ):
        resume_folder(folder)
    (folder / "summary.json").unlink()
    resume_folder(folder)
    assert_same(folder, whole)


@pytest.mark.parametrize("fly", [fly_short, resume_folder, load_run])
def test_nothing_is_written_through_a_link_out_of_the_folder(whole, tmp_path, fly):
    theirs = tmp_path / "passwd"
    for name in ("journal.jsonl", "summary.json", "map.png"):
        folder = cut(whole, tmp_path / f"run-{name}", 10)
        theirs.write_text("root:x:0:0")
        (folder / name).unlink(missing_ok=True)
        (folder / name).symlink_to(theirs)
        with pytest.raises(UserError, match="is a link; put the file itself there, or delete it"):
            fly(folder)
        assert theirs.read_text() == "root:x:0:0"


def test_an_older_folder_is_reported_on_and_not_gone_on_with(whole, tmp_path):
    """Of a skysweep that did not chain lines and kept no digest of the configuration."""
    folder = cut(whole, tmp_path / "run", 0)
    lines = read_journal(whole / "journal.jsonl")
    del lines[0]["config"]
    (folder / "journal.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines[:40]))
    assert len(load_run(folder).records) == 40
    with pytest.raises(UserError, match=r"begun by an older skysweep .*; install that one to resume it"):
        resume_folder(folder)


def copied(whole, folder):
    shutil.copytree(whole, folder)
    return folder


def test_a_mission_that_still_flies_is_refused(whole, tmp_path):
    folder = cut(whole, tmp_path / "run", 10)
    flyer = subprocess.Popen(
        [sys.executable, "-c", "import fcntl, sys, time\n"
         "file = open(sys.argv[1], 'ab'); fcntl.flock(file, fcntl.LOCK_EX); print('flies', flush=True)\n"
         "time.sleep(60)", folder / "journal.jsonl"],
        stdout=subprocess.PIPE,
        text=True,
    )  # fmt: skip
    try:
        assert flyer.stdout.readline() == "flies\n"
        with pytest.raises(UserError, match="another skysweep is writing it; wait"):
            resume_folder(folder)
    finally:
        flyer.kill()
        flyer.communicate()
    resume_folder(folder)
    assert_same(folder, whole)


def test_a_mission_keeps_others_away_while_it_flies(tmp_path):
    def try_to_write(_state, _mode, _new):
        with (tmp_path / "run" / "journal.jsonl").open("ab") as file, pytest.raises(BlockingIOError):
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        raise InterruptedError

    with pytest.raises(InterruptedError):
        fly_short(tmp_path / "run", watch=try_to_write)


@pytest.mark.parametrize("journal", [None, b"", b'{"t": 0.0, "kind": "set'])
def test_a_folder_where_nothing_was_begun_says_how_to_fly_it(whole, tmp_path, journal):
    shutil.copy(whole / "config.yaml", tmp_path)
    if journal is not None:
        (tmp_path / "journal.jsonl").write_bytes(journal)
    with pytest.raises(
        UserError, match=r"broken off before take-off; fly it with  skysweep run .*config\.yaml"
    ):
        resume_folder(tmp_path)
    fly_short(tmp_path)
    assert_same(tmp_path, whole)


def test_no_run_folder_is_said(tmp_path):
    with pytest.raises(UserError, match=r"has no config\.yaml; give a folder that 'skysweep run' wrote"):
        resume_folder(tmp_path)


def test_flying_into_a_begun_folder_names_the_command_that_goes_on(whole, tmp_path):
    folder = cut(whole, tmp_path / "my run", 10)
    with pytest.raises(UserError, match=r"resume it with  skysweep resume '.*my run'"):
        fly_short(folder)


def test_on_a_full_disk_it_comes_home_and_goes_on_when_there_is_room(whole, tmp_path):
    """A limit on the size of files is what a full disk looks like to one process."""
    folder = tmp_path / "run"
    program = f"""
import json, resource, signal, sys
sys.path.insert(0, {str(Path(__file__).parent)!r})
from pathlib import Path
from skysweep.cli.missions import flying
from skysweep.errors import UserError
from test_resume import fly_short
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
states, full = [], []
def watch(state, mode, new):
    states.append((mode, state.position_enu_m[:2].tolist()))
    if mode == "SCAN" and state.position_enu_m[0] > -8 and not full:
        full.append((Path(sys.argv[1]) / "journal.jsonl").stat().st_size + 20)
        resource.setrlimit(resource.RLIMIT_FSIZE, (full[0], full[0]))
try:
    fly_short(Path(sys.argv[1]), watch=watch)
except UserError as error:
    print(json.dumps([str(error), list(dict.fromkeys(mode for mode, *_ in states)), states[-1][1]]))
"""
    run = subprocess.run([sys.executable, "-c", program, folder], capture_output=True, text=True, check=True)
    told, modes, xy = json.loads(run.stdout)
    journal = folder / "journal.jsonl"
    assert told == (
        f"{journal}: nothing more can be written (File too large); what it holds is sound, and the vehicle "
        f"has come home; make room, then  skysweep resume {folder}  continues"
    )
    assert modes == ["TAKEOFF", "SCAN", "RETURN", "LAND"]
    assert abs(xy[0] + 12) < 2.0
    assert abs(xy[1] + 3) < 2.0
    before = (whole / "journal.jsonl").read_bytes()
    assert before.startswith(journal.read_bytes())
    assert before != journal.read_bytes()
    resume_folder(folder)
    assert_same(folder, whole)


def test_where_not_even_the_first_line_can_be_written_nothing_is_flown(tmp_path):
    """``resume`` would have nothing to go on with, so it is not advised."""
    folder = tmp_path / "run"
    program = f"""
import resource, signal, sys
sys.path.insert(0, {str(Path(__file__).parent)!r})
from pathlib import Path
from skysweep.cli.missions import flying
from skysweep.errors import UserError
from skysweep.mission.journal import FileJournal
from test_resume import fly_short
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
write = FileJournal.write
def on_a_full_disk(self, *args, **fields):
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, resource.RLIM_INFINITY))
    write(self, *args, **fields)
    resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
FileJournal.write = on_a_full_disk
try:
    fly_short(Path(sys.argv[1]), watch=lambda *_: print("flies"))
except UserError as error:
    print(error)
"""
    run = subprocess.run([sys.executable, "-c", program, folder], capture_output=True, text=True, check=True)
    assert run.stdout == (
        f"{folder / 'journal.jsonl'}: nothing more can be written (File too large); what it holds is sound, "
        "and nothing was flown; make room, then give the same command again\n"
    )
    fly_short(folder)
    assert read_journal(folder / "journal.jsonl")[-1]["kind"] == "end"


def test_ctrl_c_says_the_command_that_goes_on(tmp_path):
    scenario = tmp_path / "short.yaml"
    scenario.write_text(yaml.safe_dump(SHORT | {"name": "short"}))
    run = subprocess.Popen(
        [sys.executable, "-m", "skysweep.cli", "run", scenario, "--sensor", "statistical", "--out",
         tmp_path / "my run", "--set", "vehicle.cruise_speed_mps=0.3"],
        stderr=subprocess.PIPE,
        text=True,
    )  # fmt: skip
    journal = tmp_path / "my run" / "journal.jsonl"
    while run.poll() is None and not (journal.exists() and journal.read_bytes().count(b"\n") > 8):
        pass
    run.send_signal(signal.SIGINT)
    _, told = run.communicate(timeout=60)
    assert run.returncode == 130
    assert f"stopped; go on with:  skysweep resume '{tmp_path / 'my run'}'" in told


@pytest.mark.slow
@pytest.mark.parametrize(
    "share", [0.3, *(pytest.param(share, marks=pytest.mark.exhaustive) for share in (0.0, 0.6, 1.0))]
)
def test_with_pictures_it_ends_the_same_too(pictured, tmp_path, share):
    lines = read_journal(pictured / "journal.jsonl")
    seen = [k for k, line in enumerate(lines, start=1) if line["kind"] == "look" and line["confidences"]]
    flown_in_fresh_process_until_killed(tmp_path / "run", seen[round(share * (len(seen) - 1))])
    resume_folder(tmp_path / "run")
    assert_same(tmp_path / "run", pictured)
    names = sorted(path.name for path in (pictured / "pictures").iterdir())
    assert sorted(path.name for path in (tmp_path / "run" / "pictures").iterdir()) == names
    for name in names:
        assert_same(tmp_path / "run", pictured, [Path("pictures") / name])


@pytest.fixture(scope="module")
def pictured(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pictured") / "run"
    fly_short(folder, "imaging")
    return folder


def flown_in_fresh_process_until_killed(folder, n_lines):
    """OpenGL and ONNX Runtime have threads, so that a forked process cannot use them."""
    program = f"""
import sys
sys.path.insert(0, {str(Path(__file__).parent)!r})
from pathlib import Path
from test_resume import fly_short, killed_after
killed_after({n_lines}, fly_short, Path(sys.argv[1]), "imaging")
"""
    subprocess.run([sys.executable, "-c", program, folder], check=True)


def test_ctrl_c_before_anything_was_flown_advises_nothing(tmp_path, capfd):
    with pytest.raises(typer.Exit), flying("short", tmp_path / "run"):
        raise KeyboardInterrupt
    assert "stopped; nothing was flown" in capfd.readouterr().err


@pytest.mark.parametrize("line", ['{"t": 1.0}', "{}"])
def test_a_journal_without_checksums_that_says_nothing_is_refused(line, whole, tmp_path):
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / "config.yaml").write_bytes((whole / "config.yaml").read_bytes())
    (folder / "journal.jsonl").write_text(f"{line}\n")
    with pytest.raises(UserError, match="an older skysweep"):
        resume_folder(folder)
    assert (folder / "journal.jsonl").read_text() == f"{line}\n"
