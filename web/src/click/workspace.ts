import { address, getBytes, post } from "../api";
import { answered, type Counters } from "../counters";
import { readBundle } from "../lib/bundle";
import type { ClickJoint, Job, NewJob, Recording, ResultEntry } from "../protocol";
import { button } from "../ui/buttons";
import { h, setText } from "../ui/dom";
import { bindKeys, type Key } from "../ui/keyboard";
import { toast } from "../ui/toast";
import { ClickState } from "./clicks";
import { Fitter } from "./fitter";
import { FitFacts, JointList } from "./panel";
import { ClickPicture } from "./picture";
import { FitSpace } from "./space";

/** Joints in one picture from which on one camera can be tracked with. */
const LEAST_OF_ONE = 6;

/** Clicking in the pictures of one frame, the fitted pose beside it. */
export class Workspace {
  readonly element: HTMLElement;
  readonly state: ClickState;
  private readonly fitter: Fitter;
  private readonly picture: ClickPicture;
  private readonly list: JointList;
  private readonly facts: FitFacts;
  private readonly space: FitSpace;
  private readonly titles: Record<string, string>;
  private readonly cameras = h("div", { class: "row click-cameras", role: "radiogroup", "aria-label": "Camera" });
  private readonly save = h("form", { class: "click-save" });
  private readonly again: HTMLButtonElement;
  private readonly few = h("p", { class: "dim" });
  private readonly stops: (() => void)[];
  private touched = 0;
  private before = "";
  private dragging = false;

  /** result: the pose of this result is corrected; frame: number in the recording. */
  constructor(
    private readonly recording: Recording,
    private readonly result: ResultEntry | null,
    readonly frame: number,
    joints: readonly ClickJoint[],
    private readonly counters: Counters,
    private readonly go: (frame: number) => void,
  ) {
    this.titles = Object.fromEntries(joints.map((j) => [j.joint, j.title]));
    const cameras = recording.cameras.filter((c) => c.pictures);
    const key = `clicks.${recording.id}.${result?.id ?? ""}.${frame}`;
    this.state = new ClickState(joints, cameras.map((c) => c.name), key, () => this.show());
    this.fitter = new Fitter(this.state, { recording: recording.id, result: result?.id ?? null, frame }, () => this.show());
    this.picture = new ClickPicture(this.state, (dragging) => {
      this.dragging = dragging;
      if (!dragging) this.fitter.ask(false);
    });
    this.list = new JointList(this.state, joints);
    this.facts = new FitFacts(this.fitter);
    const host = h("div", { class: "fit-space", role: "group", "aria-label": "The fitted pose in 3D; drag to turn it" });
    this.space = new FitSpace(cameras, host);
    this.cameras.append(
      ...cameras.map((c, k) =>
        h("button", { type: "button", class: "tab", role: "radio", "data-camera": c.name, title: k < 9 ? `${c.name} (${k + 1})` : c.name, onclick: () => this.state.show(c.name) }, c.name),
      ),
    );
    const bound = bindKeys("Click to start", this.keys());
    const undo = (event: KeyboardEvent): void => {
      if (!(event.ctrlKey || event.metaKey) || event.key.toLowerCase() !== "z") return;
      if (event.shiftKey) this.state.redo();
      else this.state.undo();
      event.preventDefault();
    };
    const touch = (event: Event): void => void (this.touched = event.timeStamp);
    document.addEventListener("keydown", undo);
    for (const kind of ["pointerdown", "keydown"]) document.addEventListener(kind, touch, { capture: true });
    this.stops = [
      bound.stop,
      () => document.removeEventListener("keydown", undo),
      () => ["pointerdown", "keydown"].forEach((kind) => document.removeEventListener(kind, touch, { capture: true })),
    ];
    this.again = button(this.corrects ? "Track again from here" : "Track from here", () => undefined, {
      icon: "play",
      title: this.corrects
        ? "Track this result again from the corrected pose on; the frames before stay, and so does the old result"
        : "Follow the person with one camera alone, from this frame on",
    });
    this.element = this.layout(host, bound.help);
    this.drawSave();
    void this.loadBody();
    void this.load();
    this.show();
  }

  close(): void {
    this.fitter.close();
    this.picture.close();
    this.space.close();
    for (const stop of this.stops) stop();
  }

  private shownCamera = "";

