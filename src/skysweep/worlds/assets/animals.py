"""Animals that resemble a person lying or crouching from above: sheep, deer, dogs. Head towards +x."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skysweep.arrays import F64
from skysweep.worlds.assets.looks import Appearance
from skysweep.worlds.materials import Material
from skysweep.worlds.meshes import Mesh, ellipsoid, icosphere, lumpy, make_mesh, merge, tube, yaw_rotation
from skysweep.worlds.textures import Layer

_FLEECE = "e2dccc d8cfba ece8dc cabfa8 4a4038"
_FLEECE_HELD_OUT = "dcd8d0 c8c0ae 5c5046"
_FACE = "282420 e0d8c8 4a4038"
_HIDE = "8a5c38 9c6a40 76502e a67848"
_HIDE_HELD_OUT = "92684a 6e4a30 b08450"
_COAT = "28241f 6e4a2a b08a54 e0d6c4 50463e 6e3a22"
_COAT_HELD_OUT = "1c1c1e 94703e d2c0a0 685c50"
_ANTLER = (0.45, 0.36, 0.26)


@dataclass(frozen=True, slots=True)
class Build:
    """Proportions in body lengths, nose to rump."""

    barrel: tuple[float, float, float]  # length, width, height of the trunk
    legs: float  # from belly to hoof
    leg_radius: float
    neck: float
    head: tuple[float, float, float]
    neck_rise: float  # rad above level when the head is up


_SHEEP = Build((0.74, 0.36, 0.38), 0.27, 0.030, 0.16, (0.21, 0.11, 0.13), 0.7)
_DEER = Build((0.70, 0.25, 0.30), 0.38, 0.020, 0.24, (0.20, 0.09, 0.11), 0.9)
_DOG = Build((0.66, 0.24, 0.27), 0.30, 0.027, 0.15, (0.25, 0.14, 0.14), 0.75)


def sheep(looks: Appearance, size_m: float, pose: str) -> Mesh:
    """A sheep in its fleece, ``size_m`` long, grazing or with its head up; lying if that is its pose."""
    fleece = looks.pick(_FLEECE, _FLEECE_HELD_OUT)
    face = looks.pick(_FACE)
    v, f = icosphere(3)
    wool = 0.90 + 0.10 * lumpy(v, looks.rng, 60, 0.22)
    long, wide, high = _SHEEP.barrel
    trunk = make_mesh(v * wool[:, None] * (long / 2, wide / 2, high / 2), f, fleece, Layer.FABRIC, 0.2)
    ears = _ears((0.06, 0.02, 0.025), face, 0.3)
    return _animal(looks, _SHEEP, trunk, fleece, face, face, pose, grazes=0.7, extras=[ears]).moved(
        scale=size_m
    )


def deer(looks: Appearance, size_m: float, pose: str) -> Mesh:
    """A deer ``size_m`` long: slender, its rump white; a third are stags with antlers."""
    hide = looks.pick(_HIDE, _HIDE_HELD_OUT)
    trunk = _trunk(_DEER, hide, pale=np.array([0.86, 0.82, 0.74]))
    extras = [_ears((0.07, 0.018, 0.035), hide, 0.9)]
    if looks.chance(0.33):
        extras += [_antler(side, looks) for side in (1.0, -1.0)]
    return _animal(looks, _DEER, trunk, hide, hide, hide * 0.75, pose, grazes=0.5, extras=extras).moved(
        scale=size_m
    )


def dog(looks: Appearance, size_m: float, pose: str) -> Mesh:
    """A dog ``size_m`` long without its tail, of one coat or with another belly and legs."""
    coat = looks.pick(_COAT, _COAT_HELD_OUT)
    legs = looks.pick(_COAT, _COAT_HELD_OUT) if looks.chance(0.3) else coat
    trunk = _trunk(_DOG, coat, pale=None)
    rise = looks.between(-0.4, 1.2)
    tail = tube(
        np.array([[-0.30, 0, 0.04], [-0.40, 0, 0.04 + 0.10 * rise], [-0.52, 0, 0.04 + 0.2 * rise]]),
        [0.026, 0.022, 0.012],
        coat,
        n=6,
    )
    ears = _ears((0.05, 0.02, 0.05), coat, looks.between(0.2, 1.0))
    body = merge([trunk, tail])
    return _animal(looks, _DOG, body, coat, coat, legs, pose, grazes=0.15, extras=[ears]).moved(scale=size_m)


def _trunk(build: Build, colour: F64, pale: F64 | None) -> Mesh:
    """Chest and hindquarters, slimmer between them; ``pale`` colours the rump."""
    long, wide, high = build.barrel
    x = long * np.array([-0.50, -0.42, -0.25, 0.0, 0.22, 0.40, 0.50])
    radius = np.array([0.45, 0.85, 1.0, 0.86, 1.0, 0.9, 0.55])
    points = np.column_stack([x, np.zeros(7), high * np.array([0.10, 0.04, 0.0, -0.02, -0.02, 0.05, 0.12])])
    colours = np.tile(colour, (7, 1))
    if pale is not None:
        colours[0] = pale
    return tube(points, 0.5 * high * radius, colours, n=12).moved(scale=(1.0, wide / high, 1.0))


def _ears(size: tuple[float, float, float], colour: F64, rise: float) -> Mesh:
    """Two ears about the origin of the head."""
    out = [np.array([-0.05, side * 0.06, 0.05 * rise]) for side in (1.0, -1.0)]
    return merge([ellipsoid((size[1], size[0] * 0.7, size[2]), colour, n=6).moved(at) for at in out])


def _antler(side: float, looks: Appearance) -> Mesh:
    spread = looks.between(0.08, 0.14)
    beam = np.array(
        [[-0.03, 0.02 * side, 0.04], [-0.10, spread * side, 0.14], [-0.02, 1.4 * spread * side, 0.27]]
    )
    tine = np.array([beam[1], beam[1] + [0.09, 0.01 * side, 0.05], beam[1] + [0.13, 0.02 * side, 0.10]])
    return merge([tube(line, [0.012, 0.010, 0.005], _ANTLER, n=5) for line in (beam, tine)])


def _animal(
    looks: Appearance,
    build: Build,
    trunk: Mesh,
    coat: F64,
    face: F64,
    legs: F64,
    pose: str,
    grazes: float,
    extras: list[Mesh],
) -> Mesh:
    """Trunk (about its own middle), legs, neck and head (``extras`` belong to it), in body lengths."""
    long, wide, high = build.barrel
    lies = pose == "lying"
    middle = high / 2 + (0.0 if lies else build.legs)
    fur = Material.FLEECE if build is _SHEEP else Material.COAT
    parts = [trunk.moved((-0.5 + long / 2, 0.0, middle)).made_of(fur)]
    for fore in (True, False):
        for side in (1.0, -1.0):
            hip = np.array([-0.5 + long * (0.84 if fore else 0.14), 0.30 * side * wide, middle - 0.12 * high])
            line = _folded(hip, fore) if lies else _stood(hip, fore, looks)
            thick = build.leg_radius * np.array([2.2, 1.1, 1.0])
            leg = tube(line, thick, np.stack([coat, legs, legs]), n=6)
            parts.append(leg.made_of(Material.SHORT_COAT))
    root = np.array([-0.5 + 0.93 * long, 0.0, middle + 0.22 * high])
    down = not lies and looks.chance(grazes)
    rise = -looks.between(0.5, 0.8) if down else build.neck_rise * looks.between(0.75, 1.1)
    turned = yaw_rotation(looks.rng.normal(0, 0.25))
    along = turned @ [np.cos(rise), 0.0, np.sin(rise)]
    reach = min(build.neck * 1.35, (root[2] - 0.06) / -along[2]) if down else build.neck
    poll = root + reach * along
    neck_radius = 0.5 * min(wide, high) * np.array([0.72, 0.56, 0.42])
    throat = tube(np.array([root - 0.10 * along, 0.5 * (root + poll), poll]), neck_radius, coat, n=9)
    parts.append(throat.made_of(fur))
    nod = 0.9 if down else 0.35  # the face points down and ahead
    bowed = np.array([[np.cos(nod), 0, np.sin(nod)], [0, 1, 0], [-np.sin(nod), 0, np.cos(nod)]])
    head = merge([_head(build, face), *extras]).moved(poll, turned @ bowed)
    parts.append(head.made_of(Material.SHORT_COAT))
    return merge(parts).grounded(0.25, 0.72)


def _folded(hip: F64, fore: bool) -> F64:
    """A leg beside the belly of one that lies."""
    x, y, _ = hip
    ahead = 0.16 if fore else 0.20
    return np.array([[x, 1.5 * y, 0.10], [x + ahead, 1.75 * y, 0.05], [x + 0.04, 1.85 * y, 0.03]])


def _stood(hip: F64, fore: bool, looks: Appearance) -> F64:
    """A leg that stands, a little ahead of or behind the hip."""
    x, y, top = hip
    step = looks.rng.normal(0, 0.05)
    bend = 0.02 if fore else -0.05
    return np.array([[x, y, top], [x + 0.5 * step + bend, y, 0.48 * top], [x + step, y, 0.01]])


def _head(build: Build, face: F64) -> Mesh:
    """Skull and muzzle about the poll, along x."""
    length, width, height = build.head
    skull = ellipsoid((0.5 * length, 0.5 * width, 0.5 * height), face, n=10).moved((0.32 * length, 0, 0))
    muzzle = ellipsoid((0.3 * length, 0.32 * width, 0.32 * height), face * 0.85, n=8)
    return merge([skull, muzzle.moved((0.62 * length, 0, -0.12 * height))])
