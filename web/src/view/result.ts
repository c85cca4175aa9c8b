import { DOUBTFUL, doubtfulAt, doubtfulCounts, toLookAt, type Stretch, type ViewData } from "../lib/bundle";
import { button, select, tabs, toggle, type Toggle } from "../ui/buttons";
import { h, onResize, plain, setText } from "../ui/dom";
import { icon, type IconName } from "../ui/icons";
import { bindKeys } from "../ui/keyboard";
import { splitter } from "../ui/split";
import { clock, largeChanges, Timeline } from "../ui/timeline";
import { toast } from "../ui/toast";
import { CameraPane } from "./cameras";
import type { Corrector } from "./correct";
import { details } from "./details";
import { apartInWords } from "./difference";
import { viewKeys } from "./keys";
import { measure } from "./measure";
import { Player, SPEEDS } from "./player";
import { PlotPane, type Beside } from "./plots";
import type { Source } from "./source";
import { openness } from "./rivals";
import { Space, type Direction, type Layer } from "./space";

export interface ResultOptions {
  /** What stands at the right end of the head: compare, export, ... */
  tools?: HTMLElement[];
  /** What stands at its left end: the way back. */
  back?: HTMLElement | null;
  doctor?: HTMLElement | null;
  /** How it is called beside another. */
  name?: string;
  /** Frame to begin with. */
  row?: number;
  /** Keys are taken only while pointer or focus are in here; by default always. */
  keysIn?: HTMLElement;
  /** What puts a frame right, where that can be done. */
  corrector?: (view: ResultView) => Corrector;
  /** Called when the frame has rested for a moment. */
  rested?: (row: number) => void;
}

const TELL_MS = 120;
const TOGETHER_S = 0.2; // doubts that lie closer together are one to jump to
const LAYER_BUTTONS: readonly [Layer, string, IconName, string][] = [
  ["body", "Body", "body", "b"],
  ["skeleton", "Skeleton", "skeleton", "s"],
  ["spread", "Uncertainty", "spread", "u"],
  ["rivals", "Other poses", "rivals", "o"],
  ["trails", "Trails", "trail", "t"],
  ["cameras", "Cameras", "camera", "c"],
  ["truth", "Truth", "other", "g"],
];

/** One result on the screen: 3D, pictures, plots and the line of time, all at the same frame. */
export class ResultView {
  readonly element: HTMLElement;
  readonly player: Player;
  readonly space: Space;
  readonly cameras: CameraPane;
  readonly corrector: Corrector | null;
  private readonly plots: PlotPane;
  private readonly timeline: Timeline;
  private readonly play: HTMLButtonElement;
  private readonly where = h("output", { class: "where number", "aria-live": "off" });
  private readonly speed: HTMLSelectElement;
  private readonly layers = new Map<Layer, Toggle>();
  private readonly follow: Toggle;
  private readonly legend = h("div", { class: "legend" });
  private readonly compared = h("p", { class: "view-compared dim", role: "status" });
  private readonly open = h("output", { class: "openness number", "aria-live": "off" });
  private readonly doubts = h("output", { class: "doubts", "aria-live": "off" });
  private readonly suspects: Stretch[];
  private readonly stop: (() => void)[] = [];
  private readonly measured = measure();
  private pending = false;
  private dirty = false;
  private told = -1;
  private toldAt = 0;
  private drawnAt = 0;
  private passed: number | undefined;
  private shown = -1;
  private rest = 0;

