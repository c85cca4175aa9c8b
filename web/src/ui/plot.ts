import uPlot from "uplot";
import "uplot/dist/uPlot.min.css";
import { column, DOUBTFUL, flagName, type Stretch } from "../lib/bundle";
import { h, onResize, setText } from "./dom";
import { colour, onTheme } from "./theme";
import { clock } from "./timeline";

export interface Series {
  label: string;
  /** Name of a colour of theme.css. */
  colour: string;
  values: ArrayLike<number>;
  dashed?: boolean;
  /** Standard deviation of each value, drawn as the band that holds it with 90 %. */
  sd?: ArrayLike<number> | null;
  /** Where this is not 0 the curve may be wrong, and is red. */
  doubtful?: ArrayLike<number> | null;
  /** Stands behind the label in place of, or beside, the value at the frame shown. */
  note?: string;
}

export interface PlotOptions {
  title: string;
  unit: string;
  /** Range that is shown at least. */
  range?: readonly [number, number];
  /** Seconds that are shown at a time; 0 = all. */
  window?: number;
  /** Stretches that are shaded: lost, extrapolated or doubtful. */
  flagged?: readonly Stretch[];
  /** Moments (s) with a sign above the curves: a foot that strikes or leaves the ground. */
  marks?: readonly { time: number; side: "left" | "right"; kind: "strike" | "off" }[];
  /** Over 0 to 100 % of a cycle in place of time; the bands are of one standard deviation. */
  cycle?: boolean;
  /** A click or drag in the plot chooses a time. */
  chosen?: (index: number) => void;
}

const NINETY = 1.645; // standard deviations to either side that hold 90 % of a normal distribution
/** Of the curves' range that bands may add to it, unless most of them are wider: a part that is hardly known would flatten
 * all the rest. */
const MOST_BAND = 0.6;
const TURN_MS = 160; // longer than from one click to the next of somebody who looks around
/** Units in which nothing is more than 1. */
const SHARES: ReadonlySet<string> = new Set(["IoU", "of 1"]);
/** What is shown at least from bottom to top, by unit: noise is not to look like a movement. */
const LEAST_SPAN: Readonly<Record<string, number>> = { "°": 4, m: 0.04, mm: 2, IoU: 0.1, "of 1": 0.1, "%": 4 };

/** A plot of values over time with a cursor line that follows the frame shown, and the values there in its title. */
export class Plot {
  readonly element: HTMLElement;
  private readonly holder = h("div", { class: "plot-area" });
  private readonly line = h("div", { class: "plot-cursor" });
  private readonly figures: HTMLElement[];
  private readonly stop: (() => void)[] = [];
  private chart: uPlot | undefined;
  private at = 0;
  private page = 0;
  private turning = 0;
  private asked = 0;

  constructor(
    readonly times: Float64Array,
    readonly series: readonly Series[],
    public options: PlotOptions,
  ) {
    this.figures = series.map(() => h("b", { class: "number" }));
    const legend = series.map((s, i) => {
      const style = `--c: var(--${s.colour})`;
      // of many the dashes alone say that it is the other result
      const name = s.dashed && series.length > 2 ? "" : `${s.label} `;
      return h("span", { style, class: s.dashed ? "dashed" : "", title: [s.label, s.note].filter(Boolean).join(", ") || null }, name, options.cycle ? null : this.figures[i], s.note ? h("small", {}, ` ${s.note}`) : null);
    });
    this.element = h(
      "figure",
      { class: "plot" },
      h("figcaption", {}, h("span", { class: "plot-title", title: `${options.title} (${options.unit})` }, `${options.title} (${options.unit})`), ...legend),
      this.holder,
    );
    this.stop.push(
      onResize(this.holder, (w, height) => this.size(w, height)),
      onTheme(() => this.make()),
    );
    this.tellWhat();
    if (options.chosen) this.pointer(options.chosen);
  }

  /** Says to who hears the page what is plotted. Over time it is a slider: with the focus on it the keys of the screen move
   * through the frames, and the values there are told. */
  private tellWhat(): void {
    const { title, unit } = this.options;
    const over = this.cycle ? " over the gait cycle" : "";
    const ranges = this.series.map((s) => `${s.label} ${range(s.values, digits(unit))}`.trim());
    const facts = { role: "img", "aria-label": `${title} (${unit})${over}: ${ranges.join("; ")}` };
    const slider = { role: "slider", tabindex: "0", "aria-valuemin": "0", "aria-valuemax": String(this.times.length - 1) };
    for (const [name, value] of Object.entries(this.options.chosen ? { ...facts, ...slider } : facts)) this.holder.setAttribute(name, value);
  }

