/** The timeline: modes, altitude, battery, detections and events; drag it to scrub. */

import { MODE_COLOURS, TONE_COLOURS } from "./colours";
import { fitCanvas, h, setText } from "./dom";
import type { MissionEvent } from "./events";
import type { Store } from "./store";
import { clockTime, metres, percent } from "./words";

const LEFT = 78; // px of labels
const RIGHT = 14;
const BAND = { top: 4, height: 16 };
const CHART = { top: 26, height: 46 };
const TICKS = { top: 76, height: 10 };
const MARKS = { top: 90, height: 14 };
const AXIS_TOP = 108;
const NEAR_PX = 6;
const STEPS_S = [1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600];

export class Timeline {
  readonly element: HTMLElement;
  private readonly canvas = h("canvas", { "aria-hidden": "true" });
  private readonly head = h("div", { class: "playhead" });
  private readonly tip = h("div", { class: "tip", role: "tooltip", hidden: true });
  private drawn = "";
  private dark = false;

  constructor(
    private readonly store: Store,
    private readonly scrubbed: (t: number) => void,
  ) {
    this.element = h(
      "div",
      { class: "timeline", role: "slider", tabindex: 0, "aria-label": "Mission time", "aria-valuemin": 0 },
      this.canvas,
      this.head,
      this.tip,
    );
    this.element.addEventListener("pointerdown", (event) => {
      this.element.setPointerCapture(event.pointerId);
      this.scrub(event);
    });
    this.element.addEventListener("pointermove", (event) => {
      if (this.element.hasPointerCapture(event.pointerId)) this.scrub(event);
      this.explain(event);
    });
    this.element.addEventListener("pointerleave", () => (this.tip.hidden = true));
  }

  setTheme(dark: boolean): void {
    this.dark = dark;
    this.drawn = "";
  }

  /** Shows time `t`; what does not change with it is drawn when something has been added. */
  show(t: number): void {
    const key = `${this.store.lines.length} ${this.store.heights !== null} ${this.canvas.clientWidth}`;
    if (key !== this.drawn && this.canvas.clientWidth > 0) {
      this.drawn = key;
      this.draw();
    }
    this.head.style.transform = `translateX(${this.u(t)}px)`;
    this.element.setAttribute("aria-valuemax", this.store.end_s.toFixed(0));
    this.element.setAttribute("aria-valuenow", t.toFixed(0));
    this.element.setAttribute("aria-valuetext", `${clockTime(t)} of ${clockTime(this.store.end_s)}`);
  }

  private get width(): number {
    return Math.max(this.canvas.clientWidth - LEFT - RIGHT, 1);
  }

  private u(t: number): number {
    return LEFT + (this.store.end_s > 0 ? t / this.store.end_s : 0) * this.width;
  }

  private time(event: PointerEvent): number {
    const u = event.clientX - this.element.getBoundingClientRect().left;
    return Math.min(Math.max((u - LEFT) / this.width, 0), 1) * this.store.end_s;
  }

  private scrub(event: PointerEvent): void {
    this.scrubbed(this.snapped(event));
  }

  /** The time under the pointer; among the marks that of the nearest one. */
  private snapped(event: PointerEvent): number {
    return this.near(event)?.t ?? this.time(event);
  }

  private near(event: PointerEvent): MissionEvent | undefined {
    const v = event.clientY - this.element.getBoundingClientRect().top;
    if (v < MARKS.top || v > MARKS.top + MARKS.height) return undefined;
    const t = this.time(event);
    const reach_s = (NEAR_PX / this.width) * this.store.end_s;
    const { events } = this.store;
    const near = events.items.slice(events.count(t - reach_s), events.count(t + reach_s)).filter((e) => e.tone !== "muted");
    return near.sort((a, b) => Math.abs(a.t - t) - Math.abs(b.t - t))[0];
  }

  private explain(event: PointerEvent): void {
    const mark = this.near(event);
    const t = mark?.t ?? this.time(event);
    const state = this.store.stateAt(t);
    if (!state) return;
    const [x, y] = state.position_enu_m;
    const height = state.position_enu_m[2] - this.store.groundAt(x, y);
    setText(
      this.tip,
      mark ? `${clockTime(t)}  ${mark.words}` : `${clockTime(t)}  ${state.mode}, ${metres(height)} AGL, battery ${percent(state.battery)}`,
    );
    this.tip.hidden = false;
    const u = Math.min(Math.max(this.u(t), 130), this.canvas.clientWidth - 130);
    this.tip.style.transform = `translateX(calc(${u}px - 50%))`;
  }

  private draw(): void {
    const context = fitCanvas(this.canvas);
    const [width, height] = [this.canvas.clientWidth, this.canvas.clientHeight];
    const ink = this.dark ? "#e7ecf2" : "#17202b";
    const muted = this.dark ? "#a9b6c4" : "#505b68";
    const line = this.dark ? "#2f3b48" : "#d8dde4";
    context.clearRect(0, 0, width, height);
    context.font = "11px system-ui, sans-serif";
    context.textBaseline = "middle";
    context.fillStyle = muted;
    context.textAlign = "right";
    const highest = this.highest();
    const label = (text: string, v: number) => context.fillText(text, LEFT - 8, v);
    label("Mode", BAND.top + BAND.height / 2);
    label(`${metres(highest)}`, CHART.top + 5);
    label("Altitude", CHART.top + CHART.height / 2);
    label("Battery", CHART.top + CHART.height - 6);
    label("Detections", TICKS.top + TICKS.height / 2);
    label("Events", MARKS.top + MARKS.height / 2);
    this.drawAxis(context, muted, line);
    if (this.store.states.length === 0) return;
    this.drawModes(context);
    this.drawAltitude(context, highest, line);
    this.drawBattery(context, ink);
    this.drawDetections(context, muted);
    this.drawMarks(context);
  }

