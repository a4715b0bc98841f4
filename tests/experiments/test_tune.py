"""Tuning: honest racing, constraints that are kept, studies that survive a kill, recommendations that fly."""

import json
import math
import multiprocessing
import re
import signal
import sqlite3
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path

import numpy as np
import polars as pl
import psutil
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

import skysweep
from skysweep.errors import UserError
from skysweep.experiments.tune import study as tune_study
from skysweep.experiments.tune.race import (
    Outcomes,
    RaceRules,
    best_first,
    blocks,
    clearly_worse_by_s,
    incumbents,
    why_dropped,
)
from skysweep.experiments.tune.report import Tuned, how_sure, matters_grid, recommendation_rule
from skysweep.experiments.tune.run import Problem, family_of, search
from skysweep.experiments.tune.space import (
    CHECK_SPEED,
    D_C,
    H_C,
    H_S,
    N_C,
    TUNED,
    Parameter,
    changed_space,
    default_space,
    value_at,
)
from skysweep.experiments.tune.validate import (
    candidates_of,
    effects,
    fly_candidates,
    matters_candidates,
    matters_table,
    paired,
    standings,
)
from skysweep.planning.advice import warnings_for
from skysweep.scenarios.files import change_scenario, load_scenario, parse_scenario
from warm import run_skysweep

TUNE = [sys.executable, "-m", "skysweep.cli", "tune"]
TINY = """\
name: tiny
area: {polygon_enu_m: [[0, 0], [40, 0], [40, 25], [0, 25]]}
camera: {hfov_rad: 1.4}
search: {n_c: 1, scan_altitude_agl_m: 25, check_altitude_agl_m: 6, check_speed_mps: 4, sidelap: 0.1}
targets:
  - {class: stop sign, position_enu_m: [20, 12], size_m: 0.9}
"""
FEW = ["--fix", D_C, "--fix", "search.sidelap", "--fix", H_C, "--fix", H_S, "--fix", "search.scan_speed_mps"]
QUICK = [*FEW, "--workers", "1", "--no-matters"]


@pytest.fixture
def scenario_file(tmp_path):
    path = tmp_path / "tiny.yaml"
    path.write_text(TINY)
    return path


def tiny(**changes):
    return change_scenario(parse_scenario(TINY, "tiny.yaml"), changes)


def tune(*arguments):
    return run_skysweep("tune", *arguments, timeout_s=900)


def problem(*space, scenario=None, **others):
    given_scenario = scenario or tiny()
    settings = {"rules": RaceRules(), "seeds": 8} | others
    overlays = ({"scenario": "tiny", "set": {}},)
    return Problem("tiny", (family_of(given_scenario, None),), (given_scenario,), overlays, space, **settings)


def flown(times_s, recall=1.0, false_positives=0.0, targets=8, completed=1.0):
    n = len(times_s)
    rows = np.column_stack(
        [
            times_s,
            np.broadcast_to(recall, n),
            np.broadcast_to(false_positives, n),
            np.zeros(n),
            np.full(n, targets),
            np.round(np.broadcast_to(recall, n) * targets),
            np.broadcast_to(completed, n),
            np.zeros(n),
        ]
    )
    return Outcomes(rows[:, None, :])


# the space


@pytest.mark.parametrize("name", ["clusters", "maritime"])
def test_default_values_are_sensible_and_hold_the_scenarios_own(name):
    scenario = load_scenario(name)
    space = {p.field: p.values for p in default_space([scenario])}
    assert tuple(space) == TUNED
    assert space[N_C][-1] == space[D_C][-1] == math.inf
    assert space[H_C][-1] < space[H_S][0]
    for field, values in space.items():
        own = value_at(scenario, field)
        assert own in values
        assert list(values) == sorted(set(values))
        assert len(values) > 5
        if field in (H_S, H_C):
            for value in values:
                warned = warnings_for(change_scenario(scenario, {field: value}))
                assert value == own or not any(w.startswith(field) for w in warned)


def test_checks_are_not_tuned_below_the_floor_of_descents():
    low = change_scenario(load_scenario("sparse"), {"search.check_altitude_agl_m": 6.0})
    higher = change_scenario(low, {"safety.descent_floor_agl_m": 5.0})
    lowest = [min({p.field: p.values for p in default_space([s])}[H_C]) for s in (low, higher)]
    assert lowest[0] < 5.0
    assert lowest[1] == 5.0


