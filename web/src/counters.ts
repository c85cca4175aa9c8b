/** What a screen counts and measures of itself, for tests and for whoever wonders why it is slow: `__app` in the console. */
export interface Counters {
  screen: string;
  /** Pictures that were drawn. */
  pictures: number;
  /** ms from the last 300 clicks or keys to the moment their effect was on the screen. */
  latency: number[];
  [more: string]: unknown;
}

const KEPT = 300;

export function count(screen: string, more: Record<string, unknown> = {}): Counters {
  const counters: Counters = { screen, pictures: 0, latency: [], ...more };
  (window as unknown as { __app?: Counters }).__app = counters;
  return counters;
}

let touched = 0;
for (const kind of ["pointerdown", "pointerup", "keydown", "input"]) {
  document.addEventListener(kind, (event) => (touched = event.timeStamp), { capture: true });
}

/** When the hand last did something, as performance.now(): earlier than its handler runs, when the page is busy. */
export function touchedAt(): number {
  return touched;
}

/** Notes how long ago `since` (performance.now()) was, once what is drawn now has been handed to the screen: that is
 * after the next frame, when the one after it begins. */
export function answered(counters: Counters, since: number): void {
  requestAnimationFrame(() =>
    requestAnimationFrame(() => {
      counters.latency.push(performance.now() - since);
      if (counters.latency.length > KEPT) counters.latency.shift();
    }),
  );
}
