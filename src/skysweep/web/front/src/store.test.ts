import { describe, expect, it } from "vitest";
import { cellsInside, searched } from "./coverage";
import { Store } from "./store";
import type { Grid, Line, Scene } from "./types";

const CAMERA = { width_px: 640, height_px: 360, fx_px: 500, fy_px: 500, cx_px: 320, cy_px: 180, rate_hz: 10 };
const SCENE = { camera: CAMERA } as Scene;
const EAST = [0, -1, 0, -1, 0, 0, 0, 0, -1]; // straight down, the picture's top to the east

const state = (t: number, x: number, mode = "SCAN", battery = 1): Line => ({
  t, kind: "state", p: [x, 0, 30], v: [5, 0, 0], mode, battery, energy_wh: 0, cam: { p: [x, 0, 30], R: EAST },
});
const sighting = (t: number, candidate: number, confidence: number): Line => ({
  t, kind: "sighting", candidate, class_name: "person", p: [t, 1, 0], confidence, new: false,
});
const decision = (t: number, kind: string, candidate: number, more: Partial<Line> = {}): Line => ({
  t, kind, candidate, p: [t, 2, 0], covariance_m2: [[1, 0], [0, 1]], ...more,
});

const storeOf = (...lines: Line[]) => {
  const store = new Store(SCENE);
  store.add(lines);
  return store;
};

describe("the state", () => {
  const store = storeOf(state(0, 0, "TAKEOFF"), state(1, 10), state(2, 20, "CHECK", 0.5));

  it("lies between two lines", () => {
    const now = store.stateAt(0.25)!;
    expect(now.position_enu_m).toEqual([2.5, 0, 30]);
    expect(now.mode).toBe("TAKEOFF");
    expect(now.heading_en).toEqual([1, 0]);
  });

  it("stays at the first and the last line outside of them", () => {
    expect(store.stateAt(-1)!.position_enu_m[0]).toBe(0);
    expect(store.stateAt(9)!.position_enu_m[0]).toBe(20);
    expect(store.stateAt(9)!.mode).toBe("CHECK");
  });

  it("is unknown without lines", () => expect(storeOf().stateAt(1)).toBeNull());

  it("gives the runs of modes", () => {
    expect(store.modes.map((run) => [run.mode, run.from_s, run.to_s])).toEqual([
      ["TAKEOFF", 0, 1], ["SCAN", 1, 2], ["CHECK", 2, 2],
    ]);
  });

  it("tells the battery's time left by the use of the last minute", () => {
    expect(store.timeLeft_s(2)).toBeCloseTo(2); // half in two seconds
    expect(store.timeLeft_s(1)).toBeNull();
  });
});

describe("who else flies the vehicle", () => {
  const taken = (t: number, action: string, holder?: string): Line => ({
    t, kind: "safety", cause: "taken over", action, ...(holder && { holder }),
  });
  const now = (...lines: Line[]) => storeOf(taken(1, "KEEP_OUT", "it is in Position"), ...lines).holder;

  it("is in the newest line of it", () => {
    expect(storeOf(state(0, 0)).holder).toBeNull();
    expect(now(state(2, 0), { t: 2, kind: "safety", cause: "wind", action: "HOLD" })).toBe("it is in Position");
    expect(now(taken(2, "KEEP_OUT", "it is in Land"))).toBe("it is in Land");
  });

  it("is nobody after it was given back, and before a resumed mission says so again", () => {
    expect(now(taken(2, "CONTINUE"))).toBeNull();
    expect(now(taken(2, "HOLD"))).toBeNull();
    expect(now({ t: 2, kind: "resumed" })).toBeNull();
    expect(now({ t: 2, kind: "end", reason: "completed" })).toBeNull();
  });
});

describe("candidates", () => {
  const store = storeOf(
    sighting(10, 1, 0.4), decision(10.2, "scanned", 1, { probability: 0.6, reason: "seen" }),
    sighting(11, 1, 0.8), sighting(12, 2, 0.5),
    decision(13, "confirmed", 1, { probability: 0.99 }), decision(14, "rejected", 1, { by: "operator" }),
  );
  const of = (t: number, id: number) => store.candidatesAt(t).find((c) => c.id === id);

  it("are not known before they are seen", () => expect(store.candidatesAt(9.9)).toEqual([]));

  it("have the status of the time", () => {
    expect(of(10, 1)!.status).toBe("seen");
    expect(of(12, 1)!.status).toBe("scanned");
    expect(of(13, 1)).toMatchObject({ status: "confirmed", by_operator: false, probability: 0.99, looks: 2 });
    expect(of(14, 1)).toMatchObject({ status: "rejected", by_operator: true });
    expect(of(14, 2)).toMatchObject({ status: "seen", class_name: "person" });
  });

  it("keep the history of their confidences", () => {
    expect(store.confidencesOf(1, 10.5)).toEqual([[10, 0.4]]);
    expect(store.confidencesOf(1, 99)).toEqual([[10, 0.4], [11, 0.8]]);
  });

  it("are counted", () => {
    expect(store.countsAt(store.candidatesAt(99))).toEqual({
      candidates: 2, open: 1, confirmed: 0, rejected: 1, unchecked: 0,
    });
  });
});

