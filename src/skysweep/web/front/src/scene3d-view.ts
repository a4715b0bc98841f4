/** The camera of the 3-D view, what it is moved by, and what it is pointed at. */

import {
  PerspectiveCamera,
  Scene,
  SRGBColorSpace,
  TextureLoader,
  Vector3,
  type Texture,
  type WebGLRenderer,
} from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";

import { fitCanvas, h, toggle } from "./dom";
import type { PathColour } from "./overlay";
import { Candidates } from "./scene3d-candidates";
import { Path, Vehicle } from "./scene3d-flight";
import { palette } from "./scene3d-look";
import { free, type Mark } from "./scene3d-marks";
import { buildWorld } from "./scene3d-world";
import type { Store } from "./store";

const FOV_DEG = 38;
const MOST_PIXEL_RATIO = 2;
const MARGIN_PX = 46; // around what is fitted into the picture, where labels are
const FITTINGS = 6; // until the middle is found
const TURN_RAD = Math.PI / 24; // by one key
const ZOOM = 0.85; // by one key
const FOLLOWED_FROM = 2.5; // altitudes of SCAN

/** From the middle of the area to the camera. */
const DIRECTIONS = {
  reset: new Vector3(-0.5, -1, 0.75).normalize(),
  top: new Vector3(0, -1e-3, 1).normalize(),
  side: new Vector3(0, -1, 0.06).normalize(),
};
type Direction = keyof typeof DIRECTIONS;

interface Parts {
  fixed: Mark[];
  path: Path;
  vehicle: Vehicle;
  candidates: Candidates;
}

export class View3D {
  private readonly scene = new Scene();
  private readonly camera = new PerspectiveCamera(FOV_DEG);
  private readonly controls: OrbitControls;
  private readonly marks = h("canvas", { class: "scene3d-marks", "aria-hidden": "true" });
  private readonly follow: HTMLButtonElement;
  private parts: Parts | null = null; // null: the ground is not known yet
  private picture: Texture | null = null;
  private direction: Direction | null = "reset"; // null: the camera was moved by hand
  private followed: Vector3 | null = null; // where the followed vehicle was
  private isDark = false;
  private what: PathColour = "mode";
  private t = 0;
  private frame = 0;

  constructor(
    private readonly element: HTMLElement,
    private readonly store: Store,
    private readonly renderer: WebGLRenderer,
  ) {
    const canvas = renderer.domElement;
    canvas.tabIndex = 0;
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", "3-D view of the terrain, the paths, the vehicle and the candidates");
    const button = (name: string, direction: Direction, title: string) =>
      h("button", { type: "button", title, onclick: () => this.lookFrom(direction) }, name);
    this.follow = toggle("Follow", "Follow the vehicle (F)", false, (on) => this.setFollowing(on));
    const views = h(
      "div",
      { class: "scene3d-views", role: "group", "aria-label": "3-D view" },
      button("Reset", "reset", "The whole area, from the south-west (R)"),
      button("Top", "top", "From above, north up (T)"),
      button("Side", "side", "From the south, level (S)"),
      this.follow,
    );
    element.append(canvas, this.marks, views);

    this.camera.up.set(0, 0, 1);
    this.controls = new OrbitControls(this.camera, canvas);
    this.controls.maxPolarAngle = 0.497 * Math.PI;
    this.controls.minDistance = 2;
    this.controls.addEventListener("start", () => (this.direction = null));
    this.controls.addEventListener("change", () => this.request());
    canvas.addEventListener("keydown", this.onKey);
    canvas.addEventListener("webglcontextrestored", () => this.request());
    if (store.scene.ground.picture) {
      new TextureLoader().load(store.scene.ground.picture, (texture) => {
        texture.colorSpace = SRGBColorSpace;
        this.picture = texture;
        this.rebuild();
        this.show(this.t);
      });
    }
    this.resize();
  }

