"""Flown missions."""

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

_NO_EVENTS = ("setup", "clock", "state", "look", "snapshot")  # lines of a journal


class KeptFrame:
    """The best picture of one candidate, with the detector's answer."""

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
    """A flown mission. Shown as a map in notebooks.

    ``summary`` has the numbers of summary.json (docs/results.md), ``scenario`` is the one that was flown,
    ``folder`` is the run folder or None.
    """

    def __init__(self, told: run_folder.Run, summary: Mapping[str, Any]) -> None:
        self._told = told
        self.scenario: Scenario = told.scenario
        self.seed: int = told.seed
        self.folder: Path | None = told.folder
        self.summary: dict[str, Any] = dict(summary)
        self._frames = None if told.folder else _frames(told)  # read now: they are deleted soon

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
        """The estimated position every half second, a row each."""
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
        """Every candidate, a row each. ``verdict`` is confirmed, rejected or null; ``by_operator`` or not."""
        import polars as pl

        schema = {
            **{"id": pl.Int64, "class_name": pl.String},
            **dict.fromkeys(("east_m", "north_m", "up_m", "radius_95_m"), pl.Float64),
            **{"verdict": pl.String, "verdict_s": pl.Float64, "first_seen_s": pl.Float64},
            **{"n_sightings": pl.Int64, "confidence": pl.Float64, "by_operator": pl.Boolean},
        }
        rows = [
            (
                *(c.id, c.class_name, *c.position_enu_m.tolist(), c.radius_95_m, c.verdict, c.verdict_s),
                *(c.first_seen_s, c.n_sightings, c.confidence, c.by_operator),
            )
            for c in self._told.candidates
        ]
        return pl.DataFrame(rows, schema=schema, orient="row")

    @cached_property
    def events(self) -> tuple[dict[str, Any], ...]:
        """Events, oldest first: the journal's lines without states, looks and snapshots."""
        return tuple(dict(r) for r in self._told.records if r["kind"] not in _NO_EVENTS)

    @property
    def frames(self) -> tuple[KeptFrame, ...]:
        """The best picture of every candidate, oldest first; empty for a mission without pictures."""
        return _frames(self._told) if self._frames is None else self._frames


def load_run(folder: str | Path) -> Run:
    """The mission of a run folder, which may be broken off or still fly; nothing is written.

    Raises UserError if the folder is no run folder or is damaged.
    """
    path = checks.folder(folder)
    if path is None:
        raise UserError("folder: is None; give a folder that a mission was flown into")
    told = run_folder.load_run(path)
    return Run(told, whole_summary(told) if told.summary is None else told.summary)


def _frames(told: run_folder.Run) -> tuple[KeptFrame, ...]:
    from skysweep.results.picture_files import told_by_name

    named = sorted((name[1], name[0], path) for path in told.pictures if (name := told_by_name(path)))
    newest = {candidate: (time_s, path) for time_s, candidate, path in named}
    frames = [KeptFrame(k, time_s, path.read_bytes()) for k, (time_s, path) in newest.items()]
    return tuple(sorted(frames, key=lambda frame: (frame.time_s, frame.candidate)))
