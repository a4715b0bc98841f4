import { describe, expect, it } from "vitest";

import {
  closed,
  curtain,
  drape,
  ellipseRing,
  gridBorder,
  gridTriangles,
  isStraight,
  niceStep,
  seenGround,
  wallTriangles,
} from "./scene3d-geometry";
import type { StateAt } from "./store";
import type { XYZ } from "./types";

const CAMERA = { width_px: 640, height_px: 480, fx_px: 500, fy_px: 500, cx_px: 320, cy_px: 240, rate_hz: 10 };
const flat = () => 3;
const slope = (x: number) => x / 5;

const from = (camera_enu_m: XYZ): StateAt => ({
  t: 0,
  position_enu_m: camera_enu_m,
  velocity_enu_mps: [0, 0, 0],
  mode: "SCAN",
  battery: 1,
  energy_wh: 0,
  camera_enu_m,
  R_camera_to_enu: [1, 0, 0, 0, -1, 0, 0, 0, -1], // looks down; the picture's top is in the north
  heading_en: [0, 1],
});

const pointsOf = (packed: Float32Array): number[][] =>
  Array.from({ length: packed.length / 3 }, (_, k) => [...packed.subarray(3 * k, 3 * k + 3)]);

describe("the ground that a camera sees", () => {
  it("has the picture's size at the camera's height", () => {
    const corners = pointsOf(seenGround(from([10, 20, 53]), CAMERA, flat, 2));
    const [halfWidth, halfHeight] = [(320 / 500) * 50, (240 / 500) * 50];
    const expected = [
      [10 - halfWidth, 20 + halfHeight, 3],
      [10 + halfWidth, 20 + halfHeight, 3],
      [10 - halfWidth, 20 - halfHeight, 3],
      [10 + halfWidth, 20 - halfHeight, 3],
    ];
    corners.forEach((corner, k) =>
      corner.forEach((value, axis) => expect(value).toBeCloseTo(expected[k]![axis]!, 4)),
    );
  });

  it("lies on a slope, and is wider where that is farther away", () => {
    const points = pointsOf(seenGround(from([50, 50, 60]), CAMERA, slope, 5));
    for (const [x, , z] of points) expect(z).toBeCloseTo(slope(x!), 4);
    const north_m = (k: number) => points[k]![1]! - 50;
    expect(north_m(0)).toBeGreaterThan(north_m(4));
  });
});

describe("grids", () => {
  it("have a border that is closed and visits each outer point once", () => {
    expect(gridBorder(3, 4)).toEqual([0, 1, 2, 3, 7, 11, 10, 9, 8, 4, 0]);
    expect(gridBorder(2, 2)).toEqual([0, 1, 3, 2, 0]);
  });

  it("have two triangles in each cell", () => {
    expect([...gridTriangles(2, 2)]).toEqual([0, 1, 3, 0, 3, 2]);
    expect(gridTriangles(3, 5)).toHaveLength(6 * 8);
  });
});

describe("lines and walls", () => {
  it("follow the ground between their corners", () => {
    const points = pointsOf(drape([[0, 50], [100, 50]], slope, 1, 10));
    expect(points).toHaveLength(11);
    for (const [x, , z] of points) expect(z).toBeCloseTo(x! / 5 + 1, 4);
  });

  it("are closed by their first point", () => {
    expect(closed([[0, 0], [1, 0], [1, 1]])).toEqual([[0, 0], [1, 0], [1, 1], [0, 0]]);
    expect(closed([])).toEqual([]);
  });

  it("hang down to the ground, and never up to it", () => {
    const wall = pointsOf(curtain([50, 50, 30, 100, 50, 12], slope));
    expect(wall).toEqual([[50, 50, 30], [50, 50, 10], [100, 50, 12], [100, 50, 12]]);
  });

  it("have two triangles between neighbouring points", () => {
    expect([...wallTriangles(2)]).toEqual([0, 1, 2, 2, 1, 3]);
    expect(wallTriangles(0)).toHaveLength(0);
    expect(wallTriangles(1)).toHaveLength(0);
  });
});

describe("a stretch of the path", () => {
  it("is straight while no point leaves the piece between its ends", () => {
    expect(isStraight([[0, 0, 0], [5, 0.1, 0], [10, 0, 0]], 0.2)).toBe(true);
    expect(isStraight([[0, 0, 0], [5, 0, 0.3], [10, 0, 0]], 0.2)).toBe(false);
    expect(isStraight([[0, 0, 0], [12, 0, 0], [10, 0, 0]], 0.2)).toBe(false);
    expect(isStraight([[3, 3, 3], [3, 3, 3]], 0.2)).toBe(true);
  });
});

describe("the 95 % ellipse", () => {
  it("holds places at one Mahalanobis distance and is closed", () => {
    const [a, b, c] = [3, 1.2, 1];
    const determinant = a * c - b * b;
    const ring = ellipseRing([7, -2], [[a, b], [b, c]], 24);
    expect(ring).toHaveLength(25);
    for (const [x, y] of ring) {
      const [dx, dy] = [x - 7, y + 2];
      expect((c * dx * dx - 2 * b * dx * dy + a * dy * dy) / determinant).toBeCloseTo(5.991, 6);
    }
    expect(ring[24]![0]).toBeCloseTo(ring[0]![0], 9);
    expect(ring[24]![1]).toBeCloseTo(ring[0]![1], 9);
  });
});

describe("steps of a scale", () => {
  it("are round, and few", () => {
    expect([niceStep(30, 6), niceStep(31, 6), niceStep(120, 6), niceStep(8, 6), niceStep(6, 6)]).toEqual([
      5, 10, 20, 2, 1,
    ]);
  });
});
