"""Say from how high, how fast and with how much overlap to scan."""

from __future__ import annotations

from dataclasses import asdict

from rich.box import SIMPLE_HEAD
from rich.table import Table

from skysweep.cli.answers import answer
from skysweep.cli.common import counting, warn
from skysweep.flights.advise import Option, advise
from skysweep.planning.advice import warnings_for_plan
from skysweep.scenarios.model import Scenario

_NO_FLIGHT = "no flight"


def answer_advice(as_json: bool, source: str, scenario: Scenario, wanted_pod: float, given: str) -> None:
    """Compare flights over what ``source`` names and answer with all of them and the best one.

    ``given`` are the other options that a plan of it needs, as they were written.
    """
    with counting("flights") as count:
        advice = advise(scenario, wanted_pod, count)
    if advice.uncalibrated:
        warn(f"no expected POD: {advice.uncalibrated}")
    table = Table(box=SIMPLE_HEAD, padding=(0, 1), pad_edge=False)
    for title in ("altitude", "speed", "sidelap", "pixels on target", "expected POD", "time", "batteries"):
        table.add_column(title, justify="right")
    for option in advice.options:
        table.add_row(*_row(option), style="bold" if option is advice.best else None)
    best = advice.best
    record = {
        "scenario": scenario.name,
        "wanted_pod": wanted_pod,
        "options": [asdict(option) for option in advice.options],
        "best": None if best is None else asdict(best),
        "why": advice.why,
    }
    if best is None:
        answer(as_json, record, table, f"no flight is possible: {advice.why}")
        return
    reasons = {
        option.why_not.partition(":")[0]: option.why_not for option in advice.options if option.why_not
    }
    for warning in warnings_for_plan(scenario.with_search(**best.search_fields, plan=None)):
        warn(warning)
    altitude, speed, sidelap = best.altitude_agl_m, best.speed_mps, best.sidelap
    drawn = "" if scenario.search.plan is None else "without the scenario's search.plan, "
    command = f"skysweep plan {source}{given}"
    answer(
        as_json,
        record,
        table,
        *(f"{_NO_FLIGHT}: {why}" for why in reasons.values()),
        f"best: {altitude:g} m, {speed:g} m/s, sidelap {sidelap:g}: {advice.why}",
        f"plan it: {drawn}{command} --altitude {altitude:g} --speed {speed:g} --sidelap {sidelap:g}",
    )


def _row(option: Option) -> list[str]:
    lasts = [_NO_FLIGHT, ""]
    if option.time_s is not None:
        lasts = [f"{option.time_s / 3600:.2f} h", str(option.batteries)]
    return [
        f"{option.altitude_agl_m:g} m",
        f"{option.speed_mps:g} m/s",
        f"{option.sidelap:.0%}",
        f"{option.pixels_on_target:.0f}",
        "unknown" if option.pod is None else f"{option.pod:.0%}",
        *lasts,
    ]