def test_together_means_values_that_suit_all():
    scenarios = [load_scenario("clusters"), load_scenario("person-wilderness")]
    space = {p.field: p.values for p in default_space(scenarios)}
    alone = [{p.field: p.values for p in default_space([s])} for s in scenarios]
    assert space[H_S][0] == max(a[H_S][0] for a in alone)
    assert space[H_S][-1] == min(a[H_S][-1] for a in alone)


def test_ranges_and_fixed_values():
    scenario = tiny()
    ranges = ["search.n_c=1:4,inf", "search.c_t=0.5:0.7"]
    space, settings = changed_space(
        default_space([scenario]), [scenario], ranges, ["search.sidelap", "search.d_c_m=30"]
    )
    values = {p.field: p.values for p in space}
    assert values[N_C] == (1, 2, 3, 4, math.inf)
    assert values["search.c_t"][0] == 0.5
    assert values["search.c_t"][-1] == 0.7
    assert not {"search.sidelap", D_C} & set(values)
    assert settings == {D_C: 30.0}


def test_a_whole_number_has_whole_values():
    scenario = tiny()
    space, _ = changed_space([], [scenario], ["detector.tiles=1:3", "vehicle.batteries=1:10"], [])
    assert [p.values for p in space] == [(1, 2, 3), tuple(range(1, 11))]


@pytest.mark.parametrize(
    ("ranges", "fixed", "words"),
    [
        (["detector.tiles=1,2.5,3"], [], ["detector.tiles: is 2.5"]),
        (["search.nc=1:3"], [], ["search.nc", "did you mean 'search.n_c'?"]),
        (["h_s=10:20"], [], ["h_s", "there is no parameter"]),
        (["search.n_c=4:2"], [], ["search.n_c=4:2", "empty"]),
        (["search.n_c=3"], [], ["empty", "--fix search.n_c"]),
        (["search.n_c="], [], ["empty"]),
        (["search.d_c_m=10:inf"], [], ["inf on its own"]),
        (["search.d_c_m=1e-300:1e300"], [], ["search.d_c_m=1e-300:1e300", "more than 1,000 values"]),
        (["search.n_c=1:1e9"], [], ["search.n_c=1:1e9", "more than 1,000 values"]),
        (["search.n_c=one:two"], [], ["'one' is not a number"]),
        (["search.c_t=0.5:1.5"], [], ["search.c_t", "less than 1"]),
        (["search.check_altitude_agl_m=3:60"], [], ["not below the lowest scan altitude"]),
        (["search.n_c=1:3"], ["search.n_c"], ["--fix search.n_c", "leave out one"]),
        ([], ["search.n_c=-2"], ["search.n_c", "greater than 0"]),
        ([], list(TUNED), ["nothing is left to tune"]),
        (["search.scan_altitude_agl_m=60:115"], [], ["altitude_agl_m 115", "The sensor model was"]),
    ],
)
def test_bad_ranges_are_one_clear_sentence(ranges, fixed, words):
    scenario = tiny()
    with pytest.raises(UserError) as refused:
        changed_space(default_space([scenario]), [scenario], ranges, fixed)
    for word in words:
        assert word in str(refused.value)


# the race


def test_blocks_double_until_all_seeds():
    assert blocks(32) == [4, 8, 16, 32]
    assert blocks(20) == [4, 8, 16, 20]
    assert blocks(4) == [4]


@given(
    st.lists(st.floats(100, 900), min_size=2, max_size=12),
    st.floats(-50, 50),
    st.integers(0, 1000),
)
def test_what_a_seed_makes_hard_for_both_drops_out(shared, gap, seed):
    rng = np.random.default_rng(seed)
    mine, best = rng.normal(gap, 5, len(shared)), rng.normal(0, 5, len(shared))
    alone = clearly_worse_by_s(mine, best)
    together = clearly_worse_by_s(mine + shared, best + shared)
    assert together == pytest.approx(alone, abs=1e-6)


