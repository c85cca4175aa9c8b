import { get, Socket } from "../api";
import { count } from "../counters";
import { readPicture, type GestureMessage, type GestureRequest, type State } from "../protocol";
import type { OpenScreen } from "../router";
import { h } from "../ui/dom";
import { shell } from "../ui/shell";
import { toast } from "../ui/toast";
import "./gesture.css";
import { emptyLive, take } from "./live";
import { startPage } from "./start";
import { Trainer } from "./trainer";

/** Teach gestures, and watch for them. The session belongs to the server: a page that comes back goes on with it. */
export const gesture: OpenScreen = (root) => {
  const box = shell(root, "gesture");
  const live = emptyLive();
  const counters = count("gesture", { live });
  const aborted = new AbortController();
  let trainer: Trainer | null = null;
  // the session that was under way when the connection broke: the server lets it wait, this page goes on with it
  let interrupted: string | null = null;

  const begin = (request: GestureRequest): void => {
    box.setAttribute("aria-busy", "true");
    if (!socket.send(request)) toast("There is no connection to the server; is `hypose view` still running?", "error");
  };
  const home = async (): Promise<void> => {
    trainer?.close();
    trainer = null;
    Object.assign(live, emptyLive(), { connected: live.connected });
    try {
      const state = await get<State>("/api/state", aborted.signal);
      if (!trainer) box.replaceChildren(startPage(state, begin));
    } catch (error) {
      if (!aborted.signal.aborted) box.replaceChildren(h("div", { class: "empty" }, h("h1", {}, "No connection"), (error as Error).message));
    }
  };
  const show = (): void => {
    box.removeAttribute("aria-busy");
    if (!live.session) return void home();
    if (live.ended !== null && trainer) return trainer.later();
    trainer?.close();
    trainer = new Trainer(live, socket, counters, (next) => {
      if (next) begin(next);
      else void home();
    });
    box.replaceChildren(trainer.element);
  };
  const onMessage = (message: GestureMessage): void => {
    if (message.t === "error") {
      box.removeAttribute("aria-busy");
      toast(message.error, "error");
    } else if (message.t === "said") toast(message.text);
    else if (message.t === "hello" && interrupted && message.session?.folder === interrupted) {
      interrupted = null;
      socket.send({ t: "command", command: "continue" });
      if (take(live, message)) show();
    }
    else if (take(live, message)) show();
    else if (message.t === "step") trainer?.takeStep(message);
    else trainer?.later();
  };
  const socket = new Socket(
    "/ws/gesture",
    (message) => onMessage(message as GestureMessage),
    (picture) => trainer?.takePicture(readPicture(picture)),
    (open) => {
      const goesOn = live.step !== null && !live.step.paused && live.ended === null;
      if (!open && live.connected) interrupted = goesOn ? (live.session?.folder ?? null) : null;
      live.connected = open;
    },
  );
  return {
    close() {
      aborted.abort();
      socket.close();
      trainer?.close();
    },
  };
};
