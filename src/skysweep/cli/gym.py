"""The learning environment on this machine: results of policies without learning, and its speed."""

from __future__ import annotations

from itertools import groupby
from statistics import mean
from typing import Annotated

import typer
from rich.table import Table

from skysweep.cli.common import console, friendly


@friendly
def gym(
    scenario: Annotated[str, typer.Argument(help="Scenario: a name or a YAML file.")] = "clusters",
    episodes: Annotated[int, typer.Option(min=1, max=10_000, help="Of each policy.")] = 10,
    seed: Annotated[int, typer.Option(min=0, help="Of the first episode.")] = 0,
) -> None:
    """Play the learning environment with policies without learning: reward, recall, steps per CPU second.

    Examples:

        skysweep gym

        skysweep gym sparse --episodes 3
    """
    from skysweep.gym.baselines import play_all

    table = Table(
        "policy", "return", "recall", "false alarms", "search (s)", "steps", "steps/s", title=scenario
    )
    played = play_all(scenario, range(seed, seed + episodes))
    for policy, group in groupby(played, key=lambda episode: episode.policy):
        all_of = list(group)
        summaries = [episode.summary for episode in all_of]
        table.add_row(
            policy,
            f"{mean(e.reward for e in all_of):.2f}",
            f"{mean(s['recall'] or 0.0 for s in summaries):.3f}",
            f"{mean(s['false_positives'] - s['duplicates'] for s in summaries):.2f}",
            f"{mean(s['mission_time_s'] for s in summaries):.0f}",
            f"{mean(e.steps for e in all_of):.0f}",
            f"{sum(e.steps for e in all_of) / sum(e.cpu_s for e in all_of):.0f}",
        )
    console.print(table)
