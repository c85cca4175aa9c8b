import type { Recording } from "../protocol";
import { button } from "../ui/buttons";
import { h } from "../ui/dom";
import { begin } from "./check";

/** The person's body, from the silhouettes; may be left out. */
export function personStep(recording: Recording): HTMLElement {
  const { subject } = recording;
  const height = h("input", { type: "number", min: 40, max: 280, step: 0.5, "aria-label": "Height in cm" });
  if (recording.subject_height) height.value = (100 * recording.subject_height).toFixed(1).replace(/\.0$/, "");
  const measure = button(subject ? "Measure again" : "Measure the person", () => {
    void begin(recording, "subject", height.value ? { height: Number(height.value) / 100 } : {});
  }, { icon: "body", ...(subject ? {} : { kind: "primary" as const }) });
  return h(
    "div",
    { class: "step" },
    h("h2", {}, "Person"),
    h("p", { class: "dim" }, "Fits a body to the silhouettes of some frames. It makes tracking more exact and gives the person's sizes. Without it the tracker estimates the proportions from the first frames."),
    h("div", { class: "row" }, h("label", {}, "Height", height, "cm, if known"), measure),
    subject ? sizes(subject) : h("p", { class: "dim" }, "Not measured yet; this step can be left out."),
  );
}

function sizes(subject: NonNullable<Recording["subject"]>): HTMLElement {
  return h(
    "table",
    { class: "numbers" },
    h("thead", {}, h("tr", {}, h("th", { scope: "col" }, "Size"), h("th", { scope: "col" }, "cm"))),
    h("tbody", {}, ...Object.entries(subject.sizes_cm).map(([name, cm]) => h("tr", {}, h("th", { scope: "row" }, name.replaceAll("_", " ")), h("td", { class: "number" }, cm.toFixed(1))))),
  );
}
