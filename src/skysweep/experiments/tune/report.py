"""The report of a tuning: tables, files, and figures with their data."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import yaml

from skysweep.experiments.tune.figures import draw_matters, draw_search
from skysweep.experiments.tune.race import RECALL_SLACK, least_recall
from skysweep.experiments.tune.run import Problem
from skysweep.experiments.tune.space import D_C, TUNED
from skysweep.experiments.tune.study import Trial
from skysweep.experiments.tune.validate import Cell, Effect, Standing, distances_m, effects, limits
from skysweep.files.writing import whole_files
from skysweep.results.reporting.html import Grid
from skysweep.results.reporting.statistics import (
    SIGNIFICANCE,
    Estimate,
    PairedTest,
    pairs_needed,
    pairs_to_tell,
    pareto_front,
)
from skysweep.results.reporting.symbols import field_name, number, value_text
from skysweep.results.reporting.tables import markdown
from skysweep.results.summary import plain
from skysweep.scenarios.files import change_scenario, write_scenario
from skysweep.strategies.fields import value_at

_COUNTED = ("recall", "false_positives", "false_scans")


@dataclass(frozen=True)
class Tuned:
    """The results of a tuning. ``matters`` has the cells by scenario, and is empty where not asked for."""

    problem: Problem
    trials: list[Trial]
    standings: list[Standing]
    matters: dict[str, list[Cell]]

    @property
    def best(self) -> Standing:
        return self.standings[0]


def write_tuning(tuned: Tuned, folder: Path) -> list[Path]:
    """Write everything into ``folder`` and return the recommended scenarios' files.

    These are ``recommended.yaml`` (``recommended-NAME.yaml`` with several scenarios) and ``overlay.yaml``,
    ``tuning.json``, ``tuning.md``, ``trials.parquet``, and the figures ``search`` and ``matters-NAME`` as
    PNG and SVG with their CSV. Raises UserError where ``folder`` cannot be written to.
    """
    with whole_files(folder) as unfinished:
        recommended = _write_scenarios(tuned, unfinished)
        text = json.dumps(plain(tuning_json(tuned)), indent=1) + "\n"
        (unfinished / "tuning.json").write_text(text, encoding="utf-8")
        (unfinished / "tuning.md").write_text(_markdown(tuned), encoding="utf-8")
        table = _trials_table(tuned.problem, tuned.trials)
        table.write_parquet(unfinished / "trials.parquet")
        table.write_csv(unfinished / "search.csv")
        draw_search(table, [p.field for p in tuned.problem.space], unfinished / "search")
        for name, cells in tuned.matters.items():
            _cells_table(cells).write_csv(unfinished / f"matters-{name}.csv")
            draw_matters(cells, name, unfinished / f"matters-{name}")
    return [folder / path.name for path in recommended]


def _trials_table(problem: Problem, trials: Sequence[Trial]) -> pl.DataFrame:
    """One row a trial. Trials that flew all seeds and keep the constraints compete for ``on_front``."""
    many, rules = len(problem.scenarios), problem.rules
    flown = [trial.flown(many) for trial in trials]
    whole = [
        t.dropped is None and t.same_as is None and rules.feasible(f)
        for t, f in zip(trials, flown, strict=True)
    ]
    front = np.zeros(len(trials), dtype=bool)
    if any(whole):
        front[whole] = pareto_front(np.array([rules.objectives(f) for f in flown])[whole])
    rows = [
        {
            "trial": trial.number,
            "seeds_used": mine.seeds,
            "dropped": trial.dropped,
            "same_as": trial.same_as,
            "feasible": rules.feasible(mine),
            "on_front": bool(on_front),
            **{f"param.{field}": float(value) for field, value in trial.values.items()},
            **{key: mine.mean(key) for key in ("mission_time_s", *_COUNTED, "energy_wh")},
            "cost_s": float(rules.cost_s(mine).mean()),
        }
        for trial, mine, on_front in zip(trials, flown, front, strict=True)
    ]
    return pl.DataFrame(rows, schema_overrides={"dropped": pl.String, "same_as": pl.Int64})


def recommendation(tuned: Tuned) -> Grid:
    """The recommended values beside those of each scenario."""
    changes = tuned.best.candidate.changes
    originals = tuned.problem.originals
    rows = [
        (
            field_name(field),
            *(value_text(field, value_at(change_scenario(s, changes), field)) for s in originals[:1]),
            *(value_text(field, value_at(s, field)) for s in originals),
        )
        for field in _fields(tuned.problem)
    ]
    own = ["own"] if len(originals) == 1 else [f"{s.name}'s own" for s in originals]
    return Grid(("Parameter", "Recommended", *own), rows, f"Recommended for {tuned.problem.name}", words=True)


def recommendation_sentence(tuned: Tuned) -> str:
    """The expected results of the recommended parameters."""
    best = tuned.best
    return (
        f"On {best.flown.seeds} fresh seeds: mission time {interval(best.mission_time_s, 1)} s, "
        f"recall {interval(best.recall, 3)}, false positives {interval(best.false_positives, 2)}; "
        "means with 95 % intervals."
    )


def recommendation_rule(tuned: Tuned) -> str:
    """The rule that chose the recommended candidate."""
    rules, flown = tuned.problem.rules, [standing.flown for standing in tuned.standings]
    recall = f"within {RECALL_SLACK:g} of the highest"
    if least_recall(flown, rules) == rules.min_recall:
        recall = f"at least {rules.min_recall:g} in every scenario"
    finished = (
        "finished every search" if tuned.best.flown.unfinished == 0 else "left fewest searches unfinished"
    )
    return (
        f"Recommended: of the candidates that {finished} with a mean recall of {recall}, the one with the "
        f"least cost: mission time and {rules.false_positive_cost_s:g} s for each false positive."
    )


def standings_table(tuned: Tuned) -> Grid:
    """All candidates on the validation seeds, from the recommended to the worst."""
    measured = ("Candidate", "Time\n(s)", "Recall", "False\npos.")
    rows = []
    for s in tuned.standings:
        pair = s.cost_over_best_s
        row = [interval(s.mission_time_s, 1), interval(s.recall, 3), interval(s.false_positives, 2)]
        row += (
            ["", ""] if pair is None else [interval(pair.test, 1, True), f"{1 - pair.probability_below:.3f}"]
        )
        label = s.candidate.label + ("" if s.feasible else " *")
        rows.append([label, *(text.replace(" (", "\n(") for text in row)])
    caption = (
        f"{tuned.best.flown.seeds} fresh seeds, means with 95 % intervals; cost = time + "
        f"{tuned.problem.rules.false_positive_cost_s:g} s for each false positive, compared pair by pair"
    )
    if not all(s.feasible for s in tuned.standings):
        caption += "; * breaks a constraint"
    return Grid((*measured, "Cost over the\nfirst (s)", "P(first\nbetter)"), rows, caption, best=[0])


def matters_grid(name: str, cells: Sequence[Cell]) -> Grid:
    """Mission time over the fastest, with n_c down and d_c across."""
    distances = distances_m(cells)
    fastest = next(c for c in cells if c.time_over_best_s is None)
    rows = []
    for n_c in limits(cells):
        line = [c for c in cells if c.n_c == n_c]
        texts = [number(n_c)]
        for d_c_m in distances:
            cell = next((c for c in line if c.d_c_m in (d_c_m, None)), None)
            is_same = cell is not None and cell.d_c_m is None and len(texts) > 1
            texts.append("" if cell is None else "same" if is_same else _over_best(cell))
        rows.append(texts)
    caption = (
        f"{name}: seconds over the fastest (n_c = {number(fastest.n_c)}, d_c = {_distance(fastest)}: "
        f"{fastest.mission_time_s.mean:.1f} s, recall {fastest.flown.mean('recall'):.3f}, false positives "
        f"{fastest.flown.mean('false_positives'):.2f}), paired over {fastest.flown.seeds} seeds, 95 % "
        "intervals; = not distinguishable from it"
    )
    family = len(cells) - 1
    if undecided := [c.time_over_best_s.test for c in cells if c.time_over_best_s and c.undecided]:
        caption += (
            f"; ? too few seeds to tell after correcting for {family} comparisons, at least "
            f"{max(pairs_to_tell(test, family) for test in undecided)} are needed"
        )
    if not all(cell.is_whole for cell in cells):
        caption += "; * not every search was finished, or recall is lower than that of the best"
    return Grid(("n_c", *(f"d_c = {value_text(D_C, d)}" for d in distances)), rows, caption)


def matters_sentences(cells: Sequence[Cell]) -> list[str]:
    """When n_c and d_c matter: a summary, then a sentence for each row and column of the table."""
    found = effects(cells)
    family, seeds = sum(len(effect.others) for effect in found), cells[0].flown.seeds
    if seeds < pairs_needed(family):
        return [
            f"{seeds} seeds are too few for {family} comparisons to show anything; "
            f"give --validation-seeds {pairs_needed(family)} or more."
        ]
    return [_headline(found), *map(_effect_sentence, found)]


def how_sure(tuned: Tuned) -> list[str]:
    """How certain the recommendation is against the runner-up and the scenario's own values."""
    sentences = []
    rules, best = tuned.problem.rules, tuned.best
    if rules.min_recall is not None and not best.feasible:
        sentences.append(
            f"NOTHING tried reached recall {rules.min_recall:g} in all scenarios with all searches finished; "
            f"this is the best there is (recall {interval(best.recall, 3)})."
        )
    if len(tuned.standings) > 1:
        sentences.append("Runner-up: " + _against(tuned.standings[1]))
    own = (s for s in tuned.standings[2:] if re.search(r"(^|\()own values", s.candidate.label))
    return [*sentences, *("Scenario's own: " + _against(standing) for standing in own)]


