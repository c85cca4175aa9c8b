import "./live.css";
import { Socket } from "../api";
import { count } from "../counters";
import type { OpenScreen } from "../router";
import { h, setText } from "../ui/dom";
import { shell } from "../ui/shell";
import { toast } from "../ui/toast";
import { camerasLive } from "./cameras";
import { kinds, liveForm } from "./form";
import type { LiveMessage, Running, SensorStatus } from "./messages";
import { People } from "./people";
import { recorded } from "./recorded";

const TELL_MS = 250;

/** Skeletons of several depth sensors, fused as they come: who is seen, and how the sensors do. */
export const live: OpenScreen = (root, rest) => {
  if (rest[0] !== "sensors") return camerasLive(root);
  const box = shell(root, "live");
  const noPerson = h("p", { class: "live-no-person" });
  const space = h("div", { class: "live-space" }, noPerson);
  const sensors = h("tbody", {});
  const state = h("p", { class: "live-state", role: "status" }, "Connecting…");
  const said = { people: h("b", { class: "number" }, "–"), rate: h("b", { class: "number" }, "–"), latency: h("b", { class: "number" }, "–") };
  const form = liveForm((message) => socket.send(message) || toast("There is no connection to the server; is `hypose view` still running?", "error"));
  const kept = recorded();
  const side = h(
    "aside",
    { class: "pane live-side" },
    h("div", { class: "live-head" }, h("h1", {}, "Live fusion"), kinds("sensors"), state, form.element),
    h(
      "dl",
      { class: "live-figures" },
      ...([["persons", said.people], ["frames/s", said.rate], ["ms late", said.latency]] as const).map(([name, value]) =>
        h("div", {}, h("dd", {}, value), h("dt", {}, name)),
      ),
    ),
    h("table", {}, h("thead", {}, h("tr", {}, ...["Sensor", "Rate", "Misfit"].map((t) => h("th", {}, t)))), sensors),
    kept.element,
  );
  box.append(h("div", { class: "live" }, space, side));

  let people: People | undefined;
  let frames: number[] = [];
  let told = 0;
  const counters = count("live", { frames: 0, people: 0, standing: 0 });

  const showRunning = (running: false | Running): void => {
    form.show(running);
    state.textContent = running ? runningText(running) : "Not running. Choose who is seen and press Start; simulated sensors need nothing.";
    setText(noPerson, running ? "No person is seen yet" : "Press Start to see who the sensors see");
    noPerson.hidden = false;
    sensors.replaceChildren(h("tr", {}, h("td", { class: "dim", colspan: 3 }, "No sensor has sent anything yet.")));
    if (running) return;
    people?.show([]);
    people?.stand([]);
    for (const one of Object.values(said)) one.textContent = "–";
    kept.look();
  };
  const showFrame = (message: LiveMessage & { t: "frame" }): void => {
    const now = performance.now();
    frames = [...frames.filter((t) => now - t < 1000), now];
    counters["frames"] = message.n;
    counters["people"] = message.people.length;
    counters.pictures = people?.drawn ?? 0;
    people?.show(message.people);
    noPerson.hidden = message.people.length > 0;
    if (now - told < TELL_MS) return;
    told = now;
    said.people.textContent = String(message.people.length);
    said.rate.textContent = String(frames.length);
    said.latency.textContent = message.latency_ms.toFixed(1);
  };
  const heard = (message: LiveMessage): void => {
    if (message.t === "hello") {
      people ??= new People(message.joints, message.parents, space);
      showRunning(message.running);
    } else if (message.t === "frame") showFrame(message);
    else if (message.t === "status") {
      sensors.replaceChildren(...message.sensors.map(sensorRow));
      people?.stand(message.sensors);
      counters["standing"] = people?.standing.places.length ?? 0;
    } else if (message.t === "said") toast(message.text, "done");
    else {
      form.answered();
      toast(message.error, "error");
    }
  };
  const socket = new Socket("ws/fuse", (m) => heard(m as LiveMessage), undefined, (open) => {
    if (open) return;
    state.textContent = "The server does not answer; is `hypose view` still running?";
    people?.show([]); // they are not known any longer
    sensors.replaceChildren();
  });
  return {
    close: () => {
      socket.close();
      people?.close();
      kept.close();
    },
  };
};

function runningText({ udp, ws, simulated, osc, record }: Running): string {
  const from = simulated ? "Simulated sensors send; others are awaited" : "Skeletons are awaited";
  const more = [osc ? `What is fused goes to ${osc} by OSC.` : "", record ? `Everything is recorded in ${record}.` : ""];
  return [`${from} at UDP 127.0.0.1:${udp} and ws://127.0.0.1:${ws}/in.`, ...more].filter(Boolean).join(" ");
}

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
