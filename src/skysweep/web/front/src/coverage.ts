/** How much of the area was searched. Pure. */

import type { Grid, XY } from "./types";

/** Whether a place is within a ring of corners. */
export function isInside(x: number, y: number, ring: readonly XY[]): boolean {
  let inside = false;
  for (let i = 0, j = ring.length - 1; i < ring.length; j = i++) {
    const [xi, yi] = ring[i]!;
    const [xj, yj] = ring[j]!;
    if (yi > y !== yj > y && x < ((xj - xi) * (y - yi)) / (yj - yi) + xi) inside = !inside;
  }
  return inside;
}

/** Which cells of a grid (row 0 in the south) have their centre in an area with holes. */
export function cellsInside(
  grid: Grid,
  area: readonly XY[],
  holes: readonly XY[][],
): Uint8Array {
  const [west, south, east, north] = grid.bounds_enu_m;
  const inside = new Uint8Array(grid.rows * grid.columns);
  for (let row = 0; row < grid.rows; row++) {
    const y = south + ((row + 0.5) / grid.rows) * (north - south);
    for (let column = 0; column < grid.columns; column++) {
      const x = west + ((column + 0.5) / grid.columns) * (east - west);
      if (isInside(x, y, area) && !holes.some((hole) => isInside(x, y, hole)))
        inside[row * grid.columns + column] = 1;
    }
  }
  return inside;
}

/** Mean probability of detection (0..1) over the cells that count, and the share of them that was looked at. */
export function searched(pod: Uint8Array, inside: Uint8Array): { pos: number; share: number } {
  let [sum, looked, cells] = [0, 0, 0];
  for (let k = 0; k < inside.length; k++) {
    if (!inside[k]) continue;
    cells++;
    sum += pod[k] ?? 0;
    if (pod[k]) looked++;
  }
  return cells ? { pos: sum / (255 * cells), share: looked / cells } : { pos: 0, share: 0 };
}
