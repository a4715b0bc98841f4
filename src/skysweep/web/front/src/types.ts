/** What the server says: JSON as it comes. Places are ENU metres, times seconds of the mission. */

export type XY = [number, number];
export type XYZ = [number, number, number];

export const MODES = ["TAKEOFF", "TRANSIT", "SCAN", "CHECK", "LOOK", "HOLD", "RETURN", "LAND", "SWAP"] as const;
export type Mode = (typeof MODES)[number];

export interface SceneObject {
  kind: string;
  shape?: string;
  position_enu_m: XYZ;
  size_m: XYZ;
  yaw_rad: number;
}

export interface Scene {
  name: string;
  scenario: string;
  strategy: string;
  sensor: string;
  seed: number;
  version: string;
  simulated: boolean;
  /** Its vehicle or a part of it is not simulated with it: somebody else may fly it. */
  external: boolean;
  live: boolean;
  controls: boolean;
  origin: { latitude_deg: number; longitude_deg: number; altitude_amsl_m: number };
  bounds_enu_m: [number, number, number, number];
  area_enu_m: XY[];
  holes_enu_m: XY[][];
  no_fly_enu_m: XY[][];
  geofence_enu_m: XY[] | null;
  altitude_max_agl_m: number;
  home_enu_m: XY;
  camera: {
    width_px: number;
    height_px: number;
    fx_px: number;
    fy_px: number;
    cx_px: number;
    cy_px: number;
    rate_hz: number;
  };
  search: {
    scan_altitude_agl_m: number;
    check_altitude_agl_m: number;
    c_t: number;
    n_c: number | string | null;
    d_c_m: number | string | null;
  };
  battery_capacity_wh: number;
  batteries: number;
  classes: string[];
  ground: { picture: string | null; heights: string; tiles: string | null };
  objects: SceneObject[];
  targets?: Target[];
  coverage: Grid | null;
}

/** The truth, of a simulated mission that has ended. */
export interface Target {
  class_name: string;
  position_enu_m: XYZ; // at time 0
  /** Time, east and north of one that moves; straight in between. */
  way?: XYZ[];
}

export interface Grid {
  bounds_enu_m: [number, number, number, number];
  rows: number;
  columns: number;
}

export interface Heights extends Grid {
  heights_m: number[];
}

/** A line of the journal; which fields it has depends on its kind. */
export interface Line {
  t: number;
  kind: string;
  config?: string;
  utc?: string;
  p?: number[];
  v?: number[];
  mode?: string;
  battery?: number | null;
  energy_wh?: number | null;
  cam?: { p: number[]; R: number[] };
  boxes_xyxy_px?: number[][];
  confidences?: number[];
  class_names?: string[];
  failure?: string;
  doubt?: unknown;
  candidate?: number;
  class_name?: string;
  new?: boolean;
  confidence?: number;
  altitude_agl_m?: number;
  covariance_m2?: number[][];
  probability?: number;
  reason?: string;
  alternatives?: [string, number][];
  by?: string;
  word?: string;
  cause?: string;
  action?: string;
  sentence?: string;
  holder?: string;
  waypoints_enu_m?: number[][];
  number?: number;
  why?: string;
  length_m?: number;
  again?: boolean;
}

export interface Entry {
  id: string;
  kind: "run" | "sweep" | "comparison" | "tuning" | "benchmark";
  name: string;
  scenario: string | null;
  strategy: string | null;
  seed: number | null;
  sensor: string | null;
  state: string | null;
  modified_unix_s: number;
  figures: { label: string; value: string }[];
  thumbnail: string | null;
  report: string | null;
  error: string | null;
}

export interface Folder {
  name: string;
  live: string | null;
  entries: Entry[];
}

export type Message =
  | { type: "lines"; from: number; lines: Line[] }
  | { type: "coverage"; t: number; pod: string }
  | { type: "film"; times: string[] }
  | { type: "pictures"; of: Record<string, string> }
  | { type: "status"; flying: boolean; ended: boolean; error: string | null };

export type OrderWord = "hold" | "continue" | "return" | "confirm" | "reject" | "look" | "take back";
