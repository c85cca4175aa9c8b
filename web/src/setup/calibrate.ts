import { address, get, post } from "../api";
import type { FolderEntry, Job, Recording } from "../protocol";
import { button, select } from "../ui/buttons";
import { h } from "../ui/dom";
import { icon } from "../ui/icons";
import { toast } from "../ui/toast";
import { assign, match } from "./assign";
import { begin } from "./check";

const SQUARES_MM = [20, 25, 30, 35, 40, 45, 50, 60, 70, 80, 100, 115, 150];
const DICTIONARIES = ["DICT_4X4_50", "DICT_4X4_1000", "DICT_5X5_100", "DICT_5X5_1000", "DICT_6X6_250", "DICT_6X6_1000", "DICT_7X7_1000", "DICT_APRILTAG_36H11"];

/** What has been said of the board; it outlives the step, which is drawn anew after every job. */
export interface BoardWish {
  kind: "chessboard" | "charuco";
  square: number | null;
  other: boolean;
  columns: number;
  rows: number;
  marker: number;
  dictionary: string;
  /** Frame in which the board lies on the floor; null: where it lies still. */
  floor: number | null;
}

export const usualBoard = (): BoardWish => ({ kind: "chessboard", square: null, other: false, columns: 5, rows: 7, marker: 45, dictionary: "DICT_4X4_1000", floor: null });

/** The cameras from their clips of a board. jobs: of the recording, the newest first. */
export function calibrateStep(recording: Recording, wish: BoardWish, jobs: readonly Job[]): HTMLElement {
  const board = recording.board!;
  const last = jobs.find((j) => j.kind === "calibrate");
  if (!board.cameras.length) return withoutBoard(recording, last);
  const go = button(board.calibrated ? "Calibrate again" : "Calibrate", () => void begin(recording, "calibrate", options(wish)), {
    icon: "fit", ...(board.calibrated ? {} : { kind: "primary" as const }),
  });
  const fields = h("div", { class: "fields" });
  const first = h("span", { class: "dim" }, "First say how large a square is: measure it on the print.");
  const redraw = (): void => {
    go.disabled = wish.square === null;
    first.hidden = wish.square !== null;
    fields.replaceChildren(...boardFields(wish, redraw));
  };
  redraw();
  return h(
    "div",
    { class: "step" },
    h("h2", {}, "Calibrate"),
    h("p", { class: "dim" }, `Finds the lenses and places of ${board.cameras.join(", ")} from their clips of the board. Where the board lies still at last is the floor.`),
    fields,
    h("div", { class: "row wrap" }, go, first),
    ...result(recording, last),
  );
}

/** The cameras from the person who walks about (the card above does that), or from a board that is filmed later. */
function withoutBoard(recording: Recording, last: Job | undefined): HTMLElement {
  const sheet = (paper: string): HTMLElement => h("a", { class: "button", href: address("/api/board.pdf", { paper }), target: "_blank" }, icon("download"), `A board to print, ${paper.toUpperCase()}`);
  return h(
    "div",
    { class: "step" },
    h("h2", {}, "Calibrate"),
    ...result(recording, last),
    h("h3", {}, "From the person"),
    h("p", { class: "dim" }, "The person walks about irregularly for 10 s or more before all cameras: turns both ways, raises an arm now and then, uses one to two metres of the floor. Places and lenses of the cameras are found, and how late each is."),
    h("h3", {}, "With a board"),
    h("p", { class: "dim" }, "More exact, and the person may do what they like. The recording stays as it is: as long as the cameras stand where they stood, the board may be filmed after the person. The second page says how."),
    h("div", { class: "row wrap" }, sheet("a4"), sheet("a3"), button("Look for clips of the board", () => void findBoards(recording), { icon: "follow", title: "Clips in the recording's folder, for example board/cam1.mp4" })),
  );
}

/** Takes the clips of a board that have been put into the recording's folder. */
async function findBoards(recording: Recording): Promise<void> {
  try {
    const { files, path } = await get<FolderEntry>(`/api/folder?recording=${recording.id}`);
    const cameras = recording.views.map((v) => v.name);
    const found = assign(files.map((f) => ({ path: f.path, kind: f.kind })), []);
    const boards = files.flatMap((f, k) => (found[k]!.role === "board" ? [f.path] : []));
    const named = match(boards, cameras);
    const missing = cameras.filter((c) => !named.includes(c));
    if (missing.length) return toast(`No clip of the board of ${missing.join(", ")}: put it into the folder ${path}, for example as board/${missing[0]}.mp4.`, "error");
    for (const [k, view] of named.entries()) if (view) await post(`/api/recordings/${recording.id}/repair`, { what: "board", view, path: boards[k] });
    toast("The clips of the board are found.", "done");
    document.dispatchEvent(new CustomEvent("hypose-mended"));
  } catch (error) {
    toast((error as Error).message, "error");
  }
}

function options(wish: BoardWish): Record<string, unknown> {
  const floor = wish.floor === null ? {} : { floor: wish.floor };
  if (wish.kind === "chessboard") return { square: `${wish.square}mm`, ...floor };
  return { ...floor, charuco: `${wish.columns}x${wish.rows}`, square: `${wish.square}mm`, marker: `${wish.marker}mm`, dictionary: wish.dictionary };
}