def test_a_good_candidate_is_rarely_dropped_and_a_bad_one_soon():
    rng = np.random.default_rng(1)
    world = rng.normal(400, 60, (2000, 4))
    best = world + rng.normal(0, 10, world.shape)
    equal, bad = world + rng.normal(0, 10, world.shape), world + rng.normal(60, 10, world.shape)
    dropped_equal = np.mean([clearly_worse_by_s(a, b) > 0 for a, b in zip(equal, best, strict=True)])
    dropped_bad = np.mean([clearly_worse_by_s(a, b) > 0 for a, b in zip(bad, best, strict=True)])
    assert dropped_equal < 0.02
    assert dropped_bad > 0.85


def test_why_dropped():
    rules, best = RaceRules(), flown([300, 310, 290, 305, 300, 300, 300, 300])
    assert why_dropped(flown([305, 300, 295, 300]), [best], rules) is None
    assert "clearly worse" in why_dropped(flown([400, 412, 385, 405]), [best], rules)
    assert "recall" in why_dropped(flown([200] * 4, recall=0.25), [best], rules)
    assert why_dropped(flown([200] * 4, recall=7 / 8), [best], rules) is None, "4 missions prove nothing"
    assert "before the search was finished" in why_dropped(flown([90] * 4, completed=0.0), [best], rules)
    costly = flown([290, 301, 282, 294], false_positives=2.0)
    assert "clearly worse" in why_dropped(costly, [best], rules)
    assert why_dropped(costly, [best], RaceRules(false_positive_cost_s=0.0)) is None


def test_with_recall_as_an_objective_a_slower_candidate_that_finds_more_stays():
    rules = RaceRules(min_recall=None)
    fast = flown([200, 210, 190, 205], recall=0.5)
    thorough = flown([300, 312, 288, 303], recall=1.0)
    assert why_dropped(thorough, [fast], rules) is None
    assert "clearly worse" in why_dropped(flown([300, 312, 288, 303], recall=0.5), [fast], rules)
    assert len(incumbents([fast, thorough], rules)) == 2
    assert best_first([fast, thorough], rules) == [1, 0]


def test_best_first_keeps_recall_before_time():
    slow, fast = flown([400.0] * 4), flown([200.0] * 4, recall=0.5)
    unfinished = flown([100.0] * 4, completed=0.0)
    assert best_first([fast, unfinished, slow], RaceRules()) == [2, 0, 1]
    assert incumbents([fast], RaceRules()) == []
    poor, poorer = flown([400.0] * 4, recall=0.875), flown([100.0] * 4, recall=0.25)
    assert best_first([poorer, poor], RaceRules()) == [1, 0], (
        "nobody reaches 0.95: the most found comes first"
    )


def test_paired_says_how_sure():
    same = paired(np.zeros(20))
    assert same.probability_below == 0.5
    assert not same.is_clear
    better = paired(np.linspace(-12.0, -2.0, 20))
    assert better.probability_below == 1.0
    assert better.is_clear


# real missions


def test_a_clearly_bad_trial_is_dropped_early_and_repeats_are_not_flown_again(tmp_path):
    wanted = problem(Parameter(CHECK_SPEED, (0.2, 4.0)), seeds=16)
    trials = search(wanted, f"sqlite:///{tmp_path}/study.db", "tiny", 10, workers=1)
    assert [t.number for t in trials] == list(range(10))
    own, *others = trials
    assert own.values == {CHECK_SPEED: 4.0}
    assert len(own.missions) == 16
    bad = next(t for t in others if t.values == {CHECK_SPEED: 0.2})
    assert len(bad.missions) == 4
    assert "clearly worse" in bad.dropped
    assert all(t.same_as is not None for t in others if t is not bad)
    assert sum(len(t.missions) for t in trials if t.same_as is None) == 20


def test_the_recall_constraint_is_respected(tmp_path):
    wanted = problem(Parameter(H_S, (25.0, 120.0)))
    trials = search(wanted, f"sqlite:///{tmp_path}/study.db", "tiny", 10, workers=1)
    by_altitude = {t.values[H_S]: t for t in trials if t.same_as is None}
    assert set(by_altitude) == {25.0, 120.0}
    low, high = (by_altitude[h].flown(1) for h in (25.0, 120.0))
    assert high.mean("recall") < 0.5
    assert "recall" in by_altitude[120.0].dropped
    candidates = candidates_of(wanted, trials)
    result = standings(candidates, fly_candidates(wanted.scenarios, candidates, 4, tmp_path, 1), wanted.rules)
    assert result[0].recall.mean >= 0.95
    assert all(s.candidate.changes.get(H_S, 25.0) == 25.0 for s in result)
    assert low.mean("recall") >= 0.95