  /** Shows the state as it is, and asks for a fit when the clicks have changed. */
  private show(): void {
    const { state, fitter } = this;
    if (this.touched) {
      answered(this.counters, this.touched);
      this.touched = 0;
    }
    if (state.camera !== this.shownCamera) void this.load();
    this.list.show();
    this.picture.show(fitter.state.choice === 0 ? (fitter.state.fit?.pixels[state.camera] ?? {}) : {});
    this.picture.later();
    this.facts.show(state.count, this.titles);
    this.space.show(fitter.state.fit, fitter.state.choice);
    for (const tab of this.cameras.children as HTMLCollectionOf<HTMLElement>) {
      const name = tab.dataset["camera"] ?? "";
      const n = Object.keys(state.clicks[name] ?? {}).length;
      tab.setAttribute("aria-checked", String(name === state.camera));
      tab.textContent = n ? `${name} · ${n}` : name;
    }
    for (const b of this.save.querySelectorAll("button")) b.disabled = !fitter.state.fit;
    const { tooFew } = this;
    this.again.disabled = !fitter.state.fit || tooFew !== "";
    setText(this.few, fitter.state.fit ? tooFew : "");
    const size = this.recording.cameras.find((c) => c.name === state.camera)?.size;
    Object.assign(this.counters, { size, fit: fitter.state, clicks: state.clicks, joint: state.joint, drawn3d: () => this.space.drawn });
    const now = JSON.stringify(state.views());
    if (now === this.before) return;
    this.before = now;
    fitter.ask(this.dragging);
  }

  private async load(): Promise<void> {
    const camera = this.recording.cameras.find((c) => c.name === this.state.camera);
    if (!camera) return;
    this.shownCamera = camera.name;
    const width = Math.min(camera.size[0], 1920);
    const path = `/api/recordings/${this.recording.id}/image/${encodeURIComponent(camera.name)}/${this.frame}.jpg`;
    try {
      await this.picture.load(camera, address(path, { width }));
      this.counters.pictures++;
    } catch {
      toast(`The picture of ${camera.name}, frame ${this.frame}, cannot be shown; choose another frame.`, "error");
    }
  }

  /** The body that is fitted, of the height given. */
  private async loadBody(): Promise<void> {
    const query = new URLSearchParams({ recording: this.recording.id });
    if (this.result) query.set("result", this.result.id);
    if (this.fitter.height) query.set("height", String(this.fitter.height));
    try {
      this.space.setBody(readBundle(await getBytes(`/api/click-body?${query}`)));
    } catch {
      // without it the pose is shown as a skeleton
    }
  }

  private keys(): Key[] {
    const key = (keys: string[], shown: string, what: string, act: () => void): Key => ({ keys, shown, what, act });
    return [
      key(["Enter"], "Enter", "place the joint at the cross (in the picture)", () => this.picture.element.querySelector("canvas")?.focus()),
      key(["o"], "o", "hidden joint, yes or no", () => this.state.flipOccluded()),
      key(["u"], "u", "undo (also Ctrl Z)", () => this.state.undo()),
      key(["r"], "r", "redo", () => this.state.redo()),
      key(["Delete", "Backspace"], "Delete", "take the joint away", () => this.state.remove()),
      key(["["], "[", "joint before", () => this.state.step(-1)),
      key(["]"], "]", "next joint", () => this.state.step(1)),
      key([","], ",", "one frame back", () => this.go(this.frame - 1)),
      key(["."], ".", "one frame on", () => this.go(this.frame + 1)),
      key(["+", "="], "+", "zoom in", () => this.picture.zoomBy(1.5)),
      key(["-"], "-", "zoom out", () => this.picture.zoomBy(1 / 1.5)),
      key(["0"], "0", "whole picture", () => this.picture.fit()),
      ...this.state.cameras.slice(0, 9).map((name, k) => key([String(k + 1)], k ? "" : "1 … 9", "that camera", () => this.state.show(name))),
    ];
  }

