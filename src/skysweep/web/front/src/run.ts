/** The page of one run: everything shows the time of one clock. */

import { ask, hasToken, runPath } from "./api";
import { CameraPanel } from "./camera";
import { CandidateList } from "./candidates";
import { Clock } from "./clock";
import { Controls } from "./controls";
import { h, setText } from "./dom";
import { EventList } from "./eventlist";
import { Figures } from "./figures";
import { Follow } from "./follow";
import { NOTATIONS, written, type Notation } from "./geo";
import { helpDialog } from "./help";
import { MissionMap } from "./map";
import { MapTools } from "./maptools";
import { LAYERS, type Layer, type Shown } from "./overlay";
import type { Scene3D } from "./scene3d";
import { Scrubber } from "./scrubber";
import { Store } from "./store";
import { Theme } from "./theme";
import { Timeline } from "./timeline";
import type { Heights, Scene, XY } from "./types";

type View = "map" | "3d" | "both";
const VIEWS: readonly [View, string][] = [["map", "Map"], ["3d", "3-D"], ["both", "Both"]];
const LONGEST_QUIET_S = 5; // a vehicle tells its state twice a second
const LONGEST_QUIET_SIMULATED_S = 30; // a slow computer may take a while for a picture
const COPY_KEYS: Record<string, Notation> = { e: "local", l: "latlon", u: "utm", m: "mgrs" };

/** Opens a run in an element. Throws an Error with a sentence where it cannot be shown. */
export async function openRun(page: HTMLElement, id: string, inFolder: boolean): Promise<void> {
  const scene = await ask<Scene>(`${runPath(id)}/scene`);
  new RunPage(page, id, scene, inFolder);
}

class RunPage {
  private readonly store: Store;
  private readonly clock = new Clock();
  private readonly theme: Theme;
  private readonly map: MissionMap;
  private readonly tools: MapTools;
  private readonly camera: CameraPanel;
  private readonly figures: Figures;
  private readonly candidates: CandidateList;
  private readonly eventList: EventList;
  private readonly timeline: Timeline;
  private readonly scrubber: Scrubber;
  private readonly controls: Controls | null;
  private readonly help = helpDialog();
  private readonly chip = h("span", { class: "chip" });
  private readonly answer = h("p", { class: "answer", role: "status" });
  private readonly trouble = h("p", { class: "trouble", role: "alert", hidden: true });
  private readonly mapElement = h("div", { class: "map" });
  private readonly element3d = h("div", { class: "view3d", role: "group", "aria-label": "3-D view" });
  private readonly views: HTMLElement;
  private readonly element: HTMLElement;
  private scene3d: Scene3D | null = null;
  private view: View = "map";
  private flying = false;
  private follows = false;
  private place: XY | null = null;
  private shownKey = "";
  private opened = false;
  private last_ms = performance.now();
  private newest_s = 0; // mission time of the newest line
  private news_ms = performance.now(); // when it came

  constructor(
    page: HTMLElement,
    private readonly id: string,
    private readonly scene: Scene,
    inFolder: boolean,
  ) {
    document.title = `${scene.name} – skysweep`;
    this.store = new Store(scene);
    const mayOrder = scene.controls && scene.live && hasToken();
    this.controls = mayOrder ? new Controls(id, scene.external, (sentence) => this.say(sentence)) : null;
    this.theme = new Theme((dark) => this.setTheme(dark));
    this.camera = new CameraPanel(id, this.store);
    this.figures = new Figures(this.store);
    this.candidates = new CandidateList(id, this.store, mayOrder, {
      selected: (candidate) => this.select(candidate, true),
      verdict: (candidate, word) => this.controls?.send({ word, candidate }),
    });
    this.eventList = new EventList(this.store, (event) => {
      this.clock.goTo(event.t);
      if (event.candidate !== null) this.select(event.candidate, false);
    });
    this.timeline = new Timeline(this.store, (t) => this.clock.goTo(t));
    this.scrubber = new Scrubber(this.clock, (steps) => this.jump(steps), scene.live);
    this.views = h("div", { class: "views", "data-view": "map" }, this.mapElement, this.element3d);
    this.element = this.layout(inFolder);
    page.replaceChildren(this.element);
    this.map = new MissionMap(this.mapElement, this.store, this.shown(), {
      pointed: (place) => this.point(place),
      selected: (candidate) => this.select(candidate, false),
      placed: (place) => this.lookAt(place),
    });
    this.tools = new MapTools(this.map, scene, {
      follows: (on) => (this.follows = on),
      coloured: (colour) => this.scene3d?.colourBy(colour),
    });
    this.views.append(this.tools.element, this.tools.coordinates, this.tools.legend);
    this.views.append(h("div", { class: "alerts" }, this.trouble, this.controls?.holding));
    this.listen();
    this.setTheme(this.theme.dark);
    if (scene.live) this.clock.follow();
    void this.loadHeights();
    new Follow(id, this.store, {
      said: (sentence) => this.trouble_(sentence),
      status: (flying) => (this.flying = flying),
      lines: (lines) => this.flying && this.controls?.heard(lines), // those of before are not meant
      lost: () => this.controls?.lost(),
      restart: () => location.reload(),
    });
    requestAnimationFrame((now_ms) => this.frame(now_ms));
  }