def interval(what: Estimate | PairedTest, digits: int, sign: bool = False) -> str:
    """Mean (low to high)."""
    form = f"{'+' if sign else ''}.{digits}f"
    if not math.isfinite(what.low):
        return f"{what.mean:{form}} (no interval)"
    return f"{what.mean:{form}} ({what.low:.{digits}f} to {what.high:.{digits}f})"


def describe(values: dict[str, float]) -> str:
    """Values in one line."""
    return ", ".join(f"{field_name(field)} {value_text(field, v)}" for field, v in values.items())


def _against(standing: Standing) -> str:
    pair = standing.cost_over_best_s
    assert pair is not None
    text = f"{standing.candidate.label}, cost {interval(pair.test, 1, sign=True)} s; "
    if pair.test.n_zero == pair.test.n_pairs:
        return text + "the same in every mission."
    if not math.isfinite(pair.test.low):
        return text + "too few seeds to say more."
    probability = f"probability that the recommended is better {1 - pair.probability_below:.3f}"
    if not standing.feasible:
        return text + f"and it breaks a constraint (recall {standing.recall.mean:.3f})."
    return f"{text}{'clearly worse' if pair.is_clear else 'NOT distinguishable'}, {probability}."


def _headline(found: Sequence[Effect]) -> str:
    parts = []
    for held, other in (("d_c", "n_c"), ("n_c", "d_c")):
        lines = [effect for effect in found if effect.held == held]
        where = [number(effect.value) for effect in lines if effect.matters]
        if not where:
            parts.append(f"{other} does not show at any {held}")
        elif len(where) == len(lines):
            parts.append(f"{other} matters at every {held} flown")
        else:
            parts.append(f"{other} matters at {held} = {', '.join(where)} only")
    return "; ".join(parts) + "."


