import { describe, expect, it } from "vitest";
import { LocalFrame, mgrsOf, utmOf, written } from "./geo";

// Expected values: pyproj (PROJ) and the mgrs package, for the place at ENU (1000, -2000, 0) m.
const PLACES = [
  { origin: [60.449, 22.2966], lonLat: [22.314757789, 60.431048706], utm: [572374.811, 6700139.963], mgrs: "34V EN 72374 00139" },
  { origin: [-33.9, 18.4], lonLat: [18.410813866, -33.918030332], utm: [260633.871, 6243913.41], mgrs: "34H BH 60633 43913" },
  { origin: [61.5, 5.3], lonLat: [5.31876671, 61.482051472], utm: [303995.18, 6822017.77], mgrs: "32V LP 03995 22017" },
  { origin: [78.2, 15.6], lonLat: [15.643721504, 78.18208309], utm: [514716.983, 8678771.209], mgrs: "33X WG 14716 78771" },
  { origin: [0.5, -179.9], lonLat: [-179.891016574, 0.481912704], utm: [178176.05, 53334.18], mgrs: "1N AA 78176 53334" },
] as const;

describe.each(PLACES)("near $origin", ({ origin, lonLat, utm, mgrs }) => {
  const frame = new LocalFrame({ latitude_deg: origin[0], longitude_deg: origin[1], altitude_amsl_m: 30 });
  const [lon, lat] = frame.lonLat(1000, -2000);

  it("has PROJ's latitude and longitude", () => {
    expect(lon).toBeCloseTo(lonLat[0], 8);
    expect(lat).toBeCloseTo(lonLat[1], 8);
  });

  it("comes back to local metres", () => {
    const [x, y] = frame.enu(lon, lat);
    expect(x).toBeCloseTo(1000, 2);
    expect(y).toBeCloseTo(-2000, 2);
  });

  it("has PROJ's UTM to the millimetre, and its MGRS", () => {
    const found = utmOf(lon, lat)!;
    expect(found.easting_m).toBeCloseTo(utm[0], 2);
    expect(found.northing_m).toBeCloseTo(utm[1], 2);
    expect(mgrsOf(lon, lat)).toBe(mgrs);
  });
});

it("says where there is no UTM", () => {
  const frame = new LocalFrame({ latitude_deg: 85, longitude_deg: 0, altitude_amsl_m: 0 });
  expect(written(frame, 0, 0, "mgrs")).toBe("no MGRS here");
  expect(written(frame, 0, 0, "latlon")).toBe("85.000000, 0.000000");
  expect(written(frame, 1.25, -3, "local")).toBe("E 1.3 m, N -3.0 m");
});