@pytest.mark.parametrize(
    ("altitude_m", "recall"),
    [(25.0, "at least 0.95 in every scenario"), (120.0, "within 0.01 of the highest")],
)
def test_the_rule_that_is_told_is_the_one_that_chose(altitude_m, recall, tmp_path):
    """Where nothing reached the recall, what was recommended was said to have reached it."""
    wanted = problem(Parameter(CHECK_SPEED, (2.0, 4.0)), scenario=tiny(**{H_S: altitude_m}), seeds=4)
    candidates = candidates_of(wanted, [])[:1]
    flown_fresh = fly_candidates(wanted.scenarios, candidates, 4, tmp_path, 1)
    tuned = Tuned(wanted, [], standings(candidates, flown_fresh, wanted.rules), {})
    assert f"a mean recall of {recall}" in recommendation_rule(tuned)
    assert ("NOTHING tried reached recall 0.95" in " ".join(how_sure(tuned))) == ("within" in recall)


def test_trials_that_flew_the_same_missions_are_one_finalist(tmp_path):
    """With n_c = 1 d_c changes nothing: the runner-up was the best once more, "the same in every mission"."""
    wanted = problem(Parameter(D_C, (30.0, 60.0, math.inf)), scenario=tiny(**{N_C: 1}))
    trials = search(wanted, f"sqlite:///{tmp_path}/study.db", "tiny", 8, workers=1)
    assert len({t.values[D_C] for t in trials if t.dropped is None}) >= 2
    labels = [c.label for c in candidates_of(wanted, trials) if c.label.startswith("trial")]
    assert len(labels) == 1


def test_a_trial_that_is_not_what_was_written_is_refused(tmp_path):
    space = Parameter(CHECK_SPEED, (2.0, 4.0)), Parameter(N_C, (1.0, 5.0, math.inf))
    wanted, path = problem(*space), tmp_path / "study.db"
    search(wanted, f"sqlite:///{path}", "tiny", 2, workers=1)
    whole = path.read_bytes()
    longer = """replace(value_json, 's": ', 's": 1')"""
    wider = """replace(distribution_json, '"high": 1', '"high": 3')"""
    held = "UPDATE trial_system_attributes SET value_json = replace(value_json,"
    changes = {
        "UPDATE trial_values SET value = value + 1": "trial 0 is not what was written",
        f"UPDATE trial_user_attributes SET value_json = {longer}": "trial 0 is not what was written",
        "UPDATE trial_params SET param_value = 1 - param_value": "trial 0 is not what was written",
        "DELETE FROM trials WHERE number = 0": "trials are missing",
        f"UPDATE trial_params SET distribution_json = {wider}": "trial 0 is not what was written",
        f"{held} '0.0', '0.5') WHERE key = 'constraints'": "trial 0 is not what was written",
        f"{held} ': 2', ': 1')": "trial 2 is not what was written",
        "UPDATE trials SET state = 'COMPLETD'": "COMPLETD",
    }
    for change, told in changes.items():
        path.write_bytes(whole)
        with closing(sqlite3.connect(path)) as database, database:
            database.execute(change)
        tune_study._database.cache_clear()
        with pytest.raises(UserError, match=rf"study\.db: is damaged, .*{told}"):
            search(wanted, f"sqlite:///{path}", "tiny", 2, workers=1)


def test_a_study_of_another_seed_is_refused(tmp_path):
    def trials(name, seed):
        space = Parameter(CHECK_SPEED, (2.0, 4.0))
        wanted = problem(space, scenario=tiny(), seeds=4, sampler_seed=seed)
        return search(wanted, f"sqlite:///{tmp_path}/study.db", name, 1, workers=1)

    for name, own, other in (("zero", 0, 5), ("five", 5, 0)):
        assert trials(name, own) == trials(name, own)
        with pytest.raises(UserError, match=r"another problem \(differs: seed\)"):
            trials(name, other)


