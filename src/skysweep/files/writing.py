"""Files written whole or not at all."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory, TemporaryFile

from skysweep.errors import CannotWriteError, UserError

UNFINISHED = ".unfinished-"  # begins the name of a folder that is written into; a killed process leaves it

_URL = re.compile(r"[A-Za-z][A-Za-z0-9+.-]+:/")  # two letters at least: C:/ is a drive


@contextmanager
def whole_files(folder: Path) -> Iterator[Path]:
    """A folder to write into; at the end of the block its files move into ``folder``.

    If the block fails, ``folder`` stays as it was, and is not made. Raises UserError if it cannot be made or
    written to.
    """
    made = make_folder(folder)
    try:
        with TemporaryDirectory(prefix=UNFINISHED, dir=folder) as name:
            yield Path(name)
            for path in sorted(Path(name).rglob("*")):
                place = folder / path.relative_to(name)
                if path.is_dir():
                    place.mkdir(exist_ok=True)
                else:
                    path.replace(place)
    except (OSError, CannotWriteError) as error:
        _remove(made)
        raise CannotWriteError(folder, error) from None
    except BaseException:
        _remove(made)
        raise


def replace_file(path: Path, content: bytes, sync: bool = False) -> None:
    """Write a file whole or not at all; ``sync`` waits until the disk has it. Raises OSError of ``path``."""
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        with part.open("wb") as file:
            file.write(content)
            if sync:
                file.flush()
                os.fsync(file.fileno())
        part.replace(path)
    except BaseException as error:
        with suppress(OSError):
            part.unlink()
        if isinstance(error, OSError):
            error.filename, error.filename2 = str(path), None
        raise


def make_folder(folder: Path) -> Sequence[Path]:
    """Make a folder that can be written to, and return the folders that were missing, innermost first.

    Raises UserError, with nothing made, if that fails.
    """
    if _URL.match(str(folder)):
        raise UserError(f"--out {folder}: is a URL; write a folder of this computer")
    missing: list[Path] = []
    try:
        missing = [path for path in (folder, *folder.parents) if not path.exists()]
        folder.mkdir(parents=True, exist_ok=True)
        with TemporaryFile(dir=folder):
            return missing
    except OSError as error:
        _remove(missing)
        raise CannotWriteError(folder, error) from None


def free_folder(parent: Path, name: str) -> Path:
    """The path of a new folder of that name, with a number appended if need be."""
    name = name.replace(":", ".")  # in the name of a user's own strategy; not every file system allows it
    candidates = [parent / name] + [parent / f"{name}-{k}" for k in range(2, 10_000)]
    return next(c for c in candidates if not c.exists())


def _remove(folders: Sequence[Path]) -> None:
    """Remove the folders that are empty."""
    for folder in folders:
        with suppress(OSError):
            folder.rmdir()
