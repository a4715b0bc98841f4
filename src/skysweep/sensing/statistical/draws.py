"""Compiled draws of the statistical sensor: which objects are in the picture, and what is reported of them.

Objects are rows of ``x, y, z, size, shape, beside, contrast, cos yaw, sin yaw``; each has one or more rows in
a table of what it can be reported as: G scores, G spreads and G normal quantiles of the lapse over the grid
of log pixels, then the numbers of the FACTORS, the object's own offset and the weights of the pass and of the
rest, in standard deviations.

A draw is a hash of seed, look and row (SplitMix64: Steele, Lea and Flood, OOPSLA 2014), so that what is drawn
of one thing never depends on what else is in view, and what is out of view costs nothing.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from skysweep.sensing.statistical.factors import CUT_MIN, FACTORS, HIDDEN_MAX, factors_of_look
from skysweep.worlds.occlusion import pixels_on_target, visible_share

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

_N_FACTORS = len(FACTORS)
WIDTH = _N_FACTORS + 3  # columns of a row after the three tables
OCTAVES = 10  # of altitude, from 1 m on; ghosts of one are not those of the next
MIN_DEPTH_M = 0.1

_TOO_SMALL = 0.8  # of the smallest size that was measured
_LAPSE, _PASS, _REST, _CENTRE_U, _CENTRE_V = range(5)  # what is drawn of a row
_SHOWS, _SCORE = range(2)  # and of a ghost
_KINDS_OF_DRAW = 8
_FIRST_GHOST = 1 << 30
_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_MIX_1, _MIX_2 = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)


@njit(cache=True)
def _hash(x: np.uint64) -> np.uint64:
    x = (x ^ (x >> np.uint64(30))) * _MIX_1
    x = (x ^ (x >> np.uint64(27))) * _MIX_2
    return x ^ (x >> np.uint64(31))


@njit(cache=True)
def standard_normal(seed: int, look: int, row: int, what: int) -> float:
    """The draw of one row in one look (Box and Muller's transform of two hashes)."""
    number = np.uint64((look * (2 * _FIRST_GHOST) + row) * _KINDS_OF_DRAW + what)
    first = _hash(_hash(np.uint64(seed)) + number * _GOLDEN)
    second = _hash(first + _GOLDEN)
    u = (float(first >> np.uint64(11)) + 0.5) * 2.0**-53
    v = float(second >> np.uint64(11)) * 2.0**-53
    return math.sqrt(-2.0 * math.log(u)) * math.cos(2.0 * math.pi * v)


class Optics(NamedTuple):
    """Of the camera."""

    focal_px: float
    width_px: float
    height_px: float
    exposure_s: float


class Things(NamedTuple):
    """What can be reported, and what hides it."""

    places: F64  # (N, 9) as the module says
    solids: F64
    near_start: I64  # (N + 1,) of each object in ``near``
    near: I64  # indices of the solids that can hide it
    row_starts: I64  # (N + 1,) of each object in ``table``
    table: F64  # (rows, 3 G + WIDTH)
    log_pixels: F64  # (G,)
    box_error: F64  # (4,) of the centre: pixels, of the object, of the blur; then fade_px


class Ghosts(NamedTuple):
    """What is reported where nothing is."""

    places: F64  # (M, 6): x, y, z, class, level, own offset; of every octave lowest levels first
    octave_starts: I64
    classes: F64  # (C, 6): chance of showing, floor, weight of the rest, pixels, scale of mean 1, 1 / shape
    over_altitude: F64  # (C, 3, A): log altitudes, densities, scales of the score


class Pass(NamedTuple):
    """The memory from look to look."""

    places: F64  # (N, 3): where an object was in the last picture: u, v, pixels
    state: F64  # (rows,) what looks of one pass have in common


class Reports(NamedTuple):
    """What is reported, with room for all."""

    boxes: F64  # (room, 4)
    scores: F64  # (room,)
    rows: I64  # (room,)


class Look(NamedTuple):
    """One picture: the camera's truth, and which draw this is."""

    position: F64
    R: F64
    velocity: F64  # in the camera's axes, as ``rates``
    rates: F64
    altitude_agl_m: float
    seed: int
    number: int


@njit(cache=True)
def draw_look(
    optics: Optics,
    look: Look,
    things: Things,
    ghosts: Ghosts,
    last: Pass,
    threshold: float,
    reports: Reports,
) -> tuple[int, int]:
    """Write what is reported with a score from ``threshold`` on; ``last`` becomes that of this look.

    Returns how many objects are reported, and how many with what is reported where nothing is.
    """
    focal, width, height = optics.focal_px, optics.width_px, optics.height_px
    position, R, velocity, rates = look.position, look.R, look.velocity, look.rates
    places, log_pixels, error = last.places, things.log_pixels, things.box_error
    g, n = len(log_pixels), 0
    for i in range(len(things.places)):
        thing = things.places[i]
        dx, dy, dz = thing[0] - position[0], thing[1] - position[1], thing[2] - position[2]
        depth = R[0, 2] * dx + R[1, 2] * dy + R[2, 2] * dz
        if depth <= MIN_DEPTH_M:
            places[i, 0] = np.nan
            continue
        u = focal * (R[0, 0] * dx + R[1, 0] * dy + R[2, 0] * dz) / depth + width / 2
        v = focal * (R[0, 1] * dx + R[1, 1] * dy + R[2, 1] * dz) / depth + height / 2
        pixels = pixels_on_target(focal, int(thing[4]), thing[3], dx, dy, dz, depth)
        half = pixels / 2
        low_u, high_u = max(u - half, 0.0), min(u + half, width)
        low_v, high_v = max(v - half, 0.0), min(v + half, height)
        if low_u >= high_u or low_v >= high_v:
            places[i, 0] = np.nan
            continue
        moved = abs(u - places[i, 0]) + abs(v - places[i, 1]) + abs(pixels - places[i, 2])
        kept = math.exp(-moved / error[3]) if moved == moved else 0.0
        places[i, 0], places[i, 1], places[i, 2] = u, v, pixels
        inside_y = (high_v - low_v) / pixels
        inside = (high_u - low_u) / pixels * inside_y
        clear = 1.0
        if inside > 1.0 - HIDDEN_MAX:
            around = things.near[things.near_start[i] : things.near_start[i + 1]]
            clear = visible_share(position, thing[:3], thing[3], things.solids, around)
        blur = math.hypot(-velocity[0] / depth - rates[1], -velocity[1] / depth + rates[0])
        blur *= focal * optics.exposure_s
        at = math.log(pixels)
        unseen = inside * clear < 1.0 - HIDDEN_MAX or at < log_pixels[0] + math.log(_TOO_SMALL)
        spread_px = math.sqrt(error[0] ** 2 + (error[1] * pixels) ** 2 + (error[2] * blur) ** 2)
        across = dx * dx + dy * dy
        away = max(across + dz * dz, 1e-9)
        front = -(thing[7] * dx + thing[8] * dy) / math.sqrt(away)
        is_cut_y = inside_y < 1.0 - CUT_MIN
        factors = factors_of_look(
            across / away, front, pixels, 1.0 - clear, 1.0 - inside, is_cut_y, thing[5], blur, thing[6]
        )
        for r in range(things.row_starts[i], things.row_starts[i + 1]):
            fresh = standard_normal(look.seed, look.number, r, _PASS)
            last.state[r] = kept * last.state[r] + math.sqrt(1.0 - kept * kept) * fresh
            row = things.table[r]
            if unseen:
                continue
            mean, spread, lapse = _interpolate(log_pixels, row, at)
            if standard_normal(look.seed, look.number, r, _LAPSE) < lapse:
                continue
            own = row[3 * g :]
            for k in range(_N_FACTORS):
                mean += own[k] * factors[k]
            rest = own[_N_FACTORS + 2] * standard_normal(look.seed, look.number, r, _REST)
            score = mean + spread * (own[_N_FACTORS] + own[_N_FACTORS + 1] * last.state[r] + rest)
            if score < threshold:
                continue
            du = spread_px * standard_normal(look.seed, look.number, r, _CENTRE_U)
            dv = spread_px * standard_normal(look.seed, look.number, r, _CENTRE_V)
            _put_box(reports.boxes[n], low_u, low_v, high_u, high_v, du, dv, width, height)
            reports.scores[n], reports.rows[n] = score, r
            n += 1
    return n, _draw_ghosts(optics, look, ghosts, threshold, n, reports)


@njit(cache=True)
def _draw_ghosts(
    optics: Optics, look: Look, ghosts: Ghosts, threshold: float, n: int, reports: Reports
) -> int:
    """Those of this altitude's octave, written from place ``n`` on; where that ends.

    Their rows are classes. Scores are Weibull's.
    """
    log_altitude = math.log(max(look.altitude_agl_m, 1.0))
    octave = min(int(log_altitude / math.log(2.0)), OCTAVES - 1)
    first, end = ghosts.octave_starts[octave], ghosts.octave_starts[octave + 1]
    if first == end:
        return n
    focal, width, height = optics.focal_px, optics.width_px, optics.height_px
    now = np.empty((len(ghosts.classes), 2))
    for k in range(len(ghosts.classes)):
        grid = ghosts.over_altitude[k, 0]
        now[k, 0] = _at(log_altitude, grid, ghosts.over_altitude[k, 1])
        now[k, 1] = _at(log_altitude, grid, ghosts.over_altitude[k, 2])
    highest = now[:, 0].max()
    position, R = look.position, look.R
    for i in range(first, end):
        ghost = ghosts.places[i]
        if ghost[4] >= highest:
            break
        kind = int(ghost[3])
        c = ghosts.classes[kind]
        if ghost[4] >= now[kind, 0]:
            continue
        dx, dy, dz = ghost[0] - position[0], ghost[1] - position[1], ghost[2] - position[2]
        depth = R[0, 2] * dx + R[1, 2] * dy + R[2, 2] * dz
        if depth <= MIN_DEPTH_M:
            continue
        u = focal * (R[0, 0] * dx + R[1, 0] * dy + R[2, 0] * dz) / depth + width / 2
        v = focal * (R[0, 1] * dx + R[1, 1] * dy + R[2, 1] * dz) / depth + height / 2
        if not (0.0 <= u <= width and 0.0 <= v <= height) or n == len(reports.rows):
            continue
        row = _FIRST_GHOST + i
        if standard_normal(look.seed, look.number, row, _SHOWS) > c[0]:
            continue
        z = ghost[5] + c[2] * standard_normal(look.seed, look.number, row, _SCORE)
        above = -math.log(max(0.5 * math.erfc(z / math.sqrt(2.0)), 1e-12))
        score = c[1] + now[kind, 1] * c[4] * above ** c[5]
        if score < threshold:
            continue
        half = c[3] / 2
        _put_box(reports.boxes[n], u - half, v - half, u + half, v + half, 0.0, 0.0, width, height)
        reports.scores[n], reports.rows[n] = score, kind
        n += 1
    return n


@njit(cache=True)
def _at(x: float, grid: F64, values: F64) -> float:
    """``np.interp`` of one number. The last node may be repeated."""
    if x <= grid[0]:
        return float(values[0])
    if x >= grid[-1]:
        return float(values[-1])
    k = 0
    while x >= grid[k + 1]:
        k += 1
    slope = (values[k + 1] - values[k]) / (grid[k + 1] - grid[k])
    return float(slope * (x - grid[k]) + values[k])


@njit(cache=True)
def _interpolate(grid: F64, row: F64, at: float) -> tuple[float, float, float]:
    """The three tables at a log of pixels: linear between the nodes, constant beyond."""
    g = len(grid)
    k = 0
    while k < g - 2 and at > grid[k + 1]:
        k += 1
    w = min(max((at - grid[k]) / (grid[k + 1] - grid[k]), 0.0), 1.0)
    mean = row[k] + w * (row[k + 1] - row[k])
    spread = row[g + k] + w * (row[g + k + 1] - row[g + k])
    return mean, spread, row[2 * g + k] + w * (row[2 * g + k + 1] - row[2 * g + k])


@njit(cache=True)
def _put_box(
    box: F64,
    low_u: float,
    low_v: float,
    high_u: float,
    high_v: float,
    move_u: float,
    move_v: float,
    width: float,
    height: float,
) -> None:
    """A box of at least one pixel, moved and kept in the picture."""
    half_u, half_v = max((high_u - low_u) / 2, 0.5), max((high_v - low_v) / 2, 0.5)
    u = min(max((low_u + high_u) / 2 + move_u, 0.5), width - 0.5)
    v = min(max((low_v + high_v) / 2 + move_v, 0.5), height - 0.5)
    box[0], box[2] = max(u - half_u, 0.0), min(u + half_u, width)
    box[1], box[3] = max(v - half_v, 0.0), min(v + half_v, height)
