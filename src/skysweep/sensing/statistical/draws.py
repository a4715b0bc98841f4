"""Compiled draws of the statistical sensor: which objects are in the picture, and what is reported of them.

Objects are rows of ``x, y, z, size, shape, beside, contrast, cos yaw, sin yaw``; each has one or more rows in
a table of what it can be reported as: G scores, G spreads and G normal quantiles of the lapse over the grid
of log pixels, then the nine factors, the object's own offset and the weights of the pass and of the rest, in
standard deviations.

A draw is a hash of seed, look and row (SplitMix64: Steele, Lea and Flood, OOPSLA 2014), so that what is drawn
of one thing never depends on what else is in view, and what is out of view costs nothing.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from skysweep.sensing.statistical.model import BLUR_MAX, CUT_MIN, EDGE_PX, HIDDEN_MAX, NEAR_PX, VIEW_MAX
from skysweep.worlds.occlusion import apparent_size, visible_share

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

WIDTH = 12  # columns of a row after the three tables
PLACES = 3  # where an object was in the last picture: u, v, pixels
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


@njit(cache=True)
def draw_look(
    optics: F64,  # focal length, width, height (px), exposure (s)
    position: F64,
    R: F64,
    velocity: F64,
    rates: F64,
    things: F64,
    solids: F64,
    near_start: I64,
    near: I64,
    row_starts: I64,
    table: F64,
    log_pixels: F64,
    box_model: F64,  # centre error: pixels, of the object, of the blur; fade_px
    places: F64,
    pass_state: F64,
    ghosts: F64,  # x, y, z, class, level, own offset; of every octave lowest levels first
    octave_starts: I64,
    classes: F64,  # chance of showing, floor, weight of the rest, pixels, scale of mean 1, 1 / shape
    over_altitude: F64,  # of each class: log altitudes, densities, scales of the score
    altitude_agl: float,
    threshold: float,
    seed: int,
    look: int,
    boxes: F64,
    scores: F64,
    rows: I64,
) -> tuple[int, int]:
    """Write what is reported into ``boxes``, ``scores`` and ``rows``.

    Return how many objects, and how many with what is reported where nothing is. ``places`` and
    ``pass_state`` are the memory from look to look.
    """
    focal, width, height = optics[0], optics[1], optics[2]
    g, n = len(log_pixels), 0
    for i in range(len(things)):
        dx, dy, dz = (
            things[i, 0] - position[0],
            things[i, 1] - position[1],
            things[i, 2] - position[2],
        )
        depth = R[0, 2] * dx + R[1, 2] * dy + R[2, 2] * dz
        if depth <= MIN_DEPTH_M:
            places[i, 0] = np.nan
            continue
        u = focal * (R[0, 0] * dx + R[1, 0] * dy + R[2, 0] * dz) / depth + width / 2
        v = focal * (R[0, 1] * dx + R[1, 1] * dy + R[2, 1] * dz) / depth + height / 2
        across = dx * dx + dy * dy
        away = max(across + dz * dz, 1e-9)
        view = across / away
        front = -(things[i, 7] * dx + things[i, 8] * dy) / math.sqrt(away)
        pixels = focal * apparent_size(int(things[i, 4]), things[i, 3], math.sqrt(view)) / depth
        half = pixels / 2
        low_u, high_u = max(u - half, 0.0), min(u + half, width)
        low_v, high_v = max(v - half, 0.0), min(v + half, height)
        if low_u >= high_u or low_v >= high_v:
            places[i, 0] = np.nan
            continue
        moved = abs(u - places[i, 0]) + abs(v - places[i, 1]) + abs(pixels - places[i, 2])
        kept = math.exp(-moved / box_model[3]) if moved == moved else 0.0
        places[i, 0], places[i, 1], places[i, 2] = u, v, pixels
        inside_y = (high_v - low_v) / pixels
        inside = (high_u - low_u) / pixels * inside_y
        edge_y = max(1.0 - EDGE_PX / pixels, 0.0) if inside_y < 1.0 - CUT_MIN else 0.0
        clear = 1.0
        if inside > 1.0 - HIDDEN_MAX:
            around = near[near_start[i] : near_start[i + 1]]
            clear = visible_share(position, things[i, :3], things[i, 3], solids, around)
        blur = (
            focal * optics[3] * math.hypot(-velocity[0] / depth - rates[1], -velocity[1] / depth + rates[0])
        )
        at = math.log(pixels)
        nearness = min(max((at - math.log(NEAR_PX[0])) / math.log(NEAR_PX[1] / NEAR_PX[0]), 0.0), 1.0)
        unseen = inside * clear < 1.0 - HIDDEN_MAX or at < log_pixels[0] + math.log(_TOO_SMALL)
        spread_px = math.sqrt(box_model[0] ** 2 + (box_model[1] * pixels) ** 2 + (box_model[2] * blur) ** 2)
        for r in range(row_starts[i], row_starts[i + 1]):
            fresh = standard_normal(seed, look, r, _PASS)
            pass_state[r] = kept * pass_state[r] + math.sqrt(1.0 - kept * kept) * fresh
            row = table[r]
            if unseen:
                continue
            mean, spread, lapse = _interpolate(log_pixels, row, at)
            if standard_normal(seed, look, r, _LAPSE) < lapse:
                continue
            mean += (
                row[3 * g] * min(view, VIEW_MAX)
                + row[3 * g + 1] * front
                + row[3 * g + 2] * front * nearness
                + row[3 * g + 3] * (1.0 - clear)
                + row[3 * g + 4] * (1.0 - inside) ** 2
                + row[3 * g + 5] * edge_y
                + row[3 * g + 6] * things[i, 5]
                + row[3 * g + 7] * min(blur / pixels, BLUR_MAX)
                + row[3 * g + 8] * things[i, 6]
            )
            rest = row[3 * g + 11] * standard_normal(seed, look, r, _REST)
            score = mean + spread * (row[3 * g + 9] + row[3 * g + 10] * pass_state[r] + rest)
            if score < threshold:
                continue
            du = spread_px * standard_normal(seed, look, r, _CENTRE_U)
            dv = spread_px * standard_normal(seed, look, r, _CENTRE_V)
            _put_box(boxes[n], low_u, low_v, high_u, high_v, du, dv, width, height)
            scores[n], rows[n] = score, r
            n += 1
    end = _draw_ghosts(
        optics,
        position,
        R,
        ghosts,
        octave_starts,
        classes,
        over_altitude,
        altitude_agl,
        threshold,
        seed,
        look,
        n,
        boxes,
        scores,
        rows,
    )
    return n, end


@njit(cache=True)
def _draw_ghosts(
    optics: F64,
    position: F64,
    R: F64,
    ghosts: F64,
    octave_starts: I64,
    classes: F64,
    over_altitude: F64,
    altitude_agl: float,
    threshold: float,
    seed: int,
    look: int,
    n: int,
    boxes: F64,
    scores: F64,
    rows: I64,
) -> int:
    """Those of this altitude's octave, written from place ``n`` on; where that ends.

    ``rows`` are classes. Scores are Weibull's.
    """
    log_altitude = math.log(max(altitude_agl, 1.0))
    octave = min(int(log_altitude / math.log(2.0)), OCTAVES - 1)
    first, end = octave_starts[octave], octave_starts[octave + 1]
    if first == end:
        return n
    now = np.empty((len(classes), 2))
    for k in range(len(classes)):
        grid = over_altitude[k, 0]
        now[k, 0] = _at(log_altitude, grid, over_altitude[k, 1])
        now[k, 1] = _at(log_altitude, grid, over_altitude[k, 2])
    highest = now[:, 0].max()
    for i in range(first, end):
        g = ghosts[i]
        if g[4] >= highest:
            break
        kind = int(g[3])
        c = classes[kind]
        if g[4] >= now[kind, 0]:
            continue
        dx, dy, dz = g[0] - position[0], g[1] - position[1], g[2] - position[2]
        depth = R[0, 2] * dx + R[1, 2] * dy + R[2, 2] * dz
        if depth <= MIN_DEPTH_M:
            continue
        u = optics[0] * (R[0, 0] * dx + R[1, 0] * dy + R[2, 0] * dz) / depth + optics[1] / 2
        v = optics[0] * (R[0, 1] * dx + R[1, 1] * dy + R[2, 1] * dz) / depth + optics[2] / 2
        if not (0.0 <= u <= optics[1] and 0.0 <= v <= optics[2]) or n == len(rows):
            continue
        row = _FIRST_GHOST + i
        if standard_normal(seed, look, row, _SHOWS) > c[0]:
            continue
        z = g[5] + c[2] * standard_normal(seed, look, row, _SCORE)
        above = -math.log(max(0.5 * math.erfc(z / math.sqrt(2.0)), 1e-12))
        score = c[1] + now[kind, 1] * c[4] * above ** c[5]
        if score < threshold:
            continue
        half = c[3] / 2
        _put_box(boxes[n], u - half, v - half, u + half, v + half, 0.0, 0.0, optics[1], optics[2])
        scores[n], rows[n] = score, kind
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
