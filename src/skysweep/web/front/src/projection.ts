/** Local metres on the screen: north is up, so a shift and a scale of Web Mercator is all there is. */

import { LocalFrame } from "./geo";
import type { Scene, XY } from "./types";

const TILE_PX = 512; // of the whole world at zoom 0

export class Projection {
  readonly frame: LocalFrame;
  private readonly home: XY;
  private scale = 1;
  private left = 0;
  private top = 0;

  constructor(scene: Scene) {
    this.frame = new LocalFrame(scene.origin);
    this.home = mercator(...this.frame.lonLat(0, 0));
  }

  /** Takes the view: its centre and zoom, and its size in px. */
  view(lon_deg: number, lat_deg: number, zoom: number, width: number, height: number): void {
    const [x, y] = mercator(lon_deg, lat_deg);
    this.scale = TILE_PX * 2 ** zoom;
    this.left = width / 2 - (x - this.home[0]) * this.scale;
    this.top = height / 2 - (y - this.home[1]) * this.scale;
  }

  /** Mercator from home: what stays the same while the view moves. */
  flat(x: number, y: number): XY {
    const [u, v] = mercator(...this.frame.lonLat(x, y));
    return [u - this.home[0], v - this.home[1]];
  }

  /** Pixels of a flat place. */
  ofFlat(u: number, v: number): XY {
    return [this.left + u * this.scale, this.top + v * this.scale];
  }

  px(x: number, y: number): XY {
    return this.ofFlat(...this.flat(x, y));
  }

  /** Pixels of a metre around a place. */
  pxOfMetre(x: number, y: number): number {
    const [a] = this.px(x, y);
    const [b] = this.px(x + 10, y);
    return (b - a) / 10;
  }
}

function mercator(lon_deg: number, lat_deg: number): XY {
  const lat = (lat_deg * Math.PI) / 180;
  return [(lon_deg + 180) / 360, 0.5 - Math.log(Math.tan(Math.PI / 4 + lat / 2)) / (2 * Math.PI)];
}
