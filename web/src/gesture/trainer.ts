import { address, type Socket } from "../api";
import { answered, touchedAt, type Counters } from "../counters";
import type { GestureCommand, GestureRequest, GestureStep, Picture } from "../protocol";
import { button, toggle, type Toggle } from "../ui/buttons";
import { h, memory, setText } from "../ui/dom";
import { bindKeys, type Key } from "../ui/keyboard";
import { play, setMuted } from "../ui/sounds";
import { onTheme } from "../ui/theme";
import { signature, sourceTitle, type Live } from "./live";
import { Classes } from "./classes";
import { Numbers } from "./numbers";
import { Prompt } from "./prompt";
import { ScorePlot } from "./scores";
import { DepthStage } from "./stage";

const SIDE_MS = 120;

/** The screen of a running session. */
export class Trainer {
  readonly element: HTMLElement;
  private readonly prompt = new Prompt();
  private readonly numbers = new Numbers();
  private readonly stage: DepthStage;
  private readonly scores: ScorePlot;
  private readonly classes: Classes | null;
  private readonly pause: HTMLButtonElement;
  private readonly commands = new Map<GestureCommand, HTMLButtonElement>();
  private readonly saved = h("span", { class: "dim saved" });
  /** The hand as it was learned so far. */
  private readonly hand = h("span", { class: "thumbnail gesture-picture", hidden: true });
  private shownSaved: Live["saved"] = null;
  private readonly slider = h("input", { type: "range", min: 0, max: 1000, "aria-label": "Threshold", title: "Threshold" });
  private readonly sliderValue = h("output", { class: "number" }, "–");
  private readonly automatic: HTMLButtonElement;
  private readonly after = h("div", { class: "after", hidden: true });
  private readonly map: Toggle;
  private readonly stops: (() => void)[];
  private asked: { at: number; before: string }[] = [];
  private sliding = 0;
  private shownBeside = 0;
  private besideLater = 0;
  private waiting = 0;

  constructor(
    private readonly live: Live,
    private readonly socket: Socket,
    private readonly counters: Counters,
    private readonly leave: (next: GestureRequest | null) => void,
  ) {
    const teaches = live.session?.mode === "train";
    this.stage = new DepthStage(
      (x, y) => teaches && this.live.session?.source === "realsense" && socket.send({ t: "box", x, y }),
      (seq) => void socket.send({ t: "ack", seq }),
      () => this.later(),
    );
    this.classes = live.session && !teaches ? new Classes(live.session) : null;
    this.scores = new ScorePlot((value) => this.threshold(value));
    const keys = this.keys(teaches);
    this.pause = button("Pause", () => this.flipPause(), { icon: "pause", key: "Space" });
    this.automatic = button("Automatic", () => this.threshold(null), { title: "Let the session find the threshold" });
    this.map = toggle("Map", false, (on) => this.showMap(on), { icon: "other", title: "Where the forest sees the gesture", key: "m" });
    const bound = bindKeys("Gestures", keys);
    this.slider.addEventListener("input", () => this.threshold((Number(this.slider.value) / 1000) * this.scores.highest));
    this.element = this.layout(teaches, bound.help);
    this.stage.element.append(this.after);
    this.stops = [bound.stop, onTheme(() => this.numbers.recolour())];
    setMuted(memory.get("mute") === "on");
    if (live.session) this.stage.setSize(live.session.size);
    this.show();
  }

  /** Shows the state as it is, in the next frame: text, picture and plot at once, since every frame in which anything
   * changes has its price. A page that is hidden has no frames, but its tones go on. */
  later(): void {
    if (document.hidden) return this.show();
    this.waiting ||= requestAnimationFrame(() => {
      this.waiting = 0;
      this.show();
      this.stage.draw();
      this.counters.pictures = this.stage.drawn;
    });
  }

