/** The detector's picture with its boxes. */

import { fitCanvas, h, setText } from "./dom";
import { runPath } from "./api";
import type { Look, Store } from "./store";
import { clockTime } from "./words";

const BOX = "#ffd23f";
const STALE_S = 1.5; // without a look: its boxes are of the past

export class CameraPanel {
  readonly element: HTMLElement;
  private readonly canvas = h("canvas", { role: "img", "aria-label": "The camera's picture with the detector's boxes" });
  private readonly words = h("p", { class: "caption" });
  private picture: HTMLImageElement | null = null;
  private wanted: string | null = null;
  private loading = false;
  private drawn = "";

  constructor(
    private readonly id: string,
    private readonly store: Store,
  ) {
    const { width_px, height_px } = store.scene.camera;
    this.canvas.style.aspectRatio = `${width_px} / ${height_px}`;
    this.canvas.hidden = !this.hasPictures;
    this.element = h("section", { class: "camera", "aria-label": "Camera" }, this.canvas, this.words);
  }

  private get hasPictures(): boolean {
    return this.store.scene.sensor !== "statistical";
  }

  show(t: number): void {
    if (!this.hasPictures) {
      setText(this.words, "The statistical sensor makes no pictures.");
      return;
    }
    const name = this.store.film.at(t) ?? null;
    this.want(name);
    const shown = this.picture?.dataset.name ?? null;
    const newest = this.store.looks.at(t);
    const look = shown ? this.store.looks.at(Number(shown) + 1e-4) : newest && t - newest.t < STALE_S ? newest : undefined;
    const key = `${shown} ${look?.t} ${this.canvas.clientWidth} ${newest?.failure}`;
    if (key === this.drawn) return;
    this.drawn = key;
    this.draw(look);
    const boxes = look && `${look.confidences.length || "no"} ${look.confidences.length === 1 ? "box" : "boxes"}`;
    const parts = [look ? `Look at ${clockTime(look.t)}: ${boxes}` : "No look now"];
    if (!shown) parts.push(this.store.film.length ? "no picture yet" : "no pictures were kept");
    if (newest?.failure) parts.push(`the newest look failed: ${newest.failure}`);
    setText(this.words, parts.join("; "));
  }

  /** Loads the newest wanted picture; those wanted meanwhile are skipped. */
  private want(name: string | null): void {
    this.wanted = name;
    if (this.loading) return;
    if (name === null) this.picture = null;
    if (name === null || this.picture?.dataset.name === name) return;
    this.loading = true;
    const picture = new Image();
    picture.dataset.name = name;
    picture.src = `${runPath(this.id)}/film/${encodeURIComponent(name)}.jpg`;
    const done = () => {
      this.loading = false;
      this.picture = picture;
      if (this.wanted !== name) this.want(this.wanted);
      this.drawn = "";
    };
    picture.decode().then(done, done);
  }

  private draw(look: Look | undefined): void {
    const context = fitCanvas(this.canvas);
    const [width, height] = [this.canvas.clientWidth, this.canvas.clientHeight];
    context.fillStyle = "#20262d";
    context.fillRect(0, 0, width, height);
    if (this.picture?.complete && this.picture.naturalWidth) context.drawImage(this.picture, 0, 0, width, height);
    const scale = width / this.store.scene.camera.width_px;
    look?.boxes_xyxy_px.forEach(([x0 = 0, y0 = 0, x1 = 0, y1 = 0], k) => {
      context.strokeStyle = "#10161d";
      context.lineWidth = 4;
      context.strokeRect(x0 * scale, y0 * scale, (x1 - x0) * scale, (y1 - y0) * scale);
      context.strokeStyle = BOX;
      context.lineWidth = 2;
      context.strokeRect(x0 * scale, y0 * scale, (x1 - x0) * scale, (y1 - y0) * scale);
      const text = `${look.class_names[k] ?? ""} ${(look.confidences[k] ?? 0).toFixed(2)}`;
      context.font = "600 11px system-ui, sans-serif";
      const wide = context.measureText(text).width + 8;
      const u = Math.min(Math.max(x0 * scale, 0), width - wide);
      const v = y0 * scale > 18 ? y0 * scale - 17 : y1 * scale + 1;
      context.fillStyle = BOX;
      context.fillRect(u, v, wide, 16);
      context.fillStyle = "#10161d";
      context.textBaseline = "middle";
      context.fillText(text, u + 4, v + 8.5);
    });
  }
}