  constructor(
    private readonly data: ViewData,
    source: Source,
    private readonly options: ResultOptions = {},
  ) {
    const { header } = data;
    this.player = new Player(data.times, () => this.schedule());
    const go = (row: number): void => this.go(row);
    this.space = new Space(data, () => this.schedule());
    this.cameras = new CameraPane(data, source, (message) => toast(message, "error"));
    this.plots = new PlotPane(data, go, source.gait ? (signal) => source.gait!(signal) : null);
    this.corrector = options.corrector?.(this) ?? null;
    const curve = data.cost.some(Number.isFinite) ? data.cost.map((c) => 1 - c) : null;
    const many = data.doubtful && doubtfulCounts(data);
    this.timeline = new Timeline({ times: data.times, flags: data.flags, doubtful: many, curve, changes: largeChanges(header.provenance) }, go);
    this.suspects = toLookAt(data, Math.round(TOGETHER_S * header.frame_rate));

    this.follow = toggle("Follow", false, (on) => {
      this.space.follow = on;
      this.space.show(this.player.row);
      this.schedule();
    }, { icon: "follow", title: "Keep the person in the middle" });
    const holder = h("div", { class: "space-canvas" }, this.space.stage.canvas, this.doubts, this.legend, this.open);
    this.stop.push(onResize(holder, (w, height) => this.space.resize(w, height)));
    this.space.stage.name("The person in three dimensions");
    const space = h(
      "section",
      { class: "pane space", "aria-label": "3D" },
      h("div", { class: "pane-head" }, ...this.layerButtons(), h("span", { class: "grow" }), this.lookFrom(), this.follow.element),
      holder,
    );
    const main = h("div", { class: "view-main" });
    main.append(space, splitter(main, "right", "columns", "Width of the pictures", 44), this.rightPane(source));

    this.play = button("", () => this.player.toggle(), { icon: "play", title: "Play", key: "Space" });
    this.speed = select("Speed", SPEEDS.map((s) => ({ value: s, label: `${s}×` })), 1, (s) => this.player.setSpeed(s));
    const doubtful = data.flags.reduce((n, flag) => n + Number(flag === DOUBTFUL), 0);
    const keys = bindKeys("Keys of this screen", viewKeys(this), options.keysIn);
    this.stop.push(keys.stop);
    const flagged = this.suspects.length > 0;
    const transport = h(
      "section",
      { class: "transport", "aria-label": "Time" },
      h(
        "div",
        { class: "row" },
        button("", () => this.player.step(-1), { icon: "back", title: "One frame back", key: "←", kind: "quiet" }),
        this.play,
        button("", () => this.player.step(1), { icon: "next", title: "One frame on", key: "→", kind: "quiet" }),
        this.speed,
        toggle("", true, (on) => (this.player.loop = on), { icon: "loop", title: "Begin again at the end" }).element,
        flagged ? button("Next doubt", () => this.nextFlag(1), { icon: "flag", title: "Next stretch that is lost, extrapolated or doubtful", key: "n", kind: "quiet" }) : null,
      ),
      this.timeline.element,
      this.where,
    );
    this.element = h("div", { class: "view" });
    this.element.append(
      h(
        "div",
        { class: "view-parts" },
        h(
          "div",
          { class: "view-head" },
          options.back ?? null,
          h("h1", { title: header.title }, header.title),
          h("span", { class: "chip" }, header.recipe),
          h("span", { class: "dim number" }, `${header.frames} frames · ${round(header.frame_rate)} fps`),
          header.summary.lost ? h("span", { class: "chip bad" }, `${header.summary.lost} lost`) : null,
          header.summary.extrapolated ? h("span", { class: "chip warn" }, `${header.summary.extrapolated} extrapolated`) : null,
          doubtful ? h("span", { class: "chip warn", title: "There the evidence speaks against itself" }, `${doubtful} doubtful`) : null,
          header.complete ? null : h("span", { class: "chip warn" }, "not complete"),
          h("span", { class: "grow" }),
          ...(options.tools ?? []),
          button("", keys.help, { icon: "help", title: "Keys", key: "?", kind: "quiet" }),
          header.assessment ? assessment(header.assessment) : null,
          this.compared,
          this.corrector?.element ?? null,
        ),
        main,
        splitter(this.element, "plots", "rows", "Height of the plots", 25, [8, 60]),
        h("section", { class: "pane plots-pane", "aria-label": "Plots" }, h("div", { class: "pane-head" }, this.plots.tabs, h("span", { class: "grow" }), ...this.plots.tools), this.plots.element),
      ),
      transport,
    );
    // as wide as it will ever be, so that the line of time keeps its place
    this.where.style.width = `${this.place(data.frames - 1).length + 1}ch`;
    this.player.show(options.row ?? 0);
    this.measured.expose(this);
    this.schedule();
  }

