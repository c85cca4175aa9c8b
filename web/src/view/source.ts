import { address, get, getBytes, post } from "../api";
import type { Job } from "../protocol";
import { readBundle, type ViewData } from "../lib/bundle";
import type { Gait } from "./cycles";

/** Pictures of all cameras at one frame; `row` is that of the pictures, which a report does not have for every frame. */
export interface RowPictures {
  row: number;
  /** One JPEG per camera, null where there is none. */
  files: (Blob | null)[];
}

/** Edges of the masks of all cameras: polygons [x0, y0, x1, y1, ...] in pixels of the calibrated size. */
export type Outlines = number[][][];

/** Where a result comes from: the server, or the page itself (a report). */
export interface Source {
  /** Id for the server; null in a report. */
  readonly id: string | null;
  data(signal: AbortSignal): Promise<ViewData>;
  pictures(row: number, width: number, signal: AbortSignal): Promise<RowPictures | null>;
  outlines(row: number, signal: AbortSignal): Promise<Outlines | null>;
  /** Address of a file of the result, null where it cannot be had. */
  file(name: string): string | null;
  /** How somebody walks; absent where nobody can be asked. */
  gait?(signal: AbortSignal): Promise<Gait>;
  /** Starts writing motion files; resolves when the server has begun. */
  export(formats: readonly string[]): Promise<string>;
}

export class ServerSource implements Source {
  private readonly kept = new Map<string, ArrayBuffer>();

  constructor(
    readonly id: string,
    private readonly path = `/api/results/${id}`,
  ) {}

  async data(signal: AbortSignal): Promise<ViewData> {
    return readBundle(await getBytes(`${this.path}/view`, signal));
  }

  async pictures(row: number, width: number, signal: AbortSignal): Promise<RowPictures | null> {
    const key = `${row}/${width}`;
    const block = this.kept.get(key) ?? (await getBytes(`${this.path}/pictures/${row}?width=${width}`, signal));
    this.kept.delete(key);
    this.kept.set(key, block);
    for (const old of this.kept.keys()) {
      if (this.kept.size <= KEPT_ROWS) break;
      this.kept.delete(old);
    }
    return { row, files: jpegs(block) };
  }

  async outlines(row: number, signal: AbortSignal): Promise<Outlines | null> {
    return (await get<{ views: Outlines }>(`${this.path}/outlines/${row}`, signal)).views;
  }

  gait(signal: AbortSignal): Promise<Gait> {
    return get<Gait>(`${this.path}/gait`, signal);
  }

  file(name: string): string {
    return address(`${this.path}/files/${encodeURIComponent(name)}`);
  }

  async export(formats: readonly string[]): Promise<string> {
    return (await post<Job>("/api/jobs", { kind: "export", result: this.id, options: { formats } })).id;
  }
}
const KEPT_ROWS = 60;

function jpegs(block: ArrayBuffer): (Blob | null)[] {
  const view = new DataView(block);
  const count = view.getUint32(0, true);
  let at = 4 * (1 + count);
  return Array.from({ length: count }, (_, i) => {
    const length = view.getUint32(4 * (1 + i), true);
    const file = length ? new Blob([new Uint8Array(block, at, length)], { type: "image/jpeg" }) : null;
    at += length;
    return file;
  });
}
