import { get } from "../api";
import { count } from "../counters";
import type { ClickJoint, Recording, ResultEntry, State } from "../protocol";
import type { OpenScreen } from "../router";
import { h } from "../ui/dom";
import { icon } from "../ui/icons";
import { shell } from "../ui/shell";
import "./click.css";
import { Workspace } from "./workspace";

/** #/click: choose a recording; #/click/RECORDING/FRAME: click in it; #/click/RECORDING/FRAME/RESULT: correct that. */
export const click: OpenScreen = (root, rest) => {
  const box = shell(root, "click");
  const counters = count("click");
  const aborted = new AbortController();
  const { signal } = aborted;
  let workspace: Workspace | null = null;

  const open = async (recording: Recording, frame: number, result: ResultEntry | null, joints: ClickJoint[]): Promise<void> => {
    const at = Math.min(recording.frames - 1, Math.max(0, frame));
    workspace?.close();
    history.replaceState(null, "", `#/click/${recording.id}/${at}${result ? `/${result.id}` : ""}`);
    workspace = new Workspace(recording, result, at, joints, counters, (to) => void open(recording, to, result, joints));
    box.replaceChildren(workspace.element);
  };
  const begin = async (): Promise<void> => {
    const [id, frame, result] = rest;
    if (!id) {
      box.replaceChildren(chooser(await get<State>("/api/state", signal)));
      return;
    }
    const [recording, joints, results] = await Promise.all([
      get<Recording>(`/api/recordings/${id}`, signal),
      get<ClickJoint[]>("/api/click-joints", signal),
      result ? get<ResultEntry[]>("/api/results", signal) : [],
    ]);
    if (recording.problem) box.replaceChildren(nothing("This recording cannot be used", recording.problem, `#/setup/${id}`));
    else if (!recording.cameras.some((c) => c.pictures)) box.replaceChildren(nothing("No pictures", "This recording has masks only; there is nothing to click in.", "#/click"));
    else await open(recording, Number(frame) || 0, results.find((r) => r.id === result) ?? null, joints);
  };
  begin().catch((error: Error) => {
    if (!signal.aborted) box.replaceChildren(nothing("That did not work", error.message, "#/click"));
  });
  return {
    close() {
      aborted.abort();
      workspace?.close();
    },
  };
};

function nothing(title: string, text: string, next: string): HTMLElement {
  return h("div", { class: "empty" }, h("h1", {}, title), h("p", {}, text), h("p", {}, h("a", { href: next }, "Go on")));
}

function chooser(state: State): HTMLElement {
  if (!state.recordings.length) {
    return h(
      "div",
      { class: "empty" },
      h("h1", {}, "No recording to click in"),
      h("p", {}, `There is none in ${state.root}. Set one up first: choose the folder with the videos and their calibration.`),
      h("p", {}, h("a", { class: "button primary", href: "#/setup" }, "Set up a recording")),
    );
  }
  return h(
    "div",
    { class: "click-home" },
    h("h1", {}, "Click to start"),
    h("p", { class: "dim" }, "Show where the joints are in one picture or several, and see the pose that fits: the start of tracking with one camera, or the correction of a frame."),
    ...state.recordings.map((recording) =>
      h(
        "div",
        { class: "card click-recording" },
        h("a", { class: "row", href: `#/click/${recording.id}/0` }, icon("picture"), h("b", {}, recording.name), recording.path === recording.name ? null : h("span", { class: "dim" }, recording.path)),
        ...state.results
          .filter((r) => recording.results.includes(r.id))
          .map((r) => h("a", { class: "chip", href: `#/click/${recording.id}/0/${r.id}` }, "Correct ", r.name)),
      ),
    ),
  );
}
