/** A folder of runs, sweeps and comparisons: newest first. */

import { ask } from "./api";
import { h } from "./dom";
import { Theme } from "./theme";
import type { Entry, Folder } from "./types";
import { ago } from "./words";

const REFRESH_MS = 5000;

/** Shows the folder, and what appears in it. */
export function openFolder(page: HTMLElement, folder: Folder): void {
  document.title = `${folder.name || "Missions"} – skysweep`;
  const filter = h("input", { type: "search", placeholder: "Filter by name, scenario, strategy", "aria-label": "Filter" });
  const count = h("p", { class: "count", role: "status" });
  const list = h("ol", { class: "entries" });
  const theme = new Theme();
  let entries = folder.entries;
  const update = () => {
    const words = filter.value.toLowerCase().split(/\s+/).filter(Boolean);
    const shown = entries.filter((entry) => words.every((word) => textOf(entry).includes(word)));
    list.replaceChildren(...shown.map(rowOf));
    count.textContent = shown.length === entries.length ? `${entries.length} in all` : `${shown.length} of ${entries.length}`;
  };
  filter.addEventListener("input", update);
  page.replaceChildren(
    h(
      "div",
      { class: "folder" },
      h("header", {}, h("h1", {}, folder.name || "Missions"), h("span", { class: "space" }), theme.button),
      h("main", {}, h("div", { class: "search" }, filter, count), list),
    ),
  );
  update();
  let known = JSON.stringify(entries);
  setInterval(() => {
    ask<Folder>("/api/folder").then(
      (newer) => {
        const text = JSON.stringify(newer.entries);
        if (text === known) return;
        known = text;
        entries = newer.entries;
        update();
      },
      () => (count.textContent = "The connection to skysweep is lost; trying again."),
    );
  }, REFRESH_MS);
}

function textOf(entry: Entry): string {
  return [entry.name, entry.kind, entry.scenario, entry.strategy, entry.sensor, entry.state].join(" ").toLowerCase();
}

function rowOf(entry: Entry): HTMLElement {
  const about = [entry.scenario, entry.strategy, entry.sensor, entry.seed === null ? null : `seed ${entry.seed}`].filter(Boolean).join(", ");
  const address = entry.kind === "run" ? `/run/${entry.id.split("/").map(encodeURIComponent).join("/")}` : entry.report;
  const name = address ? h("a", { href: address }, entry.name) : h("span", {}, entry.name);
  return h(
    "li",
    {},
    entry.thumbnail ? h("img", { src: entry.thumbnail, alt: "", loading: "lazy" }) : h("div", { class: "blank" }),
    h(
      "div",
      { class: "what" },
      h("h2", {}, name),
      h("p", { class: "about" }, [entry.kind, about].filter(Boolean).join(": ")),
      entry.error ? h("p", { class: "error" }, entry.error) : null,
    ),
    h("dl", {}, ...entry.figures.map((figure) => h("div", {}, h("dt", {}, figure.label), h("dd", {}, figure.value)))),
    h(
      "div",
      { class: "when" },
      entry.state ? h("span", { class: "chip", "data-state": entry.state === "flying" ? "live" : "replay" }, entry.state) : null,
      h("p", {}, ago(entry.modified_unix_s, Date.now() / 1000)),
      entry.report && entry.kind === "run" ? h("a", { href: entry.report }, "Report") : null,
    ),
  );
}
