"""The one exception that means: the user can mend this."""


class UserError(Exception):
    """A problem with what the user gave us, told in one sentence that names the field and the fix.

    The command line prints it without a traceback and exits with code 2.
    """


class MissingExtraError(UserError):
    """An optional dependency is not installed; the message names the extra that brings it."""

    def __init__(self, what: str, extra: str) -> None:
        super().__init__(f"{what} needs an optional part: install it with  pip install 'skysweep[{extra}]'")
