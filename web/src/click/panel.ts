import type { ClickJoint } from "../protocol";
import { button, toggle } from "../ui/buttons";
import { h } from "../ui/dom";
import { side } from "../lib/bundle";
import type { ClickState } from "./clicks";
import type { Fitter } from "./fitter";

/** The joints in the order of clicking: which is next, which are placed here, which are hidden. */
export class JointList {
  readonly element: HTMLElement;
  private readonly rows = new Map<string, HTMLButtonElement>();
  private readonly occluded = toggle("Hidden", false, () => this.state.flipOccluded(), {
    title: "The joint is behind something and guessed", key: "o",
  });
  private readonly undo = button("", () => this.state.undo(), { icon: "undo", title: "Undo", key: "u" });
  private readonly redo = button("", () => this.state.redo(), { icon: "loop", title: "Redo", key: "r" });
  private readonly away = button("Remove", () => this.state.remove(), { title: "Take this joint away", key: "Delete" });
  private readonly next = h("p", { class: "click-next", "aria-live": "polite" });

  constructor(
    private readonly state: ClickState,
    joints: readonly ClickJoint[],
  ) {
    const list = h("ol", { class: "joint-list", "aria-label": "Joints in the order of clicking" });
    for (const { joint, title } of joints) {
      const row = h(
        "button",
        { type: "button", class: "joint", "data-joint": joint, onclick: () => state.choose(joint) },
        h("i", { style: `--side: var(--${side(joint)})` }),
        h("span", { class: "grow" }, title),
        h("small"),
      );
      this.rows.set(joint, row);
      list.append(h("li", {}, row));
    }
    this.element = h(
      "aside",
      { class: "click-joints" },
      this.next,
      list,
      h("div", { class: "row joint-tools" }, this.occluded.element, this.away, h("span", { class: "grow" }), this.undo, this.redo),
    );
  }

  show(): void {
    const { state } = this;
    for (const [joint, row] of this.rows) {
      const point = state.points[joint];
      row.dataset["placed"] = point ? (point.occluded ? "hidden" : "yes") : "no";
      row.lastElementChild!.textContent = point?.occluded ? "hidden" : "";
      const chosen = joint === state.joint;
      row.setAttribute("aria-current", String(chosen));
      if (chosen && row.getAttribute("aria-current") === "true") row.scrollIntoView({ block: "nearest" });
    }
    const placed = state.points[state.joint];
    const title = state.joints.find((j) => j.joint === state.joint)?.title ?? "";
    this.next.textContent = placed
      ? state.complete ? "All joints are placed. Drag to correct." : `${title}: drag it, or go on with another.`
      : `Click: ${title}`;
    this.occluded.set(placed?.occluded ?? false);
    this.occluded.element.disabled = this.away.disabled = !placed;
    this.undo.disabled = !state.canUndo;
    this.redo.disabled = !state.canRedo;
  }
}

/** What the fit says, in words and numbers; rivals to choose from. */
export class FitFacts {
  readonly element: HTMLElement;
  private readonly facts = h("dl", { class: "facts" });
  private readonly notes = h("div", { class: "fit-notes" });
  private readonly rivals = h("div", { class: "rivals", role: "radiogroup", "aria-label": "Poses that look the same" });
  private shown = "";

  constructor(private readonly fitter: Fitter) {
    this.element = h("section", { class: "fit-facts", "aria-live": "polite" }, this.facts, this.rivals, this.notes);
  }

  show(clicked: number, titles: Readonly<Record<string, string>>): void {
    const { fit, problem, choice, busy } = this.fitter.state;
    this.element.toggleAttribute("aria-busy", busy);
    const key = JSON.stringify([fit?.pose, problem, choice, clicked]);
    if (key === this.shown) return;
    this.shown = key;
    const sd = fit ? Math.max(...fit.joint_sd) : 0;
    const rows: [string, string][] = [
      ["Clicked", `${clicked} ${clicked === 1 ? "joint" : "joints"}`],
      ["Off the clicks", fit ? `${fit.rms_px.toFixed(1)} px` : "–"],
      ["Farthest", fit?.worst ? `${titles[fit.worst.joint] ?? fit.worst.joint}, ${fit.worst.px.toFixed(1)} px` : "–"],
      ["Joints are sure to", fit ? `${centimetres(median(fit.joint_sd))}, worst ${centimetres(sd)}` : "–"],
      ["Camera distance", fit ? (fit.depth_sd === null ? "from several views" : `± ${centimetres(fit.depth_sd)}`) : "–"],
    ];
    this.facts.replaceChildren(...rows.flatMap(([name, value]) => [h("dt", {}, name), h("dd", { class: "number" }, value)]));
    this.notes.replaceChildren(
      ...(problem ? [h("p", { class: "bad" }, problem)] : (fit?.notes ?? []).map((n) => h("p", { class: "dim" }, n))),
      ...(!fit && !problem ? [h("p", { class: "dim" }, "Click the joints in the picture; from four on the pose is shown here.")] : []),
    );
    const choices = fit?.alternatives.length ? [[], ...fit.alternatives.map((a) => a.flipped)] : [];
    this.rivals.replaceChildren(
      ...choices.map((flipped, k) =>
        h(
          "button",
          { type: "button", class: "chip", role: "radio", "aria-checked": String(k === choice), onclick: () => this.fitter.choose(k) },
          k === 0 ? "best" : flipped.length ? `other ${flipped.map((f) => (titles[f] ?? f).toLowerCase()).slice(0, 2).join(", ")}` : `rival ${k}`,
        ),
      ),
    );
  }
}

function median(values: readonly number[]): number {
  return [...values].sort((a, b) => a - b)[Math.floor(values.length / 2)] ?? 0;
}

function centimetres(metres: number): string {
  return `${(100 * metres).toFixed(metres < 0.1 ? 1 : 0)} cm`;
}
