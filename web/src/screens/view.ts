import type { OpenScreen } from "../screen";

export const view: OpenScreen = (root) => {
  root.textContent = "view";
  return { close: () => undefined };
};
