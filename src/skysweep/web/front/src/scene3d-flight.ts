/** What moves in the 3-D view: the flown path, the vehicle, and what its camera sees. */

import {
  BoxGeometry,
  BufferAttribute,
  Color,
  ConeGeometry,
  CylinderGeometry,
  Group,
  Mesh,
  MeshLambertMaterial,
  Vector3,
  type PerspectiveCamera,
} from "three";

import { curtain, drape, gridBorder, gridTriangles, isStraight, seenGround, wallTriangles, type GroundAt } from "./scene3d-geometry";
import { colourOfAltitude, INK, MODES, type Palette } from "./scene3d-look";
import { faces, free, Strokes, type Mark } from "./scene3d-marks";
import { label, type PathColour } from "./overlay";
import { countUpTo } from "./series";
import type { StateAt, Store } from "./store";

const SIDE = 7; // points along a side of the footprint
const LIFT_M = 0.3; // of the footprint above the ground
const CURTAIN_OPACITY = 0.3;
const DASH_M = 3;
const STRETCH_M = 10; // at most, so that the curtain follows the ground
const STRAIGHT_M = 0.15;
const MOST_STATES = 60; // of a stretch
const VEHICLE_PX = 36; // at least, on the screen
const VEHICLE_M = 1.2; // of the model, over its rotors

/**
 * The planned path, and the flown one with a curtain below it down to the ground.
 *
 * Of the flown one it draws the states between which the vehicle did not fly straight on, or in another colour.
 */
export class Path extends Group {
  private readonly planned = new Strokes(1.5);
  private readonly line = new Strokes(3);
  private readonly tip = new Strokes(3); // from the last drawn state to the present
  private readonly tipWall = new Curtain();
  private readonly wall = new Curtain();
  private plan: number[][] = [];
  private readonly drawn: number[] = []; // states
  private readonly times: number[] = []; // of those
  private taken = 0; // states
  private what: PathColour = "mode";

  constructor(
    private readonly store: Store,
    private readonly groundAt: GroundAt,
    private readonly palette: Palette,
  ) {
    super();
    this.add(this.wall, this.tipWall, this.planned, this.line, this.tip);
  }

  colourBy(what: PathColour): void {
    if (what === this.what) return;
    this.what = what;
    this.line.erase();
    this.taken = this.drawn.length = this.times.length = 0;
  }

  show(state: StateAt): void {
    this.drawPlan();
    this.takeStates();
    const last = Math.max(countUpTo(this.times, this.times.length, state.t) - 1, 0);
    this.line.show(last);
    this.wall.show(last);
    const row = this.drawn[last]!;
    const [from, to] = [this.store.position(row), state.position_enu_m];
    this.tip.erase().draw([...from, ...to], this.colourOf(row));
    [from, to].forEach((end, k) => this.tipWall.set(k, curtain(end, this.groundAt), this.colourOf(row)));
    this.tipWall.show(1);
  }

  private drawPlan(): void {
    if (this.plan === this.store.planned_enu_m) return;
    this.plan = this.store.planned_enu_m;
    const [x = 0, y = 0, z = 0] = this.plan[0] ?? [];
    const points = drape(this.plan, this.groundAt, z - this.groundAt(x, y), DASH_M);
    this.planned.erase();
    for (let k = 0; k + 6 <= points.length; k += 6) this.planned.draw(points.subarray(k, k + 6), this.palette.planned);
  }

  private takeStates(): void {
    for (; this.taken < this.store.states.length; this.taken++) {
      const from = this.drawn[this.drawn.length - 1];
      if (from === undefined) this.take(this.taken);
      else if (this.taken - 1 > from && !this.isOneStretch(from, this.taken)) this.take(this.taken - 1);
    }
  }

  private isOneStretch(from: number, to: number): boolean {
    if (!this.colourOf(from).equals(this.colourOf(to - 1))) return false;
    const rows = Array.from({ length: to - from + 1 }, (_, k) => this.store.position(from + k));
    const [a, b] = [rows[0]!, rows[rows.length - 1]!];
    return rows.length <= MOST_STATES && Math.hypot(b[0] - a[0], b[1] - a[1]) <= STRETCH_M && isStraight(rows, STRAIGHT_M);
  }

  private take(row: number): void {
    const before = this.drawn[this.drawn.length - 1];
    const here = this.store.position(row);
    if (before !== undefined) this.line.draw([...this.store.position(before), ...here], this.colourOf(before));
    this.wall.set(this.drawn.length, curtain(here, this.groundAt), this.colourOf(row));
    this.drawn.push(row);
    this.times.push(this.store.time(row));
  }

  private colourOf(row: number): Color {
    if (this.what === "mode") return MODES[this.store.mode(row)];
    const [x, y, z] = this.store.position(row);
    return colourOfAltitude(z - this.groundAt(x, y), this.store.scene.search.scan_altitude_agl_m);
  }
}

/** A wall below a path of any number of points, in buffers that grow. */
class Curtain extends Group {
  private mesh = translucentWall(4);

  constructor() {
    super();
    this.add(this.mesh);
  }

