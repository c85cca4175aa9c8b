import type { OpenScreen } from "../screen";

export const setup: OpenScreen = (root) => {
  root.textContent = "setup";
  return { close: () => undefined };
};
