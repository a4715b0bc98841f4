"""The numbers of one mission, as defined in docs/results.md."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from skysweep.errors import UserError
from skysweep.planning.advice import UNSEEN_BELOW_PX
from skysweep.planning.flight_plan import plan_scenario
from skysweep.results.run_folder import CandidateStory, Run
from skysweep.results.summary import RunSummary, Summary, finite_or_inf
from skysweep.scenarios.model import Scenario
from skysweep.strategies.covering import as_covered
from skysweep.types import F64, SEARCHING, Doubt, EventKind, Mode
from skysweep.worlds.obstacles import Obstacles, came_near
from skysweep.worlds.occlusion import Occluders, count_seen
from skysweep.worlds.world import World, WorldObject

MATCH_DISTANCE_M = 3.0
_NEEDS_TRUTH = (
    *("n_targets", "recall", "time_to_confirm_s", "pos_curve", "false_scans", "false_positives"),
    *("duplicates", "wrong_rejections", "median_localisation_error_m"),
)
_FORBIDDEN_M = 1e6
_GROUND_POINTS = 2000  # about this many points sample the ground that crowns and buildings hide
_GROUND_TRIES = 1_000_000  # at most, where the area is thin
_ABOVE_GROUND_M = 0.1
_ABOVE_PLAN = 1.1  # times the scan's height, which its author takes for low enough
_NADIR = 1e-6  # as good as straight down, where a picture's rows are equally far
_LOOKING = (*SEARCHING, Mode.LOOK)
_FLATTEST_VIEW = -0.1  # vertical part of a unit ray: flatter views reach the horizon and see nothing


@dataclass(frozen=True, slots=True)
class Matches:
    """The true targets of checked candidates, ``candidate id -> index of the target``."""

    confirmed: dict[int, int]  # rightly, one candidate per target
    duplicates: frozenset[int]  # confirmed, but their target had been confirmed before
    false_alarms: frozenset[int]  # confirmed without a target of the class nearby
    wrong_rejections: dict[int, int]  # rejected, although an unconfirmed target is there
    rejected: frozenset[int]  # rightly: nothing is there, or a target confirmed by another candidate

    @property
    def false_positives(self) -> frozenset[int]:
        """Confirmed candidates that are no new target."""
        return self.duplicates | self.false_alarms

    @property
    def false_scans(self) -> frozenset[int]:
        """Checked candidates that are no new target."""
        return self.false_positives | self.rejected


def match(run: Run) -> Matches:
    """Assign checked candidates to true targets of the same class within ``MATCH_DISTANCE_M``, one to one.

    A target that moves is where it was when the last look before the verdict was taken.

    Confirmed candidates come first. In the order of their confirmation, each counts if it can have a target
    of its own, so a duplicate is always the later one. Among these the assignment has the least total
    distance. Rejected candidates share the targets that are left.
    """
    targets = run.world.targets
    confirmed = [c for c in run.candidates if c.verdict == EventKind.CONFIRMED]
    rejected = [c for c in run.candidates if c.verdict == EventKind.REJECTED]
    everything = set(range(len(targets)))
    right = _assign(run.world, confirmed, targets, everything)
    wrong = _assign(run.world, rejected, targets, everything - set(right.values()))
    distances = _distances_m(run.world, confirmed, targets)
    near_one = {c.id: bool((row < _FORBIDDEN_M).any()) for c, row in zip(confirmed, distances, strict=True)}
    return Matches(
        confirmed=right,
        duplicates=frozenset(i for i, near in near_one.items() if near and i not in right),
        false_alarms=frozenset(i for i, near in near_one.items() if not near),
        wrong_rejections=wrong,
        rejected=frozenset(c.id for c in rejected) - frozenset(wrong),
    )


def compute_summary(
    run: Run, *, scan_only_time_s: float | None = None, wall_time_s: float | None = None
) -> Summary:
    """The numbers of a mission. Without truth ``n_confirmed`` counts all confirmed candidates."""
    search = run.scenario.search
    targets = run.world.targets
    matches = match(run)
    stories = {c.id: c for c in run.candidates}
    confirmed_s: list[float | None] = [None] * len(targets)
    errors_m = []
    for identity, index in matches.confirmed.items():
        confirmed_s[index] = stories[identity].verdict_s
        errors_m.append(horizontal_distance_m(run.world, stories[identity], targets[index]))
    times = sorted(t for t in confirmed_s if t is not None)
    mission_time_s = run.search_end_s
    total_time_s = run.landed_s if run.landed_s is not None else run.last_s
    wall_time_s = _rounded(wall_time_s)
    real_time_factor = (total_time_s - run.resumed_s) / wall_time_s if wall_time_s else None
    searching = run.states.time_s <= mission_time_s
    clearance = _clearance(run)
    path_m, vertical_m = travelled_m(run.states.position_enu_m[searching])
    seen_m2 = seen_m2_of(run)
    summary: Summary = {
        "scenario": run.scenario.name,
        "strategy": run.strategy,
        "n_c": finite_or_inf(search.n_c),
        "d_c_m": finite_or_inf(search.d_c_m),
        "seed": run.seed,
        "sensor": run.start.get("sensor"),
        "completed": run.finished_s is not None,
        "end_reason": run.end_reason,
        "mission_time_s": round(mission_time_s, 3),
        "scan_only_time_s": _rounded(scan_only_time_s),
        "return_time_s": None if run.landed_s is None else round(run.landed_s - mission_time_s, 3),
        "total_time_s": round(total_time_s, 3),
        "n_targets": len(targets),
        "n_confirmed": len(times),
        "recall": len(times) / len(targets) if targets else None,
        "time_to_confirm_s": [_rounded(t) for t in confirmed_s],
        "pos_curve": [[0.0, 0.0]]
        + [[round(t, 3), (k + 1) / len(targets)] for k, t in enumerate(times)]
        + [[round(max([mission_time_s, *times[-1:]]), 3), len(times) / len(targets) if targets else 0.0]],
        "n_scanned": len({r["candidate"] for r in run.events(EventKind.SCANNED)}),
        "n_checks": len(run.events(EventKind.CHECK_STARTED)),
        "n_checked": sum(c.verdict is not None for c in run.candidates),
        "n_unchecked": len(run.unchecked),
        "false_scans": len(matches.false_scans),
        "false_positives": len(matches.false_positives),
        "duplicates": len(matches.duplicates),
        "wrong_rejections": len(matches.wrong_rejections),
        "median_localisation_error_m": _rounded(float(np.median(errors_m)) if errors_m else None),
        "path_length_m": round(path_m, 2),
        "vertical_m": round(vertical_m, 2),
        "energy_wh": _last(run.states.energy_wh[searching]),
        "total_energy_wh": _last(run.states.energy_wh),
        "battery_remaining": _last(run.states.battery),
        "sorties": run.n_sorties,
        "collisions": clearance["collisions"],
        "min_clearance_m": clearance["min_clearance_m"],
        "area_m2": round(run.scenario.area_enu_m.area, 1),
        "area_covered": round(seen_m2 / run.scenario.area_enu_m.area, 4),
        "area_covered_m2": round(seen_m2, 1),
        "wall_time_s": wall_time_s,
        "real_time_factor": _rounded(real_time_factor),
    }
    if not run.has_truth:
        summary.update(cast("Summary", dict.fromkeys(_NEEDS_TRUTH)))
        summary["n_confirmed"] = sum(c.verdict == EventKind.CONFIRMED for c in run.candidates)
    return summary


def whole_summary(run: Run, wall_time_s: float | None = None) -> RunSummary:
    """The summary of a run folder: also whether the mission ended, and what an operator decided."""
    numbers = compute_summary(run, scan_only_time_s=_scan_only_time_s(run), wall_time_s=wall_time_s)
    n_by_operator = sum(c.by_operator for c in run.candidates)
    return {
        **numbers,
        "ended": run.ended,
        "n_by_operator": n_by_operator,
    }


def _scan_only_time_s(run: Run) -> float | None:
    """The planned time; None where the plan comes from a file that is missing or was changed."""
    if not run.has_its_plan:
        return None
    try:
        covered = as_covered(run.scenario)
    except UserError:  # by a strategy that is not here
        covered = run.scenario
    try:
        return plan_scenario(covered)[1].search_time_s
    except UserError:
        return None


def _clearance(run: Run) -> Any:
    """From the simulator, or else from the believed track."""
    seen = run.events("clearance")
    if seen:
        return {key: seen[-1][key] for key in ("collisions", "min_clearance_m")}
    world, states = run.world, run.states
    obstacles = Obstacles(world.terrain, world.trees, world.buildings)
    return came_near(obstacles, states.position_enu_m, states.mode)


def travelled_m(positions_enu_m: F64) -> tuple[float, float]:
    """Path length and vertical travel (up plus down) in metres along positions (N, 3)."""
    steps = np.diff(positions_enu_m, axis=0)
    return float(np.linalg.norm(steps, axis=1).sum()), float(np.abs(steps[:, 2]).sum())


def seen_area(run: Run) -> shapely.Geometry:
    """The part of the search area that the camera pictured while looks were answered.

    A picture counts in every mode of a search, if it was taken from low enough to find the smallest target.
    """
    _, footprints = seen_footprints(run)
    return shapely.union_all(shapely.polygons(footprints)).intersection(run.scenario.area_enu_m)


def seen_footprints(run: Run) -> tuple[F64, F64]:
    """Times (K,) since take-off and footprints (K, 4, 2) ENU metres that ``seen_area`` is made of.

    Each believed camera pose gives one footprint at the level of the ground below it.
    """
    states, lens = run.states, run.scenario.camera.lens
    looking = looking_states(run)
    eye = states.camera_position_enu_m[looking]
    u, v = lens.width_px / (2 * lens.focal_px), lens.height_px / (2 * lens.focal_px)
    R = states.R_camera_to_enu[looking]
    height = eye[:, 2] - run.world.terrain.height_m(eye[:, :2])
    top = np.maximum(-v, _farthest_row(R, height / _seen_from_m(run.scenario)))
    corners = np.ones((len(eye), 4, 3))
    corners[:, :, 0] = -u, u, u, -u
    corners[:, :2, 1], corners[:, 2:, 1] = top[:, None], v
    corners /= np.linalg.norm(corners, axis=2, keepdims=True)
    rays = np.einsum("nij,nkj->nki", R, corners)
    good = (rays[..., 2] < _FLATTEST_VIEW).all(axis=1) & (height > 0) & (top < v)
    reach = height[good, None] / -rays[good, :, 2]
    return states.time_s[looking][good], eye[good, None, :2] + reach[..., None] * rays[good, :, :2]


def seen_m2_of(run: Run) -> float:
    """Square metres of the search area's ground that the camera saw.

    Crowns and buildings hide ground. A grid of points in ``seen_area`` gives the share with a free view in at
    least one picture.
    """
    area = seen_area(run)
    solids = Occluders(run.world).solids
    if area.is_empty or not len(solids):
        return float(area.area)
    states, lens = run.states, run.scenario.camera.lens
    looking = looking_states(run)
    west, south, east, north = area.bounds
    tries = (east - west) * (north - south) / _GROUND_TRIES
    step_m = math.sqrt(max(area.area / _GROUND_POINTS, tries))
    grid = np.stack(np.meshgrid(np.arange(west, east, step_m), np.arange(south, north, step_m)), axis=-1)
    xy = grid.reshape(-1, 2) + step_m / 2
    xy = xy[shapely.contains_xy(area, xy)]
    points = np.column_stack([xy, run.world.terrain.height_m(xy) + _ABOVE_GROUND_M])
    poses = states.camera_position_enu_m[looking], states.R_camera_to_enu[looking]
    u, v = lens.width_px / (2 * lens.focal_px), lens.height_px / (2 * lens.focal_px)
    pictured, seen = count_seen(points, *poses, u, v, solids)
    return float(area.area) * seen / max(pictured, 1)


def looking_states(run: Run) -> NDArray[np.bool_]:
    """(N,) the states of the search that were not flown blind, and not too high to see the smallest target.

    In a HOLD the place may be wrong.
    """
    states, scenario = run.states, run.scenario
    looking = np.array([mode in _LOOKING for mode in states.mode], dtype=bool)
    looking &= run.altitudes_agl_m <= _seen_from_m(scenario)
    for since_s, until_s in _blind_spans_s(run):
        looking &= (states.time_s < since_s) | (states.time_s >= until_s)
    if run.keeps_looks:
        looking &= _looked(run, states.time_s)
    return looking


def _seen_from_m(scenario: Scenario) -> float:
    """How far along the optical axis the smallest target is found."""
    far_m = scenario.pixels_on_target(1.0) / UNSEEN_BELOW_PX
    return max(far_m, _ABOVE_PLAN * scenario.search.scan_altitude_agl_m)


def _farthest_row(R_camera_to_enu: F64, steepness: F64) -> F64:
    """(N,) the picture's row, over the focal length, from which on level ground is near enough.

    The ground at row v lies at the depth h / -(R21 v + R22); ``steepness`` is h over the largest depth.
    """
    down, along = -R_camera_to_enu[:, 2, 2], -R_camera_to_enu[:, 2, 1]
    return np.where(along > _NADIR, (steepness - down) / np.maximum(along, _NADIR), -np.inf)


def _looked(run: Run, time_s: F64) -> NDArray[np.bool_]:
    """(N,) whether times are near a valid look. Gaps too short to count as blind are ignored."""
    scenario = run.scenario
    reach_s = 0.5 * (scenario.safety.detector_silent_s + 1.0 / scenario.detector.rate_hz)
    counts = [look for look in run.events("look") if "failure" not in look and "doubt" not in look]
    exposed_s = np.array([-np.inf, *map(run.since_start, counts), np.inf]) - scenario.camera.latency_s
    after = np.searchsorted(exposed_s, time_s)
    near: NDArray[np.bool_] = np.minimum(time_s - exposed_s[after - 1], exposed_s[after] - time_s) <= reach_s
    return near


def _blind_spans_s(run: Run) -> list[tuple[float, float]]:
    """Start and end of the times when looks failed or their pictures were not trusted."""
    spans: list[tuple[float, float]] = []
    since_s = math.inf
    for look in run.events("look"):
        exposed_s = look["t"] - run.scenario.camera.latency_s
        if "failure" in look:
            since_s = min(since_s, exposed_s)
        elif "doubt" in look:
            since_s = min(since_s, Doubt(*look["doubt"]).since_s)
        elif since_s < exposed_s:
            spans.append((since_s, exposed_s))
            since_s = math.inf
    return [*spans, (since_s, math.inf)]


def horizontal_distance_m(world: World, candidate: CandidateStory, target: WorldObject) -> float:
    """Horizontal distance between an estimated position and the truth at the time of the last look at it."""
    true_enu_m = world.position(target, candidate.looked_s)
    return float(np.linalg.norm(candidate.position_enu_m[:2] - true_enu_m[:2]))


def _distances_m(world: World, candidates: list[CandidateStory], targets: tuple[WorldObject, ...]) -> F64:
    """Distances (candidates, targets), very large for forbidden pairs."""
    distances = np.full((len(candidates), len(targets)), _FORBIDDEN_M)
    for i, candidate in enumerate(candidates):
        for j, target in enumerate(targets):
            if candidate.class_name in (None, target.kind):
                distance = horizontal_distance_m(world, candidate, target)
                if distance <= MATCH_DISTANCE_M:
                    distances[i, j] = distance
    return distances


def _assign(
    world: World, candidates: list[CandidateStory], targets: tuple[WorldObject, ...], free: set[int]
) -> dict[int, int]:
    """Largest one-to-one assignment to the free targets that keeps the earliest candidates."""
    columns = sorted(free)
    distances = _distances_m(world, candidates, targets)[:, columns]
    kept: list[int] = []
    pairs: dict[int, int] = {}
    for row in range(len(candidates)):
        if (distances[row] >= _FORBIDDEN_M).all():
            continue
        trial = [*kept, row]
        r, c = linear_sum_assignment(distances[trial])
        if len(r) == len(trial) and (distances[trial][r, c] < _FORBIDDEN_M).all():
            kept = trial
            pairs = {candidates[trial[a]].id: columns[b] for a, b in zip(r, c, strict=True)}
    return pairs


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(float(value), 3)


def _last(values: F64) -> float | None:
    return _rounded(values[-1]) if len(values) and np.isfinite(values[-1]) else None
