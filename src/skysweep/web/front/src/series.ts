/** Things in the order of their times, found by binary search. */

/** How many of the sorted times are at or before `t`. */
export function countUpTo(times: ArrayLike<number>, length: number, t: number): number {
  let low = 0;
  let high = length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (times[middle]! <= t) low = middle + 1;
    else high = middle;
  }
  return low;
}

export class Series<T> {
  readonly times: number[] = [];
  readonly items: T[] = [];

  get length(): number {
    return this.items.length;
  }

  /** Inserts after everything at or before `t`; nearly always at the end. */
  add(t: number, item: T): void {
    const last = this.times[this.times.length - 1];
    if (last === undefined || last <= t) {
      this.times.push(t);
      this.items.push(item);
      return;
    }
    const k = countUpTo(this.times, this.times.length, t);
    this.times.splice(k, 0, t);
    this.items.splice(k, 0, item);
  }

  /** How many are at or before `t`. */
  count(t: number): number {
    return countUpTo(this.times, this.times.length, t);
  }

  /** The newest at or before `t`. */
  at(t: number): T | undefined {
    return this.items[this.count(t) - 1];
  }
}

/** Rows of `width` numbers in one growing buffer. */
export class Rows {
  data: Float64Array;
  length = 0;

  constructor(readonly width: number) {
    this.data = new Float64Array(width * 1024);
  }

  push(values: ArrayLike<number>): void {
    const start = this.length * this.width;
    if (start + this.width > this.data.length) {
      const larger = new Float64Array(this.data.length * 2);
      larger.set(this.data);
      this.data = larger;
    }
    for (let k = 0; k < this.width; k++) this.data[start + k] = values[k] ?? NaN;
    this.length++;
  }

  get(row: number, column: number): number {
    return this.data[row * this.width + column]!;
  }
}
