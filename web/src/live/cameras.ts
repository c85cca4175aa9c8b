import "./live.css";
import { address, get, Socket } from "../api";
import { count } from "../counters";
import type { Recording, State } from "../protocol";
import type { Screen } from "../router";
import { button, select } from "../ui/buttons";
import { h, memory, setText } from "../ui/dom";
import { shell } from "../ui/shell";
import { toast } from "../ui/toast";
import { kinds } from "./form";
import type { CamerasMessage, CamerasRunning, CameraStatus } from "./messages";
import { People } from "./people";

const TELL_MS = 250;
const PHASES: Record<string, string> = {
  "empty room": "The empty room is learnt",
  no_person: "No person is seen",
  looking: "A person is there; it is found out how they stand",
  following: "A person is followed",
  lost: "Lost; looked for",
};
const STAGES: Record<string, string> = { masks: "masks", track: "tracking", tell: "telling", judge: "judging" };

/** Calibrated cameras, followed as they show somebody: their pictures with masks, the person in 3D, and how it goes. */
export function camerasLive(root: HTMLElement): Screen {
  const box = shell(root, "live");
  const noPerson = h("p", { class: "live-no-person" });
  const strip = h("div", { class: "live-pictures", role: "group", "aria-label": "Pictures of the cameras", tabindex: 0 });
  const space = h("div", { class: "live-space" }, noPerson);
  const rows = h("tbody", {});
  const state = h("p", { class: "live-state", role: "status" }, "Connecting…");
  const started = h("p", { class: "live-started dim" });
  const words = h("ul", { class: "live-words", "aria-live": "polite" });
  const said = { rate: h("b", { class: "number" }, "–"), latency: h("b", { class: "number" }, "–"), skipped: h("b", { class: "number" }, "–") };
  const form = h("div", { class: "live-form" });
  const devices = h("datalist", { id: "live-devices" });
  const stages = h("p", { class: "dim live-stages" });
  const side = h(
    "aside",
    { class: "pane live-side" },
    h("div", { class: "live-head" }, h("h1", {}, "Live cameras"), kinds("cameras"), state, words, started, form),
    h(
      "dl",
      { class: "live-figures" },
      ...([["poses/s", said.rate], ["ms late", said.latency], ["% skipped", said.skipped]] as const).map(([name, value]) => h("div", {}, h("dd", {}, value), h("dt", {}, name))),
    ),
    stages,
    h("table", {}, h("thead", {}, h("tr", {}, ...["Camera", "Rate", "Lost"].map((t) => h("th", {}, t)))), rows),
  );
  box.append(h("div", { class: "live" }, h("div", { class: "live-seen" }, strip, space), side));
  const counters = count("cameras", { poses: 0, pictures: 0, phase: "" });
  let people: People | undefined;
  let told = 0;
  let running: false | CamerasRunning = false;
  let answered = (): void => undefined;
  const pictures = new Map<string, { image: HTMLImageElement; box: HTMLElement; name: HTMLElement }>();

  const send = (message: Record<string, unknown>): void => {
    if (!socket.send(message)) toast("There is no connection to the server; is `hypose view` still running?", "error");
  };

  const showForm = async (): Promise<void> => {
    if (running) {
      const room = button("Learn the empty room", () => send({ t: "room" }), { title: "Leave the cameras' view first: there are five seconds" });
      form.replaceChildren(h("div", { class: "row" }, button("Stop", () => send({ t: "stop" }), { icon: "pause" }), room));
      return;
    }
    const { recordings } = await get<State>("/api/state").catch(() => ({ recordings: [] as State["recordings"] }));
    const first = recordings[0];
    if (running) return;
    if (!first) {
      form.replaceChildren(h("p", { class: "dim" }, "Live tracking needs calibrated cameras: make a recording with them in Set up first."));
      return;
    }
    let chosen = recordings.find((r) => r.id === memory.get("cameras.recording"))?.id ?? first.id;
    const where = h("div", { class: "live-where" });
    const inputs = new Map<string, HTMLInputElement>();
    const record = h("input", { type: "checkbox" });
    const target = (kind: string, port: number): HTMLInputElement =>
      h("input", { type: "text", maxlength: 100, placeholder: `127.0.0.1:${port}`, "aria-label": `${kind} target`, spellcheck: "false", value: memory.get(`live.${kind.toLowerCase()}`) ?? "" });
    const most = h("input", { type: "number", min: 1, max: 8, step: 1, "aria-label": "People at most", value: memory.get("cameras.people") ?? "1" });
    const [osc, vmc] = [target("OSC", 9000), target("VMC", 39539)];
    const setup = h("a", { class: "button", title: "Calibrate these cameras, and see whether they agree" }, "Calibrate and check");
    const look = async (): Promise<void> => {
      memory.set("cameras.recording", chosen);
      setup.href = `#/setup/${chosen}`;
      const asked = chosen;
      inputs.clear();
      where.replaceChildren(); // nothing is written where other cameras will be
      const found = await get<Recording>(`/api/recordings/${asked}`).catch(() => null);
      if (asked !== chosen) return;
      for (const { name } of found?.views ?? []) {
        const input = h("input", { type: "text", list: devices.id, maxlength: 500, spellcheck: "false", "aria-label": `Where ${name} is`, value: memory.get(`cameras.at.${name}`) ?? "" });
        input.addEventListener("input", () => {
          memory.set(`cameras.at.${name}`, input.value.trim()); // the form may be made anew while somebody writes
          tellEmpty(inputs);
        });
        inputs.set(name, input);
      }
      tellEmpty(inputs);
      where.replaceChildren(
        ...[...inputs].map(([name, input], k) => {
          const camera = found!.cameras[k];
          const picture = camera?.pictures ? h("img", { alt: "", loading: "lazy", src: address(`/api/recordings/${asked}/image/${encodeURIComponent(camera.name)}/0.jpg`, { width: 160 }) }) : h("span", {});
          return h("div", { class: "live-row live-camera" }, picture, h("div", { class: "grow" }, h("b", {}, name), input));
        }),
      );
    };
    const start = button("Start", () => {
      const sources: Record<string, string> = {};
      for (const [name, input] of inputs) if (input.value.trim()) sources[name] = input.value.trim();
      memory.set("cameras.people", most.value);
      start.disabled = true;
      send({ t: "start", recording: chosen, sources, people: Number(most.value), record: record.checked, osc: osc.value.trim() || null, vmc: vmc.value.trim() || null });
    }, { kind: "primary", icon: "play" });
    answered = () => (start.disabled = false);
    form.replaceChildren(
      h("div", { class: "live-row" }, h("span", { class: "field-name" }, "Cameras"), select("Recording", recordings.map((r) => ({ value: r.id, label: r.name })), chosen, (id) => { chosen = id; void look(); })),
      h("p", { class: "dim" }, "The recording's videos are played again and again, or give where its cameras are now: the number of one of this computer (a field lists those that were found), or the address of a stream."),
      where,
      devices,
      h("div", { class: "live-row" }, h("span", { class: "field-name" }, "People"), most),
      h("details", { open: osc.value !== "" || vmc.value !== "" }, h("summary", { class: "dim" }, "Where poses are sent"), h("div", { class: "live-row" }, h("span", { class: "field-name" }, "OSC to"), osc), h("div", { class: "live-row" }, h("span", { class: "field-name" }, "Avatar at"), vmc)),
      h("div", { class: "live-row" }, h("span", { class: "field-name" }, "Record"), h("label", {}, record, "pictures, masks and poses")),
      h("div", { class: "row" }, start, setup),
    );
    await look();
  };

  const showRunning = (now: false | CamerasRunning): void => {
    running = now;
    void showForm();
    setText(state, now ? "The cameras are being looked at." : "Not running. Choose calibrated cameras and press Start.");
    setText(started, now ? startedText(now) : "");
    counters["phase"] = now ? "started" : "";
    forget();
    if (!now) setText(noPerson, "Press Start to see who the cameras see");
  };

  /** What was seen is seen no longer. */
  const forget = (): void => {
    setText(noPerson, "");
    words.replaceChildren();
    rows.replaceChildren();
    strip.replaceChildren();
    pictures.clear();
    people?.show([]);
    people?.stand([]);
    stages.textContent = "";
    for (const one of Object.values(said)) one.textContent = "–";
  };

  const showStatus = (message: CamerasMessage & { t: "status" }): void => {
    counters["phase"] = message.phase;
    const blind = message.cameras.length > 0 && message.cameras.every((c) => c.trouble);
    const phase = blind ? "No camera shows anything" : (PHASES[message.phase] ?? message.phase);
    setText(state, `${phase}${!blind && message.phase === "following" && !message.fitted ? "; the body is being measured" : ""}.`);
    // what is told each second is read out only when it is something else
    if (message.words.join("\n") !== [...words.children].map((li) => li.textContent).join("\n")) words.replaceChildren(...message.words.map((text) => h("li", {}, text)));
    rows.replaceChildren(...message.cameras.map(cameraRow));
    for (const { name, trouble } of message.cameras) {
      const shown = pictures.get(name);
      shown?.box.toggleAttribute("data-gone", trouble !== "");
      if (shown) setText(shown.name, trouble ? `${name}: no picture now` : name);
    }
    const places = running ? running.places : [];
    people?.stand(message.cameras.map((c, k) => ({ ...c, alive: !c.trouble, registered: true, residual: null, place: places[k] ?? null })));
    said.rate.textContent = message.per_second.toFixed(0);
    said.skipped.textContent = (100 * message.skipped).toFixed(0);
    const spent = Object.entries(message.stages_ms).filter(([, ms]) => ms !== null);
    setText(stages, spent.length ? `ms for each instant: ${spent.map(([name, ms]) => `${STAGES[name] ?? name} ${ms!.toFixed(0)}`).join(", ")}` : "");
    if (message.phase === "following" && !blind) return;
    setText(noPerson, phase);
    said.latency.textContent = "–";
    people?.show([]);
  };

  const heard = (message: CamerasMessage): void => {
    if (message.t === "hello") {
      people ??= new People(message.joints, message.parents, space);
      devices.replaceChildren(...message.devices.map(({ number, name }) => h("option", { value: number }, `${number}: ${name}`)));
      showRunning(message.running);
    } else if (message.t === "frame") {
      const [first] = message.people;
      counters["poses"] = first!.n;
      const seen = message.people.filter((p) => !p.lost).map((p) => ({ ...p, seen: true, sensors: p.cameras }));
      people?.show(seen);
      if (seen.length) setText(noPerson, "");
      if (performance.now() - told < TELL_MS) return;
      told = performance.now();
      said.latency.textContent = first!.latency_ms.toFixed(0);
    } else if (message.t === "status") showStatus(message);
    else if (message.t === "pictures") {
      for (const { name, jpeg } of message.cameras) {
        let shown = pictures.get(name);
        if (!shown) {
          const [image, caption] = [h("img", { alt: `What ${name} shows, with the mask` }), h("figcaption", {}, name)];
          shown = { image, name: caption, box: h("figure", {}, image, caption) };
          pictures.set(name, shown);
          strip.append(shown.box);
        }
        if (jpeg) shown.image.src = `data:image/jpeg;base64,${jpeg}`;
      }
      counters["pictures"] = (counters["pictures"] as number) + 1;
    } else if (message.t === "said") toast(message.text, "done");
    else {
      answered();
      toast(message.error, "error");
    }
  };
  const socket = new Socket("ws/cameras", (m) => heard(m as CamerasMessage), undefined, (open) => {
    if (open) return;
    setText(state, "The server does not answer; is `hypose view` still running?");
    forget();
  });
  return {
    close: () => {
      socket.close();
      people?.close();
    },
  };
}

/** What is done with cameras of which it is not said where they are. */
function tellEmpty(inputs: ReadonlyMap<string, HTMLInputElement>): void {
  const some = [...inputs.values()].some((input) => input.value.trim());
  for (const input of inputs.values()) input.placeholder = some ? "not used" : "its video, played";
}

function startedText({ played, ws, osc, vmc, record }: CamerasRunning): string {
  const more = [osc ? `OSC goes to ${osc}.` : "", vmc ? `The avatar at ${vmc} moves along.` : "", record ? `Everything is recorded in ${record}.` : ""];
  return [played ? "The recording's videos are played." : "The cameras are open.", `Poses: ws://127.0.0.1:${ws}/out.`, ...more].filter(Boolean).join(" ");
}

function cameraRow(c: CameraStatus): HTMLElement {
  return h(
    "tr",
    {},
    h("td", {}, h("span", { class: `chip ${c.trouble ? "bad" : "good"}` }, c.trouble ? "missing" : "there"), " ", c.name),
    h("td", { class: "number" }, `${c.rate.toFixed(0)} Hz`),
    h("td", { class: "number" }, String(c.lost)),
  );
}
