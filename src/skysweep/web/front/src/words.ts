/** Numbers as people read them. */

/** A time of the mission as 4:05 or 1:04:05. */
export function clockTime(t: number): string {
  const s = Math.max(Math.floor(t + 1e-6), 0);
  const two = (n: number) => String(n).padStart(2, "0");
  const hours = Math.floor(s / 3600);
  const minutes = Math.floor((s % 3600) / 60);
  return hours ? `${hours}:${two(minutes)}:${two(s % 60)}` : `${minutes}:${two(s % 60)}`;
}

/** A share in whole percent; a dash where it is not known. */
export function percent(share: number | null | undefined): string {
  return share === null || share === undefined || Number.isNaN(share) ? "–" : `${Math.round(100 * share)} %`;
}

/** A length in m, or km from 10 km on. */
export function metres(m: number): string {
  return m >= 10000 ? `${(m / 1000).toFixed(1)} km` : m >= 100 ? `${m.toFixed(0)} m` : `${m.toFixed(1)} m`;
}

/** How long ago, roughly. */
export function ago(unix_s: number, now_s: number): string {
  const s = Math.max(now_s - unix_s, 0);
  if (s < 90) return "just now";
  if (s < 5400) return `${Math.round(s / 60)} minutes ago`;
  if (s < 129600) return `${Math.round(s / 3600)} hours ago`;
  return `${Math.round(s / 86400)} days ago`;
}
