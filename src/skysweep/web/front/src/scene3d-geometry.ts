/** Geometry of the 3-D view: pure functions in ENU metres. Points are packed x, y, z. */

export type Vec3 = readonly [number, number, number];
export type XY = readonly [number, number];

/** What the server answers as `heights`: row 0 in the south, column 0 in the west. */
export interface Heights {
  bounds_enu_m: readonly [number, number, number, number]; // west, south, east, north
  rows: number;
  columns: number;
  heights_m: ArrayLike<number>;
}

/** A pinhole camera. */
export interface Pinhole {
  width_px: number;
  height_px: number;
  fx_px: number;
  fy_px: number;
  cx_px: number;
  cy_px: number;
}

/** Ground height over a regular grid: bilinear, and flat beyond the edges. */
export class Ground {
  readonly lowest_m: number;
  readonly highest_m: number;

  constructor(readonly grid: Heights) {
    let lowest = Infinity;
    let highest = -Infinity;
    for (let k = 0; k < grid.heights_m.length; k++) {
      lowest = Math.min(lowest, grid.heights_m[k]!);
      highest = Math.max(highest, grid.heights_m[k]!);
    }
    this.lowest_m = lowest;
    this.highest_m = highest;
  }

  heightAt(x: number, y: number): number {
    const { rows, columns, heights_m: h } = this.grid;
    const [west, south, east, north] = this.grid.bounds_enu_m;
    const r = clamp(((y - south) / (north - south)) * (rows - 1), 0, rows - 1);
    const c = clamp(((x - west) / (east - west)) * (columns - 1), 0, columns - 1);
    const i = Math.min(Math.floor(r), rows - 2);
    const j = Math.min(Math.floor(c), columns - 2);
    const at = i * columns + j;
    const south_m = h[at]! + (h[at + 1]! - h[at]!) * (c - j);
    const north_m = h[at + columns]! + (h[at + columns + 1]! - h[at + columns]!) * (c - j);
    return south_m + (north_m - south_m) * (r - i);
  }

  /** Where a ray meets the ground, or its point `farthest_m` away if it does not before. */
  meet(from: Vec3, direction: Vec3, farthest_m: number): [number, number, number] {
    const at = (s: number): [number, number, number] => [
      from[0] + s * direction[0],
      from[1] + s * direction[1],
      from[2] + s * direction[2],
    ];
    const above = (s: number): boolean => {
      const [x, y, z] = at(s);
      return z > this.heightAt(x, y);
    };
    const down = Math.max(-direction[2], 1e-9);
    const first = clamp((from[2] - this.highest_m) / down, 0, farthest_m);
    const last = clamp((from[2] - this.lowest_m) / down, 0, farthest_m);
    let [near, far] = [first, last];
    for (let k = 1; k <= STATIONS; k++) {
      const s = first + ((last - first) * k) / STATIONS;
      if (!above(s)) {
        far = s;
        break;
      }
      near = s;
    }
    while (far - near > MEETING_TOLERANCE_M) {
      const middle = (near + far) / 2;
      if (above(middle)) near = middle;
      else far = middle;
    }
    return at(far);
  }
}

const STATIONS = 24; // along the part of a ray that may meet the ground
const MEETING_TOLERANCE_M = 0.02;

/**
 * What the camera sees of the ground: `side` x `side` points, left to right and top to bottom of the picture.
 *
 * `R` is the rotation from the camera (x right, y down, z forward) to ENU, row by row.
 */
