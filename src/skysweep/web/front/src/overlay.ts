/** Draws a mission at one time over the base map. */

import { MODE_COLOURS, STATUS_COLOURS, altitudeColour, altitudeStep, podColour } from "./colours";
import { ellipse95, footprint } from "./footprint";
import type { Projection } from "./projection";
import { Rows } from "./series";
import type { CandidateAt, StateAt, Store } from "./store";
import { thinned } from "./thin";
import { placeAt } from "./truth";
import type { Grid, XY } from "./types";
import { metres } from "./words";

export const LAYERS = {
  picture: "Orthophoto",
  coverage: "Coverage (POD)",
  area: "Area, no-fly, fence",
  plan: "Planned path",
  path: "Flown path",
  camera: "Camera footprint",
  candidates: "Candidates",
  truth: "Targets (truth)",
} as const;
export type Layer = keyof typeof LAYERS;

export type PathColour = "mode" | "altitude";

export interface Shown {
  layers: Record<Layer, boolean>;
  colour: PathColour;
  selected: number | null;
  measured: XY[];
}

const TOLERANCE_PX = 0.4; // of the flown path
const HALO = "rgb(255 255 255 / 0.85)";
const INK = "#10161d";

export class Overlay {
  private readonly flats = new Rows(2); // of the states
  private coverage: { of: Uint8Array | null; canvas: HTMLCanvasElement } = { of: null, canvas: document.createElement("canvas") };

  constructor(
    private readonly store: Store,
    private readonly projection: Projection,
  ) {}

  draw(context: CanvasRenderingContext2D, width: number, height: number, t: number, shown: Shown): void {
    const { scene } = this.store;
    const { layers } = shown;
    context.clearRect(0, 0, width, height);
    context.lineJoin = context.lineCap = "round";
    if (layers.coverage && scene.coverage) this.drawCoverage(context, scene.coverage, t);
    if (layers.area) this.drawArea(context);
    if (layers.plan) this.drawPlan(context);
    if (layers.path) this.drawPath(context, t, shown.colour);
    const state = this.store.stateAt(t);
    if (state && layers.camera) this.drawFootprint(context, state);
    if (layers.truth) this.drawTruth(context, t);
    this.drawHome(context);
    if (layers.candidates) for (const candidate of this.store.candidatesAt(t)) this.drawCandidate(context, candidate, shown);
    if (state) this.drawVehicle(context, state);
    if (shown.measured.length) this.drawMeasured(context, shown.measured);
  }

  private ring(context: CanvasRenderingContext2D, places: readonly (readonly number[])[], closed = true): void {
    places.forEach((place, k) => {
      const [u, v] = this.projection.px(place[0]!, place[1]!);
      if (k) context.lineTo(u, v);
      else context.moveTo(u, v);
    });
    if (closed) context.closePath();
  }

  private drawCoverage(context: CanvasRenderingContext2D, grid: Grid, t: number): void {
    const pod = this.store.coverages.at(t)?.pod;
    if (!pod) return;
    const { canvas } = this.coverage;
    if (this.coverage.of !== pod) {
      this.coverage.of = pod;
      [canvas.width, canvas.height] = [grid.columns, grid.rows];
      const image = new ImageData(grid.columns, grid.rows);
      for (let row = 0; row < grid.rows; row++) {
        for (let column = 0; column < grid.columns; column++) {
          const colour = podColour(pod[row * grid.columns + column] ?? 0);
          image.data.set(colour, 4 * ((grid.rows - 1 - row) * grid.columns + column));
        }
      }
      canvas.getContext("2d")!.putImageData(image, 0, 0);
    }
    const [west, south, east, north] = grid.bounds_enu_m;
    const [left, top] = this.projection.px(west, north);
    const [right, bottom] = this.projection.px(east, south);
    context.imageSmoothingEnabled = false;
    context.drawImage(canvas, left, top, right - left, bottom - top);
  }

