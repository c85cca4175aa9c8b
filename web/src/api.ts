/** The token of the address the page was opened with; "" on this computer. */
const token = typeof location === "undefined" ? "" : (new URLSearchParams(location.search).get("token") ?? "");

const GONE = "The server does not answer; is `hypose view` still running?";

/** An answer that is an error; the message is the server's sentence, fit for the user. */
export class ApiError extends Error {
  constructor(
    message: string,
    readonly status: number,
  ) {
    super(message);
  }
}

/** The address of something the server has, with the token and these parameters: for fetch, <img> and <a>. */
export function address(path: string, query: Readonly<Record<string, string | number | boolean>> = {}): string {
  const url = new URL(path.replace(/^\//, ""), new URL("./", location.href));
  for (const [key, value] of Object.entries(query)) url.searchParams.set(key, String(value));
  if (token) url.searchParams.set("token", token);
  return url.href;
}

async function ask(path: string, init: RequestInit): Promise<Response> {
  let answer: Response;
  try {
    answer = await fetch(address(path), init);
  } catch (error) {
    if (init.signal?.aborted) throw error;
    throw new ApiError(GONE, 0);
  }
  if (answer.ok) return answer;
  const value: unknown = await answer.json().catch(() => null);
  const sentence = value && typeof value === "object" && "error" in value ? String(value.error) : answer.statusText;
  throw new ApiError(sentence, answer.status);
}

export async function get<T>(path: string, signal?: AbortSignal): Promise<T> {
  return (await (await ask(path, signal ? { signal } : {})).json()) as T;
}

export async function getBytes(path: string, signal?: AbortSignal): Promise<ArrayBuffer> {
  const answer = await ask(path, signal ? { signal } : {});
  const size = Number(answer.headers.get("Content-Length"));
  if (!size || !answer.body) return answer.arrayBuffer();
  // straight to where it stays: a long result would otherwise be gathered first, and then lie twice in memory
  const out = new Uint8Array(size);
  let at = 0;
  for (const reader = answer.body.getReader(); ; ) {
    const { done, value } = await reader.read().catch((error: unknown) => {
      throw signal?.aborted ? error : new ApiError(GONE, 0);
    });
    if (done) break;
    if (at + value.length > size) throw new Error("The studio sent more than it had announced; reload the page.");
    out.set(value, at);
    at += value.length;
  }
  if (at < size) throw new Error("What the studio sent broke off; reload the page.");
  return out.buffer;
}

export async function post<T>(path: string, value: unknown = {}, signal?: AbortSignal): Promise<T> {
  const init: RequestInit = {
    method: "POST",
    body: JSON.stringify(value),
    headers: { "Content-Type": "application/json" },
  };
  if (signal) init.signal = signal;
  return (await (await ask(path, init)).json()) as T;
}

/** Deletes a result for good. */
export async function remove(id: string): Promise<void> {
  await ask(`/api/results/${id}`, { method: "DELETE" });
}

/** A WebSocket of the server; it opens again by itself after a break until it is closed. */
export class Socket {
  private socket: WebSocket | undefined;
  private closed = false;
  private wait = 250;

  constructor(
    private readonly path: string,
    private readonly onMessage: (message: unknown) => void,
    private readonly onPicture: (message: ArrayBuffer) => void = () => undefined,
    private readonly onState: (open: boolean) => void = () => undefined,
  ) {
    this.open();
  }

  private open(): void {
    const socket = new WebSocket(address(this.path).replace(/^http/, "ws"));
    socket.binaryType = "arraybuffer";
    socket.onopen = () => {
      this.wait = 250;
      this.onState(true);
    };
    socket.onmessage = ({ data }: MessageEvent<string | ArrayBuffer>) => {
      if (typeof data === "string") this.onMessage(JSON.parse(data));
      else this.onPicture(data);
    };
    socket.onclose = () => {
      if (this.closed) return; // whoever closed it has gone
      this.onState(false);
      setTimeout(() => this.closed || this.open(), this.wait);
      this.wait = Math.min(5000, 2 * this.wait);
    };
    this.socket = socket;
  }

  /** False when there is no connection just now; the message is then lost. */
  send(message: unknown): boolean {
    if (this.socket?.readyState !== WebSocket.OPEN) return false;
    this.socket.send(JSON.stringify(message));
    return true;
  }

  close(): void {
    this.closed = true;
    this.socket?.close();
  }
}
