import { post } from "../api";
import { answered, type Counters } from "../counters";
import type { MaskSettings, Recording } from "../protocol";
import { button, select, toggle } from "../ui/buttons";
import { h } from "../ui/dom";
import { toast } from "../ui/toast";
import { begin } from "./check";
import { CameraPictures } from "./pictures";

interface Slider {
  name: string;
  title: string;
  what: string;
  low: number;
  high: number;
  step: number;
}

const PLAIN: readonly Slider[] = [
  { name: "threshold", title: "Difference", what: "How much a pixel must differ from the empty room. Parts of the person are missing: lower. Shadows and noise are in: higher.", low: 1, high: 15, step: 0.5 },
  { name: "close_px", title: "Close gaps", what: "Joins parts of the person that are so near, in pixels.", low: 0, high: 25, step: 1 },
  { name: "keep_share", title: "Leave out", what: "Leaves out what is smaller than this share of the biggest part.", low: 0, high: 1, step: 0.01 },
];
const ADVANCED: readonly Slider[] = [
  { name: "min_sd", title: "Least noise", what: "grey levels; more where light flickers or video is compressed", low: 1, high: 25, step: 0.5 },
  { name: "shadow_chroma", title: "Shadow colour", what: "how much a shadow may differ in colour from the lit ground, grey levels", low: 0, high: 40, step: 1 },
  { name: "open_px", title: "Open", what: "px; takes thin things away", low: 0, high: 15, step: 1 },
  { name: "hole_px", title: "Holes", what: "px of area; smaller holes are filled", low: 0, high: 2000, step: 10 },
  { name: "keep_gap", title: "Farthest part", what: "share of the person's length; farther parts are dropped", low: 0, high: 1, step: 0.01 },
];

/** The masks of a frame in all cameras, with the settings as they are being moved. */
export class MaskStep {
  readonly element: HTMLElement;
  private settings: MaskSettings;
  private shown: "edge" | "fill" | "only" = "edge";
  private readonly pictures: CameraPictures;
  private readonly sliders = h("div", { class: "mask-sliders" });
  private readonly save = button("Use these settings", () => void this.keep(), { kind: "primary", icon: "done" });
  private asked = 0;
  private advanced = false;

  constructor(
    private readonly recording: Recording,
    counters: Counters,
    private readonly kept: () => void,
  ) {
    this.settings = { ...recording.mask_settings };
    this.pictures = new CameraPictures(recording, "Mask", () => ({ frame: this.pictures.frame, query: { mask: this.shown, settings: JSON.stringify(this.settings) } }), () => {
      counters.pictures++;
      if (this.asked) answered(counters, this.asked);
    });
    // given masks and depth are taken as they are
    const made = recording.views.some((v) => !v.depth && !v.masks);
    const bare = recording.views.length > 1 && recording.views.every((v) => v.video && !v.depth && !v.masks && !v.background && !v.keypoints);
    const why = made ? "usually the settings are right as they are" : "these are cut out by their depth, or were given, and there is nothing to set";
    this.element = h(
      "div",
      { class: "step" },
      h("h2", {}, "Masks"),
      h("p", { class: "dim" }, `The masks that tracking will use${recording.views.some((v) => v.keypoints) ? ", cut out around the key points" : ""}. In every frame the person should be cut out whole, and nothing else; ${why}.`),
      bare ? h("p", {}, "There is no picture of the empty room. A small network can find the person in the videos, points and masks; it is fetched once (36 MB).") : null,
      bare ? h("div", { class: "row" }, button("Find the person", () => void begin(recording, "keypoints", { yes: true }), { kind: "primary", icon: "play" })) : null,
      h(
        "div",
        { class: "row" },
        select("Show the mask as", [{ value: "edge", label: "outline" }, { value: "fill", label: "filled" }, { value: "only", label: "mask only" }], this.shown, (v) => {
          this.shown = v as typeof this.shown;
          this.pictures.later();
        }),
        ...this.pictures.chooser,
      ),
      h("div", { class: made ? "mask-layout" : "" }, h("div", { class: "mask-pictures" }, ...this.pictures.figures), made ? this.sliders : null),
    );
    this.drawSliders();
    this.pictures.load();
  }

  private drawSliders(): void {
    const rows = (sliders: readonly Slider[], told: boolean): HTMLElement[] => sliders.filter((s) => typeof this.settings[s.name] === "number").map((s) => {
      const value = h("output", { class: "number" }, String(this.settings[s.name]));
      const input = h("input", { type: "range", min: s.low, max: s.high, step: s.step, value: this.settings[s.name], "aria-label": s.title, title: s.what });
      input.addEventListener("input", () => {
        this.settings[s.name] = Number(input.value);
        value.textContent = input.value;
        this.changed();
      });
      return h("div", { class: "mask-slider", title: s.what }, h("span", {}, s.title), input, value, told ? h("small", { class: "dim" }, s.what) : null);
    });
    const flag = (name: string, text: string, title: string): HTMLElement =>
      toggle(text, this.settings[name] === true, (on) => {
        this.settings[name] = on;
        this.changed();
      }, { title }).element;
    const reset = button("As before", () => {
      this.settings = { ...this.recording.mask_settings };
      this.drawSliders();
      this.pictures.load();
    }, { title: "Back to the settings of the recording" });
    this.sliders.replaceChildren(
      ...rows(PLAIN, true),
      h("details", { open: this.advanced, ontoggle: (event: Event) => (this.advanced = (event.target as HTMLDetailsElement).open) }, h("summary", { class: "dim" }, "Advanced"), ...rows(ADVANCED, false),
      h("div", { class: "row wrap" }, flag("shadow", "No shadows", "Take shadows away; switch it off in grey scenes"))),
      h("div", { class: "row" }, this.save, reset),
    );
    this.save.disabled = true;
  }

  private changed(): void {
    this.asked = performance.now();
    this.save.disabled = false;
    this.pictures.later();
  }

  private async keep(): Promise<void> {
    try {
      await post(`/api/recordings/${this.recording.id}/mask-settings`, this.settings);
      toast("The masks are made with these settings from now on.", "done");
      this.kept();
    } catch (error) {
      toast((error as Error).message, "error");
    }
  }

  close(): void {
    this.pictures.close();
  }
}
