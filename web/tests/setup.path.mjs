// slow: from dropped videos to a motion that opens in View.
import assert from "node:assert/strict";
import { existsSync, readdirSync, readFileSync } from "node:fs";
import { join } from "node:path";
import { walk } from "./harness.mjs";

await walk(
  async ({ page, folder, picture }) => {
    const done = (kind) => page.locator(`.job[data-job=${kind}][data-state=done]`).first().waitFor();
    const all = (kind) => readdirSync(join(folder, "walk", kind)).map((name) => join(folder, "walk", kind, name));
    const files = page.getByLabel("Videos and calibration");

    // what is missing is said
    await page.getByRole("heading", { name: "Set up a recording" }).waitFor();
    await files.setInputFiles(all("videos"));
    await page.getByText("The calibration is missing").waitFor();
    assert.ok(await page.getByRole("button", { name: "Make the recording" }).isDisabled());
    await files.setInputFiles(join(folder, "walk", "recording.toml"));
    await page.getByText("no video, picture or calibration").or(page.locator(".dropped-file .bad")).first().waitFor();
    await page.getByRole("button", { name: "Remove recording.toml" }).click();
    await files.setInputFiles(join(folder, "walk", "calibration.toml"));
    await page.getByText("calibration of cam1").waitFor();
    // the empty room of every camera: files of the same names, whose use is chosen
    await files.setInputFiles(all("background"));
    await page.getByText("Two videos are of the camera cam1").waitFor();
    for (const k of [1, 2, 3, 4]) await page.locator(`[data-file='cam${k}.mp4'] [aria-label='What it is']`).nth(1).selectOption("background");
    await page.getByRole("button", { name: "Make the recording" }).and(page.locator(":enabled")).waitFor();
    await page.getByLabel("Name of the recording").fill("mine");
    await picture("setup-dropped");
    await page.getByRole("button", { name: "Make the recording" }).click();
    await page.getByRole("heading", { name: "mine" }).waitFor();

    // checked, with the findings in words
    await page.getByRole("button", { name: "Check the recording" }).click();
    await done("check");
    await page.locator(".verdict").waitFor();
    await picture("setup-checked");

    // masks follow the sliders, and are kept
    await page.getByRole("button", { name: "Next: Masks" }).click();
    await page.locator(".mask-pictures [data-state=coming]").first().waitFor(); // something turns while the first ones are made
    const loaded = () => page.waitForFunction(() => [...document.querySelectorAll(".mask-pictures img")].every((i) => i.complete && i.naturalWidth > 0));
    await loaded();
    const pictures = () => page.evaluate(() => window.__app.pictures);
    const before = await pictures();
    await page.getByRole("slider", { name: "Threshold" }).press("ArrowRight");
    await page.waitForFunction((n) => window.__app.pictures >= n + 4, before);
    assert.match(await page.locator(".mask-pictures img").first().getAttribute("src"), /threshold=4\.5/);
    await picture("setup-masks");
    await page.getByRole("button", { name: "Use these settings" }).click();
    await page.getByText("made with these settings").waitFor();

    // the person is measured
    await page.getByRole("button", { name: "Next: Person" }).click();
    await page.getByRole("button", { name: "Measure the person" }).click();
    await done("subject");
    await page.getByRole("rowheader", { name: "stature" }).waitFor();
    await picture("setup-person");

    // tracked while one watches, and opened
    await page.locator("[data-step=track]").click();
    await page.getByRole("button", { name: "Track", exact: true }).click();
    const card = page.locator(".job[data-job=track]").first();
    await card.waitFor();
    await card.locator(".live-figure").waitFor();
    await picture("setup-tracking");
    await done("track");
    await card.getByText(/^frame [1-8]$/).waitFor();
    await picture("setup-tracked");
    await card.getByRole("link", { name: "Open in View" }).click();
    await page.waitForFunction(() => location.hash.startsWith("#/view/"));
    await page.locator(".where").waitFor();

    // tracked again it is a result of its own
    const first = readFileSync(join(folder, "mine", "results", "default", "motion.npz"));
    await page.goBack();
    await page.locator("[data-step=track]").click();
    await page.getByRole("button", { name: "Track", exact: true }).click();
    await page.getByRole("heading", { name: "Track mine as default-2" }).waitFor();
    await page.waitForFunction(() => document.querySelectorAll(".job[data-job=track][data-state=done]").length === 2);
    assert.ok(existsSync(join(folder, "mine", "results", "default-2", "motion.npz")));
    assert.ok(first.equals(readFileSync(join(folder, "mine", "results", "default", "motion.npz"))));

    // a server that is gone is said, and nothing is said to run any more
    const sockets = [];
    let open = true;
    await page.routeWebSocket(/ws\/jobs/, (socket) => {
      if (open) socket.connectToServer();
      else void socket.close();
      sockets.push(socket);
    });
    await page.reload({ waitUntil: "commit" });
    await page.locator("[data-step=person]").click();
    await page.getByRole("button", { name: /^Measure/ }).click();
    await page.locator(".job[data-job=subject][data-state=running]").waitFor();
    open = false;
    for (const socket of sockets) await socket.close();
    await page.getByText("The server does not answer").waitFor();
    await page.getByText("not known", { exact: true }).waitFor();
    await picture("setup-gone");
    assert.equal(await page.locator(".chip", { hasText: /^runs$/ }).count(), 0);
    assert.equal(await page.locator(".steps small", { hasText: /^runs$/ }).count(), 0);
  },
  { at: "#/setup" },
);
