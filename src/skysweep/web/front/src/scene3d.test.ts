import { describe, expect, it } from "vitest";

import {
  clamp,
  closed,
  curtain,
  drape,
  ellipse,
  footprint,
  gridBorder,
  gridTriangles,
  Ground,
  lastAt,
  wallTriangles,
  type Pinhole,
} from "./scene3d-geometry";

const CAMERA: Pinhole = { width_px: 640, height_px: 480, fx_px: 500, fy_px: 500, cx_px: 320, cy_px: 240 };
const DOWN_NORTH_UP = [1, 0, 0, 0, -1, 0, 0, 0, -1]; // the picture's right is east, its top north
const flat = new Ground({ bounds_enu_m: [-100, -100, 100, 100], rows: 2, columns: 2, heights_m: [3, 3, 3, 3] });
const slope = new Ground({ bounds_enu_m: [0, 0, 100, 100], rows: 2, columns: 2, heights_m: [0, 20, 0, 20] });

const pointsOf = (packed: Float32Array): number[][] =>
  Array.from({ length: packed.length / 3 }, (_, k) => [...packed.subarray(3 * k, 3 * k + 3)]);

describe("ground", () => {
  it("is bilinear between its places, with row 0 in the south", () => {
    const ground = new Ground({ bounds_enu_m: [0, 0, 10, 10], rows: 2, columns: 2, heights_m: [0, 10, 20, 30] });
    expect(ground.heightAt(0, 0)).toBe(0);
    expect(ground.heightAt(10, 0)).toBe(10);
    expect(ground.heightAt(0, 10)).toBe(20);
    expect(ground.heightAt(5, 5)).toBe(15);
  });

  it("goes on at the height of its edge", () => {
    expect(slope.heightAt(-50, 300)).toBe(0);
    expect(slope.heightAt(150, 50)).toBe(20);
  });

  it("is met by a ray where the ray passes through it", () => {
    const diagonal = Math.SQRT1_2;
    const [x, y, z] = slope.meet([20, 50, 40], [diagonal, 0, -diagonal], 500);
    expect(z).toBeCloseTo(slope.heightAt(x, y), 1);
    expect(x - 20).toBeCloseTo(40 - z, 6);
    expect(y).toBe(50);
  });

  it("is not met by a ray that rises: the ray ends at its greatest length", () => {
    expect(flat.meet([0, 0, 10], [0, 0, 1], 70)).toEqual([0, 0, 80]);
  });

  it("hides what is behind a ridge", () => {
    const ridge = new Ground({ bounds_enu_m: [0, 0, 100, 1], rows: 2, columns: 5, heights_m: [0, 0, 30, 0, 0, 0, 0, 30, 0, 0] });
    const [x] = ridge.meet([10, 0.5, 35], [Math.cos(0.35), 0, -Math.sin(0.35)], 500);
    expect(x).toBeLessThan(51);
  });
});

describe("footprint", () => {
  it("of a camera that looks straight down is the picture's size at that height", () => {
    const [h, corners] = [50, footprint(CAMERA, [10, 20, 53], DOWN_NORTH_UP, flat, 1000, 2)];
    const [halfWidth, halfHeight] = [(320 / 500) * h, (240 / 500) * h];
    const expected = [
      [10 - halfWidth, 20 + halfHeight, 3],
      [10 + halfWidth, 20 + halfHeight, 3],
      [10 - halfWidth, 20 - halfHeight, 3],
      [10 + halfWidth, 20 - halfHeight, 3],
    ];
    pointsOf(corners).forEach((corner, k) =>
      corner.forEach((value, axis) => expect(value).toBeCloseTo(expected[k]![axis]!, 1)),
    );
  });

  it("lies on sloping ground and is wider where that is farther away", () => {
    const points = pointsOf(footprint(CAMERA, [50, 50, 60], DOWN_NORTH_UP, slope, 1000, 5));
    for (const [x, y, z] of points) expect(z).toBeCloseTo(slope.heightAt(x!, y!), 1);
    const north_m = (k: number): number => points[k]![1]! - 50;
    expect(north_m(0)).toBeGreaterThan(north_m(4));
  });

  it("ends at the greatest distance where the camera sees the sky", () => {
    const level = [0, 0, 1, -1, 0, 0, 0, -1, 0]; // looks east
    const points = pointsOf(footprint(CAMERA, [0, 0, 20], level, flat, 200, 3));
    expect(Math.hypot(points[1]![0]!, points[1]![1]!, points[1]![2]! - 20)).toBeCloseTo(200, 3);
    expect(points[7]![2]).toBeCloseTo(3, 1);
  });
});

describe("grids", () => {
  it("have a border that is closed and visits each outer point once", () => {
    const border = gridBorder(4);
    expect(border[0]).toBe(border[border.length - 1]);
    expect(new Set(border).size).toBe(12);
    expect(border).toHaveLength(13);
    for (const inner of [5, 6, 9, 10]) expect(border).not.toContain(inner);
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

describe("the 95 % ellipse", () => {
  it("is a circle where the covariance is the same on all sides", () => {
    for (const [x, y] of ellipse([5, 6], [[4, 0], [0, 4]], 16)) {
      expect(Math.hypot(x - 5, y - 6)).toBeCloseTo(2 * 2.4477, 3);
    }
  });

  it("holds places at one Mahalanobis distance", () => {
    const [a, b, c] = [3, 1.2, 1];
    const determinant = a * c - b * b;
    for (const [x, y] of ellipse([0, 0], [[a, b], [b, c]], 24)) {
      expect((c * x * x - 2 * b * x * y + a * y * y) / determinant).toBeCloseTo(5.991, 6);
    }
  });
});

describe("times", () => {
  it("are found by the last that has come", () => {
    const times = [0, 1, 1, 2];
    expect(lastAt(times, -0.1)).toBe(-1);
    expect(lastAt(times, 1)).toBe(2);
    expect(lastAt(times, 1.5)).toBe(2);
    expect(lastAt(times, 9)).toBe(3);
    expect(lastAt([], 0)).toBe(-1);
  });

  it("are clamped", () => {
    expect([clamp(-1, 0, 2), clamp(1, 0, 2), clamp(3, 0, 2)]).toEqual([0, 1, 2]);
  });
});
