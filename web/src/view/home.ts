import "./home.css";
import { address, get, post } from "../api";
import type { Job, ResultEntry, State } from "../protocol";
import { button, select } from "../ui/buttons";
import { h, memory } from "../ui/dom";
import { icon } from "../ui/icons";
import { itemMenu } from "../ui/library";
import { toast } from "../ui/toast";
import { clock } from "../ui/timeline";

type Order = "newest" | "name" | "worst" | "longest";
const ORDERS: readonly { value: Order; label: string }[] = [
  { value: "newest", label: "newest first" },
  { value: "name", label: "by name" },
  { value: "worst", label: "most doubtful first" },
  { value: "longest", label: "longest first" },
];
const ASSESSMENTS = { good: ["good", "good"], look: ["warn", "look"], "not to be trusted": ["bad", "not to be trusted"] } as const;
const WORSE = ["good", "look", "not to be trusted"] as const;

/** What there is to look at in the served folder: searched, sorted, renamed, deleted. */
export async function home(box: HTMLElement, signal: AbortSignal): Promise<void> {
  const page = h("div", { class: "home" }, h("h1", {}, "Results"), h("p", { class: "dim" }, "Looking…"));
  box.append(page);
  try {
    const state = await get<State>("/api/state", signal);
    if (state.results.length) new Library(page, state, signal);
    else page.replaceChildren(h("h1", {}, "Nothing to look at yet"), nothing(state));
  } catch (error) {
    if (!signal.aborted) page.append(h("p", { class: "bad" }, (error as Error).message));
  }
}

class Library {
  private readonly list = h("div", { class: "results" });
  private readonly told = h("p", { class: "dim", role: "status" });
  private order: Order;
  private wanted = "";

  constructor(
    page: HTMLElement,
    private state: State,
    private readonly signal: AbortSignal,
  ) {
    const before = memory.get("results-order") as Order | null;
    this.order = ORDERS.some((o) => o.value === before) ? before! : "newest";
    const search = h("input", { type: "search", placeholder: "Search", "aria-label": "Search the results" });
    search.addEventListener("input", () => {
      this.wanted = search.value;
      this.draw();
    });
    const sort = select("Order", ORDERS, this.order, (order) => {
      this.order = order;
      memory.set("results-order", order);
      this.draw();
    });
    page.replaceChildren(h("div", { class: "home-head" }, h("h1", {}, "Results"), this.told, h("span", { class: "grow" }), search, sort), this.list);
    this.draw();
  }

  private async reload(): Promise<void> {
    try {
      this.state = await get<State>("/api/state", this.signal);
      this.draw();
    } catch (error) {
      if (!this.signal.aborted) toast((error as Error).message, "error");
    }
  }

  private draw(): void {
    const words = this.wanted.toLowerCase().split(/\s+/).filter(Boolean);
    const found = this.state.results.filter((r) => words.every((w) => `${r.path} ${r.recipe} ${r.assessment ?? ""}`.toLowerCase().includes(w)));
    const by: Record<Order, (a: ResultEntry, b: ResultEntry) => number> = {
      newest: (a, b) => b.changed - a.changed,
      name: (a, b) => a.path.localeCompare(b.path, undefined, { numeric: true }),
      worst: (a, b) => worse(b) - worse(a) || (a.iou ?? 1) - (b.iou ?? 1),
      longest: (a, b) => b.frames - a.frames,
    };
    const all = this.state.results.length;
    this.told.textContent = found.length === all ? `${all} in ${this.state.root}` : `${found.length} of ${all} in ${this.state.root}`;
    this.list.replaceChildren(
      ...found.sort(by[this.order]).map((r) => this.entry(r)),
      ...(found.length ? [] : [h("p", { class: "dim" }, "No result is called that.")]),
    );
  }

