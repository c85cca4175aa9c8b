import type { Phase } from "../protocol";
import { h, setText } from "../ui/dom";
import { play } from "../ui/sounds";
import { PHASES, type Live } from "./live";

const SOUNDS = { positive: "go", release: "release", negative: "tick", test: "done" } as const;

/** What to do now, in letters that are read from two metres, with the seconds left; and the same in tones. */
export class Prompt {
  readonly element: HTMLElement;
  private readonly words = h("div", { class: "prompt-words", "aria-live": "assertive" });
  private readonly hint = h("div", { class: "prompt-hint" });
  private readonly count = h("div", { class: "prompt-count number", "aria-hidden": "true" });
  private readonly round = h("div", { class: "prompt-round number" });
  private readonly bars = PHASES.map((p) =>
    h("div", { class: "prompt-bar", "data-phase": p.phase }, h("span", {}, p.short), h("i")),
  );
  private phase: Phase | null = null;
  private second = -1;

  constructor() {
    this.element = h(
      "section",
      { class: "prompt", "aria-label": "What to do" },
      h("div", { class: "prompt-text" }, this.words, this.hint),
      h("div", { class: "prompt-side" }, this.count, this.round),
      h("div", { class: "prompt-bars" }, ...this.bars),
    );
  }

  show(live: Live): void {
    const { step, session } = live;
    const state = live.ended !== null ? "ended" : !step ? "wait" : step.paused ? "paused" : step.phase;
    const found = step?.found?.filter((f) => f.threshold !== null && f.score >= f.threshold).map((f) => f.gesture);
    const sees = !!step && state === "test" && (found ? found.length > 0 : step.detected);
    const shown = sees ? "sees" : state;
    if (this.element.dataset["state"] !== shown) this.element.dataset["state"] = shown;
    const name = session?.gestures[0] ?? "";
    setText(this.words, words(state, sees ? (found ?? [name]).join(", ") : "", step?.prompt ?? "", session?.mode === "run"));
    setText(this.hint, hint(state, session?.gestures ?? []));
    const left = state === "ended" || state === "test" ? null : (step?.left_s ?? null);
    setText(this.count, left === null ? "" : String(Math.ceil(left)));
    setText(this.round, !session || session.mode === "run" || !step ? "" : `round ${Math.min(step.round, session.rounds)} of ${session.rounds}`);
    this.fill(live);
    if (step && state !== "paused" && state !== "ended") this.sound(step.phase, left);
  }

  private fill(live: Live): void {
    const { step, session } = live;
    const teaches = session?.mode === "train" && step?.phase !== "test" && live.ended === null;
    (this.element.lastElementChild as HTMLElement).style.visibility = teaches ? "" : "hidden";
    if (!teaches || !step || !session) return;
    const now = PHASES.findIndex((p) => p.phase === step.phase);
    PHASES.forEach(({ phase }, k) => {
      const bar = this.bars[k]!;
      const seconds = session.seconds[phase] || 1;
      bar.style.flexGrow = String(Math.max(1.6, seconds));
      const share = k < now ? 1 : k > now ? 0 : 1 - Math.min(1, (step.left_s ?? 0) / seconds);
      (bar.lastElementChild as HTMLElement).style.transform = `scaleX(${share.toFixed(3)})`;
      bar.toggleAttribute("data-now", k === now);
    });
  }

  /** Tones at every change, and for the last three seconds before the gesture is learned. */
  private sound(phase: Phase, left: number | null): void {
    if (phase !== this.phase && this.phase !== null && phase in SOUNDS) play(SOUNDS[phase as keyof typeof SOUNDS]);
    this.phase = phase;
    const second = left === null ? -1 : Math.ceil(left);
    if (phase === "do_gesture" && second !== this.second && second >= 1 && second <= 3) play("tick");
    this.second = second;
  }
}

function words(state: string, seen: string, prompt: string, run: boolean): string {
  if (state === "ended") return "Done";
  if (state === "wait") return "Getting ready…";
  if (seen) return seen;
  if (state === "test") return run ? "Watching" : "Try it";
  return state === "paused" ? "Paused" : (PHASES.find((p) => p.phase === state)?.words ?? prompt);
}

function hint(state: string, gestures: readonly string[]): string {
  if (state === "paused") return "Nothing is learned until you go on (Space).";
  if (state === "test") return `Do ${gestures.join(" or ")} anywhere in the picture.`;
  return PHASES.find((p) => p.phase === state)?.what ?? "";
}
