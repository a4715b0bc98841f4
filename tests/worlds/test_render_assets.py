"""Every asset, in every look, is a sound mesh of the size it was asked for."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skysweep.scenarios.model import DEFAULT_SIZE_M
from skysweep.worlds.assets import KINDS, object_mesh
from skysweep.worlds.assets.buildings import building_mesh
from skysweep.worlds.assets.plants import DETAILS, SHAPES, tree_meshes
from skysweep.worlds.meshes import Mesh, ellipsoid, lathe, tube
from skysweep.worlds.textures import Decal, decal_layer, ground_textures, layer_image
from skysweep.worlds.world import HELD_OUT_VARIANTS

SIZE_M = DEFAULT_SIZE_M | {"car": 4.5}  # which scenarios do not know
POSES = ["face-up", "standing", "lying", "floating", "sitting", "crouching", "walking", "waving"]
variants = st.one_of(st.integers(0, HELD_OUT_VARIANTS - 1), st.integers(HELD_OUT_VARIANTS, 1999))


def sound(mesh: Mesh) -> None:
    assert all(np.isfinite(a).all() for a in (mesh.vertices, mesh.normals, mesh.colours, mesh.texture))
    assert np.allclose(np.linalg.norm(mesh.normals, axis=1), 1.0, atol=1e-3)
    assert mesh.colours.min() >= 0
    assert mesh.colours.max() <= 1
    assert mesh.faces.min() >= 0
    assert mesh.faces.max() < len(mesh.vertices)


@settings(max_examples=60)
@given(kind=st.sampled_from(KINDS), pose=st.sampled_from(POSES), variant=variants, scale=st.floats(0.4, 2.5))
def test_objects_are_sound_and_of_their_size(kind: str, pose: str, variant: int, scale: float) -> None:
    size_m = SIZE_M[kind] * scale
    mesh = object_mesh(kind, size_m, pose, variant)
    sound(mesh)
    extent = np.ptp(mesh.vertices.astype(float), axis=0)
    longest = {"stop sign": 1.09, "boat": 1.5, "person": 1.35}.get(kind, 1.6)
    if pose == "standing" and "sign" in kind:
        assert extent[2] < 2.2 + 1.1 * size_m
    elif kind == "boat":
        assert 0.8 * size_m < extent[0] < longest * size_m + 1.0
    else:
        assert 0.35 * size_m < extent.max() < longest * size_m


@settings(max_examples=25)
@given(kind=st.sampled_from(KINDS), pose=st.sampled_from(POSES), variant=variants)
def test_the_same_variant_looks_the_same(kind: str, pose: str, variant: int) -> None:
    a, b = (object_mesh(kind, SIZE_M[kind], pose, variant) for _ in range(2))
    assert a.vertices.tobytes() == b.vertices.tobytes()
    assert a.colours.tobytes() == b.colours.tobytes()


@pytest.mark.parametrize("kind", KINDS)
def test_variants_differ(kind: str) -> None:
    looks = {
        object_mesh(kind, SIZE_M[kind], "face-up", v).vertices.tobytes() for v in (0, 1, 2, 3, 1000, 1001)
    }
    assert len(looks) == 6


@pytest.mark.parametrize("group", list(Decal))
def test_held_out_decals_are_other_pictures(group: Decal) -> None:
    training = {decal_layer(group, v) for v in range(200)}
    held_out = {decal_layer(group, HELD_OUT_VARIANTS + v) for v in range(200)}
    assert len(training) == len(held_out) > 10
    assert not training & held_out
    pictures = {layer_image(layer).tobytes() for layer in training | held_out}
    assert len(pictures) == len(training) + len(held_out)


@pytest.mark.parametrize("kind", ["broadleaf", "conifer", "bush"])
def test_trees_stay_inside_the_crown_that_the_world_promises(kind: str) -> None:
    for shape in range(SHAPES):
        meshes = tree_meshes(kind, shape)
        assert len(meshes) == DETAILS
        for mesh in meshes:
            sound(mesh)
            assert np.hypot(*mesh.vertices[:, :2].T).max() <= 1.0 + 1e-6
            assert 0.8 < mesh.vertices[:, 2].max() <= 1.05
        faces = [len(m.faces) for m in meshes]
        assert faces == sorted(faces)


@given(length=st.floats(3, 40), width=st.floats(3, 30), height=st.floats(2, 60), variant=st.integers(0, 50))
@settings(max_examples=15)
def test_buildings_have_their_size_and_a_roof(
    length: float, width: float, height: float, variant: int
) -> None:
    mesh = building_mesh((length, width), height, variant)
    sound(mesh)
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    assert np.allclose([high[0] - low[0], high[1] - low[1]], [length + 0.8, width + 0.8], atol=0.01)
    assert high[2] > height


@pytest.mark.parametrize(
    "closed",
    [
        ellipsoid((0.5, 0.2, 0.3), (1, 1, 1)),
        tube([(0, 0, 0), (1, 0, 0), (1, 1, 0.5)], [0.1, 0.1, 0.05], (1, 1, 1)),
        lathe([(0.3, 0), (0.5, 0.4), (0.2, 1.0)], (1, 1, 1)),
    ],
    ids=["ellipsoid", "tube", "lathe"],
)
def test_closed_shapes_face_outwards(closed: Mesh) -> None:
    a, b, c = (closed.vertices[closed.faces[:, k]].astype(float) for k in range(3))
    assert (np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6) > 0


@pytest.mark.parametrize("surface", ["grass", "forest floor", "rock", "sand", "snow", "water", "asphalt"])
def test_ground_textures_tile_without_seams(surface: str) -> None:
    textures = ground_textures(surface, 0)
    for image in (textures.detail, textures.middle, textures.macro):
        grey = image.astype(float).mean(axis=2)
        for axis in (0, 1):
            inside = np.abs(np.diff(grey, axis=axis)).mean()
            seam = np.abs(np.take(grey, 0, axis) - np.take(grey, -1, axis)).mean()
            assert seam < 2.0 * inside + 1.0
