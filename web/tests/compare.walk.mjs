// Two results beside each other, with what they differ by; the gait cycle; chosen channels; the plots as files.
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { join } from "node:path";
import { staysCutOff, walk } from "./harness.mjs";

await walk(
  async ({ page, folder, picture }) => {
    const expected = JSON.parse(readFileSync(join(folder, "expected.json"), "utf-8"));
    const { results } = await (await fetch(new URL("api/state", process.env.STUDIO))).json();
    const id = results.find((r) => r.name === "first").id;
    const titles = () => page.locator(".plot-title").allInnerTexts();
    const drawn = (n) => page.waitForFunction((count) => document.querySelectorAll(".plot-area canvas").length === count && [...document.querySelectorAll(".plot-area canvas")].every((c) => c.width > 40), n);
    const download = async (act) => {
      const coming = page.waitForEvent("download");
      await act();
      const file = await coming;
      return { name: file.suggestedFilename(), data: readFileSync(await file.path()) };
    };
    // what is asked of the page comes true when it is drawn, not when it is asked
    const until = async (what, message) => {
      for (let n = 0; n < 400; n++) {
        if (await what()) return;
        await page.waitForTimeout(100);
      }
      assert.fail(message);
    };
    const uncut = async () => assert.deepEqual(await staysCutOff(page), []);
    await page.evaluate((one) => (location.hash = `#/view/${one}`), id);
    await page.waitForFunction(() => window.hypose?.pictureRow() === 0);

    // events over the curves, and the angles over the cycle as the command line has them
    const over = page.getByLabel("Plotted over");
    await over.waitFor();
    await page.getByRole("tab", { name: "Legs" }).click();
    await drawn(3);
    await until(() => page.evaluate((n) => window.hypose.view.plots.plots[0]?.options.marks?.length === n, expected.events), "events over the curves");
    await picture("plots-events");
    await over.selectOption("cycle");
    await drawn(3);
    await page.getByText(`${expected.strides} strides`).first().waitFor();
    const curve = () => page.evaluate(() => window.hypose.view.plots.plots.flatMap((p) => p.series.map((s) => [p.options.title, s.label, [...s.values], [...(s.sd ?? [])]])).find(([title, side, values]) => title === "Knee flexion" && side === "left" && values.length === 101) ?? null);
    await until(async () => (await curve()) !== null, "the left knee over the gait cycle");
    const knee = await curve();
    knee[2].forEach((v, k) => assert.ok(Math.abs(v - expected.knee.mean[k]) < 0.01));
    knee[3].forEach((v, k) => assert.ok(Math.abs(v - expected.knee.sd[k]) < 0.01));
    await picture("plots-cycle");
    const files = page.getByRole("button", { name: "These plots as files" });
    const csv = await download(async () => {
      await files.click();
      await page.getByRole("menuitem", { name: "CSV" }).click();
    });
    const rows = csv.data.toString().trim().split("\n");
    assert.match(rows[0], /^percent,hip_flexion_left_deg,hip_flexion_left_sd_deg/);
    assert.equal(rows.length, 102);
    const png = await download(async () => {
      await files.click();
      await page.getByRole("menuitem", { name: "PNG" }).click();
    });
    assert.ok(png.data.subarray(1, 4).toString() === "PNG" && png.data.readUInt32BE(16) > 600, png.name);
    await over.selectOption("time");

    // chosen channels are kept
    await page.getByRole("button", { name: "Choose what is plotted" }).click();
    await page.getByRole("checkbox", { name: "Ankle angle" }).check();
    await page.getByRole("group", { name: "Height (z)" }).getByRole("checkbox", { name: "Head" }).check();
    await page.getByText("2 of at most 5").waitFor();
    await picture("plots-choose");
    await uncut();
    await page.getByRole("button", { name: "Show them" }).click();
    await drawn(2);
    await until(async () => (await titles()).join() === "Ankle angle (°),Head z (m)", "the chosen channels");
    await page.reload({ waitUntil: "commit" });
    await page.waitForFunction(() => window.hypose?.pictureRow() === 0);
    await page.getByRole("tab", { name: "Chosen" }).click();
    await drawn(2);

    // another result: names, body, both in the pictures, how far apart they are
    const colours = () => page.evaluate(() => {
      const tile = document.querySelector(".tile canvas");
      const { data } = tile.getContext("2d").getImageData(0, 0, tile.width, tile.height);
      let n = 0;
      for (let i = 0; i < data.length; i += 4) if (data[i] > 235 && data[i + 1] > 195 && data[i + 1] < 235 && data[i + 2] > 240) n++;
      return n;
    });
    const before = await colours();
    await page.getByLabel("Compare with another run").selectOption({ label: "second" });
    await page.getByRole("tab", { name: "Difference" }).waitFor();
    await page.waitForFunction((text) => document.querySelector(".plot-title")?.textContent.includes(text), `RMS ${expected.rms.toFixed(1)} mm`);
    await drawn(3);
    await page.locator(".legend").filter({ hasText: /first[^]*second/ }).waitFor();
    await until(async () => (await colours()) > before + 20, "the other result is not in the pictures");
    await until(() => page.evaluate(() => window.hypose.view.space.other?.body != null && window.hypose.view.space.otherBodyBox.visible), "the other body in 3D");
    await picture("compare-difference");
    await page.getByRole("tab", { name: "Legs" }).click();
    await drawn(3);
    await until(async () => /RMS \d/.test((await page.locator(".plot figcaption").allInnerTexts()).join()), "RMS at the curves");
    for (const [width, height] of [[1440, 900], [1024, 700], [390, 844]]) {
      await page.setViewportSize({ width, height });
      await uncut();
      await picture(`compare-${width}`);
    }
    await page.setViewportSize({ width: 1440, height: 900 });
    await page.getByRole("button", { name: "Dark or light" }).click();
    await picture("compare-light");
    const other = page.getByLabel("Compare with another run");
    await other.selectOption("");
    await page.getByRole("tab", { name: "Difference" }).waitFor({ state: "hidden" });

    // one that does not come is not said to be there, and who has left meanwhile hears nothing of it
    await page.route("**/view", (route) => route.abort());
    await other.selectOption({ label: "second" });
    await page.getByText("The server does not answer").waitFor();
    assert.equal(await other.inputValue(), "");
    await page.getByRole("button", { name: "Close", exact: true }).click();
    await page.unroute("**/view");
    let [asked, answer] = [() => undefined, () => undefined];
    const [coming, held] = [new Promise((done) => (asked = done)), new Promise((done) => (answer = done))];
    await page.route("**/view", async (route) => (asked(), await held, route.abort().catch(() => undefined))); // or it went with the screen
    await other.selectOption({ label: "second" });
    await coming;
    await page.evaluate(() => (location.hash = "#/view"));
    await page.getByRole("heading", { name: "Results" }).waitFor();
    answer();
    await page.unroute("**/view");
    await page.waitForTimeout(200);
    assert.equal(await page.locator(".toast.error").count(), 0);
    await page.evaluate((one) => (location.hash = `#/view/${one}`), id);
    await page.waitForFunction(() => window.hypose?.pictureRow() === 0);

    // everything of a result in one file
  },
  { at: "#/view", colorScheme: "dark", acceptDownloads: true, expected: /ERR_FAILED/, viewport: { width: 1440, height: 900 } },
);
