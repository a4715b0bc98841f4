"""Paths and digests of model files. Light: nothing here opens a model."""

from __future__ import annotations

import hashlib
from functools import lru_cache
from importlib import resources
from pathlib import Path

from skysweep.errors import UserError
from skysweep.files.reading import read_limited
from skysweep.scenarios.model import OWN_DETECTORS

OWN_MODEL = OWN_DETECTORS["visible"]
MAX_MODEL_BYTES = 1_000_000_000


def own_model_path(name: str = OWN_MODEL) -> Path:
    """The path of a shipped model."""
    return Path(str(resources.files("skysweep") / "models" / f"{name}.onnx"))


def shipped_models() -> list[Path]:
    """The files of all shipped models."""
    return [own_model_path(name) for name in OWN_DETECTORS.values()]


def model_file(model: Path | str) -> Path:
    """The file that a scenario's ``detector.model`` names: one of ours, or a path."""
    return own_model_path(str(model)) if str(model) in OWN_DETECTORS.values() else Path(model)


def existing_model_file(model: Path | str) -> Path:
    """Like :func:`model_file`. Raises UserError if the file is missing."""
    path = model_file(model)
    if not path.is_file():
        raise UserError(
            f"{path}: there is no such model file; write the path of an ONNX file, or one of ours: "
            f"{', '.join(OWN_DETECTORS.values())}"
        )
    return path


def sha256_of(path: Path) -> str:
    """The file's SHA-256 in hexadecimal; an unchanged file is read only once. Raises OSError."""
    status = path.stat()
    return _digest(path, status.st_mtime_ns, status.st_size)


def fingerprint(model: str) -> str:
    """What identifies a detector: its file's SHA-256, or its name if it is no file."""
    path = model_file(model)
    return sha256_of(path) if path.is_file() else model


@lru_cache(maxsize=16)
def _digest(path: Path, _changed_ns: int, _size: int) -> str:
    return hashlib.sha256(read_limited(path, MAX_MODEL_BYTES)).hexdigest()
