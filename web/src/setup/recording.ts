import { get } from "../api";
import type { Counters } from "../counters";
import type { Job, JobForms, Recording, State } from "../protocol";
import { button } from "../ui/buttons";
import { h, plain } from "../ui/dom";
import { calibrateStep, usualBoard } from "./calibrate";
import { JobCard } from "./card";
import { checkStep, rescue } from "./check";
import { active, type JobFeed } from "./feed";
import { MaskStep } from "./masks";
import { personStep } from "./person";
import { SyncStep } from "./sync";
import { trackStep } from "./track";
import { LiveFigure } from "./watch";
import { wayCard } from "./way";

type Step = "calibrate" | "sync" | "check" | "masks" | "person" | "track";
const TITLES: Record<Step, string> = { calibrate: "Calibrate", sync: "Synchronise", check: "Check", masks: "Masks", person: "Person", track: "Track" };
const STEP_OF: Partial<Record<Job["kind"], Step>> = {
  calibrate: "calibrate", sync: "sync", in_step: "sync", check: "check", refine: "check", keypoints: "masks", silhouettes: "masks", subject: "person", track: "track", correct: "track",
};

/** One recording: the steps from videos to motion, and the jobs that do them. */
export class RecordingPage {
  readonly element: HTMLElement;
  private readonly nav = h("nav", { class: "steps", "aria-label": "Steps" });
  private readonly content = h("div", { class: "step-box" });
  private readonly side = h("aside", { class: "setup-jobs", "aria-label": "Jobs" });
  private readonly cards = new Map<string, JobCard>();
  private readonly notes = h("div");
  private readonly way = h("div");
  private readonly opened = Date.now() / 1000;
  private readonly facts = h("span", { class: "dim" });
  private step: Step;
  private masks: MaskStep | null = null;
  private sync: SyncStep | null = null;
  private readonly board = usualBoard();
  private figure: { id: string; live: LiveFigure } | null = null;

  constructor(
    private recording: Recording,
    private state: State,
    private readonly forms: JobForms,
    private readonly feed: JobFeed,
    private readonly counters: Counters,
  ) {
    this.step = firstStep(recording);
    this.element = h(
      "div",
      { class: "setup-recording" },
      h(
        "div",
        { class: "setup-main" },
        h("div", { class: "setup-title" }, h("a", { class: "dim", href: "#/setup" }, "Recordings"), h("h1", {}, recording.name), this.facts),
        this.notes,
        this.way,
        this.nav,
        this.content,
      ),
      this.side,
    );
    document.addEventListener("hypose-mended", this.mended);
    this.draw();
    this.showJobs();
  }

  private readonly mended = (): void => void this.reload(new AbortController().signal);

  /** Reads again what a job has found. */
  async reload(signal: AbortSignal): Promise<void> {
    const [recording, state] = await Promise.all([
      get<Recording>(`/api/recordings/${this.recording.id}`, signal),
      get<State>("/api/state", signal),
    ]);
    const others = JSON.stringify(recording.views) !== JSON.stringify(this.recording.views);
    this.recording = recording;
    this.state = state;
    // sliders that are being moved stay as they are
    if (this.step !== "masks" || !this.masks || others) this.draw();
    else this.drawNav();
  }

  showJobs(): void {
    const jobs = this.feed.of(this.recording.id).slice(0, 12);
    for (const job of jobs) {
      const card = this.cards.get(job.id);
      if (card) card.show(job, this.feed.connected);
      else this.cards.set(job.id, new JobCard(job));
    }
    const elements = jobs.map((j) => this.cards.get(j.id)!.element);
    const same = elements.length === this.side.querySelectorAll(".job").length && elements.every((e) => e.isConnected);
    if (!same || !this.side.children.length) {
      this.side.replaceChildren(h("h2", {}, "Jobs"), ...(elements.length ? elements : [h("p", { class: "dim" }, "What you begin at the left runs here; it goes on when the page is closed.")]));
    }
    this.drawWay();
    // the way to a motion goes on with the recording that is on one clock
    const made = jobs.find((j) => j.go_on && j.makes && j.state === "done" && (j.ended ?? 0) > this.opened)?.makes;
    if (made) location.hash = `#/setup/${made}`;
    this.showFigure(jobs.find((j) => (j.kind === "track" && active(j)) || j.id === this.figure?.id));
    this.drawNav();
  }

  close(): void {
    document.removeEventListener("hypose-mended", this.mended);
    this.masks?.close();
    this.sync?.close();
    this.figure?.live.close();
  }

  private showFigure(job: Job | undefined): void {
    if (job && this.figure?.id === job.id) return this.figure.live.show(job);
    if (!job) return;
    this.figure?.live.close();
    const live = new LiveFigure(job);
    this.figure = { id: job.id, live };
    this.cards.get(job.id)?.element.insertBefore(live.element, this.cards.get(job.id)!.element.children[1] ?? null);
  }