  /** Sets one point's pair (2 x 3). */
  set(k: number, pair: Float32Array, colour: Color): void {
    if (2 * k + 1 >= this.attributes.position.count) this.grow(2 * (k + 1));
    const { position, color } = this.attributes;
    position.set(pair, 6 * k);
    for (const end of [0, 1]) color.setXYZW(2 * k + end, colour.r, colour.g, colour.b, CURTAIN_OPACITY);
    position.needsUpdate = color.needsUpdate = true;
  }

  /** Shows the first `n` panels. */
  show(n: number): void {
    this.mesh.geometry.setDrawRange(0, 6 * n);
  }

  private get attributes(): Record<"position" | "color", BufferAttribute> {
    return this.mesh.geometry.attributes as Record<"position" | "color", BufferAttribute>;
  }

  private grow(points: number): void {
    const before = this.attributes;
    this.remove(this.mesh);
    free(this.mesh);
    this.mesh = translucentWall(points);
    this.add(this.mesh);
    for (const name of ["position", "color"] as const) this.attributes[name].set(before[name].array);
  }
}

function translucentWall(points: number) {
  return faces(new Float32Array(6 * points), wallTriangles(points), { colours: new Float32Array(8 * points) });
}

/** The vehicle with its altitude above the ground, and the frustum of its camera. */
export class Vehicle extends Group {
  private readonly model: Group;
  private altitude_agl_m = 0;
  private readonly rays = new Strokes(1.5);
  private readonly drop = new Strokes(1.5);
  private readonly footprint;

  constructor(
    private readonly store: Store,
    private readonly groundAt: GroundAt,
    private readonly palette: Palette,
  ) {
    super();
    const look = { colour: palette.camera, opacity: 0.28 };
    this.footprint = faces(new Float32Array(3 * SIDE * SIDE), gridTriangles(SIDE, SIDE), look);
    this.model = quadrotor(palette);
    this.add(this.footprint, this.rays, this.drop, this.model);
  }

  show(state: StateAt): void {
    const [x, y, z] = state.position_enu_m;
    const ground_m = this.groundAt(x, y);
    this.model.position.set(x, y, z);
    this.model.rotation.z = Math.atan2(state.heading_en[1], state.heading_en[0]);
    this.altitude_agl_m = Math.max(z - ground_m, 0);
    this.drop.erase().draw([x, y, z, x, y, ground_m], this.palette.ink);
    this.look(state);
  }

  /** Keeps the model large enough to be seen where a CSS pixel is `perPixel` high at distance 1. */
  fit(camera: PerspectiveCamera, perPixel: number): void {
    const wanted_m = VEHICLE_PX * perPixel * camera.position.distanceTo(this.model.position);
    this.model.scale.setScalar(Math.max(1, wanted_m / VEHICLE_M));
  }

  private look(state: StateAt): void {
    const seen = seenGround(state, this.store.scene.camera, this.groundAt, SIDE);
    for (let k = 2; k < seen.length; k += 3) seen[k]! += LIFT_M;
    const position = this.footprint.geometry.attributes["position"] as BufferAttribute;
    position.set(seen);
    position.needsUpdate = true;
    const point = (k: number) => seen.subarray(3 * k, 3 * k + 3);
    this.rays.erase().draw(gridBorder(SIDE, SIDE).flatMap((k) => [...point(k)]), this.palette.camera);
    for (const corner of [0, SIDE - 1, SIDE * (SIDE - 1), SIDE * SIDE - 1]) {
      this.rays.draw([...state.camera_enu_m, ...point(corner)], this.palette.camera);
    }
  }

  get position_enu_m(): Vector3 {
    return this.model.position;
  }

  /** Its altitude above the ground, in words. */
  get mark(): Mark {
    const draw = (canvas: CanvasRenderingContext2D, u: number, v: number) =>
      label(canvas, `${this.altitude_agl_m.toFixed(0)} m`, u + VEHICLE_PX / 2, v - VEHICLE_PX / 2, INK, "600 13px");
    return { place: this.position_enu_m, draw };
  }
}

/** A quadrotor that looks along x: its nose and front rotors have the footprint's colour. */
function quadrotor(palette: Palette): Group {
  const dark = new MeshLambertMaterial({ color: palette.body });
  const bright = new MeshLambertMaterial({ color: palette.camera });
  const rotor = new CylinderGeometry(0.24, 0.24, 0.04, 20).rotateX(Math.PI / 2);
  const arm = new BoxGeometry(1, 0.06, 0.05);
  const model = new Group();
  const put = (mesh: Mesh, x: number, y: number, z: number, yaw = 0) => {
    mesh.position.set(x, y, z);
    mesh.rotation.z = yaw;
    model.add(mesh);
  };
  put(new Mesh(new BoxGeometry(0.36, 0.24, 0.14), dark), 0, 0, 0);
  put(new Mesh(new ConeGeometry(0.09, 0.26, 12).rotateZ(-Math.PI / 2), bright), 0.3, 0, 0);
  for (const [x, y] of [[1, 1], [1, -1], [-1, -1], [-1, 1]] as const) {
    put(new Mesh(rotor, x > 0 ? bright : dark), 0.36 * x, 0.36 * y, 0.08);
  }
  for (const yaw of [Math.PI / 4, -Math.PI / 4]) put(new Mesh(arm, dark), 0, 0, 0.03, yaw);
  return model;
}