  private layout(inFolder: boolean): HTMLElement {
    const { scene } = this;
    const about = [scene.strategy, scene.sensor, `seed ${scene.seed}`].filter(Boolean).join(", ");
    const viewButtons = VIEWS.map(([view, text]) => {
      const button = h("button", { type: "button", "data-view": view, onclick: () => void this.setView(view) }, text);
      return button;
    });
    const side = this.sidePanels();
    return h(
      "div",
      { class: scene.live ? "run live" : "run" },
      h(
        "header",
        {},
        inFolder ? h("a", { href: "/", class: "back" }, "All missions") : null,
        h("h1", {}, scene.name),
        h("p", { class: "about" }, scene.scenario === scene.name ? about : `${scene.scenario}: ${about}`),
        this.chip,
        h("span", { class: "space" }),
        h("div", { class: "segments", role: "group", "aria-label": "View" }, ...viewButtons),
        h("a", { href: `${runPath(this.id)}/report`, class: "button quiet report", target: "_blank", rel: "noopener" }, "Report"),
        this.theme.button,
        h("button", { type: "button", class: "quiet", title: "Keys (?)", onclick: () => this.help.showModal() }, "Keys"),
      ),
      this.figures.element,
      h("main", {}, this.views),
      side,
      h(
        "footer",
        {},
        h("div", { class: "bar" }, this.scrubber.element, this.answer, this.controls?.element),
        this.timeline.element,
      ),
      this.help,
    );
  }

  private sidePanels(): HTMLElement {
    const [first, second] = [this.candidates.node, this.eventList.node];
    const tabs = ["Candidates", "Events"].map((name, k) =>
      h("button", { type: "button", role: "tab", id: `tab-${k}`, "aria-controls": `panel-${k}`, "aria-selected": k === 0 }, name),
    );
    const panels = [first, second];
    panels.forEach((panel, k) => {
      panel.id = `panel-${k}`;
      panel.setAttribute("role", "tabpanel");
      panel.setAttribute("aria-labelledby", `tab-${k}`);
      panel.hidden = k !== 0;
    });
    tabs.forEach((tab, k) => {
      tab.setAttribute("aria-selected", String(k === 0));
      tab.addEventListener("click", () => {
        tabs.forEach((other, j) => other.setAttribute("aria-selected", String(j === k)));
        panels.forEach((panel, j) => (panel.hidden = j !== k));
        this.eventList.reveal();
      });
    });
    return h("aside", {}, this.camera.element, h("div", { class: "lists" }, h("div", { class: "tabs", role: "tablist" }, ...tabs), ...panels));
  }

  private shown(): Shown {
    const layers = Object.fromEntries(Object.keys(LAYERS).map((layer) => [layer, true])) as Record<Layer, boolean>;
    layers.truth = false;
    return { layers, colour: "mode", selected: null, measured: [] };
  }

  private async loadHeights(): Promise<void> {
    try {
      this.store.heights = await ask<Heights>(this.scene.ground.heights);
      this.store.version++;
    } catch (error) {
      this.say((error as Error).message);
    }
  }

