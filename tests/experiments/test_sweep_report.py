"""From a table of flown missions to sentences, tables, figures and a page."""

from __future__ import annotations

import io
import math
import re
from dataclasses import replace
from pathlib import Path

import fsspec
import numpy as np
import polars as pl
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats
from sweep_data import fly_sweep, tiny_scenario
from typer.testing import CliRunner

from skysweep.cli import app
from skysweep.errors import UserError
from skysweep.experiments.matrix import Matrix
from skysweep.experiments.store import MissionStore
from skysweep.experiments.sweep import figures as sweep_figures
from skysweep.experiments.sweep.analysis import analyse, best_rule, sensitivity, verdict
from skysweep.experiments.sweep.missions import (
    MISSION_TIME,
    Configuration,
    Flown,
    Missions,
    by_scenario,
    in_order,
    load_missions,
)
from skysweep.experiments.sweep.report import write_sweep_report
from skysweep.experiments.sweep.run import fly_job
from skysweep.experiments.sweep.spec import dump_spec, matrix_of, parse_spec
from skysweep.files.folder import Folder
from skysweep.results.checksums import sha256
from skysweep.results.reporting.html import Grid
from skysweep.results.reporting.statistics import holm, pairs_needed
from skysweep.results.reporting.symbols import field_name, field_unit
from skysweep.results.reporting.tables import latex_text, markdown, math_text

N_C = "param.search.n_c"
METRICS = ("mission_time_s", "recall", "false_scans", "false_positives", "energy_wh")


@pytest.fixture(scope="module")
def table() -> pl.DataFrame:
    """8 seeds of three n_c in one scenario, a single seed of two in another one."""
    calm = fly_sweep({"calm": tiny_scenario()}, {"search.n_c": [1, 3, math.inf]}, seeds=8)
    gale = tiny_scenario(wind={"mean_speed_mps": 7.0})
    windy = fly_sweep({"gale & co": gale}, {"search.n_c": [1, math.inf]}, seeds=1)
    windy = windy.with_columns(job=pl.col("job") + len(calm))
    return pl.concat([calm, windy], how="diagonal_relaxed")


@pytest.fixture(scope="module")
def reported(table: pl.DataFrame, tmp_path_factory) -> tuple[Path, list[str]]:
    folder = store(table, tmp_path_factory.mktemp("sweep"))
    (folder / "spec.yaml").write_text("name: mine\n")
    return folder / "report", write_sweep_report(load_missions(str(folder)), folder / "report")


def store(table: pl.DataFrame, folder: Path) -> Path:
    folder.mkdir(exist_ok=True)
    table.write_parquet(folder / "missions.parquet")
    return folder


def failing(table: pl.DataFrame, jobs: list[int]) -> pl.DataFrame:
    """The same table had these missions failed: an error, and nothing measured."""
    bad = pl.col("job").is_in(jobs)
    kept = {"job", "scenario", "strategy", "seed", "sensor", "config_hash", N_C, "error"}
    return table.with_columns(
        *[pl.when(~bad).then(pl.col(name)).alias(name) for name in table.columns if name not in kept],
        error=pl.when(bad).then(pl.lit("ValueError: no wind in the sails")).cast(pl.String),
    )


def test_everything_is_there_and_the_page_needs_nothing_else(reported):
    out, sentences = reported
    for name in ("statistics", "differences", "pareto"):
        assert {".md", ".tex"} <= {path.suffix for path in out.glob(f"tables/{name}.*")}
    figures = {path.stem for path in out.glob("figures/*")}
    assert figures == {"pareto-calm", "pos-calm", "search-n_c-calm"} | {
        f"{kind}-gale-co" for kind in ("pareto", "pos", "search-n_c")
    }
    for stem in figures:
        assert {p.suffix for p in out.glob(f"figures/{stem}.*")} == {".svg", ".pdf", ".csv"}
    html = (out / "report.html").read_text("utf-8")
    assert set(re.findall(r'(?:src|href)="([^"]{0,14})', html)) == {"data:image/svg"}
    assert html.count("<img") == 6
    assert "name: mine" in html
    for sentence in sentences:
        assert sentence.replace("&", "&amp;").replace("<", "&lt;") in html


