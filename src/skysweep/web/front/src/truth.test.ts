import { describe, expect, it } from "vitest";
import { placeAt } from "./truth";
import type { Target } from "./types";

const STANDS: Target = { class_name: "person", position_enu_m: [3, 4, 1] };
const WALKS: Target = { ...STANDS, way: [[0, 3, 4], [2, 5, 4], [3, 5, 8]] };

describe("a target", () => {
  it("that stands is where it began", () => expect(placeAt(STANDS, 100)).toEqual([3, 4]));

  it("that moves is on its way at the time shown", () => {
    expect(placeAt(WALKS, 0)).toEqual([3, 4]);
    expect(placeAt(WALKS, 0.5)).toEqual([3.5, 4]);
    expect(placeAt(WALKS, 2)).toEqual([5, 4]);
    expect(placeAt(WALKS, 2.75)).toEqual([5, 7]);
  });

  it("neither leaves its start too early nor goes on after the end", () => {
    expect(placeAt(WALKS, -5)).toEqual([3, 4]);
    expect(placeAt(WALKS, 50)).toEqual([5, 8]);
  });

  it("of a mission that ended at once is at its start", () => {
    expect(placeAt({ ...STANDS, way: [[0, 3, 4]] }, 1)).toEqual([3, 4]);
  });
});
