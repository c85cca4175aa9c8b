// A result is found in the list, looked at from all sides, played, questioned and taken home.
import assert from "node:assert/strict";
import { readFile } from "node:fs/promises";
import { other, resting, walk } from "./harness.mjs";

await walk(
  async ({ page, picture }) => {
    const where = page.locator(".where");
    const frame = async (number) => page.waitForFunction((n) => document.querySelector(".where")?.textContent.endsWith(`frame ${n}`), number);
    const pressed = (name) => page.getByRole("button", { name, exact: true }).getAttribute("aria-pressed");
    const still = () => page.locator(".space-canvas").screenshot();

    await page.getByRole("heading", { name: "Results" }).waitFor();
    await picture("view-list");
    await page.getByRole("link", { name: /walk/ }).click();
    await page.getByRole("heading", { name: /walk/ }).waitFor();
    assert.match(await page.locator(".view-head").innerText(), /8 frames · 25 fps/);
    await frame(0);
    await page.waitForFunction(() => window.hypose.pictureRow() === 0);
    assert.equal(await page.locator(".tile:visible").count(), 4);
    assert.deepEqual(await page.locator(".tile-name").allInnerTexts(), ["cam1", "cam2", "cam3", "cam4"]);

    // keys and the line of time move everything to the same frame
    await page.keyboard.press("ArrowRight");
    await frame(1);
    await page.keyboard.press("End");
    await frame(7);
    const line = await page.getByRole("slider", { name: "Time" }).boundingBox();
    await page.mouse.click(line.x + line.width * 0.56, line.y + line.height / 2);
    await frame(4);
    await page.waitForFunction(() => window.hypose.pictureRow() === 4);
    assert.equal(await page.getByRole("slider", { name: "Time" }).getAttribute("aria-valuetext"), "frame 5 of 8");
    await page.waitForFunction(() => location.hash.endsWith("/4"));
    await page.reload({ waitUntil: "commit" });
    await frame(4);

    // the bar between the panes goes with the hand
    const bar = page.getByRole("separator", { name: "Height of the plots" });
    const from = await bar.boundingBox();
    await page.mouse.move(from.x + 60, from.y + 2);
    await page.mouse.down();
    await page.mouse.move(from.x + 60, from.y - 38);
    await page.mouse.up();
    assert.ok(Math.abs((await bar.boundingBox()).y - (from.y - 40)) < 3, "the bar lies where it was let go");
    await bar.dblclick();

    // what is drawn in 3D can be chosen, with the button and its key
    const before = await resting(still);
    await page.getByRole("button", { name: "Body", exact: true }).click();
    assert.equal(await pressed("Body"), "false");
    await other(still, before, "the body stays in the picture");
    await page.keyboard.press("b");
    assert.equal(await pressed("Body"), "true");
    await page.keyboard.press("u");
    assert.equal(await pressed("Uncertainty"), "true");
    await page.getByLabel("Look from").selectOption({ label: "From above" });
    await page.getByLabel("Look from").selectOption({ label: "As cam1" });
    await picture("view-as-camera");
    await page.keyboard.press("f");

    // playing
    await page.keyboard.press("Space");
    await page.getByRole("button", { name: "Pause" }).waitFor();
    await page.waitForFunction(() => window.hypose.row() !== 4);
    await page.keyboard.press("]");
    await page.waitForFunction(() => document.querySelector("[aria-label=Speed]").value === "2");
    await page.getByRole("button", { name: "Pause" }).click();
    await page.getByRole("button", { name: "Play" }).waitFor();
    assert.equal(await page.evaluate(() => window.hypose.playing()), false);
    await page.keyboard.press("Home");
    await frame(0);

    // pictures: enlarged by key, and the edge of the masks over them
    await page.keyboard.press("2");
    assert.deepEqual(await page.locator(".tile:visible .tile-name").allInnerTexts(), ["cam2"]);
    await page.keyboard.press("Escape");
    assert.equal(await page.locator(".tile:visible").count(), 4);
    let made;
    const ready = new Promise((done) => (made = done));
    await page.route("**/outlines/0*", async (route) => (await ready, route.continue()));
    const asked = page.waitForResponse(/outlines\/0/);
    await page.getByRole("button", { name: "Edge of the masks" }).click();
    const waiting = page.getByText("The masks are being made…");
    await waiting.waitFor();
    await picture("view-masks-coming");
    // meanwhile pictures come, and of frames that are passed by no edges are asked for
    const edges = [];
    page.on("request", (request) => /outlines/.test(request.url()) && edges.push(request.url().split("/").pop()));
    for (const n of [1, 2, 3, 4, 5]) {
      await page.keyboard.press("ArrowRight");
      await page.waitForFunction((row) => window.hypose.pictureRow() === row, n);
    }
    assert.deepEqual(edges, []);
    const last = page.waitForResponse(/outlines\/5/);
    made();
    assert.deepEqual([(await asked).status(), (await last).status(), edges], [200, 200, ["5"]]);
    await waiting.waitFor({ state: "hidden" });
    await page.keyboard.press("Home");
    await frame(0);

    // plots and details
    await page.getByRole("tab", { name: "Quality" }).click();
    await page.getByText("Overlap with the masks (IoU)").waitFor();
    await page.locator(".plot-area canvas").nth(2).waitFor();
    const plot = await page.locator(".plot-area").first().boundingBox();
    await page.mouse.click(plot.x + plot.width - 30, plot.y + plot.height / 2);
    await page.waitForFunction(() => window.hypose.row() >= 6);
    await picture("view-quality");
    await page.getByRole("tab", { name: "Details" }).click();
    const details = await page.locator(".details").innerText();
    for (const text of ["frames lost", "mean IoU", "stature", "motion.npz", "Gauss-Newton"]) assert.match(details, new RegExp(text));
    await page.getByRole("link", { name: "Check the calibration" }).waitFor();
    await page.getByRole("tab", { name: "Cameras" }).click();

    // taken home
    await page.getByRole("button", { name: /Export/ }).click();
    const coming = page.waitForEvent("download");
    await page.getByRole("menuitem", { name: /motion.trc/ }).click();
    const file = await readFile(await (await coming).path(), "utf8");
    assert.match(file, /^PathFileType/);
    // what is not there is written first, under the name that it then has
    await page.keyboard.press("Escape");
    await page.getByRole("button", { name: /Export/ }).click();
    const written = page.waitForEvent("download");
    await page.getByRole("menuitem", { name: /motion\.osim/ }).click();
    const model = await written;
    assert.equal(model.suggestedFilename(), "motion.osim");
    assert.match(await readFile(await model.path(), "utf8"), /OpenSimDocument/);
    await page.keyboard.press("Escape");

    // help, and dark and light
    await page.locator(".view-head h1").click();
    await page.keyboard.press("?");
    assert.match(await page.getByRole("dialog").innerText(), /play or pause/);
    await page.getByRole("button", { name: "Close", exact: true }).click();
    await page.getByRole("button", { name: "Dark or light" }).click();
    assert.equal(await page.evaluate(() => document.documentElement.dataset.theme), "light");
    await picture("view-light");
    assert.ok(await where.isVisible());
    await page.getByRole("link", { name: "All results" }).click();
    await page.getByRole("heading", { name: "Results" }).waitFor();
    await page.goBack();
    await page.waitForFunction(() => window.hypose?.pictureRow() >= 0);
    // who leaves just when the frame has rested, before the page has heard of the new address, is not held back
    await page.evaluate(() => {
      location.hash = "#/view";
      window.hypose.view.options.rested(0);
    });
    await page.getByRole("heading", { name: "Results" }).waitFor();
  },
  { at: "#/view", colorScheme: "dark", acceptDownloads: true },
);
