"""What a folder holds: missions, sweeps, comparisons, tunings and benchmarks, with their key figures."""

from __future__ import annotations

import os
import re
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import quote

from skysweep.errors import UserError
from skysweep.experiments.store import PARTS, MissionStore
from skysweep.files.folder import Folder
from skysweep.results.reporting.wording import clock
from skysweep.results.run_folder import CONFIG_FILE, JOURNAL_FILE, SUMMARY_FILE, TABLE_FILE
from skysweep.results.summary_file import read_summary
from skysweep.web.feed import FLYING_S
from skysweep.web.places import Places
from skysweep.web.scene import head_of

_DEEPEST = 4  # folders in folders
_MOST = 2000  # entries
_TAIL_BYTES = 1 << 12  # of a journal: its last line is short
_END = re.compile(rb'\{"t": ([\d.]+), "kind": "end"')

# The kinds of studies, by a file that each has in its folder.
_STUDIES = {
    "compare.json": "comparison",
    "tuning.json": "tuning",
    "benchmark.json": "benchmark",
    "break-even.json": "benchmark",
    "spec.yaml": "sweep",
}
_REPORTS = ("report.html", "report/report.html", "benchmark.html", "break-even.html")
_THUMBNAILS = ("map.png", "trajectories.png", "search.png", "break-even.svg", "report/figures/pos-*.svg")


def entries(places: Places, live: str | None) -> list[dict[str, Any]]:
    """All entries, newest first; ``live`` is the id of the mission that flies here."""
    found = [_entry(places, *each, live) for each in _found(places.root)]
    return sorted(found, key=lambda entry: -entry["modified_unix_s"])


def report_of(folder: Path) -> Path | None:
    """The report in a folder, if there is one."""
    return next((folder / name for name in _REPORTS if (folder / name).is_file()), None)


def thumbnail_of(folder: Path) -> Path | None:
    """The picture that stands for a folder, if there is one."""
    return next((path for name in _THUMBNAILS for path in sorted(folder.glob(name))), None)


def _found(root: Path) -> Iterator[tuple[Path, str]]:
    """Folders and their kinds."""
    n = 0
    for name, folders, files in os.walk(root):
        folder = Path(name)
        folders[:] = sorted(f for f in folders if _is_shown(folder / f))
        if len(folder.relative_to(root).parts) >= _DEEPEST:
            folders.clear()
        if JOURNAL_FILE in files or CONFIG_FILE in files:
            folders.clear()
            kind: str | None = "run"
        else:
            kind = next((kind for mark, kind in _STUDIES.items() if mark in files), None)
        if kind is not None:
            yield folder, kind
            n += 1
        if n >= _MOST:
            return


def _is_shown(folder: Path) -> bool:
    """Links are not followed, and an address has only names that are text."""
    is_text = not any("\ud800" <= c <= "\udfff" for c in folder.name)
    return is_text and not folder.name.startswith(".") and not folder.is_symlink()


def _entry(places: Places, folder: Path, kind: str, live: str | None) -> dict[str, Any]:
    identity = places.identity(folder)
    address = f"/api/runs/{quote(identity)}"
    entry: dict[str, Any] = {
        "id": identity,
        "kind": kind,
        "name": folder.name,
        **dict.fromkeys(("scenario", "strategy", "seed", "sensor")),
        "state": "ended",
        "modified_unix_s": 0.0,
        "figures": [],
        "thumbnail": f"{address}/thumbnail" if thumbnail_of(folder) else None,
        "report": f"{address}/report" if report_of(folder) else None,
        "error": None,
    }
    try:
        entry["modified_unix_s"] = folder.stat().st_mtime
        entry |= _run(folder, identity == live) if kind == "run" else _study(folder)
    except UserError as error:
        entry["error"] = str(error)
    except (OSError, ValueError, LookupError, TypeError) as error:
        entry["error"] = f"The results in this folder cannot be read ({type(error).__name__})."
    return entry


def _run(folder: Path, is_live: bool) -> dict[str, Any]:
    journal = folder / JOURNAL_FILE
    modified_s = (journal if journal.is_file() else folder / CONFIG_FILE).stat().st_mtime
    entry: dict[str, Any] = {"modified_unix_s": modified_s, "state": "broken off"}
    if journal.is_file() and end_s(journal) is not None:
        entry["state"] = "ended"
    elif is_live or time.time() - modified_s < FLYING_S:
        entry["state"] = "flying"
    try:
        head = head_of(folder)
        entry |= {key: head.get(key) for key in ("scenario", "strategy", "seed", "sensor")}
        if not head and entry["state"] == "broken off":
            entry["error"] = "The mission was broken off before take-off."
        if (folder / SUMMARY_FILE).is_file():
            entry["figures"] = _figures(read_summary(folder / SUMMARY_FILE)[0])
    except UserError as error:
        entry["error"] = str(error)
    return entry


def end_s(journal: Path) -> float | None:
    """The time of a journal's last line, where it is that of a mission that has ended. Raises OSError."""
    with journal.open("rb") as file:
        file.seek(max(0, journal.stat().st_size - _TAIL_BYTES))
        lines = file.read().split(b"\n")
    ended = _END.match(lines[-2]) if len(lines) > 1 else None
    return float(ended[1]) if ended else None


def _figures(summary: dict[str, Any]) -> list[dict[str, str]]:
    confirmed = str(summary["n_confirmed"])
    if summary["n_targets"] is not None:
        confirmed += f" of {summary['n_targets']}"
    told = {"mission time": clock(summary["mission_time_s"]), "confirmed": confirmed}
    if summary["false_positives"]:
        told["false positives"] = str(summary["false_positives"])
    told["area seen"] = f"{summary['area_covered']:.0%}"
    return _labelled(told)


def _study(folder: Path) -> dict[str, Any]:
    """The figures over all missions of a study, as far as they are in its table."""
    table = folder / TABLE_FILE
    if not table.is_file():
        return {"state": "flying" if (folder / PARTS).is_dir() else "broken off"}
    missions = MissionStore(Folder(folder)).table(["mission_time_s", "recall"])
    time_s, recall = missions.mean().row(0)
    told = {"missions": f"{len(missions):,}"}
    if time_s is not None:
        told["mean mission time"] = clock(time_s)
    if recall is not None:
        told["mean recall"] = f"{recall:.2f}"
    return {"modified_unix_s": table.stat().st_mtime, "figures": _labelled(told)}


def _labelled(told: dict[str, str]) -> list[dict[str, str]]:
    return [{"label": label, "value": value} for label, value in told.items()]
