/** What stands on the map: zoom, layers, measuring, the cursor's coordinates, scale and legend. */

import { ALTITUDE_STEPS, MODE_COLOURS, altitudeColour } from "./colours";
import { h, setText, toggle } from "./dom";
import { NOTATIONS, written, type Notation } from "./geo";
import type { MissionMap } from "./map";
import { LAYERS, type Layer, type PathColour } from "./overlay";
import { MODES, type Scene, type XY } from "./types";
import { metres } from "./words";

const NAMES: Record<Notation, [string, string]> = {
  local: ["Local", "E"],
  latlon: ["Lat, lon", "L"],
  utm: ["UTM", "U"],
  mgrs: ["MGRS", "M"],
};
const SCALES_M = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10000];
const WIDEST_PX = 110;

export class MapTools {
  readonly element: HTMLElement;
  readonly coordinates: HTMLElement;
  readonly legend: HTMLElement;
  private readonly values = new Map<Notation, HTMLElement>();
  private readonly buttons = new Map<Notation, HTMLElement>();
  private readonly measure: HTMLButtonElement;
  private readonly follow: HTMLButtonElement;
  private readonly scale = h("span", { class: "scale" });
  private readonly ramp = h("span", { class: "ramp" });

  constructor(
    private readonly map: MissionMap,
    private readonly scene: Scene,
    private readonly told: { follows(on: boolean): void; coloured(colour: PathColour): void },
  ) {
    this.measure = toggle("Measure", "Measure a distance (R)", false, (on) => this.setMeasuring(on));
    this.follow = toggle("Follow", "Keep the vehicle in the middle (C)", false, (on) => told.follows(on));
    this.element = h(
      "div",
      { class: "tools" },
      h("button", { type: "button", "aria-label": "Zoom in", onclick: () => map.zoom(1) }, "+"),
      h("button", { type: "button", "aria-label": "Zoom out", onclick: () => map.zoom(-1) }, "−"),
      h("button", { type: "button", title: "Whole area in view (F)", onclick: () => map.fit() }, "Fit"),
      this.follow,
      this.measure,
      this.layers(),
    );
    this.coordinates = h("div", { class: "coordinates", role: "group", "aria-label": "Place under the cursor" });
    for (const notation of NOTATIONS) {
      const [name, key] = NAMES[notation];
      const value = h("span", { class: "value" }, "–");
      const button = h("button", { type: "button", title: `Copy (${key})` }, h("span", { class: "name" }, name), value);
      this.values.set(notation, value);
      this.buttons.set(notation, button);
      this.coordinates.append(button);
    }
    const pod = h("span", { class: "swatch" }, "POD 0", h("span", { class: "pod" }), "1");
    this.legend = h("div", { class: "legend" }, this.scale, this.ramp, scene.coverage && pod);
    this.drawLegend("mode");
  }

  copied(notation: Notation, copy: () => void): void {
    this.buttons.get(notation)!.addEventListener("click", copy);
  }

  point(place: XY): void {
    for (const [notation, value] of this.values) setText(value, written(this.map.projection.frame, ...place, notation));
  }

  /** Draws the scale: a round length of the map's middle. */
  show(): void {
    const metre_px = this.map.pxOfMetre();
    const length_m = [...SCALES_M].reverse().find((m) => m * metre_px <= WIDEST_PX) ?? 1;
    this.scale.style.width = `${(length_m * metre_px).toFixed(0)}px`;
    setText(this.scale, metres(length_m).replace(".0", ""));
  }

  setMeasuring(on: boolean): void {
    this.measure.setAttribute("aria-pressed", String(on));
    this.map.tool = on ? "measure" : "select";
    this.map.shown.measured.length = 0;
    this.map.setCursor(on ? "crosshair" : "");
    this.map.redraw();
  }

  toggleFollow(): void {
    this.follow.click();
  }

  private layers(): HTMLElement {
    const boxes = (Object.keys(LAYERS) as Layer[])
      .filter((layer) => layer !== "truth" || (this.scene.targets ?? []).length > 0)
      .filter((layer) => layer !== "picture" || this.scene.ground.picture)
      .map((layer) => {
        const box = h("input", { type: "checkbox" });
        box.checked = this.map.shown.layers[layer];
        box.addEventListener("change", () => this.map.setLayer(layer, box.checked));
        return h("label", {}, box, LAYERS[layer]);
      });
    const colours = (["mode", "altitude"] as PathColour[]).map((colour) => {
      const radio = h("input", { type: "radio", name: "path-colour", value: colour });
      radio.checked = colour === this.map.shown.colour;
      radio.addEventListener("change", () => {
        this.map.setColour(colour);
        this.told.coloured(colour);
        this.drawLegend(colour);
      });
      return h("label", {}, radio, `by ${colour}`);
    });
    return h(
      "details",
      { class: "layers" },
      h("summary", {}, "Layers"),
      h("div", { class: "popover" }, ...boxes, h("fieldset", {}, h("legend", {}, "Flown path coloured"), ...colours)),
    );
  }

  private drawLegend(colour: PathColour): void {
    const swatch = (background: string, text: string) =>
      h("span", { class: "swatch" }, h("i", { style: `background:${background}` }), text);
    if (colour === "mode") {
      const unnamed = ["LAND", "LOOK", "SWAP", "TRANSIT"]; // in the colour of another one
      const modes = MODES.filter((mode) => !unnamed.includes(mode));
      const words: Partial<Record<string, string>> = { TAKEOFF: "TAKEOFF, LAND", HOLD: "HOLD, LOOK", RETURN: this.scene.batteries > 1 ? "RETURN, TRANSIT" : "RETURN" };
      this.ramp.replaceChildren(...modes.map((mode) => swatch(MODE_COLOURS[mode], words[mode] ?? mode)));
      return;
    }
    const steps = Array.from({ length: ALTITUDE_STEPS }, (_, k) => h("i", { style: `background:${altitudeColour(k)}` }));
    const highest = metres(1.1 * this.scene.search.scan_altitude_agl_m);
    this.ramp.replaceChildren(h("span", { class: "swatch" }, "0 m"), h("span", { class: "steps" }, ...steps), h("span", { class: "swatch" }, highest));
  }
}