  show(t: number): void {
    this.t = t;
    if (!this.parts) this.rebuild();
    if (!this.parts) return;
    const state = this.store.stateAt(t);
    const { path, vehicle, candidates } = this.parts;
    path.visible = vehicle.visible = state !== null;
    if (state) {
      path.show(state);
      vehicle.show(state);
      if (this.followed) this.keepUp(vehicle.position_enu_m, this.followed);
    }
    candidates.show(this.store.candidatesAt(t));
    this.request();
  }

  colourBy(what: PathColour): void {
    this.what = what;
    this.parts?.path.colourBy(what);
  }

  setTheme(dark: boolean): void {
    this.isDark = dark;
    this.rebuild();
    this.show(this.t);
  }

  resize(): void {
    const { clientWidth: width, clientHeight: height } = this.element;
    if (!width || !height) return;
    this.renderer.setPixelRatio(Math.min(window.devicePixelRatio, MOST_PIXEL_RATIO));
    this.renderer.setSize(width, height);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    if (this.direction) this.lookFrom(this.direction);
    this.request();
  }

  dispose(): void {
    cancelAnimationFrame(this.frame);
    this.controls.dispose();
    free(this.scene);
    this.picture?.dispose();
    this.renderer.dispose();
    this.renderer.forceContextLoss(); // a browser allows only a few contexts
  }

  /** Everything anew, in the colours of the theme. */
  private rebuild(): void {
    const { heights, scene } = this.store;
    if (!heights) return;
    const groundAt = (x: number, y: number) => this.store.groundAt(x, y);
    const colours = palette(this.isDark);
    const isFirst = !this.parts;
    free(this.scene);
    this.scene.clear();
    this.scene.background = colours.sky;
    const { world, marks } = buildWorld(scene, heights, groundAt, this.picture, colours);
    this.parts = {
      fixed: marks,
      path: new Path(this.store, groundAt, colours),
      vehicle: new Vehicle(this.store, groundAt, colours),
      candidates: new Candidates(groundAt),
    };
    this.parts.path.colourBy(this.what);
    this.scene.add(world, this.parts.path, this.parts.vehicle, this.parts.candidates);
    if (isFirst) this.resize();
  }

  /** Puts the camera where it sees the whole area from this direction. */
  private lookFrom(direction: Direction): void {
    this.setFollowing(false);
    this.direction = direction;
    const back = DIRECTIONS[direction];
    const { middle, distance_m } = this.fitted(back);
    this.camera.position.copy(middle).addScaledVector(back, distance_m);
    this.controls.maxDistance = 4 * distance_m;
    this.controls.target.copy(middle);
    this.controls.update();
    this.request();
  }

  /** What to look at, and from how far, so that the box around the mission fills the picture. */
  private fitted(back: Vector3): { middle: Vector3; distance_m: number } {
    const corners = this.corners();
    const middle = corners[0]!.clone().add(corners[corners.length - 1]!).multiplyScalar(0.5);
    this.camera.position.copy(back);
    this.camera.lookAt(0, 0, 0);
    const right = new Vector3(1, 0, 0).applyQuaternion(this.camera.quaternion);
    const up = new Vector3(0, 1, 0).applyQuaternion(this.camera.quaternion);
    const perPixel = this.perPixel();
    const { clientWidth, clientHeight } = this.element;
    const tangent = (side_px: number) => perPixel * Math.max(side_px / 2 - MARGIN_PX, side_px / 8);
    const axes = [
      { axis: right, tangent: tangent(clientWidth) },
      { axis: up, tangent: tangent(clientHeight) },
    ];
    let distance_m = 0;
    for (let k = 0; k < FITTINGS; k++) {
      const offsets = corners.map((corner) => corner.clone().sub(middle));
      distance_m = Math.max(
        ...offsets.flatMap((d) => axes.map(({ axis, tangent }) => Math.abs(d.dot(axis)) / tangent + d.dot(back))),
      );
      for (const { axis } of axes) {
        const seen = offsets.map((d) => d.dot(axis) / (distance_m - d.dot(back)));
        middle.addScaledVector(axis, (distance_m * (Math.min(...seen) + Math.max(...seen))) / 2);
      }
    }
    return { middle, distance_m };
  }

