"""The served folder: ids of what is in it, and files that may be read."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from skysweep.errors import UserError

ITSELF = "_"  # id of the served folder


def refuse_link(path: Path) -> None:
    """Raises UserError if a file is a link."""
    if path.is_symlink():
        raise UserError(f"{path.name} is a link, and links are not followed; put the file itself there.")


class Places:
    """Finds files in a served folder, and none outside of it."""

    def __init__(self, root: Path) -> None:
        self.root = root.resolve()

    def folder(self, identity: str) -> Path:
        """The folder of an id. Raises UserError if there is none."""
        path = self._inside(self.root if identity == ITSELF else self.root / identity)
        with suppress(OSError):  # a name too long
            if path.is_dir():
                return path
        raise UserError("There is no such folder here.")

    def file(self, folder: Path, *names: str) -> Path:
        """A file of a folder. Raises UserError if there is none, or a link leads out of the served folder."""
        path = self._inside(folder.joinpath(*names))
        with suppress(OSError):
            if path.is_file():
                return path
        raise UserError("There is no such file in this folder.")

    def identity(self, folder: Path) -> str:
        """The id of a folder."""
        relative = folder.relative_to(self.root).as_posix()
        return ITSELF if relative == "." else relative

    def _inside(self, path: Path) -> Path:
        try:
            resolved = path.resolve()
        except (OSError, ValueError, RuntimeError):  # a zero byte, links in a circle
            raise UserError("This is not a path.") from None
        if resolved != path.absolute() or not resolved.is_relative_to(self.root):
            raise UserError("This path leads out of the folder that is served, or through a link.")
        return resolved
