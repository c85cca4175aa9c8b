import { address, get, post } from "../api";
import type { Check, Finding, FolderEntry, Job, Recording } from "../protocol";
import { button, select } from "../ui/buttons";
import { h, plain } from "../ui/dom";
import { icon } from "../ui/icons";
import { toast } from "../ui/toast";
import { STRETCHED } from "./folder";

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

/** Is the calibration right, do the masks make sense? */
export function checkStep(recording: Recording): HTMLElement {
  const { check } = recording;
  const again = button(check ? "Check again" : "Check the recording", () => void begin(recording, "check"), {
    ...(check && !check.stale ? {} : { kind: "primary" as const }),
    icon: "doctor",
  });
  return h(
    "div",
    { class: "step" },
    h("h2", {}, "Check"),
    h("p", { class: "dim" }, "Looks at some frames of all cameras: do the masks show one person, do the views agree, is the calibration right? It takes a minute or less."),
    h("div", { class: "row" }, again),
    ...mended(recording),
    check ? found(recording, check) : h("p", { class: "dim" }, "Not checked yet."),
    emptyRooms(recording),
  );
}

function found(recording: Recording, check: Check): HTMLElement {
  const faults = check.findings.filter((f) => f.fault);
  const sure = faults.length === 0 && check.healthy;
  const refine = button("Refine the calibration", () => void begin(recording, "refine"), { icon: "fit", title: "Move the cameras so that they agree with what they see of the person" });
  let offered = false;
  const shown = [...check.findings].sort((a, b) => order(a) - order(b)).map((f) => {
    if (f.done) return sentence("good", withoutNext(f.sentence), f.views, [h("span", { class: "good" }, "Put right")]);
    const mends = f.fault ? cures(recording, f) : [];
    const refines = f.fault && REFINES.test(f.cure ?? "");
    if (refines && !offered) mends.unshift(refine); // one button, where it is said first
    offered ||= refines;
    return sentence(f.fault ? "bad" : "dim", refines || mends.some((b) => !LEAVES.test(b.textContent ?? "")) ? withoutNext(f.sentence) : plain(f.sentence).replace(/ Next: nothing\.$/, ""), f.views, mends);
  });
  const open = faults.filter((f) => !f.done).length;
  const words = sure ? "Nothing speaks against this calibration." : faults.length && !open ? "All of it is put right. Check again to see what is left." : `${open || "Some"} ${open === 1 ? "thing" : "things"} should be put right.`;
  return h(
    "div",
    { class: "found" },
    h("p", { class: `assessment ${sure || (faults.length && !open) ? "good" : "warn"}` }, icon(sure || (faults.length && !open) ? "done" : "warning"), words),
    ...shown,
    ...folded(check.warnings.map((w) => sentence("warn", plain(w), []))),
    open && !offered ? h("div", { class: "row" }, refine) : null,
    check.views.length ? residuals(check) : null,
    check.facts.length ? h("details", {}, h("summary", { class: "dim" }, `${check.facts.length} facts`), ...check.facts.map((f) => h("p", {}, plain(f)))) : null,
    check.page ? h("div", { class: "row" }, h("a", { class: "button", href: address(`/api/recordings/${recording.id}/file/${check.page}`), target: "_blank" }, "The whole page with pictures")) : null,
  );
}

/** Whether a button puts right any of what was found. */
export function canPutRight(recording: Recording): boolean {
  return open(recording).some((f) => REFINES.test(f.cure ?? "") || edits(recording, f).some((e) => !e.leaves));
}

/** Puts right all that can be, refines where that is said, and goes on the way to a motion. */
export async function putAllRight(recording: Recording): Promise<void> {
  const faults = open(recording).sort((a, b) => order(a) - order(b));
  try {
    for (const finding of faults) {
      const [edit] = edits(recording, finding).filter((e) => !e.leaves);
      if (edit) await post(`/api/recordings/${recording.id}/repair`, { ...edit.wish, findings: [number(recording, finding)] });
    }
    const refine = faults.some((f) => REFINES.test(f.cure ?? ""));
    await post<Job>("/api/jobs", { kind: refine ? "refine" : "go_on", recording: recording.id, options: {}, go_on: true, anyway: true });
    document.dispatchEvent(new CustomEvent("hypose-mended"));
  } catch (error) {
    toast((error as Error).message, "error");
  }
}

