/** A mission at any time t, from the lines of its journal. Pure: no page, no clock, no network. */

import { Rows, Series, countUpTo } from "./series";
import { eventOf, type MissionEvent } from "./events";
import { MODES, type Heights, type Line, type Mode, type Scene, type XYZ } from "./types";

/** The vehicle's estimated state, interpolated between two lines. */
export interface StateAt {
  t: number;
  position_enu_m: XYZ;
  velocity_enu_mps: XYZ;
  mode: Mode;
  battery: number;
  energy_wh: number;
  camera_enu_m: XYZ;
  R_camera_to_enu: number[];
  /** Direction of the picture's top on the ground, a unit vector (east, north). */
  heading_en: [number, number];
}

export interface Look {
  t: number;
  boxes_xyxy_px: number[][];
  confidences: number[];
  class_names: string[];
  failure: string | null;
}

export type Status = "seen" | "scanned" | "confirmed" | "rejected" | "unchecked";

/** What is known of a candidate at one time. */
export interface CandidateAt {
  id: number;
  class_name: string;
  status: Status;
  by_operator: boolean;
  position_enu_m: number[];
  covariance_m2: number[][] | null;
  confidence: number | null;
  looks: number;
  probability: number | null;
  reason: string | null;
  alternatives: [string, number][];
  first_s: number;
}

export interface ModeRun {
  mode: Mode;
  from_s: number;
  to_s: number;
}

export interface Counts {
  candidates: number;
  open: number;
  confirmed: number;
  rejected: number;
  unchecked: number;
}

/** A sighting, and the box that it was made from. */
interface Sighting {
  line: Line;
  look: Look | null;
  box_xyxy_px: number[] | null;
}

/** The part of a picture that shows a candidate: of the film, by its name, or of the kept evidence. */
export interface Crop {
  film: string | null;
  box_xyxy_px: number[];
}

class Candidate {
  class_name = "";
  readonly sightings = new Series<Sighting>();
  readonly decisions = new Series<Line>();

  constructor(
    readonly id: number,
    readonly first_s: number,
  ) {}

  at(t: number): CandidateAt | null {
    const looks = this.sightings.count(t);
    const decided = this.decisions.count(t);
    if (looks + decided === 0) return null;
    const seen = this.sightings.items[looks - 1]?.line;
    const decision = this.decisions.items[decided - 1];
    const settled = this.settledBy(decided);
    const newest = decision && (!seen || decision.t >= seen.t || settled) ? decision : seen!;
    return {
      id: this.id,
      class_name: this.class_name,
      status: settled ? (settled.kind as Status) : decision ? "scanned" : "seen",
      by_operator: settled?.by === "operator",
      position_enu_m: newest.p ?? seen?.p ?? [0, 0, 0],
      covariance_m2: decision?.covariance_m2 ?? null,
      confidence: seen?.confidence ?? null,
      looks,
      probability: this.newest(decided, (d) => d.probability),
      reason: (settled ?? decision)?.reason ?? null,
      alternatives: (settled ?? decision)?.alternatives ?? [],
      first_s: this.first_s,
    };
  }

  private settledBy(decided: number): Line | undefined {
    for (let k = decided - 1; k >= 0; k--) {
      const line = this.decisions.items[k]!;
      if (SETTLING.has(line.kind)) return line;
    }
    return undefined;
  }

  private newest<T>(decided: number, of: (line: Line) => T | undefined): T | null {
    for (let k = decided - 1; k >= 0; k--) {
      const value = of(this.decisions.items[k]!);
      if (value !== undefined) return value;
    }
    return null;
  }
}

/** The box of a sighting among those of its look: journals hold its confidence with four digits. */
function sightingOf(line: Line, look: Look | null): Sighting {
  const k = look?.confidences.findIndex(
    (confidence, j) => Math.abs(confidence - (line.confidence ?? NaN)) < 1e-4 && look.class_names[j] === line.class_name,
  );
  return { line, look, box_xyxy_px: (k !== undefined && look?.boxes_xyxy_px[k]) || null };
}

const SETTLING = new Set(["confirmed", "rejected", "unchecked"]);
const DECISIONS = new Set([...SETTLING, "scanned", "reassessed", "misfit"]);
const HEAD_LINES = 5; // within which a journal tells of its mission
const RATE_WINDOW_S = 60; // of battery use, for the time left

// Columns of the states.
const T = 0, P = 1, V = 4, MODE = 7, BATTERY = 8, ENERGY = 9, CAMERA = 10, R = 13;
const STATE_WIDTH = 22;

