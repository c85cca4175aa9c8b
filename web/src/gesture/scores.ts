import type { HistoryRow } from "../protocol";
import { h, sharpCanvas } from "../ui/dom";
import { colour } from "../ui/theme";

const SHOWN_S = 60;
const LEFT = 34;
const BOTTOM = 18;
const GRAB_PX = 14;

/** The score over the last minute, the moving averages, and the threshold, which can be dragged. */
export class ScorePlot {
  readonly element: HTMLElement;
  private rows: readonly HistoryRow[] = [];
  private top = 1;
  private height = 1; // CSS pixels; asking the canvas for it would lay out the page for every point
  private threshold: number | null = null;
  private dragging = false;
  private readonly redraw: () => void;
  private readonly stop: () => void;
  private readonly canvas: HTMLCanvasElement;

  constructor(private readonly chosen: (threshold: number) => void) {
    const { canvas, redraw, stop } = sharpCanvas("Score over time with the threshold", (g, width, height) =>
      this.draw(g, width, height),
    );
    this.canvas = canvas;
    this.redraw = redraw;
    this.stop = stop;
    canvas.classList.add("scores");
    canvas.addEventListener("pointerdown", (event) => this.grab(event));
    canvas.addEventListener("pointermove", (event) => {
      canvas.style.cursor = this.near(event.offsetY) || this.dragging ? "ns-resize" : "";
      if (this.dragging) this.choose(event.offsetY);
    });
    canvas.addEventListener("lostpointercapture", () => (this.dragging = false));
    const key = (name: string, text: string): HTMLElement =>
      h("span", { class: "key" }, h("i", { class: `key-${name}` }), text);
    this.element = h(
      "div",
      { class: "score-plot" },
      h("div", { class: "score-keys" }, key("score", "score, cm²"), key("high", "gesture"), key("low", "other"), key("threshold", "threshold")),
      canvas,
    );
  }

  show(rows: readonly HistoryRow[], threshold: number | null): void {
    this.rows = rows;
    this.threshold = threshold;
    this.redraw();
  }

  /** Upper end of the axis, cm². */
  get highest(): number {
    return this.top;
  }

  close(): void {
    this.stop();
  }

  private plotHeight(): number {
    return this.height - BOTTOM - 6;
  }

  private toY(value: number): number {
    return 6 + this.plotHeight() * (1 - value / this.top);
  }

  private near(y: number): boolean {
    return this.threshold !== null && Math.abs(y - this.toY(this.threshold)) < GRAB_PX;
  }

  private grab(event: PointerEvent): void {
    if (!this.near(event.offsetY)) return;
    this.dragging = true;
    this.canvas.setPointerCapture(event.pointerId);
  }

  private choose(y: number): void {
    const value = this.top * (1 - (y - 6) / this.plotHeight());
    this.chosen(Math.max(0.05, Math.min(this.top, value)));
  }

  private draw(g: CanvasRenderingContext2D, width: number, height: number): void {
    this.height = height;
    g.clearRect(0, 0, width, height);
    const end = Math.max(SHOWN_S, this.rows.at(-1)?.[0] ?? 0);
    const begin = end - SHOWN_S;
    let from = this.rows.length;
    while (from > 0 && this.rows[from - 1]![0] >= begin - 1) from--;
    const rows = this.rows.slice(from);
    let peak = 1.25 * (this.threshold ?? 1);
    for (const r of rows) peak = Math.max(peak, r[1] ?? 0, r[2] ?? 0);
    const wanted = niceTop(peak);
    if (!this.dragging) this.top = wanted;
    const toX = (t: number): number => LEFT + ((t - begin) / SHOWN_S) * (width - LEFT - 4);
    const bottom = height - BOTTOM;
    this.bands(g, rows, toX, bottom);
    this.axes(g, width, bottom, begin, end, toX);
    g.save();
    g.beginPath();
    g.rect(LEFT, 0, width - LEFT, bottom);
    g.clip();
    this.line(g, rows, 1, toX, colour("ink"), 1.2);
    this.line(g, rows, 2, toX, colour("good"), 2);
    this.line(g, rows, 3, toX, colour("warn"), 2);
    if (this.threshold !== null) {
      const y = this.toY(this.threshold);
      g.strokeStyle = colour("accent");
      g.lineWidth = 2;
      g.setLineDash([7, 4]);
      g.beginPath();
      g.moveTo(LEFT, y);
      g.lineTo(width, y);
      g.stroke();
      g.setLineDash([]);
      g.fillStyle = colour("accent");
      g.beginPath();
      g.moveTo(width - 2, y - 6);
      g.lineTo(width - 11, y);
      g.lineTo(width - 2, y + 6);
      g.fill();
    }
    g.restore();
  }

  /** Behind the line: when the gesture and when something else was asked for. */
  private bands(g: CanvasRenderingContext2D, rows: readonly HistoryRow[], toX: (t: number) => number, bottom: number): void {
    for (let i = 0; i < rows.length; ) {
      let j = i + 1;
      while (j < rows.length && rows[j]![5] === rows[i]![5]) j++;
      const phase = rows[i]![5];
      if (phase === "positive" || phase === "negative") {
        const a = Math.max(LEFT, toX(rows[i]![0]));
        g.globalAlpha = 0.14;
        g.fillStyle = colour(phase === "positive" ? "good" : "warn");
        g.fillRect(a, 6, toX(rows[Math.min(j, rows.length - 1)]![0]) - a, bottom - 6);
        g.globalAlpha = 1;
      }
      i = j;
    }
  }

  private axes(
    g: CanvasRenderingContext2D, width: number, bottom: number, begin: number, end: number, toX: (t: number) => number,
  ): void {
    g.font = "11px system-ui, sans-serif";
    g.fillStyle = colour("dim");
    g.strokeStyle = colour("line");
    g.lineWidth = 1;
    g.textAlign = "right";
    g.textBaseline = "middle";
    for (const share of [0, 0.5, 1]) {
      const y = Math.round(this.toY(share * this.top)) + 0.5;
      g.beginPath();
      g.moveTo(LEFT, y);
      g.lineTo(width, y);
      g.stroke();
      g.fillText(short(share * this.top), LEFT - 5, y);
    }
    g.textAlign = "center";
    g.textBaseline = "top";
    for (let t = Math.ceil(begin / 20) * 20; t <= end; t += 20) g.fillText(`${t} s`, Math.max(LEFT + 8, Math.min(width - 14, toX(t))), bottom + 4);
  }

  private line(
    g: CanvasRenderingContext2D, rows: readonly HistoryRow[], column: 1 | 2 | 3, toX: (t: number) => number, style: string, width: number,
  ): void {
    g.strokeStyle = style;
    g.lineWidth = width;
    g.beginPath();
    let open = false;
    for (const row of rows) {
      const value = row[column];
      if (value === null) {
        open = false;
        continue;
      }
      if (open) g.lineTo(toX(row[0]), this.toY(value));
      else g.moveTo(toX(row[0]), this.toY(value));
      open = true;
    }
    g.stroke();
  }
}

/** The next of 1, 2, 3, 5, 8 times a power of ten, so that the axis seldom changes. */
function niceTop(value: number): number {
  const power = 10 ** Math.floor(Math.log10(Math.max(value, 0.1)));
  return power * ([1, 2, 3, 5, 8, 10].find((k) => k * power >= value) ?? 10);
}

function short(value: number): string {
  return value >= 10 ? value.toFixed(0) : value.toFixed(1).replace(/\.0$/, "");
}
