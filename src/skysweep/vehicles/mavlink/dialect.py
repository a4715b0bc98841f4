"""The only import of pymavlink."""

from __future__ import annotations

from skysweep.errors import MissingExtraError

try:
    from pymavlink.dialects.v20 import development as mavlink  # common, and CURRENT_MODE
except ImportError:
    raise MissingExtraError("MAVLink", "px4") from None

__all__ = ["mavlink"]
