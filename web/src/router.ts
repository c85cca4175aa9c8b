/** What the router shows: a screen fills `root`, and takes everything back (listeners, sockets) when it is left. */
export interface Screen {
  close(): void;
}

/** rest: what follows the screen's name in the address, e.g. ["walk"] of #/view/walk. */
export type OpenScreen = (root: HTMLElement, rest: readonly string[]) => Screen;

/** Shows the screen that the address names (#/view/RESULT, #/gesture, ...), `fallback` when it names none. */
export function route(root: HTMLElement, screens: Readonly<Record<string, OpenScreen>>, fallback: string): void {
  let shown: Screen | undefined;
  const show = (): void => {
    const [name = "", ...rest] = location.hash.replace(/^#\/?/, "").split("/").map(decodeURIComponent);
    const open = screens[name] ?? screens[fallback];
    if (!open) return;
    shown?.close();
    root.replaceChildren();
    shown = open(root, name in screens ? rest : []);
  };
  addEventListener("hashchange", show);
  show();
}
