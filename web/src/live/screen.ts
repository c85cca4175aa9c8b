import "./live.css";
import { Socket } from "../api";
import { count } from "../counters";
import type { OpenScreen } from "../screen";
import { button } from "../ui/buttons";
import { h, setText } from "../ui/dom";
import { shell } from "../ui/shell";
import { toast } from "../ui/toast";
import type { LiveMessage, SensorStatus } from "./messages";
import { People } from "./people";

const TELL_MS = 250;

/** Skeletons of several depth sensors, fused as they come: who is seen, and how the sensors do. */
export const live: OpenScreen = (root) => {
  const box = shell(root, "live");
  const space = h("div", { class: "live-space", role: "img", "aria-label": "The fused skeletons in 3D" });
  const nobody = h("p", { class: "live-nobody" });
  space.append(nobody);
  const side = h("aside", { class: "pane live-side" });
  const sensors = h("tbody", {});
  const said = {
    state: h("p", { class: "live-state", role: "status" }, "Connecting…"),
    people: h("b", { class: "number" }, "–"),
    rate: h("b", { class: "number" }, "–"),
    latency: h("b", { class: "number" }, "–"),
  };
  const udp = h("input", { type: "number", min: 0, max: 65535, value: 9870, "aria-label": "UDP port" });
  const ws = h("input", { type: "number", min: 0, max: 65535, value: 9871, "aria-label": "WebSocket port" });
  const start = button("Start", () => socket.send({ t: "start", udp: Number(udp.value), ws: Number(ws.value), rate: 30 }), { kind: "primary", icon: "play" });
  const stop = button("Stop", () => socket.send({ t: "stop" }), { icon: "pause" });
  side.append(
    h("div", { class: "live-head" }, h("h2", {}, "Live fusion"), said.state, h("div", { class: "row" }, h("label", {}, "UDP", udp), h("label", {}, "WebSocket", ws)), h("div", { class: "row" }, start, stop)),
    h(
      "dl",
      { class: "live-figures" },
      ...([["persons", said.people], ["frames/s", said.rate], ["ms late", said.latency]] as const).map(([name, value]) =>
        h("div", {}, h("dd", {}, value), h("dt", {}, name)),
      ),
    ),
    h("table", {}, h("thead", {}, h("tr", {}, ...["Sensor", "Rate", "Misfit"].map((t) => h("th", {}, t)))), sensors),
  );
  box.append(h("div", { class: "live" }, space, side));

  let people: People | undefined;
  let frames: number[] = [];
  let told = 0;
  const counters = count("live", { frames: 0, people: 0 });

  const showRunning = (running: false | { udp: number; ws: number }): void => {
    start.hidden = udp.disabled = ws.disabled = running !== false;
    stop.hidden = running === false;
    if (running) [udp.valueAsNumber, ws.valueAsNumber] = [running.udp, running.ws];
    said.state.textContent = running
      ? `Skeletons are awaited at UDP 127.0.0.1:${running.udp} and ws://127.0.0.1:${running.ws}/in.`
      : "Not running. Start it, then let each sensor's program send its skeletons as lines of JSON (docs/live.md).";
    setText(nobody, running ? "Nobody is seen yet" : "Press Start to see who the sensors see");
    nobody.hidden = false;
    sensors.replaceChildren(h("tr", {}, h("td", { class: "dim", colspan: 3 }, "No sensor has sent anything yet.")));
    if (running) return;
    people?.show([]);
    for (const one of [said.people, said.rate, said.latency]) one.textContent = "–";
  };
  const heard = (message: LiveMessage): void => {
    if (message.t === "hello") {
      people ??= new People(message.joints, message.parents, space);
      showRunning(message.running);
    } else if (message.t === "frame") {
      const now = performance.now();
      frames = [...frames.filter((t) => now - t < 1000), now];
      counters["frames"] = message.n;
      counters["people"] = message.people.length;
      counters.pictures = people?.drawn ?? 0;
      people?.show(message.people);
      nobody.hidden = message.people.length > 0;
      if (now - told < TELL_MS) return;
      told = now;
      said.people.textContent = String(message.people.length);
      said.rate.textContent = String(frames.length);
      said.latency.textContent = message.latency_ms.toFixed(1);
    } else if (message.t === "status") sensors.replaceChildren(...message.sensors.map(sensorRow));
    else toast(message.error, "error");
  };
  const socket = new Socket("ws/fuse", (m) => heard(m as LiveMessage), undefined, (open) => {
    if (!open) said.state.textContent = "The server does not answer; is `hypose view` still running?";
  });
  return {
    close: () => {
      socket.close();
      people?.close();
    },
  };
};

function sensorRow(s: SensorStatus): HTMLElement {
  const chip = s.alive ? (s.registered ? ["good", "in place"] : ["warn", "not placed yet"]) : ["bad", "silent"];
  return h(
    "tr",
    {},
    h("td", {}, h("span", { class: `chip ${chip[0]}` }, chip[1]), " ", s.name),
    h("td", { class: "number" }, `${s.rate.toFixed(0)} Hz`),
    h("td", { class: "number" }, s.residual === null ? "–" : `${(1000 * s.residual).toFixed(0)} mm`),
  );
}
