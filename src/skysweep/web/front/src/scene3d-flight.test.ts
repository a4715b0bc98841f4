import { describe, expect, it } from "vitest";

import { Path } from "./scene3d-flight";
import { palette } from "./scene3d-look";
import { Strokes } from "./scene3d-marks";
import { Store } from "./store";
import type { Line, Scene } from "./types";

const SCENE = { search: { scan_altitude_agl_m: 30, check_altitude_agl_m: 5 } } as Scene;
const STATES: Line[] = Array.from({ length: 400 }, (_, k) => ({
  t: k / 2,
  kind: "state",
  p: k < 200 ? [2 * k, 0, 30] : [400, 0, 30 - (k - 200) / 10],
  mode: k < 200 ? "SCAN" : "CHECK",
}));

/** The pieces of line that a path shows at a time: x, y, z of both ends of each. */
function shown(path: Path, store: Store, t: number): number[][] {
  path.show(store.stateAt(t)!);
  return path.children.flatMap((child) => {
    if (!(child instanceof Strokes)) return [];
    const { instanceStart } = child.geometry.attributes;
    const ends = Array.from((instanceStart as unknown as { data: { array: Float32Array } }).data.array);
    return Array.from({ length: child.geometry.instanceCount }, (_, k) => ends.slice(6 * k, 6 * k + 6));
  });
}

const length_m = (pieces: number[][]) =>
  pieces.reduce((sum, [x, y, z, toX, toY, toZ]) => sum + Math.hypot(toX! - x!, toY! - y!, toZ! - z!), 0);

describe("the flown path", () => {
  it("is as long as what was flown until then, in few pieces", () => {
    const store = new Store(SCENE);
    store.add(STATES);
    const path = new Path(store, () => 0, palette(false));
    for (const [t, flown_m] of [[0, 0], [10.25, 41], [60, 240], [150, 410]] as const) {
      const pieces = shown(path, store, t);
      expect(length_m(pieces)).toBeCloseTo(flown_m, 3);
      expect(pieces.length).toBeLessThan(t + 2);
    }
  });

  it("is the same whether its states come at once or one by one", () => {
    const [whole, live] = [new Store(SCENE), new Store(SCENE)];
    whole.add(STATES);
    const path = new Path(live, () => 0, palette(false));
    for (const line of STATES) {
      live.add([line]);
      path.show(live.stateAt(line.t)!);
    }
    for (const t of [3, 99.7, 170]) {
      expect(shown(path, live, t)).toEqual(shown(new Path(whole, () => 0, palette(false)), whole, t));
    }
  });
});
