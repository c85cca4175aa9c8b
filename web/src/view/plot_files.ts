import { h } from "../ui/dom";
import type { Plot } from "../ui/plot";
import { colour } from "../ui/theme";

/** Plots as a table: the time (s) or the percent of the cycle, and for every curve its values and standard deviations. */
export function table(plots: readonly Plot[]): string {
  const first = plots[0];
  if (!first) return "";
  const columns: [string, (row: number) => number | undefined][] = [[first.cycle ? "percent" : "time_s", (t) => first.times[t]]];
  const unit = (text: string): string => ({ "°": "deg", "%": "percent", "of 1": "share" })[text] ?? text;
  for (const plot of plots) {
    for (const s of plot.series) {
      const name = [plot.options.title.replace(/,? RMS [\d.]+ \w+$/, ""), s.label].filter(Boolean).join(" ").toLowerCase().replace(/[^a-z0-9.-]+/g, "_");
      columns.push([`${name}_${unit(plot.options.unit)}`, (t) => s.values[t]]);
      if (s.sd) columns.push([`${name}_sd_${unit(plot.options.unit)}`, (t) => s.sd![t]]);
    }
  }
  const cell = (value: number | undefined): string => (value === undefined || !Number.isFinite(value) ? "" : String(Number(value.toPrecision(7))));
  const rows = Array.from(first.times, (_, t) => columns.map(([, of]) => cell(of(t))).join(","));
  return `${[columns.map(([name]) => name).join(","), ...rows].join("\n")}\n`;
}

/** The plots as they are shown, beside each other, with their titles and what their curves are. */
export function picture(plots: readonly Plot[]): HTMLCanvasElement {
  const ratio = window.devicePixelRatio || 1;
  const [head, gap] = [22, 12];
  const parts = plots.flatMap((p) => (p.drawn ? [{ plot: p, drawn: p.drawn, w: p.drawn.width / ratio, h: p.drawn.height / ratio }] : []));
  const canvas = h("canvas");
  canvas.width = ratio * (gap + parts.reduce((sum, p) => sum + p.w + gap, 0));
  canvas.height = ratio * (head + Math.max(0, ...parts.map((p) => p.h)) + 2 * gap);
  const c = canvas.getContext("2d")!;
  c.scale(ratio, ratio);
  c.fillStyle = colour("panel");
  c.fillRect(0, 0, canvas.width, canvas.height);
  let x = gap;
  for (const { plot, drawn, w, h: tall } of parts) {
    const font = getComputedStyle(document.body).fontFamily;
    c.font = `600 12px ${font}`;
    c.textBaseline = "middle";
    let at = x;
    const say = (text: string, tone: string): void => {
      c.fillStyle = colour(tone);
      c.fillText(text, at, gap + head / 2, Math.max(10, x + w - at));
      at += c.measureText(text).width + 10;
    };
    say(`${plot.options.title} (${plot.options.unit})`, "ink");
    c.font = `12px ${font}`;
    for (const s of plot.series) say([s.dashed ? "- -" : "–", s.label, s.note].filter(Boolean).join(" "), s.colour);
    c.drawImage(drawn, x, gap + head, w, tall);
    x += w + gap;
  }
  return canvas;
}

/** Gives a file to whoever sits before the page. */
export function give(name: string, content: Blob): void {
  const at = URL.createObjectURL(content);
  h("a", { href: at, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(at), 60_000);
}
