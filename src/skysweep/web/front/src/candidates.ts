/** The candidates: crop, status, history of confidences, reasons; and the operator's verdicts. */

import { runPath } from "./api";
import { STATUS_COLOURS } from "./colours";
import { fitCanvas, h, setText } from "./dom";
import { drawStatus } from "./overlay";
import type { CandidateAt, Store } from "./store";
import { clockTime } from "./words";

const CROP_PX = 72; // of its side on the page
const MARK_PX = 20;
const CHART = { width: 84, height: 56 };
const LEAST_PX = 28; // of the camera's picture in a crop

export interface CandidateEvents {
  selected(id: number): void;
  verdict(id: number, word: "confirm" | "reject"): void;
}

interface Row {
  element: HTMLElement;
  crop: HTMLElement;
  mark: HTMLCanvasElement;
  title: HTMLElement;
  facts: HTMLElement;
  reason: HTMLElement;
  chart: HTMLCanvasElement;
  drawn: string;
  isInSight: boolean;
}

export class CandidateList {
  readonly element = h("ol", { class: "candidates", "aria-label": "Candidates" });
  private readonly rows = new Map<number, Row>();
  private readonly empty = h("p", { class: "empty" }, "No candidate yet.");
  private theme = "";
  private readonly sight = new IntersectionObserver((seen) => {
    for (const { target, isIntersecting } of seen) {
      const row = this.rows.get(Number((target as HTMLElement).dataset.candidate));
      if (row) row.isInSight = isIntersecting;
    }
    this.redraw();
  });
  private redraw = () => {};

  constructor(
    private readonly id: string,
    private readonly store: Store,
    private readonly mayOrder: boolean,
    private readonly events: CandidateEvents,
  ) {}

  get node(): HTMLElement {
    return h("div", { class: "scroll", tabindex: 0 }, this.empty, this.element);
  }

  setTheme(dark: boolean): void {
    this.theme = String(dark);
  }

  show(t: number, candidates: readonly CandidateAt[], selected: number | null): void {
    this.redraw = () => this.show(t, candidates, selected);
    this.empty.hidden = candidates.length > 0;
    const known = new Set<number>();
    for (const candidate of candidates) {
      known.add(candidate.id);
      const row = this.rows.get(candidate.id) ?? this.add(candidate);
      if (row.isInSight) this.update(row, candidate, t, candidate.id === selected);
    }
    for (const [id, row] of this.rows) row.element.hidden = !known.has(id);
  }

  reveal(id: number): void {
    this.rows.get(id)?.element.scrollIntoView({ block: "nearest" });
  }

  private add(candidate: CandidateAt): Row {
    const crop = h("div", { class: "crop" });
    const mark = h("canvas", { class: "mark", "aria-hidden": "true" });
    const title = h("span", { class: "name" });
    const facts = h("p", { class: "facts", title: "Sightings, newest confidence, probability that it is a target" });
    const reason = h("p", { class: "reason" });
    const chart = h("canvas", { class: "history", role: "img", "aria-label": "Confidences over time" });
    const verdicts = this.mayOrder
      ? (["confirm", "reject"] as const).map((word) =>
          h("button", { type: "button", onclick: () => this.events.verdict(candidate.id, word) }, word === "confirm" ? "Confirm" : "Reject"),
        )
      : [];
    const select = h(
      "button",
      { type: "button", class: "select", onclick: () => this.events.selected(candidate.id) },
      mark,
      title,
    );
    const element = h(
      "li",
      { "data-candidate": candidate.id },
      crop,
      h("div", { class: "what" }, select, facts, reason, verdicts.length ? h("div", { class: "verdicts" }, ...verdicts) : null),
      chart,
    );
    const row = { element, crop, mark, title, facts, reason, chart, drawn: "", isInSight: false };
    this.rows.set(candidate.id, row);
    this.sight.observe(element);
    this.element.append(element);
    return row;
  }

