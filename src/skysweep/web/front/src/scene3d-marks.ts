/** What the 3-D view draws with: lines and labels that are pixels large, and translucent faces. */

import {
  BufferAttribute,
  BufferGeometry,
  CanvasTexture,
  Color,
  DoubleSide,
  Mesh,
  MeshBasicMaterial,
  Sprite,
  SpriteMaterial,
  SRGBColorSpace,
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

/** Draws on a canvas, in CSS pixels. */
type Draw = (canvas: CanvasRenderingContext2D) => void;

const PIXELS = 2; // of a canvas in a CSS pixel
const HALO_PX = 3.5;

/** Writes words with a halo, from the left. */
export function write(
  canvas: CanvasRenderingContext2D,
  words: string,
  u: number,
  v: number,
  look: { ink: Color; halo: Color },
  size_px: number,
): void {
  canvas.font = `600 ${size_px}px system-ui, sans-serif`;
  canvas.textBaseline = "middle";
  canvas.lineJoin = "round";
  canvas.lineWidth = HALO_PX;
  canvas.strokeStyle = look.halo.getStyle();
  canvas.fillStyle = look.ink.getStyle();
  canvas.strokeText(words, u, v);
  canvas.fillText(words, u, v);
}

/** A picture that keeps its size on the screen. */
export class Badge extends Sprite {
  constructor(
    private readonly width_px: number,
    private readonly height_px: number,
    draw: Draw,
  ) {
    super(new SpriteMaterial({ sizeAttenuation: false, depthTest: false, depthWrite: false, transparent: true }));
    this.renderOrder = 10;
    this.draw(draw);
  }

  draw(draw: Draw): void {
    const canvas = document.createElement("canvas");
    canvas.width = PIXELS * this.width_px;
    canvas.height = PIXELS * this.height_px;
    const context = canvas.getContext("2d")!;
    context.scale(PIXELS, PIXELS);
    draw(context);
    this.material.map?.dispose();
    this.material.map = new CanvasTexture(canvas);
    this.material.map.colorSpace = SRGBColorSpace;
    this.material.map.generateMipmaps = false;
  }

  /** Keeps its size when a CSS pixel is `perPixel` high at distance 1. */
  fit(perPixel: number): void {
    this.scale.set(this.width_px * perPixel, this.height_px * perPixel, 1);
  }
}

const LABEL_PX = [108, 20] as const; // width and height
const ALIGNED = { "-1": "right", 0: "center", 1: "left" } as const;

/** Words on the screen, one short line: left of a place (-1), about it (0), or right of it (1). */
export class Label extends Badge {
  private words = "";

  constructor(
    private readonly look: { ink: Color; halo: Color },
    words: string,
    private readonly side: -1 | 0 | 1,
  ) {
    super(...LABEL_PX, () => {});
    this.center.x = (1 - side) / 2;
    this.say(words);
  }

  say(words: string): void {
    if (words === this.words) return;
    this.words = words;
    this.draw((canvas) => {
      canvas.textAlign = ALIGNED[this.side];
      const inside_px = LABEL_PX[0] / 2 - HALO_PX;
      write(canvas, words, LABEL_PX[0] / 2 - this.side * inside_px, LABEL_PX[1] / 2, this.look, 12);
    });
  }
}

/** Frees what an object and its children hold on the graphics device. */
export function free(root: { traverse(visit: (node: object) => void): void }): void {
  root.traverse((node) => {
    const { geometry, material } = node as Partial<Mesh<BufferGeometry, MeshBasicMaterial>>;
    geometry?.dispose();
    material?.map?.dispose();
    material?.dispose();
  });
}
