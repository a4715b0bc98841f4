"""The report of one mission."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from skysweep.mission.safety import OUTSIDE
from skysweep.results.exports import FoundTarget, found_targets
from skysweep.results.html import Grid, Section, picture, write_page
from skysweep.results.metrics import MATCH_DISTANCE_M, Summary, horizontal_distance_m, match
from skysweep.results.run_folder import Run
from skysweep.results.wording import clock, definitions, parameters, safety_words
from skysweep.scenarios.files import dump_scenario

MAX_PICTURES = 8


def write_run_report(run: Run, summary: Summary, folder: Path) -> Path:
    """Write ``report.html`` of one mission; ``map.png`` and ``pictures/*.jpg`` of the folder go inside."""
    found = found_targets(run)
    camera = sorted((folder / "pictures").glob("*.jpg"))[:MAX_PICTURES]
    sections = [
        Section(
            "Map",
            pictures=[
                picture(
                    folder / "map.png",
                    "Above: the mission from the top, north up; the line is the path that the vehicle "
                    "believes it flew, coloured by altitude. Below: altitude over time with every verdict.",
                )
            ],
        ),
        Section("What happened", steps=_timeline(run, found)),
        _found_section(run, found),
    ]
    if camera:
        shown = [picture(path, path.stem.replace("_", " ").replace("-", " ")) for path in camera]
        sections.append(Section("What the camera saw", pictures=shown))
    sections += [
        Section("All numbers", grids=[_numbers(summary)], folded=True),
        Section("What it was flown with", [_strategy(run)], grids=[parameters(run.scenario)]),
        Section("The scenario, whole", verbatim=dump_scenario(run.scenario), folded=True),
        Section("What the words mean", grids=[definitions()], folded=True),
    ]
    title = f"Mission: {run.scenario.name}"
    return write_page(folder / "report.html", title, _run_lead(run, summary), _tiles(summary), sections)


def _run_lead(run: Run, s: Summary) -> str:
    area = f"{s['area_m2'] / 1e4:.1f} ha" if s["area_m2"] >= 1000 else f"{s['area_m2']:.0f} m²"
    minutes, seconds = divmod(round(s["mission_time_s"]), 60)
    text = (
        f"{minutes} min {seconds} s after take-off the search of {area} was over: "
        f"{s['n_confirmed']} of {s['n_targets']} targets found and confirmed"
    )
    if s["n_checked"]:
        text += f", {s['false_scans']} of {s['n_checked']} checks for nothing"
    if s["collisions"]:
        text += f". The vehicle ran into {s['collisions']} obstacle{'s' * (s['collisions'] > 1)}"
    if not s["completed"]:
        text += f". The search was not completed ({run.end_reason})"
    return f"{text}."


def _tiles(s: Summary) -> list[tuple[str, str]]:
    tiles = [
        (clock(s["mission_time_s"]), "mission time (min:s)"),
        (f"{s['n_confirmed']} of {s['n_targets']}", "targets confirmed"),
        (str(s["false_scans"]), "false scans"),
        (str(s["false_positives"]), "false positives"),
        (f"{s['area_covered']:.0%}", "of the area seen"),
        (f"{s['path_length_m']:.0f} m", "flown"),
        (f"{s['vertical_m']:.0f} m", "up and down"),
    ]
    if s["scan_only_time_s"] is not None:
        tiles.insert(1, (clock(s["scan_only_time_s"]), "a scan alone would take"))
    if s["min_clearance_m"] is not None:
        tiles.append((f"{s['min_clearance_m']:.1f} m", "nearest to an obstacle"))
    if s["energy_wh"] is not None:
        tiles.append((f"{s['energy_wh']:.1f} Wh", "energy"))
    if s["median_localisation_error_m"] is not None:
        tiles.append((f"{s['median_localisation_error_m']:.2f} m", "median position error"))
    return tiles


def _timeline(run: Run, found: Sequence[FoundTarget]) -> list[tuple[str, str]]:
    """What happened in plain words; one step for each descent."""
    names = {target.candidate: target.name for target in found}
    search = run.scenario.search
    steps = [(0.0, "Take-off.")]
    scanning = next((r for r in run.events("state") if r.get("mode") == "SCAN"), None)
    if scanning is not None:
        height = scanning["p"][2] - run.world.terrain.height_m([scanning["p"][:2]])[0]
        steps.append((run.since_start(scanning), f"At {height:.0f} m above ground: the search begins."))
    check: list[Any] | None = None
    outside: list[float] = []
    started_s = 0.0
    for record in run.records:
        kind, time_s = record["kind"], run.since_start(record)
        if kind == "check_started":
            check, started_s = [], time_s
        elif kind in ("safety", "unsearched"):
            steps.append((time_s, safety_words(record)))
        elif kind == "unchecked" and record.get("reason") == OUTSIDE and check is None:
            outside.append(time_s)
        elif kind in ("confirmed", "rejected", "unchecked"):
            if check is None:
                steps.append((time_s, _verdicts([record], names)))
            else:
                check.append(record)
        elif kind in ("scan_resumed", "finished", "end") and check is not None:
            down = f"Down to {search.check_altitude_agl_m:g} m to check"
            outcome = _verdicts(check, names) if check else "Broken off."
            if check and all(r["kind"] == "unchecked" for r in check):
                down = "A check begins"
            back = f" Back to the search at {clock(time_s)}." if kind == "scan_resumed" else ""
            steps.append((started_s, f"{down}. {outcome}{back}"))
            check = None
        if kind == "finished":
            checked = "what can be is checked" if run.events("unchecked") else "all candidates checked"
            steps.append((time_s, f"All transects flown, {checked}: the way home begins."))
        elif kind == "landed":
            steps.append((time_s, "Landed."))
        elif kind == "end" and record["reason"] != "completed":
            steps.append((time_s, f"The mission ended early: {record['reason']}."))
    if outside:
        steps.append((outside[0], f"Seen outside the area and left unchecked: {len(outside)}."))
    if not run.events("end"):
        steps.append((run.last_s, "The journal ends here: the mission was broken off."))
    return [(clock(time_s), text) for time_s, text in sorted(steps, key=lambda step: step[0])]


def _verdicts(records: Sequence[Any], names: dict[int, str]) -> str:
    confirmed = [names[r["candidate"]] for r in records if r["kind"] == "confirmed"]
    nothing = sum(r["kind"] == "rejected" for r in records)
    unchecked = sum(r["kind"] == "unchecked" for r in records)
    parts = []
    if confirmed:
        parts.append(f"Confirmed {', '.join(confirmed)}")
    if nothing:
        parts.append(
            f"{'nothing' if confirmed else 'Nothing'} at {nothing} {'place' if nothing == 1 else 'places'}"
        )
    if unchecked:
        parts.append(f"{'left' if parts else 'Left'} unchecked: {unchecked}")
    return f"{'; '.join(parts)}."


def _found_section(run: Run, found: Sequence[FoundTarget]) -> Section:
    matches, targets = match(run), run.world.targets
    stories = {c.id: c for c in run.candidates}
    rows = []
    for target in found:
        index = matches.confirmed.get(target.candidate)
        if index is None:
            error = "-"
            truth = "no: found before" if target.candidate in matches.duplicates else "no: nothing there"
        else:
            truth = "yes"
            error = f"{horizontal_distance_m(stories[target.candidate], targets[index]):.2f}"
        rows.append(
            (
                target.name,
                clock(target.confirmed_s),
                f"{target.latitude_deg:.7f}",
                f"{target.longitude_deg:.7f}",
                _or_dash(target.radius_95_m, "{:.1f}"),
                _or_dash(target.confidence, "{:.2f}"),
                truth,
                error,
            )
        )
    header = (
        "Found", "Confirmed (min:s)", "Latitude (°)", "Longitude (°)", "95 % radius (m)", "Confidence",
        "True target?", "Error (m)",
    )  # fmt: skip
    grids = [Grid(header, rows)] if rows else []
    missed = [t for k, t in enumerate(targets) if k not in matches.confirmed.values()]
    if missed:
        lost = [(t.kind, *(f"{v:.1f}" for v in t.position_enu_m[:2]), _how_missed(run, t)) for t in missed]
        grids.append(
            Grid(("Missed", "East (m)", "North (m)", "Why"), lost, "Targets that were not confirmed")
        )
    unchecked = run.events("unchecked")
    if unchecked:
        grids.append(_unchecked_grid(run, unchecked))
    text = "The same places are in targets.geojson, targets.kml, targets.gpx and targets.csv (WGS 84)."
    if not found:
        text = "No target was confirmed."
    return Section("Found positions", paragraphs=[text], grids=grids)


def _unchecked_grid(run: Run, records: Sequence[Any]) -> Grid:
    places = run.scenario.frame.geodetic_from_enu([r["p"] for r in records])
    rows = [
        (f"candidate {r['candidate']}", f"{p[0]:.7f}", f"{p[1]:.7f}", r.get("reason", "the search ended"))
        for r, p in zip(records, places, strict=True)
    ]
    return Grid(
        ("Unchecked", "Latitude (°)", "Longitude (°)", "Why"),
        rows,
        "Candidates that were not checked: have a look",
    )


def _how_missed(run: Run, target: Any) -> str:
    near = [c for c in run.candidates if horizontal_distance_m(c, target) <= MATCH_DISTANCE_M]
    if not near:
        return "never seen"
    return "seen, checked and rejected" if any(c.verdict for c in near) else "seen, never checked"


def _strategy(run: Run) -> str:
    if run.strategy != "scan-check":
        return f"Strategy {run.strategy}."
    n_c, d_c = (_infinite(v) for v in (run.scenario.search.n_c, run.scenario.search.d_c_m))
    return f"Strategy scan-check: checks after n_c = {n_c} candidates, or d_c = {d_c} m after the last one."


def _numbers(summary: Summary) -> Grid:
    rows = []
    for key, value in summary.items():
        if key not in ("pos_curve", "time_to_confirm_s"):
            rows.append(
                (key, "-" if value is None else f"{value:.4g}" if isinstance(value, float) else str(value))
            )
    return Grid(("summary.json", "Value"), rows)


def _infinite(value: float) -> str:
    return "∞" if np.isinf(value) else f"{value:g}"


def _or_dash(value: float | None, form: str) -> str:
    return "-" if value is None else form.format(value)
