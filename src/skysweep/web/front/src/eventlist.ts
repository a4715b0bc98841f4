/** What happened, in words; a click goes there. */

import { TONE_COLOURS } from "./colours";
import { h } from "./dom";
import type { MissionEvent } from "./events";
import type { Store } from "./store";
import { clockTime } from "./words";

export class EventList {
  readonly node: HTMLElement;
  private readonly list = h("ol", { class: "events", "aria-label": "Events" });
  private readonly rows: { event: MissionEvent; element: HTMLElement }[] = [];
  private nLines = -1;
  private current: HTMLElement | null = null;

  constructor(
    private readonly store: Store,
    private readonly goTo: (event: MissionEvent) => void,
  ) {
    const all = h("input", { type: "checkbox" });
    all.addEventListener("change", () => this.list.classList.toggle("all", all.checked));
    this.node = h(
      "div",
      { class: "scroll", tabindex: 0 },
      h("label", { class: "check" }, all, "Waypoints and reassessments, too"),
      this.list,
    );
  }

  show(t: number): void {
    if (this.nLines !== this.store.lines.length) {
      this.nLines = this.store.lines.length;
      this.update();
    }
    const row = this.rows[this.store.events.count(t) - 1]?.element ?? null;
    if (row === this.current) return;
    this.current?.removeAttribute("aria-current");
    row?.setAttribute("aria-current", "time");
    this.current = row;
    this.reveal();
  }

  /** Scrolls to the newest event, where it is out of sight. */
  reveal(): void {
    const row = this.current;
    if (!row || this.node.hidden) return;
    const [top, bottom] = [this.node.scrollTop, this.node.scrollTop + this.node.clientHeight];
    const place = row.offsetTop;
    if (place < top + 20 || place > bottom - 50) this.node.scrollTop = place - this.node.clientHeight / 2;
  }

  /** Keeps the rows that are still right: nearly always new ones are only appended. */
  private update(): void {
    const { items } = this.store.events;
    let same = this.rows.length;
    while (same > 0 && this.rows[same - 1]!.event !== items[same - 1]) same--;
    for (const row of this.rows.splice(same)) row.element.remove();
    for (const event of items.slice(same)) {
      const element = h(
        "li",
        { class: event.tone },
        h(
          "button",
          { type: "button", onclick: () => this.goTo(event) },
          h("span", { class: "dot", style: `background:${TONE_COLOURS[event.tone]}` }),
          h("time", {}, clockTime(event.t)),
          h("span", {}, event.words),
        ),
      );
      this.rows.push({ event, element });
      this.list.append(element);
    }
  }
}
