import { rowAt } from "../lib/bundle";

export const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 4, 8] as const;

/** Which frame is shown, and the clock that moves it on while playing. */
export class Player {
  row = 0;
  playing = false;
  speed = 1;
  loop = true;
  private time = 0;
  private last = 0;

  constructor(
    private readonly times: Float64Array,
    private readonly changed: () => void,
  ) {}

  get rows(): number {
    return this.times.length;
  }

  /** Frames per second. */
  get rate(): number {
    const seconds = (this.times[this.rows - 1] ?? 0) - (this.times[0] ?? 0);
    return seconds > 0 ? (this.rows - 1) / seconds : 1;
  }

  /** Shows a frame; a row beyond the ends shows the end. */
  show(row: number): void {
    const next = Math.min(this.rows - 1, Math.max(0, Math.round(row)));
    this.time = this.times[next] ?? 0;
    if (next === this.row) return;
    this.row = next;
    this.changed();
  }

  step(rows: number): void {
    this.playing = false;
    this.show(this.row + rows);
    this.changed();
  }

  /** Starts or stops; at the end it starts from the beginning. */
  toggle(): void {
    this.playing = !this.playing && this.rows > 1;
    if (this.playing && this.row === this.rows - 1) this.show(0);
    this.last = 0;
    this.changed();
  }

  setSpeed(speed: number): void {
    this.speed = speed;
    this.changed();
  }

  faster(steps: number): void {
    const at = SPEEDS.findIndex((s) => s >= this.speed);
    this.setSpeed(SPEEDS[Math.min(SPEEDS.length - 1, Math.max(0, at + steps))] ?? 1);
  }

  /** Moves on to the time `now` (ms); true when another frame is to be shown. */
  tick(now: number): boolean {
    if (!this.playing) return false;
    const passed = this.last ? Math.min(0.25, (now - this.last) / 1000) : 0;
    this.last = now;
    const first = this.times[0] ?? 0;
    const end = this.times[this.rows - 1] ?? 0;
    this.time += passed * this.speed;
    if (this.time > end + 1e-9) {
      if (this.loop) this.time = first + ((this.time - first) % Math.max(1e-6, end - first));
      else {
        this.time = end;
        this.playing = false;
      }
    }
    const row = rowAt(this.times, this.time);
    const moved = row !== this.row;
    this.row = row;
    return moved || !this.playing;
  }
}
