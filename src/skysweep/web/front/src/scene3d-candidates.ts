/** Candidates in the 3-D view: the map's mark and number for each, and the ellipse of its place on the ground. */

import { Group, Vector3 } from "three";

import { drawStatus, label } from "./overlay";
import { drape, ellipseRing, type GroundAt } from "./scene3d-geometry";
import { INK, STATUSES } from "./scene3d-look";
import { Strokes, type Mark } from "./scene3d-marks";
import type { CandidateAt } from "./store";

const LIFT_M = 0.35; // of an ellipse above the ground
const CORNERS = 24; // of an ellipse

/** What is drawn of a candidate as it was at some time. */
interface Drawn {
  of: CandidateAt;
  mark: Mark;
  ring: Float32Array;
}

export class Candidates extends Group {
  marks: Mark[] = [];
  private readonly ellipses = new Strokes(2);
  private readonly drawn = new Map<number, Drawn>();

  constructor(private readonly groundAt: GroundAt) {
    super();
    this.add(this.ellipses);
  }

  show(now: readonly CandidateAt[]): void {
    let changed = now.length !== this.marks.length;
    for (const candidate of now) {
      const before = this.drawn.get(candidate.id);
      if (before && isSame(before.of, candidate)) continue;
      this.drawn.set(candidate.id, this.drawingOf(candidate));
      changed = true;
    }
    if (!changed) return;
    const all = now.map(({ id }) => this.drawn.get(id)!);
    this.marks = all.map(({ mark }) => mark);
    this.ellipses.erase();
    for (const { of, ring } of all) this.ellipses.draw(ring, STATUSES[of.status]);
  }

  private drawingOf(of: CandidateAt): Drawn {
    const [x = 0, y = 0] = of.position_enu_m;
    const mark: Mark = {
      place: new Vector3(x, y, this.groundAt(x, y)),
      draw: (canvas, u, v) => {
        drawStatus(canvas, of.status, u, v);
        label(canvas, String(of.id), u + 9, v - 9, INK, "600 11px");
      },
    };
    const places = of.covariance_m2 ? ellipseRing([x, y], of.covariance_m2, CORNERS) : [];
    return { of, mark, ring: drape(places, this.groundAt, LIFT_M) };
  }
}

function isSame(a: CandidateAt, b: CandidateAt): boolean {
  return (
    a.id === b.id &&
    a.status === b.status &&
    a.position_enu_m === b.position_enu_m &&
    a.covariance_m2 === b.covariance_m2
  );
}
