import { get, post } from "../api";
import type { SkeletonsEntry, State } from "../protocol";
import { JobCard } from "../setup/card";
import { active, JobFeed } from "../setup/feed";
import { button } from "../ui/buttons";
import { h } from "../ui/dom";
import { toast } from "../ui/toast";

/** What was recorded, to be fused again with all of it known. */
export function recorded(): { element: HTMLElement; look: () => void; close: () => void } {
  const list = h("div", { class: "live-recorded" });
  const cards = h("div", { class: "live-jobs" });
  const element = h("section", { hidden: true }, h("h3", {}, "Recorded"), list, cards);
  const shown = new Map<string, JobCard>();
  const fuse = async (one: SkeletonsEntry): Promise<void> => {
    try {
      await post("/api/jobs", { kind: "fuse", skeletons: one.id });
    } catch (error) {
      toast((error as Error).message, "error");
    }
  };
  const look = async (): Promise<void> => {
    const { skeletons } = await get<State>("/api/state").catch(() => ({ skeletons: [] }));
    element.hidden = !skeletons.length;
    list.replaceChildren(
      ...skeletons.map((one) =>
        h(
          "div",
          { class: "row" },
          h("b", { class: "grow", title: one.path }, one.name),
          one.result ? h("a", { class: "button", href: `#/view/${one.result}` }, "Open in View") : button("Fuse it", () => void fuse(one), { icon: "play", title: "Once more, with all of it known: better than live, and kept as a result" }),
        ),
      ),
    );
  };
  const feed = new JobFeed(
    () => {
      for (const job of feed.of(null).filter((j) => j.kind === "fuse")) {
        const card = shown.get(job.id);
        if (card) card.show(job, feed.connected);
        else if (active(job)) {
          const made = new JobCard(job);
          shown.set(job.id, made);
          cards.prepend(made.element);
        }
      }
    },
    () => void look(),
  );
  return { element, look: () => void look(), close: () => feed.close() };
}
