/** The viewer inside a report: one file, opened from disk, with everything in it. hypose/app/reports/report_viewer.py fills it. */
import { readBundle, type ViewData } from "./lib/bundle";
import { suitCanvases } from "./lib/software";
import { button } from "./ui/buttons";
import { startTheme, themeButton } from "./ui/theme";
import type { Gait } from "./view/cycles";
import { ResultView } from "./view/result";
import type { Outlines, RowPictures, Source } from "./view/source";
import "./style.css";
import "./ui/over.css";
import "./view/view.css";
import "./report.css";

interface StoredPictures {
  rows: number[];
  /** For each row one JPEG per camera as base64, "" where there is none. */
  files: string[][];
}

/** What the page itself carries; pictures of some frames only. */
class PageSource implements Source {
  readonly id = null;
  readonly gait?: () => Promise<Gait>;
  private readonly stored: StoredPictures;

  constructor() {
    const gait = text("hypose-gait"); // absent where nobody walks
    if (gait) this.gait = async () => JSON.parse(gait) as Gait;
    this.stored = JSON.parse(text("hypose-pictures") || '{"rows":[],"files":[]}') as StoredPictures;
  }

  async data(): Promise<ViewData> {
    const packed = new Blob([decode(text("hypose-result"))]).stream().pipeThrough(new DecompressionStream("gzip"));
    return readBundle(await new Response(packed).arrayBuffer());
  }

  async pictures(row: number): Promise<RowPictures | null> {
    const { rows, files } = this.stored;
    let best = 0;
    rows.forEach((r, i) => {
      if (Math.abs(r - row) < Math.abs(rows[best]! - row)) best = i;
    });
    const found = files[best];
    if (!found) return null;
    return {
      row: rows[best]!,
      files: found.map((file) => (file ? new Blob([decode(file)], { type: "image/jpeg" }) : null)),
    };
  }

  async outlines(): Promise<Outlines | null> {
    return null;
  }

  file(): null {
    return null;
  }

  async export(): Promise<string> {
    throw new Error("A report writes no files; use hypose export.");
  }
}

function text(id: string): string {
  return document.getElementById(id)?.textContent?.trim() ?? "";
}

function decode(base64: string): Uint8Array<ArrayBuffer> {
  return Uint8Array.from(atob(base64), (c) => c.charCodeAt(0));
}

async function open(box: HTMLElement): Promise<void> {
  suitCanvases();
  startTheme();
  const source = new PageSource();
  const data = await source.data();
  const full = button("Full screen", () => void box.requestFullscreen().catch(() => undefined), { icon: "expand", kind: "quiet" });
  const view = new ResultView(data, source, { tools: [full, themeButton()], keysIn: box });
  box.replaceChildren(view.element);
}

const box = document.getElementById("hypose-viewer");
if (box) {
  open(box).catch((error: Error) => {
    box.classList.add("failed");
    box.textContent = error.message;
  });
}
