"""The report of one mission."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from skysweep.errors import UserError
from skysweep.mission.notes import LOOKED, NEXT_SORTIE, OPERATOR, SORTIE, UNDECIDED
from skysweep.mission.orders import LOOK, ORDER
from skysweep.mission.safety import OUTSIDE
from skysweep.results.beliefs import KEY, beliefs
from skysweep.results.evidence import evidence
from skysweep.results.exports import FoundTarget, found_targets, unchecked_targets
from skysweep.results.figures import coverage_map_png
from skysweep.results.metrics import MATCH_DISTANCE_M, horizontal_distance_m, match
from skysweep.results.pod import coverage_of
from skysweep.results.reporting.html import Grid, Picture, Section, data_uri, picture, write_page
from skysweep.results.reporting.wording import (
    clock,
    counted,
    definitions,
    is_said,
    moving_words,
    order_words,
    parameters,
    probability_of,
    safety_words,
    share,
    sortie_words,
)
from skysweep.results.run_folder import Run
from skysweep.results.summary import RunSummary, Summary
from skysweep.scenarios.files import dump_scenario
from skysweep.text import printable
from skysweep.types import SEARCHING, SETTLING, EventKind

_POOR_POD = 0.5
_EVIDENCE = {
    "Confirmed": "Pictures of confirmed targets",
    "Unchecked": "Pictures of unchecked candidates",
    "Rejected": "Pictures of rejected candidates",
    "Other": "Pictures",
}


def write_run_report(run: Run, summary: RunSummary, folder: Path) -> Path:
    """Write ``report.html`` of one mission, with ``map.png`` of the folder and the run's pictures inside."""
    found, unchecked = found_targets(run), unchecked_targets(run)
    caption = (
        "Above: the mission from the top, north up. The line is the vehicle's estimated path, coloured by "
        "altitude. Below: altitude over time with all verdicts."
    )
    sections = [
        Section("Map", pictures=[picture(folder / "map.png", caption), *_coverage(run)]),
        Section("What happened", steps=_timeline(run, [*found, *unchecked])),
        _found_section(run, found, unchecked),
    ]
    if run.n_sorties > 1:
        sections.append(Section("Sorties", grids=[_sorties(run)]))
    pictures = evidence(run)
    sections += [Section(t, pictures=pictures[v]) for v, t in _EVIDENCE.items() if pictures[v]]
    charts = beliefs(run)
    if charts:
        sections.append(Section("How sure it was of each candidate, and why", [KEY], pictures=charts))
    sections += [
        Section("All numbers", grids=[_numbers(summary)], folded=True),
        Section("What it was flown with", [_strategy(run)], grids=[parameters(run.scenario)]),
        Section("The scenario, whole", verbatim=dump_scenario(run.scenario), folded=True),
        Section("What the words mean", grids=[definitions()], folded=True),
    ]
    title = f"Mission: {run.scenario.name}"
    return write_page(folder / "report.html", title, _run_lead(run, summary), sections, _tiles(summary))


def _coverage(run: Run) -> list[Picture]:
    """The map of the probability of detection, where the detector has a sensor model."""
    try:
        coverage = coverage_of(run)
    except UserError:
        return []
    pod = coverage.pod()[coverage.inside]
    poor = share((pod < _POOR_POD).mean())
    caption = (
        "How probably a target would have been reported at least once at each place, by the sensor model. "
        f"The mean over the area is {share(pod.mean())}; {poor} of it is below {_POOR_POD:.0%}. The line is "
        f"the path. {moving_words(run.scenario)}".rstrip()
    )
    return [Picture(data_uri(coverage_map_png(run, coverage), "image/png"), caption)]


def _after_take_off(time_s: float) -> str:
    minutes, seconds = divmod(round(time_s), 60)
    return f"{minutes} min {seconds} s after take-off"


