/** What stands still in the 3-D view: the ground, what grows and stands on it, borders, and the scale of altitudes. */

import {
  AmbientLight,
  BoxGeometry,
  BufferAttribute,
  BufferGeometry,
  Color,
  ConeGeometry,
  CylinderGeometry,
  DirectionalLight,
  DoubleSide,
  Group,
  IcosahedronGeometry,
  InstancedMesh,
  Matrix4,
  Mesh,
  MeshBasicMaterial,
  MeshLambertMaterial,
  Quaternion,
  Vector3,
  type Texture,
} from "three";

import { label } from "./overlay";
import { closed, curtain, drape, gridBorder, gridTriangles, niceStep, wallTriangles } from "./scene3d-geometry";
import type { GroundAt } from "./scene3d-geometry";
import { INK, MODES, type Palette } from "./scene3d-look";
import { faces, Strokes, type Mark } from "./scene3d-marks";
import type { Heights, Scene, SceneObject, XY } from "./types";

const LIFT_M = 0.4; // of lines above the ground
const CROWN_FROM = 0.35; // of a tree's height
const EAVES_M = 0.4;
const UP = new Vector3(0, 0, 1);

/** Returns what is in the world, and the marks on it. */
export function buildWorld(
  scene: Scene,
  heights: Heights,
  groundAt: GroundAt,
  picture: Texture | null,
  palette: Palette,
): { world: Group; marks: Mark[] } {
  const world = new Group();
  const sun = new DirectionalLight(0xffffff, 2.2);
  sun.position.set(-1, -2, 3);
  world.add(new AmbientLight(0xffffff, 1.6), sun);
  world.add(terrain(heights, picture, palette), ...objects(scene.objects, palette));

  const outline = new Strokes(2.5);
  for (const ring of [scene.area_enu_m, ...scene.holes_enu_m]) {
    outline.draw(drape(closed(ring), groundAt, LIFT_M), palette.area);
  }
  world.add(outline);
  const ceiling_m = scene.altitude_max_agl_m;
  for (const zone of scene.no_fly_enu_m) world.add(...wall(zone, groundAt, ceiling_m, palette.noFly, 0.42));
  if (scene.geofence_enu_m) world.add(...wall(scene.geofence_enu_m, groundAt, ceiling_m, palette.fence, 0.08));

  const scale = altitudeScale(scene, groundAt, palette);
  world.add(scale.pole);
  return { world, marks: [...scale.marks, home(scene.home_enu_m, groundAt)] };
}

/** The ground as a block: its picture above, its edges down to below the lowest place. */
function terrain(heights: Heights, picture: Texture | null, palette: Palette): Group {
  const { rows, columns, bounds_enu_m, heights_m } = heights;
  const [west, south, east, north] = bounds_enu_m;
  const positions = new Float32Array(3 * rows * columns);
  const uvs = new Float32Array(2 * rows * columns);
  let lowest = Infinity;
  for (let r = 0, k = 0; r < rows; r++) {
    for (let c = 0; c < columns; c++, k++) {
      const [u, v] = [c / (columns - 1), r / (rows - 1)];
      const z = heights_m[k]!;
      lowest = Math.min(lowest, z);
      positions.set([west + u * (east - west), south + v * (north - south), z], 3 * k);
      uvs.set([u, v], 2 * k);
    }
  }
  const top = new BufferGeometry();
  top.setAttribute("position", new BufferAttribute(positions, 3));
  top.setAttribute("uv", new BufferAttribute(uvs, 2));
  top.setIndex(new BufferAttribute(gridTriangles(rows, columns), 1));
  top.computeVertexNormals();
  const behind = { polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 4 };
  const surface = picture
    ? new MeshBasicMaterial({ map: picture, ...behind })
    : new MeshLambertMaterial({ color: palette.ground, ...behind });

  const edge: number[] = [];
  const border = gridBorder(rows, columns);
  for (const k of border) edge.push(positions[3 * k]!, positions[3 * k + 1]!, positions[3 * k + 2]!);
  const base = lowest - 0.02 * Math.max(east - west, north - south);
  const sides = faces(curtain(edge, () => base), wallTriangles(border.length), {
    colour: palette.block,
    opacity: 1,
  });
  sides.material.transparent = false;
  sides.material.depthWrite = true;
  const block = new Group();
  block.add(new Mesh(top, surface), sides);
  return block;
}

/** All trees and buildings: one mesh for each shape. */
function objects(all: readonly SceneObject[], palette: Palette): InstancedMesh[] {
  const trees = all.filter((o) => o.kind === "tree");
  const conifers = trees.filter((o) => o.shape === "conifer");
  const others = trees.filter((o) => o.shape !== "conifer");
  const buildings = all.filter((o) => o.kind === "building");
  const upright = (geometry: BufferGeometry) => geometry.rotateX(Math.PI / 2).translate(0, 0, 0.5);
  const crown = (o: SceneObject) =>
    placed(o, [0, 0, CROWN_FROM * o.size_m[2]], [o.size_m[0], o.size_m[1], (1 - CROWN_FROM) * o.size_m[2]]);
  return [
    many(upright(new CylinderGeometry(0.5, 0.5, 1, 6)), palette.trunk, trees, (o) => {
      const thick = 0.04 * o.size_m[2];
      return placed(o, [0, 0, 0], [thick, thick, 0.6 * o.size_m[2]]);
    }),
    many(upright(new ConeGeometry(0.5, 1, 9)), palette.conifer, conifers, crown),
    many(new IcosahedronGeometry(0.5, 1).translate(0, 0, 0.5), palette.broadleaf, others, crown),
    many(new BoxGeometry(1, 1, 1).translate(0, 0, 0.5), palette.wall, buildings, (o) => placed(o, [0, 0, 0], o.size_m)),
    many(gable(), palette.roof, buildings, (o) => {
      const [length, width, height] = o.size_m;
      return placed(o, [0, 0, height], [length + 2 * EAVES_M, width + 2 * EAVES_M, GABLE * width]);
    }),
  ].filter((mesh) => mesh.count > 0);
}

