import type { OpenScreen } from "../screen";

export const gesture: OpenScreen = (root) => {
  root.textContent = "gesture";
  return { close: () => undefined };
};
