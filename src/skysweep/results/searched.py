"""How thoroughly a mission searched the cells of a map of probabilities."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from skysweep.arrays import F64
from skysweep.errors import UserError
from skysweep.geometry.frames import LocalFrame
from skysweep.planning.prior.flown import ground_path
from skysweep.planning.prior.maps import ProbabilityMap
from skysweep.results.metrics import seen_footprints
from skysweep.results.pod import LONGEST_GAP_S, CoverageMap, coverage_of_flights, other_than, refuse_twice
from skysweep.results.run_folder import Run

_LEAST_MISSED = 1e-9


def coverage_of_runs(runs: Sequence[Run], cells: ProbabilityMap, sweep_width_m: float | None = None) -> F64:
    """Coverage (R, C) of each cell by what was flown of searches while looks were answered.

    It is -log(1 - POD) of the runs' ``CoverageMap``, averaged over the cell's ground; nothing outside of the
    runs' areas. Runs that share what a map is made of share one, in which a target that is hard to see is so
    in all of them; others count as independent. A sweep width counts the tracks instead. Raises UserError for
    a run without a sensor model, where two are the same flight, and for the sweep width of pictures, which
    have no track.
    """
    refuse_twice(runs)
    coverage = np.zeros(cells.poa.shape)
    if sweep_width_m is None:
        for alike in _alike(runs):
            searched = coverage_of_flights(alike, "write --sweep-width-m")
            missed = _missed(searched, alike[0].scenario.frame, cells)
            coverage -= np.log(np.maximum(missed, _LEAST_MISSED))
        return coverage
    if any(run.is_photographed for run in runs):
        raise UserError("--sweep-width-m: is of a track, and pictures have none; leave it out")
    for run in runs:
        coverage += cells.coverage_by(scanned_paths(run, cells.frame), sweep_width_m)
    return coverage


def scanned_paths(run: Run, frame: LocalFrame) -> list[F64]:
    """The tracks (K, 2) along which the camera saw ground, ENU metres of a frame."""
    states = run.states
    saw, step_s = np.isin(states.time_s, seen_footprints(run)[0]), np.diff(states.time_s)
    geodetic = run.scenario.frame.geodetic_from_enu(states.position_enu_m)
    flown = saw[:-1] & (step_s > 0.0) & (step_s <= LONGEST_GAP_S)
    return _stretches(ground_path(geodetic[:, :2], frame), flown)


def _alike(runs: Sequence[Run]) -> list[list[Run]]:
    """The runs that share what a map is made of, together."""
    groups: list[list[Run]] = []
    for run in runs:
        group = next((group for group in groups if other_than(group[0], run) is None), None)
        if group is None:
            groups.append([run])
        else:
            group.append(run)
    return groups


def _missed(searched: CoverageMap, frame: LocalFrame, cells: ProbabilityMap) -> F64:
    """(R, C) chance that a target somewhere in a cell was not reported.

    The mean over points of the cell that lie as close together as the POD's cells.
    """
    west, south, east, north = searched.bounds_enu_m
    centres_m, aside_m = cells.centres_xy_m.reshape(-1, 2), cells.cell_size_m
    x, y = _moved(centres_m, cells.frame, frame).T
    near = np.flatnonzero(
        (x > west - aside_m) & (x < east + aside_m) & (y > south - aside_m) & (y < north + aside_m)
    )
    pod, across = searched.pod(), max(1, math.ceil(aside_m / searched.cell_m))
    steps_m = aside_m * ((np.arange(across) + 0.5) / across - 0.5)
    missed = np.ones(cells.poa.size)
    for step_m in np.stack(np.meshgrid(steps_m, steps_m), axis=-1).reshape(-1, 2):
        x, y = _moved(centres_m[near] + step_m, cells.frame, frame).T
        there = (x >= west) & (x < east) & (y >= south) & (y < north)
        column = ((x[there] - west) / searched.cell_m).astype(int)
        row = ((y[there] - south) / searched.cell_m).astype(int)
        missed[near[there]] -= pod[row, column] / across**2
    return missed.reshape(cells.poa.shape)


def _moved(places_m: F64, of: LocalFrame, to: LocalFrame) -> F64:
    """Places (N, 2) of one frame in another."""
    geodetic = of.geodetic_from_enu(np.column_stack([places_m, np.zeros(len(places_m))]))
    return ground_path(geodetic[:, :2], to)


def _stretches(places: F64, flown: NDArray[np.bool_]) -> list[F64]:
    """The connected parts of a track (N, 2), of whose N - 1 steps those ``flown`` count."""
    edges = np.diff(np.concatenate([[False], flown, [False]]).astype(int))
    starts, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    return [places[start : end + 1] for start, end in zip(starts, ends, strict=True)]
