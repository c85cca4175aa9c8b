import { get, post } from "../api";
import type { Job, ResultEntry, State } from "../protocol";
import { button } from "../ui/buttons";
import { h } from "../ui/dom";
import { icon } from "../ui/icons";
import { toast } from "../ui/toast";
import { clock } from "../ui/timeline";

/** What there is to look at in the served folder. */
export async function home(box: HTMLElement, signal: AbortSignal): Promise<void> {
  const page = h("div", { class: "home" }, h("h1", {}, "Results"), h("p", { class: "dim" }, "Looking…"));
  box.append(page);
  let state: State;
  try {
    state = await get<State>("/api/state", signal);
  } catch (error) {
    if (!signal.aborted) page.append(h("p", { class: "bad" }, (error as Error).message));
    return;
  }
  const title = h("h1", {}, state.results.length ? "Results" : "Nothing to look at yet");
  if (!state.results.length) {
    page.replaceChildren(title, nothing(state));
    return;
  }
  const newest = [...state.results].sort((a, b) => b.changed - a.changed);
  page.replaceChildren(
    title,
    h("p", { class: "dim" }, `In ${state.root}, newest first`),
    h("div", { class: "results" }, ...newest.map((r) => entry(r, state))),
  );
}

function entry(result: ResultEntry, state: State): HTMLElement {
  const recording = state.recordings.find((r) => r.id === result.recording);
  const seconds = result.frame_rate ? result.frames / result.frame_rate : 0;
  return h(
    "a",
    { class: "card result", href: `#/view/${result.id}` },
    icon("skeleton"),
    h(
      "span",
      { class: "grow" },
      h("b", {}, recording?.name ?? result.name),
      h("span", { class: "dim" }, result.path),
    ),
    h("span", { class: "chip" }, result.recipe),
    result.complete ? null : h("span", { class: "chip warn" }, "not complete"),
    h("span", { class: "number dim" }, `${result.frames} frames · ${clock(seconds, 0.1)}`),
    h("span", { class: "dim" }, new Date(1000 * result.changed).toLocaleString()),
  );
}

function nothing(state: State): HTMLElement {
  const demo = button("Make a demo", () => void begin(), { kind: "primary", icon: "play" });
  async function begin(): Promise<void> {
    demo.disabled = true;
    try {
      const job = await post<Job>("/api/jobs", { kind: "demo", options: {} });
      toast(`${job.title} has begun; it takes about a minute.`);
      location.hash = "#/setup";
    } catch (error) {
      demo.disabled = false;
      toast((error as Error).message, "error");
    }
  }
  const recording = state.recordings[0];
  return h(
    "div",
    { class: "start" },
    h("p", { class: "dim" }, `There are no results in ${state.root}.`),
    recording
      ? h(
          "div",
          { class: "card" },
          h("h2", {}, `Track ${recording.name}`),
          h("p", { class: "dim" }, "The recording is there and has not been tracked yet."),
          h("a", { class: "button primary", href: `#/setup/${recording.id}` }, "Go on with it"),
        )
      : null,
    h(
      "div",
      { class: "card" },
      h("h2", {}, "Your own videos"),
      h("p", { class: "dim" }, "Drop the videos of all cameras and their calibration; the rest is shown step by step."),
      h("a", { class: `button ${recording ? "" : "primary"}`, href: "#/setup" }, "Set up a recording"),
    ),
    h(
      "div",
      { class: "card" },
      h("h2", {}, "A demo"),
      h("p", { class: "dim" }, "A made-up person walks in front of four made-up cameras and is tracked, in about a minute."),
      demo,
    ),
  );
}
