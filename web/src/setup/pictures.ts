import { address } from "../api";
import type { Recording } from "../protocol";
import { h } from "../ui/dom";

const WAIT_MS = 60;
const WIDEST = 480;

/** What is shown of a camera: the frame, and how (the query of its address). */
export interface Wanted {
  frame: number;
  query?: Readonly<Record<string, string | number | boolean>>;
}

/** A frame of every camera of a recording, side by side, and the slider that chooses it. What is asked for in quick
 * succession is loaded once; while a picture comes something turns. */
export class CameraPictures {
  readonly figures: HTMLElement[];
  /** The slider with its frame number. */
  readonly chooser: HTMLElement[];
  frame: number;
  private readonly images: HTMLImageElement[];
  private waiting = 0;

  constructor(
    private readonly recording: Recording,
    what: string,
    private readonly wanted: (camera: number) => Wanted,
    loaded: () => void = () => undefined,
  ) {
    const [first, stop] = recording.frame_range ?? [0, recording.frames];
    this.frame = Math.floor((first + stop - 1) / 2);
    this.images = recording.cameras.map((c) => {
      const image = h("img", { alt: `${what} of ${c.name}`, width: c.size[0], height: c.size[1] });
      image.addEventListener("error", () => image.parentElement?.setAttribute("data-state", "failed"));
      image.addEventListener("load", () => {
        image.parentElement?.removeAttribute("data-state");
        loaded();
      });
      return image;
    });
    this.figures = this.images.map((image, k) => h("figure", { "data-state": "coming" }, image, h("span", { class: "mask-wait", role: "status" }), h("figcaption", {}, recording.cameras[k]!.name)));
    const told = h("output", { class: "number" }, String(this.frame));
    const slider = h("input", { type: "range", min: 0, max: recording.frames - 1, value: this.frame, class: "grow", "aria-label": "Frame" });
    slider.addEventListener("input", () => {
      this.frame = Number(slider.value);
      told.textContent = slider.value;
      this.later();
    });
    this.chooser = [h("span", { class: "dim" }, "Frame"), slider, told];
  }

  /** Loads what is wanted, in a moment. */
  later(): void {
    clearTimeout(this.waiting);
    this.waiting = window.setTimeout(() => this.load(), WAIT_MS);
  }

  load(): void {
    this.recording.cameras.forEach((c, k) => {
      const { frame, query } = this.wanted(k);
      const path = `/api/recordings/${this.recording.id}/image/${encodeURIComponent(c.name)}/${frame}.jpg`;
      const wanted = address(path, { width: Math.min(WIDEST, c.size[0]), ...query });
      const image = this.images[k]!;
      if (image.src === wanted) return;
      image.src = wanted;
      image.parentElement?.setAttribute("data-state", "coming");
    });
  }

  close(): void {
    clearTimeout(this.waiting);
  }
}
