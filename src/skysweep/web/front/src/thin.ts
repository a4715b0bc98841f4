/** Fewer points for the same line. Pure. */

/**
 * Indices of the points (packed u, v) that a line needs to stay within `tolerance` of all of them.
 *
 * Points are left out while they lie ahead on the ray from the last kept point through the one after it (Reumann and
 * Witkam, 1974). First and last points are kept, and those where `key` changes.
 */
export function thinned(points: ArrayLike<number>, key: (k: number) => unknown, tolerance: number): number[] {
  const n = points.length / 2;
  const kept: number[] = [];
  let [u, v, du, dv, reach] = [NaN, NaN, 0, 0, 0];
  const keep = (k: number) => {
    kept.push(k);
    [u, v, du, dv, reach] = [points[2 * k]!, points[2 * k + 1]!, 0, 0, 0];
  };
  for (let k = 0; k < n; k++) {
    if (k === 0 || key(k) !== key(k - 1)) {
      if (k > 0 && kept[kept.length - 1] !== k - 1) keep(k - 1);
      keep(k);
      continue;
    }
    for (let again = 0; again < 2; again++) {
      const [a, b] = [points[2 * k]! - u, points[2 * k + 1]! - v];
      const length = Math.hypot(a, b);
      if (reach === 0) {
        if (length > tolerance) [du, dv, reach] = [a / length, b / length, length];
        break;
      }
      const along = a * du + b * dv;
      if (Math.abs(a * dv - b * du) <= tolerance && along >= reach - tolerance) {
        reach = Math.max(reach, along);
        break;
      }
      keep(k - 1); // and from there on
    }
  }
  if (n > 0 && kept[kept.length - 1] !== n - 1) keep(n - 1);
  return kept;
}
