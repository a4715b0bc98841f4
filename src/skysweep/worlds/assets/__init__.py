"""Meshes of everything the camera can see, one module per family. ``variant`` seeds every look.

Variants from :data:`skysweep.worlds.world.HELD_OUT_VARIANTS` on use other palettes and proportions than
those below: detectors are trained on the lower ones and tested on the others.
"""

from __future__ import annotations

from collections.abc import Callable

from skysweep.worlds.assets import animals, boats, people, signs, things, vehicles
from skysweep.worlds.assets.looks import Appearance
from skysweep.worlds.meshes import Mesh

_MAKERS: dict[str, Callable[[Appearance, float, str], Mesh]] = {
    "stop sign": signs.stop_sign,
    "red round sign": signs.round_sign,
    "person": people.person,
    "boat": boats.boat,
    "red bucket": things.bucket,
    "rock": things.rock,
    "stump": things.stump,
    "clothing": things.clothing,
    "buoy": things.buoy,
    "sheep": animals.sheep,
    "deer": animals.deer,
    "dog": animals.dog,
    "car": vehicles.car,
}

KINDS = tuple(_MAKERS)


def object_mesh(kind: str, size_m: float, pose: str, variant: int, clothing: str | None = None) -> Mesh:
    """The mesh of a target or distractor: origin on the ground (or water line), x forward, z up, metres.

    ``pose`` and ``clothing`` are those of ``scenarios.model``; a kind ignores poses that do not apply to it.
    Raises KeyError for an unknown kind.
    """
    return _MAKERS[kind](Appearance.of(kind, variant, clothing), size_m, pose)
