"""Compiled draws of the statistical sensor: which objects are in the picture, and what is reported of them.

A sensor is a few arrays that live as long as it does: the records SENSOR, THING, GHOST and GHOST_CLASS, and a
table with one or more rows for each THING, one for each class that it can be reported as. A row holds G
scores, G spreads and G normal quantiles of the lapse over the grid of log pixels, then the numbers of the
FACTORS, the object's own offset and the weights of the pass and of the rest, in standard deviations.

A draw is a hash of seed, look and row (SplitMix64: Steele, Lea and Flood, OOPSLA 2014), so that what is drawn
of one object never depends on what else is in view, and what is out of view costs nothing.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit

from skysweep.arrays import F64, I64
from skysweep.sensing.statistical.factors import CUT_MIN, FACTORS, HIDDEN_MAX, TOO_SMALL, factors_of_look
from skysweep.worlds.occlusion import pixels_on_target, visible_share

Record = Any  # of SENSOR

_N_FACTORS = len(FACTORS)
WIDTH = _N_FACTORS + 3  # columns of a row after the three tables
OCTAVES = 10  # of altitude, from 1 m on; ghosts of one are not those of the next
MIN_DEPTH_M = 0.1

# Every field is 8 bytes wide: records are handed over as arrays of their floats, which costs a third.
SENSOR = np.dtype(
    [
        ("focal_px", float),
        ("width_px", float),
        ("height_px", float),
        ("exposure_s", float),
        ("seed", np.int64),
        ("threshold", float),  # the lowest score that is reported
        ("floor", float),  # of the scores of ghosts
        ("centre_px", float),  # error of a box's centre, as the next two
        ("centre_of_object", float),
        ("centre_of_blur", float),
        ("fade_px", float),
        ("octave_starts", np.int64, OCTAVES + 1),  # in the ghosts
    ]
)
THING = np.dtype(  # an object that can be reported
    [
        ("place", float, 3),
        ("size", float),
        ("shape", np.int64),
        ("beside", float),
        ("contrast", float),
        ("facing", float, 2),  # cosine and sine of its yaw
        ("near", np.int64, 2),  # its part of the indices of solids that can hide it
        ("rows", np.int64, 2),  # its part of the table
        ("last", float, 3),  # in the last picture: u, v, pixels; u is NaN where it was not in it
    ]
)
GHOST = np.dtype(  # a place where something can be reported that is not there
    [("place", float, 3), ("kind", float), ("level", float), ("own", float)]
)
GHOST_CLASS = np.dtype(
    [
        ("shows", float),  # normal quantile of the chance of showing
        ("rest", float),  # weight of the rest
        ("pixels", float),
        ("unit_scale", float),  # Weibull's scale of mean 1
        ("exponent", float),  # 1 / Weibull's shape
    ]
)

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
    """One draw of a row in a look (Box and Muller's transform of two hashes)."""
    number = np.uint64((look * (2 * _FIRST_GHOST) + row) * _KINDS_OF_DRAW + what)
    first = _hash(_hash(np.uint64(seed)) + number * _GOLDEN)
    second = _hash(first + _GOLDEN)
    u = (float(first >> np.uint64(11)) + 0.5) * 2.0**-53
    v = float(second >> np.uint64(11)) * 2.0**-53
    return math.sqrt(-2.0 * math.log(u)) * math.cos(2.0 * math.pi * v)


@njit(cache=True)
def draw_look(
    sensor: F64,
    position: F64,
    R: F64,
    velocity: F64,
    rates: F64,
    altitude_agl_m: float,
    look: int,
    things: F64,
    solids: F64,
    near: I64,
    table: F64,
    log_pixels: F64,
    pass_state: F64,
    ghosts: F64,
    ghost_classes: F64,
    over_altitude: F64,
    boxes: F64,
    scores: F64,
    rows: I64,
) -> tuple[int, int]:
    """Write what is reported into ``boxes`` (N, 4), ``scores`` (N,) and ``rows`` (N,), with room for all.

    The first are objects, by their rows of the ``table`` (rows, 3 G + WIDTH); then ghosts, by their class.
    Returns where each part ends.

    ``sensor``, ``things``, ``ghosts`` and ``ghost_classes`` are the floats of their records. ``position``,
    ``R``, ``velocity`` and ``rates`` are the camera's truth, the last two in its own axes. ``near`` are
    indices of ``solids``, ``log_pixels`` (G,) is the table's grid, ``pass_state`` (rows,) what looks of one
    pass have in common. ``over_altitude`` (classes, 3, A): log altitudes, densities and scales of the score.
    """
    s = sensor.view(SENSOR)[0]
    focal, width, height = s.focal_px, s.width_px, s.height_px
    g, n = len(log_pixels), 0
    for thing in things.view(THING):
        place, last = thing.place, thing.last
        dx, dy, dz = place[0] - position[0], place[1] - position[1], place[2] - position[2]
        u, v, depth = _project(s, R, dx, dy, dz)
        if depth <= MIN_DEPTH_M:
            last[0] = np.nan
            continue
        pixels = pixels_on_target(focal, thing.shape, thing.size, dx, dy, dz, depth)
        half = pixels / 2
        low_u, high_u = max(u - half, 0.0), min(u + half, width)
        low_v, high_v = max(v - half, 0.0), min(v + half, height)
        if low_u >= high_u or low_v >= high_v:
            last[0] = np.nan
            continue
        moved = abs(u - last[0]) + abs(v - last[1]) + abs(pixels - last[2])
        kept = math.exp(-moved / s.fade_px) if moved == moved else 0.0
        last[0], last[1], last[2] = u, v, pixels
        inside_y = (high_v - low_v) / pixels
        inside = (high_u - low_u) / pixels * inside_y
        clear = 1.0
        if inside > 1.0 - HIDDEN_MAX:
            clear = visible_share(position, place, thing.size, solids, near[thing.near[0] : thing.near[1]])
        blur = math.hypot(-velocity[0] / depth - rates[1], -velocity[1] / depth + rates[0])
        blur *= focal * s.exposure_s
        at = math.log(pixels)
        unseen = inside * clear < 1.0 - HIDDEN_MAX or at < log_pixels[0] + math.log(TOO_SMALL)
        spread_px = math.sqrt(
            s.centre_px**2 + (s.centre_of_object * pixels) ** 2 + (s.centre_of_blur * blur) ** 2
        )
        across = dx * dx + dy * dy
        away = max(across + dz * dz, 1e-9)
        front = -(thing.facing[0] * dx + thing.facing[1] * dy) / math.sqrt(away)
        is_cut_y = inside_y < 1.0 - CUT_MIN
        factors = factors_of_look(
            across / away,
            front,
            pixels,
            1.0 - clear,
            1.0 - inside,
            is_cut_y,
            thing.beside,
            blur,
            thing.contrast,
        )
        for r in range(thing.rows[0], thing.rows[1]):
            fresh = standard_normal(s.seed, look, r, _PASS)
            pass_state[r] = kept * pass_state[r] + math.sqrt(1.0 - kept * kept) * fresh
            if unseen:
                continue
            mean, spread, lapse = _interpolate(log_pixels, table[r], at)
            if standard_normal(s.seed, look, r, _LAPSE) < lapse:
                continue
            own = table[r, 3 * g :]
            for k in range(_N_FACTORS):
                mean += own[k] * factors[k]
            rest = own[_N_FACTORS + 2] * standard_normal(s.seed, look, r, _REST)
            score = mean + spread * (own[_N_FACTORS] + own[_N_FACTORS + 1] * pass_state[r] + rest)
            if score < s.threshold:
                continue
            du = spread_px * standard_normal(s.seed, look, r, _CENTRE_U)
            dv = spread_px * standard_normal(s.seed, look, r, _CENTRE_V)
            _put_box(boxes[n], low_u, low_v, high_u, high_v, du, dv, width, height)
            scores[n], rows[n] = score, r
            n += 1
    end = _draw_ghosts(
        s, position, R, altitude_agl_m, look, ghosts, ghost_classes, over_altitude, n, boxes, scores, rows
    )
    return n, end


@njit(cache=True)
def _draw_ghosts(
    s: Record,
    position: F64,
    R: F64,
    altitude_agl_m: float,
    look: int,
    ghosts: F64,
    ghost_classes: F64,
    over_altitude: F64,
    n: int,
    boxes: F64,
    scores: F64,
    rows: I64,
) -> int:
    """Those of this altitude's octave, lowest levels first, written from place ``n`` on; where that ends.

    Scores are Weibull's.
    """
    log_altitude = math.log(max(altitude_agl_m, 1.0))
    octave = min(int(log_altitude / math.log(2.0)), OCTAVES - 1)
    first, end = s.octave_starts[octave], s.octave_starts[octave + 1]
    if first == end:
        return n
    width, height = s.width_px, s.height_px
    places, classes = ghosts.view(GHOST), ghost_classes.view(GHOST_CLASS)
    now = np.empty((len(classes), 2))
    for k in range(len(classes)):
        now[k, 0] = _at(log_altitude, over_altitude[k, 0], over_altitude[k, 1])
        now[k, 1] = _at(log_altitude, over_altitude[k, 0], over_altitude[k, 2])
    highest = now[:, 0].max()
    for i in range(first, end):
        ghost = places[i]
        if ghost.level >= highest:
            break
        kind = int(ghost.kind)
        if ghost.level >= now[kind, 0]:
            continue
        place, c = ghost.place, classes[kind]
        dx, dy, dz = place[0] - position[0], place[1] - position[1], place[2] - position[2]
        u, v, _ = _project(s, R, dx, dy, dz)
        if not (0.0 <= u <= width and 0.0 <= v <= height) or n == len(rows):
            continue
        row = _FIRST_GHOST + i
        if standard_normal(s.seed, look, row, _SHOWS) > c.shows:
            continue
        z = ghost.own + c.rest * standard_normal(s.seed, look, row, _SCORE)
        above = -math.log(max(0.5 * math.erfc(z / math.sqrt(2.0)), 1e-12))
        score = s.floor + now[kind, 1] * c.unit_scale * above**c.exponent
        if score < s.threshold:
            continue
        half = c.pixels / 2
        _put_box(boxes[n], u - half, v - half, u + half, v + half, 0.0, 0.0, width, height)
        scores[n], rows[n] = score, kind
        n += 1
    return n


@njit(cache=True)
def _project(s: Record, R: F64, dx: float, dy: float, dz: float) -> tuple[float, float, float]:
    """Pixels u and v, NaN behind the camera, and depth of what is that far east, north and up of it."""
    depth = R[0, 2] * dx + R[1, 2] * dy + R[2, 2] * dz
    if depth <= MIN_DEPTH_M:
        return np.nan, np.nan, depth
    u = s.focal_px * (R[0, 0] * dx + R[1, 0] * dy + R[2, 0] * dz) / depth + s.width_px / 2
    v = s.focal_px * (R[0, 1] * dx + R[1, 1] * dy + R[2, 1] * dz) / depth + s.height_px / 2
    return u, v, depth


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
