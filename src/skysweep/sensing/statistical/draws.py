"""Compiled draws of the statistical sensor: which objects are in the picture, and what is reported of them.

A sensor is a few arrays that live as long as it does: the records SENSOR, THING, GHOST and GHOST_CLASS, and a
table with one or more rows for each THING, one for each class that it can be reported as. A row holds G
scores, G spreads and three times G normal quantiles of lapses (the object's own, of the aspect, of the look)
over the grid of log pixels, then the numbers of the FACTORS, the object's own offset and the weights of the
aspect and of the rest, in standard deviations, the object's own draw for lapses, and how fast aspects fade.

What is common to an aspect fades as the line of sight turns and the object grows: the score's part little by
little, the draw for lapses by being drawn anew with a chance, so that it stays the same or is another.

A draw is a hash of seed, look and row (SplitMix64: Steele, Lea and Flood, OOPSLA 2014), so that the luck of
one object never depends on what else is in view, and what is out of view costs nothing.

A picture that the detector looks at in tiles is one look for each tile: what lies in two of them is drawn
twice, of the same luck, and boxes of one object that overlap become one, as the detector merges them.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit

from skysweep.arrays import F64, I64
from skysweep.geometry.point_tree import in_view
from skysweep.sensing.statistical.factors import (
    COMPANY_PX,
    CUT_MIN,
    FACTORS,
    HIDDEN_MAX,
    TOO_SMALL,
    factors_of_look,
)
from skysweep.sensing.statistical.luck import kept
from skysweep.worlds.grid import around
from skysweep.worlds.occlusion import is_behind_a_hill, pixels_on_target, visible_share

Record = Any  # of SENSOR

_N_FACTORS = len(FACTORS)
TABLES = 8  # of a row
WIDTH = _N_FACTORS + 5  # columns of a row after them
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
        ("fade_scale", float),
        ("iou_max", float),  # of two boxes of one object
        ("largest", float),  # size of the things, in metres
        ("farthest_cut", float),  # of the ghosts, in metres
    ]
)
THING = np.dtype(  # an object that can be reported
    [
        ("place", float, 3),
        ("size", float),
        ("shape", np.int64),
        ("beside", float),
        ("shade", float),
        ("contrast", float),
        ("facing", float, 2),  # cosine and sine of its yaw
        ("rows", np.int64, 2),  # its part of the table
        ("last", float, 4),  # direction to the camera and log pixels in the last picture that had it
    ]
)
GHOST = np.dtype(  # a place where something can be reported that is not there
    [("place", float, 3), ("kind", float), ("level", float), ("own", float), ("cut_m", float)]
    # cut_m: where this is not 0, it shows only while an edge of the picture is so near, and at that edge
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

_NOT_KNOWN = -1.0
ROUNDING_M = 1e-6
_LAPSE, _ASPECT, _REST, _CENTRE_U, _CENTRE_V, _ANEW, _ASPECT_LAPSE = range(7)  # what is drawn of a row
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
def _uniform(seed: int, look: int, row: int, what: int) -> float:
    """Another, from 0 to 1."""
    number = np.uint64((look * (2 * _FIRST_GHOST) + row) * _KINDS_OF_DRAW + what)
    return (float(_hash(_hash(np.uint64(seed)) + number * _GOLDEN) >> np.uint64(11)) + 0.5) * 2.0**-53


@njit(cache=True)
def draw_look(
    sensor: F64,
    tiles: F64,
    position: F64,
    R: F64,
    velocity: F64,
    rates: F64,
    log_altitude: float,
    look: int,
    things: F64,
    tree_boxes: F64,
    tree_nodes: I64,
    tree_order: I64,
    solids: F64,
    grid_frame: F64,
    grid_starts: I64,
    grid_order: I64,
    heights: F64,
    bounds: F64,
    table: F64,
    log_pixels: F64,
    aspects: F64,
    ghosts: F64,
    first_ghost: int,
    ghost_boxes: F64,
    ghost_nodes: I64,
    ghost_order: I64,
    ghost_classes: F64,
    over_altitude: F64,
    room: I64,
    boxes: F64,
    scores: F64,
    rows: I64,
) -> tuple[int, int]:
    """Write what is reported into ``boxes`` (N, 4), ``scores`` (N,) and ``rows`` (N,), with room for all.

    The first are objects, by their rows of the ``table`` (rows, TABLES * G + WIDTH); then ghosts, by class.
    Returns where each part ends.

    ``sensor``, ``things``, ``ghosts`` and ``ghost_classes`` are the floats of their records, the ghosts those
    of this altitude alone, of which the first has the number ``first_ghost``. The arrays ``tree_...`` and
    ``ghost_...`` are the ``PointTree`` of their places, ``grid_...`` the ``Grid`` of the ``solids``,
    ``heights`` and ``bounds`` the ground's ``relief``. ``tiles`` (T, 4) are parts of the picture.
    ``position``, ``R``, ``velocity`` and ``rates`` are the camera's truth, the last two in its own axes.
    ``log_pixels`` (G,) is the table's grid, ``aspects`` (rows, 2) what looks at one aspect have in common:
    of the score and of lapses. ``over_altitude`` (classes, 3, A): log altitudes, densities and scales of the
    score. ``room`` is for indices of things, ghosts and solids.
    """
    s = sensor.view(SENSOR)[0]
    all_things = things.view(THING)
    across, up = s.width_px / (2.0 * s.focal_px), s.height_px / (2.0 * s.focal_px)
    n_in_view = in_view(room, tree_boxes, tree_nodes, tree_order, position, R, across, up, s.largest)
    n, company = 0, _company(s, tiles, position, R, all_things, room[:n_in_view])
    for i in room[:n_in_view]:
        n = _draw_thing(
            s,
            tiles,
            company,
            position,
            R,
            velocity,
            rates,
            look,
            all_things[i],
            solids,
            grid_frame,
            grid_starts,
            grid_order,
            heights,
            bounds,
            table,
            log_pixels,
            aspects,
            room[n_in_view:],
            n,
            boxes,
            scores,
            rows,
        )
    n_in_view = in_view(room, ghost_boxes, ghost_nodes, ghost_order, position, R, across, up, s.farthest_cut)
    end = _draw_ghosts(
        s,
        tiles,
        position,
        R,
        log_altitude,
        look,
        ghosts,
        first_ghost,
        room[:n_in_view],
        ghost_classes,
        over_altitude,
        n,
        boxes,
        scores,
        rows,
    )
    return n, end


@njit(cache=True)
def _company(s: Record, tiles: F64, position: F64, R: F64, things: Record, in_sight: I64) -> F64:
    """(T,) how many things are in each tile."""
    found = np.zeros(len(tiles))
    for i in in_sight:
        place = things[i].place
        dx, dy, dz = place[0] - position[0], place[1] - position[1], place[2] - position[2]
        u, v, depth = _project(s, R, dx, dy, dz)
        for t in range(len(tiles)):
            found[t] += _is_company(s, tiles[t], things[i].size, u, v, depth)
    return found


@njit(cache=True)
def _is_company(s: Record, tile: F64, size_m: float, u: float, v: float, depth: float) -> bool:
    """Whether something at these pixels counts as company for the other things in a tile."""
    inside = tile[0] <= u <= tile[2] and tile[1] <= v <= tile[3]
    return bool(inside and s.focal_px * size_m >= COMPANY_PX * depth)


@njit(cache=True)
def _draw_thing(
    s: Record,
    tiles: F64,
    company: F64,
    position: F64,
    R: F64,
    velocity: F64,
    rates: F64,
    look: int,
    thing: Record,
    solids: F64,
    grid_frame: F64,
    grid_starts: I64,
    grid_order: I64,
    heights: F64,
    bounds: F64,
    table: F64,
    log_pixels: F64,
    aspects: F64,
    room: I64,
    n: int,
    boxes: F64,
    scores: F64,
    rows: I64,
) -> int:
    """One object that may be in the picture, written from place ``n`` on; where that ends."""
    focal, width, height, g = s.focal_px, s.width_px, s.height_px, len(log_pixels)
    place, last = thing.place, thing.last
    dx, dy, dz = place[0] - position[0], place[1] - position[1], place[2] - position[2]
    u, v, depth = _project(s, R, dx, dy, dz)
    if depth <= MIN_DEPTH_M:
        return n
    pixels = pixels_on_target(focal, thing.shape, thing.size, dx, dy, dz, depth)
    half = pixels / 2
    if max(u - half, 0.0) >= min(u + half, width) or max(v - half, 0.0) >= min(v + half, height):
        return n
    across = dx * dx + dy * dy
    away = max(across + dz * dz, 1e-9)
    at, distance = math.log(pixels), math.sqrt(away)
    x, y, z = -dx / distance, -dy / distance, -dz / distance
    turned, grown = math.sqrt((x - last[0]) ** 2 + (y - last[1]) ** 2 + (z - last[2]) ** 2), at - last[3]
    is_new = last[3] != last[3]
    last[0], last[1], last[2], last[3] = x, y, z, at
    for r in range(thing.rows[0], thing.rows[1]):
        left = 0.0 if is_new else kept(turned, grown, table[r, TABLES * g + _N_FACTORS + 4], s.fade_scale)
        fresh = standard_normal(s.seed, look * len(tiles), r, _ASPECT)
        aspects[r, 0] = left * aspects[r, 0] + math.sqrt(1.0 - left * left) * fresh
        if _uniform(s.seed, look * len(tiles), r, _ANEW) >= left:
            aspects[r, 1] = standard_normal(s.seed, look * len(tiles), r, _ASPECT_LAPSE)
    if at < log_pixels[0] + math.log(TOO_SMALL):
        return n
    clear = _NOT_KNOWN
    blur = math.hypot(-velocity[0] / depth - rates[1], -velocity[1] / depth + rates[0])
    blur *= focal * s.exposure_s
    spread_px = math.sqrt(
        s.centre_px**2 + (s.centre_of_object * pixels) ** 2 + (s.centre_of_blur * blur) ** 2
    )
    front = thing.facing[0] * x + thing.facing[1] * y
    first = n
    for t in range(len(tiles)):
        tile, tile_look = tiles[t], look * len(tiles) + t
        low_u, high_u = max(u - half, tile[0]), min(u + half, tile[2])
        low_v, high_v = max(v - half, tile[1]), min(v + half, tile[3])
        if low_u >= high_u or low_v >= high_v:
            continue
        inside_y = (high_v - low_v) / pixels
        inside = (high_u - low_u) / pixels * inside_y
        if inside < 1.0 - HIDDEN_MAX:
            continue
        if clear == _NOT_KNOWN:
            n_near = around(
                room,
                grid_frame,
                grid_starts,
                grid_order,
                place[0],
                place[1],
                position[0],
                position[1],
                thing.size,
            )
            clear = visible_share(position, place, thing.size, solids, room[:n_near])
            if is_behind_a_hill(position, place, heights, bounds):
                clear = 0.0
        if inside * clear < 1.0 - HIDDEN_MAX:
            continue
        factors = factors_of_look(
            across / away,
            front,
            pixels,
            1.0 - clear,
            1.0 - inside,
            inside_y < 1.0 - CUT_MIN,
            thing.beside,
            thing.shade,
            blur,
            thing.contrast,
            company[t] - _is_company(s, tile, thing.size, u, v, depth),
        )
        of_lapses = 5 if thing.beside > 0.0 or thing.shade > 0.0 or clear < 1.0 else 2
        for r in range(thing.rows[0], thing.rows[1]):
            mean, spread, own_lapse, aspect_lapse, lapse = _interpolate(log_pixels, table[r], at, of_lapses)
            own = table[r, TABLES * g :]
            if own[_N_FACTORS + 3] < own_lapse or aspects[r, 1] < aspect_lapse:
                continue
            if standard_normal(s.seed, tile_look, r, _LAPSE) < lapse:
                continue
            for k in range(_N_FACTORS):
                mean += own[k] * factors[k]
            rest = own[_N_FACTORS + 2] * standard_normal(s.seed, tile_look, r, _REST)
            score = mean + spread * (own[_N_FACTORS] + own[_N_FACTORS + 1] * aspects[r, 0] + rest)
            if score < s.threshold:
                continue
            du = spread_px * standard_normal(s.seed, tile_look, r, _CENTRE_U)
            dv = spread_px * standard_normal(s.seed, tile_look, r, _CENTRE_V)
            _put_box(boxes[n], low_u, low_v, high_u, high_v, du, dv, tile)
            scores[n], rows[n] = score, r
            n += 1
    return _merged(boxes, scores, rows, first, n, s.iou_max) if len(tiles) > 1 else n


@njit(cache=True)
def _merged(boxes: F64, scores: F64, rows: I64, first: int, end: int, iou_max: float) -> int:
    """Drop, from ``first`` on, the reports that a better one of the same row overlaps; the new end."""
    order = np.argsort(-scores[first:end]) + first
    is_kept = np.ones(end - first, dtype=np.bool_)
    for k in range(1, len(order)):
        for j in order[:k]:
            same = is_kept[j - first] and rows[j] == rows[order[k]]
            if same and _overlap(boxes[j], boxes[order[k]]) > iou_max:
                is_kept[order[k] - first] = False
    n = first
    for i in range(first, end):
        if is_kept[i - first]:
            boxes[n], scores[n], rows[n] = boxes[i], scores[i], rows[i]
            n += 1
    return n


@njit(cache=True)
def _overlap(a: F64, b: F64) -> float:
    """Intersection over union."""
    width, height = min(a[2], b[2]) - max(a[0], b[0]), min(a[3], b[3]) - max(a[1], b[1])
    both = max(width, 0.0) * max(height, 0.0)
    return float(both / ((a[2] - a[0]) * (a[3] - a[1]) + (b[2] - b[0]) * (b[3] - b[1]) - both))


@njit(cache=True)
def _draw_ghosts(
    s: Record,
    tiles: F64,
    position: F64,
    R: F64,
    log_altitude: float,
    look: int,
    ghosts: F64,
    first_ghost: int,
    in_sight: I64,
    ghost_classes: F64,
    over_altitude: F64,
    n: int,
    boxes: F64,
    scores: F64,
    rows: I64,
) -> int:
    """Those in sight, lowest levels first, written from place ``n`` on; where that ends.

    Scores are Weibull's. Where two tiles show one, the better report counts.
    """
    if not len(in_sight):
        return n
    places, classes = ghosts.view(GHOST), ghost_classes.view(GHOST_CLASS)
    now = np.empty((len(classes), 2))
    for k in range(len(classes)):
        now[k, 0] = _at(log_altitude, over_altitude[k, 0], over_altitude[k, 1])
        now[k, 1] = _at(log_altitude, over_altitude[k, 0], over_altitude[k, 2])
    whole = np.array((0.0, 0.0, s.width_px, s.height_px))
    for i in in_sight:
        ghost = places[i]
        kind = int(ghost.kind)
        if ghost.level >= now[kind, 0]:
            continue
        place, c = ghost.place, classes[kind]
        dx, dy, dz = place[0] - position[0], place[1] - position[1], place[2] - position[2]
        u, v, depth = _project(s, R, dx, dy, dz)
        if ghost.cut_m > 0.0:
            u, v = _at_edge(s, u, v, s.focal_px * ghost.cut_m / depth, c.pixels / 2)
        if not (0.0 <= u <= s.width_px and 0.0 <= v <= s.height_px) or n == len(rows):
            continue
        row, best = _FIRST_GHOST + first_ghost + i, -math.inf
        for t in range(len(tiles)):
            tile, tile_look = tiles[t], look * len(tiles) + t
            if not (tile[0] <= u <= tile[2] and tile[1] <= v <= tile[3]):
                continue
            if standard_normal(s.seed, tile_look, row, _SHOWS) > c.shows:
                continue
            z = ghost.own + c.rest * standard_normal(s.seed, tile_look, row, _SCORE)
            above = -math.log(max(0.5 * math.erfc(z / math.sqrt(2.0)), 1e-12))
            best = max(best, s.floor + now[kind, 1] * c.unit_scale * above**c.exponent)
        if best < s.threshold:
            continue
        half = c.pixels / 2
        _put_box(boxes[n], u - half, v - half, u + half, v + half, 0.0, 0.0, whole)
        scores[n], rows[n] = best, kind
        n += 1
    return n


@njit(cache=True)
def _at_edge(s: Record, u: float, v: float, reach: float, half: float) -> tuple[float, float]:
    """The middle of a box that reaches the edge of the picture nearest to a place; NaN if that is far."""
    beside, above = min(u, s.width_px - u), min(v, s.height_px - v)  # negative outside
    if not abs(min(beside, above)) < reach:
        return np.nan, np.nan
    if beside < above:
        u = half if u < s.width_px / 2 else s.width_px - half
    else:
        v = half if v < s.height_px / 2 else s.height_px - half
    return min(max(u, half), s.width_px - half), min(max(v, half), s.height_px - half)


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
def _interpolate(grid: F64, row: F64, at: float, of_lapses: int) -> tuple[float, float, float, float, float]:
    """Tables at a log of pixels: score, spread and the three ``of_lapses`` on.

    They are linear between the nodes and constant beyond.
    """
    g = len(grid)
    k = 0
    while k < g - 2 and at > grid[k + 1]:
        k += 1
    w = min(max((at - grid[k]) / (grid[k + 1] - grid[k]), 0.0), 1.0)
    mean = row[k] + w * (row[k + 1] - row[k])
    spread = row[g + k] + w * (row[g + k + 1] - row[g + k])
    k += of_lapses * g
    own = row[k] + w * (row[k + 1] - row[k])
    of_aspect = row[g + k] + w * (row[g + k + 1] - row[g + k])
    return mean, spread, own, of_aspect, row[2 * g + k] + w * (row[2 * g + k + 1] - row[2 * g + k])


@njit(cache=True)
def _put_box(
    box: F64,
    low_u: float,
    low_v: float,
    high_u: float,
    high_v: float,
    move_u: float,
    move_v: float,
    limits: F64,
) -> None:
    """A box of at least one pixel, moved and kept within limits: left, top, right and bottom."""
    left, top, right, bottom = limits
    half_u, half_v = max((high_u - low_u) / 2, 0.5), max((high_v - low_v) / 2, 0.5)
    u = min(max((low_u + high_u) / 2 + move_u, left + 0.5), right - 0.5)
    v = min(max((low_v + high_v) / 2 + move_v, top + 0.5), bottom - 0.5)
    box[0], box[2] = max(u - half_u, left), min(u + half_u, right)
    box[1], box[3] = max(v - half_v, top), min(v + half_v, bottom)
