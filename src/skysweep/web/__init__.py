"""The live page: missions in a browser, while they fly and after.

Importing it raises MissingExtraError if Starlette, uvicorn or websockets is not installed.
"""

from __future__ import annotations

from skysweep.errors import MissingExtraError

try:
    import starlette  # noqa: F401
    import uvicorn  # noqa: F401
    import websockets  # noqa: F401
except ImportError:
    raise MissingExtraError("The live page", "web") from None