  private entry(result: ResultEntry): HTMLElement {
    const recording = this.state.recordings.find((r) => r.id === result.recording);
    const seconds = result.frame_rate ? result.frames / result.frame_rate : 0;
    return h(
      "div",
      { class: "card result", "data-result": result.path },
      h(
        "a",
        { class: "result-link", href: `#/view/${result.id}` },
        thumbnail(result),
        h("span", { class: "result-name" }, h("b", {}, recording ? `${recording.name}: ${result.name}` : result.name), h("span", { class: "dim" }, result.path)),
      ),
      quality(result),
      h(
        "span",
        { class: "result-facts dim" },
        h("span", { class: "number" }, `${result.frames} frames · ${clock(seconds, 0.1)}`),
        h("span", {}, new Date(1000 * result.changed).toLocaleString(undefined, { dateStyle: "medium", timeStyle: "short" })),
      ),
      itemMenu(result, () => void this.reload(), [
        ...(recording ? [h("a", { role: "menuitem", href: `#/setup/${recording.id}` }, "Its recording")] : []),
      ]),
    );
  }
}

/** The person in the middle of the result, or a sign where there are no pictures. */
export function thumbnail(result: ResultEntry): HTMLElement {
  const box = h("span", { class: "thumbnail result-picture" }, icon("skeleton"));
  if (!result.pictured) return box;
  const picture = h("img", { src: address(`/api/results/${result.id}/thumbnail.jpg`, { v: Math.round(result.changed) }), alt: "", loading: "lazy", width: 96, height: 72 });
  picture.addEventListener("error", () => box.replaceChildren(icon("skeleton")));
  box.replaceChildren(picture);
  return box;
}

function worse(result: ResultEntry): number {
  return WORSE.indexOf(result.assessment ?? "good") + (result.lost ?? 0);
}

/** How good a result is: the assessment, and the figures behind it. */
export function quality(result: ResultEntry): HTMLElement {
  const [tone, word] = result.assessment ? ASSESSMENTS[result.assessment] : ["", ""];
  const figures = [
    result.iou ? `overlap ${result.iou.toFixed(2)}` : "",
    result.sd_mm ? `± ${result.sd_mm.toFixed(0)} mm` : "",
    result.lost ? `${(100 * result.lost).toFixed(result.lost < 0.01 ? 1 : 0)} % not found` : "",
  ].filter(Boolean);
  return h(
    "span",
    { class: "result-quality" },
    word ? h("span", { class: `chip ${tone}` }, word) : null,
    result.complete ? null : h("span", { class: "chip warn" }, "not complete"),
    h("span", { class: "dim number" }, figures.join(" · ")),
  );
}

function nothing(state: State): HTMLElement {
  const demo = button("Make a demo", () => void begin(), { kind: "primary", icon: "play" });
  async function begin(): Promise<void> {
    demo.disabled = true;
    try {
      const job = await post<Job>("/api/jobs", { kind: "demo", options: {} });
      toast(`${job.title} has begun; it takes about a minute.`);
      location.hash = "#/setup";
    } catch (error) {
      demo.disabled = false;
      toast((error as Error).message, "error");
    }
  }
  const recording = state.recordings[0];
  return h(
    "div",
    { class: "start" },
    h("p", { class: "dim" }, `There are no results in ${state.root}.`),
    recording
      ? h(
          "div",
          { class: "card" },
          h("h2", {}, `Track ${recording.name}`),
          h("p", { class: "dim" }, "The recording is there and has not been tracked yet."),
          h("a", { class: "button primary", href: `#/setup/${recording.id}` }, "Go on with it"),
        )
      : null,
    h(
      "div",
      { class: "card" },
      h("h2", {}, "Your own videos"),
      h("p", { class: "dim" }, "Choose the folder with the videos of all cameras and their calibration; the rest is shown step by step."),
      h("a", { class: `button ${recording ? "" : "primary"}`, href: "#/setup" }, "Set up a recording"),
    ),
    h(
      "div",
      { class: "card" },
      h("h2", {}, "A demo"),
      h("p", { class: "dim" }, "A made-up person walks in front of four made-up cameras and is tracked, in about a minute."),
      demo,
    ),
  );
}
