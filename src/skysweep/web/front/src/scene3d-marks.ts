/** What the 3-D view draws with: lines that are pixels wide, translucent faces, and marks over the picture. */

import {
  BufferAttribute,
  BufferGeometry,
  DoubleSide,
  Mesh,
  MeshBasicMaterial,
  type Color,
  type Object3D,
  type Vector3,
} from "three";
import { LineMaterial } from "three/addons/lines/LineMaterial.js";
import { LineSegments2 } from "three/addons/lines/LineSegments2.js";
import { LineSegmentsGeometry } from "three/addons/lines/LineSegmentsGeometry.js";

/** Any number of straight pieces, kept in buffers that grow. */
export class Strokes extends LineSegments2 {
  private ends = new Float32Array(0); // x, y, z of both ends of each piece
  private colours = new Float32Array(0); // r, g, b of both ends of each piece
  private n = 0;

  constructor(width_px: number, opacity = 1) {
    const transparent = opacity < 1;
    const looks = { linewidth: width_px, vertexColors: true, transparent, opacity, depthWrite: !transparent };
    super(new LineSegmentsGeometry(), new LineMaterial(looks));
    this.frustumCulled = false;
    this.reserve(32);
    this.show(0);
  }

  erase(): this {
    this.n = 0;
    this.show(0);
    return this;
  }

  /** Adds a line through packed points. */
  draw(points: ArrayLike<number>, colour: Color): this {
    const pieces = Math.max(0, points.length / 3 - 1);
    this.reserve(this.n + pieces);
    for (let k = 0; k < pieces; k++, this.n++) {
      for (let i = 0; i < 6; i++) this.ends[6 * this.n + i] = points[3 * k + i]!;
      colour.toArray(this.colours, 6 * this.n);
      colour.toArray(this.colours, 6 * this.n + 3);
    }
    for (const name of ["instanceStart", "instanceColorStart"]) this.geometry.attributes[name]!.needsUpdate = true;
    this.show(this.n);
    return this;
  }

  /** Shows the first `n` pieces. */
  show(n: number): void {
    this.geometry.instanceCount = Math.min(n, this.n);
    this.visible = this.geometry.instanceCount > 0;
  }

  private reserve(pieces: number): void {
    if (6 * pieces <= this.ends.length) return;
    const size = 12 * pieces;
    const [ends, colours] = [new Float32Array(size), new Float32Array(size)];
    ends.set(this.ends);
    colours.set(this.colours);
    [this.ends, this.colours] = [ends, colours];
    this.geometry.dispose();
    this.geometry = new LineSegmentsGeometry().setPositions(ends).setColors(colours);
  }
}

/** Triangles without light. `colours` are r, g, b, alpha of each point; without them, one colour is everywhere. */
export function faces(
  positions: Float32Array,
  indices: Uint32Array,
  look: { colour: Color; opacity: number } | { colours: Float32Array },
): Mesh<BufferGeometry, MeshBasicMaterial> {
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(positions, 3));
  geometry.setIndex(new BufferAttribute(indices, 1));
  const material = new MeshBasicMaterial({ side: DoubleSide, transparent: true, depthWrite: false });
  if ("colours" in look) {
    geometry.setAttribute("color", new BufferAttribute(look.colours, 4));
    material.vertexColors = true;
  } else {
    material.color.copy(look.colour);
    material.opacity = look.opacity;
  }
  const mesh = new Mesh(geometry, material);
  mesh.frustumCulled = false;
  return mesh;
}

/** Something that keeps its size: drawn beside (u, v), the pixel in which its place is seen. */
export interface Mark {
  place: Vector3;
  draw(canvas: CanvasRenderingContext2D, u: number, v: number): void;
}

/** Frees what an object and its children hold on the graphics device. */
export function free(root: Object3D): void {
  root.traverse((node) => {
    const { geometry, material } = node as Partial<Mesh<BufferGeometry, MeshBasicMaterial>>;
    geometry?.dispose();
    material?.dispose();
  });
}
