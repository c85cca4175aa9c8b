// Opens all results of the folder whose path holds OPEN, one after the other: seconds until the result, its figures and
// pictures are on the screen. Prints JSON.
import { walk } from "./harness.mjs";

await walk(
  async ({ page, address }) => {
    const { results } = await (await fetch(new URL("api/state", address))).json();
    const order = results.filter((r) => r.path.includes(process.env.OPEN ?? "")).sort((a, b) => a.path.localeCompare(b.path));
    await page.getByRole("heading", { name: "Results" }).waitFor();
    const opened = [];
    for (const { id, path, frames, pictured } of order) {
      const began = performance.now();
      await page.evaluate((one) => (location.hash = `#/view/${one}`), id);
      await page.waitForFunction(
        ([n, seen]) => window.hypose?.view.player.rows === n && document.querySelector(".where")?.textContent && (!seen || window.hypose.pictureRow() === 0) && document.querySelectorAll(".plot-area canvas").length > 0,
        [frames, pictured],
        { polling: "raf" },
      );
      opened.push({ path, frames, seconds: (performance.now() - began) / 1000 });
      await page.evaluate(() => (location.hash = "#/view"));
      await page.getByRole("heading", { name: "Results" }).waitFor();
    }
    console.log(JSON.stringify({ results: opened }));
  },
  { at: "#/view", viewport: { width: 1440, height: 900 } },
);
