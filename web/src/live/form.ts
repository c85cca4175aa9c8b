import { button, select } from "../ui/buttons";
import { h, memory } from "../ui/dom";
import type { Running } from "./messages";

const SOURCES = [
  { value: 0, label: "Sensors that send" },
  { value: 2, label: "2 simulated sensors" },
  { value: 3, label: "3 simulated sensors" },
  { value: 4, label: "4 simulated sensors" },
];

/** Where skeletons come from, where fused ones go, and whether all is recorded. send: to the server. */
export function liveForm(send: (message: Record<string, unknown>) => void): {
  element: HTMLElement;
  show: (running: false | Running) => void;
  answered: () => void;
} {
  let simulated = 0;
  const source = select("Who is seen", SOURCES, simulated, (n) => (simulated = n));
  const port = (name: string, value: number): HTMLInputElement => h("input", { type: "number", min: 0, max: 65535, value, "aria-label": `${name} port` });
  const [udp, ws] = [port("UDP", 9870), port("WebSocket", 9871)];
  const osc = h("input", {
    type: "text", maxlength: 100, placeholder: "127.0.0.1:9000", value: memory.get("live.osc") ?? "", "aria-label": "OSC target", spellcheck: "false",
    title: "HOST:PORT of a program that takes Open Sound Control; empty: none",
  });
  const record = h("input", { type: "checkbox" });
  const start = button("Start", () => {
    const toOsc = osc.value.trim();
    memory.set("live.osc", toOsc);
    start.disabled = true;
    send({ t: "start", udp: Number(udp.value), ws: Number(ws.value), simulated, osc: toOsc || null, record: record.checked });
  }, { kind: "primary", icon: "play" });
  const stop = button("Stop", () => send({ t: "stop" }), { icon: "pause" });
  const inputs = [source, udp, ws, osc, record];
  const row = (name: string, ...more: HTMLElement[]): HTMLElement => h("div", { class: "live-row" }, h("span", { class: "field-name" }, name), ...more);
  return {
    element: h(
      "div",
      { class: "live-form" },
      row("Seen by", source),
      h("details", { open: osc.value !== "" }, h("summary", { class: "dim" }, "Ports, and where poses are sent"), h("div", { class: "live-row" }, h("label", {}, "UDP", udp), h("label", {}, "WebSocket", ws)), row("OSC to", osc)),
      row("Record", h("label", {}, record, "all that the sensors send")),
      h("div", { class: "row" }, start, stop),
    ),
    show: (running) => {
      start.disabled = false;
      start.hidden = running !== false;
      stop.hidden = running === false;
      for (const input of inputs) input.disabled = running !== false;
      if (!running) return;
      [udp.valueAsNumber, ws.valueAsNumber] = [running.udp, running.ws];
      osc.value = running.osc ?? "";
      record.checked = running.record !== null;
    },
    answered: () => (start.disabled = false),
  };
}

/** The two kinds of live tracking, as links; active: the one that is shown. */
export function kinds(active: "sensors" | "cameras"): HTMLElement {
  const link = (kind: "sensors" | "cameras", label: string, to: string): HTMLElement => h("a", { class: "button", href: to, "aria-current": kind === active ? "page" : null }, label);
  return h("nav", { class: "row", "aria-label": "Kinds of sensors" }, link("cameras", "Cameras", "#/live"), link("sensors", "Depth sensors", "#/live/sensors"));
}