  private frame(now_ms: number): void {
    const wall_s = Math.min((now_ms - this.last_ms) / 1000, 0.25);
    this.last_ms = now_ms;
    const { clock, store } = this;
    clock.end_s = store.end_s;
    if (!this.opened && store.lines.length) this.open();
    clock.step(wall_s);
    if (store.ended !== null && clock.following && clock.t >= clock.end_s) clock.following = false;
    if (store.end_s !== this.newest_s) [this.newest_s, this.news_ms] = [store.end_s, now_ms];
    const film = this.store.film.length;
    const key = `${clock.t} ${store.version} ${film} ${this.map.shown.colour} ${this.silent_s(now_ms)}`;
    if (key !== this.shownKey) {
      this.shownKey = key;
      this.show(clock.t, this.silent_s(now_ms));
    }
    this.controls?.show(store.holder, now_ms);
    this.camera.show(clock.t); // a picture comes when it comes
    this.scrubber.show(this.scene.live && store.ended === null);
    requestAnimationFrame((next_ms) => this.frame(next_ms));
  }

  /** For how many seconds a live mission has told nothing; 0 where that is not long. */
  private silent_s(now_ms: number): number {
    const quiet_s = Math.floor((now_ms - this.news_ms) / 1000);
    const longest_s = this.scene.external ? LONGEST_QUIET_S : LONGEST_QUIET_SIMULATED_S;
    return this.scene.live && this.store.ended === null && this.newest_s > 0 && quiet_s >= longest_s ? quiet_s : 0;
  }

  /** Where a page begins: at the time in its address, else at the present, else at the end. */
  private open(): void {
    const asked = new URLSearchParams(location.hash.slice(1)).get("t");
    const wanted = asked === null ? NaN : Number(asked);
    if (wanted >= 0) {
      if (this.store.end_s < wanted && !this.store.ended) return;
      this.opened = true;
      this.clock.goTo(wanted);
    } else if (this.store.ended !== null || this.scene.live || this.store.lines.length > 0) {
      this.opened = this.store.ended !== null || this.scene.live;
      this.clock.t = this.store.end_s;
    }
  }

  private show(t: number, silent_s: number): void {
    const candidates = this.store.candidatesAt(t);
    this.figures.show(t, this.store.countsAt(candidates));
    if (this.view !== "3d") {
      if (this.follows) this.map.follow(t);
      this.map.show(t);
    }
    if (this.view !== "map") {
      this.scene3d?.colourBy(this.map.shown.colour);
      this.scene3d?.show(t);
    }
    this.candidates.show(t, candidates, this.map.shown.selected);
    this.eventList.show(t);
    this.timeline.show(t);
    this.tools.show();
    const live = this.scene.live && this.store.ended === null;
    setText(this.chip, silent_s > 0 ? `No news for ${silent_s} s` : live ? (this.clock.following ? "Live" : "Live, looking back") : this.store.ended !== null ? "Replay" : this.flying ? "Flying" : "Broken off");
    this.chip.dataset.state = silent_s > 0 ? "silent" : live ? "live" : "replay";
    this.element.classList.toggle("silent", silent_s > 0);
    this.element.classList.toggle("over", this.store.ended !== null);
  }

  private setTheme(dark: boolean): void {
    if (!this.timeline) return; // its first call comes before there is a page
    this.timeline.setTheme(dark);
    this.candidates.setTheme(dark);
    this.scene3d?.setTheme(dark);
    this.shownKey = "";
  }

  private async setView(view: View): Promise<void> {
    this.view = view;
    this.views.dataset.view = view;
    for (const button of document.querySelectorAll<HTMLElement>(".segments [data-view]")) {
      button.setAttribute("aria-pressed", String(button.dataset.view === view));
    }
    if (view !== "map" && !this.scene3d) {
      try {
        const { Scene3D } = await import("./scene3d");
        this.scene3d ??= new Scene3D(this.element3d, this.store);
        this.scene3d.setTheme(this.theme.dark);
        this.scene3d.colourBy(this.map.shown.colour);
      } catch (error) {
        this.say(`The 3-D view cannot be shown: ${(error as Error).message}`);
      }
    }
    this.resize();
    this.map.fit();
  }

