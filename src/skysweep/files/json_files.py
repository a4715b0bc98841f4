"""JSON from users: a mistake in it is one sentence."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, NoReturn

from skysweep.errors import UserError


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