export function footprint(
  camera: Pinhole,
  from: Vec3,
  R: ArrayLike<number>,
  ground: Ground,
  farthest_m: number,
  side: number,
): Float32Array {
  const points = new Float32Array(3 * side * side);
  for (let row = 0; row < side; row++) {
    for (let column = 0; column < side; column++) {
      const u = ((column / (side - 1)) * camera.width_px - camera.cx_px) / camera.fx_px;
      const v = ((row / (side - 1)) * camera.height_px - camera.cy_px) / camera.fy_px;
      const length = Math.hypot(u, v, 1);
      const direction: Vec3 = [
        (R[0]! * u + R[1]! * v + R[2]!) / length,
        (R[3]! * u + R[4]! * v + R[5]!) / length,
        (R[6]! * u + R[7]! * v + R[8]!) / length,
      ];
      points.set(ground.meet(from, direction, farthest_m), 3 * (row * side + column));
    }
  }
  return points;
}

/** Indices of the outer points of a `side` x `side` grid, clockwise from the first, which comes again at the end. */
export function gridBorder(side: number): number[] {
  const border: number[] = [];
  for (let k = 0; k < side - 1; k++) border.push(k);
  for (let k = 0; k < side - 1; k++) border.push(k * side + side - 1);
  for (let k = side - 1; k > 0; k--) border.push((side - 1) * side + k);
  for (let k = side - 1; k >= 0; k--) border.push(k * side);
  return border;
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

/** A line on the ground through places, with a point at least every `step_m`, lifted by `lift_m`. */
export function drape(line: readonly XY[], ground: Ground, lift_m: number, step_m = 4): Float32Array {
  const points: number[] = [];
  const put = (x: number, y: number): void => {
    points.push(x, y, ground.heightAt(x, y) + lift_m);
  };
  line.forEach(([x, y], k) => {
    const next = line[k + 1];
    if (!next) return put(x, y);
    const n = Math.max(1, Math.ceil(Math.hypot(next[0] - x, next[1] - y) / step_m));
    for (let i = 0; i < n; i++) put(x + ((next[0] - x) * i) / n, y + ((next[1] - y) * i) / n);
  });
  return new Float32Array(points);
}

/** The outline of a polygon as a closed line. */
export function closed<T>(ring: readonly T[]): T[] {
  return [...ring, ...ring.slice(0, 1)];
}

/** A wall below a line of points: two points for each, the point itself and the ground below it. */
export function curtain(points: ArrayLike<number>, ground: Ground): Float32Array {
  const wall = new Float32Array(2 * points.length);
  for (let k = 0; k < points.length; k += 3) {
    const [x, y] = [points[k]!, points[k + 1]!];
    wall.set([x, y, points[k + 2]!, x, y, Math.min(ground.heightAt(x, y), points[k + 2]!)], 2 * k);
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

const CHI2_95 = 5.991; // two degrees of freedom

/** The 95 % ellipse around a place as a closed line of `n` + 1 places; `covariance_m2` is 2 x 2, row by row. */
export function ellipse(centre: XY, covariance_m2: readonly XY[], n: number): XY[] {
  const [[a, b], [, c]] = covariance_m2 as [XY, XY];
  const middle = (a + c) / 2;
  const spread = Math.hypot((a - c) / 2, b);
  const yaw = Math.atan2(2 * b, a - c) / 2;
  const long = Math.sqrt(CHI2_95 * Math.max(middle + spread, 0));
  const short = Math.sqrt(CHI2_95 * Math.max(middle - spread, 0));
  return Array.from({ length: n + 1 }, (_, k): XY => {
    const u = long * Math.cos((2 * Math.PI * k) / n);
    const v = short * Math.sin((2 * Math.PI * k) / n);
    return [
      centre[0] + u * Math.cos(yaw) - v * Math.sin(yaw),
      centre[1] + u * Math.sin(yaw) + v * Math.cos(yaw),
    ];
  });
}

/** Index of the last of ascending `times` that is at most `t`; -1: none. */
export function lastAt(times: ArrayLike<number>, t: number): number {
  let [low, high] = [0, times.length];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (times[middle]! <= t) low = middle + 1;
    else high = middle;
  }
  return low - 1;
}

export function clamp(value: number, least: number, most: number): number {
  return Math.min(Math.max(value, least), most);
}