export class Store {
  /** All lines so far, in the journal's order. */
  readonly lines: Line[] = [];
  /** Rises with everything that is added. */
  version = 0;
  /** Time of the newest line. */
  end_s = 0;
  heights: Heights | null = null;
  ended: string | null = null;
  /** Who else flies the vehicle, in the mission's words; null: nobody does. */
  holder: string | null = null;
  planned_enu_m: number[][] = [];
  readonly states = new Rows(STATE_WIDTH);
  readonly looks = new Series<Look>();
  /** How many things each look that found any has found; of a sensor without looks, the sightings. */
  readonly detections = new Series<number>();
  readonly events = new Series<MissionEvent>();
  readonly modes: ModeRun[] = [];
  readonly coverages = new Series<{ t: number; pod: Uint8Array }>();
  readonly film = new Series<string>();
  pictures: Record<string, string> = {};
  private readonly candidates = new Map<number, Candidate>();
  private readonly sorties_s: number[] = []; // when each but the first has taken off
  private readonly filmed = new Set<string>();
  private newestLook: Look | null = null;
  private times = new Float64Array(0);
  private timesOf = -1;

  constructor(readonly scene: Scene) {}

  /** What tells this mission from others: as the server's Feed.mission. */
  get mission(): string {
    const clock = this.lines.slice(0, HEAD_LINES).find((line) => line.kind === "clock");
    return `${this.lines[0]?.config ?? ""} ${clock?.utc ?? ""}`;
  }

  add(lines: readonly Line[]): void {
    for (const line of lines) {
      this.lines.push(line);
      this.end_s = Math.max(this.end_s, line.t);
      this.take(line);
    }
    this.version++;
  }

  addCoverage(t: number, pod: Uint8Array): void {
    if (this.coverages.at(t)?.t === t) return;
    this.coverages.add(t, { t, pod });
    this.version++;
  }

  /** Pictures of the film, by the names that are their times. */
  addFilm(times: readonly string[]): void {
    for (const name of times) {
      if (this.filmed.has(name)) continue;
      this.filmed.add(name);
      this.film.add(Number(name), name);
    }
    this.version++;
  }

  addPictures(of: Record<string, string>): void {
    Object.assign(this.pictures, of);
    this.version++;
  }

  private take(line: Line): void {
    switch (line.kind) {
      case "state":
        this.takeState(line);
        break;
      case "look":
        this.newestLook = {
          t: line.t,
          boxes_xyxy_px: line.boxes_xyxy_px ?? [],
          confidences: line.confidences ?? [],
          class_names: line.class_names ?? [],
          failure: line.failure ?? null,
        };
        this.looks.add(line.t, this.newestLook);
        if (line.confidences?.length) this.detections.add(line.t, line.confidences.length);
        break;
      case "plan":
        this.planned_enu_m = line.waypoints_enu_m ?? [];
        break;
      case "sighting":
        this.candidateOf(line)?.sightings.add(line.t, sightingOf(line, this.newestLook));
        if (!this.newestLook) this.detections.add(line.t, 1);
        break;
      case "next_sortie":
        this.sorties_s.push(line.t);
        break;
      case "safety":
        if (line.cause === "taken over") this.holder = line.holder ?? null;
        break;
      case "resumed":
        this.holder = null; // it is said again where it is still so
        break;
      case "end":
        this.ended = line.reason ?? "";
        this.holder = null;
        break;
      default:
        if (DECISIONS.has(line.kind)) this.candidateOf(line)?.decisions.add(line.t, line);
    }
    const event = eventOf(line);
    if (event) this.events.add(line.t, event);
  }

  private takeState(line: Line): void {
    const [p = [], v = [], cam] = [line.p, line.v, line.cam];
    const found = MODES.indexOf(line.mode as Mode);
    const mode = found < 0 ? MODES.indexOf("HOLD") : found;
    this.states.push([
      line.t, p[0]!, p[1]!, p[2]!, v[0] ?? 0, v[1] ?? 0, v[2] ?? 0, mode,
      line.battery ?? NaN, line.energy_wh ?? NaN, ...(cam?.p ?? p), ...(cam?.R ?? LEVEL),
    ]);
    const run = this.modes[this.modes.length - 1];
    if (run) run.to_s = line.t;
    if (run?.mode !== MODES[mode]) this.modes.push({ mode: MODES[mode]!, from_s: line.t, to_s: line.t });
  }

  private candidateOf(line: Line): Candidate | undefined {
    if (line.candidate === undefined) return undefined;
    let candidate = this.candidates.get(line.candidate);
    if (!candidate) this.candidates.set(line.candidate, (candidate = new Candidate(line.candidate, line.t)));
    candidate.class_name ||= line.class_name ?? "";
    return candidate;
  }

  /** How many states are at or before `t`. */
  countStates(t: number): number {
    if (this.timesOf !== this.states.length) {
      this.times = Float64Array.from({ length: this.states.length }, (_, k) => this.states.get(k, T));
      this.timesOf = this.states.length;
    }
    return countUpTo(this.times, this.times.length, t);
  }

  position(row: number): XYZ {
    return [this.states.get(row, P), this.states.get(row, P + 1), this.states.get(row, P + 2)];
  }

  mode(row: number): Mode {
    return MODES[this.states.get(row, MODE)]!;
  }

  time(row: number): number {
    return this.states.get(row, T);
  }

  battery(row: number): number {
    return this.states.get(row, BATTERY);
  }