def _run_lead(run: Run, s: Summary) -> str:
    area = f"{s['area_m2'] / 1e4:.1f} ha" if s["area_m2"] >= 1000 else f"{s['area_m2']:.0f} m²"
    searched, told = (_after_take_off(time_s) for time_s in (s["mission_time_s"], run.last_s))
    if run.ended:
        text = f"The search of {area} ended {searched}:"
    elif s["completed"]:
        text = f"The search of {area} was finished {searched}, and the journal ends on the way home:"
    else:
        text = f"The journal ends {told}: the search of {area} was broken off, or is still going on. So far"
    confirmed = counted(s["n_confirmed"], "target")
    if run.has_truth:
        confirmed = f"{s['n_confirmed']} of {s['n_targets']} targets"
    text += f" {confirmed} confirmed"
    if s["n_checked"]:
        decided = counted(s["n_checked"], "verdict")
        if run.has_truth:
            text += f", {s['false_scans']} of {decided} on something else"
        else:
            text += f", {s['n_checked'] - s['n_confirmed']} of {decided} against a target"
    if s["wrong_rejections"]:
        text += f", {counted(s['wrong_rejections'], 'target')} seen and rejected"
    n_by_operator = sum(c.by_operator for c in run.candidates)
    if n_by_operator:
        text += f", {counted(n_by_operator, 'verdict')} by the operator"
    if run.unchecked:
        text += f", {counted(len(run.unchecked), 'candidate')} left unchecked"
    if run.n_sorties > 1:
        text += f". It was flown in {run.n_sorties} sorties"
    if s["collisions"]:
        text += f". The vehicle ran into {counted(s['collisions'], 'obstacle')}"
    early = [r["reason"] for r in run.events(EventKind.FINISHED) if r.get("reason")]
    if early:
        text += f". The strategy ended the search early: {printable(early[-1])}"
    if run.ended and not s["completed"]:
        text += f". The search was not completed ({run.end_reason})"
    if run.left_out:
        text += f". The folder is damaged; left out: {', '.join(run.left_out)}"
    return f"{text}."


def _tiles(s: Summary) -> list[tuple[str, str]]:
    tiles = [(clock(s["mission_time_s"]), "mission time (min:s)")]
    if s["scan_only_time_s"] is not None:
        tiles.append((clock(s["scan_only_time_s"]), "a scan alone would take"))
    if s["n_targets"] is None:
        tiles.append((str(s["n_confirmed"]), "confirmed"))
    else:
        tiles += [
            (f"{s['n_confirmed']} of {s['n_targets']}", "targets confirmed"),
            (str(s["false_scans"]), "false scans"),
            (str(s["false_positives"]), "false positives"),
        ]
    if s["wrong_rejections"]:
        tiles.append((str(s["wrong_rejections"]), "seen and rejected"))
    tiles += [
        (share(s["area_covered"]), "of the area seen"),
        (f"{s['path_length_m']:.0f} m", "flown"),
        (f"{s['vertical_m']:.0f} m", "up and down"),
    ]
    optional = (
        (s["min_clearance_m"], "{:.1f} m", "nearest to an obstacle"),
        (s["energy_wh"], "{:.1f} Wh", "energy"),
        (s["median_localisation_error_m"], "{:.2f} m", "median position error"),
    )
    return tiles + [(form.format(value), label) for value, form, label in optional if value is not None]


def _timeline(run: Run, named: Sequence[FoundTarget]) -> list[tuple[str, str]]:
    """The events in plain words, with one step for each descent."""
    names = {target.candidate: target.name for target in named}
    steps = [(0.0, "Take-off.")]
    scanning = next((k for k, mode in enumerate(run.states.mode) if mode in SEARCHING), None)
    if scanning is not None:
        height_m = run.altitudes_agl_m[scanning]
        steps.append((run.states.time_s[scanning], f"The search begins at {height_m:.0f} m above ground."))
    check: list[Any] | None = None  # the check's start and its verdicts
    decided: dict[float, list[Any]] = {}  # not during a check of theirs
    left: dict[tuple[float, str], list[Any]] = {}  # by the reason
    outside: list[Any] = []
    finished = {run.since_start(record) for record in run.events(EventKind.FINISHED)}
    for record in run.records:
        kind, time_s = record["kind"], run.since_start(record)
        if kind == EventKind.CHECK_STARTED:
            if check is not None:
                steps.append(_check_step(run, check, names))
            check = [record]
        elif kind == LOOKED or (kind == ORDER and record["word"] == LOOK):
            steps.append((time_s, order_words(record)))
        elif kind in (SORTIE, NEXT_SORTIE):
            steps.append((time_s, sortie_words(record)))
        elif kind in SETTLING and record.get("by") == OPERATOR:
            steps.append((time_s, _verdicts([record], names)))
        elif is_said(record):
            steps.append((time_s, safety_words(record)))
        elif kind == EventKind.UNCHECKED and record.get("reason") == OUTSIDE:
            (outside if check is None else check).append(record)
        elif kind == EventKind.UNCHECKED and (_cause(run, record) or {}).get("action") != "REFUSE_CHECK":
            left.setdefault((time_s, _why_unchecked(run, record["candidate"])), []).append(record)
        elif kind in SETTLING:
            if check is None or _aim(check[0]) not in (None, record["candidate"]):
                decided.setdefault(time_s, []).append(record)
            else:
                check.append(record)
        elif kind in (EventKind.SCAN_RESUMED, EventKind.FINISHED, "end") and check is not None:
            goes_on = kind == EventKind.SCAN_RESUMED and time_s not in finished
            back = f" Back to the search at {clock(time_s)}." if goes_on else ""
            started_s, text = _check_step(run, check, names)
            steps.append((started_s, f"{text}{back}"))
            check = None
        if kind == EventKind.FINISHED:
            steps.append((time_s, _done(run, record)))
        elif kind == "landed":
            steps.append((time_s, "Landed."))
        elif kind == "end" and record["reason"] != "completed":
            steps.append((time_s, f"The mission ended early: {record['reason']}."))
    if check is not None:
        steps.append(_check_step(run, check, names))
    if outside:
        why = _why_unchecked(run, outside[0]["candidate"])
        left.setdefault((run.since_start(outside[0]), why), []).extend(outside)
    steps[:0] = [(time_s, _verdicts(records, names)) for time_s, records in decided.items()]
    steps += [(time_s, _left_words(why, records, names)) for (time_s, why), records in left.items()]
    if not run.ended:
        steps.append((run.last_s, "The journal ends here: the mission was broken off, or still flies."))
    return [(clock(time_s), text) for time_s, text in sorted(steps, key=lambda step: step[0])]


