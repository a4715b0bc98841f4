from __future__ import annotations

import json
import re
from html.parser import HTMLParser

import pytest
from PIL import Image
from results_data import tiny_records, write_run

from skysweep.results.metrics import compute_summary
from skysweep.results.report import write_compare_report
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
    for k in range(10):
        Image.new("RGB", (32, 18)).save(tiny_folder / "pictures" / f"confirmed_stop-sign_{k}.jpg")
    summary = write_results(load_run(tiny_folder), wall_time_s=8.0)
    assert json.loads((tiny_folder / "summary.json").read_text()) == summary
    assert 10 < summary["scan_only_time_s"] < 60
    assert summary["real_time_factor"] == 10
    left = {p.name for p in tiny_folder.iterdir()}
    assert left == {
        "config.yaml",
        "journal.jsonl",
        "pictures",
        "summary.json",
        "map.png",
        "mission.mcap",
        "report.html",
        *(f"targets.{suffix}" for suffix in ("geojson", "kml", "gpx", "csv")),
    }
    page = read_page(tiny_folder / "report.html")
    assert len(page.sources) == 1 + 8
    for told in (
        "1 min 0 s after take-off the search of 800 m² was over: 2 of 3 targets found and confirmed, "
        "3 of 5 checks for nothing.",
        "0:11 Down to 2 m to check. Confirmed stop sign 1. ",
        "Nothing at 1 place. Back to the search at 0:21.",
        "60.4490898",  # latitude of the first
        "no: found before",
        "no: nothing there",
        "never seen",  # the sign at x = 35
        "confirmed stop sign 0",  # a caption
    ):
        assert told in page.text


def test_report_of_a_mission_broken_off_says_so(tmp_path):
    folder = write_run(tmp_path / "run", [r for r in tiny_records() if r["t"] <= 15])
    write_results(load_run(folder))
    page = read_page(folder / "report.html")
    assert "The search was not completed (broken off)." in page.text
    assert "No target was confirmed." in page.text


def test_names_from_files_cannot_inject_html(tmp_path):
    folder = write_run(tmp_path / "run", tiny_records(), description="<script>alert(1)</script>")
    write_results(load_run(folder))
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


def test_comparison_writes_tables_and_figures(comparison):
    folder, summaries = comparison
    rows = write_compare_report(folder, summaries)
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
    rows = write_compare_report(folder, summaries)
    assert [(r.n_c, r.n_seeds) for r in rows] == [(1, 2), ("inf", 2), (None, 2)]
    assert [r["n_c"] for r in json.loads((folder / "compare.json").read_text())] == [1, "inf"]
    (baseline,) = json.loads((folder / "baselines.json").read_text())
    assert baseline["mission_time_mean_s"] == 60
    page = read_page(folder / "report.html")
    assert "What CHECK costs and brings" in page.text
    assert "sparse ∞ -0.5" in page.text
    assert "the same in all rows" in page.text
    for figure in ("trajectories.svg", "pos-sparse.svg"):
        assert "scan-only" in (folder / figure).read_text(), figure


def test_comparison_tells_of_searches_that_were_not_finished(comparison):
    folder, summaries = comparison
    write_compare_report(folder, [summaries[0] | {"completed": False}, *summaries[1:]])
    assert "1 of them ended before the search was finished" in read_page(folder / "report.html").text


def test_comparison_without_run_folders_has_no_trajectories(comparison, tmp_path_factory):
    _, summaries = comparison
    folder = tmp_path_factory.mktemp("bare")
    write_compare_report(folder, summaries)
    page = read_page(folder / "report.html")
    assert "Trajectories" not in page.text
    assert "Table 3" in page.text


def test_parameters_that_differ_between_rows_are_told(comparison):
    folder, summaries = comparison
    config = folder / "runs/sparse-nc1-seed0/config.yaml"
    config.write_text(config.read_text().replace("mean_speed_mps: 2.0", "mean_speed_mps: 9.0"))
    write_compare_report(folder, summaries)
    assert "NOT the same in all rows" in read_page(folder / "report.html").text