  private update(row: Row, candidate: CandidateAt, t: number, selected: boolean): void {
    const picture = this.store.pictures[candidate.id];
    const key = [candidate.status, candidate.by_operator, candidate.looks, candidate.probability, candidate.reason, selected,
      picture, this.store.film.length, this.theme].join("|");
    if (key === row.drawn) return;
    row.drawn = key;
    row.element.classList.toggle("selected", selected);
    setText(row.title, `${candidate.id}  ${candidate.class_name || "candidate"}, ${candidate.status}${candidate.by_operator ? " by the operator" : ""}`);
    const facts = [`${candidate.looks} ${candidate.looks === 1 ? "look" : "looks"}`];
    if (candidate.confidence !== null) facts.push(`confidence ${candidate.confidence.toFixed(2)}`);
    if (candidate.probability !== null) facts.push(`P ${candidate.probability.toFixed(2)}`);
    setText(row.facts, facts.join(", "));
    setText(row.reason, candidate.reason ?? `first seen at ${clockTime(candidate.first_s)}`);
    const costs = candidate.alternatives.map(([what, cost_s]) => `${what}: ${cost_s.toFixed(0)} s`).join("; ");
    row.reason.title = costs ? `Expected cost: ${costs}` : "";
    const mark = fitCanvas(row.mark, MARK_PX, MARK_PX);
    mark.clearRect(0, 0, MARK_PX, MARK_PX);
    drawStatus(mark, candidate.status, MARK_PX / 2, MARK_PX / 2);
    this.drawChart(row.chart, candidate, t);
    this.showCrop(row.crop, candidate.id, t);
  }

  private showCrop(element: HTMLElement, id: number, t: number): void {
    const crop = this.store.cropOf(id, t);
    const kept = this.store.pictures[id];
    const file = crop?.film ? `film/${crop.film}.jpg` : crop && kept ? `pictures/${encodeURIComponent(kept)}` : null;
    if (!crop || !file || element.dataset.file === file) return;
    element.dataset.file = file;
    const { width_px, height_px } = this.store.scene.camera;
    const [x0 = 0, y0 = 0, x1 = 0, y1 = 0] = crop.box_xyxy_px;
    const side = Math.min(Math.max(2.2 * Math.max(x1 - x0, y1 - y0), LEAST_PX), height_px, width_px);
    const start = (middle: number, most: number) => Math.min(Math.max(middle - side / 2, 0), most - side);
    const zoom = CROP_PX / side;
    element.style.backgroundImage = `url("${runPath(this.id)}/${file}")`;
    element.style.backgroundSize = `${width_px * zoom}px auto`;
    element.style.backgroundPosition = `${-start((x0 + x1) / 2, width_px) * zoom}px ${-start((y0 + y1) / 2, height_px) * zoom}px`;
  }

  private drawChart(canvas: HTMLCanvasElement, candidate: CandidateAt, t: number): void {
    const { width, height } = CHART;
    const context = fitCanvas(canvas, width, height);
    const style = getComputedStyle(document.documentElement);
    context.clearRect(0, 0, width, height);
    const points = this.store.confidencesOf(candidate.id, t);
    const v = (confidence: number) => 3 + (1 - confidence) * (height - 6);
    context.strokeStyle = style.getPropertyValue("--line");
    context.lineWidth = 1;
    for (const edge of [0, 1]) {
      context.beginPath();
      context.moveTo(0, v(edge));
      context.lineTo(width, v(edge));
      context.stroke();
    }
    context.setLineDash([3, 3]);
    context.strokeStyle = style.getPropertyValue("--muted");
    context.beginPath();
    context.moveTo(0, v(this.store.scene.search.c_t));
    context.lineTo(width, v(this.store.scene.search.c_t));
    context.stroke();
    context.setLineDash([]);
    const first = points[0]?.[0] ?? 0;
    const span = Math.max((points[points.length - 1]?.[0] ?? 0) - first, 1);
    context.strokeStyle = context.fillStyle = STATUS_COLOURS[candidate.status];
    context.lineWidth = 1.5;
    context.beginPath();
    const places = points.map(([time, confidence]) => [3 + ((time - first) / span) * (width - 6), v(confidence)] as const);
    for (const [u, w] of places) context.lineTo(u, w);
    context.stroke();
    for (const [u, w] of places) context.fillRect(u - 1.5, w - 1.5, 3, 3);
  }
}