const REFINES = /--refine/;
/** Faults that are not put right yet. */
const open = (recording: Recording): Finding[] => (recording.check?.findings ?? []).filter((f) => f.fault && !f.done);
const number = (recording: Recording, finding: Finding): number => recording.check!.findings.indexOf(finding);

/** A finding without the line to be typed that ends it: its buttons do that. */
const withoutNext = (text: string): string => text.replace(/ Next: .*$/s, "");
const LEAVES = /^Leave .* out$/;

/** The first of many sentences, and the others behind a click: a bad frame says the same of every camera. */
function folded(sentences: HTMLElement[]): HTMLElement[] {
  if (sentences.length <= SHOWN + 1) return sentences;
  const rest = sentences.slice(SHOWN);
  return [...sentences.slice(0, SHOWN), h("details", { class: "more" }, h("summary", { class: "dim" }, `${rest.length} more like these`), ...rest)];
}

function sentence(kind: string, text: string, views: readonly string[], mend: readonly HTMLElement[] = []): HTMLElement {
  return h(
    "div",
    { class: "finding" },
    h("span", { class: kind }, icon(kind === "dim" ? "help" : kind === "good" ? "done" : "warning")),
    h("span", {}, text, mend.length ? h("span", { class: "row wrap cures" }, ...mend) : null),
    ...views.map((v) => h("span", { class: "chip" }, v)),
  );
}

/** What is the cause of others comes first: files, then units and the world, then cameras, then key points. */
const CAUSES = ["size", "keypoint_pixels", "frame_rate", "frame_count", "unit", "up", "flipped", "late", "distortion", "extrinsics", "scatter", "keypoint_set", "keypoint_lag", "sides"];
function order(finding: Finding): number {
  const at = CAUSES.indexOf(finding.kind);
  return (finding.fault ? 0 : 100) + (at < 0 ? CAUSES.length : at);
}

/** A change of recording.toml that puts a finding right; leaves: by doing without a camera. */
interface Edit { label: string; wish: Record<string, string | number>; said: string; leaves?: boolean }

function edits(recording: Recording, finding: Finding): Edit[] {
  const { kind, views, cure = "" } = finding;
  const out: Edit[] = [];
  const [, lag] = /set keypoint_lag = (-?\d+)/.exec(cure) ?? [];
  if (lag) {
    const frames = `${Math.abs(Number(lag))} ${Math.abs(Number(lag)) === 1 ? "frame" : "frames"}`;
    out.push({ label: `Move the key points by ${frames}`, wish: { what: "keypoint_lag", frames: Number(lag) }, said: `The key points are moved by ${frames}.` });
  }
  if (/set keypoint_pixels = "image"/.test(cure)) {
    out.push({ label: "They are pixels of the pictures as stored", wish: { what: "keypoint_pixels" }, said: "The key points are taken as pixels of the stored pictures." });
  }
  const seen = recording.views.find((v) => v.name === views[0] || v.camera === views[0]);
  if (!seen || views.length > 1) return out;
  const view = seen.name;
  if (kind === "size") {
    out.push({ label: "It was stretched: accept it", wish: { what: "accept_scaled", view }, said: `${view} is taken as stretched.` });
  }
  const [, x, y] = /set image_shift = \[(-?[\d.e-]+), (-?[\d.e-]+)\]/.exec(cure) ?? [];
  if (x && y && !seen.masks) {
    out.push({ label: "Move its pictures", wish: { what: "image_shift", view, x: Number(x), y: Number(y) }, said: `The pictures of ${view} are moved by ${x}, ${y} px.` });
  }
  if (recording.views.length > 2) out.push({ label: `Leave ${view} out`, wish: { what: "leave_out", view }, said: `${view} is left out.`, leaves: true });
  return out;
}

