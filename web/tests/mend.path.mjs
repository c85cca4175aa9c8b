// What is found wrong is mended with a button, not with a line to be typed: a stretched video, a camera that is off, an
// empty room, a refined calibration.
import assert from "node:assert/strict";
import { cpSync, mkdirSync, readFileSync, writeFileSync } from "node:fs";
import { join } from "node:path";
import { staysCutOff, walk } from "./harness.mjs";

await walk(
  async ({ page, folder, picture }) => {
    const at = (...parts) => join(folder, "walk", ...parts);
    const toml = () => readFileSync(at("recording.toml"), "utf-8");
    const calibration = readFileSync(at("calibration.toml"), "utf-8");
    const stretched = calibration.replace("size = [160, 120]", "size = [160, 100]");
    assert.notEqual(stretched, calibration);
    const { recordings } = await (await fetch(new URL("api/state", process.env.STUDIO))).json();
    const open = async () => {
      await page.evaluate(() => (location.hash = "#/view"));
      await page.evaluate((id) => (location.hash = `#/setup/${id}`), recordings[0].id);
      await page.locator(".setup-title").waitFor();
    };

    // a recording that cannot be used because a video was stretched
    writeFileSync(at("calibration.toml"), stretched);
    await open();
    await page.getByRole("alert").getByText("camera cam1 is calibrated for 160 x 100").waitFor();
    await page.getByRole("button", { name: "Leave cam1 out" }).waitFor();
    await page.getByRole("button", { name: "It was stretched: accept it" }).click();
    await page.getByText("4 cameras · 8 frames").waitFor();
    assert.match(toml(), /accept_scaled = true/);

    // the same with a folder that is to become a recording
    mkdirSync(join(folder, "two"));
    for (const [from, name] of [["calibration.toml", "calibration.toml"], ["videos/cam1.mp4", "cam1.mp4"], ["videos/cam2.mp4", "cam2.mp4"]]) cpSync(at(from), join(folder, "two", name));
    await page.evaluate(() => (location.hash = "#/setup"));
    await page.getByRole("button", { name: "two", exact: true }).click();
    await page.getByText("No video of cam3, cam4: the recording is made without.").waitFor();
    await page.getByRole("button", { name: "Make the recording" }).click();
    await page.getByRole("button", { name: "It was stretched: accept it" }).click();
    await page.getByRole("heading", { name: "two" }).waitFor();
    writeFileSync(at("calibration.toml"), calibration);

    // findings of a check, the cause of others first
    const finding = (kind, views, text, cure = "") => ({ fault: true, kind, views, sentence: cure ? `${text} Next: ${cure}.` : text, cure });
    writeFileSync(at("results", "check.json"), JSON.stringify({
      healthy: false, facts: [], warnings: [], views: [], page: null,
      findings: [finding("keypoint_lag", ["cam1"], "cam1: its key points come late."), finding("extrinsics", ["cam2"], "cam2: it was moved since.", "run hypose check --refine and use the calibration that it writes")],
    }));
    cpSync(at("calibration.toml"), at("results", "calibration_refined.toml"));
    await open();
    await page.locator("[data-step=check]").click();
    await page.getByText("2 things should be put right.").waitFor();
    const found = await page.locator(".finding").allInnerTexts();
    assert.ok(found.findIndex((t) => /moved since/.test(t)) < found.findIndex((t) => /come late/.test(t)), "the cause comes first");
    assert.ok(!found.some((t) => /Next:|hypose check/.test(t)), "a line to be typed stands beside the button that does it");
    await page.locator(".finding", { hasText: "moved since" }).getByRole("button", { name: "Refine the calibration" }).waitFor();
    assert.equal(await page.getByRole("button", { name: "Refine the calibration" }).count(), 1);
    await picture("mend-findings");
    assert.deepEqual(await staysCutOff(page), []);
    await page.getByRole("button", { name: "Leave cam2 out" }).click();
    await page.getByText("Left out: cam2.").waitFor();
    await page.getByText("3 cameras · 8 frames").waitFor();
    await page.getByRole("button", { name: "Take back" }).click();
    await page.getByText("4 cameras · 8 frames").waitFor();
    await page.getByRole("button", { name: "Use the refined calibration" }).click();
    await page.getByRole("button", { name: "Use the refined calibration" }).waitFor({ state: "hidden" });
    assert.match(toml(), /^calibration = .results\/calibration_refined\.toml/);
    await page.getByText("Empty rooms", { exact: true }).click();
    await page.getByLabel("Empty room of cam3").selectOption("background/cam4.mp4");
    await page.getByText("cam3 has another empty room").waitFor();
    assert.match(toml(), /background = .background\/cam4\.mp4/);
    await picture("mend-done");

    // all frames can be tracked of a recording that says which are to be
    writeFileSync(at("recording.toml"), `frame_range = [2, 6]\n${toml()}`);
    await open();
    await page.locator("[data-step=track]").click();
    let asked;
    await page.route("**/api/jobs", (route) => {
      asked = route.request().postDataJSON();
      return route.fulfill({ status: 400, json: { error: "Not now." } });
    });
    const [first, last] = [page.getByLabel("First frame"), page.getByLabel("Frame after the last")];
    const track = async () => {
      asked = undefined;
      const answer = page.waitForResponse(/api\/jobs$/);
      await page.getByRole("button", { name: "Track", exact: true }).click();
      await answer;
      return asked.options.frames;
    };
    assert.deepEqual([await first.inputValue(), await last.inputValue(), await track()], ["2", "6", undefined]);
    await first.fill("0");
    await last.fill("8");
    assert.equal(await track(), "0:8");
  },
  { at: "#/setup", expected: /400/ },
);
