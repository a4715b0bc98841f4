"""A vehicle of your own: the embedded one, whose idea of its position drifts away to the east.

ss.run("clusters", vehicle=Drifting, sensor="statistical")
"""

import skysweep as ss


class Drifting:
    def __init__(self, scenario, seed, drift_mps=0.01):
        self.inner, self.drift_mps = ss.embedded_vehicle(scenario, seed), drift_mps
        self.truth = self.inner.truth  # simulated here; None for a vehicle that nobody knows the truth of
        self.command, self.advance, self.hold = self.inner.command, self.inner.advance, self.inner.hold
        self.takeoff, self.land = self.inner.takeoff, self.inner.land

    def state(self):
        state = self.inner.state()
        off_m = [self.drift_mps * state.time_s, 0.0, 0.0]
        camera = state.camera._replace(position_enu_m=state.camera.position_enu_m + off_m)
        return state._replace(position_enu_m=state.position_enu_m + off_m, camera=camera)
