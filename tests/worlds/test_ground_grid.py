"""Chunks of any level of detail cover the ground without cracks; what is drawn depends on the view."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skysweep.worlds.ground_grid import CHUNK_CELLS, CHUNK_POSTS, GroundGrid
from skysweep.worlds.world import TerrainSurface

CHUNKS = 3  # a side, with the ring of flat ground around the world


def hills(posts: int = 3 * CHUNK_CELLS - 5, spacing_m: float = 2.0) -> TerrainSurface:
    side_m = (posts - 1) * spacing_m
    heights = np.random.default_rng(1).uniform(0, 20, (posts, posts))
    return TerrainSurface(heights, (0.0, 0.0, side_m, side_m), "grass")


@settings(max_examples=30)
@given(st.lists(st.integers(0, 5), min_size=CHUNKS**2, max_size=CHUNKS**2))
def test_neighbours_of_any_levels_share_all_edges(levels: list[int]) -> None:
    grid = GroundGrid(hills())
    chunks = np.arange(CHUNKS**2)
    edges: Counter[tuple[int, int]] = Counter()
    area = 0.0
    for chunk, faces in zip(chunks.tolist(), grid.faces(chunks, 2.0 / 2.0 ** np.array(levels)), strict=True):
        i, j = divmod(chunk, CHUNKS)
        r, c = i * CHUNK_CELLS + faces // CHUNK_POSTS, j * CHUNK_CELLS + faces % CHUNK_POSTS
        u, v = c[:, 1:] - c[:, :1], r[:, 1:] - r[:, :1]
        twice = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
        assert (twice > 0).all()  # all face up
        area += 0.5 * float(twice.sum())
        posts = r * 10_000 + c
        for a, b in ((0, 1), (1, 2), (2, 0)):
            edges.update(zip(posts[:, a].tolist(), posts[:, b].tolist(), strict=True))
    side = CHUNKS * CHUNK_CELLS
    assert area == side**2
    for (a, b), times in edges.items():
        assert times == 1
        if (b, a) not in edges:  # only the border of the whole has no other side
            assert {a // 10_000, b // 10_000} in ({0}, {side}) or {a % 10_000, b % 10_000} in ({0}, {side})


def test_posts_lie_on_the_terrain_and_their_normals_agree_across_chunks() -> None:
    terrain = hills()
    grid, whole = GroundGrid(terrain), GroundGrid(terrain).mesh()
    by_place = {
        tuple(v): tuple(n) for v, n in zip(whole.vertices.tolist(), whole.normals.tolist(), strict=True)
    }
    for chunk in range(len(grid.low_enu_m)):
        vertices, normals = grid.posts(chunk)
        assert vertices[:, 2] == pytest.approx(terrain.height_m(vertices[:, :2]), abs=1e-4)
        low, high = grid.low_enu_m[chunk], grid.high_enu_m[chunk]
        assert (vertices >= low - 1e-3).all()
        assert (vertices <= high + 1e-3).all()
        inner = np.flatnonzero((vertices[:, :2] < [grid.x_m[-1], grid.y_m[-1]]).all(axis=1))
        for k in inner.tolist():
            assert by_place[tuple(vertices[k].tolist())] == tuple(normals[k].tolist())


def test_far_ground_takes_few_triangles() -> None:
    grid = GroundGrid(hills(20 * CHUNK_CELLS))
    chunks = np.arange(len(grid.low_enu_m))
    finest = sum(map(len, grid.faces(chunks, np.full(len(chunks), 2.0))))
    far = sum(map(len, grid.faces(chunks, np.full(len(chunks), 0.1))))
    assert far < finest / 200
