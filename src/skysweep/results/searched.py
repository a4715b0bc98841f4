"""How thoroughly a mission searched the cells of a map of probabilities."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from skysweep.arrays import F64
from skysweep.geometry.frames import LocalFrame
from skysweep.planning.prior.flown import ground_path
from skysweep.planning.prior.maps import ProbabilityMap
from skysweep.results.metrics import looking_states
from skysweep.results.run_folder import Run
from skysweep.sensing.statistical.sweep_width import sweep_width_from

_BANDS_PER_OCTAVE = 4  # of altitude; one band has one sweep width
_LOWEST_M = 1.0


def coverage_of_run(run: Run, cells: ProbabilityMap, sweep_width_m: float | None = None) -> F64:
    """Coverage (R, C) of each cell by what was flown of the search while looks were answered.

    Without a sweep width it is that of the run's calibrated sensor at the altitude flown above ground; raises
    UserError where the sensor model is not for the run's camera and detector.
    """
    octaves = np.log2(np.maximum(run.altitudes_agl_m, _LOWEST_M))
    bands = np.where(looking_states(run), np.round(_BANDS_PER_OCTAVE * octaves).astype(int), -1)
    places = _places(run, cells.frame)
    coverage = np.zeros(cells.poa.shape)
    for band in np.unique(bands[bands >= 0]):
        width_m = sweep_width_m
        if width_m is None:
            width_m = sweep_width_from(run.scenario, 2.0 ** (band / _BANDS_PER_OCTAVE))
        if width_m > 0.0:
            coverage += cells.coverage_by(_stretches(places, bands == band), width_m)
    return coverage


def scanned_paths(run: Run, frame: LocalFrame) -> list[F64]:
    """The tracks (K, 2) that count, ENU metres of a frame."""
    return _stretches(_places(run, frame), looking_states(run))


def _places(run: Run, frame: LocalFrame) -> F64:
    geodetic = run.scenario.frame.geodetic_from_enu(run.states.position_enu_m)
    return ground_path(geodetic[:, :2], frame)


def _stretches(places: F64, chosen: NDArray[np.bool_]) -> list[F64]:
    """The parts of a track (N, 2) that chosen states (N,) begin, each as far as the state after it."""
    edges = np.diff(np.concatenate([[False], chosen, [False]]).astype(int))
    starts, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    return [places[start : end + 1] for start, end in zip(starts, ends, strict=True)]
