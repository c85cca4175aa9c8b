import type { GestureSession } from "../protocol";
import { h, setText } from "../ui/dom";
import { gesturePicture } from "./start";
import type { Live } from "./live";

/** The gestures that are watched for, each with its picture and how near it is to being seen. */
export class Classes {
  readonly element = h("ul", { class: "classes" });
  private readonly rows: { name: string; row: HTMLElement; bar: HTMLMeterElement; score: HTMLElement }[];

  constructor(session: GestureSession) {
    const single = session.models.length === session.gestures.length;
    this.rows = session.gestures.map((name, k) => {
      const bar = h("meter", { min: 0, max: 1, "aria-label": `${name}: share of its threshold` });
      const score = h("span", { class: "number dim" });
      const row = h("li", {}, single ? gesturePicture(session.models[k]!) : null, h("b", { class: "grow" }, name.replaceAll("_", " ")), bar, score);
      return { name, row, bar, score };
    });
    this.element.append(...this.rows.map((r) => r.row));
  }

  show(live: Live): void {
    for (const { name, row, bar, score } of this.rows) {
      const found = live.step?.found?.find((f) => f.gesture === name);
      const share = found?.threshold ? found.score / found.threshold : 0;
      bar.value = Math.min(1, share);
      row.toggleAttribute("data-seen", share >= 1);
      setText(score, found ? `${found.score.toFixed(1)} cm²` : "–");
    }
  }
}
