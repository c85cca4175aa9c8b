// A result of ten minutes: opened, gone through and played; memory does not grow. Prints what was measured as JSON.
import assert from "node:assert/strict";
import { emptyScene, quantile as at, walk } from "./harness.mjs";

await walk(
  async ({ page, browser }) => {
    const { results } = await (await fetch(new URL("api/state", process.env.STUDIO))).json();
    const begin = Date.now();
    await page.evaluate((id) => (location.hash = `#/view/${id}`), results[0].id);
    await page.waitForFunction(() => window.hypose?.view.player.rows === 15000 && document.querySelector(".where")?.textContent);
    const open_ms = Date.now() - begin;
    await page.getByRole("heading", { name: "No cameras" }).waitFor();
    const line = await page.getByRole("slider", { name: "Time" }).boundingBox();
    const x = (share) => line.x + 2 + share * (line.width - 4);
    const y = line.y + line.height / 2;
    await page.evaluate(() => (window.hypose.latency.length = 0));
    for (let i = 1; i <= 40; i++) {
      await page.mouse.click(x((i * 0.317) % 1), y);
      await page.waitForFunction((n) => window.hypose.latency.length >= n, i);
      await page.waitForTimeout(60);
    }
    const clicks = await page.evaluate(() => [...window.hypose.latency]);
    await page.evaluate(() => (window.hypose.frames.length = window.hypose.latency.length = 0));
    await page.mouse.move(x(0), y);
    await page.mouse.down();
    const seen = () => page.evaluate(() => window.hypose.frames.length);
    for (let i = 1; i <= 240 || (await seen()) <= 20; i++) { // longer where a busy machine draws few frames
      await page.mouse.move(x((i * 0.0131) % 1), y);
      await page.waitForTimeout(12);
    }
    await page.mouse.move(x(0.999), y);
    await page.waitForFunction(() => window.hypose.row() >= 14900);
    await page.mouse.up();
    const scrub = await page.evaluate(() => ({ frames: [...window.hypose.frames], latency: [...window.hypose.latency] }));

    // ---- memory over playing
    const memory = async () => {
      const session = await page.context().newCDPSession(page);
      await session.send("HeapProfiler.collectGarbage");
      const { usedSize } = await session.send("Runtime.getHeapUsage");
      const { geometries, textures } = await page.evaluate(() => window.hypose.held());
      return { mb: usedSize / 1e6, geometries, textures };
    };
    await page.keyboard.press("Home");
    await page.getByLabel("Speed").selectOption({ label: "8×" });
    await page.keyboard.press("Space");
    await page.waitForTimeout(2000);
    const first = await memory();
    const row = await page.evaluate(() => window.hypose.row());
    await page.waitForTimeout(Number(process.env.PLAY_MS ?? 8000));
    const last = await memory();
    assert.ok((await page.evaluate(() => window.hypose.row())) > row, "it plays");
    assert.ok(last.mb - first.mb < 6, `memory grows: ${first.mb} MB, then ${last.mb} MB`);
    assert.deepEqual([last.geometries, last.textures], [first.geometries, first.textures]);
    await page.keyboard.press("Space");
    const drawn = await page.locator(".space-canvas").boundingBox();
    const empty = await emptyScene(browser, Math.round(drawn.width), Math.round(drawn.height));
    console.log(
      JSON.stringify({
        ...empty,
        open_ms,
        click_p50_ms: at(clicks, 0.5),
        click_p95_ms: at(clicks, 0.95),
        scrub_frame_p50_ms: at(scrub.frames, 0.5),
        scrub_frame_p95_ms: at(scrub.frames, 0.95),
        scrub_latency_p95_ms: at(scrub.latency, 0.95),
        heap_first_mb: first.mb,
        heap_last_mb: last.mb,
      }),
    );
  },
  { at: "#/view" },
);
