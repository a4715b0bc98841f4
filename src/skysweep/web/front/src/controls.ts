/** What a person may order on a live mission, and what became of it. */

import { order, type Order } from "./api";
import { h, setText } from "./dom";
import { orderInWords } from "./events";
import { askOnceMore } from "./help";
import type { Line } from "./types";

const LONGEST_WAY_MS = 5000; // of an order that the server has passed on
const READ_MS = 1000; // until a person has read who flies the vehicle
const SAME_PLACE_M = 0.01;

export class Controls {
  readonly element: HTMLElement;
  readonly lookHere = h("button", { type: "button", "aria-pressed": "false", title: "Click on the map: the vehicle goes there, looks, and comes back" }, "Look here");
  /** Says who else flies the vehicle. */
  readonly holding = h("p", { class: "holding", role: "alert", hidden: true });
  private readonly takeBack: HTMLButtonElement;
  private readonly onTheWay = new Map<Order, { doubted: boolean }>();
  private holder: string | null = null; // as it is shown
  private shown_ms = 0; // since when

  constructor(
    private readonly id: string,
    isExternal: boolean,
    private readonly said: (sentence: string) => void,
  ) {
    const button = (text: string, title: string, pressed: () => void) =>
      h("button", { type: "button", title, onclick: pressed }, text);
    this.takeBack = button("Take back", "Give the vehicle back to the mission; only while somebody else flies it", () => this.takeItBack());
    this.element = h(
      "div",
      { class: "controls", role: "group", "aria-label": "Orders to the mission" },
      button("Hold", "Stop where it is and wait", () => this.send({ word: "hold" })),
      button("Continue", "Go on with the search", () => this.send({ word: "continue" })),
      this.lookHere,
      isExternal && this.takeBack,
      button("Return home", "End the search and fly home", () => void this.return()),
    );
  }

  /** Shows who else flies the vehicle, if anybody does: from them it can be taken back once that was read. */
  show(holder: string | null, now_ms: number): void {
    if (holder !== this.holder) {
      [this.holder, this.shown_ms] = [holder, now_ms];
      setText(this.holding, `Somebody else flies the vehicle (${holder}).`);
      this.holding.hidden = holder === null;
    }
    this.takeBack.disabled = holder === null || now_ms - this.shown_ms < READ_MS;
  }

  send(what: Order): void {
    this.onTheWay.set(what, { doubted: false });
    order(this.id, what).then(
      (said) => {
        if (!this.onTheWay.has(what)) return; // it was heard before
        this.onTheWay.set(what, { doubted: false });
        this.said(`${said} On its way.`);
        setTimeout(() => this.doubt(what), LONGEST_WAY_MS);
      },
      (error: Error) => {
        this.onTheWay.delete(what);
        this.said(error.message);
      },
    );
  }

  /** Looks in new lines of the journal for what became of the orders. */
  heard(lines: readonly Line[]): void {
    for (const line of lines) {
      if (line.kind === "operator") {
        for (const what of this.onTheWay.keys()) {
          if (!isTold(what, line)) continue;
          this.onTheWay.delete(what);
          this.said(`Heard: ${inWords(what)}.`);
        }
      } else if (line.kind === "safety" && line.cause === "operator") this.said(line.sentence ?? "");
    }
  }

  /** The connection has ended: nobody knows what became of the orders. */
  lost(): void {
    for (const what of this.onTheWay.keys()) this.doubt(what);
  }

  private doubt(what: Order): void {
    const way = this.onTheWay.get(what);
    if (!way || way.doubted) return;
    way.doubted = true;
    this.said(`Not taken so far: ${inWords(what)}. Look at the vehicle and say it again.`);
  }

  private takeItBack(): void {
    if (this.holder !== null) this.send({ word: "take back", holder: this.holder });
  }

  private async return(): Promise<void> {
    if (await askOnceMore("End the search and fly home?", "Return home")) this.send({ word: "return" });
  }
}

/** Whether a line of kind operator tells of an order. */
function isTold(what: Order, line: Line): boolean {
  const place = what.position_enu_m ?? [];
  const isThere = place.every((v, k) => Math.abs(v - (line.p?.[k] ?? NaN)) < SAME_PLACE_M);
  return line.word === what.word && line.candidate === what.candidate && isThere;
}

function inWords(what: Order): string {
  return orderInWords(what.word, what.candidate, what.position_enu_m);
}
