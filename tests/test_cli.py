"""The command line as a user meets it: processes, exit codes, one clear sentence for bad input."""

import json
import shutil

import pytest
import yaml

from skysweep.detection.model_files import own_model_path
from warm import run_skysweep as skysweep

GOOD = """\
name: test
area:
  polygon_enu_m: [[0, 0], [60, 0], [60, 40], [0, 40]]
home:
  position_enu_m: [-5, -5]
camera: {hfov_rad: 1.2}
targets:
  - {class: stop sign, position_enu_m: [20, 20], size_m: 0.9}
"""


def refused(result, *words):
    assert result.returncode == 2, result.stderr
    assert "Traceback" not in result.stderr
    for word in words:
        assert word in result.stderr, result.stderr


@pytest.fixture
def scenario(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text(GOOD)
    return path


def test_run_says_its_finds_as_plain_lines(tmp_path, scenario):
    result = skysweep("run", scenario, "--sensor", "statistical", "--out", "out", cwd=tmp_path)
    found = [line for line in result.stderr.splitlines() if line.startswith("found stop sign 1 at ")]
    assert len(found) == 1
    assert "after take-off" in found[0]
    assert "\N{ESCAPE}" not in result.stderr
    assert "found" not in result.stdout


@pytest.mark.parametrize("words", [["--out", ""], ["--out="]])
def test_an_empty_word_is_no_folder(tmp_path, words):
    """As ``--out "$OUT"`` gives where the variable is not set."""
    refused(skysweep("run", "clusters", *words, cwd=tmp_path), "--out", "empty")
    assert not list(tmp_path.iterdir())


def test_run_writes_the_whole_run_folder(tmp_path, scenario):
    out = tmp_path / "run"
    result = skysweep("run", scenario, "--sensor", "statistical", "--seed", 3, "--out", out, cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert {p.name for p in out.iterdir()} >= {
        "config.yaml",
        "journal.jsonl",
        "foxglove-layout.json",
        "mission.mcap",
        "summary.json",
        "targets.geojson",
        "targets.kml",
        "targets.gpx",
        "targets.csv",
        "map.png",
        "report.html",
    }
    summary = json.loads((out / "summary.json").read_text())
    wanted = (
        "scenario strategy seed mission_time_s scan_only_time_s n_targets n_confirmed recall false_scans "
        "false_positives path_length_m vertical_m energy_wh area_covered wall_time_s real_time_factor"
    )
    assert set(wanted.split()) <= set(summary)
    assert (summary["scenario"], summary["seed"], summary["recall"]) == ("test", 3, 1.0)
    again = skysweep("run", scenario, "--sensor", "statistical", "--out", out, cwd=tmp_path)
    refused(again, "already holds a mission", "--out")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("[60, 0], [60, 40]", "[60, 40], [60, 0]", ["area", "not simple"]),
        ("[[0, 0], [60, 0], [60, 40], [0, 40]]", "[]", ["area", "3 corners"]),
        ("[60, 40]", "[9000000, 9000000]", ["area", "km2"]),
        ("[60, 40]", "[60, .nan]", ["mine.yaml", "area.polygon_enu_m"]),
        ("class: stop sign", "class: unicorn", ["mine.yaml", "class", "stop sign"]),
        (
            "name: test",
            "name: test\nsearch: {check_altitude_agl_m: 40}",
            ["check_altitude_agl_m", "less than"],
        ),
        ("name: test", "name: !!python/object:os.system test", ["mine.yaml"]),
        ("name: test", "nmae: test", ["mine.yaml", "nmae", "name"]),
        (
            "name: test",
            "name: test\ngeofence_enu_m: [[0, 0], [60, 0], [60, 40], [0, 40]]",
            ["home", "geofence_enu_m"],
        ),
    ],
)
def test_bad_scenarios_are_refused_before_anything_is_written(tmp_path, scenario, old, new, words):
    scenario.write_text(GOOD.replace(old, new))
    result = skysweep("run", "mine.yaml", "--sensor", "statistical", cwd=tmp_path)
    refused(result, *words)
    assert [p.name for p in tmp_path.iterdir()] == ["mine.yaml"]


def test_too_high_to_see_is_a_warning_with_the_pixels(tmp_path, scenario):
    scenario.write_text(GOOD + "search: {scan_altitude_agl_m: 90}\n")
    result = skysweep("scenarios", "validate", "mine.yaml", cwd=tmp_path)
    assert result.returncode == 0
    assert "warning" in result.stdout
    assert "pixels" in result.stdout


@pytest.mark.parametrize("content", [None, b"not a network"])
def test_a_missing_or_broken_model_is_one_sentence(tmp_path, scenario, content):
    if content is not None:
        (tmp_path / "mine.onnx").write_bytes(content)
    scenario.write_text(GOOD + "detector: {model: mine.onnx}\n")
    result = skysweep("run", "mine.yaml", cwd=tmp_path)
    refused(result, "mine.onnx")
    assert not (tmp_path / "runs").exists()


