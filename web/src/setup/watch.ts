import { Vector3 } from "three";
import { getBytes, type ApiError } from "../api";
import { readBundle, type ViewData } from "../lib/bundle";
import type { Job } from "../protocol";
import { h, onResize } from "../ui/dom";
import { onTheme } from "../ui/theme";
import { Sticks } from "../view/figure";
import { Stage } from "../view/stage";
import { active } from "./feed";

const EVERY_MS = 2500;
const STEP_MS = 40;

/** The motion as it is being tracked: what has come since the last look is played, then the newest pose stands. */
export class LiveFigure {
  readonly element = h("div", { class: "live-figure" });
  private readonly caption = h("span", { class: "chip number" });
  private stage: Stage | null = null;
  private sticks: Sticks | null = null;
  private data: ViewData | null = null;
  private row = -1;
  private timer = 0;
  private steps = 0;
  private waiting = 0;
  private stops: (() => void)[] = [];
  private closed = false;

  constructor(private job: Job) {
    this.element.append(this.caption);
    this.caption.textContent = "waiting for the first frames";
    void this.ask();
  }

  show(job: Job): void {
    const ended = active(this.job) && !active(job);
    this.job = job;
    if (!ended) return;
    clearTimeout(this.timer);
    void this.ask();
  }

  close(): void {
    this.closed = true;
    clearTimeout(this.timer);
    clearInterval(this.steps);
    cancelAnimationFrame(this.waiting);
    for (const stop of this.stops) stop();
    this.stage?.close();
  }

  private async ask(): Promise<void> {
    clearTimeout(this.timer);
    const tracking = this.job.stages.some((s) => s.name === "track" && s.done > 0);
    if (tracking) {
      const found = await getBytes(`/api/jobs/${this.job.id}/view`).catch((error: ApiError) => error);
      if (this.closed) return;
      if (!(found instanceof ArrayBuffer)) {
        if (found.status === 404 && !this.data) this.caption.textContent = "shown when it is done";
      } else if (found.byteLength) this.take(readBundle(found));
    }
    if (!this.closed && active(this.job)) this.timer = window.setTimeout(() => void this.ask(), EVERY_MS);
  }

  private take(data: ViewData): void {
    this.data = data;
    if (!this.stage) this.begin(data);
    clearInterval(this.steps);
    this.steps = window.setInterval(() => this.step(), STEP_MS);
  }

  private begin(data: ViewData): void {
    const stage = (this.stage = new Stage(() => this.later()));
    this.sticks = new Sticks(data.header.parents, data.header.joint_names, null, 1.6);
    stage.over.add(this.sticks.group);
    stage.name("The motion tracked so far");
    this.element.prepend(stage.canvas);
    const at = new Vector3().fromArray(data.positions, 0);
    stage.layFloor(data.header.floor, at.x, at.y, 4);
    stage.look(at, new Vector3(0.5, -1, 0.4), 2);
    this.stops = [
      onResize(this.element, (w, hgt) => stage.resize(w, hgt)),
      onTheme(() => {
        stage.recolour();
        this.sticks?.recolour();
      }),
    ];
  }

  private step(): void {
    const { data } = this;
    if (!data || this.row >= data.frames - 1) return clearInterval(this.steps);
    this.row = Math.max(this.row + 1, data.frames - 60);
    this.sticks?.place(data.positions, 3 * this.row * data.joints);
    this.caption.textContent = `frame ${this.row + data.header.first_frame}`;
    this.later();
  }

  private later(): void {
    this.waiting ||= requestAnimationFrame(() => {
      this.waiting = 0;
      this.stage?.draw();
    });
  }
}