  private drawSave(): void {
    const name = h("input", { type: "text", value: `frame-${this.frame}`, maxlength: 60, pattern: "[A-Za-z0-9_.\\-]+", required: true, "aria-label": "Name" });
    const height = h("input", { type: "number", min: 40, max: 280, step: 0.5, placeholder: "cm", "aria-label": "Height of the person in cm" });
    const known = this.recording.subject_height;
    if (known) height.value = (100 * known).toFixed(0);
    height.addEventListener("change", () => {
      this.fitter.height = height.value ? Number(height.value) / 100 : null;
      this.fitter.ask(false);
      void this.loadBody();
    });
    this.save.addEventListener("submit", (event) => {
      event.preventDefault();
      void this.keep(name.value);
    });
    const submit = button("Save", () => undefined, { kind: "primary", icon: "done", title: "Keep the clicks and the pose" });
    submit.type = "submit";
    this.save.append(
      this.result || this.recording.subject ? "" : h("div", { class: "field" }, h("label", { class: "field-name" }, "Height"), h("div", { class: "row" }, height, h("span", { class: "dim" }, "cm, if known"))),
      h("div", { class: "field" }, h("span", { class: "field-name" }, "Save as"), h("div", { class: "row" }, name, submit)),
      h("div", { class: "row" }, this.again),
      this.few,
    );
    this.again.addEventListener("click", () => void this.track(name.value));
  }

  /** Saves the clicks; their name, and the view that they are a start for. Null when they could not be saved. */
  private async keep(name: string): Promise<{ camera: string; name: string } | null> {
    try {
      const saved = await post<{ camera: string; name: string }>(`/api/recordings/${this.recording.id}/starts`, { ...this.fitter.request(), name, camera: this.state.camera });
      toast(`Saved as starts/${saved.name}.json`, "done");
      return saved;
    } catch (error) {
      toast((error as Error).message, "error");
      return null;
    }
  }

  /** Whether the result that is shown can itself be tracked again from this frame on; else one camera starts afresh. */
  private get corrects(): boolean {
    return this.result?.correctable ?? false;
  }

  /** Why nothing can be tracked from these clicks yet; "" when it can. */
  private get tooFew(): string {
    if (this.corrects) return "";
    const camera = this.state.most;
    const placed = Object.keys(this.state.clicks[camera ?? ""] ?? {}).length;
    return placed >= LEAST_OF_ONE ? "" : `To track from here, place ${LEAST_OF_ONE} joints in one picture${camera ? `; ${camera} has ${placed}` : ""}.`;
  }

  /** Saves, and tracks from this frame on: the result again from the corrected pose, or with this camera alone. */
  private async track(name: string): Promise<void> {
    const saved = await this.keep(name);
    if (saved === null) return;
    const view = saved.camera;
    const start = `clicks:${saved.name}`;
    const wanted: NewJob = this.corrects
      ? { kind: "correct", result: this.result!.id, options: { start } }
      : {
          kind: "track", recording: this.recording.id,
          options: { recipe: "monocular", camera: view, start, frames: `${this.frame}:`, name: `monocular-${view}` },
        };
    try {
      const job = await post<Job>("/api/jobs", wanted);
      toast(`${job.title} has begun.`);
      location.hash = `#/setup/${this.recording.id}`;
    } catch (error) {
      toast((error as Error).message, "error");
    }
  }

  private layout(host: HTMLElement, help: () => void): HTMLElement {
    const last = this.recording.frames - 1;
    const slider = h("input", { type: "range", min: 0, max: last, value: this.frame, "aria-label": "Frame", class: "grow" });
    slider.addEventListener("change", () => this.go(Number(slider.value)));
    const frame = h("output", { class: "number" }, `${this.frame} of ${last}`);
    slider.addEventListener("input", () => (frame.textContent = `${slider.value} of ${last}`));
    return h(
      "div",
      { class: "click-screen" },
      this.list.element,
      h(
        "div",
        { class: "click-main" },
        h(
          "div",
          { class: "pane-head" },
          this.cameras,
          h("span", { class: "grow" }),
          button("", () => this.picture.zoomBy(1 / 1.5), { kind: "quiet", icon: "back", title: "Zoom out", key: "-" }),
          button("", () => this.picture.fit(), { kind: "quiet", icon: "fit", title: "Whole picture", key: "0" }),
          button("", () => this.picture.zoomBy(1.5), { kind: "quiet", icon: "plus", title: "Zoom in", key: "+" }),
          button("Clear", () => this.state.clear(), { kind: "quiet", title: "Take all clicks away; undo brings them back" }),
          button("", help, { kind: "quiet", icon: "help", title: "Keys", key: "?" }),
        ),
        this.picture.element,
        h("div", { class: "row click-frame" }, h("span", { class: "dim" }, "Frame"), slider, frame),
      ),
      h("aside", { class: "click-side" }, h("h1", {}, this.recording.name), host, this.facts.element, this.save),
    );
  }
}
