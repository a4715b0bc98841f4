"""What the lines of a journal must say for results to be made of them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

import numpy as np
from pydantic import AfterValidator, BaseModel, Field, TypeAdapter, ValidationError

from skysweep.mission.safety import Action

_Place = Annotated[list[float], Field(min_length=3, max_length=3)]
_Finite = Annotated[float, Field(allow_inf_nan=False)]
_Pair = Annotated[list[_Finite], Field(min_length=2, max_length=2)]
_ROUNDED = 0.01  # by that much the determinant of a rotation may be off
_Matrix = Annotated[list[_Pair], Field(min_length=2, max_length=2)]


def _turns(rows: list[float]) -> list[float]:
    if not abs(np.linalg.det(np.reshape(rows, (3, 3))) - 1.0) < _ROUNDED:
        raise ValueError("is no rotation")
    return rows


class _Line(BaseModel):
    t: float = Field(ge=-1e8, le=1e8, allow_inf_nan=False)
    kind: str


class _Start(_Line):
    seed: int = Field(ge=0)


class _Plan(_Line):
    waypoints_enu_m: list[Annotated[list[_Finite], Field(min_length=3, max_length=3)]]


class _Camera(BaseModel):
    p: _Place
    R: Annotated[list[_Finite], Field(min_length=9, max_length=9), AfterValidator(_turns)]


class _State(_Line):
    p: _Place
    cam: _Camera | None = None
    battery: float | None = None
    energy_wh: float | None = None


class _OfCandidate(_Line):
    candidate: int | None
    p: _Place | None = None
    confidence: float | None = None
    altitude_agl_m: float | None = None
    covariance_m2: _Matrix | None = None


class _Safety(_Line):
    action: str = Field(pattern=f"^({'|'.join(Action.__members__)})$")
    sentence: str


class _Unsearched(_Line):
    length_m: float = Field(allow_inf_nan=False)
    again: bool


class _End(_Line):
    reason: str


_OTHER = TypeAdapter(_Line)
_KNOWN: dict[str, TypeAdapter[Any]] = {
    "start": TypeAdapter(_Start),
    "plan": TypeAdapter(_Plan),
    "state": TypeAdapter(_State),
    "safety": TypeAdapter(_Safety),
    "unsearched": TypeAdapter(_Unsearched),
    "end": TypeAdapter(_End),
    **dict.fromkeys(("sighting", "scanned", "confirmed", "rejected", "unchecked"), TypeAdapter(_OfCandidate)),
}


def can_be_told(record: Mapping[str, Any]) -> bool:
    """Whether a line says what lines of its kind say."""
    try:
        _KNOWN.get(str(record.get("kind")), _OTHER).validate_python(record)
    except ValidationError:
        return False
    return True