def _effect_sentence(effect: Effect) -> str:
    slowest, over_best_s, p = max(effect.others, key=lambda other: other[1].mean)
    by_d_c = effect.held == "d_c"
    over = f"{interval(over_best_s, 1, sign=True)} s (p = {p:.2g})"

    def choice(cell: Cell) -> str:
        return f"n_c = {number(cell.n_c)}" if by_d_c else f"d_c = {_distance(cell)}"

    held = f"d_c = {value_text(D_C, effect.value)}" if by_d_c else f"n_c = {number(effect.value)}"
    if not effect.matters:
        return f"{held}: {'n_c' if by_d_c else 'd_c'} makes no difference that shows; the slowest: {over}."
    text = f"{held}: {choice(effect.best)} is fastest, {choice(slowest)} slowest: {over}"
    as_good = [cell for cell, test, p in effect.others if p >= SIGNIFICANCE and not test.low > 0]
    if as_good:
        text += "; as good as the fastest: " + ", ".join(map(choice, as_good))
    return text + "."


def _over_best(cell: Cell) -> str:
    if cell.time_over_best_s is None:
        return "fastest"
    mark = (" =" if cell.as_good else " ?" if cell.undecided else "") + " *" * (not cell.is_whole)
    return interval(cell.time_over_best_s.test, 0, sign=True) + mark


