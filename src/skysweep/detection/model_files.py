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
    """SHA-256 in hexadecimal of a file, with the weights that an export wrote beside it (``.onnx.data``).

    Unchanged files are read only once. Raises OSError.
    """
    beside = path.with_name(f"{path.name}.data")
    files = (path, beside) if beside.is_file() else (path,)
    return _digest(files, tuple((f.stat().st_mtime_ns, f.stat().st_size) for f in files))


def fingerprint(model: str) -> str:
    """What identifies a detector: its file's SHA-256, or its name if it is no file."""
    path = model_file(model)
    return sha256_of(path) if path.is_file() else model


@lru_cache(maxsize=16)
def _digest(files: tuple[Path, ...], _changed_ns_and_size: tuple[tuple[int, int], ...]) -> str:
    digest = hashlib.sha256()
    for file in files:
        digest.update(read_limited(file, MAX_MODEL_BYTES))
    return digest.hexdigest()
