"""What the user can mend, and a detector that fails on a picture."""

from __future__ import annotations

from pathlib import Path

CLONE = Path(__file__).parents[2]  # where the code is that of a checkout


class UserError(Exception):
    """A problem with what the user gave us, told in one sentence that names the field and the fix.

    The command line prints it without a traceback and exits with code 2.
    """


class DetectorError(Exception):
    """The detector failed on one picture; the next may be answered."""


class MissingExtraError(UserError):
    """An optional dependency is not installed; the message names the extra that brings it."""

    def __init__(self, what: str, extra: str) -> None:
        super().__init__(f"{what} needs an optional part: install it with  {install_command(extra)}")


def install_command(extra: str) -> str:
    """The command that installs an optional part here: a clone's own, which knows more than pip does."""
    return f"tools/setup.sh {extra}" if is_clone() else f"pip install 'skysweep[{extra}]'"


def is_clone() -> bool:
    """Whether this is the code of a checkout."""
    return (CLONE / "tools" / "setup.sh").is_file()


class CannotWriteError(UserError):
    """Results cannot be written into a folder; ``strerror`` is what the system says."""

    def __init__(self, folder: Path, error: OSError | CannotWriteError) -> None:
        super().__init__(folder, error)  # so that it can be pickled
        self.folder = folder
        self.strerror: str = error.strerror or str(error)

    def __str__(self) -> str:
        return f"--out {self.folder}: cannot be made or written to ({self.strerror}); choose another"
