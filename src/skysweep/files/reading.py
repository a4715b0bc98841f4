"""Files from users: only regular files up to a size."""

from __future__ import annotations

from pathlib import Path

from skysweep.errors import UserError


def read_limited(path: str | Path, max_bytes: int) -> bytes:
    """The bytes of a user's file. Folders, pipes and devices, which may have no end, are not opened.

    Raises UserError if the file is missing, no file, unreadable, or larger than ``max_bytes``.
    """
    path = Path(path)
    try:
        if not path.exists():
            raise UserError(f"{path}: there is no such file; check the path")
        if not path.is_file():
            raise UserError(f"{path}: is a folder or device; write the path of a file")
        with path.open("rb") as file:
            data = file.read(max_bytes + 1)
    except OSError as error:
        raise UserError(
            f"{path}: cannot be read ({error.strerror}); check the path and its permissions"
        ) from None
    if len(data) > max_bytes:
        raise UserError(f"{path}: is larger than {max_bytes / 1e6:g} MB; give a smaller file")
    return data


def read_text_limited(path: str | Path, max_bytes: int) -> str:
    """Like :func:`read_limited`, as text. Raises UserError also if the file is not UTF-8."""
    try:
        return read_limited(path, max_bytes).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise UserError(f"{path}: is not a text file in UTF-8; write plain text") from None


def stamp_of(path: Path) -> tuple[int, int] | None:
    """What shows that a file has changed: its time and size; None if there is no file."""
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_mtime_ns, status.st_size