  /** Whether it is over a cycle. */
  get cycle(): boolean {
    return this.options.cycle ?? false;
  }

  /** What it has drawn its curves on. */
  get drawn(): HTMLCanvasElement | undefined {
    return this.chart?.ctx.canvas;
  }

  /** Moves the cursor to a frame. */
  show(index: number): void {
    this.at = index;
    this.line.hidden = this.cycle;
    if (!this.chart || this.cycle) return;
    this.turn();
    this.line.style.transform = `translateX(${this.chart.valToPos(this.times[index] ?? 0, "x")}px)`;
  }

  /** Says the values there in the title. */
  tell(): void {
    this.series.forEach((s, i) => {
      const value = s.values[this.at];
      const text = value === undefined || !Number.isFinite(value) ? "–" : value.toFixed(digits(this.options.unit));
      setText(this.figures[i]!, text);
    });
    if (!this.options.chosen) return;
    const values = this.series.map((s, i) => `${s.label} ${this.figures[i]!.textContent}`.trim());
    this.holder.setAttribute("aria-valuenow", String(this.at));
    this.holder.setAttribute("aria-valuetext", `${clock(this.times[this.at] ?? 0)}: ${values.join(", ")} ${this.options.unit}`);
  }

  /** Shows so many seconds at a time, 0 = all. */
  setWindow(seconds: number): void {
    this.options = { ...this.options, window: seconds };
    this.turnNow();
  }

  /** To the page that the frame shown is on, once the hand rests: what moves with it must not wait for curves. Where
   * frames take long, rest is longer too. */
  private turn(): void {
    const away = this.pageOf(this.at) !== this.page;
    this.line.hidden = away;
    clearTimeout(this.turning);
    const now = performance.now();
    const wait = Math.max(TURN_MS, Math.min(4 * TURN_MS, 3 * (now - this.asked)));
    this.asked = now;
    if (away) this.turning = window.setTimeout(() => this.turnNow(), wait);
  }

  private turnNow(): void {
    this.page = this.pageOf(this.at);
    const [min, max] = this.shownRange();
    this.chart?.setScale("x", { min, max });
    this.show(this.at);
  }

  private pageOf(index: number): number {
    const since = (this.times[index] ?? 0) - (this.times[0] ?? 0);
    return this.options.window ? Math.floor(since / this.options.window) : 0;
  }

  private shownRange(): [number, number] {
    const { times } = this;
    const [first, last] = [times[0] ?? 0, times[times.length - 1] ?? 0];
    const window = this.options.window ?? 0;
    if (!window || last - first <= window) return [first, Math.max(last, first + 1e-3)];
    const from = first + this.pageOf(this.at) * window;
    return [from, from + window];
  }

  close(): void {
    clearTimeout(this.turning);
    for (const stop of this.stop) stop();
    this.chart?.destroy();
    this.chart = undefined;
  }

  private size(width: number, height: number): void {
    if (width < 40 || height < 40) return;
    if (this.chart) this.chart.setSize({ width, height });
    else this.make();
  }

