import { post } from "../api";
import type { Job, Stage } from "../protocol";
import { button } from "../ui/buttons";
import { h, plain, setText } from "../ui/dom";
import { toast } from "../ui/toast";
import { active } from "./feed";

const STATES = { queued: "waits", running: "runs", done: "done", failed: "failed", cancelled: "stopped" } as const;

/** A job as it runs: its stages with progress and time left, what it said, and what can be done about it. */
export class JobCard {
  readonly element: HTMLElement;
  private readonly title = h("h3");
  private readonly state = h("span", { class: "chip" });
  private readonly stages = h("div", { class: "stages" });
  private readonly said = h("pre", { class: "said", tabindex: 0, "aria-label": "What the job said" });
  private readonly error = h("p", { class: "bad" });
  private readonly actions = h("div", { class: "row job-actions" });
  private shownState = "";

  constructor(job: Job) {
    this.element = h(
      "article",
      { class: "card job", "data-job": job.kind },
      h("div", { class: "row" }, this.title, h("span", { class: "grow" }), this.state),
      this.stages,
      this.error,
      this.actions,
      h("details", { class: "job-more" }, h("summary", { class: "dim" }, "The same on the command line"), h("code", {}, job.command), this.said),
    );
    this.show(job);
  }

  /** connected: whether the server answers; while it does not, nobody knows what a job does. */
  show(job: Job, connected = true): void {
    this.title.textContent = job.title;
    this.element.dataset["state"] = job.state;
    const known = connected || !active(job);
    this.element.toggleAttribute("data-unknown", !known);
    this.state.textContent = known ? STATES[job.state] : "not known";
    this.state.className = `chip ${job.state === "failed" ? "bad" : job.state === "done" ? "good" : ""}`;
    this.error.textContent = plain(job.error ?? "");
    this.showStages(job.stages);
    setText(this.said, job.lines.join("\n")); // of many lines only the last come, so their number says nothing
    const key = `${job.state} ${job.result} ${job.resumable} ${known}`;
    if (key === this.shownState) return;
    this.shownState = key;
    this.actions.replaceChildren(
      ...(active(job) && known ? [button("Stop", () => void act(job, "cancel"), { icon: "close", title: "Stop it; what is done is kept" })] : []),
      ...(job.resumable && !active(job) && job.state !== "done" ? [button("Go on", () => void act(job, "resume"), { icon: "play", kind: "primary" })] : []),
      ...(job.state === "done" && job.result ? [h("a", { class: "button primary", href: `#/view/${job.result}` }, "Open in View")] : []),
      ...(job.state === "done" && job.makes ? [h("a", { class: "button primary", href: `#/setup/${job.makes}` }, "Go on with what is synchronised")] : []),
      ...(job.state === "failed" && job.kind === "refine" && /10 degrees or 0\.5 m/.test(job.error ?? "") ? [button("Take it all the same", () => void farther(job), { icon: "done", title: "Refine again, and let the cameras move as far as they have to" })] : []),
      ...(job.state === "done" && !job.result && !job.makes && job.recording && !location.hash.includes(job.recording) ? [h("a", { class: "button", href: `#/setup/${job.recording}` }, "Go on with the recording")] : []),
    );
  }

  private showStages(stages: readonly Stage[]): void {
    while (this.stages.children.length > stages.length) this.stages.lastElementChild?.remove();
    stages.forEach((stage, k) => {
      let row = this.stages.children[k] as HTMLElement | undefined;
      if (!row) {
        row = h("div", { class: "stage" }, h("span"), h("progress"), h("span", { class: "number dim" }));
        this.stages.append(row);
      }
      const [name, bar, rest] = row.children as unknown as [HTMLElement, HTMLProgressElement, HTMLElement];
      if (name.textContent !== stage.title) name.textContent = stage.title;
      bar.max = Math.max(1, stage.total);
      bar.value = stage.done;
      bar.setAttribute("aria-label", stage.title);
      rest.textContent = detail(stage);
    });
  }
}

function detail(stage: Stage): string {
  const parts = [stage.total > 1 ? `${stage.done} of ${stage.total}` : ""];
  const rate = stage.seconds > 0.2 ? stage.done / stage.seconds : 0;
  if (rate && stage.unit === "frames") parts.push(`${rate.toFixed(rate < 10 ? 1 : 0)} frames/s`);
  if (stage.done >= stage.total) parts.push(duration(stage.seconds));
  else if (rate) parts.push(`${duration((stage.total - stage.done) / rate)} left`);
  return parts.filter(Boolean).join(" · ");
}

export function duration(seconds: number): string {
  if (seconds < 10) return `${seconds.toFixed(1)} s`;
  const whole = Math.round(seconds);
  return whole < 120 ? `${whole} s` : `${Math.floor(whole / 60)} min ${whole % 60} s`;
}

async function farther(job: Job): Promise<void> {
  try {
    await post("/api/jobs", { kind: "refine", recording: job.recording, options: { ...job.options, far: true }, go_on: job.go_on });
  } catch (error) {
    toast((error as Error).message, "error");
  }
}

async function act(job: Job, what: "cancel" | "resume"): Promise<void> {
  try {
    await post(`/api/jobs/${job.id}/${what}`);
  } catch (error) {
    toast((error as Error).message, "error");
  }
}
