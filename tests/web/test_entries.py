"""The list of a folder: missions, sweeps and comparisons, newest first, with their key figures."""

import hashlib
import os
import shutil

import polars as pl
import pytest

from skysweep.experiments.store import MissionStore
from skysweep.files.folder import Folder
from skysweep.files.line_file import LineFile
from skysweep.web.entries import entries
from skysweep.web.places import Places


def told(root, live=None):
    return {entry["id"]: entry for entry in entries(Places(root), live)}


def figures(entry):
    return {figure["label"]: figure["value"] for figure in entry["figures"]}


def start(run, fields):
    """A journal with nothing but its start."""
    (run / "journal.jsonl").write_text(f'{{"t": 0, "kind": "start", {fields}}}\n')


def test_a_journal_that_is_a_pipe_holds_up_nobody(root, run):
    (run / "journal.jsonl").unlink()
    os.mkfifo(run / "journal.jsonl")
    assert told(root)["short"]["kind"] == "run"


def test_a_run_that_is_deleted_meanwhile_hides_no_other(root, monkeypatch):
    found = [(root / "gone", "run"), (root / "short", "run")]
    monkeypatch.setattr("skysweep.web.entries._found", lambda _root: found)
    listed = told(root)
    assert "cannot be read" in listed["gone"]["error"]
    assert listed["short"]["error"] is None


def test_a_folder_whose_name_is_no_text_hides_no_other(root, run):
    shutil.copytree(run, root / os.fsdecode(b"bad\xff"))
    assert set(told(root)) == {"short"}


def test_links_in_a_run_are_not_followed(root, run):
    for name in ("journal.jsonl", "config.yaml"):
        (run / name).rename(root.parent / name)
        (run / name).symlink_to(root.parent / name)
        assert f"{name} is a link" in told(root)["short"]["error"]
        (root.parent / name).replace(run / name)


def test_a_mission_is_listed_with_its_figures_map_and_report(root, run):
    entry = told(root)["short"]
    assert entry["kind"] == "run"
    assert (entry["scenario"], entry["strategy"], entry["seed"]) == ("short", "scan-check", 0)
    assert entry["sensor"] == "imaging"
    assert entry["state"] == "ended"
    assert figures(entry)["confirmed"] == "1 of 1"
    assert ":" in figures(entry)["mission time"]
    assert entry["thumbnail"] == "/api/runs/short/thumbnail"
    assert entry["report"] == "/api/runs/short/report"
    assert entry["error"] is None


def test_the_newest_comes_first(root, run):
    for name, age_s in (("older", 5000), ("newest", 10), ("oldest", 9000)):
        shutil.copytree(run, root / "deep" / name)
        for path in (root / "deep" / name).iterdir():
            os.utime(path, (1_700_000_000 - age_s, 1_700_000_000 - age_s))
    shutil.rmtree(run)
    assert [entry["id"] for entry in entries(Places(root), None)] == [
        "deep/newest",
        "deep/older",
        "deep/oldest",
    ]


def test_a_comparison_is_listed_with_the_figures_of_its_table(root, tmp_path):
    from typer.testing import CliRunner

    from skysweep.cli import app

    spec = tmp_path / "sweep.yaml"
    spec.write_text(
        "name: small\nscenarios: [sparse]\nstrategies: [scan-only]\nseeds: 2\nsensor: statistical\n"
    )
    result = CliRunner().invoke(app, ["sweep", str(spec), "--out", str(root / "swept"), "--workers", "1"])
    assert result.exit_code == 0, result.output
    entry = told(root)["swept"]
    assert entry["kind"] == "sweep"
    assert figures(entry)["missions"] == "2"
    assert 0 <= float(figures(entry)["mean recall"]) <= 1


def test_a_damaged_table_is_one_sentence(root):
    (root / "sweep").mkdir()
    (root / "sweep" / "spec.yaml").write_text("name: x")
    (root / "sweep" / "missions.parquet").write_bytes(b"PAR1 no more")
    assert "missions.parquet: is missing, or not a Parquet table" in told(root)["sweep"]["error"]


def test_a_changed_table_shows_no_figures(root):
    pl.DataFrame({"mission_time_s": [60.0], "recall": [0.5]}).write_parquet(root / "missions.parquet")
    (root / "sweep").mkdir()
    (root / "sweep" / "spec.yaml").write_text("name: x")
    table = (root / "missions.parquet").rename(root / "sweep" / "missions.parquet")
    digest = hashlib.sha256(table.read_bytes()).hexdigest()
    (root / "sweep" / "SHA256SUMS").write_text(f"{digest}  missions.parquet\n")
    assert figures(told(root)["sweep"])["mean recall"] == "0.50"
    pl.DataFrame({"mission_time_s": [60.0], "recall": [0.9]}).write_parquet(table)
    entry = told(root)["sweep"]
    assert "SHA256SUMS has another digest" in entry["error"]
    assert not entry.get("figures")


@pytest.mark.parametrize(
    ("change", "state", "words"),
    [
        (lambda run: (run / "journal.jsonl").unlink(), "broken off", "broken off before take-off"),
        (lambda run: (run / "summary.json").write_text("{}"), "ended", "is damaged"),
        (lambda run: (run / "journal.jsonl").write_bytes(b'{"t": 0'), "broken off", "broken off before"),
        (lambda run: start(run, '"seed": "x"'), "broken off", "not written by a mission"),
        (lambda run: start(run, '"seed": 0, "scenario": NaN'), "broken off", "not written by a mission"),
    ],
)
def test_a_broken_folder_is_listed_with_one_sentence(root, run, change, state, words):
    change(run)
    for path in run.iterdir():
        os.utime(path, (1_700_000_000, 1_700_000_000))
    entry = told(root)["short"]
    assert entry["state"] == state
    assert words in entry["error"]


def test_a_run_of_a_later_skysweep_is_listed_with_one_sentence(root, run):
    (run / "journal.jsonl").unlink()
    file = LineFile(run / "journal.jsonl", "")
    file.append({"t": 0.0, "kind": "setup", "version": "9.1.0", "seed": 0}, sync=False)
    file.close()
    assert "9.1.0" in told(root)["short"]["error"]


def test_a_mission_that_still_flies_is_listed_as_such(root, run):
    journal = run / "journal.jsonl"
    journal.write_bytes(journal.read_bytes()[:20_000])
    assert told(root)["short"]["state"] == "flying"
    os.utime(journal, (1_700_000_000, 1_700_000_000))
    assert told(root)["short"]["state"] == "broken off"
    assert told(root, live="short")["short"]["state"] == "flying"


def test_missions_of_a_comparison_are_no_part_of_a_run(root, run):
    shutil.copytree(run, run / "inner")
    assert set(told(root)) == {"short"}


def test_an_empty_store_is_no_entry(root):
    MissionStore(Folder(str(root / "empty")))
    assert set(told(root)) == {"short"}
