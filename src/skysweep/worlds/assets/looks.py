"""Where an asset's random choices come from."""

from __future__ import annotations

from dataclasses import dataclass
from zlib import crc32

import numpy as np

from skysweep.arrays import F64
from skysweep.worlds.world import HELD_OUT_VARIANTS


@dataclass(frozen=True)
class Appearance:
    """The random choices of one asset, the same for the same kind and variant."""

    kind: str
    variant: int
    rng: np.random.Generator
    clothing: str | None = None  # of a person, as ``scenarios.model.Clothing``; None: any

    @classmethod
    def of(cls, kind: str, variant: int, clothing: str | None = None) -> Appearance:
        return cls(kind, variant, np.random.default_rng([crc32(kind.encode()), variant]), clothing)

    @property
    def held_out(self) -> bool:
        return self.variant >= HELD_OUT_VARIANTS

    def between(self, low: float, high: float) -> float:
        """A number of the range; held-out looks use its shifted, wider half."""
        shift = 0.25 * (high - low) if self.held_out else 0.0
        return float(self.rng.uniform(low + shift, high + shift))

    def chance(self, probability: float) -> bool:
        return bool(self.rng.random() < probability)

    def pick(self, training: str, held_out: str = "") -> F64:
        """A varied colour (3,) 0..1 from the palette that applies; palettes are colours in hexadecimal."""
        palette = (held_out if self.held_out and held_out else training).split()
        colour = np.array([*bytes.fromhex(palette[self.rng.integers(len(palette))])]) / 255
        return np.clip(colour * self.rng.uniform(0.88, 1.1) + self.rng.normal(0, 0.015, 3), 0.01, 1.0)