def test_what_was_flown_with_another_sensor_file_is_not_taken(tmp_path):
    sensor = tmp_path / "sensor.yaml"
    shipped = (Path(skysweep.__file__).parent / "sensing/statistical/visible.yaml").read_text()
    sensor.write_text(shipped)
    scenario = tiny(**{"detector.statistical_model": str(sensor)})
    wanted = problem(Parameter(CHECK_SPEED, (2.0, 4.0)), scenario=scenario, seeds=4)
    search(wanted, f"sqlite:///{tmp_path}/study.db", "tiny", 1, workers=1)
    own = candidates_of(wanted, [])[:1]
    sharp = fly_candidates([scenario], own, 1, tmp_path, 1)[0].mean("recall")
    sensor.write_text(re.sub(r"score: .*", f"score: {[-9.0] * 13}", shipped))
    with pytest.raises(UserError, match=r"another problem \(differs: sensor or plan file\)"):
        search(wanted, f"sqlite:///{tmp_path}/study.db", "tiny", 1, workers=1)
    assert sharp > fly_candidates([scenario], own, 1, tmp_path, 1)[0].mean("recall") == 0.0


def test_one_process_and_one_seed_repeat_themselves(tmp_path):
    space = [p for p in default_space([tiny()]) if p.field in (CHECK_SPEED, H_C)]
    first, second = (
        search(problem(*space, seeds=4), f"sqlite:///{tmp_path}/{name}.db", "tiny", 15, workers=1)
        for name in ("a", "b")
    )
    assert first == second
    assert len({tuple(t.values.items()) for t in first}) > 10, "beyond the first random ones too"


def test_when_it_matters(tmp_path):
    scenario = tiny(**{"search.n_c": 5.0})
    cells = matters_candidates(scenario)
    cells = [c for c in cells if c.changes[N_C] in (1, 5) and c.changes[D_C] in (5, math.inf)]
    table = matters_table(cells, fly_candidates([scenario], cells, 4, tmp_path, 1), scenario)
    assert [(c.n_c, c.d_c_m) for c in table] == [(1, None), (5, 5), (5, math.inf)]
    assert sum(c.time_over_best_s is None for c in table) == 1
    assert all(c.time_over_best_s is None or c.time_over_best_s.test.mean >= 0 for c in table)
    assert [(e.held, e.value) for e in effects(table)] == [("d_c", 5.0), ("d_c", math.inf), ("n_c", 5.0)]


def test_a_clear_interval_is_never_called_as_good_as_the_fastest():
    scenario = tiny(**{"search.n_c": 5.0})
    cells = [c for c in matters_candidates(scenario) if c.changes[D_C] == math.inf]
    few, many = (
        matters_table(
            cells, [flown(100.0 + 8.0 * k + 0.1 * np.arange(n)) for k in range(len(cells))], scenario
        )
        for n in (4, 20)
    )
    assert len(few) == 6
    assert [c.as_good for c in few] == [True, *[False] * 5]
    assert [c.undecided for c in few] == [False, *[True] * 5]
    assert [(c.as_good, c.undecided) for c in many[1:]] == [(False, False)] * 5
    grid = matters_grid("tiny", few)
    assert "+8 (8 to 8) ?" in grid.rows[1]
    assert "too few seeds to tell after correcting for 5 comparisons, at least 8 are needed" in grid.caption
    assert "?" not in str(matters_grid("tiny", many))
    equal = matters_table(cells, [flown(100.0 + 0.1 * np.arange(4))] * 6, scenario)
    assert all(c.as_good for c in equal)


def test_who_gives_up_is_not_the_fastest():
    scenario = tiny(**{"search.n_c": 5.0})
    cells = [c for c in matters_candidates(scenario) if c.changes[D_C] == math.inf]
    found = [flown(100.0 + 8.0 * k + 0.1 * np.arange(20)) for k in range(len(cells))]
    found[2] = flown(20.0 + 0.1 * np.arange(20), completed=False)
    table = matters_table(cells, found, scenario)
    assert [c.is_whole for c in table] == [k != 2 for k in range(len(cells))]
    assert all(e.best is not table[2] for e in effects(table) if len(e.others) > 1)
    grid = matters_grid("tiny", table)
    assert grid.rows[2][-1].startswith("-80 ")
    assert grid.rows[2][-1].endswith(" *")
    assert grid.caption.endswith(
        "; * not every search was finished, or recall is lower than that of the best"
    )