def test_recall_axes_end_at_1(table, tmp_path, monkeypatch):
    drawn = []

    def save(figure, stem, *suffixes):
        drawn.append(figure)
        return [stem.with_suffix(suffix) for suffix in suffixes]

    monkeypatch.setattr(sweep_figures, "save_figures", save)
    flown_there = by_scenario(load_missions_of(table))["calm"]
    (analysis,) = analyse({"calm": flown_there})
    sweep_figures.draw_pareto(analysis, tmp_path / "pareto")
    sweep_figures.draw_pos(analysis, tmp_path / "pos")
    sweep_figures.draw_sensitivity(sensitivity(flown_there, "search.n_c"), "search.n_c", tmp_path / "n_c")
    shares = {
        id(axis): axis
        for figure in drawn
        for axis in figure.axes
        if "recall" in axis.get_ylabel().lower() or "POS" in axis.get_ylabel()
    }
    assert [axis.get_ylim()[1] for axis in shares.values()] == [1.0, 1.0, 1.0]
    assert all(axis.get_ylim()[0] < 1.0 for axis in shares.values())
    assert all(1.0 in axis.get_yticks().round(9) for axis in shares.values())


def test_means_are_those_of_the_table(reported, table):
    out, _ = reported
    statistics = pl.read_csv(out / "tables" / "statistics.csv")
    for row in statistics.filter(pl.col("metric").is_in(METRICS)).iter_rows(named=True):
        values = table.filter(
            (pl.col("scenario") == row["scenario"]) & (pl.col(N_C) == row["param.search.n_c"])
        )[row["metric"]]
        assert row["n"] == len(values)
        assert row["mean"] == pytest.approx(values.mean())
        assert row["median"] == pytest.approx(values.median())
        if len(values) > 1:
            assert row["std"] == pytest.approx(values.std())
            assert values.min() - 1e-9 <= row["low"] <= row["mean"] + 1e-9
            assert row["mean"] - 1e-9 <= row["high"] <= values.max() + 1e-9
        else:
            assert row["low"] is row["high"] is row["std"] is None
    assert set(METRICS) <= set(statistics["metric"])


def test_pairs_are_tested_seed_by_seed_and_corrected_together(reported, table):
    out, _ = reported
    pairs = pl.read_csv(out / "tables" / "all_pairs.csv")
    times = {
        n_c: rows.sort("seed")["mission_time_s"].to_numpy()
        for (n_c,), rows in table.filter(pl.col("scenario") == "calm").group_by(N_C)
    }
    labels = {"n_c = 1": 1.0, "n_c = 3": 3.0, "n_c = ∞": math.inf}
    found = pairs.filter((pl.col("scenario") == "calm") & (pl.col("metric") == "mission_time_s"))
    assert len(found) == 3
    for row in found.iter_rows(named=True):
        difference = times[labels[row["a"]]] - times[labels[row["b"]]]
        assert row["mean"] == pytest.approx(difference.mean())
        assert row["low"] <= row["mean"] <= row["high"]
        assert row["n_pairs"] == 8
        assert row["n_zero"] == (difference == 0).sum()
        moved = difference[difference != 0]
        if len(np.unique(np.abs(moved))) == len(moved):
            assert row["p"] == pytest.approx(stats.wilcoxon(moved, method="exact").pvalue)
    for metric in METRICS:
        family = pairs.filter(pl.col("metric") == metric)
        assert family["p_holm"].to_numpy() == pytest.approx(holm(family["p"].to_numpy()))
        assert set(family["family"]) == {4}  # 3 pairs in one scenario, 1 in the other


def test_pos_rises_from_nothing_to_the_recall(reported, table):
    out, _ = reported
    curves = pl.read_csv(out / "figures" / "pos-calm.csv")
    for (label,), curve in curves.group_by("configuration"):
        pos = curve.sort("time_s")["pos_mean"].to_numpy()
        assert pos[0] == 0.0
        assert (np.diff(pos) >= 0).all()
        n_c = {"n_c = 1": 1.0, "n_c = 3": 3.0, "n_c = ∞": math.inf}[str(label)]
        recall = table.filter((pl.col("scenario") == "calm") & (pl.col(N_C) == n_c))["recall"].mean()
        assert pos[-1] == pytest.approx(recall)
        assert (curve["pos_low"] <= curve["pos_mean"] + 1e-12).all()
        assert (curve["pos_mean"] <= curve["pos_high"] + 1e-12).all()


