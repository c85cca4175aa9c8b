import { ApiError, post } from "../api";
import type { Fit, FitRequest } from "../protocol";
import type { ClickState } from "./clicks";

export interface FitState {
  fit: Fit | null;
  /** The sentence why there is no fit. */
  problem: string | null;
  busy: boolean;
  /** Which of the poses that look the same is shown; 0 = the best. */
  choice: number;
}

/** Joints from which on a pose can be fitted; one is enough to correct a pose. */
const LEAST = 4;

/** Asks the server for the pose after every change: one question at a time, always the newest. */
export class Fitter {
  readonly state: FitState = { fit: null, problem: null, busy: false, choice: 0 };
  private again = false;
  private near = false;
  private readonly stop = new AbortController();

  constructor(
    private readonly clicks: ClickState,
    private readonly about: Omit<FitRequest, "views" | "start" | "height">,
    private readonly changed: () => void,
  ) {}

  height: number | null = null;

  /** near: a joint is being dragged, so the answer lies near the last one and comes sooner. */
  ask(near = false): void {
    this.near = near;
    if (this.state.busy) this.again = true;
    else void this.run();
  }

  /** The pose shown: the best, or the rival that was chosen. */
  get pose(): number[] | null {
    const { fit, choice } = this.state;
    return fit ? (fit.alternatives[choice - 1]?.pose ?? fit.pose) : null;
  }

  choose(choice: number): void {
    this.state.choice = choice;
    this.changed();
  }

  request(): FitRequest {
    return { ...this.about, views: this.clicks.views(), height: this.height };
  }

  close(): void {
    this.stop.abort();
  }

  private async run(): Promise<void> {
    const { state } = this;
    const joints = new Set(this.clicks.views().flatMap((v) => v.points.map((p) => p.joint)));
    if (joints.size < (this.about.result ? 1 : LEAST)) {
      Object.assign(state, { fit: null, problem: null, choice: 0 });
      this.changed();
      return;
    }
    state.busy = true;
    this.changed();
    try {
      const start = this.near && state.choice === 0 ? (state.fit?.pose ?? null) : null;
      const fit = await post<Fit>("/api/fit-clicks", { ...this.request(), start }, this.stop.signal);
      // while a joint is dragged the rivals stay those of the last whole search
      if (start && state.fit) fit.alternatives = [];
      Object.assign(state, { fit, problem: null, choice: 0 });
    } catch (error) {
      if (this.stop.signal.aborted) return;
      Object.assign(state, { fit: null, problem: error instanceof ApiError ? error.message : String(error), choice: 0 });
    }
    state.busy = false;
    if (this.again) {
      this.again = false;
      void this.run();
    }
    this.changed();
  }
}
