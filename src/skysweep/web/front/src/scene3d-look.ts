/** Colours of the 3-D view. Those with a meaning are the map's. */

import { Color } from "three";

import { altitudeColour, altitudeStep, MODE_COLOURS, STATUS_COLOURS } from "./colours";

const LIGHT = {
  sky: "#e9eef2",
  ink: "#10161d",
  ground: "#b4bfa8",
  block: "#8d8577",
};
const DARK: typeof LIGHT = { sky: "#12181f", ink: "#eaf0f5", ground: "#5b6654", block: "#3a3833" };
const ALWAYS = {
  area: "#ffffff",
  noFly: "#d55e00",
  fence: "#f0a020",
  planned: "#ffffff",
  camera: "#ffe14d",
  body: "#20262d",
  trunk: "#6b5138",
  conifer: "#3f6b46",
  broadleaf: "#5d8a4a",
  wall: "#c9beb0",
  roof: "#9a5b48",
};

export const INK = "#10161d"; // of words, which have a white halo

export type Palette = Record<keyof typeof LIGHT | keyof typeof ALWAYS, Color>;

export function palette(dark: boolean): Palette {
  return coloured({ ...(dark ? DARK : LIGHT), ...ALWAYS });
}

export const MODES = coloured(MODE_COLOURS);
export const STATUSES = coloured(STATUS_COLOURS);

/** The colour of an altitude, on the map's scale from the ground to the altitude of SCAN. */
export function colourOfAltitude(altitude_m: number, scan_m: number): Color {
  return new Color(altitudeColour(altitudeStep(altitude_m, 1.1 * scan_m)));
}

function coloured<K extends string>(hexes: Record<K, string>): Record<K, Color> {
  const entries = Object.entries<string>(hexes).map(([name, hex]) => [name, new Color(hex)]);
  return Object.fromEntries(entries) as Record<K, Color>;
}