def test_sentences_say_the_fastest_and_how_sure(reported, table):
    _, (calm, gale) = reported
    means = table.filter(pl.col("scenario") == "calm").group_by(N_C).agg(pl.mean("mission_time_s", "recall"))
    fastest = means.filter(pl.col("recall") >= 0.95).sort("mission_time_s").row(0, named=True)
    sign = "∞" if math.isinf(fastest[N_C]) else f"{fastest[N_C]:g}"
    assert calm.startswith(f"calm: n_c = {sign} is the best: recall ")
    assert f"mission time {fastest['mission_time_s']:.1f} s (95 % CI" in calm
    assert "over 8 seeds" in calm
    assert "1 seed: no interval" in gale
    assert "not distinguishable" in gale


def test_a_report_made_twice_is_the_same(reported, tmp_path):
    out, sentences = reported
    again = write_sweep_report(load_missions(str(out.parent)), tmp_path / "again")
    assert again == sentences
    for path in sorted(p for p in out.rglob("*") if p.is_file()):
        assert (tmp_path / "again" / path.relative_to(out)).read_bytes() == path.read_bytes(), path


def test_failed_missions_are_counted_listed_and_in_no_mean(table, tmp_path):
    calm = table.filter(pl.col("scenario") == "calm")
    always = calm.filter(pl.col(N_C) == 1)["job"].to_list()
    twice = calm.filter(pl.col(N_C).is_infinite())["job"].to_list()[:2]
    missions = load_missions(str(store(failing(calm, always + twice), tmp_path / "sweep")))
    (sentence,) = write_sweep_report(missions, tmp_path / "out")
    assert sentence.startswith("calm: n_c = 3")  # a quarter of the other's failed: never called the best
    text = (tmp_path / "out/tables/statistics.md").read_text("utf-8")
    assert "| n_c = 1 | 0 | - | - | - | - | - | - | 8 / 0 |" in text
    rows = pl.read_csv(tmp_path / "out/tables/statistics.csv").filter(pl.col("metric") == "mission_time_s")
    row = rows.filter(pl.col("configuration") == "n_c = ∞").row(0, named=True)
    assert (row["n"], row["failed"]) == (6, 2)
    good = missions.table.filter(pl.col(N_C).is_infinite() & pl.col("error").is_null())
    assert row["mean"] == pytest.approx(good["mission_time_s"].mean())
    pairs = pl.read_csv(tmp_path / "out/tables/all_pairs.csv").filter(pl.col("b") == "n_c = ∞")
    assert dict(pairs.select("a", "n_pairs").iter_rows()) == {"n_c = 1": 0, "n_c = 3": 6}
    html = (tmp_path / "out/report.html").read_text("utf-8")
    assert "10 missions failed" in html
    assert "no wind in the sails" in html


def test_a_sweep_that_still_runs_with_missions_cut_short(table, tmp_path):
    calm = table.filter(pl.col("scenario") == "calm")
    cut = calm.with_columns(completed=~pl.col(N_C).is_infinite())
    parts = tmp_path / "sweep/parts"
    parts.mkdir(parents=True)
    (tmp_path / "sweep/spec.yaml").write_text("")
    jobs = cut.select("job", "scenario", "strategy", "seed", "sensor", N_C, "config_hash")
    outcomes = cut.drop("job", "strategy", "seed", "sensor", N_C)
    late = failing(outcomes.with_columns(job=cut["job"]), [11]).drop("job")[10:]
    for part in (late, outcomes[:12]):
        content = io.BytesIO()
        part.write_parquet(content)
        (parts / f"{sha256(content.getvalue())}.parquet").write_bytes(content.getvalue())
    missions = load_missions(str(tmp_path / "sweep"), lambda spec: jobs)
    assert missions.table["job"].to_list() == list(range(24))
    assert not len(missions.failed)  # the mission that failed in one part was flown again in the other
    unfinished, sentence = write_sweep_report(missions, tmp_path / "out")
    assert unfinished.startswith("The sweep is not finished")
    assert not sentence.startswith("calm: n_c = ∞")
    html = (tmp_path / "out/report.html").read_text("utf-8")
    assert "The sweep is not finished" in html
    assert "8 missions ended before the search was finished" in html


