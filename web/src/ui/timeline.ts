import { flagName, stretches, type Stretch } from "../lib/bundle";
import { h, sharpCanvas } from "./dom";
import { colour, onTheme } from "./theme";

export interface TimelineData {
  times: Float64Array;
  flags: Uint8Array;
  /** (T) how many joints may be wrong; null when nothing has looked. */
  doubtful: Uint8Array | null;
  /** (T) 0 to 1, drawn as a curve; NaN where not known. */
  curve: Float32Array | null;
  /** What passes moved after their frame was tracked, the largest first. */
  changes: Change[];
}

/** A stretch of rows in which a pass moved a joint, as in the trace of provenance.json. */
export interface Change {
  pass: string;
  joint: string;
  frames: [number, number];
  moved_mm: number;
  reason: string;
}

const LARGE_MM = 50;

/** Changes that are large enough to be seen, of a provenance. */
export function largeChanges(provenance: Record<string, unknown>): Change[] {
  const trace = (provenance["trace"] ?? []) as Change[];
  return trace.filter((c) => c.moved_mm >= LARGE_MM).sort((a, b) => b.moved_mm - a.moved_mm);
}

const RULER = 16;
const HOVER = 230; // px, as in view.css: measured at every move it would lay out the page each time

/** The line of time of a result: a ruler, flagged stretches, a curve, and the frame that is shown, which can be dragged. */
export class Timeline {
  readonly element: HTMLElement;
  readonly flagged: Stretch[];
  private readonly back: ReturnType<typeof sharpCanvas>;
  private readonly cursor = h("div", { class: "timeline-cursor" });
  private readonly hover = h("div", { class: "timeline-hover", hidden: true });
  private readonly stop: (() => void)[] = [];
  private row = -1;
  private width = 1;

  constructor(
    private readonly data: TimelineData,
    private readonly chosen: (row: number) => void,
  ) {
    this.flagged = stretches(data.flags);
    this.back = sharpCanvas("", (c, w, height) => {
      this.width = w;
      this.draw(c, w, height);
      this.moveCursor();
    });
    this.element = h(
      "div",
      {
        class: "timeline",
        role: "slider",
        tabindex: 0,
        "aria-label": "Time",
        "aria-valuemin": 0,
        "aria-valuemax": data.times.length - 1,
      },
      this.back.canvas,
      this.hover,
      this.cursor,
    );
    this.stop.push(this.back.stop, onTheme(this.back.redraw));
    this.element.addEventListener("pointerdown", (down) => {
      if (down.button !== 0) return;
      this.element.setPointerCapture(down.pointerId);
      this.chosen(this.rowOf(down));
      const move = (event: PointerEvent): void => this.chosen(this.rowOf(event));
      this.element.addEventListener("pointermove", move);
      this.element.addEventListener(
        "lostpointercapture",
        () => this.element.removeEventListener("pointermove", move),
        { once: true },
      );
    });
    this.element.addEventListener("pointermove", (event) => this.tell(event));
    this.element.addEventListener("pointerleave", () => (this.hover.hidden = true));
  }

  /** Shows which frame is shown. */
  show(row: number): void {
    if (row === this.row) return;
    this.row = row;
    this.moveCursor();
    this.element.setAttribute("aria-valuenow", String(row));
    this.element.setAttribute("aria-valuetext", `frame ${row + 1} of ${this.data.times.length}`);
  }

  close(): void {
    for (const stop of this.stop) stop();
  }

  /** A transform, since it moves with every frame and must not lay out the page anew. */
  private moveCursor(): void {
    this.cursor.style.transform = `translateX(${(this.width * (this.row + 0.5)) / this.data.times.length}px)`;
  }

  private rowOf(event: PointerEvent): number {
    const box = this.element.getBoundingClientRect();
    const n = this.data.times.length;
    return Math.min(n - 1, Math.max(0, Math.floor(((event.clientX - box.left) / box.width) * n)));
  }

  private tell(event: PointerEvent): void {
    const box = this.element.getBoundingClientRect();
    const row = this.rowOf(event);
    const flag = this.data.flags[row];
    const joints = this.data.doubtful?.[row] ?? 0;
    const what = (flag ? ` · ${flagName(flag)}` : "") + (joints ? ` · ${joints} ${joints === 1 ? "joint" : "joints"}` : "");
    const value = this.data.curve?.[row] ?? NaN;
    const fit = Number.isFinite(value) ? ` · overlap ${value.toFixed(2)}` : "";
    const moved = this.data.changes.find((c) => c.frames[0] <= row && row < c.frames[1]);
    const how = moved ? `\n${moved.joint.replaceAll("_", " ")} moved ${moved.moved_mm} mm by ${moved.pass}` : "";
    this.hover.textContent = `${clock(this.data.times[row] ?? 0)}${what}${fit}${how}`;
    this.hover.title = moved?.reason ?? "";
    this.hover.hidden = false;
    const x = Math.min(box.width - HOVER / 2, Math.max(HOVER / 2, event.clientX - box.left));
    this.hover.style.transform = `translateX(${x - HOVER / 2}px)`;
  }