/** Buttons that put right what was found, in place of a line to be typed. */
function cures(recording: Recording, finding: Finding): HTMLElement[] {
  return edits(recording, finding).map(({ label, wish, said, leaves }) =>
    button(label, () => void mend(recording, wish, said, [number(recording, finding)]), leaves ? { icon: "close", title: "Track without this camera; it can be taken back" } : { icon: "done" }),
  );
}

/** Changes recording.toml; the page reads it again. findings: numbers of those that it puts right. */
export async function mend(recording: Recording, wish: Record<string, string | number>, said: string, findings: number[] = []): Promise<void> {
  try {
    await post(`/api/recordings/${recording.id}/repair`, { ...wish, findings });
    toast(said, "done");
    document.dispatchEvent(new CustomEvent("hypose-mended"));
  } catch (error) {
    toast((error as Error).message, "error");
  }
}

/** What may mend a recording that cannot be used as it is. */
export function rescue(recording: Recording): HTMLElement[] {
  const [, view] = STRETCHED.exec(recording.problem ?? "") ?? [];
  if (!view) return [];
  return [
    button("It was stretched: accept it", () => void mend(recording, { what: "accept_scaled", view }, `${view} is taken as stretched.`), { icon: "done" }),
    button(`Leave ${view} out`, () => void mend(recording, { what: "leave_out", view }, `${view} is left out.`), { icon: "close" }),
  ];
}

/** What has been mended already, and what is ready to be. */
function mended(recording: Recording): HTMLElement[] {
  const out: HTMLElement[] = [];
  if (recording.left_out.length) {
    out.push(sentence("dim", `Left out: ${recording.left_out.join(", ")}.`, [], [button("Take back", () => void mend(recording, { what: "take_back" }, "All cameras are used again."), { icon: "undo" })]));
  }
  if (recording.refined) {
    out.push(sentence("dim", "A refined calibration is there and is not used yet.", [], [button("Use the refined calibration", () => void mend(recording, { what: "use_refined" }, "The refined calibration is used from now on.", open(recording).filter((f) => REFINES.test(f.cure ?? "")).map((f) => number(recording, f))), { kind: "primary", icon: "done" })]));
  }
  return out;
}

/** An empty room of a camera, given or replaced by a file of the recording's folder. */
export function emptyRooms(recording: Recording): HTMLElement {
  const rows = h("div");
  const details = h("details", { class: "empty-rooms" }, h("summary", { class: "dim" }, "Empty rooms"), rows);
  details.addEventListener("toggle", () => {
    if (!details.open || rows.children.length) return;
    get<FolderEntry>(`/api/folder?recording=${recording.id}`).then(({ files }) => {
      const rooms = files.filter((f) => ["video", "image", "images"].includes(f.kind)).map((f) => ({ value: f.path, label: f.path }));
      rows.replaceChildren(...recording.views.map((v) => {
        const now = v.background ?? (v.masks ? "has masks" : "made from the recording itself");
        const chooser = select(`Empty room of ${v.name}`, [{ value: "", label: v.background ? "Replace it…" : "Give one…" }, ...rooms], "", (path) => {
          if (path) void mend(recording, { what: "background", view: v.name, path }, `${v.name} has another empty room.`);
        });
        return h("div", { class: "row" }, h("b", {}, v.name), h("span", { class: "dim grow" }, now), chooser);
      }));
    }, (error: Error) => toast(error.message, "error"));
  });
  return details;
}

const COLUMNS = [
  ["Camera", ""],
  ["Key points off", "How far this camera's key points lie from where all cameras together put them; the median"],
  ["… from the others", "How far they lie from where the other cameras put them; the median"],
  ["Outline off", "How far this camera's outline of the person disagrees with the others'; the median"],
] as const;

function residuals(check: Check): HTMLElement {
  const px = (value: number | null): string => (value === null ? "–" : `${value.toFixed(1)} px`);
  return h(
    "table",
    { class: "numbers" },
    h("thead", {}, h("tr", {}, ...COLUMNS.map(([text, title]) => h("th", { scope: "col", title }, text)))),
    h("tbody", {}, ...check.views.map((v) => h("tr", {}, h("th", { scope: "row" }, v.name), ...[v.residual_px, v.left_out_px, v.tangency_px].map((p) => h("td", { class: "number" }, px(p)))))),
  );
}
