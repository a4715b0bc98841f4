"""Find good search parameters."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from skysweep.cli import completion
from skysweep.cli.answers import JsonOption, answer
from skysweep.cli.common import (
    MOST_SEEDS,
    SetOption,
    WorkersOption,
    bar,
    changes_of,
    friendly,
    say,
)
from skysweep.errors import UserError
from skysweep.files.writing import make_folder

if TYPE_CHECKING:
    from skysweep.experiments.tune.report import Tuned
    from skysweep.experiments.tune.run import Problem
    from skysweep.experiments.tune.study import Trial
    from skysweep.results.reporting.html import Grid


@friendly
def tune(
    scenarios: Annotated[
        list[str],
        typer.Argument(help="Shipped scenarios or YAML files.", autocompletion=completion.scenarios),
    ],
    together: Annotated[
        bool, typer.Option("--together", help="One answer for all scenarios instead of one for each.")
    ] = False,
    trials: Annotated[int, typer.Option(min=1, max=100_000, help="Sets of parameters to try.")] = 100,
    minutes: Annotated[float | None, typer.Option(min=0.0, help="Search no longer than this.")] = None,
    seeds: Annotated[
        int, typer.Option(min=4, max=MOST_SEEDS, help="Seeds of the best sets in the search.")
    ] = 32,
    validation_seeds: Annotated[
        int,
        typer.Option(min=0, max=MOST_SEEDS, help="Fresh seeds for the final comparison; 0: search only."),
    ] = 100,
    recall: Annotated[
        Literal["constraint", "objective"], typer.Option(help="Keep --min-recall, or trade recall for time.")
    ] = "constraint",
    min_recall: Annotated[float, typer.Option(min=0.0, max=1.0, help="Mean recall to keep.")] = 0.95,
    false_positive_cost_s: Annotated[
        float, typer.Option(min=0.0, help="Cost of one false positive, in seconds of mission time.")
    ] = 60.0,
    ranges: Annotated[
        list[str] | None,
        typer.Option("--range", metavar="FIELD=LOW:HIGH", help="Or FIELD=1,2,inf. May be repeated."),
    ] = None,
    fix: Annotated[
        list[str] | None,
        typer.Option(metavar="FIELD[=VALUE]", help="Do not tune this field. May be repeated."),
    ] = None,
    change: SetOption = None,
    scatter_m: Annotated[
        float | None,
        typer.Option(
            min=0.0,
            help="Move every target by about this much, anew for each seed; 0: the layout as given. "
            "Default: 5 where the layout would be the same for every seed.",
        ),
    ] = None,
    matters: Annotated[
        bool, typer.Option("--matters/--no-matters", help="Fly the table of when n_c and d_c matter.")
    ] = True,
    out: Annotated[Path, typer.Option(help="Folder; each answer gets a folder in it.")] = Path("tuning"),
    storage: Annotated[
        str | None, typer.Option(help="URL of a shared database. Default: a file in the answer's folder.")
    ] = None,
    study: Annotated[
        str | None, typer.Option(help="Name in that database. Default: the scenario's name.")
    ] = None,
    workers: WorkersOption = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the search.")] = 0,
    as_json: JsonOption = False,
) -> None:
    """Find good n_c, d_c, altitudes, speeds and sidelap by flying many missions without pictures.

    The best set finishes every search with a mean recall of at least --min-recall, at the least cost: mission
    time plus --false-positive-cost-s for each false positive. It is chosen on fresh seeds.

    Writes recommended.yaml for `skysweep run`. The same command continues an interrupted search.

    Examples:

        skysweep tune clusters

        skysweep tune clusters abundance sparse --together --trials 300 --out one-answer

        skysweep tune my-scenario.yaml --range search.n_c=1:8,inf --fix search.sidelap --minutes 10

        skysweep tune clusters --storage postgresql://user@host/tuning   # on several machines
    """
    from skysweep.experiments.tune import report
    from skysweep.experiments.tune.race import RaceRules
    from skysweep.experiments.tune.run import Problem, family_of
    from skysweep.experiments.tune.space import changed_space, default_space
    from skysweep.scenarios.files import change_scenario, list_scenarios, load_scenario

    if not math.isfinite(false_positive_cost_s):
        raise UserError(
            f"--false-positive-cost-s: is {false_positive_cost_s}; write a number of seconds, such as 600"
        )
    changes = changes_of(change)
    given = [change_scenario(load_scenario(name), changes) for name in scenarios]
    shipped = list_scenarios()
    sources = {
        scenario.name: name if name in shipped else str(Path(name).resolve())
        for scenario, name in zip(given, scenarios, strict=True)
    }
    names = [scenario.name for scenario in given]
    if len(set(names)) < len(names):
        raise UserError(f"two scenarios are both called '{max(names, key=names.count)}'; name each once")
    rules = RaceRules(min_recall if recall == "constraint" else None, false_positive_cost_s)
    problems = []
    for group in [given] if together else [[scenario] for scenario in given]:
        space, settings = changed_space(default_space(group), group, ranges or [], fix or [])
        originals = tuple(change_scenario(scenario, settings) for scenario in group)
        problems.append(
            Problem(
                name="+".join(scenario.name for scenario in group),
                scenarios=tuple(family_of(scenario, scatter_m) for scenario in originals),
                originals=originals,
                overlays=tuple({"scenario": sources[s.name], "set": changes | settings} for s in originals),
                space=tuple(space),
                rules=rules,
                seeds=seeds,
                sampler_seed=seed,
            )
        )
    answers: list[dict[str, Any]] = []
    try:
        for problem in problems:
            study_name = problem.name
            if study:
                study_name = study if len(problems) == 1 else f"{study}-{problem.name}"
            folder = out / problem.name
            found = _search(problem, folder, storage, study_name, trials, minutes, workers)
            if validation_seeds:
                tuned, recommended = _validate(problem, found, folder, validation_seeds, matters, workers)
                record = {"folder": str(folder), "scenarios": list(map(str, recommended))}
                answers.append(record | report.tuning_json(tuned))
                if not as_json:
                    answer(as_json, answers[-1], *_shown(tuned, folder, recommended))
            else:
                say("searched only; give --validation-seeds for a recommendation")
    except KeyboardInterrupt:
        say(f"stopped; finished work is kept in {out}, and the same command continues it")
        raise typer.Exit(130) from None
    answer(as_json, {"recommendations": answers})


def _search(
    problem: Problem,
    folder: Path,
    storage: str | None,
    study: str,
    trials: int,
    minutes: float | None,
    workers: int | None,
) -> list[Trial]:
    from skysweep.experiments.tune.run import search

    if storage is None:
        make_folder(folder)
    _say_what_is_tuned(problem)
    database = storage or f"sqlite:///{(folder / 'study.db').absolute()}"
    with bar() as progress:
        task = progress.add_task(f"{problem.name}: search", total=trials)
        seen: list[Trial] = []

        def on_trial(trial: Trial) -> None:
            seen.append(trial)
            best = _best(problem, seen)
            if best is trial:
                say(_best_so_far(problem, best))
            progress.advance(task)

        found = search(problem, database, study, trials, minutes, workers, on_trial)
    say(_search_sentence(found))
    return found


def _validate(
    problem: Problem, found: list[Trial], folder: Path, seeds: int, matters: bool, workers: int | None
) -> tuple[Tuned, list[Path]]:
    """Choose on fresh seeds, and write it: what was found, and the files of the recommended scenarios."""
    from skysweep.experiments.tune import report, validate

    make_folder(folder)
    with bar() as progress:
        task = progress.add_task(f"{problem.name}: validation", total=None)

        def on_mission(done: int, of: int) -> None:
            progress.update(task, completed=done, total=of)

        candidates = validate.candidates_of(problem, found)
        flown = validate.fly_candidates(problem.scenarios, candidates, seeds, folder, workers, on_mission)
        tables = {}
        for scenario in problem.scenarios if matters else ():
            progress.reset(task, description=f"{scenario.name}: when it matters", total=None)
            cells = validate.matters_candidates(scenario)
            cells_flown = validate.fly_candidates([scenario], cells, seeds, folder, workers, on_mission)
            tables[scenario.name] = validate.matters_table(cells, cells_flown, scenario)
    tuned = report.Tuned(problem, found, validate.standings(candidates, flown, problem.rules), tables)
    return tuned, report.write_tuning(tuned, folder)


def _shown(tuned: Tuned, folder: Path, recommended: list[Path]) -> list[Grid | str]:
    from skysweep.experiments.tune import report

    shown: list[Grid | str] = [
        report.recommendation(tuned),
        report.recommendation_sentence(tuned),
        report.recommendation_rule(tuned),
        *report.how_sure(tuned),
        report.standings_table(tuned),
    ]
    for name, table in tuned.matters.items():
        shown += [report.matters_grid(name, table), *(f"- {s}" for s in report.matters_sentences(table))]
    shown.append(f"fly it: skysweep run {recommended[0]}")
    shown.append(f"all of it: {folder / 'tuning.md'}, {folder / 'search.png'}")
    return shown


def _say_what_is_tuned(problem: Problem) -> None:
    from skysweep.results.reporting.symbols import number

    for original, flown in zip(problem.originals, problem.scenarios, strict=True):
        if flown.scatter_m != original.scatter_m:
            say(f"{original.name}: every target is moved by about {flown.scatter_m:g} m, anew for each seed")
    for parameter in problem.space:
        shown = [number(value) for value in parameter.values]
        if len(shown) > 10:
            shown = [*shown[:3], "...", *shown[-2:]]
        say(f"  {parameter.field}: {', '.join(shown)}")


def _best(problem: Problem, trials: list[Trial]) -> Trial | None:
    from skysweep.experiments.tune.race import best_first

    finished = [trial for trial in trials if trial.dropped is None]
    order = best_first([trial.flown(len(problem.scenarios)) for trial in finished], problem.rules)
    return finished[order[0]] if order else None


def _best_so_far(problem: Problem, trial: Trial) -> str:
    from skysweep.experiments.tune.report import describe

    flown = trial.flown(len(problem.scenarios))
    return (
        f"best so far: trial {trial.number}, {flown.mean('mission_time_s'):.1f} s, "
        f"recall {flown.mean('recall'):.3f}, {flown.mean('false_positives'):.2f} false positives "
        f"({describe(trial.values)})"
    )


def _search_sentence(trials: list[Trial]) -> str:
    dropped = sum(trial.dropped is not None for trial in trials)
    repeated = sum(trial.same_as is not None for trial in trials)
    missions = sum(len(trial.missions) for trial in trials if trial.same_as is None)
    return (
        f"{len(trials)} trials, {missions} missions; {dropped} were dropped before they had flown all seeds, "
        f"{repeated} repeated an earlier one"
    )