  private show(): void {
    const { live } = this;
    this.prompt.show(live);
    const over = live.ended !== null;
    const paused = live.step?.paused ?? false;
    const label = paused ? "Go on" : "Pause";
    if (this.pause.textContent !== label) {
      this.pause.lastElementChild!.textContent = label;
      this.pause.setAttribute("aria-label", label);
    }
    this.pause.classList.toggle("primary", paused && !over);
    for (const b of [this.pause, ...this.commands.values()]) b.disabled = over;
    const test = live.step?.phase === "test";
    for (const name of ["next", "test"] as const) this.commands.get(name)!.disabled = over || test;
    this.showBeside();
    if (live.saved !== this.shownSaved) this.showHand((this.shownSaved = live.saved));
    setText(this.saved, live.saved ? `Saved: ${live.saved.path}` : live.session?.mode === "train" ? "Recording" : "");
    if (over && this.after.hidden) this.showAfter(live.ended!);
  }

  /** After every saving: of the frames that the gesture was learned from the one in the middle. */
  private showHand(saved: Live["saved"]): void {
    if (!saved) return;
    const src = address(`/api/models/${saved.model}/thumbnail.jpg`, { at: Date.now() });
    const image = h("img", { alt: "The gesture as it was learned", src, onload: () => {
      this.hand.hidden = false;
      this.hand.replaceChildren(image);
    } });
  }

  /** The column beside the picture: a few times a second is enough, and leaves the time to the picture. */
  private showBeside(): void {
    const wait = SIDE_MS - (performance.now() - this.shownBeside);
    clearTimeout(this.besideLater);
    if (wait > 0) {
      this.besideLater = window.setTimeout(() => this.later(), wait);
      return;
    }
    this.shownBeside = performance.now();
    this.scores.show(this.live.history, this.live.step?.threshold ?? null);
    this.numbers.show(this.live);
    this.classes?.show(this.live);
    this.showThreshold(this.live.step);
  }

  takeStep(step: GestureStep): void {
    this.stage.takeStep(step);
    if (!this.stage.expects || this.asked.length) this.later();
    const now = signature(step);
    this.asked = this.asked.filter(({ at, before }) => {
      if (now === before) return true;
      answered(this.counters, at);
      return false;
    });
    if (step.events.some((e) => e.event === "start")) play("detected");
  }

  takePicture(picture: Picture): void {
    void this.stage.takePicture(picture);
  }

  close(): void {
    clearTimeout(this.besideLater);
    cancelAnimationFrame(this.waiting);
    this.stage.close();
    this.scores.close();
    this.numbers.close();
    for (const stop of this.stops) stop();
  }

  private command(command: GestureCommand): void {
    this.asked.push({ at: touchedAt(), before: signature(this.live.step) });
    this.socket.send({ t: "command", command });
  }

  private flipPause(): void {
    this.command(this.live.step?.paused ? "continue" : "pause");
  }

  private threshold(value: number | null): void {
    this.asked.push({ at: touchedAt(), before: signature(this.live.step) });
    this.sliding = value === null ? 0 : performance.now();
    this.socket.send({ t: "threshold", value: value === null ? null : Math.max(0.05, value) });
  }

  private showThreshold(step: GestureStep | null): void {
    const t = step?.threshold ?? null;
    this.slider.disabled = t === null;
    this.automatic.disabled = !step?.manual;
    setText(this.sliderValue, t === null ? "–" : `${t.toFixed(1)} cm²${step?.manual ? "" : ", automatic"}`);
    if (t !== null && performance.now() - this.sliding > 500) this.slider.value = String(Math.round((1000 * t) / this.scores.highest));
  }

  private showMap(on: boolean): void {
    this.map.set(on);
    this.stage.showMap = on;
    this.socket.send({ t: "map", on });
  }

  private mute(on: boolean): void {
    setMuted(!on);
    memory.set("mute", on ? "off" : "on");
  }

  private showAfter(why: string): void {
    this.after.hidden = false;
    const { session, saved } = this.live;
    const source = session?.source ?? "simulated:0";
    const again = session && saved && session.mode === "train";
    this.after.replaceChildren(
      h("h2", {}, why),
      h("p", { class: "dim" }, saved ? `The gesture is saved as ${saved.path}.` : session?.mode === "train" ? "Nothing was learned, so there is nothing to save." : ""),
      h(
        "div",
        { class: "row" },
        again ? button("Teach it more", () => this.leave({ t: "start", mode: "train", gesture: session.gestures[0]!, source, resume: saved.model, rounds: session.rounds, seconds: session.seconds }), { icon: "plus" }) : null,
        again ? button("Watch for it", () => this.leave({ t: "start", mode: "run", models: [saved.model], source }), { icon: "play" }) : null,
        button("Another gesture", () => this.leave(null), { kind: "primary" }),
      ),
    );
    this.after.querySelector<HTMLElement>("button.primary")?.focus();
  }

