"""A camera of your own: pictures in shades of grey, with fog that thickens with the distance.

ss.run("clusters", camera=FoggyCamera)
"""

import numpy as np

import skysweep as ss


class FoggyCamera:
    renderer = "foggy"  # it shows the scenario's world; None for a camera that does not

    def __init__(self, scenario, world, truth):
        self.world, self.truth, self.visibility_m = world, truth, 150.0

    def capture(self, state):
        pose = self.truth.true_camera_pose()
        east_m, north_m, up_m = pose.position_enu_m
        distance_m = up_m - self.world.ground_m(east_m, north_m)
        clear = np.exp(-3.0 * distance_m / self.visibility_m)
        grey = self.world.render(pose, state.time_s) @ [0.299, 0.587, 0.114]
        image = np.repeat((clear * grey + (1 - clear) * 200.0)[..., None], 3, axis=2).astype(np.uint8)
        return ss.Frame(state.time_s, image, state.camera, self.world.lens)  # with the pose that is believed

    def close(self):
        """Nothing is held open."""