  private drawArea(context: CanvasRenderingContext2D): void {
    const { scene } = this.store;
    context.beginPath();
    for (const ring of [scene.area_enu_m, ...scene.holes_enu_m]) this.ring(context, ring);
    stroke(context, HALO, 5);
    stroke(context, INK, 2);
    for (const zone of scene.no_fly_enu_m) {
      context.beginPath();
      this.ring(context, zone);
      context.fillStyle = "rgb(213 94 0 / 0.28)";
      context.fill();
      stroke(context, HALO, 4);
      stroke(context, "#b34700", 2);
    }
    if (scene.geofence_enu_m) {
      context.beginPath();
      this.ring(context, scene.geofence_enu_m);
      stroke(context, HALO, 4);
      stroke(context, "#b34700", 2, [10, 4, 2, 4]);
    }
  }

  private drawPlan(context: CanvasRenderingContext2D): void {
    context.beginPath();
    this.ring(context, this.store.planned_enu_m, false);
    stroke(context, HALO, 3.5);
    stroke(context, INK, 1.5, [5, 5]);
  }

  private drawPath(context: CanvasRenderingContext2D, t: number, colour: PathColour): void {
    const { store } = this;
    while (this.flats.length < store.states.length) {
      const [x, y] = store.position(this.flats.length);
      this.flats.push(this.projection.flat(x, y));
    }
    const n = store.countStates(t);
    if (n === 0) return;
    const highest = 1.1 * store.scene.search.scan_altitude_agl_m;
    const keyOf = (row: number) => (colour === "mode" ? store.mode(row) : altitudeStep(store.position(row)[2], highest));
    const all = new Float64Array(2 * n);
    for (let row = 0; row < n; row++) all.set(this.projection.ofFlat(this.flats.get(row, 0), this.flats.get(row, 1)), 2 * row);
    const rows = thinned(all, keyOf, TOLERANCE_PX);
    const keys = rows.map(keyOf);
    const points = rows.flatMap((row) => [all[2 * row]!, all[2 * row + 1]!]);
    const now = store.stateAt(t)!;
    points.push(...this.projection.px(now.position_enu_m[0], now.position_enu_m[1]));
    keys.push(keys[keys.length - 1]!);
    context.beginPath();
    for (let k = 0; k < keys.length; k++) context.lineTo(points[2 * k]!, points[2 * k + 1]!);
    stroke(context, HALO, 5.5);
    for (let k = 1; k < keys.length; ) {
      const key = keys[k]!;
      context.beginPath();
      context.moveTo(points[2 * k - 2]!, points[2 * k - 1]!);
      for (; k < keys.length && keys[k] === key; k++) context.lineTo(points[2 * k]!, points[2 * k + 1]!);
      stroke(context, typeof key === "number" ? altitudeColour(key) : MODE_COLOURS[key as keyof typeof MODE_COLOURS], 3);
    }
  }

  private drawFootprint(context: CanvasRenderingContext2D, state: StateAt): void {
    const corners = footprint(state, this.store.scene.camera, (x, y) => this.store.groundAt(x, y));
    context.beginPath();
    this.ring(context, corners);
    context.fillStyle = "rgb(255 255 255 / 0.16)";
    context.fill();
    stroke(context, INK, 3);
    stroke(context, "#ffffff", 1.5);
  }

  private drawTruth(context: CanvasRenderingContext2D, t: number): void {
    for (const target of this.store.scene.targets ?? []) {
      const [u, v] = this.projection.px(...placeAt(target, t));
      context.beginPath();
      context.arc(u, v, 11, 0, 2 * Math.PI);
      stroke(context, HALO, 4);
      stroke(context, INK, 1.5, [3, 3]);
    }
  }

  private drawHome(context: CanvasRenderingContext2D): void {
    const [u, v] = this.projection.px(...this.store.scene.home_enu_m);
    context.beginPath();
    context.rect(u - 6, v - 6, 12, 12);
    context.fillStyle = "#ffffff";
    context.fill();
    stroke(context, INK, 2);
    label(context, "H", u, v, INK, "700 10px", false);
  }

