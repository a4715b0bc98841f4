"""JSON from strangers: size, nesting and what is wrong with it told in one sentence."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, NoReturn

from skysweep.errors import UserError


def read_limited(path: str | Path, max_bytes: int) -> bytes:
    """A file's bytes. Raises UserError when it is not there, no file, unreadable or too large."""
    path = Path(path)
    if not path.exists():
        raise UserError(f"{path}: there is no such file; check the path")
    if not path.is_file():
        raise UserError(f"{path}: is a folder or device; write the path of a file")
    try:
        with path.open("rb") as file:
            data = file.read(max_bytes + 1)
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror}); check the file's rights") from None
    if len(data) > max_bytes:
        raise UserError(f"{path}: is larger than {max_bytes / 1e6:g} MB; give a smaller file")
    return data


def parse_json(data: bytes, path: str | Path, fix: str) -> Any:
    """Strict JSON (RFC 8259: no NaN). Raises UserError that ends with ``fix``."""

    def refuse(constant: str) -> NoReturn:
        raise UserError(f"{path}: {constant} is no JSON number; {fix}")

    try:
        return json.loads(data.decode("utf-8-sig"), parse_constant=refuse)
    except UnicodeDecodeError:
        raise UserError(f"{path}: is not text in UTF-8; {fix}") from None
    except json.JSONDecodeError as error:
        cut = error.pos >= len(error.doc.rstrip())
        problem = "ends too early (truncated?)" if cut else f"is not JSON ({error.msg})"
        raise UserError(f"{path}: line {error.lineno} {problem}; {fix}") from None
    except (RecursionError, ValueError):
        raise UserError(f"{path}: is nested too deeply or holds a number too long; {fix}") from None