  private keys(teaches: boolean): Key[] {
    const key = (key: string, command: GestureCommand, what: string): Key => ({
      keys: [key], shown: key, what, act: () => this.live.ended === null && this.command(command),
    });
    return [
      { keys: [" "], shown: "Space", what: "pause, go on", act: () => this.flipPause() },
      ...(teaches
        ? [
            key("n", "next", "next phase now"), key("u", "undo", "take the last learned segment back"),
            key("a", "again", "another round"), key("t", "test", "end teaching, try it"),
            { keys: ["s"], shown: "s", what: "save now", act: () => void this.socket.send({ t: "save" }) },
          ]
        : []),
      { keys: ["m"], shown: "m", what: "where the forest sees the gesture", act: () => this.showMap(!this.map.on) },
      { keys: ["f"], shown: "f", what: "picture only, or everything", act: () => this.element.classList.toggle("large") },
    ];
  }

  private layout(teaches: boolean, help: () => void): HTMLElement {
    const make = (command: GestureCommand, text: string, options: Parameters<typeof button>[2]): HTMLElement => {
      const b = button(text, () => this.command(command), options);
      this.commands.set(command, b);
      return b;
    };
    const teaching = [
      make("next", "Next", { icon: "next", key: "n", title: "Next phase now" }),
      make("undo", "Undo", { icon: "undo", key: "u", title: "Take the last learned segment back" }),
      make("again", "Again", { icon: "loop", key: "a", title: "Another round" }),
      make("test", "Test", { icon: "flag", key: "t", title: "End teaching, try it" }),
      button("Save", () => this.socket.send({ t: "save" }), { icon: "download", key: "s", title: "Save now; it is saved every 10 s anyway" }),
    ];
    const sound = toggle("Sound", memory.get("mute") !== "on", (on) => this.mute(on), { icon: "sound" });
    const hold = h("input", { type: "number", min: 0, max: 10, step: 0.05, value: 0.15, "aria-label": "Seconds to hold" });
    hold.addEventListener("change", () => this.socket.send({ t: "hold", seconds: Math.min(10, Math.max(0, Number(hold.value) || 0)) }));
    return h(
      "div",
      { class: "gesture-screen" },
      h(
        "div",
        { class: "gesture-main" },
        this.prompt.element,
        this.stage.element,
        h(
          "div",
          { class: "gesture-tools", role: "toolbar", "aria-label": "Session" },
          this.pause,
          ...(teaches ? teaching : []),
          button("Stop", () => this.socket.send({ t: "stop" }), { icon: "close", title: "End the session; everything is kept" }),
          h("span", { class: "grow" }),
          this.map.element,
          sound.element,
          button("", () => this.element.classList.toggle("large"), { icon: "expand", title: "Picture only", key: "f", kind: "quiet" }),
          button("", help, { icon: "help", title: "Keys", key: "?", kind: "quiet" }),
        ),
      ),
      h(
        "aside",
        { class: "gesture-side" },
        h("div", { class: "side-head" }, this.hand, h("h1", {}, this.live.session?.gestures.join(", ") ?? ""), h("span", { class: "dim" }, this.live.session ? sourceTitle(this.live.session) : ""), this.saved),
        this.scores.element,
        h("div", { class: "row threshold" }, h("span", { class: "field-name" }, "Threshold"), this.slider),
        h("div", { class: "row threshold" }, h("span", { class: "field-name" }), this.sliderValue, this.automatic),
        h("div", { class: "row threshold" }, h("span", { class: "field-name" }, "Hold it for"), hold, h("span", { class: "dim" }, "s until it counts")),
        this.classes ? h("section", {}, h("h3", {}, "Watched for"), this.classes.element) : null,
        teaches ? h("section", {}, h("h3", {}, "Learned"), this.numbers.learned) : null,
        teaches ? h("section", {}, h("h3", {}, "How good it is"), this.numbers.good, this.numbers.curve) : null,
        h("section", { class: "event-log" }, h("h3", {}, "Seen"), this.numbers.log),
      ),
    );
  }
}
