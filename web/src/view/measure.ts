import type { ResultView } from "./result";

/** What the page measures of itself; read by tests and by whoever wonders why it is slow, as `hypose` in the console. */
export interface Measured {
  row: () => number;
  pictureRow: () => number;
  playing: () => boolean;
  /** ms from the last 500 inputs that changed the frame to the moment it was on the screen. */
  latency: number[];
  /** ms between the last 500 frames that were drawn while something moved. */
  frames: number[];
  held: () => { geometries: number; textures: number };
  view: ResultView;
}

const KEPT = 500;

export function measure(): { changed: () => void; drawn: () => void; expose: (view: ResultView) => void; stop: () => void } {
  const latency: number[] = [];
  const frames: number[] = [];
  let input = 0;
  let waiting = 0;
  let before = 0;
  const touched = (event: Event): void => {
    if (event.type !== "pointermove" || (event as PointerEvent).buttons) input = event.timeStamp;
  };
  const kinds = ["pointerdown", "pointermove", "keydown"] as const;
  for (const kind of kinds) document.addEventListener(kind, touched, { capture: true });
  return {
    changed() {
      if (input) waiting = input;
      input = 0;
    },
    drawn() {
      const now = performance.now();
      if (before && now - before < 1000) push(frames, now - before);
      before = now;
      if (!waiting) return;
      const since = waiting;
      waiting = 0;
      // what was drawn is handed to the screen before the task after the next animation frame begins
      requestAnimationFrame(() => push(latency, performance.now() - since));
    },
    expose(view) {
      const measured: Measured = {
        row: () => view.player.row,
        pictureRow: () => view.cameras.row,
        playing: () => view.player.playing,
        latency,
        frames,
        held: () => view.space.stage.held,
        view,
      };
      (window as unknown as { hypose?: Measured }).hypose = measured;
    },
    stop() {
      for (const kind of kinds) document.removeEventListener(kind, touched, { capture: true });
      delete (window as unknown as { hypose?: Measured }).hypose;
    },
  };
}

function push(list: number[], value: number): void {
  list.push(value);
  if (list.length > KEPT) list.shift();
}