  stateAt(t: number): StateAt | null {
    if (this.states.length === 0) return null;
    const before = Math.max(this.countStates(t) - 1, 0);
    const after = Math.min(before + 1, this.states.length - 1);
    const [t0, t1] = [this.time(before), this.time(after)];
    const share = t1 > t0 ? Math.min(Math.max((t - t0) / (t1 - t0), 0), 1) : 0;
    const mix = (column: number) => {
      const a = this.states.get(before, column);
      return a + share * (this.states.get(after, column) - a);
    };
    const mixed = (column: number): XYZ => [mix(column), mix(column + 1), mix(column + 2)];
    const [east, north] = [-mix(R + 3), mix(R)];
    const length = Math.hypot(east, north) || 1;
    return {
      t: t0 + share * (t1 - t0),
      position_enu_m: mixed(P),
      velocity_enu_mps: mixed(V),
      mode: this.mode(before),
      battery: mix(BATTERY),
      energy_wh: mix(ENERGY),
      camera_enu_m: mixed(CAMERA),
      R_camera_to_enu: Array.from({ length: 9 }, (_, k) => mix(R + k)),
      heading_en: [east / length, north / length],
    };
  }

  candidatesAt(t: number): CandidateAt[] {
    const known: CandidateAt[] = [];
    for (const candidate of this.candidates.values()) {
      const now = candidate.at(t);
      if (now) known.push(now);
    }
    return known;
  }

  /** The confidences (time, value) of a candidate's sightings until `t`. */
  confidencesOf(id: number, t: number): [number, number][] {
    const sightings = this.candidates.get(id)?.sightings;
    if (!sightings) return [];
    return sightings.items.slice(0, sightings.count(t)).map(({ line }) => [line.t, line.confidence ?? 0]);
  }

  /** The most confident sighting of a candidate until `t` that a picture shows; the film's pictures come first. */
  cropOf(id: number, t: number): Crop | null {
    const sightings = this.candidates.get(id)?.sightings;
    let best: { rank: number; crop: Crop } | null = null;
    for (let k = 0; k < (sightings?.count(t) ?? 0); k++) {
      const { line, look, box_xyxy_px } = sightings!.items[k]!;
      if (!look || !box_xyxy_px) continue;
      const name = look.t.toFixed(4);
      const film = this.filmed.has(name) ? name : null;
      const rank = (line.confidence ?? 0) + (film ? 1 : 0);
      const isEvidence = Math.abs(line.t - evidenceTime(this.pictures[id])) < 0.06;
      if ((film || isEvidence) && rank > (best?.rank ?? 0)) best = { rank, crop: { film, box_xyxy_px } };
    }
    return best?.crop ?? null;
  }

  countsAt(candidates: readonly CandidateAt[]): Counts {
    const of = (status: Status) => candidates.filter((c) => c.status === status).length;
    return {
      candidates: candidates.length,
      open: of("seen") + of("scanned"),
      confirmed: of("confirmed"),
      rejected: of("rejected"),
      unchecked: of("unchecked"),
    };
  }

  /** The number of the sortie that flies at `t`, from 1. */
  sortieAt(t: number): number {
    return 1 + countUpTo(this.sorties_s, this.sorties_s.length, t);
  }

  /** Seconds until the battery is empty at the rate of the last minute; null: it is not known. */
  timeLeft_s(t: number): number | null {
    const row = this.countStates(t) - 1;
    const since = Math.max(this.countStates(t - RATE_WINDOW_S) - 1, 0);
    if (row <= since) return null;
    const used = this.battery(since) - this.battery(row);
    if (!(used > 1e-6)) return null;
    return (this.battery(row) * (this.time(row) - this.time(since))) / used;
  }

  /** Height of the ground in m, 0 where it is not known. */
  groundAt(x: number, y: number): number {
    const grid = this.heights;
    if (!grid || grid.rows < 2 || grid.columns < 2) return 0;
    const [west, south, east, north] = grid.bounds_enu_m;
    const column = ((x - west) / (east - west)) * (grid.columns - 1);
    const row = ((y - south) / (north - south)) * (grid.rows - 1);
    const c = Math.min(Math.max(column, 0), grid.columns - 1.001);
    const r = Math.min(Math.max(row, 0), grid.rows - 1.001);
    const [i, j] = [Math.floor(r), Math.floor(c)];
    const [fr, fc] = [r - i, c - j];
    const height = (a: number, b: number) => grid.heights_m[a * grid.columns + b] ?? 0;
    return (
      height(i, j) * (1 - fr) * (1 - fc) + height(i, j + 1) * (1 - fr) * fc +
      height(i + 1, j) * fr * (1 - fc) + height(i + 1, j + 1) * fr * fc
    );
  }
}

/** The time in a kept picture's name, to a tenth of a second. */
function evidenceTime(name: string | undefined): number {
  return Number(/-([\d.]+)s\.jpg$/.exec(name ?? "")?.[1] ?? NaN);
}

const LEVEL = [0, -1, 0, -1, 0, 0, 0, 0, -1]; // looks straight down, the picture's top to the east