describe("what comes in another order", () => {
  it("is told in order", () => {
    const store = storeOf(decision(12, "scanned", 1), decision(11.5, "scanned", 2), { t: 13, kind: "end", reason: "completed" });
    expect(store.events.items.map((e) => e.candidate)).toEqual([2, 1, null]);
    expect(store.ended).toBe("completed");
    expect(store.end_s).toBe(13);
  });

  it("comes once", () => {
    const store = storeOf();
    store.addFilm(["12.4000", "3.0000"]);
    store.addFilm(["12.4000"]);
    store.addCoverage(2, new Uint8Array([1]));
    store.addCoverage(2, new Uint8Array([1]));
    expect(store.film.items).toEqual(["3.0000", "12.4000"]);
    expect(store.film.at(5)).toBe("3.0000");
    expect(store.coverages.length).toBe(1);
  });
});

it("a class name stays text", () => {
  const store = storeOf({ t: 1, kind: "safety", action: "HOLD", sentence: "<script>alert(1)</script>" });
  expect(store.events.items[0]).toMatchObject({ tone: "danger", words: "<script>alert(1)</script>" });
});

it("finds the picture that shows a candidate best", () => {
  const look = (t: number, ...confidences: number[]): Line => ({
    t, kind: "look", boxes_xyxy_px: confidences.map((_, k) => [k, k, k + 9, k + 9]), confidences,
    class_names: confidences.map(() => "person"),
  });
  const store = storeOf(
    look(1.2, 0.91234, 0.51111), sighting(1, 7, 0.5111), look(2.2, 0.71111), sighting(2, 7, 0.7111),
    look(3.2, 0.61111), sighting(3, 7, 0.6111),
  );
  expect(store.cropOf(7, 9)).toBeNull();
  store.addPictures({ "7": "candidate-7-1.0s.jpg" });
  expect(store.cropOf(7, 9)).toEqual({ film: null, box_xyxy_px: [1, 1, 10, 10] });
  store.addFilm(["3.2000"]);
  expect(store.cropOf(7, 9)).toEqual({ film: "3.2000", box_xyxy_px: [0, 0, 9, 9] });
  expect(store.cropOf(7, 2.5)).toEqual({ film: null, box_xyxy_px: [1, 1, 10, 10] });
});

it("averages the coverage over the area without its holes", () => {
  const grid: Grid = { bounds_enu_m: [0, 0, 4, 1], rows: 1, columns: 4 };
  const inside = cellsInside(grid, [[0, 0], [3, 0], [3, 1], [0, 1]], [[[1, 0], [2, 0], [2, 1], [1, 1]]]);
  expect([...inside]).toEqual([1, 0, 1, 0]);
  expect(searched(new Uint8Array([255, 9, 0, 9]), inside)).toEqual({ pos: 0.5, share: 0.5 });
});

it("scrubs an hour with 36,000 looks far faster than 20 frames a second", () => {
  const store = new Store(SCENE);
  const lines: Line[] = [];
  for (let k = 0; k < 36000; k++) {
    lines.push({ t: k / 10, kind: "look", boxes_xyxy_px: [[1, 2, 3, 4]], confidences: [0.5], class_names: ["person"] });
    if (k % 5 === 0) lines.push(state(k / 10, k, "SCAN", 1 - k / 40000));
    if (k % 20 === 0) lines.push(sighting(k / 10, k % 300, 0.5), decision(k / 10, "reassessed", k % 300));
  }
  store.add(lines);
  const started = performance.now();
  for (let k = 0; k < 200; k++) {
    const t = (k * 3600) / 200;
    store.stateAt(t);
    store.looks.at(t);
    store.countsAt(store.candidatesAt(t));
    store.timeLeft_s(t);
  }
  expect((performance.now() - started) / 200).toBeLessThan(10); // ms a frame
});
