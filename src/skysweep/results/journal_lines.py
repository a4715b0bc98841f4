"""Models of a journal's lines, which results and resumed missions rely on."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, BaseModel, Field, ValidationError, model_validator

from skysweep.mission.notes import LOOKED, NEXT_SORTIE, OF_A_CANDIDATE, OPERATOR, SORTIE
from skysweep.mission.orders import ORDER
from skysweep.mission.safety import Action
from skysweep.types import EventKind

_Place = Annotated[list[float], Field(min_length=3, max_length=3)]
_Finite = Annotated[float, Field(allow_inf_nan=False)]
_Pair = Annotated[list[_Finite], Field(min_length=2, max_length=2)]
_Matrix = Annotated[list[_Pair], Field(min_length=2, max_length=2)]
_ROUNDED = 0.01  # tolerance of a rotation's determinant


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


class _Decision(_Line):
    candidate: int | None = None
    probability: float | None = Field(None, ge=0.0, le=1.0)
    reason: str | None = None
    alternatives: list[tuple[str, _Finite]] = []


class _OfCandidate(_Decision):
    candidate: int | None
    p: _Place | None = None
    confidence: float | None = None
    altitude_agl_m: float | None = None
    covariance_m2: _Matrix | None = None
    by: str | None = Field(None, pattern=f"^{OPERATOR}$")


class _Order(_Line):
    word: str
    candidate: int | None = None
    p: _Place | None = None


class _Looked(_Line):
    p: _Place


class _Sortie(_Line):
    number: int = Field(ge=1)
    battery: float | None = None


class _Landed(_Sortie):
    why: str
    energy_wh: _Finite


class _Safety(_Line):
    action: str = Field(pattern=f"^({'|'.join(Action.__members__)})$")
    sentence: str


class _Unsearched(_Line):
    length_m: float = Field(allow_inf_nan=False)
    again: bool


class _Reason(_Line):
    reason: str


class _LeftOut(_Line):
    picture: str
    why: str


class _Clock(_Line):
    utc: str

    @model_validator(mode="after")
    def _has_a_zone(self) -> _Clock:
        if datetime.fromisoformat(self.utc).tzinfo is None:
            raise ValueError("the time has no zone")
        return self


class _Setup(_Start):
    sensor: str
    renderer: str | None
    threads: int = Field(ge=1, le=1024)
    model: str
    replays: bool


class _Look(_Line):
    boxes_xyxy_px: list[Annotated[list[_Finite], Field(min_length=4, max_length=4)]] = []
    confidences: list[_Finite] = []
    class_names: list[str] = []
    failure: str | None = None
    doubt: tuple[str, _Finite] | None = None

    @model_validator(mode="after")
    def _of_one_length(self) -> _Look:
        if not len(self.boxes_xyxy_px) == len(self.confidences) == len(self.class_names):
            raise ValueError("boxes, confidences and class names are not as many")
        return self


class _Ordered(BaseModel):
    verdicts: list[tuple[int, Literal["confirmed", "rejected"]]]
    places: list[_Pair]


class _Snapshot(_Line):
    strategy: dict[str, Any]
    tracker: dict[str, Any]
    operator: _Ordered | None = None


_KNOWN: dict[str, type[_Line]] = {
    "start": _Start,
    "plan": _Plan,
    "state": _State,
    "safety": _Safety,
    ORDER: _Order,
    LOOKED: _Looked,
    SORTIE: _Landed,
    NEXT_SORTIE: _Sortie,
    "look": _Look,
    "unsearched": _Unsearched,
    "end": _Reason,
    "clock": _Clock,
    "left_out": _LeftOut,
    EventKind.CHECK_STARTED: _Decision,
    EventKind.MISFIT: _Reason,
    **dict.fromkeys(OF_A_CANDIDATE, _OfCandidate),
}
_GONE_ON_WITH = _KNOWN | {"setup": _Setup, "snapshot": _Snapshot}


def can_be_told(record: Mapping[str, Any]) -> bool:
    """Whether a line has the fields that results need."""
    return _says(_KNOWN, record)


def can_be_gone_on_with(record: Mapping[str, Any]) -> bool:
    """Whether a line also has the fields that a resumed mission needs."""
    return _says(_GONE_ON_WITH, record)


def _says(known: Mapping[str, type[_Line]], record: Mapping[str, Any]) -> bool:
    try:
        known.get(str(record.get("kind")), _Line).model_validate(record)
    except ValidationError:
        return False
    return True
