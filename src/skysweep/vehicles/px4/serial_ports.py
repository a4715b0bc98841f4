"""Serial ports that a radio or an autopilot may be plugged into."""

from __future__ import annotations

from pathlib import Path

_PATTERNS = ("ttyUSB*", "ttyACM*", "ttyAMA*")


def serial_ports() -> list[str]:
    """Their paths, in order."""
    return sorted(str(port) for pattern in _PATTERNS for port in Path("/dev").glob(pattern))
