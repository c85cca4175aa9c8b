import type { OpenScreen } from "../screen";

export const click: OpenScreen = (root) => {
  root.textContent = "click";
  return { close: () => undefined };
};