  private draw(c: CanvasRenderingContext2D, w: number, height: number): void {
    const { times, curve } = this.data;
    const n = times.length;
    c.clearRect(0, 0, w, height);
    const top = RULER;
    const x = (row: number): number => (w * row) / n;
    c.fillStyle = colour("raised");
    c.fillRect(0, top, w, height - top);
    if (curve) this.drawCurve(c, curve, w, top, height);
    for (const { first, last, flag } of this.flagged) {
      c.fillStyle = colour(flagName(flag));
      const width = Math.max(2, x(last + 1) - x(first));
      c.globalAlpha = 0.28;
      c.fillRect(x(first), top, width, height - top);
      c.globalAlpha = 1;
      c.fillRect(x(first), height - 4, width, 4);
    }
    c.fillStyle = colour("ink");
    for (const { frames } of this.data.changes) c.fillRect(x(frames[0]), top, Math.max(2, x(frames[1]) - x(frames[0])), 2);
    this.drawDoubt(c, w, top);
    const seconds = (times[n - 1] ?? 0) - (times[0] ?? 0);
    const step = ruler(seconds, w);
    c.font = `11px ${getComputedStyle(document.body).fontFamily}`;
    c.textBaseline = "top";
    c.fillStyle = colour("dim");
    c.strokeStyle = colour("line-strong");
    c.lineWidth = 1;
    c.beginPath();
    const first = times[0] ?? 0;
    for (let t = step * Math.ceil(first / step - 1e-6); t <= first + seconds + 1e-9; t += step) {
      const at = Math.round((w * (t - first)) / Math.max(1e-9, seconds + seconds / Math.max(1, n - 1))) + 0.5;
      c.moveTo(at, top - 4);
      c.lineTo(at, top);
      const text = clock(t, step);
      const wide = c.measureText(text).width;
      if (at + wide + 4 < w) c.fillText(text, at + 3, 1);
    }
    c.stroke();
  }

  /** A red line at the top of the band wherever a joint may be wrong, the thicker the more joints are. */
  private drawDoubt(c: CanvasRenderingContext2D, w: number, top: number): void {
    const { doubtful } = this.data;
    if (!doubtful) return;
    const n = doubtful.length;
    const columns = Math.min(n, Math.ceil(w));
    c.fillStyle = colour("doubtful");
    for (let i = 0; i < columns; i++) {
      const begin = Math.floor((n * i) / columns);
      const end = Math.max(begin + 1, Math.floor((n * (i + 1)) / columns));
      let most = 0;
      for (let t = begin; t < end; t++) most = Math.max(most, doubtful[t]!);
      if (most) c.fillRect((w * i) / columns, top, Math.max(1.5, w / columns + 0.5), 3 + Math.min(9, 1.5 * most));
    }
  }

  /** The curve as a filled band per pixel column, lowest value of the frames there: dips are what one looks for. */
  private drawCurve(c: CanvasRenderingContext2D, curve: Float32Array, w: number, top: number, height: number): void {
    const n = curve.length;
    const columns = Math.min(n, Math.ceil(w));
    c.beginPath();
    c.moveTo(0, height);
    for (let i = 0; i < columns; i++) {
      let low = Infinity;
      const end = Math.max(Math.floor((n * i) / columns) + 1, Math.floor((n * (i + 1)) / columns));
      for (let t = Math.floor((n * i) / columns); t < end; t++) {
        const value = curve[t]!;
        if (value < low) low = value;
      }
      const y = Number.isFinite(low) ? height - (height - top - 3) * Math.max(0, low) : height;
      c.lineTo((w * i) / columns, y);
      c.lineTo((w * (i + 1)) / columns, y);
    }
    c.lineTo(w, height);
    c.closePath();
    c.fillStyle = colour("accent");
    c.globalAlpha = 0.3;
    c.fill();
    c.globalAlpha = 1;
  }
}

/** Seconds as 0:04.2; without fractions when `step` is whole seconds. */
export function clock(seconds: number, step = 0.01): string {
  const digits = step >= 1 ? 0 : step >= 0.1 ? 1 : 2;
  const rounded = Number(seconds.toFixed(digits));
  const minutes = Math.floor(rounded / 60);
  const rest = (rounded - 60 * minutes).toFixed(digits);
  return `${minutes}:${rest.padStart(digits ? digits + 3 : 2, "0")}`;
}

/** A round step (s) for about one label per 90 px. */
function ruler(seconds: number, width: number): number {
  const least = (90 * seconds) / Math.max(1, width);
  return [0.1, 0.2, 0.5, 1, 2, 5, 10, 15, 30, 60, 120, 300, 600].find((s) => s >= least) ?? 1200;
}