def test_the_command_end_to_end(tmp_path, scenario_file):
    out = tmp_path / "out"
    arguments = [scenario_file, *FEW, "--trials", 6, "--seeds", 4, "--validation-seeds", 3, "--out", out]
    result = tune(*arguments, "--workers", 1)
    assert result.returncode == 0, result.stderr
    assert "Recommended for tiny" in result.stdout
    assert "Runner-up" in result.stdout
    rule = (
        "mean recall of at least 0.95 in every scenario, the one with the least cost: mission time and 60 s"
    )
    assert rule in result.stdout
    assert ", cost +" in result.stdout
    folder = out / "tiny"
    lines = (folder / "tuning.md").read_text().splitlines()
    cells = {cell.strip() for line in lines if line.startswith("| ") for cell in line.split("|")}
    figures = re.findall(r"^\| (?:trial|own).*", "\n".join(lines), re.M)
    assert len(figures) >= 2
    for row in figures:
        assert len(re.findall(r"[\d.]+ \([\d.]+ to [\d.]+\)", "|".join(row.split("|")[2:5]))) == 3, row
    numbers = {part for cell in cells if cell[:1] in set("+0123456789") for part in cell.split(" (")}
    assert len(numbers) >= 15
    assert {number for number in numbers if number not in result.stdout} == set(), "cut short"
    trials = pl.read_parquet(folder / "trials.parquet")
    assert len(trials) == 6
    assert trials["seeds_used"].is_between(1, 4).all()
    told = json.loads((folder / "tuning.json").read_text())
    recommended = load_scenario(folder / "recommended.yaml")
    assert recommended.scatter_m == 0.0, "the scenario as given, only with other search parameters"
    assert recommended.search.check_speed_mps == told["recommended"][CHECK_SPEED]
    overlay = yaml.safe_load((folder / "overlay.yaml").read_text())
    assert change_scenario(load_scenario(overlay["scenario"]), overlay["set"]) == recommended
    for name in ("search.png", "search.csv", "matters-tiny.png", "matters-tiny.csv", "tuning.md"):
        assert (folder / name).stat().st_size > 100
    flight = run_skysweep(
        "run", folder / "recommended.yaml", "--sensor", "statistical", "--out", tmp_path / "run"
    )
    assert flight.returncode == 0, flight.stderr
    missions = (folder / "missions.parquet").read_bytes()
    again = tune(*arguments, "--workers", 1)
    assert again.stdout == result.stdout
    assert (folder / "missions.parquet").read_bytes() == missions, "nothing is flown twice"
    other = tune(*arguments[:-2], "--out", out, "--min-recall", 0.5)
    assert other.returncode == 2
    assert "another problem" in other.stderr
    assert "min-recall" in other.stderr


def test_killed_and_continued_it_keeps_what_was_finished(tmp_path, scenario_file):
    out = tmp_path / "out"
    arguments = [scenario_file, *QUICK, "--trials", 6, "--seeds", 8, "--validation-seeds", 0, "--out", out]
    process = subprocess.Popen([*TUNE, *map(str, arguments)], stderr=subprocess.DEVNULL)
    before = _wait_for_trials(process, out / "tiny" / "study.db", 2)
    children = psutil.Process(process.pid).children(recursive=True)
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert not psutil.wait_procs(children, timeout=20)[1], "workers end with the command that was killed"
    result = tune(*arguments)
    assert result.returncode == 0, result.stderr
    assert "6 trials" in result.stderr
    after = _trials(out / "tiny" / "study.db")
    assert len(after) == 6
    assert {number: after[number] for number in before} == before
    states = {state for (state,) in _query(out / "tiny" / "study.db", "SELECT state FROM trials")}
    assert states <= {"COMPLETE", "FAIL"}


@pytest.mark.parametrize("locks", [True, False])
def test_a_trial_that_was_never_claimed_does_not_use_up_the_budget(tmp_path, monkeypatch, locks):
    monkeypatch.setattr(tune_study, "_CLAIM_S", 0.2)
    path, space = f"sqlite:///{tmp_path}/study.db", default_space([tiny()])
    study = tune_study.TuningStudy(path, "tiny", {"a": 1}, space, RaceRules(0.95, 60.0), 0)
    study._locks = locks
    study._study.ask()  # and the process dies
    trial = study.ask(1)
    assert trial is not None
    states = _query(tmp_path / "study.db", "SELECT number, state FROM trials ORDER BY number")
    assert states == [(0, "FAIL"), (1, "RUNNING")]
    assert study.ask(1) is None, "one that is being flown is left alone"


