"""The learning environment on this machine: results of policies without learning, and its speed."""

from __future__ import annotations

from itertools import groupby
from statistics import mean
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table

from skysweep.cli.answers import JsonOption, answer
from skysweep.cli.common import ScenarioArg, bar_over, friendly

if TYPE_CHECKING:
    from skysweep.gym.baselines import Played


@friendly
def gym(
    scenario: ScenarioArg = "clusters",
    episodes: Annotated[int, typer.Option(min=1, max=10_000, help="Of each policy.")] = 10,
    seed: Annotated[int, typer.Option(min=0, help="Of the first episode.")] = 0,
    as_json: JsonOption = False,
) -> None:
    """Play the learning environment with policies without learning: reward, recall, steps per CPU second.

    Examples:

        skysweep gym

        skysweep gym sparse --episodes 3
    """
    from skysweep.gym.baselines import N_POLICIES, play_all

    episodes_played = play_all(scenario, range(seed, seed + episodes))
    played = list(bar_over(episodes_played, "episodes", N_POLICIES * episodes))
    policies = [
        _figures(policy, list(group)) for policy, group in groupby(played, key=lambda episode: episode.policy)
    ]
    table = Table(
        "policy", "return", "recall", "false alarms", "search (s)", "steps", "steps/s", title=scenario
    )
    for of in policies:
        table.add_row(
            of["policy"],
            f"{of['return']:.2f}",
            f"{of['recall']:.3f}",
            f"{of['false_alarms']:.2f}",
            f"{of['search_s']:.0f}",
            f"{of['steps']:.0f}",
            f"{of['steps_per_cpu_s']:.0f}",
        )
    answer(as_json, {"scenario": scenario, "episodes": episodes, "policies": policies}, table)


def _figures(policy: str, episodes: list[Played]) -> dict[str, Any]:
    """Means over the episodes of one policy."""
    summaries = [episode.summary for episode in episodes]
    return {
        "policy": policy,
        "return": mean(e.reward for e in episodes),
        "recall": mean(s["recall"] or 0.0 for s in summaries),
        "false_alarms": mean(s["false_positives"] - s["duplicates"] for s in summaries),
        "search_s": mean(s["mission_time_s"] for s in summaries),
        "steps": mean(e.steps for e in episodes),
        "steps_per_cpu_s": sum(e.steps for e in episodes) / sum(e.cpu_s for e in episodes),
    }