  private highest(): number {
    let highest = 1;
    for (let row = 0; row < this.store.states.length; row++) highest = Math.max(highest, this.store.position(row)[2]);
    return highest;
  }

  private drawAxis(context: CanvasRenderingContext2D, muted: string, line: string): void {
    const end_s = Math.max(this.store.end_s, 1);
    const step = STEPS_S.find((s) => (s / end_s) * this.width > 64) ?? 3600;
    context.textAlign = "center";
    for (let t = 0; t <= end_s; t += step) {
      context.fillStyle = line;
      context.fillRect(Math.round(this.u(t)), CHART.top, 1, AXIS_TOP - CHART.top);
      context.fillStyle = muted;
      context.fillText(clockTime(t), this.u(t), AXIS_TOP + 8);
    }
  }

  private drawModes(context: CanvasRenderingContext2D): void {
    for (const run of this.store.modes) {
      const [u0, u1] = [this.u(run.from_s), this.u(run.to_s)];
      context.fillStyle = MODE_COLOURS[run.mode];
      context.fillRect(u0, BAND.top, Math.max(u1 - u0, 1.5), BAND.height);
      context.font = "600 10px system-ui, sans-serif";
      if (u1 - u0 > context.measureText(run.mode).width + 8) {
        context.fillStyle = run.mode === "SCAN" ? "#ffffff" : "#10161d";
        context.textAlign = "left";
        context.fillText(run.mode, u0 + 4, BAND.top + BAND.height / 2 + 0.5);
      }
    }
    context.font = "11px system-ui, sans-serif";
  }

  private drawAltitude(context: CanvasRenderingContext2D, highest: number, line: string): void {
    const { store } = this;
    const bottom = CHART.top + CHART.height;
    context.fillStyle = line;
    context.fillRect(LEFT, bottom, this.width, 1);
    const outline = new Path2D();
    let last = -Infinity;
    for (let row = 0; row < store.states.length; row++) {
      const u = this.u(store.time(row));
      if (u - last < 0.7 && row + 1 < store.states.length) continue;
      last = u;
      const [x, y, z] = store.position(row);
      outline.lineTo(u, bottom - (Math.max(z - store.groundAt(x, y), 0) / highest) * CHART.height);
    }
    const filled = new Path2D(outline);
    filled.lineTo(last, bottom);
    filled.lineTo(this.u(store.time(0)), bottom);
    context.fillStyle = this.dark ? "#56b4e940" : "#0072b230";
    context.fill(filled);
    context.strokeStyle = this.dark ? "#7cc4ee" : "#0072b2";
    context.lineWidth = 1.5;
    context.stroke(outline);
  }

  private drawBattery(context: CanvasRenderingContext2D, ink: string): void {
    const { store } = this;
    context.beginPath();
    let last = -Infinity;
    for (let row = 0; row < store.states.length; row++) {
      const u = this.u(store.time(row));
      if (Number.isNaN(store.battery(row)) || u - last < 2) continue;
      last = u;
      context.lineTo(u, CHART.top + (1 - store.battery(row)) * CHART.height);
    }
    context.setLineDash([4, 3]);
    context.strokeStyle = ink;
    context.lineWidth = 1.2;
    context.stroke();
    context.setLineDash([]);
  }

  private drawDetections(context: CanvasRenderingContext2D, muted: string): void {
    const { detections } = this.store;
    context.fillStyle = muted;
    const seconds = this.store.end_s / this.width;
    let start = 0;
    for (let column = 0; column < this.width; column++) {
      const end = detections.count((column + 1) * seconds);
      let most = 0;
      for (; start < end; start++) most = Math.max(most, detections.items[start]!);
      const tall = Math.min(most, 4) * (TICKS.height / 4);
      if (most) context.fillRect(LEFT + column, TICKS.top + TICKS.height - tall, 1.2, tall);
    }
  }

  private drawMarks(context: CanvasRenderingContext2D): void {
    const middle = MARKS.top + MARKS.height / 2;
    for (const event of this.store.events.items) {
      if (event.tone === "muted") continue;
      const u = this.u(event.t);
      context.beginPath();
      if (event.tone === "good") context.arc(u, middle, 4.5, 0, 2 * Math.PI);
      else if (event.tone === "danger" || event.tone === "warning") {
        context.moveTo(u, middle - 6);
        context.lineTo(u + 6, middle + 5);
        context.lineTo(u - 6, middle + 5);
      } else if (event.tone === "operator") context.rect(u - 4.5, middle - 4.5, 9, 9);
      else context.rect(u - 1, middle - 5, 2, 10);
      context.fillStyle = TONE_COLOURS[event.tone];
      context.fill();
    }
  }
}
