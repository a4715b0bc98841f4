/** Where the camera's picture lies on the ground. Pure. */

import type { StateAt } from "./store";
import type { Scene, XY, XYZ } from "./types";

type Ground = (x: number, y: number) => number;

const FARTHEST_M = 5000; // of a corner that looks at the horizon or above

/** Where the ray through a pixel meets the ground. */
export function groundOfPixel(u: number, v: number, state: StateAt, camera: Scene["camera"], ground: Ground): XY {
  const R = state.R_camera_to_enu;
  const [a, b] = [(u - camera.cx_px) / camera.fx_px, (v - camera.cy_px) / camera.fy_px];
  const ray: XYZ = [
    R[0]! * a + R[1]! * b + R[2]!,
    R[3]! * a + R[4]! * b + R[5]!,
    R[6]! * a + R[7]! * b + R[8]!,
  ];
  const [x, y, z] = state.camera_enu_m;
  const farthest = FARTHEST_M / Math.max(Math.hypot(ray[0], ray[1]), 1e-9);
  let s = 0;
  for (let k = 0; k < 3; k++) {
    const down = z - ground(x + s * ray[0], y + s * ray[1]);
    s = ray[2] < 0 ? Math.min(Math.max(down, 0) / -ray[2], farthest) : farthest;
  }
  return [x + s * ray[0], y + s * ray[1]];
}

/** The picture's corners on the ground. */
export function footprint(state: StateAt, camera: Scene["camera"], ground: Ground): XY[] {
  const [w, h] = [camera.width_px, camera.height_px];
  const corners: XY[] = [[0, 0], [w, 0], [w, h], [0, h]];
  return corners.map(([u, v]) => groundOfPixel(u, v, state, camera, ground));
}

/** Half axes in m and angle in rad (from east, counter-clockwise) of the ellipse that holds 95 %. */
export function ellipse95(covariance_m2: readonly number[][]): { a_m: number; b_m: number; angle_rad: number } {
  const [[xx = 0, xy = 0] = [], [, yy = 0] = []] = covariance_m2;
  const middle = (xx + yy) / 2;
  const half = Math.hypot((xx - yy) / 2, xy);
  const CHI2_95 = 5.991;
  return {
    a_m: Math.sqrt(Math.max(middle + half, 0) * CHI2_95),
    b_m: Math.sqrt(Math.max(middle - half, 0) * CHI2_95),
    angle_rad: Math.atan2(2 * xy, xx - yy) / 2,
  };
}
