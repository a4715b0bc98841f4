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

import { curtain, drape, gridBorder, gridTriangles, seenGround, wallTriangles, type GroundAt } from "./scene3d-geometry";
import { colourOfAltitude, MODES, type Palette } from "./scene3d-look";
import { faces, free, Label, Strokes } from "./scene3d-marks";
import type { PathColour } from "./overlay";
import type { StateAt, Store } from "./store";

const SIDE = 7; // points along a side of the footprint
const LIFT_M = 0.3; // of the footprint above the ground
const CURTAIN_OPACITY = 0.3;
const DASH_M = 3;
const VEHICLE_PX = 36; // at least, on the screen
const VEHICLE_M = 1.2; // of the model, over its rotors

/** The planned path, and the flown one with a curtain below it down to the ground. */
export class Path extends Group {
  private readonly planned = new Strokes(1.5);
  private plan: number[][] = [];
  private readonly line = new Strokes(3);
  private readonly tip = new Strokes(3);
  private wall = new Curtain(256);
  private rows = 0; // states drawn
  private what: PathColour = "mode";

  constructor(
    private readonly store: Store,
    private readonly groundAt: GroundAt,
    private readonly palette: Palette,
  ) {
    super();
    this.add(this.wall, this.planned, this.line, this.tip);
  }

  colourBy(what: PathColour): void {
    this.what = what;
    this.rows = 0;
    this.line.erase();
  }

  show(state: StateAt): void {
    this.grow();
    const flown = this.store.countStates(state.t);
    const last = Math.max(flown - 1, 0);
    this.line.show(last);
    this.wall.show(last);
    this.tip.erase().draw([...this.store.position(last), ...state.position_enu_m], this.colourOf(last));
  }

  private grow(): void {
    const { store } = this;
    if (this.plan !== store.planned_enu_m) {
      this.plan = store.planned_enu_m;
      const [x = 0, y = 0, z = 0] = this.plan[0] ?? [];
      const points = drape(this.plan, this.groundAt, z - this.groundAt(x, y), DASH_M);
      this.planned.erase();
      for (let k = 0; k + 6 <= points.length; k += 6) this.planned.draw(points.subarray(k, k + 6), this.palette.planned);
    }
    if (store.states.length > this.wall.capacity) {
      this.remove(this.wall);
      free(this.wall);
      this.add((this.wall = new Curtain(2 * store.states.length)));
      this.rows = 0;
      this.line.erase();
    }
    for (; this.rows < store.states.length; this.rows++) {
      const row = this.rows;
      const here = store.position(row);
      if (row > 0) this.line.draw([...store.position(row - 1), ...here], this.colourOf(row - 1));
      this.wall.set(row, curtain(here, this.groundAt), this.colourOf(row));
    }
  }

  private colourOf(row: number): Color {
    if (this.what === "mode") return MODES[this.store.mode(row)];
    const [x, y, z] = this.store.position(row);
    return colourOfAltitude(z - this.groundAt(x, y), this.store.scene.search.scan_altitude_agl_m);
  }
}

/** A wall below a path of up to `capacity` points. */
class Curtain extends Group {
  private readonly mesh;

  constructor(readonly capacity: number) {
    super();
    this.mesh = faces(new Float32Array(6 * capacity), wallTriangles(capacity), {
      colours: new Float32Array(8 * capacity),
    });
    this.add(this.mesh);
  }

  /** Sets one point's pair (2 x 3). */
  set(k: number, pair: Float32Array, colour: Color): void {
    const { position, color } = this.mesh.geometry.attributes as Record<"position" | "color", BufferAttribute>;
    position.set(pair, 6 * k);
    for (const end of [0, 1]) color.setXYZW(2 * k + end, colour.r, colour.g, colour.b, CURTAIN_OPACITY);
    position.needsUpdate = color.needsUpdate = true;
  }

  /** Shows the first `n` panels. */
  show(n: number): void {
    this.mesh.geometry.setDrawRange(0, 6 * n);
  }
}

/** The vehicle with its altitude above the ground, and the frustum of its camera. */
export class Vehicle extends Group {
  private readonly model: Group;
  private readonly altitude: Label;
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
    this.altitude = new Label(palette, "", 0);
    this.altitude.center.set(0.5, -1);
    this.add(this.footprint, this.rays, this.drop, this.model, this.altitude);
  }

  show(state: StateAt): void {
    const [x, y, z] = state.position_enu_m;
    const ground_m = this.groundAt(x, y);
    this.model.position.set(x, y, z);
    this.model.rotation.z = Math.atan2(state.heading_en[1], state.heading_en[0]);
    this.altitude.position.set(x, y, z);
    this.altitude.say(`${Math.max(z - ground_m, 0).toFixed(0)} m`);
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
