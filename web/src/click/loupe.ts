import type { Point } from "./clicks";

const SIDE = 172;
const TIMES = 5;
const MARGIN = 10;

/** The surroundings of the cursor, enlarged, in the corner that is farthest from it. */
export function drawLoupe(
  g: CanvasRenderingContext2D,
  image: HTMLImageElement,
  size: readonly [number, number],
  cursor: readonly [number, number],
  onScreen: readonly [number, number],
  canvas: readonly [number, number],
  points: Readonly<Record<string, Point>>,
): void {
  const left = onScreen[0] < canvas[0] / 2 ? canvas[0] - SIDE - MARGIN : MARGIN;
  const top = MARGIN;
  const half = SIDE / 2 / TIMES;
  const ratio = image.naturalWidth / size[0];
  g.save();
  g.beginPath();
  g.roundRect(left, top, SIDE, SIDE, 8);
  g.fillStyle = "#000000";
  g.fill();
  g.clip();
  g.imageSmoothingEnabled = false;
  g.drawImage(
    image,
    (cursor[0] + 0.5 - half) * ratio,
    (cursor[1] + 0.5 - half) * ratio,
    2 * half * ratio,
    2 * half * ratio,
    left,
    top,
    SIDE,
    SIDE,
  );
  for (const p of Object.values(points)) {
    g.beginPath();
    g.arc(left + SIDE / 2 + (p.x - cursor[0]) * TIMES, top + SIDE / 2 + (p.y - cursor[1]) * TIMES, 5, 0, 2 * Math.PI);
    g.strokeStyle = "#ffffff";
    g.lineWidth = 2;
    g.stroke();
  }
  const [x, y] = [left + SIDE / 2, top + SIDE / 2];
  g.strokeStyle = "#ffffff";
  g.lineWidth = 1;
  g.beginPath();
  for (const d of [-1, 1]) {
    g.moveTo(x + 4 * d, y);
    g.lineTo(x + 26 * d, y);
    g.moveTo(x, y + 4 * d);
    g.lineTo(x, y + 26 * d);
  }
  g.stroke();
  g.restore();
  g.strokeStyle = "rgb(255 255 255 / 70%)";
  g.lineWidth = 1.5;
  g.beginPath();
  g.roundRect(left, top, SIDE, SIDE, 8);
  g.stroke();
}
