import { expect, it } from "vitest";
import { Clock } from "./clock";

const clockOf = (end_s: number) => Object.assign(new Clock(), { end_s });

it("plays at its speed and stops at the end", () => {
  const clock = clockOf(20);
  clock.toggle();
  clock.step(0.5);
  expect(clock.t).toBe(5);
  clock.step(5);
  expect([clock.t, clock.playing]).toEqual([20, false]);
  clock.toggle();
  expect([clock.t, clock.playing]).toEqual([0, true]);
});

it("follows the present until somebody goes elsewhere", () => {
  const clock = clockOf(100);
  clock.follow();
  clock.step(0.2);
  expect(clock.t).toBe(50);
  for (let k = 0; k < 60; k++) clock.step(0.2);
  expect(clock.t).toBe(100);
  clock.goTo(30);
  clock.end_s = 110;
  clock.step(1);
  expect(clock.t).toBe(30);
});

it("stays within the mission and its speeds", () => {
  const clock = clockOf(10);
  clock.goTo(-4);
  expect(clock.t).toBe(0);
  clock.goTo(99);
  expect(clock.t).toBe(10);
  clock.faster(99);
  expect(clock.speed).toBe(100);
  clock.faster(-1);
  expect(clock.speed).toBe(50);
});
