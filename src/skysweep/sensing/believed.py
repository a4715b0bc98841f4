"""The estimated pose is older than the picture, which degrades georeferencing in turns."""

from __future__ import annotations

from collections import deque

from skysweep.geometry.camera import CameraPose, pose_between

_EPS_S = 1e-9
_SAME = 1e-6  # share of the way between two poses that is negligible


class DelayedPose:
    """The camera poses of the last ``delay_s`` seconds."""

    def __init__(self, delay_s: float) -> None:
        self.delay_s = delay_s
        self._poses: deque[tuple[float, CameraPose]] = deque()

    def push(self, time_s: float, pose: CameraPose) -> None:
        """Append a pose. Times must not decrease; a second pose at the same time replaces the first."""
        if self._poses and time_s <= self._poses[-1][0]:
            self._poses.pop()
        self._poses.append((time_s, pose))
        while len(self._poses) > 2 and self._poses[1][0] <= time_s - self.delay_s:
            self._poses.popleft()

    def at(self, time_s: float) -> CameraPose:
        """The pose at ``time_s - delay_s``: positions linear, attitudes by slerp, held beyond the ends."""
        t = time_s - self.delay_s
        before = after = self._poses[0]
        for after in self._poses:
            if after[0] > t + _EPS_S:
                break
            before = after
        (t0, a), (t1, b) = before, after
        if a is b:
            return a
        w = min(max((t - t0) / (t1 - t0), 0.0), 1.0)
        return a if w < _SAME else pose_between(a, b, w)