  private make(): void {
    const { clientWidth: width, clientHeight: height } = this.holder;
    if (width < 40 || height < 40) return;
    this.chart?.destroy();
    const grid = { stroke: colour("line"), width: 1 };
    const font = `11px ${getComputedStyle(document.body).fontFamily}`;
    const axis = { stroke: colour("dim"), grid, ticks: { show: false }, font } satisfies uPlot.Axis;
    const least = this.options.range;
    const banded = this.series.filter((s) => s.sd);
    const wide = this.wide;
    const usual = wide * Math.max(0, ...banded.map((s) => middle(s.sd!)));
    const edge = { width: 0, auto: false, points: { show: false } } satisfies uPlot.Series;
    this.chart = new uPlot(
      {
        width,
        height,
        legend: { show: false },
        cursor: { show: false },
        padding: [6, this.cycle ? 20 : 10, 0, 0],
        hooks: {
          ready: [() => this.turnNow()],
          setSize: [() => this.show(this.at)],
          drawClear: [(chart) => this.shade(chart)],
          draw: [(chart) => this.redden(chart), (chart) => this.mark(chart)],
        },
        scales: {
          x: { time: false, range: () => this.shownRange() },
          y: {
            range: (_, low, high) => {
              if (!Number.isFinite(low)) return [...(least ?? [0, 1])] as [number, number];
              const missing = least ? 0 : Math.max(0, (LEAST_SPAN[this.options.unit] ?? 0) - (high - low)) / 2;
              [low, high] = [low - missing, high + missing];
              const add = Math.max(MOST_BAND * (high - low || 1), usual);
              const band = this.reach(low, high);
              const [a, b] = [Math.min(low, least?.[0] ?? low, Math.max(band[0], low - add)), Math.max(high, least?.[1] ?? high, Math.min(band[1], high + add))];
              const room = Math.max(1e-3, (b - a) * 0.06);
              const top = least && high <= least[1] ? b : b + room;
              return [least && low >= least[0] ? a : a - room, SHARES.has(this.options.unit) ? Math.min(1.002, top) : top];
            },
          },
        },
        axes: [
          { ...axis, size: 22, gap: 5, space: 60, values: (_, at, __, ___, step) => at.map((t) => this.timeText(t, step)) },
          // as many digits as the steps have, so that no two lines are called the same
          { ...axis, size: 40, gap: 4, space: 22, values: (_, at, __, ___, step) => at.map((v) => v.toFixed(decimals(step))) },
        ],
        series: [
          {},
          ...this.series.map((s) => ({
            stroke: colour(s.colour),
            width: 1.5,
            points: { show: false },
            spanGaps: false,
            ...(s.dashed ? { dash: [4, 3] } : {}),
          })),
          // their range is taken from reach(), so that a part without knowledge does not flatten the rest
          ...banded.flatMap((s) => {
            const line = { ...edge, stroke: seeThrough(colour(s.colour), 45), width: banded.length > 1 ? 1 : 0 };
            return [{ ...line }, { ...line }];
          }),
        ],
        bands: banded.map((s, k) => {
          const first = 1 + this.series.length + 2 * k;
          return { series: [first + 1, first] as [number, number], fill: seeThrough(colour(s.colour), banded.length > 1 ? 12 : 22) };
        }),
      },
      [
        this.times,
        ...this.series.map((s) => gaps(s.values)),
        ...banded.flatMap((s) => [-wide, wide].map((by) => gaps(column(new Float64Array(s.values.length), (t) => s.values[t]! + by * s.sd![t]!)))),
      ] as unknown as uPlot.AlignedData,
      this.holder,
    );
    this.chart.over.append(this.line);
  }

  /** Standard deviations to either side in a band. */
  private get wide(): number {
    return this.cycle ? 1 : NINETY;
  }

  private timeText(seconds: number, step: number): string {
    if (this.cycle) return `${Math.round(seconds)} %`;
    const long = (this.times[this.times.length - 1] ?? 0) >= 60;
    return long ? clock(seconds, step) : `${seconds.toFixed(decimals(step))} s`;
  }

  /** How far the bands reach, where the curves lie between these values. */
  private reach(low: number, high: number): [number, number] {
    let [a, b] = [low, high];
    for (const { values, sd } of this.series) {
      if (!sd) continue;
      for (let t = 0; t < values.length; t++) {
        const [v, r] = [values[t]!, this.wide * sd[t]!];
        if (v - r < a) a = v - r;
        if (v + r > b) b = v + r;
      }
    }
    return [a, b];
  }

  /** The curves again in red where they may be wrong. */
  private redden(chart: uPlot): void {
    const { ctx, bbox } = chart;
    ctx.save();
    ctx.beginPath();
    ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
    ctx.clip();
    ctx.strokeStyle = colour("doubtful");
    ctx.lineWidth = 3 * (window.devicePixelRatio || 1);
    for (const { values, doubtful } of this.series) {
      if (!doubtful) continue;
      const [from, to] = this.shownRange();
      ctx.beginPath();
      let open = false;
      for (let t = 0; t < values.length; t++) {
        const at = this.times[t] ?? 0;
        const on = Boolean(doubtful[t]) && at >= from && at <= to && Number.isFinite(values[t]);
        if (!on) {
          open = false;
          continue;
        }
        const [x, y] = [chart.valToPos(at, "x", true), chart.valToPos(values[t]!, "y", true)];
        if (!open) ctx.moveTo(x - 1, y);
        ctx.lineTo(x, y);
        open = true;
      }
      ctx.stroke();
    }
    ctx.restore();
  }