const GABLE = 0.35; // rise of a roof, of its house's width

/** A roof of size 1 whose ridge runs along x. */
function gable(): BufferGeometry {
  const [a, b, c, d] = [[-0.5, -0.5, 0], [0.5, -0.5, 0], [0.5, 0.5, 0], [-0.5, 0.5, 0]] as const;
  const [e, f] = [[-0.5, 0, 1], [0.5, 0, 1]] as const;
  const triangles = [a, b, f, a, f, e, c, d, e, c, e, f, b, c, f, d, a, e];
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(new Float32Array(triangles.flat()), 3));
  geometry.computeVertexNormals();
  return geometry;
}

function placed(o: SceneObject, offset_m: readonly number[], scale: readonly number[]): Matrix4 {
  const at = new Vector3(...o.position_enu_m).add(new Vector3(...offset_m));
  const turn = new Quaternion().setFromAxisAngle(UP, o.yaw_rad);
  return new Matrix4().compose(at, turn, new Vector3(...scale));
}

/** One mesh at many places, in slightly different tones. */
function many(
  geometry: BufferGeometry,
  colour: Color,
  all: readonly SceneObject[],
  place: (o: SceneObject) => Matrix4,
): InstancedMesh {
  const mesh = new InstancedMesh(geometry, new MeshLambertMaterial({ flatShading: true, side: DoubleSide }), all.length);
  all.forEach((o, k) => {
    mesh.setMatrixAt(k, place(o));
    mesh.setColorAt(k, colour.clone().multiplyScalar(0.85 + 0.3 * ((k * 0.618) % 1)));
  });
  return mesh;
}

/** A translucent wall from the ground up, which fades towards its top. */
function wall(ring: readonly XY[], groundAt: GroundAt, height_m: number, colour: Color, opacity: number): [Mesh, Strokes] {
  const top = drape(closed(ring), groundAt, height_m);
  const n = top.length / 3;
  const colours = new Float32Array(8 * n);
  for (let k = 0; k < n; k++) {
    colours.set([...colour.toArray(), 0.25 * opacity, ...colour.toArray(), opacity], 8 * k);
  }
  const edges = new Strokes(2).draw(drape(closed(ring), groundAt, LIFT_M), colour).draw(top, colour);
  for (const [x, y] of ring) edges.draw([x, y, groundAt(x, y), x, y, groundAt(x, y) + height_m], colour);
  return [faces(curtain(top, groundAt), wallTriangles(n), { colours }), edges];
}

/** A pole in the south-east with the altitudes above the ground there, and those of SCAN and CHECK. */
function altitudeScale(scene: Scene, groundAt: GroundAt, palette: Palette): { pole: Strokes; marks: Mark[] } {
  const corners = [...scene.area_enu_m, scene.home_enu_m];
  const [x, y] = [Math.max(...corners.map((c) => c[0])), Math.min(...corners.map((c) => c[1]))];
  const foot = groundAt(x, y);
  const { scan_altitude_agl_m: scan_m, check_altitude_agl_m: check_m } = scene.search;
  const step = niceStep(scan_m, 4);
  const top_m = step * (Math.ceil(scan_m / step) + 1);
  const tick_m = 0.05 * top_m;
  const pole = new Strokes(2.5).draw([x, y, foot, x, y, foot + top_m], palette.ink);
  const marks: Mark[] = [];
  const mark = (words: string, altitude_m: number, side: -1 | 1, colour: Color) => {
    pole.draw([x, y, foot + altitude_m, x + side * tick_m, y, foot + altitude_m], colour);
    marks.push({
      place: new Vector3(x + side * 1.4 * tick_m, y, foot + altitude_m),
      draw: (canvas, u, v) => {
        canvas.font = "600 12px system-ui, sans-serif";
        const left = side < 0 ? u - canvas.measureText(words).width : u;
        label(canvas, words, left, v, INK, "600 12px");
      },
    });
  };
  for (let altitude_m = step; altitude_m <= top_m; altitude_m += step) mark(`${altitude_m} m`, altitude_m, 1, palette.ink);
  mark(`SCAN ${scan_m} m`, scan_m, -1, MODES.SCAN);
  mark(`CHECK ${check_m} m`, check_m, -1, MODES.CHECK);
  return { pole, marks };
}

function home([x, y]: XY, groundAt: GroundAt): Mark {
  return {
    place: new Vector3(x, y, groundAt(x, y)),
    draw: (canvas, u, v) => {
      canvas.beginPath();
      canvas.rect(u - 6, v - 6, 12, 12);
      canvas.fillStyle = "#ffffff";
      canvas.strokeStyle = INK;
      canvas.lineWidth = 2;
      canvas.setLineDash([]);
      canvas.fill();
      canvas.stroke();
      label(canvas, "H", u, v, INK, "700 10px", false);
    },
  };
}
