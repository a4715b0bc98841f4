"""What a strategy of a user's own raises, in words."""

from __future__ import annotations

import traceback
from pathlib import Path

from skysweep.text import printable

_LONGEST = 200  # characters of an exception's own words


def failure_words(error: BaseException) -> str:
    """Kind, words and place of what a call raised, such as ``ValueError: no way at my_strategy.py:12``.

    To be called where it was caught. The place is the last line in the file that was called, whatever other
    code that line called; there is none where the call itself failed.
    """
    words = printable(" ".join(str(error).split())[:_LONGEST])
    told = f"{type(error).__name__}: {words}" if words else type(error).__name__
    frames = traceback.extract_tb(error.__traceback__)[1:]
    if not frames:
        return told
    place = next(frame for frame in reversed(frames) if frame.filename == frames[0].filename)
    return f"{told} at {Path(place.filename).name}:{place.lineno}"
