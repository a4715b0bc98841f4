/** Colours with a meaning: the same on map, timeline and lists, in light and dark, and safe for the colour-blind. */

import type { EventTone } from "./events";
import type { Status } from "./store";
import type { Mode } from "./types";

// Okabe and Ito's palette (https://jfly.uni-koeln.de/color/), as in the reports.
export const MODE_COLOURS: Record<Mode, string> = {
  TAKEOFF: "#8a949e",
  TRANSIT: "#56b4e9",
  SCAN: "#0072b2",
  CHECK: "#e69f00",
  LOOK: "#cc79a7",
  HOLD: "#cc79a7",
  RETURN: "#56b4e9",
  LAND: "#8a949e",
  SWAP: "#8a949e",
};

export const STATUS_COLOURS: Record<Status, string> = {
  seen: "#e69f00",
  scanned: "#e69f00",
  confirmed: "#009e73",
  rejected: "#808080",
  unchecked: "#d55e00",
};

export const TONE_COLOURS: Record<EventTone, string> = {
  plain: "#0072b2",
  good: "#009e73",
  muted: "#808080",
  warning: "#e69f00",
  danger: "#d55e00",
  operator: "#cc79a7",
};

// Matplotlib's viridis from 0 to 0.87, darkest when low: the altitudes of the reports' maps.
const ALTITUDES = ["#440154", "#482576", "#414487", "#35608d", "#2a788e", "#21908d", "#22a884", "#43bf71", "#7ad151", "#aadc32"];

export const ALTITUDE_STEPS = ALTITUDES.length;

/** The step of an altitude in the scale from the ground to the highest. */
export function altitudeStep(altitude_m: number, highest_m: number): number {
  const share = highest_m > 0 ? altitude_m / highest_m : 0;
  return Math.min(Math.max(Math.floor(share * ALTITUDE_STEPS), 0), ALTITUDE_STEPS - 1);
}

export function altitudeColour(step: number): string {
  return ALTITUDES[step]!;
}

/** Red, green, blue and opacity (0..255) of a probability of detection (0..255). */
export function podColour(pod: number): [number, number, number, number] {
  const share = pod / 255;
  return [Math.round(150 - 110 * share), Math.round(225 - 60 * share), Math.round(245 - 25 * share), pod ? Math.round(25 + 85 * share) : 0];
}
