"""Names of classes in public data sets, and ours for them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np

from skysweep.detection.training.matching import strongest
from skysweep.errors import UserError
from skysweep.types import Detections

_SAME_IOU = 0.5  # boxes of one thing under two names
IGNORED = "ignored"  # stands for a class whose boxes are neither hit nor false

OURS: dict[str, str] = {
    # VisDrone: https://github.com/VisDrone/VisDrone-Dataset
    "pedestrian": "person",
    "people": "person",
    "van": "car",
    "motor": "motorcycle",
    "ignored regions": IGNORED,
    "others": IGNORED,
    # SeaDronesSee: https://github.com/Ben93kie/SeaDronesSee
    "swimmer": "person",
    "floater": "person",
    "swimmer with life jacket": "person",
    "swimmer on boat": "person",
    "floater on boat": "person",
    "jetski": "boat",
    # common elsewhere
    "human": "person",
    "man": "person",
    "woman": "person",
    "child": "person",
    "ship": "boat",
    "vessel": "boat",
    "sailboat": "boat",
    "kayak": "boat",
    "stopsign": "stop sign",
}
"""Ours by the other's name, in lower case and with spaces; names that are not here stay what they are."""


def parse_renames(texts: Iterable[str]) -> dict[str, str]:
    """NAME=OURS texts as a mapping. Raises UserError for any other text."""
    found = {}
    for text in texts:
        name, equals, our = (part.strip() for part in text.partition("="))
        if not (name and equals and our):
            raise UserError(f"--class {text}: write NAME=OURS, such as people=person, or NAME={IGNORED}")
        found[_plain(name)] = ours(our)
    return found


def refuse_unused(renames: Mapping[str, str], names: Iterable[str]) -> None:
    """Raises UserError if one of the renamed classes is none of those there are."""
    there = dict.fromkeys(names)
    plain = {_plain(name) for name in there}
    for name, our in renames.items():
        if name not in plain:
            listed = ", ".join(there) or "none"
            raise UserError(f"--class {name}={our}: no class has that name; there are {listed}")


def ours(name: str, renames: Mapping[str, str] | None = None) -> str:
    """Our name of a class; ``renames`` come before ``OURS``."""
    plain = _plain(name)
    return (renames or {}).get(plain) or OURS.get(plain) or plain


def with_our_names(found: Detections, renames: Mapping[str, str] | None = None) -> Detections:
    """Detections by our names; of two that overlap and were of one of our classes the weaker is left out."""
    names = np.array([ours(name, renames) for name in found.class_names], dtype=object)
    theirs = np.array(found.class_names, dtype=object)
    kept = np.ones(len(names), dtype=bool)
    for name in set(names.tolist()):
        own = np.flatnonzero(names == name)
        if len(set(theirs[own].tolist())) > 1:
            kept[own] = False
            kept[own[strongest(found.boxes_xyxy_px[own], found.confidences[own], _SAME_IOU)]] = True
    return replace(
        found,
        boxes_xyxy_px=found.boxes_xyxy_px[kept],
        confidences=found.confidences[kept],
        class_names=tuple(names[kept].tolist()),
    )


def _plain(name: str) -> str:
    return " ".join(name.lower().replace("_", " ").replace("-", " ").split())