  private go(step: Step): void {
    this.step = step;
    this.draw();
  }

  private draw(): void {
    const { recording } = this;
    this.masks?.close();
    this.sync?.close();
    this.masks = this.sync = null;
    this.facts.textContent = facts(recording);
    const steps = this.steps();
    if (!steps.includes(this.step)) this.step = firstStep(recording);
    this.notes.replaceChildren(
      ...(recording.problem ? [h("div", { class: "card bad", role: "alert" }, recording.problem, h("div", { class: "row wrap cures" }, ...rescue(recording)))] : []),
      recording.notes.length ? h("details", { class: "notes" }, h("summary", { class: "dim" }, recording.notes.length === 1 ? "1 note on its files" : `${recording.notes.length} notes on its files`), ...recording.notes.map((n) => h("p", { class: "dim note" }, plain(n)))) : "",
    );
    this.drawNav();
    this.drawWay();
    if (recording.problem) return this.content.replaceChildren();
    if (this.step === "masks") {
      this.masks = new MaskStep(recording, this.counters, () => {
        this.masks = null;
        void this.reload(new AbortController().signal);
      });
    }
    if (this.step === "sync") this.sync = new SyncStep(recording);
    const names = new Map(this.state.results.map((r) => [r.id, r.name]));
    this.content.replaceChildren(
      this.step === "calibrate" ? calibrateStep(recording, this.board, this.feed.of(recording.id))
      : this.step === "sync" ? this.sync!.element
      : this.step === "check" ? checkStep(recording)
      : this.step === "masks" ? this.masks!.element
      : this.step === "person" ? personStep(recording)
      : trackStep(recording, this.forms["track"] ?? [], (id) => names.get(id) ?? id),
      ...this.onward(),
    );
  }

  private drawWay(): void {
    const { recording } = this;
    if (recording.problem) return this.way.replaceChildren();
    const jobs = this.feed.of(recording.id);
    const results = this.state.results.filter((r) => r.recording === recording.id);
    const key = JSON.stringify([recording, results, jobs.map((j) => [j.kind, j.state])]);
    if (this.way.dataset["key"] === key) return;
    this.way.dataset["key"] = key;
    this.way.replaceChildren(wayCard(recording, results, jobs, this.uncalibrated));
  }

  /** The steps that this recording has. */
  private steps(): Step[] {
    const { board, views } = this.recording;
    return [...(board ? ["calibrate" as const] : []), ...(views.length > 1 || this.uncalibrated ? ["sync" as const] : []), "check", "masks", "person", "track"];
  }

  private get uncalibrated(): boolean {
    return this.recording.board !== null && !this.recording.board.calibrated;
  }

  private onward(): HTMLElement[] {
    const steps = this.steps();
    const next = this.recording.problem || this.uncalibrated ? undefined : steps[steps.indexOf(this.step) + 1];
    return next ? [h("div", { class: "row step-next" }, button(`Next: ${TITLES[next]}`, () => this.go(next), { icon: "next" }))] : [];
  }

  private drawNav(): void {
    const running = new Set(this.feed.of(this.recording.id).filter((j) => active(j) && this.feed.connected).map((j) => STEP_OF[j.kind]));
    const done: Record<Step, string> = {
      calibrate: this.recording.board?.calibrated ? "done" : "",
      sync: this.recording.sync ? "done" : "",
      check: this.recording.check ? (this.recording.check.healthy ? "done" : "look") : "",
      masks: "",
      person: this.recording.subject ? "done" : "",
      track: this.recording.results.length ? "done" : "",
    };
    const steps = this.steps();
    const key = JSON.stringify([this.step, steps, this.uncalibrated, [...running], done]);
    if (this.nav.dataset["key"] === key) return;
    this.nav.dataset["key"] = key;
    this.nav.replaceChildren(
      ...steps.map((s, k) =>
        h(
          "button",
          { type: "button", class: "step-tab", "aria-current": s === this.step ? "step" : null, "data-step": s, disabled: this.uncalibrated && s !== "calibrate", onclick: () => this.go(s) },
          h("span", { class: "step-number" }, String(k + 1)),
          h("span", {}, TITLES[s]),
          h("small", { class: running.has(s) ? "accent" : done[s] === "look" ? "warn" : "good" }, running.has(s) ? "runs" : done[s] === "look" ? "look" : done[s] ? "done" : ""),
        ),
      ),
    );
  }
}

function firstStep(recording: Recording): Step {
  if (recording.board && !recording.board.calibrated) return "calibrate";
  return recording.check ? "track" : recording.board && !recording.sync && recording.views.length > 1 ? "sync" : "check";
}

function facts(r: Recording): string {
  const where = r.path === r.name ? [] : [r.path];
  if (r.problem) return where.join();
  const views = `${r.views.length} ${r.views.length === 1 ? "camera" : "cameras"}`;
  return [...where, views, `${r.frames} frames`, `${Number(r.frame_rate.toFixed(2))} frames/s`].join(" · ");
}
