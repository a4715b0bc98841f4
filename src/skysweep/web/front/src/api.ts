/** The server: what it is asked, and who asks. */

import type { OrderWord, XY } from "./types";

const KEY = "skysweep-token";
const LONGEST_ORDER_MS = 5000;

/** Takes the token out of the address, where it would stay in the history. */
export function keepToken(): void {
  const fragment = new URLSearchParams(location.hash.slice(1));
  const token = fragment.get("token");
  if (!token) return;
  sessionStorage.setItem(KEY, token);
  fragment.delete("token");
  const rest = fragment.toString();
  history.replaceState(null, "", location.pathname + location.search + (rest ? `#${rest}` : ""));
}

function bearer(): Record<string, string> {
  const token = sessionStorage.getItem(KEY);
  return token ? { Authorization: `Bearer ${token}` } : {};
}

export function hasToken(): boolean {
  return sessionStorage.getItem(KEY) !== null;
}

/** Pictures and websockets carry no bearer: the session's cookie lets them in. */
export async function openSession(): Promise<void> {
  if (hasToken()) await fetch("/api/session", { method: "POST", headers: bearer() });
}

/** What the server answers; with a body, to an order. Throws an Error with its sentence. */
export async function ask<T>(path: string, body?: unknown): Promise<T> {
  const ordered = body !== undefined && {
    method: "POST",
    headers: { ...bearer(), "Content-Type": "application/json" },
    body: JSON.stringify(body),
    signal: AbortSignal.timeout(LONGEST_ORDER_MS),
  };
  let response: Response;
  try {
    response = await fetch(path, ordered || { headers: bearer() });
  } catch {
    throw new Error(ordered ? "No answer; it may not have arrived: look at the vehicle and say it again." : "The server does not answer.");
  }
  const answer = (await response.json().catch(() => ({}))) as { error?: string };
  if (!response.ok) throw new Error(answer.error ?? `The server answered ${response.status}.`);
  return answer as T;
}

/** An id as part of an address; slashes stay. */
export function runPath(id: string): string {
  return `/api/runs/${id.split("/").map(encodeURIComponent).join("/")}`;
}

export interface Order {
  word: OrderWord;
  candidate?: number;
  position_enu_m?: XY;
  holder?: string;
}

export async function order(id: string, what: Order): Promise<string> {
  return (await ask<{ said: string }>(`${runPath(id)}/operator`, what)).said;
}
