/** The keys, and the overlay that lists them. */

import { h } from "./dom";

const KEYS: [string, string][] = [
  ["Space", "play or pause"],
  ["← →", "5 s back or forward; with Shift 30 s"],
  [", .", "previous or next event"],
  ["0 – 9", "to that tenth of the mission"],
  ["+ −", "faster or slower"],
  ["G", "to the present of a live mission, else to the end"],
  ["V", "map, 3-D or both"],
  ["F", "whole area in view"],
  ["C", "keep the vehicle in the middle"],
  ["R", "measure a distance; Esc ends it"],
  ["E L U M", "copy the place under the cursor: local, latitude and longitude, UTM, MGRS"],
  ["T", "light or dark"],
  ["?", "this list"],
];

export function helpDialog(): HTMLDialogElement {
  const close = h("button", { type: "button" }, "Close");
  const dialog = h(
    "dialog",
    { "aria-label": "Keys" },
    h("h2", {}, "Keys"),
    h("dl", { class: "keys" }, ...KEYS.flatMap(([key, what]) => [h("dt", {}, ...key.split(" ").map((k) => h("kbd", {}, k))), h("dd", {}, what)])),
    close,
  );
  close.addEventListener("click", () => dialog.close());
  return dialog;
}

/** Asks once more; whether the answer was yes. */
export function askOnceMore(question: string, yes: string): Promise<boolean> {
  const [agree, refuse] = [h("button", { type: "button", class: "primary" }, yes), h("button", { type: "button" }, "Cancel")];
  const dialog = h("dialog", { "aria-label": question }, h("p", {}, question), h("div", { class: "row" }, agree, refuse));
  document.body.append(dialog);
  return new Promise((answered) => {
    let agreed = false;
    agree.addEventListener("click", () => {
      agreed = true;
      dialog.close();
    });
    refuse.addEventListener("click", () => dialog.close());
    dialog.addEventListener("close", () => {
      dialog.remove();
      answered(agreed);
    });
    dialog.showModal();
  });
}
