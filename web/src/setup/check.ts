import { address, post } from "../api";
import type { Check, Job, Recording } from "../protocol";
import { button } from "../ui/buttons";
import { h } from "../ui/dom";
import { icon } from "../ui/icons";
import { toast } from "../ui/toast";

const SHOWN = 3;

/** Begins a job of a recording; the server's sentence when it cannot be. */
export async function begin(recording: Recording, kind: Job["kind"], options: Record<string, unknown> = {}): Promise<Job | null> {
  try {
    return await post<Job>("/api/jobs", { kind, recording: recording.id, options });
  } catch (error) {
    toast((error as Error).message, "error");
    return null;
  }
}

/** Step 1: is the calibration right, do the masks make sense? */
export function checkStep(recording: Recording): HTMLElement {
  const { check } = recording;
  const again = button(check ? "Check again" : "Check the recording", () => void begin(recording, "check"), {
    ...(check ? {} : { kind: "primary" as const }),
    icon: "doctor",
  });
  return h(
    "div",
    { class: "step" },
    h("h2", {}, "Check"),
    h("p", { class: "dim" }, "Looks at some frames of all cameras: do the masks show one person, do the views agree, is the calibration right? It takes a minute or less."),
    h("div", { class: "row" }, again),
    check ? found(recording, check) : h("p", { class: "dim" }, "Not checked yet."),
  );
}

function found(recording: Recording, check: Check): HTMLElement {
  const faults = check.findings.filter((f) => f.fault);
  const sure = faults.length === 0 && check.healthy;
  return h(
    "div",
    { class: "found" },
    h("p", { class: `verdict ${sure ? "good" : "warn"}` }, icon(sure ? "done" : "warning"), sure ? "Nothing speaks against this calibration." : `${faults.length || "Some"} ${faults.length === 1 ? "thing" : "things"} should be mended.`),
    ...check.findings.map((f) => sentence(f.fault ? "bad" : "dim", f.sentence, f.views)),
    ...folded(check.warnings.map((w) => sentence("warn", w, []))),
    faults.length ? h("div", { class: "row" }, button("Refine the calibration", () => void begin(recording, "refine"), { icon: "fit", title: "Move the cameras so that they agree with what they see of the person" })) : null,
    check.views.length ? residuals(check) : null,
    h("details", {}, h("summary", { class: "dim" }, `${check.facts.length} facts`), ...check.facts.map((f) => h("p", {}, f))),
    check.page ? h("a", { href: address(`/api/recordings/${recording.id}/file/${check.page}`), target: "_blank" }, "The whole page with pictures") : null,
  );
}

/** The first of many sentences, and the others behind a click: a bad frame says the same of every camera. */
function folded(sentences: HTMLElement[]): HTMLElement[] {
  if (sentences.length <= SHOWN + 1) return sentences;
  const rest = sentences.slice(SHOWN);
  return [...sentences.slice(0, SHOWN), h("details", { class: "more" }, h("summary", { class: "dim" }, `${rest.length} more like these`), ...rest)];
}

function sentence(kind: string, text: string, views: readonly string[]): HTMLElement {
  return h("p", { class: "finding" }, h("span", { class: kind }, icon(kind === "dim" ? "help" : "warning")), h("span", {}, text), ...views.map((v) => h("span", { class: "chip" }, v)));
}

function residuals(check: Check): HTMLElement {
  const px = (value: number | null): string => (value === null ? "–" : `${value.toFixed(1)} px`);
  return h(
    "table",
    { class: "numbers" },
    h("thead", {}, h("tr", {}, ...["Camera", "Residual", "Left out", "Tangency"].map((t) => h("th", { scope: "col" }, t)))),
    h("tbody", {}, ...check.views.map((v) => h("tr", {}, h("th", { scope: "row" }, v.name), ...[v.residual_px, v.left_out_px, v.tangency_px].map((p) => h("td", { class: "number" }, px(p)))))),
  );
}
