/** Candidates in the 3-D view: the map's mark and number for each, and the ellipse of its place on the ground. */

import { Group } from "three";

import { drawStatus } from "./overlay";
import { drape, ellipseRing, type GroundAt } from "./scene3d-geometry";
import { STATUSES, type Palette } from "./scene3d-look";
import { Badge, free, Strokes, write } from "./scene3d-marks";
import type { CandidateAt, Status } from "./store";

const LIFT_M = 0.35; // of an ellipse above the ground
const CORNERS = 40; // of an ellipse

export class Candidates extends Group {
  private readonly ellipses = new Strokes(2);
  private readonly marks = new Map<number, { mark: Badge; status: Status }>();
  private shown: CandidateAt[] = [];

  constructor(
    private readonly groundAt: GroundAt,
    private readonly palette: Palette,
  ) {
    super();
    this.add(this.ellipses);
  }

  show(now: CandidateAt[]): void {
    if (now.length === this.shown.length && now.every((candidate, k) => isSame(candidate, this.shown[k]!))) return;
    this.shown = now;
    this.ellipses.erase();
    for (const { mark } of this.marks.values()) mark.visible = false;
    for (const candidate of now) {
      const [x = 0, y = 0] = candidate.position_enu_m;
      const mark = this.markOf(candidate);
      mark.visible = true;
      mark.position.set(x, y, this.groundAt(x, y));
      if (!candidate.covariance_m2) continue;
      const ring = ellipseRing([x, y], candidate.covariance_m2, CORNERS);
      this.ellipses.draw(drape(ring, this.groundAt, LIFT_M), STATUSES[candidate.status]);
    }
  }

  private markOf({ id, status }: CandidateAt): Badge {
    const known = this.marks.get(id);
    if (known?.status === status) return known.mark;
    if (known) {
      this.remove(known.mark);
      free(known.mark);
    }
    const mark = new Badge(64, 36, (canvas) => {
      drawStatus(canvas, status, 32, 18);
      write(canvas, String(id), 41, 9, this.palette, 11);
    });
    this.marks.set(id, { mark, status });
    this.add(mark);
    return mark;
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