  /** Corners of the box around the area, home and the altitude of SCAN. */
  private corners(): Vector3[] {
    const { scene, heights } = this.store;
    const places = [...scene.area_enu_m, scene.home_enu_m];
    const [x, y] = [places.map((place) => place[0]), places.map((place) => place[1])];
    const z = places.map((place) => this.store.groundAt(...place));
    const top_m = (heights?.heights_m ?? z).reduce((a, b) => Math.max(a, b)) + scene.search.scan_altitude_agl_m;
    const ends = (values: number[]) => [Math.min(...values), Math.max(...values)];
    return ends(x).flatMap((east) =>
      ends(y).flatMap((north) => [Math.min(...z), top_m].map((up) => new Vector3(east, north, up))),
    );
  }

  private setFollowing(on: boolean): void {
    this.follow.setAttribute("aria-pressed", String(on));
    this.followed = null;
    if (!on || !this.parts?.vehicle.visible) return;
    this.direction = null;
    const vehicle = this.parts.vehicle.position_enu_m;
    const distance_m = FOLLOWED_FROM * this.store.scene.search.scan_altitude_agl_m;
    this.camera.position.copy(vehicle).addScaledVector(DIRECTIONS.reset, distance_m);
    this.controls.target.copy(vehicle);
    this.followed = vehicle.clone();
    this.controls.update();
    this.request();
  }

  private keepUp(vehicle: Vector3, before: Vector3): void {
    const moved = vehicle.clone().sub(before);
    this.camera.position.add(moved);
    this.controls.target.add(moved);
    this.followed = vehicle.clone();
    this.controls.update();
  }

  private readonly onKey = (event: KeyboardEvent): void => {
    const act = this.actOf(event);
    if (!act || event.ctrlKey || event.metaKey || event.altKey) return;
    act();
    this.controls.update();
    event.preventDefault();
    event.stopPropagation(); // the page has keys of its own
  };

  private actOf({ key, shiftKey }: KeyboardEvent): (() => void) | undefined {
    const turns: Record<string, () => void> = {
      ArrowLeft: () => this.controls.rotateLeft(TURN_RAD),
      ArrowRight: () => this.controls.rotateLeft(-TURN_RAD),
      ArrowUp: () => this.controls.rotateUp(TURN_RAD),
      ArrowDown: () => this.controls.rotateUp(-TURN_RAD),
    };
    const others: Record<string, () => void> = {
      r: () => this.lookFrom("reset"),
      t: () => this.lookFrom("top"),
      s: () => this.lookFrom("side"),
      f: () => this.setFollowing(!this.followed),
      "+": () => this.controls.dollyIn(ZOOM),
      "-": () => this.controls.dollyOut(ZOOM),
    };
    return others[key.toLowerCase()] ?? (shiftKey ? turns[key] : undefined);
  }

  private request(): void {
    this.frame ||= requestAnimationFrame(() => this.draw());
  }

  private draw(): void {
    this.frame = 0;
    const { clientWidth, clientHeight } = this.element;
    if (!this.parts || !clientWidth || !clientHeight) return;
    this.camera.near = this.controls.getDistance() / 50;
    this.camera.far = this.camera.near + 3 * this.controls.maxDistance;
    this.camera.updateProjectionMatrix();
    this.parts.vehicle.fit(this.camera, this.perPixel());
    this.renderer.render(this.scene, this.camera);
    this.drawMarks(this.parts);
  }

  /** Size at distance 1 of what is seen in a CSS pixel. */
  private perPixel(): number {
    return (2 * Math.tan((FOV_DEG * Math.PI) / 360)) / this.element.clientHeight;
  }

  private drawMarks({ fixed, candidates, vehicle }: Parts): void {
    const canvas = fitCanvas(this.marks);
    const { clientWidth: width, clientHeight: height } = this.marks;
    canvas.clearRect(0, 0, width, height);
    for (const mark of [...fixed, ...candidates.marks, ...(vehicle.visible ? [vehicle.mark] : [])]) {
      const { x, y, z } = seen.copy(mark.place).project(this.camera);
      if (z < 1) mark.draw(canvas, ((1 + x) / 2) * width, ((1 - y) / 2) * height);
    }
  }
}

const seen = new Vector3();
