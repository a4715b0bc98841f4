/** Follows a run's journal, and comes back by itself when the connection is lost. */

import { runPath } from "./api";
import type { Store } from "./store";
import type { Line, Message } from "./types";

export interface Following {
  /** A sentence about the connection or the run; empty: all is well. */
  said(sentence: string): void;
  status(flying: boolean, ended: boolean): void;
  /** New lines of the journal, which the store has. */
  lines(lines: readonly Line[]): void;
  /** The connection has ended; lines may come again later. */
  lost(): void;
  /** The journal was cut and begins anew. */
  restart(): void;
}

const LONGEST_WAIT_S = 5;

export class Follow {
  private socket: WebSocket | null = null;
  private lost = 0;
  private closed = false;

  constructor(
    private readonly id: string,
    private readonly store: Store,
    private readonly told: Following,
  ) {
    this.connect();
  }

  close(): void {
    this.closed = true;
    this.socket?.close();
  }

  private connect(): void {
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    const from = this.store.lines.length;
    const asked = new URLSearchParams({ from: String(from), ...(from > 0 && { mission: this.store.mission }) });
    this.socket = new WebSocket(`${scheme}://${location.host}${runPath(this.id)}/follow?${asked}`);
    this.socket.onmessage = (event) => this.take(JSON.parse(event.data as string) as Message);
    this.socket.onclose = () => {
      if (this.closed) return;
      this.told.lost();
      const wait_s = Math.min(0.5 * 2 ** this.lost++, LONGEST_WAIT_S);
      if (this.lost > 1) this.told.said("The connection to skysweep is lost; trying again.");
      setTimeout(() => this.connect(), 1000 * wait_s);
    };
  }

  private take(message: Message): void {
    if (this.lost) this.told.said("");
    this.lost = 0;
    switch (message.type) {
      case "lines":
        if (message.from !== this.store.lines.length) {
          this.close();
          this.told.restart();
          return;
        }
        this.store.add(message.lines);
        this.told.lines(message.lines);
        break;
      case "coverage":
        this.store.addCoverage(message.t, bytesOf(message.pod));
        break;
      case "film":
        this.store.addFilm(message.times);
        break;
      case "pictures":
        this.store.addPictures(message.of);
        break;
      case "status":
        this.told.status(message.flying, message.ended);
        this.told.said(message.error ?? "");
    }
  }
}

function bytesOf(base64: string): Uint8Array {
  const text = atob(base64);
  const bytes = new Uint8Array(text.length);
  for (let k = 0; k < text.length; k++) bytes[k] = text.charCodeAt(k);
  return bytes;
}
