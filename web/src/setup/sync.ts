import type { Recording } from "../protocol";
import { button, select } from "../ui/buttons";
import { h } from "../ui/dom";
import { icon } from "../ui/icons";
import { begin } from "./check";
import { CameraPictures } from "./pictures";

/** frames: cameras that differ by less show the same instant, for a person who walks. */
const IN_STEP = 0.5;

/** Do all cameras show the same instant? The pictures side by side, moved by how late each camera is. */
export class SyncStep {
  readonly element: HTMLElement;
  private readonly late: number[];
  private readonly found: readonly number[] | null;
  private by = "motion";
  private largest = 0;
  private readonly pictures: CameraPictures;
  private readonly numbers: HTMLElement[];
  private readonly sliders: HTMLInputElement[];
  private readonly assessment = h("p", { class: "assessment" });
  private readonly write: HTMLButtonElement;

  constructor(private readonly recording: Recording) {
    const { sync } = recording;
    this.found = recording.offsets;
    this.late = this.found ? [...this.found] : recording.views.map(() => 0);
    this.by = ["sound", "flash"].find((by) => by === sync?.by) ?? "motion";
    this.pictures = new CameraPictures(recording, "Picture", (k) => ({
      frame: Math.min(recording.frames - 1, Math.max(0, this.pictures.frame + Math.round(this.late[k]!))),
    }));
    this.numbers = recording.views.map(() => h("output", { class: "number" }));
    const reach = Math.max(10, Math.ceil(recording.frame_rate), ...this.late.map((x) => Math.ceil(Math.abs(x)) + 5));
    this.sliders = recording.views.map((v, k) => {
      const input = h("input", { type: "range", min: -reach, max: reach, step: 0.25, value: this.late[k], "aria-label": `Frames that ${v.name} is late` });
      input.addEventListener("input", () => {
        this.late[k] = Number(input.value);
        this.show();
      });
      return input;
    });
    this.write = button("Synchronise the cameras", () => void begin(this.recording, "in_step", { offsets: this.late }), {
      icon: "done", title: "Makes a recording of masks and key points on one clock; this one stays as it is",
    });
    const seconds = select("How far apart at most", [0, 0.5, 2, 10, 60].map((s) => ({ value: s, label: s ? `up to ${s} s apart` : "however far apart" })), this.largest, (v) => (this.largest = v));
    this.element = h(
      "div",
      { class: "step" },
      h("h2", {}, "Synchronise"),
      h("p", { class: "dim" }, "All cameras should show the same instant. How late each one is can be found by how the person moves, by the sound (a clap), or by the light (a flash); or move the sliders until the pictures agree."),
      h(
        "div",
        { class: "row wrap" },
        select("Found by", [{ value: "motion", label: "by motion" }, { value: "sound", label: "by sound" }, { value: "flash", label: "by light" }], this.by, (v) => (this.by = v)),
        seconds,
        button(this.found ? "Find out again" : "Find out", () => void begin(this.recording, "sync", { by: this.by, ...(this.largest ? { largest: this.largest } : {}) }), { icon: "follow", ...(this.found ? {} : { kind: "primary" as const }) }),
      ),
      this.assessment,
      h("div", { class: "row" }, ...this.pictures.chooser),
      h(
        "div",
        { class: "mask-pictures sync-pictures" },
        ...recording.views.map((_, k) =>
          h(
            "div",
            { class: "sync-view" },
            this.pictures.figures[k]!,
            h("div", { class: "row" }, this.sliders[k]!, this.numbers[k]!),
            sync && this.found ? h("small", { class: "dim" }, `found: ${words(this.found[k]!)} (${sync.views[k]!.how})`) : null,
          ),
        ),
      ),
      h("div", { class: "row wrap" }, this.write, button("As found", () => this.set(this.found ?? recording.views.map(() => 0)), { icon: "undo", title: "Back to what was found" })),
    );
    this.show();
  }

  close(): void {
    this.pictures.close();
  }

  private set(late: readonly number[]): void {
    late.forEach((x, k) => {
      this.late[k] = x;
      this.sliders[k]!.value = String(x);
    });
    this.show();
  }

  private show(): void {
    this.late.forEach((x, k) => (this.numbers[k]!.textContent = words(x)));
    const apart = Math.max(...this.late) - Math.min(...this.late);
    const ready = apart < IN_STEP;
    this.assessment.hidden = !this.found && apart === 0;
    this.assessment.className = `assessment ${ready ? "good" : "warn"}`;
    this.assessment.replaceChildren(
      icon(ready ? "done" : "warning"),
      ready ? `The cameras are synchronised: they differ by ${apart.toFixed(2)} frames at most.` : `The cameras differ by ${apart.toFixed(1)} frames (${(apart / Math.max(1, this.recording.frame_rate)).toFixed(2)} s). Synchronise them, and go on with that.`,
    );
    this.write.disabled = apart === 0;
    this.write.classList.toggle("primary", !ready);
    this.pictures.later();
  }
}

function words(late: number): string {
  const frames = Math.abs(late).toFixed(2).replace(/\.?0+$/, "");
  return Math.abs(late) < 0.005 ? "synchronised" : `${frames} ${frames === "1" ? "frame" : "frames"} ${late > 0 ? "late" : "early"}`;
}