  private resize(): void {
    this.map.resize();
    this.scene3d?.resize();
    this.shownKey = "";
  }

  private select(candidate: number | null, goThere: boolean): void {
    const now = this.store.candidatesAt(this.clock.t).find((c) => c.id === candidate);
    this.map.shown.selected = candidate;
    if (candidate !== null) this.candidates.reveal(candidate);
    if (goThere && now) this.map.goTo(now.position_enu_m as XY);
    this.shownKey = "";
  }

  private point(place: XY): void {
    this.place = place;
    this.tools.point(place);
  }

  private lookAt(place: XY): void {
    this.controls?.send({ word: "look", position_enu_m: place });
    this.setPlacing(false);
  }

  private setPlacing(on: boolean): void {
    this.tools.setMeasuring(false);
    this.map.tool = on ? "place" : "select";
    this.map.setCursor(on ? "crosshair" : "");
    this.controls?.lookHere.setAttribute("aria-pressed", String(on));
    if (on) this.say("Click on the map where the vehicle is to look; Esc cancels.");
  }

  private jump(steps: number): void {
    const times = this.store.events.items.filter((e) => e.tone !== "muted").map((e) => e.t);
    const { t } = this.clock;
    const next = steps > 0 ? times.find((time) => time > t + 1e-6) : times.filter((time) => time < t - 1e-6).pop();
    if (next !== undefined) this.clock.goTo(next);
  }

  private say(sentence: string): void {
    setText(this.answer, sentence);
  }

  private trouble_(sentence: string): void {
    setText(this.trouble, sentence);
    this.trouble.hidden = sentence === "";
  }

  private copy(notation: Notation): void {
    if (!this.place) return;
    const text = written(this.map.projection.frame, ...this.place, notation);
    navigator.clipboard.writeText(text).then(
      () => this.say(`Copied: ${text}`),
      () => this.say("The browser did not allow copying."),
    );
  }

  private listen(): void {
    document.addEventListener("keydown", (event) => this.pressed(event));
    new ResizeObserver(() => this.resize()).observe(this.views);
    this.controls?.lookHere.addEventListener("click", () => this.setPlacing(this.map.tool !== "place"));
    for (const notation of NOTATIONS) this.tools.copied(notation, () => this.copy(notation));
    document.querySelector(".segments [data-view=map]")?.setAttribute("aria-pressed", "true");
  }

  private pressed(event: KeyboardEvent): void {
    const target = event.target as HTMLElement;
    if (event.ctrlKey || event.metaKey || event.altKey || target.closest("input, select, dialog[open]")) return;
    const { clock } = this;
    const far = event.shiftKey ? 30 : 5;
    const actions: Record<string, () => void> = {
      ArrowLeft: () => clock.goTo(clock.t - far),
      ArrowRight: () => clock.goTo(clock.t + far),
      Home: () => clock.goTo(0),
      End: () => clock.follow(),
      ",": () => this.jump(-1),
      ".": () => this.jump(1),
      "+": () => clock.faster(1),
      "=": () => clock.faster(1),
      "-": () => clock.faster(-1),
      g: () => clock.follow(),
      v: () => void this.setView(this.view === "map" ? "3d" : this.view === "3d" ? "both" : "map"),
      f: () => this.map.fit(),
      c: () => this.tools.toggleFollow(),
      r: () => this.tools.setMeasuring(this.map.tool !== "measure"),
      t: () => this.theme.switch(),
      "?": () => this.help.showModal(),
      Escape: () => this.setPlacing(false),
    };
    if (event.key === " " && target.closest("button, a, [role=tab]")) return; // presses that
    if (event.key === " ") clock.toggle();
    else if (/^\d$/.test(event.key)) clock.goTo((Number(event.key) / 10) * clock.end_s);
    else if (COPY_KEYS[event.key.toLowerCase()] && !event.shiftKey) this.copy(COPY_KEYS[event.key.toLowerCase()]!);
    else {
      const action = actions[event.key] ?? actions[event.key.toLowerCase()];
      if (!action) return;
      action();
    }
    event.preventDefault();
  }
}