def test_what_the_sweep_command_has_so_far(tmp_path):
    spec = parse_spec(
        yaml.safe_dump(
            {"name": "so far", "scenarios": ["clusters"], "parameters": {"search.n_c": [1, 5]}, "seeds": 3}
        ),
        "x.yaml",
    )
    matrix = matrix_of(spec)
    store = MissionStore(Folder(tmp_path / "sweep"))
    store.write_spec(dump_spec(spec))
    store.append([fly_job(matrix.job(k)) for k in (0, 1)])
    store.append([fly_job(matrix.job(k)) for k in (2,)])
    result = CliRunner().invoke(app, ["report", str(tmp_path / "sweep")])
    assert result.exit_code == 0, result.stderr
    assert "clusters: " in result.stdout
    assert "not finished" in result.stdout
    html = (tmp_path / "sweep/report/report.html").read_text("utf-8")
    assert "3 missions, 1 scenario, 2 configurations, 2 seeds" in html
    assert "not finished" in html


def test_a_folder_anywhere(table, tmp_path):
    store(table, tmp_path / "here")
    with fsspec.open("memory://there/missions.parquet", "wb") as file:
        file.write((tmp_path / "here/missions.parquet").read_bytes())
    assert load_missions("memory://there").table.equals(load_missions(str(tmp_path / "here")).table)
    result = CliRunner().invoke(app, ["report", "memory://there"])
    assert result.exit_code == 2
    assert "--out" in result.stderr


def test_a_sweep_without_truth_reports_its_times(tmp_path):
    table = fly_sweep({"bare": tiny_scenario(targets=[], distractors=[])}, {"search.n_c": [1, 2]}, 2)
    assert table["false_positives"].null_count() == len(table)
    store(table, tmp_path / "sweep")
    (sentence, *_) = write_sweep_report(load_missions(str(tmp_path / "sweep")), tmp_path / "report")
    assert "recall" not in sentence
    assert (tmp_path / "report" / "report.html").is_file()


def test_a_comparison_that_was_interrupted_is_told_so_far_and_tells_scan_only_from_n_c(tmp_path):
    ways = [("scan-check", 5.0), ("scan-check", math.inf), ("scan-only", 5.0)]
    scenarios = [tiny_scenario(search={"strategy": strategy, "n_c": n_c}) for strategy, n_c in ways]
    matrix = Matrix.of([("tiny", s) for s in scenarios], range(3), "statistical", ["search.n_c"])
    store = MissionStore(Folder(tmp_path))
    for jobs in ((4, 7, 2), (8, 6), (5, 3)):
        store.append([fly_job(matrix.job(k)) for k in jobs], matrix.table())
    so_far = load_missions(str(tmp_path))
    assert not so_far.finished
    flown_there = by_scenario(so_far)["tiny"]
    assert [f.label for f in flown_there] == ["scan-check, n_c = 5", "scan-check, n_c = ∞", "scan-only"]
    assert [f.seeds.tolist() for f in flown_there] == [[1, 2], [1, 2], [0, 1, 2]]
    store.finish_all()
    whole = load_missions(str(tmp_path))
    assert whole.finished
    assert by_scenario(whole)["tiny"][2].values["recall"].tolist() == flown_there[2].values["recall"].tolist()


def test_comparisons_with_different_parameters_are_not_mixed(tmp_path):
    store = MissionStore(Folder(tmp_path))
    for wind_mps in (1.0, 2.0):
        scenario = tiny_scenario(wind={"mean_speed_mps": wind_mps})
        matrix = Matrix.of([("tiny", scenario)], [0], "statistical", ["search.n_c"])
        store.append([fly_job(matrix.job(0))], matrix.table())
    with pytest.raises(UserError, match="a comparison with other parameters another --out"):
        load_missions(str(tmp_path))


@pytest.mark.parametrize(
    ("prepare", "says"),
    [
        (lambda f, t: None, "there is no such folder"),
        (lambda f, t: f.mkdir(), "holds no missions"),
        (lambda f, t: store(failing(t, t["job"].to_list()), f), "all 26 missions failed"),
        (lambda f, t: store(t[:0], f), "empty"),
        (lambda f, t: store(t.drop("recall"), f), "no column 'recall'"),
        (lambda f, t: store(t.with_columns(seed=pl.lit(1)), f), "is in the table twice"),
        (lambda f, t: (f.mkdir(), (f / "missions.parquet").write_text("?")), "not a Parquet table"),
        (lambda f, t: (f.mkdir(), (f / "missions.jsonl").write_text("")), "of an older skysweep"),
    ],
)
def test_bad_folders_are_one_sentence(prepare, says, table, tmp_path):
    prepare(tmp_path / "sweep", table)
    result = CliRunner().invoke(app, ["report", str(tmp_path / "sweep")])
    assert result.exit_code == 2
    assert says in result.stderr
    assert len(result.stderr.strip().splitlines()) == 1
    assert not (tmp_path / "sweep/report").exists()


