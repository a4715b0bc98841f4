from __future__ import annotations

import json
import re
from html.parser import HTMLParser

import numpy as np
import pytest
from PIL import Image
from results_data import event, sighting, tiny_records, write_run

from skysweep.experiments.paper.report import write_compare_report
from skysweep.mission.notes import UNDECIDED
from skysweep.results import figures
from skysweep.results.metrics import compute_summary
from skysweep.results.picture_files import picture_name
from skysweep.results.reporting.wording import share
from skysweep.results.run_folder import load_run
from skysweep.results.writing import write_results

VOID = {"meta", "img", "br", "link"}


class Page(HTMLParser):
    """Text, images and whether every element was closed."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open_tags: list[str] = []
        self.sources: list[str] = []
        self.text = ""
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.sources += [value for name, value in attrs if name in ("src", "href")]
        if tag not in VOID:
            self.open_tags.append(tag)

    def handle_endtag(self, tag):
        assert self.open_tags.pop() == tag

    def handle_data(self, data):
        if "style" not in self.open_tags:
            self.text += f"{data} "


def read_page(path):
    page = Page(path.read_text(encoding="utf-8"))
    page.text = re.sub(r"\s+", " ", page.text)
    assert page.open_tags == []
    assert all(source.startswith("data:image/") for source in page.sources), "needs another file"
    return page


def test_run_folder_gets_everything(tiny_folder):
    (tiny_folder / "pictures").mkdir()
    Image.new("RGB", (32, 18)).save(tiny_folder / "pictures" / "confirmed_stop-sign_0.jpg")
    told = []
    summary = write_results(
        load_run(tiny_folder), tiny_folder, wall_time_s=8.0, on_step=lambda done, of: told.append((done, of))
    )
    assert told == [(0, 3), (1, 3), (2, 3), (3, 3)]
    written = json.loads((tiny_folder / "summary.json").read_text())
    assert {key: written[key] for key in summary} == summary
    assert list(written)[len(summary) :] == ["journal", "crc"]
    assert 10 < summary["scan_only_time_s"] < 60
    assert summary["real_time_factor"] == 10
    left = {p.name for p in tiny_folder.iterdir()}
    assert left == {
        "config.yaml",
        "journal.jsonl",
        "pictures",
        "summary.json",
        "map.png",
        "foxglove-layout.json",
        "mission.mcap",
        "report.html",
        *(f"targets.{suffix}" for suffix in ("geojson", "kml", "gpx", "csv")),
    }
    page = read_page(tiny_folder / "report.html")
    assert len(page.sources) == 2 + 1, "map, probability of detection, pictures"
    for told in (
        "The search of 800 m² ended 1 min 0 s after take-off: 2 of 3 targets confirmed, 3 of 5 verdicts on "
        "something else.",
        "Strategy scan-check: candidates are checked after 1 of them (n_c) or at the end of the scan.",
        "0:11 Down to 2 m to check. Confirmed stop sign 1. ",
        "Rejected 1 candidate. Back to the search at 0:21.",
        "60.4490898",  # latitude of the first
        "- duplicate -",  # the fourth
        "- no -",  # the bucket
        "never seen",  # the sign at x = 35
        "confirmed stop sign 0",  # a caption
    ):
        assert told in page.text


def test_report_of_a_mission_broken_off_says_so(tmp_path):
    folder = write_run(tmp_path / "run", [r for r in tiny_records() if r["t"] <= 15])
    write_results(load_run(folder), folder)
    page = read_page(folder / "report.html")
    assert (
        "The journal ends 0 min 15 s after take-off: the search of 800 m² was broken off, or is still going "
        "on. So far 0 of 3 targets confirmed, 1 candidate left unchecked." in page.text
    )
    assert "No target was confirmed." in page.text
    assert "The mission had not reached it when the journal ended." in page.text
    assert "0:11 Down to 2 m to check. Broken off. " in page.text
    summary = json.loads((folder / "summary.json").read_text())
    assert (summary["ended"], summary["completed"], summary["n_unchecked"]) == (False, False, 1)


def test_a_search_that_was_finished_is_not_called_broken_off(tmp_path):
    records = [r for r in tiny_records() if r["kind"] not in ("landed", "end")]
    text = report_of(tmp_path / "run", records)
    assert (
        "The search of 800 m² was finished 1 min 0 s after take-off, and the journal ends on the way" in text
    )
    assert "broken off, or is still going on" not in text


def test_candidates_left_for_other_reasons_are_told_apart(tmp_path):
    left = [
        event(59, "unchecked", 8, [35, 11, 0]) | {"reason": "nobody knows"},
        event(59, "unchecked", 9, [30, 11, 0]) | {"reason": "it is dark"},
    ]
    text = report_of(tmp_path / "run", [*tiny_records(), *left])
    assert "1 candidate left unchecked (unchecked stop sign 1): Nobody knows." in text
    assert "1 candidate left unchecked (unchecked stop sign 2): It is dark." in text


def report_of(folder, records):
    write_results(load_run(write_run(folder, sorted(records, key=lambda r: r["t"]))), folder)
    return read_page(folder / "report.html").text


def test_a_target_that_was_rejected_is_told_in_the_lead_and_on_a_tile(tmp_path):
    rejected = [event(54, "scanned", 7, [35, 11, 0]), event(56, "rejected", 7, [35, 11, 0])]
    text = report_of(tmp_path / "run", [*tiny_records(), *rejected])
    assert "2 of 3 targets confirmed, 3 of 6 verdicts on something else, 1 target seen and rejected." in text
    assert "1 seen and rejected" in text
    run = load_run(tmp_path / "run")
    assert figures._marks_of_candidates(run)[7] == "wrong rejection"


def test_why_a_target_was_missed(tmp_path):
    """Another class does not count, and a confirmed neighbour is no rejection."""
    close = [{"class": "stop sign", "position_enu_m": [x, 10]} for x in (5, 20, 21.5)]
    folder = write_run(tmp_path / "close", tiny_records(), targets=close)
    write_results(load_run(folder), folder)
    assert "not told apart from a confirmed one" not in read_page(folder / "report.html").text
    records = [r for r in tiny_records() if r.get("candidate") != 4]
    folder = write_run(tmp_path / "one", records, targets=close)
    write_results(load_run(folder), folder)
    assert "not told apart from a confirmed one" in read_page(folder / "report.html").text
    seen = [*tiny_records(), sighting(57, 8, [35, 11, 0], 0.3, new=True)]
    assert "seen, not decided on" in report_of(tmp_path / "seen", seen)


def test_a_search_that_the_strategy_ended_early_is_not_told_as_whole(tmp_path):
    records = [r for r in tiny_records() if r["kind"] != "finished"]
    early = event(60, "finished") | {"reason": "it has lasted 60 s"}
    text = report_of(tmp_path / "run", [*records, early])
    assert "The strategy ended the search early: it has lasted 60 s." in text
    assert "1:00 The way home begins." in text
    assert "All transects flown" not in text


def test_what_the_strategy_did_not_decide_on_is_left_to_people(tmp_path):
    left = event(60, "unchecked", 6, [38, 18, 0]) | {"reason": UNDECIDED}
    text = report_of(tmp_path / "run", [*tiny_records(), left])
    assert "1:00 All transects flown: the way home begins." in text
    assert (
        "1:00 1 candidate left unchecked (unchecked stop sign 1): The strategy did not decide on it." in text
    )
    found = json.loads((tmp_path / "run/targets.geojson").read_text())["features"]
    assert len(found) == 4 + 1


@pytest.mark.parametrize(
    ("value", "words"),
    [(0.0, "0%"), (0.003, "under 1%"), (0.01, "1%"), (0.994, "99%"), (0.9969, "over 99%"), (1.0, "100%")],
)
def test_a_share_is_nothing_or_all_only_where_it_is(value, words):
    assert share(value) == words


def test_candidates_left_unchecked_are_one_step_with_their_names_and_the_reason(tmp_path):
    safety = {"t": 57, "kind": "safety", "cause": "battery", "action": "RETURN", "sentence": "20 % are left."}
    records = [r for r in tiny_records() if r["kind"] not in ("finished", "end")]
    places = [sighting(52 + k, 6 + k, [30 + k, 18, 0], 0.3, new=True) for k in range(3)]
    left = [event(57, "unchecked", 6 + k, [30 + k, 18, 0]) for k in range(3)]
    end = {"t": 80, "kind": "end", "reason": "battery"}
    told = sorted([*records, *places, safety, *left, end], key=lambda r: r["t"])
    folder = write_run(tmp_path / "run", told)
    write_results(load_run(folder), folder)
    text = read_page(folder / "report.html").text
    assert text.count("left unchecked (") == 1
    assert (
        "0:57 3 candidates left unchecked (unchecked stop sign 1, unchecked stop sign 2, unchecked stop sign "
        "3): 20 % are left." in text
    )
    assert re.search(r"unchecked stop sign 2 60\.\d{7} 22\.\d{7} 0\.30 10 20 % are left\.", text)


def test_a_report_without_truth_judges_nothing(tmp_path):
    folder = write_run(tmp_path / "run", tiny_records(), targets=[])
    write_results(load_run(folder), folder)
    page = read_page(folder / "report.html")
    assert (
        "ended 1 min 0 s after take-off: 4 targets confirmed, 1 of 5 verdicts against a target." in page.text
    )
    report, _, _ = page.text.partition("What the words mean")
    for word in ("True target?", "Error (m)", "false positives", "0 of 0", "median position error"):
        assert word not in report
    assert "target 4 0:50 " in report


def test_the_report_maps_the_probability_of_detection_where_there_is_a_sensor_model(tmp_path):
    camera = {"width_px": 640, "height_px": 360, "hfov_rad": 1.4}
    folder = write_run(tmp_path / "run", tiny_records(), camera=camera)
    write_results(load_run(folder), folder)
    page = read_page(folder / "report.html")
    assert len(page.sources) == 2
    assert re.search(r"How probably a target would have been reported .* over the area is \d+%", page.text)


def test_the_report_of_a_damaged_journal_says_what_it_is_of(tiny_folder):
    journal = tiny_folder / "journal.jsonl"
    lines = journal.read_text().splitlines()
    journal.write_text("\n".join([*lines[:12], "rubbish", *lines[13:]]))
    write_results(load_run(tiny_folder, from_sound_lines=True), tiny_folder)
    told = "The folder is damaged; left out: line 13 of journal.jsonl and all lines after it"
    assert told in read_page(tiny_folder / "report.html").text


@pytest.mark.parametrize("n_lines", [1, 2, 3, 4, 7, 17])
def test_a_journal_broken_off_anywhere_has_results(tmp_path, n_lines):
    folder = write_run(tmp_path / "run", tiny_records()[:n_lines])
    summary = write_results(load_run(folder), folder)
    assert not summary["ended"]
    assert (folder / "report.html").is_file()


def test_results_need_no_file_but_those_of_the_folder(tmp_path):
    gone = {"search": {"n_c": 1, "scan_altitude_agl_m": 10, "check_altitude_agl_m": 2, "plan": "/gone.plan"}}
    folder = write_run(tmp_path / "run", tiny_records(), detector={"model": "/gone.onnx"}, **gone)
    summary = write_results(load_run(folder), folder)
    assert summary["scan_only_time_s"] is None
    assert summary["n_confirmed"] == 2


def test_evidence_has_every_candidate_with_a_verdict_or_left_unchecked(tmp_path):
    records = [*tiny_records(), event(59, "unchecked", 6, [38, 18, 0])]
    folder = write_run(tmp_path / "run", records)
    (folder / "pictures").mkdir()
    for candidate, time_s in ((1, 15.0), (2, 20.0), (3, 40.0), (6, 55.0), (7, 56.0)):
        picture = Image.new("RGB", (1280, 720), (90, 120, candidate))
        picture.save(folder / "pictures" / picture_name(candidate, time_s))
    (folder / "pictures" / picture_name(4, 44.0)).write_bytes(b"torn")
    write_results(load_run(folder), folder)
    page = read_page(folder / "report.html")
    assert len(page.sources) == 2 + 4, "map, probability of detection, pictures"
    for heading, caption in (
        (
            "Pictures of confirmed targets",
            "Confirmed stop sign 1: confidence 0.80, from 10.0 m above ground, at 0:15",
        ),
        (
            "Pictures of unchecked candidates",
            "Unchecked stop sign 1: confidence 0.30, from 10.0 m above ground, at 0:55",
        ),
        (
            "Pictures of rejected candidates",
            "Rejected stop sign (candidate 2): not detected, from 4.7 m above ground, at 0:20",
        ),
    ):
        assert re.search(rf"{heading}.*{re.escape(caption)}", page.text)


def test_a_report_with_many_pictures_stays_small_and_drops_none(tmp_path):
    records = tiny_records()[:-1]
    for k in range(60):
        records.append(event(61 + k / 10, "rejected", 100 + k, [k / 2, 3, 0]))
    folder = write_run(tmp_path / "run", records)
    (folder / "pictures").mkdir()
    noise = np.random.default_rng(0).normal(120, 12, (90, 160, 3)).clip(0, 255).astype(np.uint8)
    busy = Image.fromarray(noise).resize((1280, 720), Image.Resampling.BICUBIC)
    for k in range(60):
        busy.save(folder / "pictures" / picture_name(100 + k, 61 + k / 10), quality=85)
    write_results(load_run(folder), folder)
    page = read_page(folder / "report.html")
    assert len(page.sources) == 2 + 60, "map, probability of detection, pictures"
    assert (folder / "report.html").stat().st_size < 8e6


def test_names_from_files_cannot_inject_html(tmp_path):
    folder = write_run(tmp_path / "run", tiny_records(), description="<script>alert(1)</script>")
    write_results(load_run(folder), folder)
    assert "<script" not in (folder / "report.html").read_text(encoding="utf-8")


@pytest.fixture
def comparison(tmp_path):
    """Two rows of Table 3, two seeds each; n_c = 1 takes 20 s longer."""
    summaries = []
    for n_c, extra in ((1, 20.0), (float("inf"), 0.0)):
        for seed in (0, 1):
            records = tiny_records()
            records[0]["seed"] = seed
            for record in records:
                if record["kind"] == "finished":
                    record["t"] += extra - seed
            folder = write_run(
                tmp_path / f"runs/sparse-nc{n_c:g}-seed{seed}", records, name="sparse", search={"n_c": n_c}
            )
            summaries.append(compute_summary(load_run(folder)))
    return tmp_path, summaries


def runs_in(folder):
    return sorted(folder.glob("runs/*"))


def test_comparison_writes_tables_and_figures(comparison):
    folder, summaries = comparison
    rows = write_compare_report(folder, summaries, runs_in(folder))
    assert [(r.scenario, r.n_c, r.n_seeds) for r in rows] == [("sparse", 1, 2), ("sparse", "inf", 2)]
    written = json.loads((folder / "compare.json").read_text())
    assert [row["mission_time_mean_s"] for row in written] == [79.5, 59.5]
    assert {p.name for p in folder.iterdir()} == {
        "runs",
        "baselines.json",
        "compare.json",
        "compare.md",
        "report.html",
        "pos-sparse.svg",
        *(f"trajectories.{suffix}" for suffix in ("png", "svg", "pdf")),
    }
    page = read_page(folder / "report.html")
    assert len(page.sources) == 2
    assert "sparse: n_c = ∞ is faster than n_c = 1 -20.0 s" in page.text
    assert "the same in all rows" in page.text


def test_comparison_shows_scan_only_beside_the_rows(comparison):
    folder, summaries = comparison
    for seed in (0, 1):
        records = tiny_records()
        records[0] |= {"seed": seed, "strategy": "scan-only"}
        run = write_run(folder / f"runs/sparse-scan-only-seed{seed}", records, name="sparse")
        summaries.append(compute_summary(load_run(run)))
    rows = write_compare_report(folder, summaries, runs_in(folder))
    assert [(r.n_c, r.n_seeds) for r in rows] == [(1, 2), ("inf", 2), ("scan-only", 2)]
    assert [r["n_c"] for r in json.loads((folder / "compare.json").read_text())] == [1, "inf"]
    (baseline,) = json.loads((folder / "baselines.json").read_text())
    assert baseline["mission_time_mean_s"] == 60
    page = read_page(folder / "report.html")
    assert "What closer looks cost and bring" in page.text
    assert "sparse n_c = ∞ -0.5" in page.text
    assert "the same in all rows" in page.text
    for figure in ("trajectories.svg", "pos-sparse.svg"):
        assert "scan-only" in (folder / figure).read_text(), figure


def test_comparison_tells_of_searches_that_were_not_finished(comparison):
    folder, summaries = comparison
    cut = [summaries[0] | {"completed": False}, *summaries[1:]]
    write_compare_report(folder, cut, runs_in(folder))
    assert "1 of them ended before the search was finished" in read_page(folder / "report.html").text


def test_comparison_without_run_folders_has_no_trajectories(comparison, tmp_path_factory):
    _, summaries = comparison
    folder = tmp_path_factory.mktemp("bare")
    write_compare_report(folder, summaries, [])
    page = read_page(folder / "report.html")
    assert "Trajectories" not in page.text
    assert "Table 3" in page.text


def test_parameters_that_differ_between_rows_are_told(comparison):
    folder, summaries = comparison
    config = folder / "runs/sparse-nc1-seed0/config.yaml"
    config.write_text(config.read_text().replace("mean_speed_mps: 2.0", "mean_speed_mps: 9.0"))
    write_compare_report(folder, summaries, runs_in(folder))
    assert "NOT the same in all rows" in read_page(folder / "report.html").text
