"""What the user can mend, and a detector that fails on a picture."""

from __future__ import annotations

from pathlib import Path


class UserError(Exception):
    """A problem with what the user gave us, told in one sentence that names the field and the fix.

    The command line prints it without a traceback and exits with code 2.
    """


class DetectorError(Exception):
    """The detector failed on one picture; the next may be answered."""


class MissingExtraError(UserError):
    """An optional dependency is not installed; the message names the extra that brings it."""

    def __init__(self, what: str, extra: str) -> None:
        super().__init__(f"{what} needs an optional part: install it with  pip install 'skysweep[{extra}]'")


class CannotWriteError(UserError):
    """Results cannot be written into a folder; ``strerror`` is what the system says."""

    def __init__(self, folder: Path, error: OSError | CannotWriteError) -> None:
        super().__init__(folder, error)  # so that it can be pickled
        self.folder = folder
        self.strerror: str = error.strerror or str(error)

    def __str__(self) -> str:
        return f"--out {self.folder}: cannot be made or written to ({self.strerror}); choose another"
