from __future__ import annotations

import json

import numpy as np
import pytest
from results_data import event, sighting, tiny_records, write_run

from skysweep.errors import UserError
from skysweep.results.run_folder import load_run


def test_reads_what_was_flown(tiny_run):
    assert tiny_run.seed == 3
    assert tiny_run.strategy == "scan-check"
    assert tiny_run.plan_enu_m.tolist() == [[0, 10, 10], [40, 10, 10]]
    assert len(tiny_run.states) == 8
    assert tiny_run.states.R_camera_to_enu.shape == (8, 3, 3)
    assert tiny_run.finished_s == 60
    assert tiny_run.landed_s == 80
    assert tiny_run.end_reason == "completed"


def test_candidates_tell_their_story(tiny_run):
    stories = {c.id: c for c in tiny_run.candidates}
    assert [c.id for c in tiny_run.candidates] == [1, 2, 3, 4, 5, 6]
    assert (stories[1].verdict, stories[1].verdict_s, stories[1].scanned_s) == ("confirmed", 16, 11)
    assert stories[1].confidence == 0.8
    assert stories[1].n_sightings == 2
    assert stories[2].verdict == "rejected"
    assert stories[6].verdict is None
    assert stories[6].class_name == "stop sign"


def test_radius_is_that_of_the_95_percent_circle(tmp_path):
    records = tiny_records()
    next(r for r in records if r["kind"] == "confirmed")["covariance_m2"] = [[0.25, 0.0], [0.0, 0.04]]
    story = load_run(write_run(tmp_path, records)).candidates[0]
    assert story.radius_95_m == pytest.approx(0.5 * np.sqrt(5.991))


def test_times_count_from_takeoff(tmp_path):
    run = load_run(write_run(tmp_path, tiny_records(t0=1000.0)))
    assert run.finished_s == 60
    assert run.states.time_s[-1] == 80
    assert run.candidates[0].verdict_s == 16


def test_line_cut_short_by_a_crash_is_left_out(tiny_folder):
    journal = tiny_folder / "journal.jsonl"
    journal.write_text("\n".join(journal.read_text().splitlines()[:-6]) + '\n{"t": 61, "ki')
    run = load_run(tiny_folder)
    assert run.finished_s is None
    assert run.end_reason == "broken off"
    assert run.last_s == 55


@pytest.mark.parametrize("bad", ["nonsense", json.dumps([1, 2]), json.dumps({"kind": "state"})])
def test_a_damaged_line_is_named_and_those_before_it_are_read_when_asked_for(tiny_folder, bad):
    journal = tiny_folder / "journal.jsonl"
    lines = journal.read_text().splitlines()
    lines[4] = bad
    journal.write_text("\n".join(lines))
    with pytest.raises(
        UserError, match=r"line 5 is damaged, 4 before it are sound; .skysweep report .*--from"
    ):
        load_run(tiny_folder)
    run = load_run(tiny_folder, from_sound_lines=True)
    assert run.left_out == ("line 5 of journal.jsonl and all lines after it",)
    assert [r["kind"] for r in run.records] == ["start", "plan", "state", "state"]


def test_a_mission_that_had_not_begun_has_no_results(tiny_folder):
    journal = tiny_folder / "journal.jsonl"
    lines = journal.read_text().splitlines()
    journal.write_text('{"t": 0.0, "kind": "setup"}\n')
    with pytest.raises(UserError, match=r"journal\.jsonl: the mission had not taken off"):
        load_run(tiny_folder)
    journal.write_text("\n".join(["rubbish", *lines]))
    with pytest.raises(UserError, match=r"journal\.jsonl: line 1 is damaged"):
        load_run(tiny_folder)


def test_a_whole_journal_names_what_was_left_unchecked(tmp_path):
    left = event(59, "unchecked", 6, [38, 18, 0])
    assert load_run(write_run(tmp_path / "none", tiny_records())).unchecked == ()
    (story,) = load_run(write_run(tmp_path / "one", [*tiny_records(), left])).unchecked
    assert (story.id, story.position_enu_m.tolist()) == (6, [38, 18, 0])


def test_a_journal_without_an_end_leaves_unchecked_what_was_scanned_or_seen_twice(tmp_path):
    records = [r for r in tiny_records() if r["t"] <= 36] + [
        sighting(37, 7, [30, 5, 0], 0.5, new=True),
        sighting(38, 8, [31, 9, 0], 0.5, new=True),
        sighting(39, 8, [31, 9, 0], 0.5),
    ]
    run = load_run(write_run(tmp_path, records))
    assert not run.ended
    assert [story.id for story in run.unchecked] == [3, 8]


def test_truth_needs_targets_and_a_sensor_that_saw_the_scenario(tmp_path):
    setup = {"t": 0.0, "kind": "setup"}
    seen = tmp_path / "seen", [setup, *tiny_records()]
    outside = tmp_path / "outside", [setup | {"truth": False}, *tiny_records()]
    assert load_run(write_run(*seen)).has_truth
    assert not load_run(write_run(*outside)).has_truth
    assert not load_run(write_run(*seen, targets=[])).has_truth


def test_missing_folder_is_named(tmp_path):
    with pytest.raises(UserError, match=r"nowhere: has no config\.yaml"):
        load_run(tmp_path / "nowhere")


def test_config_that_is_no_scenario_names_the_field(tiny_folder):
    (tiny_folder / "config.yaml").write_text("name: x\n")
    with pytest.raises(UserError, match=r"config\.yaml: area: is missing"):
        load_run(tiny_folder)


def test_python_tags_in_config_are_refused(tiny_folder):
    (tiny_folder / "config.yaml").write_text("!!python/object/apply:os.system ['true']\n")
    with pytest.raises(UserError, match=r"config\.yaml: line 1: the YAML tag"):
        load_run(tiny_folder)