def _first_number(path):
    study = tune_study.TuningStudy(path, "tiny", {"a": 1}, default_space([tiny()]), RaceRules(0.95, 60.0), 0)
    return study.ask(100).number


def test_processes_that_ask_at_once_are_given_different_trials(tmp_path):
    path, space = f"sqlite:///{tmp_path}/study.db", default_space([tiny()])
    study = tune_study.TuningStudy(path, "tiny", {"a": 1}, space, RaceRules(0.95, 60.0), 0)
    study.start([{p.field: p.values[k] for p in space} for k in range(3)])
    with multiprocessing.get_context("spawn").Pool(4) as pool:
        numbers = pool.map(_first_number, [path] * 12, chunksize=1)
    assert sorted(numbers) == list(range(12))


def test_two_commands_share_a_study(tmp_path, scenario_file):
    storage = f"sqlite:///{tmp_path}/shared.db"
    arguments = [scenario_file, *QUICK, "--trials", 6, "--seeds", 4, "--validation-seeds", 0]
    processes = [
        subprocess.Popen(
            [*TUNE, *map(str, [*arguments, "--storage", storage, "--out", tmp_path / name])],
            stderr=subprocess.PIPE,
            text=True,
        )
        for name in ("a", "b")
    ]
    for process in processes:
        _, stderr = process.communicate(timeout=900)
        assert process.returncode == 0, stderr
    assert len(_trials(tmp_path / "shared.db")) == 6
    assert not (tmp_path / "a").exists(), "only what is asked for is written"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["clusterz"], ["clusterz", "did you mean 'clusters'?"]),
        (["clusters", "clusters"], ["both called 'clusters'"]),
        (["clusters", "--seeds", "1000000000"], ["--seeds", "less than or equal to 10000"]),
        (["clusters", "--workers", "1000000"], ["--workers", "too many for this machine"]),
        (["clusters", "--false-positive-cost-s", "inf"], ["--false-positive-cost-s", "inf"]),
        (["clusters", "--storage", "sqlite:////nowhere/at/all.db"], ["--storage", "cannot be used"]),
        (["clusters", "--storage", "nonsense"], ["--storage nonsense", "check the URL"]),
        (
            ["clusters", "--storage", "oracle://me:secret@host/db"],
            ["--storage oracle://me@host/db", "driver"],
        ),
    ],
)
def test_bad_input_is_one_clear_sentence(tmp_path, arguments, words):
    result = tune(*arguments, "--out", tmp_path / "out")
    assert result.returncode == 2
    assert "Traceback" not in result.stderr
    assert "secret" not in result.stderr
    for word in words:
        assert word in result.stderr
    assert not (tmp_path / "out").exists()


def test_without_optuna_the_extra_is_named(tmp_path, scenario_file):
    hide = "import sys; sys.modules['optuna'] = None; from skysweep.cli import app; app()"
    result = subprocess.run(
        [sys.executable, "-c", hide, "tune", str(scenario_file), "--out", str(tmp_path / "out")],
        capture_output=True,
        text=True,
    )
    assert result.returncode == 2
    assert "tools/setup.sh tune" in result.stderr


def test_targets_are_needed(tmp_path):
    path = tmp_path / "empty.yaml"
    path.write_text(TINY.split("targets:")[0])
    result = tune(path, *QUICK, "--out", tmp_path / "out")
    assert result.returncode == 2
    assert "no targets" in result.stderr


def _query(database, sql):
    with closing(sqlite3.connect(f"file:{database}?mode=ro", uri=True, timeout=30)) as connection:
        return connection.execute(sql).fetchall()


def _trials(database):
    """(number, what was written down) of the finished ones."""
    rows = _query(
        database,
        "SELECT number, key, value_json FROM trials JOIN trial_user_attributes USING (trial_id) "
        "WHERE state = 'COMPLETE' ORDER BY number, key",
    )
    return {
        number: [row[1:] for row in rows if row[0] == number] for number in dict.fromkeys(r[0] for r in rows)
    }


def _wait_for_trials(process, database, many):
    deadline = time.monotonic() + 600
    while time.monotonic() < deadline:
        assert process.poll() is None, "it ended before it could be killed"
        try:
            found = _trials(database)
        except sqlite3.OperationalError:  # the study is not made yet
            found = {}
        if len(found) >= many:
            return found
        time.sleep(0.2)
    process.kill()
    raise AssertionError("no trials in time")
