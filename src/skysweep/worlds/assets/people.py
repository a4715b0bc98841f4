"""People: a skeleton posed, then dressed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from skysweep.arrays import F64
from skysweep.worlds.assets.looks import Appearance
from skysweep.worlds.materials import Material
from skysweep.worlds.meshes import Mesh, box, circle, ellipsoid, loft, merge, tube
from skysweep.worlds.textures import Layer

_SKIN = "ecbc9e d6a07c b07a56 784e36 54382a"
_SKIN_HELD_OUT = "e2b092 c48e68 926446 624230"
_HAIR = "281e18 523822 96703e c8ac78 787470 602a16"
_HAIR_HELD_OUT = "1a1614 704c2e b29260 d2cec8"
_UPPER = "be2224 1e3e8c e8e8e4 222226 f09618 e0e028 2e683e 76787c 5694c8 80326e d67882 5a4c36"
_UPPER_HELD_OUT = "ce461e 146e78 f6f6f0 3c3c5a c4de28 a01e3c 465a32 968c78 3c82dc aa823c"
_LOWER = "243054 1e1e22 5c5646 465c82 827458 3a3e34 787a7e"
_LOWER_HELD_OUT = "34466e 2c2828 70644c 543c2e a09a8c 285046"
_BAG = "b4281e 244678 323828 dc821e 28282c"
_CLOTHES = {  # colours of the upper part; the lower part and what is worn over it are muted where that is
    "bright": "f46e14 e8e21e dc281e c8f028 ff5a96 1eaaeb f6f6f0",
    "muted": "5a4c36 465a32 6e6a5a 3e4436 50463c 74705c",
    "black": "1c1c20 2a2a2e",
    "blue": "1e3e8c 2a5ab0 5694c8",
    "brown": "5a4c36 6b4a2e 7e5e3e",
    "green": "2e683e 3c7a46 465a32",
    "grey": "76787c 8e9094 606266",
    "orange": "f46e14 f09618",
    "red": "be2224 d2302a a01e26",
    "white": "e8e8e4 f6f6f0",
    "yellow": "e8e21e f0d020",
}
_MUTED_BELOW = "3a3e34 5c5646 4a4238 3c3c40"
_CHILD_BELOW_M = 1.45  # of body height: the head is larger against the body


@dataclass(frozen=True, slots=True)
class Skeleton:
    """Joint positions in body heights: x forward, y left, z up."""

    pelvis: F64
    neck: F64
    head: F64
    arms: list[F64]  # two, each (3, 3): shoulder, elbow, wrist
    legs: list[F64]  # two, each (4, 3): hip, knee, ankle, toe


def person(looks: Appearance, size_m: float, pose: str) -> Mesh:
    """A person of body height ``size_m``; lying, where the pose is none of a person."""
    if pose == "floating":
        return _floating(looks, size_m)
    if pose not in _UPRIGHT:
        return _lying(looks, size_m)
    return _dress(looks, _UPRIGHT[pose](looks), size_m).moved(scale=size_m).grounded(0.3, 0.7)


def _floating(looks: Appearance, size_m: float) -> Mesh:
    """Upright in the water to the chest, arms out, or on the back with the face up."""
    if looks.chance(0.3):
        body = _dress(looks, _stretched(looks, knees=0.05), size_m, swimmer=True)
        return _on_the_back(body, face_up=True).moved((0, 0, -0.045), scale=size_m)
    spread = looks.rng.uniform(np.radians(60), np.radians(100), 2)
    skeleton = _upright(looks, spread, looks.rng.uniform(-0.3, 0.8, 2), looks.rng.uniform(0.1, 0.9, 2))
    lean = looks.rng.normal(0, 0.12)
    c, s = np.cos(lean), np.sin(lean)
    R = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    return _dress(looks, skeleton, size_m, swimmer=True).moved((0, 0, -0.775), R).moved(scale=size_m)


def _lying(looks: Appearance, size_m: float) -> Mesh:
    """Stretched out on the back or the belly, or curled up on the side."""
    if looks.chance(0.25):
        right_side_down = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
        body = _dress(looks, _sitting(looks, curled=True), size_m).moved(rotation=right_side_down)
        body = body.moved([*-body.vertices[:, :2].mean(axis=0), 0.11])
    else:
        body = _on_the_back(_dress(looks, _stretched(looks, knees=0.35), size_m), face_up=looks.chance(0.65))
    return body.moved(scale=size_m).grounded(0.15, 0.75)


def _on_the_back(body: Mesh, face_up: bool) -> Mesh:
    up = 1.0 if face_up else -1.0
    R = np.array([[0, 0, -up], [0, 1, 0], [up, 0, 0]])
    return body.moved((0, 0, -0.5)).moved((0, 0, 0.075), R)


def _limb(start: ArrayLike, direction: ArrayLike, bend: ArrayLike, first: float, second: float) -> F64:
    knee = start + first * np.asarray(direction) / np.linalg.norm(direction)
    return np.stack([start, knee, knee + second * np.asarray(bend) / np.linalg.norm(bend)])


def _arm(shoulder: ArrayLike, direction: ArrayLike, bend: ArrayLike) -> F64:
    return _limb(shoulder, direction, bend, 0.165, 0.15)


def _leg(hip: ArrayLike, direction: ArrayLike, bend: ArrayLike) -> F64:
    return _limb(hip, direction, bend, 0.245, 0.225)


def _with_toe(leg: F64, toe: ArrayLike) -> F64:
    return np.vstack([leg, leg[2] + toe])


def _straight(arms: list[F64], legs: list[F64], head_forward: float) -> Skeleton:
    return Skeleton(
        np.array([0, 0, 0.53]), np.array([0, 0, 0.83]), np.array([head_forward, 0, 0.925]), arms, legs
    )


def _upright(looks: Appearance, spread: F64, forward: F64, elbow: F64) -> Skeleton:
    """Standing straight, the arms ``spread`` rad from hanging, ``forward`` rad ahead, elbows bent."""
    hips, shoulders = looks.between(0.045, 0.055), looks.between(0.098, 0.115)
    arms, legs = [], []
    for side, a, f, e in zip((1, -1), spread, forward, elbow, strict=True):
        down = np.array([np.sin(f) * np.cos(a), side * np.sin(a), -np.cos(a) * np.cos(f)])
        bend = down + e * np.array([1.0, -0.4 * side, 0.5])
        arms.append(_arm([0, side * shoulders, 0.81], down, bend))
        stance, step = side * looks.between(0.02, 0.10), looks.between(-0.12, 0.12)
        leg = _leg([0, side * hips, 0.51], [step, stance, -1], [step - 0.06, stance, -1])
        legs.append(_with_toe(leg, [0.105, side * 0.02, -0.02]))
    return _straight(arms, legs, head_forward=0.012)


def _standing(looks: Appearance) -> Skeleton:
    spread = looks.rng.uniform(0.06, 0.4, 2)
    if looks.chance(0.35):  # waves
        spread[0] = looks.rng.uniform(2.0, 2.9)
        if looks.chance(0.6):
            spread[1] = looks.rng.uniform(2.0, 2.9)
    return _upright(looks, spread, looks.rng.uniform(-0.3, 0.4, 2), looks.rng.uniform(0.0, 0.7, 2))


def _waving(looks: Appearance) -> Skeleton:
    """One arm or both high up, the forearm to either side of the upper arm."""
    both = looks.chance(0.5)
    spread = looks.rng.uniform(2.1, 2.8, 2) if both else looks.rng.uniform([2.1, 0.06], [2.8, 0.4])
    return _upright(looks, spread, looks.rng.uniform(-0.3, 0.3, 2), looks.rng.uniform(-0.5, 0.7, 2))


def _walking(looks: Appearance) -> Skeleton:
    """In mid-stride: one leg ahead, the other behind on its toes, the arms against the legs."""
    hips, shoulders = looks.between(0.045, 0.055), looks.between(0.098, 0.115)
    first, stride = (1, -1) if looks.chance(0.5) else (-1, 1), looks.between(0.3, 0.5)
    arms, legs = [], []
    for side in (1, -1):
        ahead = stride if side == first[0] else -0.85 * stride
        shin = ahead - (0.1 if ahead > 0 else looks.rng.uniform(0.35, 0.75))
        thigh = [np.sin(ahead), 0.03 * side, -np.cos(ahead)]
        leg = _leg([0, side * hips, 0.51], thigh, [np.sin(shin), 0, -np.cos(shin)])
        legs.append(_with_toe(leg, [0.105, side * 0.015, -0.02 if ahead > 0 else -0.07]))
        swing = -0.8 * ahead + looks.rng.normal(0, 0.08)
        upper = [np.sin(swing), 0.16 * side, -np.cos(swing)]
        bent = swing + looks.rng.uniform(0.25, 0.7)
        arms.append(_arm([0.02, side * shoulders, 0.81], upper, [np.sin(bent), 0.05 * side, -np.cos(bent)]))
    lean = Skeleton(np.array([0, 0, 0.53]), np.array([0.03, 0, 0.83]), np.array([0.05, 0, 0.924]), arms, legs)
    return _on_its_feet(lean)


def _crouching(looks: Appearance) -> Skeleton:
    """Squatting on the feet, bent forward, the arms about the knees or on the ground."""
    hips, shoulders = looks.between(0.05, 0.065), looks.between(0.098, 0.115)
    lean = looks.between(0.35, 0.85)
    up = np.array([np.sin(lean), 0, np.cos(lean)])
    pelvis = np.array([0, 0, 0.17])
    arms, legs = [], []
    for side in (1, -1):
        rise, out = looks.rng.uniform(0.2, 0.45), looks.rng.uniform(0.05, 0.45)
        thigh = [np.cos(rise), side * out, np.sin(rise)]
        leg = _leg([0.01, side * hips, 0.165], thigh, [-0.35, -0.2 * side * out, -1])
        legs.append(_with_toe(leg, [0.105, side * 0.03, -0.015]))
        shoulder = pelvis + 0.28 * up + [0, side * shoulders, 0]
        reach = np.array([looks.rng.uniform(0.2, 0.9), side * looks.rng.uniform(-0.1, 0.5), -1.0])
        arms.append(_arm(shoulder, reach, reach + np.array([0.5, -0.6 * side, 0.2])))
    neck = pelvis + 0.30 * up
    return _on_its_feet(Skeleton(pelvis, neck, neck + np.array([0.035, 0, 0.088]), arms, legs))


def _on_its_feet(bones: Skeleton) -> Skeleton:
    """The skeleton moved up or down until its lowest foot is on the ground."""
    lowest = min(float(min(leg[2, 2] - 0.04, leg[3, 2] - 0.02)) for leg in bones.legs)
    up = np.array([0.0, 0.0, -lowest])
    return Skeleton(
        bones.pelvis + up,
        bones.neck + up,
        bones.head + up,
        [arm + up for arm in bones.arms],
        [leg + up for leg in bones.legs],
    )


def _stretched(looks: Appearance, knees: float) -> Skeleton:
    """Stretched out in the plane of the body, limbs spread sideways."""
    hips, shoulders = looks.between(0.045, 0.055), looks.between(0.098, 0.115)
    arms, legs = [], []
    for side in (1, -1):
        near, far = looks.rng.uniform(0.1, 0.6), looks.rng.uniform(0.8, 2.8)
        a = float(looks.rng.choice([near, far], p=[0.55, 0.45]))
        b = a + looks.rng.uniform(-0.5, 0.7)
        upper, lower = ([0, side * np.sin(t), -np.cos(t)] for t in (a, b))
        arms.append(_arm([0, side * shoulders, 0.81], upper, lower))
        t = looks.rng.uniform(0.02, 0.35)
        k = t + looks.rng.uniform(-1.2, 0.3) * knees
        thigh, shin = [0.02, side * np.sin(t), -np.cos(t)], [0, side * np.sin(k), -np.cos(k)]
        legs.append(_with_toe(_leg([0, side * hips, 0.51], thigh, shin), [0.03, side * 0.06, -0.07]))
    return _straight(arms, legs, head_forward=0.0)


def _sitting(looks: Appearance, curled: bool = False) -> Skeleton:
    hips, shoulders = looks.between(0.045, 0.055), looks.between(0.098, 0.115)
    lean = looks.between(-0.25, 0.3) if not curled else looks.between(0.3, 0.7)
    up = np.array([np.sin(lean), 0, np.cos(lean)])
    pelvis = np.array([0, 0, 0.065])
    neck = pelvis + 0.30 * up
    arms, legs = [], []
    for side in (1, -1):
        shoulder = pelvis + 0.28 * up + [0, side * shoulders, 0]
        reach = np.array([looks.rng.uniform(0.1, 0.9), side * 0.25, -0.7])
        arms.append(_arm(shoulder, reach, reach + np.array([0.8, -0.4 * side, 0.4])))
        rise = looks.rng.uniform(0.0, 0.9) if not curled else looks.rng.uniform(0.3, 0.9)
        drop = -rise * 245 / 225
        out = looks.rng.uniform(0.05, 0.35)
        ahead = -0.3 if curled else np.sqrt(max(0.04, 1 - drop**2))
        thigh = [np.sqrt(1 - min(rise, 0.95) ** 2), side * out, rise]
        leg = _leg([0.02, side * hips, 0.06], thigh, [ahead, -side * 0.3 * out, drop])
        leg[2, 2] = max(leg[2, 2], 0.03)
        legs.append(_with_toe(leg, [0.09, side * 0.02, 0.0]))
    return Skeleton(pelvis, neck, neck + 0.095 * up + [0.012, 0, 0], arms, legs)


_UPRIGHT = {
    "standing": _standing,
    "sitting": _sitting,
    "crouching": _crouching,
    "walking": _walking,
    "waving": _waving,
}


def _dress(looks: Appearance, bones: Skeleton, size_m: float, swimmer: bool = False) -> Mesh:
    """Flesh and clothes on a skeleton, in body heights."""
    skin = looks.pick(_SKIN, _SKIN_HELD_OUT)
    hair = looks.pick(_HAIR, _HAIR_HELD_OUT)
    upper = looks.pick(_UPPER, _UPPER_HELD_OUT)
    lower = looks.pick(_LOWER, _LOWER_HELD_OUT)
    shoes = looks.pick("282422 969696 60422c", "1e1e28 bebab0 783c28")
    long_sleeves, shorts, bare = looks.chance(0.6), looks.chance(0.25), swimmer and looks.chance(0.4)
    stout = looks.between(0.88, 1.22)
    cloth: dict[str, Any] = {"layer": Layer.FABRIC, "texture_size_m": 0.45}
    muted = looks.clothing == "muted"
    if looks.clothing is not None:
        upper, bare = looks.pick(_CLOTHES[looks.clothing]), False
        lower = looks.pick(_MUTED_BELOW) if muted else lower
    if bare:
        upper, long_sleeves = skin, False
    parts = [_torso(bones, stout, upper, lower, cloth)]
    for arm in bones.arms:
        below = upper if long_sleeves else skin
        parts.append(
            _clothed(arm, np.array([0.033, 0.030, 0.025, 0.019]) * stout**0.5, upper, below, 6, cloth)
        )
        hand = arm[2] + 0.03 * (arm[2] - arm[1]) / np.linalg.norm(arm[2] - arm[1])
        parts.append(ellipsoid((0.022, 0.022, 0.026), skin, n=6).moved(hand))
    for leg in bones.legs:
        below = skin if shorts else lower
        parts.append(
            _clothed(leg, np.array([0.050, 0.045, 0.034, 0.026]) * stout**0.5, lower, below, 7, cloth)
        )
        parts.append(tube(leg[2:] - [0, 0, 0.008], [0.027, 0.024], shoes, n=6))
    up = bones.head - bones.neck
    up = up / np.linalg.norm(up)
    parts.append(tube([bones.neck - 0.01 * up, bones.neck + 0.05 * up], [0.032, 0.030], skin, n=6))
    dressed = merge(parts)
    is_skin = np.isclose(dressed.colours, skin, atol=1e-6).all(axis=1)
    parts = [dressed.made_of(Material.CLOTHES).made_of(Material.SKIN, is_skin)]
    large = 1.0 + max(0.0, _CHILD_BELOW_M - size_m)
    head = bones.head + 0.06 * (large - 1.0) * up
    parts.append(ellipsoid((0.052, 0.044, 0.066), skin, n=10).moved(head, scale=large).made_of(Material.SKIN))
    cap = looks.chance(0.3)
    colour = looks.pick(_UPPER, _UPPER_HELD_OUT) if cap else hair
    colour = upper if cap and muted else colour
    crown = ellipsoid((0.055, 0.049, 0.058), colour, n=10).made_of(Material.HAIR)
    parts.append(crown.moved(head + large * (0.018 * up - [0.012, 0, 0]), scale=large))
    if cap:
        peak = ellipsoid((0.05, 0.042, 0.006), colour, n=8).made_of(Material.CLOTH)
        parts.append(peak.moved(head + large * (0.022 * up + [0.05, 0, 0]), scale=large))
    chest = 0.5 * (bones.pelvis + bones.neck) + 0.05 * up
    if looks.chance(0.3 if not swimmer else 0.45) and not muted:
        if swimmer or looks.chance(0.4):  # life jacket or hi-vis vest
            vest = looks.pick("f46e14 e8e21e dc281e", "fa5a28 c8f028")
            over = ellipsoid((0.085, 0.115, 0.115), vest, n=10, **cloth).moved(chest)
            parts.append(over.made_of(Material.CLOTHES))
        else:
            bag = looks.pick(_BAG)
            parts.append(box((0.09, 0.15, 0.22), bag, **cloth).moved(chest - [0.105, 0, 0.1]))
    return merge(parts)


def _clothed(limb: F64, radii: F64, above: F64, below: F64, n: int, cloth: dict[str, Any]) -> Mesh:
    """An arm or a leg whose cloth has the colour ``above`` as far as the joint and ``below`` beyond it."""
    line = [limb[0], 0.5 * (limb[0] + limb[1]), limb[1], limb[2]]
    return tube(line, radii, np.stack([above, above, below, below]), n=n, **cloth)


def _torso(bones: Skeleton, stout: float, upper: F64, lower: F64, cloth: dict[str, Any]) -> Mesh:
    """Elliptical sections from the crotch to the shoulders."""
    along = bones.neck - bones.pelvis
    t = np.array([-0.14, -0.04, 0.12, 0.35, 0.65, 0.88, 0.98])
    half_width = np.array([0.050, 0.088, 0.090, 0.082, 0.098, 0.105, 0.045])
    half_width *= [1, stout, stout, stout, stout**0.7, 1, 1]
    half_depth = np.array([0.040, 0.062, 0.064, 0.058, 0.068, 0.058, 0.035]) * stout
    ring = circle(10)
    forward = np.cross([0.0, 1.0, 0.0], along)
    forward /= np.linalg.norm(forward)
    rings = (
        (bones.pelvis + t[:, None] * along)[:, None]
        + (half_depth[:, None] * ring[None, :, 0])[..., None] * forward
        + (half_width[:, None] * ring[None, :, 1])[..., None] * np.array([0.0, 1.0, 0.0])
    )
    return loft(rings, np.stack([lower, lower, lower, upper, upper, upper, upper]), **cloth)
