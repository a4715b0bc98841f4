import { expect, it } from "vitest";
import { thinned } from "./thin";

const same = () => 0;
const line = (...places: [number, number][]) => places.flat();

it("leaves out what lies on a straight line", () => {
  const points = line([0, 0], [10, 0], [20, 0.1], [30, 0], [30, 10], [30, 20]);
  expect(thinned(points, same, 0.5)).toEqual([0, 3, 5]);
});

it("keeps turns back, changes of colour, and the ends", () => {
  expect(thinned(line([0, 0], [10, 0], [20, 0], [5, 0], [0, 0]), same, 0.5)).toEqual([0, 2, 4]);
  expect(thinned(line([0, 0], [10, 0], [20, 0], [30, 0]), (k) => k >= 2, 0.5)).toEqual([0, 1, 2, 3]);
  expect(thinned(line([7, 7]), same, 0.5)).toEqual([0]);
  expect(thinned([], same, 0.5)).toEqual([]);
});

it("stays near every point of a curve", () => {
  const points = Array.from({ length: 2000 }, (_, k) => [100 * Math.cos(k / 300), 100 * Math.sin(k / 300)] as [number, number]);
  const kept = thinned(points.flat(), same, 0.5);
  expect(kept.length).toBeLessThan(300);
  for (let k = 0, j = 0; k < points.length; k++) {
    while (kept[j + 1]! < k) j++;
    const [a, b, p] = [points[kept[j]!]!, points[kept[j + 1] ?? kept[j]!]!, points[k]!];
    const length = Math.hypot(b[0] - a[0], b[1] - a[1]) || 1;
    const off = Math.abs((p[0] - a[0]) * (b[1] - a[1]) - (p[1] - a[1]) * (b[0] - a[0])) / length;
    expect(off).toBeLessThan(1.1);
  }
});
