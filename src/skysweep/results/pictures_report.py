"""The report of a detector on the pictures of somebody's flight."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from pathlib import Path

from skysweep.results.evidence import evidence
from skysweep.results.exports import FoundTarget, unchecked_targets
from skysweep.results.reporting.html import Grid, Section, picture, write_page
from skysweep.results.reporting.wording import counted
from skysweep.results.run_folder import LEFT_OUT, Run
from skysweep.results.summary import RunSummary
from skysweep.text import printable

_CAPTION = (
    "North up. The line joins the places of the pictures in the order of their time, coloured by altitude; "
    "marks are candidates."
)
_HAVE_A_LOOK = (
    "Nobody has looked at these: have a look before anybody is sent. The same places are in targets.geojson, "
    "targets.kml, targets.gpx and targets.csv (WGS 84). The surest come first."
)


def write_pictures_report(run: Run, summary: RunSummary, folder: Path) -> Path:
    """Write ``report.html``, with ``map.png`` of the folder and the candidates' pictures inside."""
    candidates = unchecked_targets(run)
    off_size = detections_left_out(run)
    nothing = "No detection became a candidate." if off_size else "The detector reported nothing."
    text = [_HAVE_A_LOOK if candidates else nothing]
    if off_size:
        text.append(f"{left_out_words(off_size)}.")
    sections = [
        Section("Map", pictures=[picture(folder / "map.png", _CAPTION)]),
        Section("Candidates", text, grids=[_candidates(candidates)] if candidates else []),
    ]
    shown = [each for group in evidence(run).values() for each in group]
    if shown:
        sections.append(Section("Pictures of candidates", pictures=shown))
    left_out = run.events(LEFT_OUT)
    if left_out:
        rows = [(printable(str(r["picture"])), printable(str(r["why"]))) for r in left_out]
        grid = Grid(("Picture", "Why"), rows, words=True)
        sections.append(Section("Pictures that were left out", grids=[grid]))
    sections.append(Section("What it was looked at with", grids=[_with(run)]))
    n_damaged = sum("failure" in look for look in run.events("look"))
    n_pictures = counted(len(run.states) - n_damaged, "picture")
    hectares = f"{summary['area_m2'] / 1e4:.1f} ha"
    lead = f"{counted(len(candidates), 'candidate')} in {n_pictures} of {hectares}"
    lead += f"; {counted(len(left_out), 'picture')} left out." if left_out else "."
    tiles = [
        (str(len(candidates)), "candidates"),
        (str(len(run.states) - n_damaged), "pictures"),
        (f"{summary['area_covered_m2'] / 1e4:.1f} ha", "of ground seen"),
        (f"{run.scenario.search.scan_altitude_agl_m:.0f} m", "usual height"),
    ]
    return write_page(folder / "report.html", f"Pictures: {run.scenario.name}", lead, sections, tiles)


def detections_left_out(run: Run) -> dict[str, int]:
    """How many detections of each class the tracker left out, for their size or as they are on no ground."""
    seen = Counter(name for look in run.events("look") for name in look.get("class_names", ()))
    kept = Counter(sighting["class_name"] for sighting in run.events("sighting"))
    return dict(seen - kept)


def left_out_words(counts: Mapping[str, int]) -> str:
    """What ``detections_left_out`` says, in words."""
    listed = ", ".join(f"{n} of {name}" for name, n in counts.items())
    n = counted(sum(counts.values()), "detection")
    return f"{n} left out: too large or small on the ground for what it says, or on no ground ({listed})"


def _candidates(targets: list[FoundTarget]) -> Grid:
    header = ["Candidate", "Confidence", "Pictures", "Seen from (m)", "Latitude (°)", "Longitude (°)"]
    rows = [
        [
            t.name.removeprefix("unchecked "),
            "-" if t.confidence is None else f"{t.confidence:.2f}",
            str(t.sightings),
            "-" if t.seen_from_m is None else f"{t.seen_from_m:.0f}",
            f"{t.latitude_deg:.7f}",
            f"{t.longitude_deg:.7f}",
            "-" if t.radius_95_m is None else f"{t.radius_95_m:.1f}",
        ]
        for t in sorted(targets, key=lambda t: -(t.confidence or 0.0))
    ]
    return Grid([*header, "95 % radius (m)"], rows)


def _with(run: Run) -> Grid:
    detector, camera = run.scenario.detector, run.scenario.camera
    tiles = f", in {detector.tiles} x {detector.tiles} tiles" if detector.tiles > 1 else ""
    rows = [
        ("Detector", f"{detector.model}, from confidence {detector.confidence_min:g}{tiles}"),
        ("Pictures", f"{camera.width_px} x {camera.height_px} px, {camera.hfov_rad:.2f} rad wide"),
        ("Ground", run.scenario.terrain.dem or "taken for level, at the height of the take-off place"),
        ("Radius", "assumes errors of 2° in direction and 2 m in place, and of 1.5 m common to all pictures"),
    ]
    return Grid(("", "Value"), rows, words=True)
