"""How the probability of each candidate went, and why it was checked and decided on as it was."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from skysweep.results.evidence import titles_of
from skysweep.results.reporting.html import Picture, data_uri
from skysweep.results.reporting.style import (
    BLUE,
    COLUMN_IN,
    GREEN,
    GREY,
    ORANGE,
    VERMILLION,
    figure_bytes,
    style,
)
from skysweep.results.reporting.wording import clock, decision_words, probability_of
from skysweep.results.run_folder import Record, Run
from skysweep.types import F64, SETTLING, EventKind

KEY = (
    "The line is the probability that the candidate is a target, as the strategy believed, on a scale of "
    "log odds. Dots: looks that moved it. Ticks at the bottom: looks that found it. Triangle: a check "
    "begins. Last mark: the verdict. In brackets: what could be decided then, and what it costs on average "
    "in seconds of search."
)
_KINDS = (EventKind.SCANNED, EventKind.REASSESSED, EventKind.CHECK_STARTED, *SETTLING)
_MARKS = {  # marker, size, face, edge
    EventKind.SCANNED: ("o", 3.0, BLUE, BLUE),
    EventKind.REASSESSED: ("o", 3.0, BLUE, BLUE),
    EventKind.CHECK_STARTED: ("v", 5.5, ORANGE, ORANGE),
    EventKind.CONFIRMED: ("o", 6.0, GREEN, GREEN),
    EventKind.REJECTED: ("X", 6.0, GREY, GREY),
    EventKind.UNCHECKED: ("s", 6.0, "none", VERMILLION),
}
_TICKS = (0.01, 0.1, 0.5, 0.9, 0.99)
_CLIP = 0.004  # probabilities nearer to 0 or 1 are drawn here
_SHORTEST_S = 8.0  # span of a chart


def beliefs(run: Run) -> list[Picture]:
    """A chart with its story for each candidate whose probability was told, in the order of the verdicts."""
    titles, told = titles_of(run), dict[int, list[Record]]()
    for record in run.events(*_KINDS):
        if record.get("probability") is not None and record.get("candidate") is not None:
            told.setdefault(record["candidate"], []).append(record)
    found_s: dict[int, list[float]] = {}
    for sighting in run.events("sighting"):
        found_s.setdefault(sighting["candidate"], []).append(run.since_start(sighting))
    pictures = []
    for story in run.candidates:
        records = told.get(story.id)
        if records is None:
            continue
        name = titles.get(story.id, f"Candidate {story.id}")
        checked = any(r["kind"] == EventKind.CHECK_STARTED for r in records)
        caption = f"{name}: probability {probability_of(records[-1]['probability'])}"
        if story.seen_from_m is not None:
            caption += f", seen from {story.seen_from_m:.0f} m and higher"
        caption += ", checked." if checked else ", not checked."
        steps = [(clock(run.since_start(r)), _words(r)) for r in records]
        pictures.append(Picture(_chart(run, records, found_s.get(story.id, [])), caption, steps=steps))
    return pictures


def _words(record: Record) -> str:
    why, kind = decision_words(record), record["kind"]
    if kind == EventKind.CHECK_STARTED:
        return f"Check begins: {why}"
    if kind in SETTLING:
        return f"{kind.capitalize()}: {why}"
    return f"{probability_of(record['probability'])}: {why}"


def _chart(run: Run, records: Sequence[Record], found_s: Sequence[float]) -> str:
    """The probability over mission time, as a data URI."""
    time_s = np.array([run.since_start(r) for r in records])
    log_odds = _log_odds(np.array([r["probability"] for r in records], dtype=float))
    low, high = float(time_s.min()), float(time_s.max())
    pad = max(0.04 * (high - low), 0.5 * (_SHORTEST_S - (high - low)))
    bottom, top = _log_odds(np.array([_CLIP, 1.0 - _CLIP])) * 1.1
    with style():
        figure = Figure(figsize=(COLUMN_IN, 1.5))
        axis = figure.subplots()
        axis.axhline(0.0, color="0.8", lw=0.6)
        axis.step(time_s, log_odds, where="post", color=BLUE, lw=1.0)
        axis.plot(found_s, [bottom] * len(found_s), "|", color=GREY, ms=6.0, mew=0.7)
        for x, y, record in zip(time_s, log_odds, records, strict=True):
            marker, size, face, edge = _MARKS[record["kind"]]
            axis.plot(x, y, marker, ms=size, mfc=face, mec=edge, clip_on=False, zorder=3)
        axis.set_yticks(_log_odds(np.array(_TICKS)), [f"{p:g}" for p in _TICKS])
        axis.set(xlim=(low - pad, high + pad), ylim=(bottom, top), ylabel="Probability")
        axis.xaxis.set_major_formatter(lambda seconds, _position: clock(seconds))
        axis.locator_params(axis="x", nbins=6, integer=True)
        axis.grid(axis="y", lw=0.3, color="0.9")
        svg = figure_bytes(figure, "svg")
    return data_uri(svg, "image/svg+xml")


def _log_odds(probability: F64) -> F64:
    p = np.clip(probability, _CLIP, 1.0 - _CLIP)
    return np.asarray(np.log(p / (1.0 - p)))