def test_the_command(table, tmp_path):
    store(table.filter(pl.col("scenario") != "calm"), tmp_path / "sweep")
    result = CliRunner().invoke(app, ["report", str(tmp_path / "sweep"), "--min-recall", "0.5"])
    assert result.exit_code == 0, result.stderr
    assert "gale & co: " in result.stdout
    assert (tmp_path / "sweep/report/report.html").exists()
    (tmp_path / "file").write_text("")
    result = CliRunner().invoke(app, ["report", str(tmp_path / "sweep"), "--out", str(tmp_path / "file")])
    assert result.exit_code == 2
    assert "choose another" in result.stderr


def flown(
    time_s: list[float],
    recall: list[float] | float = 1.0,
    strategy: str = "scan-check",
    false_positives: list[float] | float = 0.0,
    **parameters: float,
) -> Flown:
    """A configuration whose numbers are given, for computing by hand."""
    times = np.array(time_s, dtype=float)
    configuration = Configuration(strategy, tuple((f"search.{k}", v) for k, v in parameters.items()))
    values = {
        "mission_time_s": times,
        "recall": np.broadcast_to(np.asarray(recall, dtype=float), times.shape),
        "false_scans": np.zeros_like(times),
        "false_positives": np.broadcast_to(np.asarray(false_positives, dtype=float), times.shape),
    }
    label = configuration.label(with_strategy=False)
    return Flown(configuration, label, np.arange(len(times)), values, (), 0, 0)


def verdict_of(*members: Flown, min_recall: float = 0.95) -> str:
    return verdict(analyse({"here": members}, min_recall)[0], min_recall)


NOISE = np.random.default_rng(0).normal(size=30)


def test_verdict_faster():
    text = verdict_of(flown(300 + NOISE, n_c=5), flown(310 + 2 * NOISE, n_c=1))
    assert text.startswith(
        "here: n_c = 5 is the best: recall 1.000 (with every seed), false positives 0.00 (with every seed), "
        "mission time "
    )
    assert re.search(
        r"it is (9\.\d|10\.\d) s \(95 % CI .* 30 common seeds\) faster than the runner-up n_c = 1", text
    )
    assert "corrected p < 0.001" in text


def test_verdict_not_distinguishable():
    text = verdict_of(
        flown(300 + NOISE, n_c=5), flown(300.05 + NOISE[::-1], n_c=1), flown(400 + NOISE, n_c=2)
    )
    assert "not distinguishable from the runner-up n_c = 1" in text
    assert "from 1 of the 2 others with recall and false positives that are as good" in text


def test_verdict_equal_with_every_seed():
    text = verdict_of(flown(300 + NOISE, n_c=5), flown(300 + NOISE, n_c=7))
    assert "not distinguishable from the runner-up n_c = 7: equal with each of 30 common seeds" in text


def test_verdict_too_few_seeds():
    text = verdict_of(flown([300, 301, 302, 303], n_c=5), flown([400, 402, 404, 405], n_c=1))
    assert re.search(r"runner-up n_c = 1 is 101\.\d s .* slower, but these are too few seeds to tell: ", text)
    assert "at least 6 common seeds are needed" in text
    assert "not distinguishable" not in text


def test_verdict_too_few_seeds_after_correction():
    others = [flown(np.arange(8) + 100.0 * k, n_c=k) for k in (5, 6, 7, 8)]
    text = verdict_of(flown(NOISE[:8] - 170, n_c=1), *others)
    needed = pairs_needed(10)
    assert needed == 9
    assert "too few seeds to tell after correcting for 10 comparisons: at least 9 common seeds" in text


def test_a_difference_that_only_the_correction_hides_is_no_contradiction():
    rng = np.random.default_rng(1)
    gaps = np.where(np.arange(20) < 7, -30.0, 60.0) + NOISE[:20]
    members = [flown(300 + np.zeros(20), n_c=5), flown(300 + gaps, n_c=1)]
    members += [flown(900 + rng.normal(size=20), n_c=10 + k) for k in range(10)]
    (analysis,) = analyse({"here": members})
    runner_up = analysis.compare(MISSION_TIME, 1, 0)
    assert not runner_up.too_few
    assert runner_up.test.low > 0
    assert runner_up.undecided
    text = verdict(analysis)
    assert "not distinguishable from the runner-up" not in text
    (needed,) = re.findall(r"after correcting for 66 comparisons: at least (\d+) common seeds", text)
    assert int(needed) > 20


