"""How the probability of detection grew over a mission, as pictures for the page."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from skysweep.errors import UserError
from skysweep.results.pod import CoverageMap
from skysweep.results.run_folder import CONFIG_FILE
from skysweep.scenarios.files import load_scenario
from skysweep.scenarios.model import Scenario

_PERIOD_S = 2.0  # of mission time between pictures
_CELLS = 10_000  # larger pictures are rarer


class Coverage:
    """The coverage of the mission in ``folder`` at every ``_PERIOD_S``, from its journal's lines in turn."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._map: CoverageMap | None = None
        self.n_lines = 0  # taken in
        self._due_s = 0.0
        self._newest = b""
        self.frames: list[dict[str, Any]] = []  # messages: time, and base64 of a byte a cell, row 0 south

    def add(self, lines: Sequence[Mapping[str, Any]]) -> None:
        """Take in the next lines. Without a readable scenario and a sensor model nothing is shown."""
        if self.n_lines == 0:
            with suppress(UserError):
                self._map = CoverageMap.of(load_scenario(self._folder / CONFIG_FILE))
        self.n_lines += len(lines)
        if self._map is None:
            return
        for line in lines:
            self._map.add(line)
            if line["kind"] in ("state", "end") and (line["t"] >= self._due_s or line["kind"] == "end"):
                self._keep(float(line["t"]))

    def _keep(self, time_s: float) -> None:
        """Keep a picture of this moment, if it differs from the last one."""
        assert self._map is not None
        pod = np.rint(255.0 * self._map.pod()).astype(np.uint8)
        self._due_s = time_s + _PERIOD_S * max(1.0, pod.size / _CELLS)
        if pod.tobytes() != self._newest:
            self._newest = pod.tobytes()
            self.frames.append({"t": time_s, "pod": base64.b64encode(self._newest).decode("ascii")})


def grid_of(scenario: Scenario) -> dict[str, Any] | None:
    """The cells of the pictures; None where there is no sensor model for the scenario."""
    cells = CoverageMap.of(scenario)
    if cells is None:
        return None
    rows, columns = cells.inside.shape
    bounds = [float(v) for v in cells.bounds_enu_m]
    return {"bounds_enu_m": bounds, "rows": rows, "columns": columns, "cell_m": float(cells.cell_m)}
