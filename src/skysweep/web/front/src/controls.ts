/** What a person may order on a live mission, and what was answered. */

import { order, type Order } from "./api";
import { h } from "./dom";
import { askOnceMore } from "./help";

export class Controls {
  readonly element: HTMLElement;
  readonly lookHere = h("button", { type: "button", "aria-pressed": "false", title: "Click on the map: the vehicle goes there, looks, and comes back" }, "Look here");

  constructor(
    private readonly id: string,
    isSimulated: boolean,
    private readonly said: (sentence: string) => void,
  ) {
    const button = (text: string, title: string, pressed: () => void) =>
      h("button", { type: "button", title, onclick: pressed }, text);
    this.element = h(
      "div",
      { class: "controls", role: "group", "aria-label": "Orders to the mission" },
      button("Hold", "Stop where it is and wait", () => this.send({ word: "hold" })),
      button("Continue", "Go on with the search", () => this.send({ word: "continue" })),
      this.lookHere,
      isSimulated ? null : button("Take back", "Give the vehicle back to the mission after somebody else has flown it", () => this.send({ word: "take back" })),
      button("Return home", "End the search and fly home", () => void this.return()),
    );
  }

  send(what: Order): void {
    order(this.id, what).then(this.said, (error: Error) => this.said(error.message));
  }

  private async return(): Promise<void> {
    if (await askOnceMore("End the search and fly home?", "Return home")) this.send({ word: "return" });
  }
}
