"""Examine this machine."""

from __future__ import annotations

from dataclasses import asdict

import typer

from skysweep.cli.answers import JsonOption, answer, figures_table, mark
from skysweep.cli.common import bar_over, friendly
from skysweep.text import printable


@friendly
def doctor(as_json: JsonOption = False) -> None:
    """Say what works here and what is missing, each with the command that mends it.

    Exit code 0 if a simulated mission with pictures can be flown, else 1. What is marked "note" is missing or
    unusual, but is needed for other things only.

    Examples:

        skysweep doctor

        skysweep doctor --json
    """
    from skysweep.flights.doctor import CHECKS, can_fly, examine

    findings = [finding for name in bar_over(CHECKS, "checks", len(CHECKS)) for finding in examine(name)]
    flies = can_fly(findings)
    table = figures_table()
    for finding in findings:
        mend = f"\n-> {finding.mend}" if finding.mend else ""
        table.add_row(mark(finding.passed), finding.name, printable(finding.said) + mend)
    verdict = "a mission can be flown here" if flies else "no mission can be flown here yet"
    answer(as_json, {"can_fly": flies, "checks": [asdict(finding) for finding in findings]}, table, verdict)
    if not flies:
        raise typer.Exit(1)
