"""The MAVLink face of a vehicle: from outside it looks like a PX4 (docs/mavlink.md)."""
