/** Light or dark: the system's choice until a person makes one. */

import { h } from "./dom";

const KEY = "skysweep-theme";
const system = matchMedia("(prefers-color-scheme: dark)");

export class Theme {
  readonly button = h("button", { type: "button", class: "quiet", title: "Light or dark (T)", onclick: () => this.switch() });

  constructor(private readonly changed: (dark: boolean) => void = () => {}) {
    system.addEventListener("change", () => this.apply());
    this.apply();
  }

  get dark(): boolean {
    const chosen = localStorage.getItem(KEY);
    return chosen ? chosen === "dark" : system.matches;
  }

  switch(): void {
    localStorage.setItem(KEY, this.dark ? "light" : "dark");
    this.apply();
  }

  private apply(): void {
    document.documentElement.dataset.theme = this.dark ? "dark" : "light";
    this.button.textContent = this.dark ? "Light" : "Dark";
    this.changed(this.dark);
  }
}
