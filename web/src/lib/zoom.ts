export type XY = [number, number];

const MOST = 16;

/** Which part of a picture is shown, and how large: the whole picture in the middle of what shows it, or closer. Places on
 * the screen are CSS pixels of what shows it; pixel centres of the picture lie at whole numbers. */
export class Zoom {
  /** Width and height of the picture, and of what shows it. */
  picture: readonly [number, number] = [1, 1];
  screen: XY = [1, 1];
  private factor = 1;
  private offset: XY = [0, 0];

  /** Pixels of the screen per pixel of the picture. */
  get scale(): number {
    return this.factor * Math.min(this.screen[0] / this.picture[0], this.screen[1] / this.picture[1]);
  }

  /** How many times larger than the whole picture. */
  get times(): number {
    return this.factor;
  }

  toScreen([x, y]: XY): XY {
    const s = this.scale;
    return [
      this.screen[0] / 2 + this.offset[0] + (x + 0.5 - this.picture[0] / 2) * s,
      this.screen[1] / 2 + this.offset[1] + (y + 0.5 - this.picture[1] / 2) * s,
    ];
  }

  toPicture([u, v]: XY): XY {
    const s = this.scale;
    return [
      (u - this.screen[0] / 2 - this.offset[0]) / s + this.picture[0] / 2 - 0.5,
      (v - this.screen[1] / 2 - this.offset[1]) / s + this.picture[1] / 2 - 0.5,
    ];
  }

  /** So many times larger than the whole picture, with this place of the picture in the middle as far as the picture
   * reaches. */
  look(times: number, [x, y]: XY): void {
    this.factor = Math.min(MOST, Math.max(1, times));
    [x, y].forEach((at, k) => {
      const most = Math.max(0, (this.picture[k]! * this.scale - this.screen[k]!) / 2);
      this.offset[k] = Math.min(most, Math.max(-most, (this.picture[k]! / 2 - 0.5 - at) * this.scale));
    });
  }

  /** The whole picture. */
  fit(): void {
    this.factor = 1;
    this.offset = [0, 0];
  }

  /** Larger or smaller; what is at this place of the screen stays there. */
  by(factor: number, at: XY = [this.screen[0] / 2, this.screen[1] / 2]): void {
    const before = this.toPicture(at);
    this.factor = Math.min(MOST, Math.max(1, this.factor * factor));
    const after = this.toScreen(before);
    this.move(at[0] - after[0], at[1] - after[1]);
  }

  /** Moves the picture on the screen, but not out of it; the whole picture stays in the middle. */
  move(dx: number, dy: number): void {
    if (this.factor === 1) return this.fit();
    [dx, dy].forEach((d, k) => {
      const most = (this.picture[k]! * this.scale) / 2;
      this.offset[k] = Math.min(most, Math.max(-most, this.offset[k]! + d));
    });
  }
}

/** How much a turn of the wheel changes the size. */
export function wheelFactor(event: WheelEvent): number {
  return Math.exp(-0.0015 * event.deltaY);
}
