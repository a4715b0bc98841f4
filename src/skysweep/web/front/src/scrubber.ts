/** Buttons of the time that is shown: play, speed, events, the present. */

import { SPEEDS, type Clock } from "./clock";
import { h, setText } from "./dom";

export class Scrubber {
  readonly element: HTMLElement;
  private readonly play = h("button", { type: "button", class: "primary play", onclick: () => this.clock.toggle() });
  private readonly speed = h("select", { "aria-label": "Speed" }, ...SPEEDS.map((s) => h("option", { value: s }, `${s} ×`)));
  private readonly present: HTMLButtonElement;

  constructor(
    private readonly clock: Clock,
    jump: (steps: number) => void,
    live: boolean,
  ) {
    this.speed.addEventListener("change", () => (clock.speed = Number(this.speed.value)));
    this.present = h("button", { type: "button", onclick: () => clock.follow() }, live ? "Go to live" : "To the end");
    this.element = h(
      "div",
      { class: "scrubber", role: "group", "aria-label": "Playback" },
      h("button", { type: "button", title: "Previous event (,)", onclick: () => jump(-1) }, "◂ Event"),
      this.play,
      h("button", { type: "button", title: "Next event (.)", onclick: () => jump(1) }, "Event ▸"),
      this.speed,
      this.present,
    );
  }

  show(live: boolean): void {
    const { clock } = this;
    setText(this.play, clock.playing || clock.following ? "Pause" : "Play");
    if (this.speed.value !== String(clock.speed)) this.speed.value = String(clock.speed);
    setText(this.present, !live ? "To the end" : clock.following ? "Live" : "Go to live");
    this.present.classList.toggle("on", live && clock.following);
  }
}
