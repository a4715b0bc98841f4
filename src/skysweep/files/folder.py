"""A folder of small files, local or on any store that fsspec knows (``s3://``, ``memory://`` ...)."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import wraps
from pathlib import Path
from typing import Concatenate, ParamSpec, TypeVar, cast

import fsspec
from fsspec.implementations.local import LocalFileSystem

from skysweep.errors import UserError
from skysweep.files.locking import locked
from skysweep.files.writing import make_folder

P = ParamSpec("P")
R = TypeVar("R")

_UNFINISHED = ".unfinished-"

Method = Callable[Concatenate["Folder", P], R]


def _told(method: Method[P, R]) -> Method[P, R]:
    """Turn any error of a store into one sentence; fsspec prescribes no common class of errors."""

    @wraps(method)
    def wrapped(self: Folder, *args: P.args, **kwargs: P.kwargs) -> R:
        try:
            return method(self, *args, **kwargs)
        except Exception as error:
            reason = " ".join(str(error).split()) or type(error).__name__
            is_full = isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT)
            what = "make room" if is_full else "check the address and its permissions"
            raise UserError(f"{self}: cannot be read or written ({reason}); {what}") from None

    return cast("Method[P, R]", wrapped)


class Folder:
    """Reads and writes whole files: each is written under another name first, then renamed.

    ``url`` is a path or an fsspec URL. Raises UserError if it cannot be opened.
    """

    def __init__(self, url: str | os.PathLike[str]) -> None:
        self.url = os.fspath(url)
        try:
            self._files, self._root = fsspec.core.url_to_fs(self.url)
        except Exception as error:  # any class; some stores connect at once
            reason = " ".join(str(error).split()).rstrip(".") or type(error).__name__
            raise UserError(
                f"{self.url}: {reason}; write a local folder or a URL that fsspec can open"
            ) from None

    def __str__(self) -> str:
        return self.url

    def where(self, name: str) -> str:
        """The address of a file, for messages."""
        return f"{self.url.rstrip('/')}/{name}"

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Hold the lock of a local folder, which is made; others have none.

        A folder that holds nothing in the end is removed again. Raises UserError if it cannot be made, or
        another process holds the lock.
        """
        if not isinstance(self._files, LocalFileSystem):
            yield
            return
        made = make_folder(Path(self._root))
        try:
            with locked(Path(self._root)):
                yield
        finally:
            with suppress(OSError):  # something is in it
                for folder in made:
                    folder.rmdir()

    @_told
    def read(self, name: str) -> bytes | None:
        """The content of a file, or None if there is no such file."""
        try:
            content: bytes = self._files.cat_file(self._path(name))
        except FileNotFoundError:
            return None
        return content

    @_told
    def exists(self, name: str = "") -> bool:
        """Whether it holds such a file or folder; without a name, whether it exists itself."""
        return bool(self._files.exists(self._path(name)))

    @_told
    def write(self, name: str, content: bytes) -> None:
        """Make or replace a file, whole or not at all."""
        path = self._path(name)
        parent, _, last = path.rpartition("/")
        self._files.makedirs(parent, exist_ok=True)
        unfinished = f"{parent}/{_UNFINISHED}{os.getpid()}-{last}"
        with self._removed_on_failure(unfinished):
            self._files.pipe_file(unfinished, content)
            self._files.mv(unfinished, path)

    @_told
    def try_out(self) -> None:
        """Write a file and remove it again, as a trial."""
        is_new = isinstance(self._files, LocalFileSystem) and not self._files.exists(self._root)
        self._files.makedirs(self._root, exist_ok=True)
        path = self._path(f"{_UNFINISHED}{os.getpid()}")
        with self._removed_on_failure(path):
            self._files.pipe_file(path, b"-")
            self._files.rm_file(path)
        if is_new:
            self._files.rmdir(self._root)

    @_told
    def names(self, folder: str) -> list[str]:
        """Sorted names of the whole files in a folder; none if there is no such folder."""
        self._files.invalidate_cache()
        try:
            paths = self._files.ls(self._path(folder), detail=False)
        except FileNotFoundError:
            return []
        names = (path.rstrip("/").rpartition("/")[2] for path in paths)
        return sorted(f"{folder}/{name}" for name in names if not name.startswith(_UNFINISHED))

    @_told
    def remove(self, folder: str) -> None:
        """Remove a folder with its content."""
        if self._files.exists(self._path(folder)):
            self._files.rm(self._path(folder), recursive=True)

    @contextmanager
    def _removed_on_failure(self, path: str) -> Iterator[None]:
        try:
            yield
        except BaseException:
            with suppress(Exception):
                self._files.rm_file(path)
            raise

    def _path(self, name: str) -> str:
        return f"{self._root.rstrip('/')}/{name}".rstrip("/")
