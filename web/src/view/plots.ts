import "./plots.css";
import { stretches, type ViewData } from "../lib/bundle";
import { button, menu, select, tabs } from "../ui/buttons";
import { h, memory } from "../ui/dom";
import { Plot } from "../ui/plot";
import { toast } from "../ui/toast";
import { chooseChannels } from "./channels";
import { cycles, PERCENT, type Gait } from "./cycles";
import { difference } from "./difference";
import { ANGLE_GROUPS, angles, own, place, quality, type Beside, type Group, type Panel } from "./panels";
import { give, picture, table } from "./plot_files";

export type { Beside } from "./panels";

const WINDOWS = [0, 5, 20, 60];
const LONG_S = 60; // longer results begin with a part of themselves: whole, their curves would be solid blocks
const WALK_MS = 800; // after the first picture, it is asked how somebody walks: the server is busy with that for long
export const MOST_PANELS = 5;

/** Joint angles and the quality of the fit over time or over the gait cycle, in groups. */
export class PlotPane {
  readonly element: HTMLElement;
  readonly tabs = h("div", { class: "tabs-box" });
  /** What is shown, how much of it, and its files. */
  readonly tools: HTMLElement[];
  private plots: Plot[] = [];
  private name = "";
  private row = 0;
  private window = 0;
  private beside: Beside | null = null;
  private chosenChannels: string[];
  private gait: Gait | null = null;
  private over: "time" | "cycle" = "time";
  private later = 0;
  private readonly closed = new AbortController();
  private readonly span: HTMLSelectElement;
  private readonly axis: HTMLSelectElement;

  /** gait: asks for what is known of how somebody walks; null where that cannot be had. */
  constructor(
    private readonly data: ViewData,
    private readonly chosen: (row: number) => void,
    private readonly askGait: ((signal: AbortSignal) => Promise<Gait>) | null = null,
  ) {
    this.element = h("div", { class: "plots" });
    this.chosenChannels = (memory.get("plots-own") ?? "").split(",").filter(Boolean);
    const seconds = (data.times[data.frames - 1] ?? 0) - (data.times[0] ?? 0);
    if (seconds > LONG_S) this.window = 20;
    const spans = WINDOWS.map((w) => ({ value: w, label: w ? `${w} s` : "All" })).filter((w) => w.value < seconds);
    this.span = select("Time shown in the plots", spans, this.window, (w) => {
      this.window = w;
      for (const plot of this.plots) plot.setWindow(w);
    });
    this.axis = select("Plotted over", [{ value: "time", label: "over time" }, { value: "cycle", label: "over the gait cycle" }], "time", (over) => {
      this.over = over as typeof this.over;
      this.open(this.name);
    });
    this.axis.hidden = true; // until somebody is known to walk
    this.tools = [
      this.axis,
      this.span,
      button("", () => void this.choose(), { icon: "list", kind: "quiet", title: "Choose what is plotted" }),
      menu("", () => [
        { label: "CSV", hint: "the curves as a table", act: () => this.save("csv") },
        { label: "PNG", hint: "as they are shown", act: () => this.save("png") },
      ], { icon: "download", kind: "quiet", title: "These plots as files" }),
    ];
    this.drawTabs(memory.get("plots") ?? "");
    const drawn = (): number => (this.later = window.setTimeout(() => void this.walk(), WALK_MS));
    requestAnimationFrame(() => requestAnimationFrame(() => this.closed.signal.aborted || drawn()));
  }

  private groups(): Group[] {
    const { data, beside } = this;
    return [
      ...(data.angles ? ANGLE_GROUPS.map(([name, label, panels]): Group => ({ name, label, panels: angles(panels) })) : []),
      { name: "place", label: "Position", panels: place },
      { name: "quality", label: "Quality", panels: quality },
      ...(beside ? [{ name: "difference", label: "Difference", panels: difference }] : []),
      ...(this.chosenChannels.length ? [{ name: "own", label: "Chosen", panels: own(this.chosenChannels) }] : []),
    ];
  }

