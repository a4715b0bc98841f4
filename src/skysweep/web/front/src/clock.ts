/** The time that is shown: it stands, plays at a speed, or follows the present of a live mission. */

export const SPEEDS = [0.5, 1, 2, 5, 10, 20, 50, 100] as const;
const CATCH_UP_S = 0.4; // wall time in which it closes most of the gap to the present

export class Clock {
  t = 0;
  playing = false;
  following = false;
  speed = 10;

  /** The newest time there is. */
  end_s = 0;

  /** Moves on by a stretch of wall time. */
  step(wall_s: number): void {
    if (this.following) {
      this.t += (this.end_s - this.t) * Math.min(1, wall_s / CATCH_UP_S);
      if (this.end_s - this.t < 0.02) this.t = this.end_s;
    } else if (this.playing) {
      this.t += wall_s * this.speed;
      if (this.t >= this.end_s) {
        this.t = this.end_s;
        this.playing = false;
      }
    }
  }

  /** Goes to a time and stays there, or plays on from there. */
  goTo(t: number): void {
    this.t = Math.min(Math.max(t, 0), this.end_s);
    this.following = false;
  }

  toggle(): void {
    if (this.playing || this.following) this.playing = this.following = false;
    else {
      if (this.t >= this.end_s) this.t = 0;
      this.playing = true;
    }
  }

  follow(): void {
    this.following = true;
    this.playing = false;
  }

  faster(steps: number): void {
    const k = SPEEDS.findIndex((speed) => speed >= this.speed);
    this.speed = SPEEDS[Math.min(Math.max(k + steps, 0), SPEEDS.length - 1)]!;
  }
}
