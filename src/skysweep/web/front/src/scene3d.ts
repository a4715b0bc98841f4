/** The 3-D view. Loaded lazily, so that three.js costs only the pages that show it. */

import { WebGLRenderer } from "three";

import { h } from "./dom";
import type { PathColour } from "./overlay";
import { View3D } from "./scene3d-view";
import type { Store } from "./store";
import "./scene3d.css";

const NO_WEBGL = "The 3-D view needs WebGL: turn on hardware acceleration in this browser, or use another one.";

/**
 * Terrain, paths, vehicle and candidates of one mission, in ENU metres; one sentence where there is no WebGL.
 *
 * It draws only when something has changed, and nothing before the store has its `heights`.
 */
export class Scene3D {
  private readonly view: View3D | null;

  constructor(
    private readonly element: HTMLElement,
    store: Store,
  ) {
    const renderer = rendererHere();
    element.classList.add("scene3d");
    this.view = renderer && new View3D(element, store, renderer);
    if (!this.view) element.append(h("p", { class: "scene3d-sentence", role: "status" }, NO_WEBGL));
  }

  /** Shows mission time `t` (s), with what the store has learned since. */
  show(t: number): void {
    this.view?.show(t);
  }

  /** What the next path shown is coloured by. */
  colourBy(what: PathColour): void {
    this.view?.colourBy(what);
  }

  /** To be called when the element's size has changed. */
  resize(): void {
    this.view?.resize();
  }

  setTheme(dark: boolean): void {
    this.view?.setTheme(dark);
  }

  dispose(): void {
    this.view?.dispose();
    this.element.replaceChildren();
    this.element.classList.remove("scene3d");
  }
}

function rendererHere(): WebGLRenderer | null {
  try {
    return new WebGLRenderer({ antialias: hasDevice() });
  } catch {
    return null;
  }
}

/** Whether WebGL runs on a graphics device. In software, smooth edges cost more than all the rest. */
function hasDevice(): boolean {
  const context = document.createElement("canvas").getContext("webgl2");
  const told = context?.getExtension("WEBGL_debug_renderer_info");
  const name = told ? String(context!.getParameter(told.UNMASKED_RENDERER_WEBGL)) : "";
  context?.getExtension("WEBGL_lose_context")?.loseContext();
  return !/swiftshader|llvmpipe|softpipe|software|basic render/i.test(name);
}
