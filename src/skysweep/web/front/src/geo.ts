/** Places on the earth: local ENU, latitude and longitude, UTM, MGRS (WGS 84). */

import type { Scene, XY } from "./types";

const A = 6378137.0;
const F = 1 / 298.257223563;
const E2 = F * (2 - F);
const RAD = Math.PI / 180;

/** Geodetic places of an ENU tangent frame; exact (by way of ECEF). */
export class LocalFrame {
  private readonly lat: number;
  private readonly lon: number;
  private readonly ecef: [number, number, number];

  constructor(private readonly origin: Scene["origin"]) {
    this.lat = origin.latitude_deg * RAD;
    this.lon = origin.longitude_deg * RAD;
    this.ecef = ecefOf(this.lat, this.lon, origin.altitude_amsl_m);
  }

  /** Longitude and latitude in degrees of a place on the tangent plane. */
  lonLat(x: number, y: number): XY {
    const [sLat, cLat, sLon, cLon] = [Math.sin(this.lat), Math.cos(this.lat), Math.sin(this.lon), Math.cos(this.lon)];
    const X = this.ecef[0] - sLon * x - sLat * cLon * y;
    const Y = this.ecef[1] + cLon * x - sLat * sLon * y;
    const Z = this.ecef[2] + cLat * y;
    const p = Math.hypot(X, Y);
    let lat = Math.atan2(Z, p * (1 - E2));
    for (let k = 0; k < 5; k++) {
      const N = A / Math.sqrt(1 - E2 * Math.sin(lat) ** 2);
      const h = p / Math.cos(lat) - N;
      lat = Math.atan2(Z, p * (1 - (E2 * N) / (N + h)));
    }
    return [Math.atan2(Y, X) / RAD, lat / RAD];
  }

  /** East and north in m of a place at the origin's height. */
  enu(lon_deg: number, lat_deg: number): XY {
    const [X, Y, Z] = ecefOf(lat_deg * RAD, lon_deg * RAD, this.origin.altitude_amsl_m);
    const [dX, dY, dZ] = [X - this.ecef[0], Y - this.ecef[1], Z - this.ecef[2]];
    const [sLat, cLat, sLon, cLon] = [Math.sin(this.lat), Math.cos(this.lat), Math.sin(this.lon), Math.cos(this.lon)];
    return [-sLon * dX + cLon * dY, -sLat * cLon * dX - sLat * sLon * dY + cLat * dZ];
  }
}

function ecefOf(lat: number, lon: number, h: number): [number, number, number] {
  const N = A / Math.sqrt(1 - E2 * Math.sin(lat) ** 2);
  return [
    (N + h) * Math.cos(lat) * Math.cos(lon),
    (N + h) * Math.cos(lat) * Math.sin(lon),
    (N * (1 - E2) + h) * Math.sin(lat),
  ];
}

export interface Utm {
  zone: number;
  letter: string;
  easting_m: number;
  northing_m: number;
}

const BANDS = "CDEFGHJKLMNPQRSTUVWX";

/** UTM of a place between 80 S and 84 N; null elsewhere. Krueger's series to the third order: below a millimetre. */
export function utmOf(lon_deg: number, lat_deg: number): Utm | null {
  if (!(lat_deg >= -80 && lat_deg <= 84)) return null;
  const letter = BANDS[Math.min(Math.floor((lat_deg + 80) / 8), 19)]!;
  const zone = zoneOf(lon_deg, lat_deg);
  const lat = lat_deg * RAD;
  const dLon = (lon_deg - (zone * 6 - 183)) * RAD;
  const n = F / (2 - F);
  const radius = (A / (1 + n)) * (1 + n ** 2 / 4 + n ** 4 / 64);
  const alpha = [
    n / 2 - (2 / 3) * n ** 2 + (5 / 16) * n ** 3,
    (13 / 48) * n ** 2 - (3 / 5) * n ** 3,
    (61 / 240) * n ** 3,
  ];
  const e = Math.sqrt(E2);
  const t = Math.sinh(Math.atanh(Math.sin(lat)) - e * Math.atanh(e * Math.sin(lat)));
  const xi = Math.atan2(t, Math.cos(dLon));
  const eta = Math.atanh(Math.sin(dLon) / Math.hypot(1, t));
  let [easting, northing] = [eta, xi];
  alpha.forEach((a, k) => {
    const j = 2 * (k + 1);
    easting += a * Math.cos(j * xi) * Math.sinh(j * eta);
    northing += a * Math.sin(j * xi) * Math.cosh(j * eta);
  });
  return {
    zone,
    letter,
    easting_m: 500000 + 0.9996 * radius * easting,
    northing_m: (lat_deg < 0 ? 10000000 : 0) + 0.9996 * radius * northing,
  };
}

function zoneOf(lon: number, lat: number): number {
  if (lat >= 56 && lat < 64 && lon >= 3 && lon < 12) return 32; // Norway
  if (lat >= 72 && lon >= 0 && lon < 42) return lon < 9 ? 31 : lon < 21 ? 33 : lon < 33 ? 35 : 37; // Svalbard
  return Math.min(Math.floor((lon + 180) / 6) + 1, 60);
}

const COLUMNS = ["STUVWXYZ", "ABCDEFGH", "JKLMNPQR"];
const ROWS = "ABCDEFGHJKLMNPQRSTUV";

/** MGRS to the metre, as `35V MG 12345 67890`; null near the poles. */
export function mgrsOf(lon_deg: number, lat_deg: number): string | null {
  const utm = utmOf(lon_deg, lat_deg);
  if (!utm) return null;
  const column = COLUMNS[utm.zone % 3]![Math.floor(utm.easting_m / 100000) - 1] ?? "?";
  const row = ROWS[(Math.floor(utm.northing_m / 100000) + (utm.zone % 2 === 0 ? 5 : 0)) % 20]!;
  const digits = (metres: number) => String(Math.floor(metres % 100000)).padStart(5, "0");
  return `${utm.zone}${utm.letter} ${column}${row} ${digits(utm.easting_m)} ${digits(utm.northing_m)}`;
}

export type Notation = "local" | "latlon" | "utm" | "mgrs";
export const NOTATIONS: readonly Notation[] = ["local", "latlon", "utm", "mgrs"];

/** A place in one notation, as people write it. */
export function written(frame: LocalFrame, x: number, y: number, notation: Notation): string {
  const [lon, lat] = frame.lonLat(x, y);
  switch (notation) {
    case "local":
      return `E ${x.toFixed(1)} m, N ${y.toFixed(1)} m`;
    case "latlon":
      return `${lat.toFixed(6)}, ${lon.toFixed(6)}`;
    case "utm": {
      const utm = utmOf(lon, lat);
      return utm ? `${utm.zone}${utm.letter} ${utm.easting_m.toFixed(0)} ${utm.northing_m.toFixed(0)}` : "no UTM here";
    }
    case "mgrs":
      return mgrsOf(lon, lat) ?? "no MGRS here";
  }
}