  /** Shows a frame. */
  go(row: number): void {
    this.player.playing = false;
    this.player.show(row);
    this.schedule();
  }

  look(from: Direction): void {
    this.space.look(from);
  }

  flip(layer: Layer): void {
    this.layers.get(layer)?.element.click();
  }

  flipFollow(): void {
    this.follow.element.click();
  }

  /** Goes to the beginning of the next (1) or the previous (-1) stretch that is lost, extrapolated or doubtful. */
  nextFlag(direction: 1 | -1): void {
    const firsts = this.suspects.map((s) => s.first);
    const row = this.player.row;
    const found = direction > 0 ? firsts.find((f) => f > row) : firsts.filter((f) => f < row).pop();
    const next = found ?? (direction > 0 ? firsts[0] : firsts[firsts.length - 1]);
    if (next === undefined) toast("No frame is lost, extrapolated or doubtful.");
    else this.go(next);
  }

  /** Puts another run beside this one; null takes it away. */
  compare(beside: Beside | null): void {
    this.legend.replaceChildren(
      ...(beside ? [entry("body", `${this.options.name ?? "this result"}`), entry("beside", `${beside.name} (dashed in the plots)`)] : []),
      ...(beside && this.space.hasTruth ? [entry("other", "truth")] : []),
    );
    this.compared.replaceChildren(...(beside ? [apartInWords(this.data, beside)] : []));
    this.space.compare(beside);
    this.cameras.compare(beside);
    this.plots.compare(beside);
    this.schedule();
  }

  close(): void {
    for (const stop of this.stop) stop();
    clearTimeout(this.rest);
    this.player.playing = false;
    this.measured.stop();
    this.corrector?.close();
    this.space.close();
    this.cameras.close();
    this.plots.close();
    this.timeline.close();
  }

  /** The frame shown has changed by itself: its joints were moved. */
  redraw(): void {
    this.space.show(this.player.row);
    this.cameras.draw();
    this.told = -1;
    this.schedule();
  }

  /** Something is to be shown anew. */
  private schedule(): void {
    this.dirty = true;
    this.request();
  }

  private request(): void {
    if (this.pending) return;
    this.pending = true;
    requestAnimationFrame((now) => this.frame(now));
  }

  private frame(now: number): void {
    this.pending = false;
    if (!this.element.isConnected && this.shown >= 0) return;
    const moved = this.player.tick(now);
    if (this.drawnAt) this.passed = now - this.drawnAt;
    this.drawnAt = 0;
    // a screen has more frames than a recording: what shows the same again would only cost time
    if (moved || this.dirty) {
      this.dirty = false;
      if (this.player.row !== this.shown) this.showRow(this.player.row);
      this.tell(now);
      this.controls();
      this.space.draw(this.passed);
      this.measured.drawn();
      this.drawnAt = now;
    }
    if (this.player.playing) this.request();
  }

  private showRow(row: number): void {
    this.shown = row;
    this.space.show(row);
    this.cameras.show(row);
    this.plots.show(row);
    this.timeline.show(row);
    this.measured.changed();
    clearTimeout(this.rest);
    if (this.options.rested) this.rest = window.setTimeout(() => this.options.rested?.(row), 400);
  }

  /** The figures of the frame shown. While it plays nobody reads each of them, and text is dear to draw. */
  private tell(now: number): void {
    if (this.told === this.shown || (this.player.playing && now - this.toldAt < TELL_MS)) return;
    this.told = this.shown;
    this.toldAt = now;
    setText(this.where, this.place(this.shown));
    if (this.data.rivals) setText(this.open, openness(this.data.rivals, this.shown));
    const doubtful = doubtfulAt(this.data, this.shown).map((j) => (this.data.header.joint_names[j] ?? "").replaceAll("_", " "));
    setText(this.doubts, doubtful.length ? `May be wrong here: ${doubtful.join(", ")}` : "");
    this.plots.tell();
  }

