// slow, folder: empty. Two gestures are taught one after the other in one session, and then both are watched for, each with
// its picture.
import assert from "node:assert/strict";
import { barriers, staysCutOff, walk } from "./harness.mjs";

await walk(
  async ({ page, picture }) => {
    const PATIENCE = { timeout: 1_200_000 };
    page.setDefaultTimeout(PATIENCE.timeout);
    await page.getByLabel("Another gesture").selectOption("ok");
    await page.getByLabel("Another gesture").selectOption("cross");
    await page.getByRole("button", { name: "cross" }).click(); // taken away again
    await page.getByLabel("Rounds", { exact: true }).fill("1");
    await page.getByText("Timing").click();
    await page.getByText("as fast as the computer can").click();
    await page.getByText("36 s in all").waitFor();
    await picture("gesture-several");
    assert.deepEqual(await staysCutOff(page), []);
    await page.getByRole("button", { name: "Start", exact: true }).click();
    await page.getByText("tee, 1 of 2 · round 1 of 1").waitFor();
    await page.getByText("ok, 2 of 2 · round 1 of 1").waitFor();
    // nothing is clicked: the second comes by itself, and then both are tried
    await page.getByRole("heading", { name: "Watched for" }).waitFor();
    const rows = page.locator(".classes li");
    assert.equal(await rows.count(), 2);
    await page.waitForFunction(() => [...document.querySelectorAll(".classes img")].filter((i) => i.complete && i.naturalWidth > 0).length === 2);
    await page.waitForFunction(() => [...document.querySelectorAll(".classes .number")].every((e) => /cm²/.test(e.textContent)));
    await page.locator(".classes li[data-seen]").first().waitFor();
    await picture("gesture-watched");
    assert.deepEqual(await staysCutOff(page), []);
    assert.deepEqual(await barriers(page), []);
    await page.getByRole("button", { name: "Stop" }).click();
    await page.getByRole("button", { name: "Another gesture" }).click();
    await page.getByRole("button", { name: "Watch for all 2" }).waitFor();
    await page.waitForFunction(() => document.querySelectorAll(".model .gesture-picture img").length === 2);
    await picture("gesture-list");
    assert.deepEqual(await staysCutOff(page), []);
    assert.deepEqual(await barriers(page), []);
  },
  { at: "#/gesture", colorScheme: "dark" },
);
