/** The 3-D view. Loaded lazily, so that three.js costs only the pages that show it. */

import type { Store } from "./store";

/** What the colour of the flown path says. */
export type PathColour = "mode" | "altitude";

/**
 * Terrain, paths, vehicle and candidates of one mission, in ENU metres, drawn when something changed.
 *
 * Of the store it reads `scene` (the server's answer, as it is) and `lines` (all journal lines so far, in order;
 * the array grows while a mission is live).
 */
export class Scene3D {
  constructor(_element: HTMLElement, _store: Pick<Store, "scene" | "lines">) {}

  /** Shows mission time `t` (s). */
  show(_t: number): void {}

  colourBy(_what: PathColour): void {}

  /** To be called when the element's size has changed. */
  resize(): void {}

  setTheme(_dark: boolean): void {}

  dispose(): void {}
}
