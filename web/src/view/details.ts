import type { ViewData } from "../lib/bundle";
import { h, plain } from "../ui/dom";
import { icon } from "../ui/icons";
import { clock } from "../ui/timeline";
import type { Source } from "./source";

/** Everything about a result that is no picture: figures, notes, sizes, files, where it comes from. */
export function details(data: ViewData, source: Source, doctor: HTMLElement | null): HTMLElement {
  const { header } = data;
  const s = header.summary;
  const figure = (value: string, label: string, tone = ""): HTMLElement =>
    h("div", { class: "figure" }, h("b", { class: `number ${tone}` }, value), h("span", {}, label));
  const figures = [
    figure(String(s.frames), `frames, ${clock(s.seconds, 0.1)}`),
    figure(String(header.cameras.length), "cameras"),
    figure(String(s.lost), "frames lost", s.lost ? "bad" : ""),
    figure(String(s.extrapolated), "extrapolated", s.extrapolated ? "warn" : ""),
  ];
  if (s.iou !== null) figures.push(figure(s.iou.toFixed(3), `mean IoU, worst ${(s.worst_iou ?? 0).toFixed(2)}`));
  if (s.sd_mm !== null) figures.push(figure(`${s.sd_mm.toFixed(1)} mm`, "median joint sd"));
  if (header.truth?.mean_mm) figures.push(figure(`${header.truth.mean_mm.toFixed(1)} mm`, "mean joint error"));
  const track = header.seconds["track"];
  if (track) figures.push(figure((s.frames / track).toFixed(1), "frames/s tracked"));
  return h(
    "div",
    { class: "details" },
    h("div", { class: "figures" }, ...figures),
    header.complete ? null : h("p", { class: "warn" }, "The run was interrupted: this is what was tracked until then."),
    ...section("Notes", header.notes.length > 0, h("ul", {}, ...header.notes.map((n) => h("li", {}, plain(n))))),
    ...section("Truth", Boolean(header.truth), h("p", { class: "dim" }, header.truth?.note ?? "")),
    ...section("Calibration", Boolean(doctor), doctor ?? h("span")),
    ...section(
      "Subject",
      header.subject.length > 0,
      rows(header.subject.map(([name, metres]) => [name, `${(100 * metres).toFixed(1)} cm`])),
      h("p", { class: "dim" }, "Between joint centres; limbs: mean of both sides."),
    ),
    ...section("Files", header.files.length > 0, files(data, source)),
    ...section(
      "How this was made",
      true,
      header.citation ? h("p", {}, `Method: ${header.citation}`) : null,
      h("p", { class: "dim" }, `Tracked as “${header.recipe}” by hypose ${header.version}`),
      Object.keys(header.seconds).length
        ? h(
            "details",
            {},
            h("summary", {}, "Time per stage"),
            rows(Object.entries(header.seconds).map(([name, value]) => [name, `${value.toFixed(1)} s`])),
          )
        : null,
      h(
        "details",
        {},
        h("summary", {}, "Settings, versions, inputs with their hashes"),
        h("pre", {}, JSON.stringify(header.provenance, null, 2)),
      ),
    ),
  );
}

function section(title: string, wanted: boolean, ...content: (HTMLElement | null)[]): HTMLElement[] {
  if (!wanted) return [];
  return [h("section", {}, h("h3", {}, title), ...content)];
}

function rows(cells: readonly (readonly [string, string])[]): HTMLElement {
  return h(
    "table",
    { class: "plain" },
    ...cells.map(([name, value]) => h("tr", {}, h("td", {}, name), h("td", { class: "number" }, value))),
  );
}

function files(data: ViewData, source: Source): HTMLElement {
  return h(
    "ul",
    { class: "files" },
    ...data.header.files.map(({ name, what, bytes }) => {
      const at = source.file(name);
      const link = at ? h("a", { href: at, target: "_blank", rel: "noopener" }, name) : h("b", {}, name);
      return h("li", {}, link, h("span", { class: "dim" }, ` ${bytes ? `${size(bytes)} · ` : ""}${what}`));
    }),
  );
}

export function size(bytes: number): string {
  if (bytes < 1e5) return `${Math.max(1, Math.round(bytes / 1e3))} kB`;
  return `${(bytes / 1e6).toFixed(bytes < 1e7 ? 1 : 0)} MB`;
}

/** Where the doctor's page of a recording is, or what to do to get one. */
export function doctorLink(page: string | null, healthy: boolean | null, recording: string): HTMLElement {
  if (page) {
    const word = healthy === null ? "" : healthy ? "The calibration looks right. " : "The doctor found something. ";
    return h(
      "p",
      {},
      h("span", { class: healthy === false ? "bad" : "good" }, word),
      h("a", { href: page, target: "_blank", rel: "noopener" }, "The doctor's page"),
    );
  }
  return h(
    "p",
    { class: "row" },
    icon("doctor"),
    h("span", {}, "Not checked yet. "),
    h("a", { href: `#/setup/${recording}` }, "Check the calibration"),
  );
}
