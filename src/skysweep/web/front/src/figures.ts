/** The instruments: mode, time, altitude, battery, coverage and counts, each in its fixed place. */

import { MODE_COLOURS } from "./colours";
import { cellsInside, searched } from "./coverage";
import { h, setText } from "./dom";
import type { Counts, Store } from "./store";
import { clockTime, metres, percent } from "./words";

interface Cell {
  element: HTMLElement;
  label: HTMLElement;
  value: HTMLElement;
}

function cell(label: string, title: string): Cell {
  const term = h("dt", {}, label);
  const value = h("dd", {}, "–");
  return { label: term, value, element: h("div", { title }, term, value) };
}

export class Figures {
  readonly element: HTMLElement;
  private readonly cells = {
    mode: cell("Mode", "What the mission is doing"),
    time: cell("Time", "Mission time, and its end so far"),
    altitude: cell("Altitude AGL", "Height above the ground below the vehicle"),
    speed: cell("Speed", "Horizontal speed"),
    battery: cell("Battery", "Charge that remains, and which battery it is"),
    left: cell("Time left", "Until the battery is empty, at the use of the last minute"),
    searched: cell("Area seen", "Share of the area that was looked at"),
    pos: cell("POS", "Probability of success: mean probability of detection over the area"),
    confirmed: cell("Confirmed", "Candidates confirmed as targets"),
    open: cell("Open", "Candidates seen or scanned, without a verdict yet"),
    rejected: cell("Rejected", "Candidates rejected"),
    unchecked: cell("Unchecked", "Candidates that were left without a check"),
  };
  private readonly inside: Uint8Array | null;
  private pod: { of: Uint8Array | null; pos: number; share: number } = { of: null, pos: 0, share: 0 };

  constructor(private readonly store: Store) {
    const { coverage, area_enu_m, holes_enu_m } = store.scene;
    this.inside = coverage && cellsInside(coverage, area_enu_m, holes_enu_m);
    this.cells.mode.value.className = "mode";
    this.element = h("dl", { class: "figures" }, ...Object.values(this.cells).map((c) => c.element));
  }

  show(t: number, counts: Counts): void {
    const { store, cells } = this;
    const state = store.stateAt(t);
    const coverage = this.coverage(t);
    const say = (which: keyof Figures["cells"], text: string) => setText(cells[which].value, text);
    say("mode", state?.mode ?? "–");
    cells.mode.value.style.setProperty("--mode", state ? MODE_COLOURS[state.mode] : "transparent");
    say("time", `${clockTime(t)} / ${clockTime(store.end_s)}`);
    if (state) {
      const [x, y, z] = state.position_enu_m;
      say("altitude", metres(Math.max(z - store.groundAt(x, y), 0)));
      say("speed", `${Math.hypot(state.velocity_enu_mps[0], state.velocity_enu_mps[1]).toFixed(1)} m/s`);
      const { batteries } = store.scene;
      say("battery", percent(state.battery));
      if (batteries > 1) setText(cells.battery.label, `Battery ${store.sortieAt(t)} of ${batteries}`);
    }
    const left_s = store.timeLeft_s(t);
    say("left", left_s === null ? "–" : clockTime(left_s));
    say("searched", percent(coverage?.share));
    say("pos", percent(coverage?.pos));
    say("confirmed", String(counts.confirmed));
    say("open", String(counts.open));
    say("rejected", String(counts.rejected));
    say("unchecked", String(counts.unchecked));
  }

  private coverage(t: number): { pos: number; share: number } | null {
    const pod = this.store.coverages.at(t)?.pod;
    if (!pod || !this.inside) return null;
    if (this.pod.of !== pod) this.pod = { of: pod, ...searched(pod, this.inside) };
    return this.pod;
  }
}
