"""The candidates found so far, as markers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from skysweep.ros.messages import CYLINDER, TEXT, Mark
from skysweep.text import printable
from skysweep.types import F64

RGBA = {
    "seen": (0.94, 0.89, 0.26, 0.6),
    "scanned": (0.90, 0.62, 0.0, 0.7),
    "confirmed": (0.0, 0.62, 0.45, 0.8),
    "rejected": (0.84, 0.37, 0.0, 0.5),
}
_SEEN_RADIUS_M = 1.0


@dataclass(frozen=True, slots=True)
class KnownTarget:
    """A candidate and its standing: seen, scanned, confirmed or rejected."""

    id: int
    class_name: str
    standing: str
    position_enu_m: F64  # (3,)
    radius_95_m: float
    by_operator: bool = False  # decided

    @property
    def label(self) -> str:
        return f"{self.id} {self.class_name} {self.standing}{' by the operator' * self.by_operator}"


class TargetBoard:
    """Collects the targets from the records of a journal."""

    def __init__(self) -> None:
        self.targets: dict[int, KnownTarget] = {}
        self._marks: dict[int, tuple[Mark, Mark]] = {}

    def note(self, record: Mapping[str, Any]) -> bool:
        """Take in one record; True if a target is new or its standing changed."""
        kind, identity, place = record["kind"], record.get("candidate"), record.get("p")
        standing = "seen" if kind == "sighting" else kind
        if identity is None or standing not in RGBA:
            return False
        known = self.targets.get(identity)
        if known is None:
            if place is None:
                return False
            name = printable(str(record.get("class_name", "target")))
            known = KnownTarget(identity, name, "", np.array(place, dtype=float), _SEEN_RADIUS_M)
        elif standing == "seen":
            return False
        spread = record.get("covariance_m2")
        target = self.targets[identity] = replace(
            known,
            standing=standing,
            by_operator="by" in record,
            position_enu_m=known.position_enu_m if place is None else np.array(place, dtype=float),
            radius_95_m=known.radius_95_m if spread is None else _radius_95_m(spread),
        )
        self._marks[identity] = _disc_and_label(target)
        return True

    def marks(self) -> list[Mark]:
        """A disc of the 95 % radius and a label for every target."""
        return [mark for marks in self._marks.values() for mark in marks]


def _disc_and_label(t: KnownTarget) -> tuple[Mark, Mark]:
    size = (2 * t.radius_95_m, 2 * t.radius_95_m, 0.2)
    above = t.position_enu_m + np.array([0.0, 0.0, 2.0])
    return (
        Mark(t.standing, t.id, CYLINDER, t.position_enu_m, size, RGBA[t.standing]),
        Mark("labels", t.id, TEXT, above, (0.0, 0.0, 1.5), (1.0, 1.0, 1.0, 1.0), t.label),
    )


def _radius_95_m(covariance_m2: Any) -> float:
    """The radius of the circle around the 95 % error ellipse (chi-square, 2 degrees of freedom: 5.991)."""
    matrix = np.asarray(covariance_m2, dtype=float).reshape(2, 2)
    return float(np.sqrt(5.991 * np.linalg.eigvalsh(matrix)[-1]))