function boardFields(wish: BoardWish, redraw: () => void): HTMLElement[] {
  const field = (name: string, ...inputs: (HTMLElement | string)[]): HTMLElement =>
    h("div", { class: "field" }, h("span", { class: "field-name" }, name), h("div", { class: "row wrap" }, ...inputs));
  const count = (label: string, value: number, low: number, high: number, step: number, changed: (value: number) => void): HTMLElement => {
    const input = h("input", { type: "number", min: low, max: high, step, value, "aria-label": label });
    input.addEventListener("change", () => input.reportValidity() && changed(Number(input.value)));
    return input;
  };
  const kind = select("Board", [{ value: "chessboard", label: "chessboard (its corners are counted)" }, { value: "charuco", label: "ChArUco board" }], wish.kind, (v) => {
    wish.kind = v as BoardWish["kind"];
    redraw();
  });
  const side = select(
    "Side of a square",
    [...(wish.square === null && !wish.other ? [{ value: "", label: "choose" }] : []), ...SQUARES_MM.map((mm) => ({ value: String(mm), label: `${mm} mm` })), { value: "other", label: "another" }],
    wish.other ? "other" : String(wish.square ?? ""),
    (v) => {
      wish.other = v === "other";
      wish.square = wish.other ? (wish.square ?? 40) : Number(v);
      redraw();
    },
  );
  const own = wish.other ? [count("Side of a square in mm", wish.square ?? 40, 1, 5000, 0.1, (v) => (wish.square = v)), "mm"] : [];
  const ground = h("input", { type: "number", min: 0, step: 1, value: wish.floor ?? "", placeholder: "found", "aria-label": "Frame in which the board lies on the floor" });
  ground.addEventListener("change", () => (wish.floor = ground.value === "" ? null : Number(ground.value)));
  const floor = field("Floor", ground, h("span", { class: "dim" }, "frame in which the board lies on it, if it is not the one found"));
  if (wish.kind === "chessboard") return [field("Board", kind), field("Square", side, ...own), floor];
  return [
    field("Board", kind),
    field("Square", side, ...own),
    field("Squares", count("Columns of squares", wish.columns, 2, 100, 1, (v) => (wish.columns = v)), "×", count("Rows of squares", wish.rows, 2, 100, 1, (v) => (wish.rows = v))),
    field("Marker", count("Side of a marker in mm", wish.marker, 1, 5000, 0.1, (v) => (wish.marker = v)), "mm"),
    field("Markers", select("Dictionary of the markers", DICTIONARIES.map((d) => ({ value: d, label: d.replace("DICT_", "").replaceAll("_", " ") })), wish.dictionary, (v) => (wish.dictionary = v))),
    floor,
  ];
}

const RMS = /Joint fit of all boards: ([\d.]+) px rms/;

/** How well the cameras fit what they saw, and the sheet of it, also of a calibration that failed. */
function result(recording: Recording, job: Job | undefined): HTMLElement[] {
  const board = recording.board!;
  const out: HTMLElement[] = [];
  const lines = job?.lines ?? [];
  const rms = Number(lines.map((l) => RMS.exec(l)?.[1]).find((x) => x) ?? NaN);
  const warnings = lines.filter((l) => l.startsWith("warning: "));
  if (job?.state === "done" && board.calibrated) {
    const good = rms < 1 && !warnings.length;
    out.push(h("p", { class: `assessment ${good ? "good" : "warn"}` }, icon(good ? "done" : "warning"), Number.isFinite(rms) ? `The cameras are calibrated: the corners are ${rms.toFixed(2)} px off${rms < 1 ? ", which is good" : "; below 1 px would be good"}${warnings.length ? ", but look below" : ""}.` : "The cameras are calibrated."));
  } else if (board.calibrated) out.push(h("p", { class: "assessment good" }, icon("done"), "The cameras are calibrated."));
  for (const text of [...warnings, ...lines.filter((l) => l.startsWith("note: "))]) {
    const warn = text.startsWith("warning: ");
    out.push(h("div", { class: "finding" }, h("span", { class: warn ? "warn" : "dim" }, icon(warn ? "warning" : "help")), h("span", {}, text.replace(/^\w+: /, "").replace(/give --floor FRAME/, "say so above, at Floor"))));
  }
  if (board.sheet !== null) {
    const sheet = address(`/api/recordings/${recording.id}/file/calibration.png`, { made: Math.round(board.sheet) });
    out.push(
      h("h3", {}, "What was seen"),
      h("p", { class: "dim" }, "Per camera: a board that was found, whose first row (red) must be the same in all; all corners, green to red up to 2 px of error; a picture without a board, and why; below, all pictures that were looked at."),
      h("a", { class: "contact-sheet", href: sheet, target: "_blank", "aria-label": "The contact sheet by itself" }, h("img", { src: sheet, alt: "Contact sheet of the calibration" })),
    );
  }
  return out;
}
