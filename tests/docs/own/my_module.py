"""A strategy of your own: cover the area once from half way down, and confirm what was seen surely twice.

skysweep run clusters --strategy strategy:Halfway --sensor statistical   (in this folder)
"""

import math

import skysweep as ss


class MyStrategy:
    @staticmethod
    def cover_altitude_agl_m(search):
        return (search.scan_altitude_agl_m + search.check_altitude_agl_m) / 2

    def __init__(self, context):
        self.search, self.to_scan, self.found = context.search, list(context.waypoints_xy_enu_m), []

    def step(self, seen):
        self.to_scan += [xy for leg in seen.unsearched for xy in leg]  # flown blind: again, at the end
        if self.to_scan and math.dist(seen.vehicle.position_enu_m[:2], self.to_scan[0]) < 2.0:
            self.to_scan.pop(0)
        new = [c for c in seen.candidates.values() if c.id not in self.found]
        sure = [c for c in new if sum(conf >= self.search.c_t for conf in c.confidences) >= 2]
        self.found += [c.id for c in sure]
        events = [ss.Event(ss.EventKind.CONFIRMED, c.id, tuple(c.position_enu_m.tolist())) for c in sure]
        if not self.to_scan:
            return ss.Command(ss.Mode.SCAN, None, (*events, ss.Event(ss.EventKind.FINISHED)))
        altitude_agl_m = self.cover_altitude_agl_m(self.search)
        goal = ss.Waypoint(tuple(self.to_scan[0]), altitude_agl_m, self.search.scan_speed_mps)
        return ss.Command(ss.Mode.SCAN, goal, tuple(events))

    def snapshot(self):
        return {"to_scan": self.to_scan, "found": self.found}

    def restore(self, snapshot):
        vars(self).update(snapshot)
