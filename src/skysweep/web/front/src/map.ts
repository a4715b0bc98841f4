/** The map: MapLibre holds the base, the mission is drawn over it. */

import { Map as BaseMap, setWorkerUrl, type StyleSpecification } from "maplibre-gl";
import "maplibre-gl/dist/maplibre-gl.css";
import workerUrl from "maplibre-gl/dist/maplibre-gl-worker.mjs?url";
import { fitCanvas, h } from "./dom";
import { Overlay, type Layer, type PathColour, type Shown } from "./overlay";
import { Projection } from "./projection";
import type { Store } from "./store";
import type { XY } from "./types";

setWorkerUrl(workerUrl);

export interface MapEvents {
  /** The cursor is at a place. */
  pointed(place: XY): void;
  /** A click on a candidate; null: beside all of them. */
  selected(candidate: number | null): void;
  /** A click while a place is asked for. */
  placed(place: XY): void;
}

const NEAR_PX = 16; // of a click to a candidate
const PADDING_PX = { top: 56, bottom: 112, left: 32, right: 32 }; // free of what stands on the map

export class MissionMap {
  readonly projection: Projection;
  readonly shown: Shown;
  /** What a click does. */
  tool: "select" | "measure" | "place" = "select";
  private readonly base: BaseMap;
  private readonly canvas = h("canvas", { class: "overlay", "aria-hidden": "true" });
  private readonly overlay: Overlay;
  private t = 0;

  constructor(
    element: HTMLElement,
    private readonly store: Store,
    shown: Shown,
    private readonly events: MapEvents,
  ) {
    if (!document.createElement("canvas").getContext("webgl2")) {
      throw new Error("The map needs WebGL 2, which this browser does not have or has switched off.");
    }
    this.shown = shown;
    this.projection = new Projection(store.scene);
    this.overlay = new Overlay(store, this.projection);
    this.base = new BaseMap({
      container: element,
      style: this.style(),
      attributionControl: false,
      dragRotate: false,
      pitchWithRotate: false,
      touchPitch: false,
      maxPitch: 0,
      maxZoom: 24,
      fadeDuration: 0,
      bounds: this.bounds(),
      fitBoundsOptions: { padding: PADDING_PX },
      keyboard: false, // the page has keys of its own
    });
    this.base.touchZoomRotate.disableRotation();
    this.base.getCanvas().tabIndex = -1;
    element.append(this.canvas);
    this.base.on("move", () => this.redraw());
    this.base.on("resize", () => this.redraw());
    this.base.on("mousemove", ({ lngLat }) => events.pointed(this.projection.frame.enu(lngLat.lng, lngLat.lat)));
    this.base.on("click", (event) => this.clicked([event.lngLat.lng, event.lngLat.lat], [event.point.x, event.point.y]));
  }

  show(t: number): void {
    this.t = t;
    this.redraw();
  }

  /** Moves the map so that the vehicle stays in the middle. */
  follow(t: number): void {
    const state = this.store.stateAt(t);
    if (state) this.base.setCenter(this.projection.frame.lonLat(state.position_enu_m[0], state.position_enu_m[1]));
  }

  fit(): void {
    this.base.fitBounds(this.bounds(), { padding: PADDING_PX, duration: 0 });
  }

  zoom(steps: number): void {
    this.base.zoomTo(this.base.getZoom() + steps, { duration: 150 });
  }

  goTo(place: XY): void {
    this.base.easeTo({ center: this.projection.frame.lonLat(...place), duration: 300 });
  }

  resize(): void {
    this.base.resize();
    this.redraw();
  }

  setLayer(layer: Layer, on: boolean): void {
    this.shown.layers[layer] = on;
    if (layer === "picture" && this.base.getLayer("picture")) {
      this.base.setLayoutProperty("picture", "visibility", on ? "visible" : "none");
    }
    this.redraw();
  }

  setColour(colour: PathColour): void {
    this.shown.colour = colour;
    this.redraw();
  }

  setCursor(cursor: string): void {
    this.base.getCanvas().style.cursor = cursor;
  }

  /** Width of a metre in the middle of the map, in px. */
  pxOfMetre(): number {
    return this.projection.pxOfMetre(...this.middle());
  }

  private middle(): XY {
    const { lng, lat } = this.base.getCenter();
    return this.projection.frame.enu(lng, lat);
  }

  redraw(): void {
    const context = fitCanvas(this.canvas);
    const { lng, lat } = this.base.getCenter();
    const [width, height] = [this.canvas.clientWidth, this.canvas.clientHeight];
    this.projection.view(lng, lat, this.base.getZoom(), width, height);
    this.overlay.draw(context, width, height, this.t, this.shown);
  }

  private bounds(): [number, number, number, number] {
    const places = [...this.store.scene.area_enu_m, this.store.scene.home_enu_m];
    const corners = places.map(([x, y]) => this.projection.frame.lonLat(x, y));
    const [lons, lats] = [corners.map((c) => c[0]), corners.map((c) => c[1])];
    return [Math.min(...lons), Math.min(...lats), Math.max(...lons), Math.max(...lats)];
  }

  private style(): StyleSpecification {
    const { ground, bounds_enu_m } = this.store.scene;
    const [west, south, east, north] = bounds_enu_m;
    const corner = (x: number, y: number) => this.projection.frame.lonLat(x, y);
    const style: StyleSpecification = {
      version: 8,
      sources: {},
      layers: [],
    };
    if (ground.tiles) {
      style.sources.tiles = { type: "raster", tiles: [ground.tiles], tileSize: 256, maxzoom: 19 };
      style.layers.push({ id: "tiles", type: "raster", source: "tiles" });
    }
    if (ground.picture) {
      style.sources.picture = {
        type: "image",
        url: new URL(ground.picture, location.href).href,
        coordinates: [corner(west, north), corner(east, north), corner(east, south), corner(west, south)],
      };
      style.layers.push({
        id: "picture",
        type: "raster",
        source: "picture",
        layout: { visibility: this.shown.layers.picture ? "visible" : "none" },
      });
    }
    return style;
  }

  private clicked(lonLat: XY, point: XY): void {
    const place = this.projection.frame.enu(...lonLat);
    this.events.pointed(place);
    if (this.tool === "measure") {
      this.shown.measured.push(place);
      this.redraw();
    } else if (this.tool === "place") this.events.placed(place);
    else this.events.selected(this.candidateNear(point));
  }

  private candidateNear(point: XY): number | null {
    let nearest: number | null = null;
    let least = NEAR_PX;
    for (const candidate of this.store.candidatesAt(this.t)) {
      const [u, v] = this.projection.px(candidate.position_enu_m[0]!, candidate.position_enu_m[1]!);
      const distance = Math.hypot(u - point[0], v - point[1]);
      if (distance < least) [least, nearest] = [distance, candidate.id];
    }
    return nearest;
  }
}