  private drawCandidate(context: CanvasRenderingContext2D, candidate: CandidateAt, shown: Shown): void {
    const [x, y] = candidate.position_enu_m as XY;
    const [u, v] = this.projection.px(x, y);
    const colour = STATUS_COLOURS[candidate.status];
    if (candidate.covariance_m2) {
      const { a_m, b_m, angle_rad } = ellipse95(candidate.covariance_m2);
      const scale = this.projection.pxOfMetre(x, y);
      context.beginPath();
      context.ellipse(u, v, a_m * scale, b_m * scale, -angle_rad, 0, 2 * Math.PI);
      context.fillStyle = `${colour}40`;
      context.fill();
      stroke(context, HALO, 3);
      stroke(context, colour, 1.5);
    }
    if (candidate.id === shown.selected) {
      context.beginPath();
      context.arc(u, v, 14, 0, 2 * Math.PI);
      stroke(context, INK, 4);
      stroke(context, "#ffffff", 2);
    }
    drawStatus(context, candidate.status, u, v);
    label(context, String(candidate.id), u + 9, v - 9, INK, "600 11px");
  }

  private drawVehicle(context: CanvasRenderingContext2D, state: StateAt): void {
    const [u, v] = this.projection.px(state.position_enu_m[0], state.position_enu_m[1]);
    context.save();
    context.translate(u, v);
    context.rotate(Math.atan2(state.heading_en[0], state.heading_en[1]));
    context.beginPath();
    context.moveTo(0, -13);
    context.lineTo(9, 10);
    context.lineTo(0, 5);
    context.lineTo(-9, 10);
    context.closePath();
    context.fillStyle = MODE_COLOURS[state.mode];
    stroke(context, "#ffffff", 5);
    stroke(context, INK, 2.5);
    context.fill();
    context.restore();
  }

  private drawMeasured(context: CanvasRenderingContext2D, places: XY[]): void {
    context.beginPath();
    this.ring(context, places, false);
    stroke(context, "#ffffff", 5);
    stroke(context, "#b0005c", 2.5);
    let sum_m = 0;
    places.forEach((place, k) => {
      const before = places[k - 1];
      if (before) sum_m += Math.hypot(place[0] - before[0], place[1] - before[1]);
      const [u, v] = this.projection.px(...place);
      context.beginPath();
      context.arc(u, v, 4, 0, 2 * Math.PI);
      context.fillStyle = "#ffffff";
      context.fill();
      stroke(context, "#b0005c", 2);
      if (before) label(context, metres(sum_m), u + 10, v + 14, INK, "600 12px");
    });
  }
}

function stroke(context: CanvasRenderingContext2D, colour: string, width: number, dash: number[] = []): void {
  context.setLineDash(dash);
  context.strokeStyle = colour;
  context.lineWidth = width;
  context.stroke();
}

export function label(context: CanvasRenderingContext2D, text: string, u: number, v: number, colour: string, font: string, halo = true): void {
  context.font = `${font} system-ui, sans-serif`;
  context.textAlign = halo ? "left" : "center";
  context.textBaseline = "middle";
  context.setLineDash([]);
  if (halo) {
    context.strokeStyle = "rgb(255 255 255 / 0.95)";
    context.lineWidth = 4;
    context.strokeText(text, u, v);
  }
  context.fillStyle = colour;
  context.fillText(text, u, v);
}

/** The mark of a candidate: a shape of its own for each status. */
export function drawStatus(context: CanvasRenderingContext2D, status: CandidateAt["status"], u: number, v: number): void {
  const colour = STATUS_COLOURS[status];
  context.beginPath();
  if (status === "confirmed") {
    context.arc(u, v, 6, 0, 2 * Math.PI);
    context.fillStyle = colour;
    context.fill();
    stroke(context, "#ffffff", 2);
  } else if (status === "rejected") {
    for (const side of [-1, 1]) {
      context.moveTo(u - 5 * side, v - 5);
      context.lineTo(u + 5 * side, v + 5);
    }
    stroke(context, "#ffffff", 5);
    stroke(context, "#5c5c5c", 2.5);
  } else {
    if (status === "unchecked") context.rect(u - 5.5, v - 5.5, 11, 11);
    else {
      context.moveTo(u, v - 7);
      context.lineTo(u + 7, v);
      context.lineTo(u, v + 7);
      context.lineTo(u - 7, v);
      context.closePath();
    }
    context.fillStyle = status === "scanned" ? colour : "rgb(255 255 255 / 0.8)";
    context.fill();
    stroke(context, "#ffffff", 4.5);
    stroke(context, status === "scanned" ? INK : colour, status === "scanned" ? 1.2 : 2.5);
  }
}
