// A Pose2Sim project's own photos, videos and key points become a result in View, by the page only, in at most 15
// clicks. FOLDER/expected.json: {"raw": folder that is dropped, "frames": of each camera}.
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { join } from "node:path";
import { staysCutOff, walk } from "./harness.mjs";

await walk(
  async ({ page, folder, picture }) => {
    page.setDefaultTimeout(600_000); // on a machine that is busy with other things
    const { raw, frames } = JSON.parse(readFileSync(join(folder, "expected.json"), "utf-8"));
    let clicks = 0;
    const click = async (what) => {
      await what.click();
      clicks++;
    };
    const button = (name) => page.getByRole("button", { name, exact: true });
    const done = (kind) => page.locator(`.job[data-job=${kind}][data-state=done]`).first().waitFor({ timeout: 1_500_000 });

    await page.getByRole("heading", { name: "Set up a recording" }).waitFor();
    clicks += 2; // the button and the system's dialog
    await page.getByLabel("A folder of files").setInputFiles(raw);
    await button("Make the recording").and(page.locator(":enabled")).waitFor();
    const roles = await page.evaluate(() => [...document.querySelectorAll("[data-file]")].map((row) => [...row.querySelectorAll("select")].map((s) => s.selectedOptions[0].textContent).join(" ")).filter((t) => !/not used/.test(t)).sort());
    assert.equal(roles.filter((r) => /^video of/.test(r)).length, 4, roles.join());
    assert.equal(roles.filter((r) => /^key points of/.test(r)).length, 4, roles.join());
    assert.equal(roles.filter((r) => /^calibration/.test(r)).length, 1, roles.join());
    await picture("balancing-dropped");
    await page.getByLabel("Name of the recording").fill("beam");
    await click(button("Make the recording"));
    await page.getByText(`4 cameras · ${frames} frames`).waitFor();

    // what is wrong is found, and mended with its button
    await page.locator("[data-step=check]").click();
    await click(button("Check the recording"));
    await done("check");
    await page.locator(".verdict").waitFor();
    await picture("balancing-checked");
    assert.deepEqual(await staysCutOff(page), []);
    await click(page.getByRole("button", { name: /Move the key points by 1 frame/ }));
    await page.getByText(/The key points are moved by 1 frame/).waitFor();
    await click(page.locator("[data-step=track]"));
    await page.getByLabel("Evidence").selectOption("both");
    clicks += 2;
    await click(button("Track"));
    await done("track");
    await click(page.locator(".job[data-job=track]").getByRole("link", { name: "Open in View" }));
    await page.waitForFunction(() => location.hash.startsWith("#/view/") && window.hypose?.pictureRow() === 0);
    await picture("balancing-result");
    console.log(JSON.stringify({ clicks }));
    assert.ok(clicks <= 15, `${clicks} clicks`);
  },
  { at: "#/setup", viewport: { width: 1440, height: 900 } },
);
