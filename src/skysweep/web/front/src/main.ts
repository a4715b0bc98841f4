/** The address says what to show: a folder of runs, or one of them. */

import "./style.css";
import { ask, keepToken, openSession } from "./api";
import { h } from "./dom";
import { Theme } from "./theme";
import type { Folder } from "./types";

const ONLY = "_"; // id of the run that is served alone

async function show(page: HTMLElement): Promise<void> {
  keepToken();
  await openSession();
  const asked = decodeURIComponent(location.pathname).match(/^\/run\/(.+)$/)?.[1];
  const folder = asked ? null : await ask<Folder>("/api/folder");
  const only = folder?.entries.find((entry) => entry.id === ONLY);
  const id = asked ?? folder?.live ?? only?.id;
  if (id) {
    const { openRun } = await import("./run");
    await openRun(page, id, asked !== undefined && asked !== ONLY);
  } else if (folder) {
    const { openFolder } = await import("./list");
    openFolder(page, folder);
  }
}

const page = document.getElementById("page")!;
new Theme();
show(page).catch((error: Error) => {
  page.replaceChildren(
    h("main", { class: "failure" }, h("h1", {}, "This cannot be shown"), h("p", { role: "alert" }, error.message), h("a", { href: "/" }, "Back to the start")),
  );
});