  private drawTabs(wanted: string): void {
    const groups = this.groups();
    const made = tabs("Plots", groups, (name) => this.open(name));
    this.tabs.replaceChildren(made.element);
    made.show(groups.some((g) => g.name === wanted) ? wanted : groups[0]!.name);
  }

  /** Moves to a frame; tell() says the values there. */
  show(row: number): void {
    this.row = row;
    for (const plot of this.plots) plot.show(row);
  }

  tell(): void {
    for (const plot of this.plots) plot.tell();
  }

  compare(beside: Beside | null): void {
    this.beside = beside;
    this.drawTabs(beside ? "difference" : this.name);
  }

  close(): void {
    clearTimeout(this.later);
    this.closed.abort(); // what nobody looks at any more is not to keep the next result waiting
    this.empty();
  }

  private empty(): void {
    for (const plot of this.plots) plot.close();
    this.plots = [];
  }

  private async walk(): Promise<void> {
    if (!this.askGait || !this.data.angles) return;
    const gait = await this.askGait(this.closed.signal).catch(() => null); // who does not walk is looked at over time
    if (!gait?.figures.length || !this.element.isConnected) return; // a foot that is lifted once is no step
    this.gait = gait;
    this.axis.hidden = !gait.cycles.length;
    this.open(this.name);
  }

  private async choose(): Promise<void> {
    const chosen = await chooseChannels(this.data, this.chosenChannels, MOST_PANELS);
    if (!chosen) return;
    this.chosenChannels = chosen;
    memory.set("plots-own", chosen.join());
    this.drawTabs(chosen.length ? "own" : this.name);
  }

  private save(kind: "csv" | "png"): void {
    const name = `${this.data.header.title.replace(/[^\w.-]+/g, "_")}-${this.name}${this.cyclic ? "-cycle" : ""}.${kind}`;
    if (kind === "csv") return give(name, new Blob([table(this.plots)], { type: "text/csv" }));
    picture(this.plots).toBlob((blob) => (blob ? give(name, blob) : toast("The picture could not be made.", "error")), "image/png");
  }

  private get cyclic(): boolean {
    return this.plots.some((p) => p.cycle);
  }

  /** Over the cycle, where the group has angles that have one. */
  private cycles(name: string): Panel[] {
    if (!this.gait || this.over !== "cycle") return [];
    const known = ANGLE_GROUPS.find(([group]) => group === name)?.[2];
    const mine = this.chosenChannels.filter((id) => id.startsWith("angle:")).map((id): [string, string[]] => {
      const angle = id.slice("angle:".length);
      const names = this.data.header.angles.map((a) => a.name).filter((n) => n === angle || n === `${angle}_l` || n === `${angle}_r`);
      return [angle.replaceAll("_", " ").replace(/^./, (c) => c.toUpperCase()), names];
    });
    return cycles(this.gait, known ?? (name === "own" ? mine : []));
  }

  private open(name: string): void {
    this.name = name;
    if (name !== "difference") memory.set("plots", name);
    this.empty();
    const group = this.groups().find((g) => g.name === name);
    const flagged = stretches(this.data.flags);
    const cyclic = this.cycles(name);
    this.span.disabled = cyclic.length > 0;
    const panels = cyclic.length ? cyclic : (group?.panels(this.data, this.beside) ?? []);
    const marks = name === "quality" || name === "difference" ? [] : (this.gait?.events ?? []);
    this.plots = panels.slice(0, MOST_PANELS).map(({ series, ...options }) =>
      options.cycle ? new Plot(PERCENT, series, options) : new Plot(this.data.times, series, { ...options, chosen: this.chosen, flagged, marks, window: this.window }),
    );
    this.element.replaceChildren(...this.plots.map((p) => p.element));
    this.show(this.row);
    this.tell();
  }
}