  /** Feet that strike (pointing down) and leave the ground (pointing up), in the colour of their side. */
  private mark(chart: uPlot): void {
    const marks = this.options.marks ?? [];
    if (!marks.length) return;
    const { ctx, bbox } = chart;
    const size = 4 * (window.devicePixelRatio || 1);
    const [from, to] = this.shownRange();
    ctx.save();
    for (const { time, side, kind } of marks) {
      if (time < from || time > to) continue;
      const x = chart.valToPos(time, "x", true);
      const [base, tip] = kind === "strike" ? [bbox.top, bbox.top + 1.6 * size] : [bbox.top + 1.6 * size, bbox.top];
      ctx.fillStyle = ctx.strokeStyle = colour(side);
      ctx.beginPath();
      ctx.moveTo(x - size, base);
      ctx.lineTo(x + size, base);
      ctx.lineTo(x, tip);
      ctx.closePath();
      if (kind === "strike") ctx.fill();
      else ctx.stroke();
    }
    ctx.restore();
  }

  private shade(chart: uPlot): void {
    const { left, top, width, height } = chart.bbox;
    const step = (this.times[1] ?? 1) - (this.times[0] ?? 0);
    for (const { first, last, flag } of this.options.flagged ?? []) {
      const from = chart.valToPos((this.times[first] ?? 0) - step / 2, "x", true);
      const to = chart.valToPos((this.times[last] ?? 0) + step / 2, "x", true);
      const [a, b] = [Math.max(left, from), Math.min(left + width, to)];
      if (a >= b) continue;
      chart.ctx.globalAlpha = flag === DOUBTFUL ? 0.1 : 0.22; // which joints they are, the curves say
      chart.ctx.fillStyle = colour(flagName(flag));
      chart.ctx.fillRect(a, top, b - a, height);
      chart.ctx.globalAlpha = 1;
    }
  }

  private pointer(chosen: (index: number) => void): void {
    const choose = (event: PointerEvent): void => {
      if (!this.chart) return;
      const x = event.clientX - this.chart.over.getBoundingClientRect().left;
      chosen(this.chart.posToIdx(x));
    };
    this.holder.addEventListener("pointerdown", (down) => {
      if (down.button !== 0) return;
      this.holder.setPointerCapture(down.pointerId);
      choose(down);
      this.holder.addEventListener("pointermove", choose);
      this.holder.addEventListener("lostpointercapture", () => this.holder.removeEventListener("pointermove", choose), {
        once: true,
      });
    });
  }
}

/** Digits behind the point that multiples of a step have: 2.5 has one. */
function decimals(step: number): number {
  for (let digits = 0; digits < 6; digits++) {
    const whole = step * 10 ** digits;
    if (Math.abs(whole - Math.round(whole)) < 1e-6) return digits;
  }
  return 6;
}

/** A colour as it lies below the curves. */
function seeThrough(tone: string, percent = 22): string {
  return `color-mix(in srgb, ${tone} ${percent}%, transparent)`;
}

/** uPlot takes null for a gap, and NaN breaks its search for the range. */
function gaps(values: ArrayLike<number>): (number | null)[] | ArrayLike<number> {
  for (let i = 0; i < values.length; i++) {
    if (!Number.isFinite(values[i])) return Array.from(values, (v) => (Number.isFinite(v) ? v : null));
  }
  return values;
}

/** The median of what is known; 0 where nothing is. */
function middle(values: ArrayLike<number>): number {
  const sorted = Float64Array.from(values).filter(Number.isFinite).sort();
  return sorted[sorted.length >> 1] ?? 0;
}

/** The values' range in words. */
function range(values: ArrayLike<number>, digits: number): string {
  let [low, high] = [Infinity, -Infinity];
  for (let t = 0; t < values.length; t++) {
    const v = values[t]!;
    if (v < low) low = v;
    if (v > high) high = v;
  }
  return low <= high ? `from ${low.toFixed(digits)} to ${high.toFixed(digits)}` : "not known";
}

function digits(unit: string): number {
  return unit === "m" ? 3 : unit === "IoU" || unit === "of 1" ? 2 : unit === "views" ? 0 : 1;
}