def _done(run: Run, finished: Any) -> str:
    """What a strategy has done when it finishes."""
    if finished.get("reason"):  # it ended early, which is said
        return "The way home begins."
    unchecked = run.events(EventKind.UNCHECKED)
    if any(record.get("reason") == UNDECIDED for record in unchecked):
        return "All transects flown: the way home begins."
    reachable = "reachable " if unchecked else ""
    done = "decided" if run.tells_probabilities else "checked"
    return f"All transects flown, all {reachable}candidates {done}: the way home begins."


def _aim(start: Any) -> int | None:
    """The one candidate that a check was begun for; None: for all that are to be checked."""
    return start.get("candidate") if start.get("reason") else None


def _check_step(run: Run, check: Sequence[Any], names: dict[int, str]) -> tuple[float, str]:
    """Time and words of a check, from its start and its verdicts."""
    start, *records = check
    begins, undecided = f"Down to {run.scenario.search.check_altitude_agl_m:g} m to check.", "Broken off."
    if _aim(start) is not None:
        begins = f"A closer look at {_name(start, names)}: {printable(start['reason'])}."
        undecided = "Not decided there."
    elif records and all(r["kind"] == EventKind.UNCHECKED for r in records):
        begins = "A check begins."
    return run.since_start(start), f"{begins} {_verdicts(records, names) if records else undecided}"


def _verdicts(records: Sequence[Any], names: dict[int, str]) -> str:
    confirmed = [_name(r, names) for r in records if r["kind"] == EventKind.CONFIRMED]
    rejected = sum(r["kind"] == EventKind.REJECTED for r in records)
    unchecked = [_name(r, names) for r in records if r["kind"] == EventKind.UNCHECKED]
    parts = []
    if confirmed:
        parts.append(f"confirmed {', '.join(confirmed)}")
    if rejected:
        parts.append(f"rejected {counted(rejected, 'candidate')}")
    if unchecked:
        parts.append(f"not flown to {', '.join(unchecked)}")
    text = "; ".join(parts) + " by the operator" * any("by" in r for r in records)
    return f"{text[:1].upper()}{text[1:]}."


def _left_words(why: str, records: Sequence[Any], names: dict[int, str]) -> str:
    which = ", ".join(_name(r, names) for r in records)
    if len(records) > 1:
        why = why.replace("It lies", "They lie")
    return f"{counted(len(records), 'candidate')} left unchecked ({which}): {why}"


def _name(record: Any, names: dict[int, str]) -> str:
    """The name of a candidate. One left unchecked may have had its verdict later, after a resumption."""
    return names.get(record["candidate"], f"candidate {record['candidate']}")


def _cause(run: Run, record: Any) -> Any:
    """The safety record that made the mission leave a candidate unchecked, or None."""
    before = run.records[: run.records.index(record)]
    reason = record.get("reason")
    asked = ("REFUSE_CHECK",) if reason else ("REFUSE_CHECK", "RETURN", "LAND", "KEEP_OUT")
    causes = (r for r in reversed(before) if r["kind"] == "safety" and r["action"] in asked)
    return next((r for r in causes if not reason or r.get("cause") == reason), None)


def _why_unchecked(run: Run, candidate: int) -> str:
    record = next((r for r in run.events(EventKind.UNCHECKED) if r["candidate"] == candidate), None)
    if record is None:
        return "The mission had not reached it when the journal ended."
    if record.get("reason") == OUTSIDE:
        return "It lies outside the area that is searched."
    cause = _cause(run, record)
    if cause is not None:
        return str(cause["sentence"])
    reason = printable(str(record.get("reason") or "the mission ended early"))
    return f"{reason[:1].upper()}{reason[1:]}."