  private place(row: number): string {
    return `${clock(this.data.times[row] ?? 0)}  ·  frame ${row + this.data.header.first_frame}`;
  }

  private controls(): void {
    const { playing, speed } = this.player;
    const wanted = playing ? "Pause" : "Play";
    if (this.play.getAttribute("aria-label") !== wanted) {
      this.play.setAttribute("aria-label", wanted);
      this.play.replaceChildren(...button("", () => undefined, { icon: playing ? "pause" : "play" }).children);
    }
    if (this.speed.value !== String(speed)) this.speed.value = String(speed);
  }

  private layerButtons(): HTMLElement[] {
    return LAYER_BUTTONS.flatMap(([layer, label, icon, key]) => {
      if (layer === "body" && !this.space.hasBody) return [];
      if (layer === "truth" && !this.space.hasTruth) return [];
      if (layer === "rivals" && !this.data.rivals) return [];
      if (layer === "cameras" && !this.data.header.cameras.length) return [];
      if (layer === "spread" && !this.data.sd.some(Number.isFinite)) return [];
      const one = toggle(label, this.space.on[layer], (on) => {
        this.space.set(layer, on);
        this.schedule();
      }, { icon, key, title: TITLES[layer] });
      this.layers.set(layer, one);
      return [one.element];
    });
  }

  private lookFrom(): HTMLElement {
    const fixed = [["fit", "Whole walk"], ["front", "From the front"], ["side", "From the side"], ["top", "From above"]] as const;
    const list = [
      { value: "", label: "Look…" },
      ...fixed.map(([value, label]) => ({ value: value as string, label })),
      ...this.data.header.cameras.map((c, i) => ({ value: String(i), label: `As ${c.name}` })),
    ];
    const made: HTMLSelectElement = select("Look from", list, "", (value) => {
      made.value = "";
      if (value) this.look(/^\d+$/.test(value) ? Number(value) : (value as Direction));
    });
    return made;
  }

  private rightPane(source: Source): HTMLElement {
    const about = details(this.data, source, this.options.doctor ?? null);
    const tools = h("div", { class: "row" }, this.corrector?.opener ?? null, ...this.cameras.tools());
    const panel = h("div", { class: "right-content" }, this.cameras.element, about);
    const { element, show } = tabs("Beside", [{ name: "cameras", label: "Cameras" }, { name: "details", label: "Details" }], (name) => {
      this.cameras.element.hidden = tools.hidden = name !== "cameras";
      about.hidden = name !== "details";
    });
    show("cameras");
    return h("section", { class: "pane right", "aria-label": "Cameras and details" }, h("div", { class: "pane-head" }, element, h("span", { class: "grow" }), tools), panel);
  }
}

const TITLES: Record<Layer, string> = {
  body: "The body",
  skeleton: "Joints and bones; the left side orange, the right side blue",
  spread: "Where every joint lies with 90 %",
  rivals: "Other poses that explain the pictures as well",
  trails: "Where pelvis, hands and feet went in the last two seconds",
  cameras: "The cameras",
  truth: "The truth of this made-up recording",
};

function entry(tone: string, text: string): HTMLElement {
  return h("span", { style: `--c: var(--${tone})` }, text);
}

const TONES = { good: ["good", "done"], look: ["warn", "warning"], "not to be trusted": ["bad", "warning"] } as const;

/** What is to be thought of the result, in one line on top of it. */
function assessment({ word, sentence }: NonNullable<ViewData["header"]["assessment"]>): HTMLElement {
  const [tone, sign] = TONES[word] ?? TONES.look;
  return h("p", { class: `view-assessment ${tone}` }, icon(sign), h("span", {}, plain(sentence)));
}

function round(rate: number): string {
  return Number(rate.toFixed(2)).toString();
}
