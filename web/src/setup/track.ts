import type { JobOption, Recording } from "../protocol";
import { button, select } from "../ui/buttons";
import { h } from "../ui/dom";
import { begin } from "./check";

/** Words for choices whose names need some; the others are shown by their names. */
const WORDS: Readonly<Record<string, string>> = {
  default: "default: particles and contours",
  hpf: "hierarchical particle filter (hpf)",
  apf: "annealed particle filter (apf)",
  sir: "plain particle filter (sir)",
  partitioned: "partitioned sampling",
  keypoints: "key points",
};
/** Choices that a recording of several cameras does not have. */
const ONE_CAMERA = ["monocular", "auto", "edges"];

/** How to track; and what was tracked before. options: of the job, as the command declares them. */
export function trackStep(recording: Recording, options: readonly JobOption[], named: (id: string) => string): HTMLElement {
  const keypoints = recording.views.some((v) => v.keypoints);
  const choices = (name: string): { value: string; label: string }[] => {
    const all = options.find((o) => o.name === name)?.choices ?? [];
    return all
      .filter((c) => (recording.views.length === 1 || !ONE_CAMERA.includes(c)) && (keypoints || !["keypoints", "both"].includes(c)))
      .map((c) => ({ value: c, label: WORDS[c] ?? c }));
  };
  const wish = { recipe: "default", evidence: keypoints ? "both" : "silhouettes", start: "auto", subject: recording.subject !== null };
  const [first, stop] = recording.frame_range ?? [0, recording.frames];
  const from = h("input", { type: "number", min: 0, max: recording.frames - 1, value: first, "aria-label": "First frame" });
  const to = h("input", { type: "number", min: 1, max: recording.frames, value: stop, "aria-label": "Frame after the last" });
  const field = (name: string, ...inputs: (HTMLElement | string)[]): HTMLElement =>
    h("div", { class: "field" }, h("span", { class: "field-name" }, name), h("div", { class: "row" }, ...inputs));
  const subject = h("input", { type: "checkbox", checked: wish.subject, disabled: recording.subject === null });
  subject.addEventListener("change", () => (wish.subject = subject.checked));
  const name = h("input", { type: "text", maxlength: 60, pattern: "[A-Za-z0-9_.\\-]+", placeholder: "by the method", "aria-label": "Name of the result" });
  const go = (): void => {
    if (!name.reportValidity()) return;
    const chosen: Record<string, unknown> = { recipe: wish.recipe, evidence: wish.evidence, start: wish.start };
    if (wish.subject) chosen["subject"] = true;
    if (name.value) chosen["name"] = name.value;
    if (Number(from.value) !== first || Number(to.value) !== stop) chosen["frames"] = `${from.value}:${to.value}`;
    void begin(recording, "track", chosen);
  };
  return h(
    "div",
    { class: "step" },
    h("h2", {}, "Track"),
    h(
      "div",
      { class: "fields" },
      field("Method", select("Method", choices("recipe"), wish.recipe, (v) => (wish.recipe = v))),
      field("Evidence", select("Evidence", choices("evidence"), wish.evidence, (v) => (wish.evidence = v))),
      field("Start", select("Start", ["auto", ...(keypoints ? ["keypoints"] : []), "hull", "a", "t", "standing", "hands-up"].map((v) => ({ value: v, label: v === "auto" ? "found by itself" : v === "hull" ? "from the visual hull" : v === "keypoints" ? "from key points" : `pose: ${v}` })), wish.start, (v) => (wish.start = v))),
      field("Frames", from, "to", to, h("span", { class: "dim" }, "(the one after the last)")),
      field("Result", name, h("span", { class: "dim" }, "a name of its own; what was tracked before stays as it is")),
      field("Body", h("label", {}, subject, recording.subject ? "the measured person" : "the measured person (not measured yet)")),
    ),
    h("div", { class: "row" }, button("Track", go, { kind: "primary", icon: "play" }), h("a", { class: "button", href: `#/click/${recording.id}/${first}` }, "One camera only: click to start")),
    h("h3", {}, "Results"),
    recording.results.length
      ? h("div", { class: "row wrap" }, ...recording.results.map((id) => h("a", { class: "button", href: `#/view/${id}` }, named(id))))
      : h("p", { class: "dim" }, "None yet."),
  );
}