def test_verdict_other_seeds():
    other = flown(310 + NOISE, n_c=1)
    apart = Flown(other.configuration, other.label, other.seeds + 100, other.values, (), 0, 0)
    assert "flown on other seeds" in verdict_of(flown(300 + NOISE, n_c=5), apart)


def test_verdict_recall_first():
    quick, sure = flown(200 + NOISE, recall=0.8, n_c=9), flown(300 + NOISE, n_c=1)
    for floor in (0.95, 0.7):
        text = verdict_of(quick, sure, min_recall=floor)
        assert "here: n_c = 1 is the best" in text
        assert "no other configuration has recall and false positives that are as good" in text
        assert "n_c = 9 is faster but finds less: recall 0.800 (with every seed), false positives" in text
    assert "no configuration reaches a mean recall of 0.95" in verdict_of(quick)
    assert "highest recall is that of n_c = 9: recall 0.800 (with every seed)" in verdict_of(quick)


def test_a_mean_recall_of_exactly_the_least_is_enough():
    recall = [0.9, 1.0] * 10
    assert np.mean(recall) < 0.95
    assert "n_c = 1 is the best" in verdict_of(
        flown([300.0] * 20, recall, n_c=1), flown([400.0] * 20, recall, n_c=2)
    )


def test_verdict_says_who_is_left_out_for_missions_without_an_end():
    sure, quick = flown(900 + NOISE, recall=1.0, n_c=1), flown(300 + NOISE, recall=0.96, n_c=9)
    worse = flown(800 + NOISE, recall=0.97, n_c=2)
    assert "left out" not in verdict_of(sure, quick)
    battery = replace(sure, n_unfinished=14)
    text = verdict_of(battery, quick)
    assert "n_c = 9 is the best" in text
    assert "no other configuration that finishes its missions has recall and false positives that" in text
    assert "n_c = 1 is left out, as 14 of its 30 missions failed or were not finished: recall 1.000" in text
    assert "So is" not in text
    assert verdict_of(battery, quick, replace(worse, n_failed=9)).endswith("30 seeds. So is 1 other.")
    failed = Flown(
        sure.configuration, sure.label, sure.seeds[:0], {k: v[:0] for k, v in sure.values.items()}, (), 30, 0
    )
    text = verdict_of(failed, quick)
    assert text.endswith("n_c = 1 is left out, as 30 of its 30 missions failed or were not finished.")


def test_who_finishes_too_few_missions_is_not_on_the_front():
    whole = flown(300 + NOISE, n_c=1)
    cut = replace(flown(150 + NOISE, n_c=5), n_unfinished=30)
    (analysis,) = analyse({"here": (whole, cut)}, 0.95)
    assert [m.on_front for m in analysis.members] == [True, False]
    assert analysis.members[0].front_share == 1.0


def test_verdict_never_says_that_who_found_more_finds_less():
    """Recall is told from the highest mean, which may be another's than that of the best."""
    highest = flown(400 + NOISE, recall=1.0 - 0.02 * (NOISE > 1), n_c=1)
    noisy = flown(300 + NOISE, recall=np.where(np.arange(30) % 10 == 0, 0.5, 1.0), n_c=5)
    steady = flown(200 + NOISE, recall=0.98, n_c=8)
    text = verdict_of(highest, noisy, steady)
    assert "here: n_c = 5 is the best: recall 0.950" in text
    assert "finds less" not in text


COUNTS = (np.arange(30) % 3).astype(float)  # 0, 1, 2, on average 1


def test_verdict_false_positives_before_time():
    quick = flown(100 + NOISE, false_positives=COUNTS + 12, n_c=9)
    quiet = flown(400 + NOISE, false_positives=COUNTS, n_c=1)
    slow = flown(500 + NOISE, false_positives=COUNTS[::-1], n_c=2)
    text = verdict_of(quick, quiet, slow)
    assert text.startswith("here: n_c = 1 is the best: ")
    assert "false positives 1.00 (95 % CI" in text
    assert "faster than the runner-up n_c = 2" in text
    assert "n_c = 9 is faster but has more false positives: recall 1.000 (with every seed), false" in text
    assert "false positives 13.00 (95 % CI" in text


