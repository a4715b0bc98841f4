/** Geometry of the 3-D view: pure functions in ENU metres. Points are packed x, y, z. */

import { ellipse95, groundOfPixel } from "./footprint";
import type { StateAt } from "./store";
import type { Scene, XY, XYZ } from "./types";

/** Height of the ground in m. */
export type GroundAt = (x: number, y: number) => number;

/** What the camera sees of the ground: `side` x `side` points, left to right and top to bottom of its picture. */
export function seenGround(state: StateAt, camera: Scene["camera"], ground: GroundAt, side: number): Float32Array {
  const points = new Float32Array(3 * side * side);
  for (let row = 0; row < side; row++) {
    for (let column = 0; column < side; column++) {
      const u = (column / (side - 1)) * camera.width_px;
      const v = (row / (side - 1)) * camera.height_px;
      const [x, y] = groundOfPixel(u, v, state, camera, ground);
      points.set([x, y, ground(x, y)], 3 * (row * side + column));
    }
  }
  return points;
}

/** Indices of the outer points of a grid in turn; the first comes again at the end. */
export function gridBorder(rows: number, columns: number): number[] {
  const last = rows * columns - 1;
  return [
    ...Array.from({ length: columns - 1 }, (_, c) => c),
    ...Array.from({ length: rows - 1 }, (_, r) => (r + 1) * columns - 1),
    ...Array.from({ length: columns - 1 }, (_, c) => last - c),
    ...Array.from({ length: rows }, (_, r) => (rows - 1 - r) * columns),
  ];
}

/** Triangles over a grid of points, row by row. */
export function gridTriangles(rows: number, columns: number): Uint32Array {
  const indices = new Uint32Array(6 * (rows - 1) * (columns - 1));
  let n = 0;
  for (let r = 0; r < rows - 1; r++) {
    for (let c = 0; c < columns - 1; c++) {
      const a = r * columns + c;
      const b = a + columns;
      for (const index of [a, a + 1, b + 1, a, b + 1, b]) indices[n++] = index;
    }
  }
  return indices;
}

/** A line through places `lift_m` above the ground, with a point at least every `step_m`. */
export function drape(line: readonly (readonly number[])[], ground: GroundAt, lift_m: number, step_m = 4): Float32Array {
  const points: number[] = [];
  const put = (x: number, y: number) => points.push(x, y, ground(x, y) + lift_m);
  line.forEach(([x = 0, y = 0], k) => {
    const [toX = x, toY = y] = line[k + 1] ?? [];
    const n = Math.max(1, Math.ceil(Math.hypot(toX - x, toY - y) / step_m));
    for (let i = 0; i < n; i++) put(x + ((toX - x) * i) / n, y + ((toY - y) * i) / n);
  });
  return new Float32Array(points);
}

/** The outline of a polygon as a line that ends where it begins. */
export function closed<T>(ring: readonly T[]): T[] {
  return [...ring, ...ring.slice(0, 1)];
}

/** A wall below a line of points: for each point itself, and the ground below it. */
export function curtain(points: ArrayLike<number>, ground: GroundAt): Float32Array {
  const wall = new Float32Array(2 * points.length);
  for (let k = 0; k < points.length; k += 3) {
    const [x, y, z] = [points[k]!, points[k + 1]!, points[k + 2]!];
    wall.set([x, y, z, x, y, Math.min(ground(x, y), z)], 2 * k);
  }
  return wall;
}

/** Triangles of a wall of `n` pairs of points. */
export function wallTriangles(n: number): Uint32Array {
  const indices = new Uint32Array(Math.max(0, 6 * (n - 1)));
  for (let k = 0; k < n - 1; k++) {
    const a = 2 * k;
    indices.set([a, a + 1, a + 2, a + 2, a + 1, a + 3], 6 * k);
  }
  return indices;
}

/** The 95 % ellipse around a place as a line of `n` + 1 places that ends where it begins. */
export function ellipseRing(centre: XY, covariance_m2: readonly number[][], n: number): XY[] {
  const { a_m, b_m, angle_rad } = ellipse95(covariance_m2);
  const [cos, sin] = [Math.cos(angle_rad), Math.sin(angle_rad)];
  return Array.from({ length: n + 1 }, (_, k): XY => {
    const u = a_m * Math.cos((2 * Math.PI * k) / n);
    const v = b_m * Math.sin((2 * Math.PI * k) / n);
    return [centre[0] + u * cos - v * sin, centre[1] + u * sin + v * cos];
  });
}

/** Whether all points lie within a tolerance of the straight piece from the first to the last. */
export function isStraight(points: readonly XYZ[], tolerance_m: number): boolean {
  const [from, to] = [points[0]!, points[points.length - 1]!];
  const way = [to[0] - from[0], to[1] - from[1], to[2] - from[2]] as const;
  const length2 = way[0] ** 2 + way[1] ** 2 + way[2] ** 2;
  return points.every((point) => {
    const d = [point[0] - from[0], point[1] - from[1], point[2] - from[2]] as const;
    const along = length2 > 0 ? (d[0] * way[0] + d[1] * way[1] + d[2] * way[2]) / length2 : 0;
    const share = Math.min(Math.max(along, 0), 1);
    return Math.hypot(d[0] - share * way[0], d[1] - share * way[1], d[2] - share * way[2]) <= tolerance_m;
  });
}

/** The smallest of 1, 2, 5, 10, 20, ... that divides `length` into at most `most` parts. */
export function niceStep(length: number, most: number): number {
  const power = 10 ** Math.floor(Math.log10(length / most));
  return [1, 2, 5].map((n) => n * power).find((step) => length / step <= most) ?? 10 * power;
}
