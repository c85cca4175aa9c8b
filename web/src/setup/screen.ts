import { get, post } from "../api";
import { count } from "../counters";
import type { Job, JobForms, Recording, State } from "../protocol";
import type { OpenScreen } from "../router";
import { button } from "../ui/buttons";
import { h } from "../ui/dom";
import { icon } from "../ui/icons";
import { shell } from "../ui/shell";
import { toast } from "../ui/toast";
import { JobCard } from "./card";
import { JobFeed } from "./feed";
import { NewRecordingForm } from "./folder";
import { RecordingPage } from "./recording";
import "./setup.css";

/** #/setup: choose a folder of videos, or a recording; #/setup/RECORDING: check it, see its masks, measure, track. */
export const setup: OpenScreen = (root, rest) => {
  const box = shell(root, "setup");
  const counters = count("setup");
  const aborted = new AbortController();
  const { signal } = aborted;
  const offline = h("p", { class: "offline", role: "alert", hidden: true }, icon("warning"), "The server does not answer; is `hypose view` still running? What is shown may have changed since.");
  let page: RecordingPage | null = null;
  let home: Home | null = null;

  const feed: JobFeed = new JobFeed(
    () => {
      counters["jobs"] = feed.of(null);
      offline.hidden = feed.connected;
      page?.showJobs();
      home?.showJobs();
    },
    () => void (page?.reload(signal) ?? home?.reload(signal))?.catch(failed),
  );
  const failed = (error: Error): void => {
    if (!signal.aborted && !page && !home) {
      box.replaceChildren(h("div", { class: "empty" }, h("h1", {}, "That did not work"), h("p", {}, error.message), h("p", {}, h("a", { href: "#/setup" }, "To the recordings"))));
    } else if (!signal.aborted) toast(error.message, "error");
  };
  const begin = async (): Promise<void> => {
    const id = rest[0];
    const state = await get<State>("/api/state", signal);
    if (id) {
      const [recording, forms] = await Promise.all([get<Recording>(`/api/recordings/${id}`, signal), get<JobForms>("/api/job-forms", signal)]);
      page = new RecordingPage(recording, state, forms, feed, counters);
      box.replaceChildren(offline, page.element);
    } else {
      home = new Home(state, feed);
      box.replaceChildren(offline, home.element);
    }
  };
  begin().catch(failed);
  return {
    close() {
      aborted.abort();
      feed.close();
      page?.close();
    },
  };
};

/** Recordings that are there, the jobs of all, and the way to a new one. */
class Home {
  readonly element: HTMLElement;
  private readonly list = h("section", { class: "card", "aria-label": "Recordings" });
  private readonly jobs = h("section", { class: "setup-home-jobs" });
  private readonly cards = new Map<string, JobCard>();

  constructor(
    state: State,
    private readonly feed: JobFeed,
  ) {
    const form = new NewRecordingForm((recording) => (location.hash = `#/setup/${recording.id}`));
    this.element = h(
      "div",
      { class: "setup-home" },
      h("h1", {}, "Set up a recording"),
      h("div", { class: "setup-columns" }, h("div", {}, form.element), h("div", {}, this.list, this.jobs)),
    );
    this.show(state);
    this.showJobs();
  }

  async reload(signal: AbortSignal): Promise<void> {
    this.show(await get<State>("/api/state", signal));
  }

  showJobs(): void {
    const jobs = this.feed.of(null).slice(0, 6);
    for (const job of jobs) {
      const card = this.cards.get(job.id) ?? new JobCard(job);
      this.cards.set(job.id, card);
      card.show(job, this.feed.connected);
    }
    const elements = jobs.map((j) => this.cards.get(j.id)!.element);
    if (elements.length + 1 !== this.jobs.children.length || !elements.every((e) => e.isConnected)) {
      this.jobs.replaceChildren(...(elements.length ? [h("h2", {}, "Jobs"), ...elements] : []));
    }
  }

  private show(state: State): void {
    const rows = state.recordings.map((r) =>
      h(
        "div",
        { class: "recording-item" },
        h(
          "a",
          { class: "recording-row", href: `#/setup/${r.id}` },
          icon("camera"),
          h("span", { class: "grow" }, h("b", {}, r.name), r.path === r.name ? null : h("span", { class: "dim" }, r.path)),
          h("span", { class: "dim" }, r.results.length ? `${r.results.length} ${r.results.length === 1 ? "result" : "results"}` : "not tracked yet"),
        ),
      ),
    );
    this.list.replaceChildren(
      h("h2", {}, "Recordings"),
      ...(rows.length ? rows : [h("p", { class: "dim" }, `None in ${state.root} yet. Choose a folder with your videos at the left, or see first how it goes:`)]),
      h("div", { class: "row" }, button("Make a demo", () => void demo(), { icon: "play", title: "A made-up person before four made-up cameras, tracked; about a minute" })),
    );
  }
}

async function demo(): Promise<void> {
  try {
    const job = await post<Job>("/api/jobs", { kind: "demo", options: {} });
    toast(`${job.title} has begun.`);
  } catch (error) {
    toast((error as Error).message, "error");
  }
}