def test_verdict_time_decides_between_equals():
    text = verdict_of(
        flown(
            142 + NOISE, recall=1.0 - 0.125 * (COUNTS[::-1] == 2) * (NOISE > 1), false_positives=COUNTS, n_c=9
        ),
        flown(312 + NOISE, false_positives=COUNTS[::-1], n_c=1),
    )
    assert text.startswith("here: n_c = 9 is the best: ")
    assert "faster than the runner-up n_c = 1" in text


def test_verdict_says_when_the_seeds_are_too_few_to_weigh():
    quick, quiet = flown([100, 101, 102], false_positives=9.0, n_c=9), flown([400, 401, 402], n_c=1)
    text = verdict_of(quick, quiet)
    assert "here: n_c = 9 is the best" in text
    assert "too few seeds to weigh recall and false positives: at least 6 common seeds are needed" in text


@given(
    st.lists(
        st.tuples(st.integers(100, 400), st.sampled_from([0.96, 0.98, 1.0]), st.integers(0, 9)),
        min_size=1,
        max_size=5,
    )
)
@settings(max_examples=25)
def test_the_best_is_the_rule(rows):
    """By means alone, where every seed gives the same and so every difference is distinguishable."""
    members = [
        flown([float(t)] * 30, recall=r, false_positives=float(f), n_c=k + 1.0)
        for k, (t, r, f) in enumerate(rows)
    ]
    (analysis,) = analyse({"here": members})
    assert sorted(analysis.ranking) == list(range(len(rows)))
    t, r, f = rows[analysis.ranking[0]]
    assert (-r, f, t) == min((-r, f, t) for t, r, f in rows)


def test_the_rule_is_on_the_page_and_in_the_help(reported):
    out, _ = reported
    page = (out / "report.html").read_text("utf-8")
    help_text = " ".join(CliRunner().invoke(app, ["report", "--help"], terminal_width=200).stdout.split())
    docs = " ".join((Path(__file__).parents[2] / "docs/statistics.md").read_text("utf-8").split())
    rule = (
        "not distinguishable from the highest; of these, those whose false positives are not distinguishable"
    )
    for text in (page, help_text.replace("│ ", ""), docs):
        assert rule in text
    assert best_rule().startswith("The best: ")
    assert best_rule() in page


def test_verdict_one_configuration():
    assert "one configuration was flown (n_c = 5): recall 1.000 (with" in verdict_of(
        flown(300 + NOISE, n_c=5)
    )


def test_comparisons_turn_around():
    (analysis,) = analyse({"here": [flown(300 + NOISE, n_c=5), flown(310 + 2 * NOISE, n_c=1)]})
    forth, back = analysis.compare(MISSION_TIME, 0, 1), analysis.compare(MISSION_TIME, 1, 0)
    assert forth.test.mean == pytest.approx(-back.test.mean)
    assert (forth.test.low, forth.test.high) == (-back.test.high, -back.test.low)
    assert forth.p_holm == back.p_holm


def test_sensitivity_one_curve_for_each_setting_of_the_others():
    members = [
        flown([10 * n_c + d_c] * 3, n_c=n_c, d_c_m=d_c) for n_c in (5, math.inf, 1) for d_c in (40, 80)
    ]
    curves = sensitivity(members, "search.n_c")
    assert [c.label for c in curves] == ["d_c = 40 m", "d_c = 80 m"]
    assert [c.values for c in curves] == [(1, 5, math.inf)] * 2
    assert [e.mean for e in curves[1].estimates["mission_time_s"][:2]] == [90, 130]
    assert sensitivity(members, "search.sidelap") == []


def test_sensitivity_of_a_large_grid_averages_what_was_flown_at_every_value():
    members = [
        flown([10.0 * n_c + d_c], n_c=n_c, d_c_m=d_c)
        for n_c in (1, 2)
        for d_c in range(10)
        if (n_c, d_c) != (2, 9)
    ]
    (curve,) = sensitivity(members, "search.n_c")
    assert curve.averaged_over == 9  # d_c = 9 was not flown at n_c = 2
    assert [e.mean for e in curve.estimates["mission_time_s"]] == [14, 24]


