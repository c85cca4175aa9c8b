import { address, get } from "../api";
import type { Job, Recording, ResultEntry, State } from "../protocol";
import type { OpenScreen } from "../router";
import { menu, select } from "../ui/buttons";
import { h } from "../ui/dom";
import { icon } from "../ui/icons";
import { shell } from "../ui/shell";
import { toast } from "../ui/toast";
import { Corrector } from "./correct";
import { correctionsMenu } from "./corrections";
import { doctorLink, size } from "./details";
import { home } from "./home";
import { ResultView } from "./result";
import { ServerSource } from "./source";
import type { ViewData } from "../lib/bundle";
import "./view.css";

/** #/view lists the results, #/view/RESULT shows one, #/view/RESULT/ROW at a frame, .../CLICKS with a correction of it. */
export const view: OpenScreen = (root, [id, row, clicks]) => {
  const abort = new AbortController();
  const box = shell(root, "view");
  let shown: ResultView | undefined;
  if (id) {
    void open(box, id, Number(row) || 0, clicks, abort.signal).then((made) => {
      if (abort.signal.aborted) made?.close();
      else shown = made;
    });
  } else void home(box, abort.signal);
  return {
    close() {
      abort.abort();
      shown?.close();
    },
  };
};

async function open(box: HTMLElement, id: string, row: number, clicks: string | undefined, signal: AbortSignal): Promise<ResultView | undefined> {
  const source = new ServerSource(id);
  const waiting = h("div", { class: "empty" }, h("p", {}, "Opening…"));
  box.replaceChildren(waiting);
  try {
    const [data, state] = await Promise.all([source.data(signal), get<State>("/api/state", signal)]);
    const entry = state.results.find((r) => r.id === id);
    const doctor = entry?.recording ? await checked(entry.recording, signal) : null;
    if (signal.aborted) return undefined;
    const tools = [exportMenu(source, data)];
    const report = data.header.files.find((f) => f.name === "report.html");
    if (report) {
      const href = source.file(report.name);
      tools.push(h("a", { class: "button quiet", href, target: "_blank", rel: "noopener", title: "The same as one file" }, icon("report"), "Report"));
    }
    const made: ResultView = new ResultView(data, source, {
      row,
      name: entry?.name ?? data.header.title,
      doctor,
      tools,
      back: h("a", { class: "button quiet only-icon", href: "#/view", "aria-label": "All results", title: "All results" }, icon("list")),
      ...(entry?.correctable ? { corrector: (shown: ResultView) => new Corrector(shown, data, entry) } : {}),
      rested: (at) => {
        // who is on the way to another screen stays on it: the address has changed already, and that is told later
        if (location.hash.startsWith(`#/view/${id}`)) history.replaceState(null, "", `#/view/${id}/${at}`);
      },
    });
    const corrections = entry ? correctionsMenu(data, entry, state) : null;
    if (corrections) tools[0]!.before(corrections);
    const others = entry ? comparable(entry, state) : [];
    if (others.length) tools[0]!.before(compare(made, data, others, signal));
    box.replaceChildren(made.element);
    if (clicks) made.corrector?.begin(row, clicks);
    document.title = `${data.header.title} · hypose`;
    return made;
  } catch (error) {
    if (signal.aborted) return undefined;
    box.replaceChildren(
      h(
        "div",
        { class: "empty" },
        h("h1", {}, "This result cannot be shown"),
        h("p", {}, (error as Error).message),
        h("p", {}, h("a", { class: "button", href: "#/view" }, "All results")),
      ),
    );
    return undefined;
  }
}

async function checked(recording: string, signal: AbortSignal): Promise<HTMLElement | null> {
  try {
    const { check } = await get<Recording>(`/api/recordings/${recording}`, signal);
    const page = check ? address(`/api/recordings/${recording}/file/${check.page}`) : null;
    return doctorLink(page, check ? check.healthy : null, recording);
  } catch {
    return null; // the result can be looked at without its recording
  }
}

/** Results that show the same recording. */
function comparable(entry: ResultEntry, state: State): ResultEntry[] {
  return state.results.filter((r) => r.id !== entry.id && r.recording === entry.recording && r.frames > 0);
}

function compare(made: ResultView, data: ViewData, others: readonly ResultEntry[], signal: AbortSignal): HTMLElement {
  const choices = [{ value: "", label: "Compare with…" }, ...others.map((r) => ({ value: r.id, label: r.name }))];
  let wanted = "";
  const chooser = select("Compare with another run", choices, "", (id) => {
    wanted = id;
    if (!id) return made.compare(null);
    new ServerSource(id).data(signal).then(
      (other) => {
        if (id !== wanted) return; // another one was chosen meanwhile
        const name = others.find((r) => r.id === id)?.name ?? "";
        made.compare({ data: other, shift: data.header.first_frame - other.header.first_frame, name });
      },
      (error: Error) => {
        if (signal.aborted || id !== wanted) return;
        chooser.value = wanted = "";
        made.compare(null);
        toast(error.message, "error");
      },
    );
  });
  return chooser;
}

/** What a format writes, where that is not motion.FORMAT. */
const FILES: Record<string, readonly string[]> = {
  csv: ["angles.csv", "joints.csv"],
  osim: ["motion.osim", "motion_markers.trc", "motion_ik.xml"],
};

/** Downloads what is there and writes what is not. */
function exportMenu(source: ServerSource, data: ViewData): HTMLElement {
  const there = new Map(data.header.files.map((f) => [f.name, f]));
  // joint positions alone have no angles
  const files = (format: string): string[] => (FILES[format] ?? [`motion.${format}`]).filter((name) => data.angles || name !== "angles.csv");
  const write = async (format: string): Promise<void> => {
    try {
      toast(`Writing ${format.toUpperCase()}…`);
      await finished(await source.export([format]));
      for (const name of files(format)) {
        there.set(name, { name, what: "", bytes: 0 });
        h("a", { href: source.file(name), download: name }).click();
      }
      toast(`${format.toUpperCase()} is written into the results folder.`, "done");
    } catch (error) {
      toast((error as Error).message, "error");
    }
  };
  return menu(
    "Export",
    () => [
      ...data.header.formats.flatMap((format) =>
        files(format).map((name) => {
          const file = there.get(name);
          if (!file) return { label: name, hint: "write it", act: () => void write(format) };
          return h(
            "a",
            { role: "menuitem", href: source.file(name), download: name },
            h("span", {}, name),
            h("small", {}, [file.bytes ? size(file.bytes) : "", file.what].filter(Boolean).join(" · ")),
          );
        }),
      ),
    ],
    { icon: "download", title: "Motion files" },
  );
}

async function finished(id: string): Promise<void> {
  for (;;) {
    const job = await get<Job>(`/api/jobs/${id}`);
    if (job.state === "done") return;
    if (job.state === "failed" || job.state === "cancelled") throw new Error(job.error ?? "The export was stopped.");
    await new Promise((done) => setTimeout(done, 300));
  }
}
