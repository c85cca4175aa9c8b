/** What the router shows: a screen fills `root`, and takes everything back (listeners, sockets) when it is left. */
export interface Screen {
  close(): void;
}

/** rest: what follows the screen's name in the address, e.g. ["walk"] of #/view/walk. */
export type OpenScreen = (root: HTMLElement, rest: readonly string[]) => Screen;