def test_labels(table):
    groups = by_scenario(load_missions_of(table))
    assert {s: [f.label for f in flown] for s, flown in groups.items()} == {
        "calm": ["n_c = 1", "n_c = 3", "n_c = ∞"],
        "gale & co": ["n_c = 1", "n_c = ∞"],
    }
    assert field_name("search.scan_altitude_agl_m") == "h_S"
    assert (field_name("wind.mean_speed_mps"), field_unit("wind.mean_speed_mps")) == (
        "wind mean speed",
        "m/s",
    )
    assert in_order([math.inf, 3, 1.5]) == [1.5, 3, math.inf]
    named = Configuration("low-only", (("search.d_c_m", 60.0), ("terrain.surface", "grass"), ("a.b", True)))
    assert named.label(with_strategy=True) == ("low-only, d_c = 60 m, terrain surface = grass, a b = true")


def test_a_value_that_a_strategy_never_changes_is_not_in_its_label(table):
    baseline = table.filter(pl.col("scenario") == "calm", pl.col(N_C) == 3).with_columns(
        pl.col("job") + 1000, strategy=pl.lit("scan-only")
    )
    both = pl.concat([table.filter(pl.col("scenario") == "calm"), baseline])
    labels = [f.label for f in by_scenario(load_missions_of(both))["calm"]]
    assert labels == [f"scan-check, n_c = {n}" for n in ("1", "3", "∞")] + ["scan-only"]


def load_missions_of(table: pl.DataFrame):
    with fsspec.open("memory://labels/missions.parquet", "wb") as file:
        table.write_parquet(file)
    return load_missions("memory://labels")


def test_text_for_papers(reported):
    assert latex_text("n_c = ∞, a_b & 5 % -3") == r"$n_c$ = $\infty$, a\_b \& 5 \% $-$3"
    assert math_text("h_S = 30 m, $") == r"$h_S$ = 30 m, \$"
    assert markdown(Grid(["a", "b"], [["x|y", "1\n(2)"]], "T"), left=1) == (
        "**T**\n\n| a | b |\n| :--- | ---: |\n| x\\|y | 1 (2) |\n"
    )
    out, _ = reported
    tex = (out / "tables/statistics.tex").read_text("utf-8")
    assert tex.isascii()
    assert tex.count("\\begin{table*}") == tex.count("\\end{table*}") == tex.count("\\bottomrule") == 2
    for line in tex.splitlines():
        if line.endswith("\\\\"):
            assert len(re.findall(r"(?<!\\)&", line)) == 7
    assert "gale \\& co" in tex


def missions_of(*rows: tuple[str, int, float, float | None]) -> pl.DataFrame:
    """Of configuration, seed, mission time and recall; without a recall it failed."""
    return pl.DataFrame(
        [
            {"job": job, "scenario": "s", "strategy": strategy, "seed": seed}
            | {"completed": True, "mission_time_s": time_s, "recall": recall, "false_positives": 0.0}
            | {"error": None}
            if recall is not None
            else {"job": job, "scenario": "s", "strategy": strategy, "seed": seed, "error": "boom"}
            for job, (strategy, seed, time_s, recall) in enumerate(rows)
        ],
        infer_schema_length=None,
    )


def test_who_lost_the_hardest_world_is_not_the_better_for_it():
    """B finds more and is faster with every seed; A failed in the one hard world, and B's mean counts it."""
    rng = np.random.default_rng(0)
    rows = []
    for seed in range(30):
        recall = 0.5 if seed == 0 else 0.97 + rng.choice([0.0, 0.005])
        rows.append(("A", seed, 320.0 + rng.normal(), None if seed == 0 else recall))
        rows.append(("B", seed, 300.0 + rng.normal(), recall + 0.01))
    found = analyse(by_scenario(Missions("x", missions_of(*rows), True)))[0]
    assert found.members[found.ranking[0]].label == "B"


def test_one_seed_more_makes_none_slower():
    rng, rows = np.random.default_rng(0), []
    for seed in range(12):
        rows += [
            (strategy, seed, time_s + 20.0 * seed + rng.normal(0.0, 0.2), 1.0)
            for strategy, time_s in (("A", 301.0), ("B", 300.0))
            if (strategy, seed) != ("A", 11)
        ]
    said = verdict(analyse(by_scenario(Missions("x", missions_of(*rows), False)))[0])
    assert "B is the best" in said
    assert re.search(r"it is 0\.\d s .* faster than the runner-up A", said)
