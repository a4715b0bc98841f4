"""What things are made of, as far as their temperature depends on it.

Rounded from ranges that the literature gives. Conductivities, heat capacities, albedos, emissivities: Oke,
Boundary Layer Climates (1987); Incropera and DeWitt, Fundamentals of Heat and Mass Transfer; CIBSE Guide A.
Insulation of clothes: ISO 9920 (1 clo is 0.155 m2 K/W); of skin and coats: Monteith and Unsworth, Principles
of Environmental Physics.
"""

from __future__ import annotations

import math
from enum import IntEnum
from typing import NamedTuple

from skysweep.worlds.textures import Layer

_CLO = 0.155  # m2 K/W
_FLESH = 1 / 30.0  # m2 K/W between the core and the skin of a head or a hand in the cold
_CORE_C = 37.0


class Material(IntEnum):
    """Of a vertex of a mesh, or of the ground."""

    GRASS = 0
    FOREST_FLOOR = 1
    ROCK = 2
    SAND = 3
    SNOW = 4
    WATER = 5
    ASPHALT = 6
    LEAVES = 7
    NEEDLES = 8
    WOOD = 9
    CLOTH = 10  # that nobody wears
    SHEET = 11  # metal or plastic
    WALL = 12
    ROOF = 13
    SKIN = 14
    HAIR = 15
    CLOTHES = 16  # on a person
    FLEECE = 17
    COAT = 18  # of a deer or a dog
    SHORT_COAT = 19  # of faces and legs


class Thermal(NamedTuple):
    """Properties of a material's surface and of what lies below it."""

    absorptance: float  # of sunlight
    emissivity: float  # in the long-wave infrared
    conductivity: float  # W/(m K)
    capacity: float  # MJ/(m3 K)
    thickness_m: float = math.inf
    evaporates: float = 0.0  # share of the absorbed sunlight that goes into evaporation
    exchange: float = 1.0  # with the air, times that of a large flat surface: small leaves have more
    inner_w_m2k: float = 0.0  # conductance from what is warm inside
    inner_c: float = 0.0  # its temperature


def _worn(clo: float) -> float:
    return 1.0 / (clo * _CLO + _FLESH)


THERMAL: dict[Material, Thermal] = {
    Material.GRASS: Thermal(0.77, 0.97, 0.3, 1.2, evaporates=0.6, exchange=2.0),
    Material.FOREST_FLOOR: Thermal(0.85, 0.97, 0.2, 0.8, evaporates=0.4),
    Material.ROCK: Thermal(0.75, 0.95, 2.9, 2.2),
    Material.SAND: Thermal(0.65, 0.93, 0.3, 1.3, evaporates=0.1),
    Material.SNOW: Thermal(0.2, 0.98, 0.2, 0.6),
    Material.WATER: Thermal(0.93, 0.98, 100.0, 4.2, evaporates=0.5),  # stirred
    Material.ASPHALT: Thermal(0.9, 0.95, 0.75, 1.9),
    Material.LEAVES: Thermal(0.5, 0.97, 0.5, 3.0, 0.0003, evaporates=0.6, exchange=3.0),
    Material.NEEDLES: Thermal(0.6, 0.97, 0.5, 3.0, 0.001, evaporates=0.5, exchange=3.0),
    Material.WOOD: Thermal(0.7, 0.92, 0.15, 1.1, 0.1),
    Material.CLOTH: Thermal(0.65, 0.95, 0.05, 0.3, 0.02),
    Material.SHEET: Thermal(0.55, 0.90, 0.3, 2.5, 0.003),
    Material.WALL: Thermal(0.6, 0.93, 0.8, 1.4, 0.1, inner_w_m2k=0.5, inner_c=20.0),
    Material.ROOF: Thermal(0.8, 0.92, 0.8, 1.6, 0.015, inner_w_m2k=0.2, inner_c=20.0),
    Material.SKIN: Thermal(0.65, 0.98, 0.4, 3.5, 0.004, inner_w_m2k=1 / _FLESH, inner_c=_CORE_C),
    Material.HAIR: Thermal(0.8, 0.95, 0.05, 0.3, 0.01, inner_w_m2k=_worn(0.5), inner_c=_CORE_C),
    Material.CLOTHES: Thermal(0.65, 0.95, 0.05, 0.3, 0.004, inner_w_m2k=_worn(1.0), inner_c=_CORE_C),
    Material.FLEECE: Thermal(0.75, 0.95, 0.05, 0.1, 0.03, inner_w_m2k=1.6, inner_c=39.0),
    Material.COAT: Thermal(0.8, 0.95, 0.05, 0.1, 0.02, inner_w_m2k=3.3, inner_c=38.5),
    Material.SHORT_COAT: Thermal(0.8, 0.95, 0.05, 0.3, 0.004, inner_w_m2k=10.0, inner_c=38.0),
}

OF_SURFACE: dict[str, Material] = {
    "grass": Material.GRASS,
    "forest floor": Material.FOREST_FLOOR,
    "rock": Material.ROCK,
    "sand": Material.SAND,
    "snow": Material.SNOW,
    "water": Material.WATER,
    "asphalt": Material.ASPHALT,
}

_OF_LAYER = {
    Layer.LEAVES: Material.LEAVES,
    Layer.NEEDLES: Material.NEEDLES,
    Layer.BARK: Material.WOOD,
    Layer.FABRIC: Material.CLOTH,
    Layer.STONE: Material.ROCK,
    Layer.ROOF: Material.ROOF,
    Layer.WALL: Material.WALL,
    Layer.WINDOWS: Material.WALL,
    Layer.PLANKS: Material.WOOD,
}


def material_of(layer: int) -> Material:
    """What a mesh with this texture layer is made of, unless it says otherwise."""
    return _OF_LAYER.get(Layer(layer), Material.SHEET) if layer in set(Layer) else Material.SHEET
