/** Where the simulated targets are: those that move, at the time that is shown. */

import { countUpTo } from "./series";
import type { Target, XY } from "./types";

export function placeAt(target: Target, t: number): XY {
  const { way } = target;
  if (!way) return [target.position_enu_m[0], target.position_enu_m[1]];
  const before = Math.max(countUpTo(way.map(([at]) => at), way.length, t) - 1, 0);
  const [t0, x0, y0] = way[before]!;
  const [t1, x1, y1] = way[before + 1] ?? way[before]!;
  const share = t1 > t0 ? Math.min(Math.max((t - t0) / (t1 - t0), 0), 1) : 0;
  return [x0 + share * (x1 - x0), y0 + share * (y1 - y0)];
}
