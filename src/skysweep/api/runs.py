"""Missions that were flown."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from skysweep.api import checks
from skysweep.arrays import U8
from skysweep.errors import UserError
from skysweep.results import run_folder
from skysweep.results.metrics import whole_summary
from skysweep.scenarios.model import Scenario

if TYPE_CHECKING:
    import polars as pl

_NO_EVENTS = ("setup", "state", "look", "snapshot")  # lines of a journal


class KeptFrame:
    """The best picture of one candidate, with what the detector said to it."""

    def __init__(self, candidate: int, time_s: float, jpeg: bytes) -> None:
        self.candidate, self.time_s, self._jpeg = candidate, time_s, jpeg

    def __repr__(self) -> str:
        """One line."""
        return f"KeptFrame(candidate {self.candidate}, t = {self.time_s:.1f} s)"

    @property
    def image(self) -> U8:
        """(H, W, 3) RGB."""
        import cv2

        decoded: Any = cv2.imdecode(np.frombuffer(self._jpeg, np.uint8), cv2.IMREAD_COLOR)
        return np.asarray(decoded[..., ::-1], dtype=np.uint8)

    def _repr_jpeg_(self) -> bytes:
        return self._jpeg


class Run:
    """A mission as its journal tells it. Shown as a map in notebooks.

    ``summary`` has the numbers of summary.json (docs/results.md), ``scenario`` is what was flown, ``folder``
    where it was written, or None.
    """

    def __init__(self, told: run_folder.Run, summary: Mapping[str, Any]) -> None:
        self._told = told
        self.scenario: Scenario = told.scenario
        self.seed: int = told.seed
        self.folder: Path | None = told.folder
        self.summary: dict[str, Any] = dict(summary)
        self._frames = None if told.folder else _frames(told)  # else the pictures are gone when asked for

    def __repr__(self) -> str:
        """One line."""
        s = self.summary
        of_all = "" if s["n_targets"] is None else f" of {s['n_targets']} targets"
        return (
            f"Run({s['scenario']}, {s['strategy']}, seed {s['seed']}: {s['n_confirmed']}{of_all} confirmed "
            f"in {s['mission_time_s']:.0f} s, {s['end_reason']})"
        )

    def _repr_png_(self) -> bytes:
        from skysweep.results.figures import run_map_png

        return run_map_png(self._told)

    @cached_property
    def track(self) -> pl.DataFrame:
        """Where the vehicle believed to be, every half second, a row each."""
        import polars as pl

        states = self._told.states
        return pl.DataFrame(
            {
                "time_s": states.time_s,
                **dict(zip(("east_m", "north_m", "up_m"), states.position_enu_m.T, strict=True)),
                "altitude_agl_m": self._told.altitudes_agl_m,
                "mode": list(states.mode),
                "battery": states.battery,
                "energy_wh": states.energy_wh,
            }
        )

    @cached_property
    def candidates(self) -> pl.DataFrame:
        """What was seen and what became of it, a row each; ``verdict`` is confirmed, rejected or null."""
        import polars as pl

        rows = [
            {
                "id": story.id,
                "class_name": story.class_name,
                **dict(zip(("east_m", "north_m", "up_m"), story.position_enu_m.tolist(), strict=True)),
                "radius_95_m": story.radius_95_m,
                "verdict": story.verdict,
                "verdict_s": story.verdict_s,
                "first_seen_s": story.first_seen_s,
                "n_sightings": story.n_sightings,
                "confidence": story.confidence,
            }
            for story in self._told.candidates
        ]
        return pl.DataFrame(rows, schema=_candidate_schema(), orient="row")

    @cached_property
    def events(self) -> tuple[dict[str, Any], ...]:
        """What happened, oldest first: the journal's lines without states, looks and snapshots."""
        return tuple(dict(r) for r in self._told.records if r["kind"] not in _NO_EVENTS)

    @property
    def frames(self) -> tuple[KeptFrame, ...]:
        """The best picture of every candidate, oldest first; none of a mission without pictures."""
        return _frames(self._told) if self._frames is None else self._frames


def load_run(folder: str | Path) -> Run:
    """The mission of a run folder, also one that was broken off or still flies; nothing is written.

    Raises:
        UserError: it is no run folder, or a damaged one.
    """
    path = checks.folder(folder)
    if path is None:
        raise UserError("folder: is None; give a folder that a mission was flown into")
    told = run_folder.load_run(path)
    return Run(told, whole_summary(told) if told.summary is None else told.summary)


def _candidate_schema() -> dict[str, Any]:
    import polars as pl

    numbers = ("east_m", "north_m", "up_m", "radius_95_m")
    return {
        "id": pl.Int64,
        "class_name": pl.String,
        **dict.fromkeys(numbers, pl.Float64),
        "verdict": pl.String,
        "verdict_s": pl.Float64,
        "first_seen_s": pl.Float64,
        "n_sightings": pl.Int64,
        "confidence": pl.Float64,
    }


def _frames(told: run_folder.Run) -> tuple[KeptFrame, ...]:
    from skysweep.results.evidence import told_by_name

    named = [(told_by_name(path), path) for path in told.pictures]
    frames = [KeptFrame(*name, path.read_bytes()) for name, path in named if name is not None]
    return tuple(sorted(frames, key=lambda frame: (frame.time_s, frame.candidate)))
