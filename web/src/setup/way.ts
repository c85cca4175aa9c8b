import { address, post } from "../api";
import type { Job, JobKind, Recording, ResultEntry } from "../protocol";
import { button } from "../ui/buttons";
import { h, plain } from "../ui/dom";
import { icon } from "../ui/icons";
import { toast } from "../ui/toast";
import { quality, thumbnail } from "../view/home";
import { begin, canPutRight, putAllRight } from "./check";
import { active } from "./feed";

const STAGES: readonly (readonly [JobKind, string])[] = [
  ["calibrate", "find the cameras"], ["keypoints", "find the person"], ["sync", "how late each camera is"], ["in_step", "synchronise"], ["refine", "refine the calibration"], ["check", "check"], ["track", "track"],
];

/** From the videos to the motion by one button; then the result, or what is to be done first. jobs: of the recording, the newest first. */
export function wayCard(recording: Recording, results: readonly ResultEntry[], jobs: readonly Job[], uncalibrated: boolean): HTMLElement {
  const running = jobs.find((j) => j.go_on && active(j));
  return h(
    "section",
    { class: "card way", "aria-label": "From the videos to the motion" },
    ...(running ? underWay(running, jobs) : [...shown(results), ...(uncalibrated ? cameras(recording, jobs) : onward(recording, results))]),
  );
}

/** The newest result, and the files that OpenSim takes. */
function shown([result]: readonly ResultEntry[]): HTMLElement[] {
  if (!result) return [];
  return [
    h(
      "div",
      { class: "way-result" },
      thumbnail(result),
      h("div", { class: "grow" }, h("h2", {}, result.name), quality(result), result.sentence ? h("p", {}, plain(result.sentence)) : null),
      h(
        "div",
        { class: "row wrap" },
        h("a", { class: "button primary", href: `#/view/${result.id}` }, "Open in View"),
        h("a", { class: "button", href: address(`/api/results/${result.id}/opensim.zip`), download: `${result.name}-opensim.zip`, title: "Model, motion, markers and the set-up of inverse kinematics" }, icon("download"), "OpenSim files"),
      ),
    ),
  ];
}

function underWay(running: Job, jobs: readonly Job[]): HTMLElement[] {
  const done = new Set(jobs.filter((j) => j.go_on && j.state === "done").map((j) => j.kind));
  const shown = (kind: JobKind): boolean => done.has(kind) || kind === running.kind;
  const late = done.has("sync") || running.kind === "sync" ? "in_step" : "sync"; // one of the two is on the way, or both
  const begun = STAGES.findIndex(([kind]) => shown(kind));
  const steps = STAGES.filter(([kind], k) => shown(kind) || (k >= begun && kind !== late && kind !== "refine"));
  const now = steps.findIndex(([kind]) => kind === running.kind);
  return [
    h("h2", {}, "On the way to the motion"),
    h("ol", { class: "way-steps" }, ...steps.map(([kind, title], k) => h("li", { "aria-current": kind === running.kind ? "step" : null, class: k < now ? "good" : k === now ? "accent" : "dim" }, k < now ? icon("done") : null, title))),
    h("p", { class: "dim" }, "It goes on by itself, also when this page is closed."),
  ];
}

function onward(recording: Recording, results: readonly ResultEntry[]): HTMLElement[] {
  const { check, next } = recording;
  const faults = (check?.findings ?? []).filter((f) => f.fault && !f.done).length;
  const kind = results.length ? {} : { kind: "primary" as const };
  if (recording.in_step) return [h("div", { class: "row wrap" }, h("span", {}, "There is this recording with all cameras synchronised:"), h("a", { class: "button primary", href: `#/setup/${recording.in_step}` }, "Go on with it"))];
  if (recording.views.length < 2) return [h("div", { class: "row wrap" }, h("a", { class: "button primary", href: `#/click/${recording.id}/${recording.frame_range?.[0] ?? 0}` }, "One camera only: click to start"))];
  const found = faults ? [h("p", { class: "assessment warn" }, icon("warning"), `The check found ${faults} ${faults === 1 ? "thing" : "things"}; the step Check says what.`)] : [];
  if (!next && faults) {
    const right = canPutRight(recording);
    return [
      ...found,
      h(
        "div",
        { class: "row wrap" },
        right ? button("Put all right and go on", () => void putAllRight(recording), { kind: "primary", icon: "done" }) : null,
        button("Track all the same", () => void begin(recording, "track", evidence(recording)), right ? { icon: "play" } : { ...kind, icon: "play" }),
      ),
    ];
  }
  if (!next) return [];
  const from = STAGES.findIndex(([k]) => k === next);
  const rest = STAGES.slice(from).filter(([k]) => k === next || (k !== "in_step" && k !== "refine")).map(([, title]) => title);
  return [
    ...found,
    h("div", { class: "row wrap" }, button(results.length ? "Track again" : "Track the person", () => void goOn(recording), { ...kind, icon: "play" }), h("span", { class: "dim" }, results.length ? "with all that is known now" : `does the rest by itself: ${rest.join(", ")}`)),
  ];
}

/** What a recording without a calibration needs. */
function cameras(recording: Recording, jobs: readonly Job[]): HTMLElement[] {
  const last = jobs.find((j) => j.kind === "calibrate");
  if (recording.board!.cameras.length) return [h("p", {}, "Say below how large a square of the board is; the rest follows.")];
  if (recording.views.length < 2) return [h("p", {}, "The camera is to be calibrated by clips of a board: see below.")];
  const height = h("input", { type: "number", min: 40, max: 280, step: 0.5, required: true, "aria-label": "Height of the person in cm" });
  if (recording.subject_height) height.value = (100 * recording.subject_height).toFixed(1).replace(/\.0$/, "");
  const go = async (): Promise<void> => {
    if (!height.reportValidity()) return;
    const metres = Number(height.value) / 100;
    if (metres !== recording.subject_height) await post(`/api/recordings/${recording.id}/repair`, { what: "height", metres });
    await goOn(recording);
  };
  return [
    h("h2", {}, "Track the person"),
    last?.state === "failed" ? h("p", { class: "bad", role: "alert" }, `The person did not tell where the cameras stand: ${plain(last.error ?? "")} A board does: below.`) : null,
    h("p", {}, "The cameras are found from the person who walks about before them; only the height is needed. Then the rest is done: the person found in the videos, the cameras synchronised, checked, tracked."),
    h("div", { class: "row wrap" }, h("label", { class: "row" }, "The person is", height, "cm tall"), button("Find the cameras and track", () => void go().catch((e: Error) => toast(e.message, "error")), { kind: "primary", icon: "play" })),
    h("p", { class: "dim" }, "The detector's models are fetched once (36 MB). Should the person stay in one place, use a board: below."),
  ].filter((e) => e !== null);
}

async function goOn(recording: Recording): Promise<void> {
  try {
    await post<Job>("/api/jobs", { kind: "go_on", recording: recording.id });
  } catch (error) {
    toast((error as Error).message, "error");
  }
}

/** What tracking looks at: both where there are key points. */
export const evidence = (recording: Recording): Record<string, unknown> => ({ evidence: recording.views.some((v) => v.keypoints) ? "both" : "silhouettes", ...(recording.subject ? { subject: true } : {}) });
