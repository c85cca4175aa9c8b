import { h, setText, sharpCanvas } from "../ui/dom";
import { colour } from "../ui/theme";
import type { Live } from "./live";

/** What was learned, how good that is on what was not learned yet, and what was seen: the column beside the picture. */
export class Numbers {
  readonly learned = h("dl", { class: "facts" });
  readonly good = h("dl", { class: "facts" });
  readonly log = h("ol", { class: "events" });
  readonly curve: HTMLElement;
  private readonly canvas;
  private live: Live | null = null;
  private shownLog = "";

  constructor() {
    this.canvas = sharpCanvas("Precision over recall on frames that were not learned yet", (g, w, hgt) => this.draw(g, w, hgt));
    this.canvas.canvas.classList.add("curve");
    this.curve = this.canvas.canvas;
  }

  show(live: Live): void {
    const judgedBefore = this.live?.judged;
    this.live = { ...live };
    const counts = live.step?.counts;
    facts(this.learned, [
      ["Frames of the gesture", counts ? String(counts.gesture) : "–"],
      ["Frames of other movement", counts ? String(counts.negative) : "–"],
      ["Pixels learned", counts ? counts.pixels.toLocaleString("en") : "–"],
      ["Nodes of the forest", counts ? counts.nodes.toLocaleString("en") : "–"],
    ]);
    const j = live.judged;
    const at = atThreshold(live);
    facts(this.good, [
      ["Average precision", j && j.ap !== null ? j.ap.toFixed(2) : "–", j && j.ap !== null ? grade(j.ap) : ""],
      ["Precision, recall", at ? `${percent(at.precision)}, ${percent(at.recall)}` : "–"],
      ["False alarms per minute", j && j.false_per_min !== null ? j.false_per_min.toFixed(1) : "–"],
      ["Measured on", j && j.positives ? `${j.positives} + ${j.frames - j.positives} ${j.on === "test" ? "frames of the test" : "new frames"}` : "nothing yet"],
    ]);
    if (j !== judgedBefore) this.canvas.redraw();
    this.showLog(live);
  }

  recolour(): void {
    this.canvas.redraw();
  }

  close(): void {
    this.canvas.stop();
  }

  private showLog(live: Live): void {
    const key = live.log.length ? `${live.log.length} ${live.log[0]!.time} ${live.log[0]!.seconds}` : "none";
    if (key === this.shownLog) return;
    this.shownLog = key;
    if (!live.log.length) {
      this.log.replaceChildren(h("li", { class: "dim" }, "Nothing seen yet."));
      return;
    }
    this.log.replaceChildren(
      ...live.log.slice(0, 50).map((e) =>
        h(
          "li",
          {},
          h("span", { class: "number dim" }, `${e.time.toFixed(1)} s`),
          h("b", {}, e.gesture),
          h("span", { class: "number" }, `${e.score.toFixed(1)} cm²`),
          h("span", { class: "number dim" }, e.seconds === null ? "now" : `for ${e.seconds.toFixed(1)} s`),
        ),
      ),
    );
  }

  private draw(g: CanvasRenderingContext2D, width: number, height: number): void {
    g.clearRect(0, 0, width, height);
    const [left, bottom, top] = [34, height - 20, 8];
    const right = width - 8;
    const x = (recall: number): number => left + recall * (right - left);
    const y = (precision: number): number => bottom - precision * (bottom - top);
    g.strokeStyle = colour("line");
    g.strokeRect(left + 0.5, top + 0.5, right - left, bottom - top);
    g.font = "11px system-ui, sans-serif";
    g.fillStyle = colour("dim");
    g.textAlign = "center";
    g.fillText("recall", (left + right) / 2, height - 5);
    g.textAlign = "right";
    g.fillText("1", left - 5, top + 9);
    g.fillText("0", left - 5, bottom);
    g.save();
    g.translate(12, (top + bottom) / 2);
    g.rotate(-Math.PI / 2);
    g.textAlign = "center";
    g.fillText("precision", 0, 0);
    g.restore();
    const j = this.live?.judged;
    if (!j || !j.recall.length) return;
    g.strokeStyle = colour("accent");
    g.lineWidth = 2;
    g.beginPath();
    g.moveTo(x(0), y(j.precision[0] ?? 1));
    j.recall.forEach((r, k) => g.lineTo(x(r), y(j.precision[k]!)));
    g.stroke();
    const at = this.live && atThreshold(this.live);
    if (!at) return;
    g.fillStyle = colour("accent");
    g.beginPath();
    g.arc(x(at.recall), y(at.precision), 5, 0, 2 * Math.PI);
    g.fill();
  }
}

function facts(list: HTMLElement, rows: [string, string, string?][]): void {
  if (list.children.length !== 2 * rows.length) {
    list.replaceChildren(...rows.flatMap(([name]) => [h("dt", {}, name), h("dd", { class: "number" })]));
  }
  rows.forEach(([, value, kind], k) => {
    const cell = list.children[2 * k + 1] as HTMLElement;
    setText(cell, value);
    cell.className = `number ${kind ?? ""}`;
  });
}

/** Precision and recall at the threshold; null before either is known. */
function atThreshold({ judged, step }: Live): { precision: number; recall: number } | null {
  const threshold = step?.threshold ?? null;
  if (!judged?.scores.length || threshold === null) return null;
  const last = judged.scores.filter((s) => s >= threshold).length - 1;
  return last < 0 ? { precision: 1, recall: 0 } : { precision: judged.precision[last]!, recall: judged.recall[last]! };
}

const percent = (share: number): string => `${Math.round(100 * share)} %`;
const grade = (ap: number): string => (ap >= 0.75 ? "good" : ap >= 0.4 ? "warn" : "bad");
