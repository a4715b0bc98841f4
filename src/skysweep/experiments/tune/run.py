"""Tuning: find the search parameters of a scenario, or of a family of them, by flying many missions.

A study proposes values. Each proposal races against the best so far on the same seeds (``race``). The best
fly again on fresh seeds, beside the scenario's own values and the paper's choices (``validate``).
"""

from __future__ import annotations

import hashlib
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

from skysweep import __version__
from skysweep.experiments.engines import LocalEngine
from skysweep.experiments.tune.race import (
    Outcome,
    Outcomes,
    RaceRules,
    blocks,
    incumbents,
    outcome_of,
    why_dropped,
)
from skysweep.experiments.tune.space import N_C, Parameter
from skysweep.experiments.tune.study import OpenTrial, Trial, TuningStudy
from skysweep.flights.build import refuse_unseeable
from skysweep.flights.fly import digests_of_files, fly_in_memory
from skysweep.scenarios.files import change_scenario, dump_scenario
from skysweep.scenarios.model import Scenario
from skysweep.strategies import fingerprint_of, strategy_spec
from skysweep.strategies.fields import value_at

PAPER_N_C = (1.0, 5.0, math.inf)
FAMILY_SCATTER_M = 5.0


@dataclass(frozen=True)
class Problem:
    """A tuning problem: one answer for all ``scenarios``, on the mission seeds 0 .. ``seeds`` - 1."""

    name: str
    scenarios: tuple[Scenario, ...]  # as flown, with layouts that differ by seed
    originals: tuple[Scenario, ...]  # as given
    overlays: tuple[dict[str, Any], ...]  # origin of each: ``scenario``, and the fields that were ``set``
    space: tuple[Parameter, ...]
    rules: RaceRules
    seeds: int = 32
    sampler_seed: int = 0

    def as_data(self) -> dict[str, Any]:
        """All that distinguishes problems. The keys are words of an error message."""
        codes = [_code(scenario) for scenario in self.scenarios]
        return {
            "scenario": [scenario.name for scenario in self.scenarios],
            "what the scenario says": [_digest(scenario) for scenario in self.scenarios],
            "sensor or plan file": [digests_of_files(scenario, "statistical") for scenario in self.scenarios],
            **({"code of the strategy": codes} if any(codes) else {}),
            "ranges": {parameter.field: parameter.values for parameter in self.space},
            "seeds": self.seeds,
            **({"seed": self.sampler_seed} if self.sampler_seed else {}),
            "min-recall": self.rules.min_recall,
            "false-positive-cost-s": self.rules.false_positive_cost_s,
            "version of skysweep": __version__,
        }

    @property
    def first_values(self) -> list[dict[str, float]]:
        """The first scenario's own values, then the same with the paper's n_c."""
        own = {p.field: value_at(self.scenarios[0], p.field) for p in self.space}
        paper = [own | {N_C: n_c} for n_c in PAPER_N_C if N_C in own]
        return [own, *(values for values in paper if values != own)]


def family_of(scenario: Scenario, scatter_m: float | None) -> Scenario:
    """The scenario with a layout that differs by seed.

    ``scatter_m`` None keeps the scenario's own. A scenario whose targets stand in the same places with all
    seeds gets ``FAMILY_SCATTER_M``, since a search for known places would learn them.
    """
    if scatter_m is None:
        varies = scenario.scatter_m > 0 or any(g.seed is None for g in scenario.generators)
        scatter_m = scenario.scatter_m if varies else FAMILY_SCATTER_M
    if scatter_m == scenario.scatter_m:
        return scenario
    return change_scenario(scenario, {"scatter_m": scatter_m})


def search(
    problem: Problem,
    storage: str,
    study_name: str,
    trials: int,
    minutes: float | None = None,
    workers: int | None = None,
    on_trial: Callable[[Trial], None] = lambda _trial: None,
) -> list[Trial]:
    """Let the study grow to ``trials``, or for ``minutes``, and return all of its trials.

    ``on_trial`` is called with each trial, first with those already in the study. Other processes may work on
    the same study at the same time. Raises UserError where the storage is unusable or holds another problem,
    or as ``refuse_unseeable``.
    """
    for scenario in problem.scenarios:
        refuse_unseeable(scenario, "statistical")
    study = _open(problem, storage, study_name)
    study.start(problem.first_values)
    known = study.trials()
    for held in known:
        on_trial(held)
    deadline = math.inf if minutes is None else time.time() + 60.0 * minutes
    fly = partial(_fly_trial, problem, storage, study_name, trials, deadline)
    for _, trial in LocalEngine(workers).run(fly, range(len(known), trials)):
        if trial is not None:
            on_trial(trial)
    return study.trials()


def _open(problem: Problem, storage: str, study_name: str) -> TuningStudy:
    return TuningStudy(
        storage, study_name, problem.as_data(), problem.space, problem.rules, problem.sampler_seed
    )


def _fly_trial(
    problem: Problem, storage: str, study_name: str, trials: int, deadline_unix_s: float, _place: int
) -> Trial | None:
    """The study's next trial, from its values to its end, in a worker process."""
    if time.time() >= deadline_unix_s:
        return None
    study = _open(problem, storage, study_name)
    trial = study.ask(trials)
    return None if trial is None else _race(problem, study, trial)


def _race(problem: Problem, study: TuningStudy, trial: OpenTrial) -> Trial:
    """Fly block after block of seeds until the trial is clearly beaten or has flown them all."""
    many = len(problem.scenarios)
    for known in study.trials():
        if known.values == trial.values:
            return trial.close(known.missions, known.flown(many), known.dropped, known.number)
    scenarios = [change_scenario(scenario, trial.values) for scenario in problem.scenarios]
    missions: list[Outcome] = []
    flown, dropped = Outcomes.of([], many), None
    for end in blocks(problem.seeds):
        for seed in range(flown.seeds, end):
            missions += [outcome_of(fly_in_memory(scenario, seed)) for scenario in scenarios]
            trial.sign_of_life()
        flown = Outcomes.of(missions, many)
        if end < problem.seeds:
            finished = [t.flown(many) for t in study.trials() if t.dropped is None]
            dropped = why_dropped(flown, incumbents(finished, problem.rules), problem.rules)
            if dropped:
                break
    return trial.close(missions, flown, dropped, None)


def _code(scenario: Scenario) -> str | None:
    """What tells the code of a strategy that is not built in from another one's."""
    strategy_spec(scenario.search.strategy)  # imports it, in a worker process, too
    return fingerprint_of(scenario.search.strategy)


def _digest(scenario: Scenario) -> str:
    return hashlib.sha256(dump_scenario(scenario).encode()).hexdigest()[:16]
