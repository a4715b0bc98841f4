/** What happened, in words. */

import type { Line } from "./types";

export type EventTone = "plain" | "good" | "muted" | "warning" | "danger" | "operator";

export interface MissionEvent {
  t: number;
  kind: string;
  tone: EventTone;
  words: string;
  candidate: number | null;
}

const WORDS: Record<string, string> = {
  hold: "hold",
  continue: "continue",
  return: "return home",
  confirm: "confirm candidate",
  reject: "reject candidate",
  look: "look here",
};

/** An order in words. */
export function orderInWords(word: string | undefined, candidate?: number, place?: readonly number[]): string {
  const order = WORDS[word ?? ""] ?? word ?? "order";
  if (candidate !== undefined) return `${order} ${candidate}`;
  return place ? `${order}, E ${place[0]!.toFixed(0)} m, N ${place[1]!.toFixed(0)} m` : order;
}

/** The event that a line tells; null: it tells none. */
export function eventOf(line: Line): MissionEvent | null {
  const told = inWords(line);
  if (!told) return null;
  const [words, tone] = told;
  return { t: line.t, kind: line.kind, tone, words, candidate: line.candidate ?? null };
}

function inWords(line: Line): [string, EventTone] | null {
  const who = `Candidate ${line.candidate}`;
  const by = line.by === "operator" ? " by the operator" : "";
  const why = line.reason ? `: ${line.reason}` : "";
  switch (line.kind) {
    case "scanned":
      return [`${who} scanned${why}`, "plain"];
    case "reassessed":
      return [`${who} reassessed${why}`, "muted"];
    case "misfit":
      return [`The detector differs from its model${why}`, "warning"];
    case "check_started":
      return [line.candidate === undefined ? `CHECK started${why}` : `CHECK of candidate ${line.candidate}${why}`, "plain"];
    case "confirmed":
      return [`${who} confirmed${by}${why}`, "good"];
    case "rejected":
      return [`${who} rejected${by}${why}`, "muted"];
    case "unchecked":
      return [`${who} left unchecked${why}`, "warning"];
    case "scan_resumed":
      return ["SCAN resumed", "plain"];
    case "looks_again":
      return [`Back to weakly searched ground${why}`, "plain"];
    case "waypoint_reached":
      return ["Waypoint reached", "muted"];
    case "unsearched":
      return [`${Math.round(line.length_m ?? 0)} m flown without looks${line.again ? ", to be flown again" : ""}`, "warning"];
    case "finished":
      return [`Search finished${why}`, "plain"];
    case "operator":
      return [`Operator: ${orderInWords(line.word, line.candidate, line.p)}`, "operator"];
    case "safety":
      return [`${line.sentence ?? line.cause ?? "Alarm"}`, line.action === "CONTINUE" ? "warning" : "danger"];
    case "sortie":
      return [`Sortie ${line.number} landed for another battery: ${line.why}`, "plain"];
    case "next_sortie":
      return [`Sortie ${line.number} took off`, "plain"];
    case "resumed":
      return ["Mission resumed", "plain"];
    case "landed":
      return ["Landed", "plain"];
    case "end":
      return [`Mission ended: ${line.reason ?? "no reason given"}`, line.reason === "completed" ? "plain" : "warning"];
    default:
      return null;
  }
}