def _found_section(run: Run, found: Sequence[FoundTarget], unchecked: Sequence[FoundTarget]) -> Section:
    header = ["Found", "Confirmed (min:s)", "Latitude (°)", "Longitude (°)", "95 % radius (m)", *_seen(run)]
    rows = [
        [
            target.name + " (by the operator)" * target.by_operator,
            clock(target.confirmed_s or 0.0),
            *_place(target),
            _or_dash(target.radius_95_m, "{:.1f}"),
            *_seen(run, target),
        ]
        for target in found
    ]
    missed = []
    if run.has_truth:
        header += ["True target?", "Error (m)"]
        rows = [[*row, *_truth(run, target)] for row, target in zip(rows, found, strict=True)]
        right = match(run).confirmed.values()
        missed = [t for k, t in enumerate(run.world.targets) if k not in right]
    grids = [Grid(header, rows)] if rows else []
    if missed:
        places = [run.world.position(t, run.last_s)[:2] for t in missed]
        lost = [
            (t.kind, *(f"{v:.1f}" for v in place), _how_missed(run, t))
            for t, place in zip(missed, places, strict=True)
        ]
        when = ", where they were at the end" if any(t.track for t in missed) else ""
        header = ["Missed", "East (m)", "North (m)", "Why"]
        grids.append(Grid(header, lost, f"Targets that were not confirmed{when}"))
    if unchecked:
        header = ["Unchecked", "Latitude (°)", "Longitude (°)", *_seen(run), "Why"]
        rows = [[t.name, *_place(t), *_seen(run, t), _why_unchecked(run, t.candidate)] for t in unchecked]
        grids.append(Grid(header, rows, "Candidates that were not checked: have a look"))
    text = "The same places are in targets.geojson, targets.kml, targets.gpx and targets.csv (WGS 84)."
    if not found:
        text = "No target was confirmed."
    return Section("Found positions", paragraphs=[text], grids=grids)


def _sorties(run: Run) -> Grid:
    header = ("Sortie", "Took off (min:s)", "Landed (min:s)", "Why", "Battery at landing", "Energy (Wh)")
    rows = [
        (
            str(s.number),
            clock(s.took_off_s),
            "-" if s.landed_s is None else clock(s.landed_s),
            s.why or "-",
            "-" if np.isnan(s.battery) else f"{s.battery:.0%}",
            "-" if np.isnan(s.energy_wh) else f"{s.energy_wh:.1f}",
        )
        for s in run.sorties
    ]
    return Grid(header, rows)


def _truth(run: Run, target: FoundTarget) -> tuple[str, str]:
    """Whether a confirmed target is a true one, and its position error."""
    matches = match(run)
    index = matches.confirmed.get(target.candidate)
    if index is None:
        return "duplicate" if target.candidate in matches.duplicates else "no", "-"
    story = next(c for c in run.candidates if c.id == target.candidate)
    return "yes", f"{horizontal_distance_m(run.world, story, run.world.targets[index]):.2f}"


def _place(target: FoundTarget) -> tuple[str, str]:
    return f"{target.latitude_deg:.7f}", f"{target.longitude_deg:.7f}"


def _seen(run: Run, target: FoundTarget | None = None) -> list[str]:
    """How well a target was seen; the headers of these cells without one."""
    if target is None:
        cells = ["Probability", "Best confidence", "Lowest height (m)"]
    else:
        cells = ["-" if target.probability is None else probability_of(target.probability)]
        cells += [_or_dash(target.confidence, "{:.2f}"), _or_dash(target.seen_from_m, "{:.0f}")]
    return cells if run.tells_probabilities else cells[1:]


def _how_missed(run: Run, target: Any) -> str:
    verdicts = {
        c.verdict
        for c in run.candidates
        if c.class_name in (target.kind, None)
        and horizontal_distance_m(run.world, c, target) <= MATCH_DISTANCE_M
    }
    if EventKind.REJECTED in verdicts:
        return "seen and rejected"
    if None in verdicts:
        return "seen, not decided on"
    return "not told apart from a confirmed one" if verdicts else "never seen"


def _strategy(run: Run) -> str:
    if run.strategy != "scan-check":
        return f"Strategy {run.strategy}."
    n_c, d_c_m = run.scenario.search.n_c, run.scenario.search.d_c_m
    when = [f"after {n_c:g} of them (n_c)"] if np.isfinite(n_c) else []
    when += [f"{d_c_m:g} m after the last new one (d_c)"] if np.isfinite(d_c_m) else []
    return f"Strategy scan-check: candidates are checked {' or '.join([*when, 'at the end of the scan'])}."


def _numbers(summary: RunSummary) -> Grid:
    rows = [
        (key, _or_dash(value, "{:.4g}" if isinstance(value, float) else "{}"))
        for key, value in summary.items()
        if key not in ("pos_curve", "time_to_confirm_s")
    ]
    return Grid(("summary.json", "Value"), rows)


def _or_dash(value: Any, form: str) -> str:
    return "-" if value is None else form.format(value)