def test_unknown_scenario_names_those_there_are(tmp_path):
    refused(skysweep("run", "clutsers", cwd=tmp_path), "clusters")


def test_numbers_may_be_infinite_but_not_nonsense(tmp_path):
    result = skysweep("run", "clusters", "--n-c", "many", cwd=tmp_path)
    assert result.returncode == 2
    assert "inf" in result.stderr


def test_a_camera_for_a_sensor_without_pictures_is_refused(tmp_path, scenario):
    result = skysweep("run", scenario, "--sensor", "statistical", "--camera", "gazebo", cwd=tmp_path)
    refused(result, "--camera gazebo", "takes no pictures")
    assert not (tmp_path / "runs").exists()


def test_a_run_takes_the_detector_of_a_file(tmp_path, scenario):
    shutil.copy(own_model_path(), tmp_path / "mine.onnx")
    arguments = ("--sensor", "statistical", "--set", "detector.model=gone.onnx", "--out", "r")
    result = skysweep("run", scenario, "--detector", "mine.onnx", *arguments, cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    flown = yaml.safe_load((tmp_path / "r" / "config.yaml").read_text())
    assert flown["detector"]["model"] == str(tmp_path / "mine.onnx")
    gone = skysweep("run", scenario, "--detector", "gone.onnx", cwd=tmp_path)
    refused(gone, "gone.onnx: there is no such model file")
    unknown = skysweep("run", scenario, "--detector", "yolo", cwd=tmp_path)
    refused(unknown, "--detector yolo: write scenario, skysweep, skysweep-thermal, FILE.onnx, or ros:/TOPIC")


def test_any_field_can_be_set(tmp_path, scenario):
    changes = ("--set", "search.n_c=.inf", "--set", "wind.mean_speed_mps=0")
    result = skysweep("run", scenario, "--sensor", "statistical", *changes, "--out", "r", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert json.loads((tmp_path / "r" / "summary.json").read_text())["n_c"] == "inf"
    unfenced = ("--sensor", "statistical", "--set", "safety.fence_margin_m=null")
    assert skysweep("run", scenario, *unfenced, "--out", "u", cwd=tmp_path).returncode == 0
    assert "fence_margin_m: null" in (tmp_path / "u" / "config.yaml").read_text()
    for text, word in (("search.nc=3", "n_c"), ("serach.n_c=3", "serach"), ("search.n_c", "FIELD=VALUE")):
        refused(skysweep("run", scenario, "--sensor", "statistical", "--set", text, cwd=tmp_path), word)


def test_plan_writes_a_plan_and_a_picture(tmp_path):
    result = skysweep("plan", "clusters", "--out", "p", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert {p.name for p in (tmp_path / "p").iterdir()} == {"clusters.plan", "clusters.png"}
    assert "batteries" in result.stdout


def test_a_truncated_plan_and_an_entity_bomb_are_refused(tmp_path):
    (tmp_path / "cut.plan").write_text('{"fileType": "Plan", "mission": {"items": [')
    refused(skysweep("plan", "cut.plan", cwd=tmp_path), "cut.plan")
    bomb = '<?xml version="1.0"?><!DOCTYPE k [<!ENTITY a "aa"><!ENTITY b "&a;&a;">]><kml>&b;</kml>'
    (tmp_path / "bomb.kml").write_text(bomb)
    refused(skysweep("plan", "bomb.kml", cwd=tmp_path), "bomb.kml")
    assert not (tmp_path / "plan").exists()


def test_shown_scenarios_can_be_read_again(tmp_path):
    shown = skysweep("scenarios", "show", "sparse", cwd=tmp_path)
    (tmp_path / "copy.yaml").write_text(shown.stdout)
    again = skysweep("scenarios", "show", "copy.yaml", cwd=tmp_path)
    assert again.stdout == shown.stdout


def test_help_has_examples(tmp_path):
    detect = ["detect", "evaluate"], ["detect", "inspect"]
    for command in (["run"], ["plan"], ["compare", "paper"], ["dataset"], *detect):
        text = skysweep(*command, "--help", cwd=tmp_path).stdout
        assert "skysweep " + " ".join(command) in text


@pytest.fixture
def flown(tmp_path, scenario):
    """A whole run folder of a statistical mission."""
    out = tmp_path / "flown"
    result = skysweep("run", scenario, "--sensor", "statistical", "--out", out, cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    return out


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_the_summary_in_the_terminal_has_names_and_units(tmp_path, scenario):
    result = skysweep("run", scenario, "--sensor", "statistical", "--out", "r", cwd=tmp_path)
    lines = [" ".join(line.split()) for line in result.stdout.splitlines()]
    summary = json.loads((tmp_path / "r" / "summary.json").read_text())
    assert f"Mission time {summary['mission_time_s']:.0f} s" in lines
    assert "Confirmed 1 of 1 targets" in lines
    assert f"Energy {summary['energy_wh']:.1f} Wh" in lines
    assert "mission_time_s" not in result.stdout


def test_results_of_a_mission_broken_off_are_had_without_flying_and_it_still_goes_on(tmp_path, flown):
    whole = contents(flown)
    broken = tmp_path / "broken"
    broken.mkdir()
    (broken / "config.yaml").write_bytes(whole["config.yaml"])
    lines = whole["journal.jsonl"].splitlines(keepends=True)
    (broken / "journal.jsonl").write_bytes(b"".join(lines[: len(lines) // 2]) + b'{"t": 33.1, "ki')
    before = (broken / "journal.jsonl").read_bytes()
    result = skysweep("report", broken, cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert "warning" in result.stderr
    assert "interrupted or is still flying" in result.stderr
    assert set(contents(broken)) == set(whole)
    assert (broken / "journal.jsonl").read_bytes() == before
    assert json.loads((broken / "summary.json").read_text())["ended"] is False
    result = skysweep("resume", broken, cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert "nothing to do" not in result.stdout
    assert (broken / "journal.jsonl").read_bytes() == whole["journal.jsonl"]
    assert json.loads((broken / "summary.json").read_text())["ended"] is True


def test_results_of_a_mission_go_elsewhere_and_leave_its_folder_alone(tmp_path, flown):
    before = contents(flown)
    result = skysweep("report", flown, "--out", tmp_path / "elsewhere", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert result.stderr == ""
    assert contents(flown) == before
    elsewhere = contents(tmp_path / "elsewhere")
    assert elsewhere == {name: before[name] for name in elsewhere}
    assert set(before) - set(elsewhere) == {"config.yaml", "journal.jsonl"}


def test_a_mission_is_reported_while_it_flies(tmp_path, flown):
    from skysweep.mission.journal import FileJournal

    journal = flown / "journal.jsonl"
    held = FileJournal(journal)
    before = journal.read_bytes()
    assert skysweep("report", flown, cwd=tmp_path).returncode == 0
    assert journal.read_bytes() == before
    held.close()


def test_the_sound_part_of_a_damaged_folder_is_reported_elsewhere_when_asked_for(tmp_path, flown):
    journal = flown / "journal.jsonl"
    lines = journal.read_bytes().splitlines(keepends=True)
    journal.write_bytes(b"".join([*lines[:40], b"rubbish\n", *lines[41:]]))
    before = contents(flown)
    refused(skysweep("report", flown, cwd=tmp_path), "line 41 is damaged, 40 before it", "--from-sound-lines")
    refused(skysweep("report", flown, "--from-sound-lines", cwd=tmp_path), "line 41", "--out")
    result = skysweep("report", flown, "--from-sound-lines", "--out", "sound", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert "left out: line 41 of journal.jsonl and all lines after it" in result.stderr
    assert "left out: summary.json" in result.stderr
    assert "line 41 of journal.jsonl" in (tmp_path / "sound" / "report.html").read_text()
    assert contents(flown) == before
    refused(skysweep("resume", flown, cwd=tmp_path), "line 41 is damaged", "--from-sound-lines")


def test_a_folder_that_cannot_be_written_asks_for_out(tmp_path, flown):
    (tmp_path / "file").write_text("")
    refused(
        skysweep("report", flown, "--out", tmp_path / "file" / "x", cwd=tmp_path), "--out", "choose another"
    )


def test_planning_an_area_warns_of_too_few_pixels_as_validate_does(tmp_path):
    ring = [[22.2966, 60.449], [22.3000, 60.449], [22.3000, 60.4510], [22.2966, 60.4510], [22.2966, 60.449]]
    (tmp_path / "field.geojson").write_text(json.dumps({"type": "Polygon", "coordinates": [ring]}))
    result = skysweep("plan", "field.geojson", "--altitude", 60, cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert "warning: search.scan_altitude_agl_m: the smallest target spans only" in result.stderr
    assert "there are none" not in result.stderr
    (tmp_path / "mine.yaml").write_text(
        "name: mine\narea: {file: field.geojson}\nhome: {latitude_deg: 60.449, longitude_deg: 22.2966}\n"
        "targets: [{class: stop sign, position_enu_m: [20, 20], size_m: 0.9}]\n"
    )
    result = skysweep("run", "mine.yaml", "--sensor", "statistical", "--out", "r", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    (tmp_path / "field.geojson").unlink()
    assert skysweep("report", "r", "--out", "again", cwd=tmp_path).returncode == 0