def _distance(cell: Cell) -> str:
    return "any" if cell.d_c_m is None else value_text(D_C, cell.d_c_m)


def _fields(problem: Problem) -> list[str]:
    """The usual parameters first, then what else was tuned."""
    usual = list(TUNED)
    return usual + [p.field for p in problem.space if p.field not in usual]


def _write_scenarios(tuned: Tuned, folder: Path) -> list[Path]:
    changes = tuned.best.candidate.changes
    alone, paths, overlays = len(tuned.problem.originals) == 1, [], []
    for original, base in zip(tuned.problem.originals, tuned.problem.overlays, strict=True):
        name = f"recommended{'' if alone else f'-{original.name}'}.yaml"
        paths.append(write_scenario(change_scenario(original, changes), folder / name))
        differs = {field: v for field, v in changes.items() if v != value_at(original, field)}
        overlays.append(base | {"set": base["set"] | differs})
    text = yaml.safe_dump(overlays[0] if alone else overlays, sort_keys=False, default_flow_style=False)
    (folder / "overlay.yaml").write_text(text, encoding="utf-8")
    return paths


def _markdown(tuned: Tuned) -> str:
    problem = tuned.problem
    parts = [
        f"# Tuning of {problem.name}",
        f"{len(tuned.trials)} trials, up to {problem.seeds} seeds each.",
        markdown(recommendation(tuned)).rstrip(),
        recommendation_sentence(tuned),
        recommendation_rule(tuned),
        *how_sure(tuned),
        markdown(standings_table(tuned)).rstrip(),
        *(
            f"- {s.candidate.label}: {describe(s.candidate.changes)}"
            for s in tuned.standings
            if s.candidate.changes.keys() == {p.field for p in problem.space}
        ),
    ]
    for name, cells in tuned.matters.items():
        parts += [f"## When n_c and d_c matter: {name}", markdown(matters_grid(name, cells)).rstrip()]
        parts.append("\n".join(f"- {sentence}" for sentence in matters_sentences(cells)))
    return "\n\n".join(parts) + "\n"


def tuning_json(tuned: Tuned) -> dict[str, Any]:
    """The content of ``tuning.json``."""
    problem = tuned.problem
    recommended = change_scenario(problem.originals[0], tuned.best.candidate.changes)
    means = ("mission_time_s", "recall", "false_positives", "cost_s")
    return {
        "problem": problem.as_data(),
        "trials": len(tuned.trials),
        "missions_flown": sum(len(t.missions) for t in tuned.trials if t.same_as is None),
        "validation_seeds": tuned.best.flown.seeds,
        "recommended": {field: value_at(recommended, field) for field in _fields(problem)},
        "candidates": [
            {
                **asdict(s.candidate),
                "feasible": s.feasible,
                **{key: asdict(getattr(s, key)) for key in means},
                "cost_over_recommended_s": s.cost_over_best_s and asdict(s.cost_over_best_s),
            }
            for s in tuned.standings
        ],
        "rule": recommendation_rule(tuned),
        "how_sure": how_sure(tuned),
        "matters": {
            name: {"cells": _cells_table(cells).to_dicts(), "says": matters_sentences(cells)}
            for name, cells in tuned.matters.items()
        },
    }


def _cells_table(cells: Sequence[Cell]) -> pl.DataFrame:
    rows = []
    for cell in cells:
        test = cell.time_over_best_s.test if cell.time_over_best_s else None
        rows.append(
            {
                "n_c": cell.n_c,
                "d_c_m": cell.d_c_m,
                "seeds": cell.flown.seeds,
                "mission_time_s": cell.mission_time_s.mean,
                "mission_time_low_s": cell.mission_time_s.low,
                "mission_time_high_s": cell.mission_time_s.high,
                "over_fastest_s": test.mean if test else 0.0,
                "over_fastest_low_s": test.low if test else None,
                "over_fastest_high_s": test.high if test else None,
                "as_good": cell.as_good,
                "unfinished": cell.flown.unfinished,
                **{key: cell.flown.mean(key) for key in _COUNTED},
            }
        )
    floats = {name: pl.Float64 for name in ("d_c_m", "over_fastest_low_s", "over_fastest_high_s")}
    return pl.DataFrame(rows, schema_overrides=floats)
