"""Announcements while a mission flies: finds, unchecked candidates, and safety actions."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from skysweep.mission.notes import LOOKED, NEXT_SORTIE, OF_A_CANDIDATE, OPERATOR, SORTIE
from skysweep.results.exports import found_targets, probability_words
from skysweep.results.reporting.wording import clock, is_said, order_words, safety_words, sortie_words
from skysweep.results.run_folder import Run
from skysweep.scenarios.model import Scenario
from skysweep.types import EventKind

Record = Mapping[str, Any]


class Announcer:
    """Hears the lines of a journal as they are written, and announces those of interest in a sentence.

    A line that cannot be announced ends no flight: that is said instead.

    ``before`` are the journal's earlier lines, which are not announced again. ``picture_of`` gives the
    picture of a candidate that was just confirmed, or None.
    """

    def __init__(
        self,
        scenario: Scenario,
        before: Iterable[Record],
        say: Callable[[str], None],
        picture_of: Callable[[int], Path | None] = lambda _candidate: None,
    ) -> None:
        self._scenario, self._say, self._picture_of = scenario, say, picture_of
        self._records = [r for r in before if r["kind"] in OF_A_CANDIDATE]

    def hear(self, record: Record) -> None:
        with suppress(Exception):  # nobody may be there to be told
            self._say_what_matters(record)

    def _say_what_matters(self, record: Record) -> None:
        try:
            words = self._words(record)
        except Exception as error:
            self._records = [r for r in self._records if r is not record]  # it would spoil all later ones
            words = (
                f"the journal's line '{record['kind']}' at {clock(float(record['t']))} cannot be announced "
                f"({type(error).__name__}: {error})"
            )
        if words:
            self._say(words)

    def _words(self, record: Record) -> str:
        """The sentence of a line; empty for one that is of no interest."""
        kind = record["kind"]
        if kind in OF_A_CANDIDATE:
            self._records.append(record)
        if kind == EventKind.CONFIRMED:
            return self._found(record)
        if kind == EventKind.REJECTED and record.get("by") == OPERATOR:
            return f"rejected by the operator: {self._candidate(record)}"
        if kind == EventKind.UNCHECKED:
            return f"not checked: {self._candidate(record)}"
        if kind == LOOKED:
            return order_words(record)
        if kind in (SORTIE, NEXT_SORTIE):
            return sortie_words(record)
        return safety_words(record) if is_said(record) else ""

    def _found(self, record: Record) -> str:
        target = next(t for t in found_targets(self._run) if t.candidate == record["candidate"])
        found = "confirmed by the operator:" if target.by_operator else "found"
        words = f"{found} {target.name} at {self._place(record)}"
        if target.probability is not None:
            words += f", {probability_words(target)}"
        if target.confidence is not None:
            words += f", confidence up to {target.confidence:.2f}"
        words += f", {clock(float(record['t']))} after take-off"
        picture = self._picture_of(target.candidate)
        return words if picture is None else f"{words}, picture {picture}"

    def _candidate(self, record: Record) -> str:
        candidate = record["candidate"]
        names = {c.id: c.class_name for c in self._run.candidates}
        return f"candidate {candidate} ({names[candidate]}) at {self._place(record)}"

    @property
    def _run(self) -> Run:
        return Run(self._scenario, tuple(self._records))

    def _place(self, record: Record) -> str:
        latitude, longitude, _ = self._scenario.frame.geodetic_from_enu(record["p"])[0]
        east_m, north_m, _ = record["p"]
        return f"{latitude:.7f}, {longitude:.7f} (E {east_m:.1f} m, N {north_m:.1f} m)"
