// Joints are clicked in one picture and in a second one; dragged, hidden, taken back; the pose that fits is beside it.
import assert from "node:assert/strict";
import { existsSync, readFileSync } from "node:fs";
import { join } from "node:path";
import { walk } from "./harness.mjs";

await walk(
  async ({ page, folder, picture }) => {
    const fact = (name) => page.locator(`dt:text-is("${name}") + dd`).innerText();
    const settled = () => page.waitForFunction(() => window.__app.fit && !window.__app.fit.busy);
    const joint = (title) => page.getByRole("button", { name: title, exact: false }).first();
    const next = () => page.locator(".click-next").innerText();
    const canvas = page.locator(".click-canvas");
    // a person as a child draws one, in shares of the picture
    const figure = {
      head_top: [0.5, 0.2], neck: [0.5, 0.32], right_shoulder: [0.44, 0.35], right_elbow: [0.41, 0.46],
      right_wrist: [0.4, 0.56], left_shoulder: [0.56, 0.35], left_elbow: [0.59, 0.46], left_wrist: [0.6, 0.56],
      right_hip: [0.465, 0.58], right_knee: [0.46, 0.73], right_ankle: [0.46, 0.88], right_big_toe: [0.43, 0.91],
    };
    const place = async (name) => {
      const box = await canvas.boundingBox();
      const [w, h] = await page.evaluate(() => window.__app.size);
      const scale = Math.min(box.width / w, box.height / h);
      const [x, y] = figure[name];
      return [box.x + box.width / 2 + (x - 0.5) * w * scale, box.y + box.height / 2 + (y - 0.5) * h * scale];
    };

    await page.getByRole("heading", { name: "Click to start" }).waitFor();
    await page.getByRole("link", { name: "walk" }).first().click();
    await page.waitForFunction(() => window.__app.pictures > 0);
    assert.equal(await next(), "Click: Top of the head");
    assert.match(await page.locator(".fit-notes").innerText(), /from four on/);

    // a click places the joint whose turn it is and goes on to the next
    for (const name of Object.keys(figure)) await page.mouse.click(...(await place(name)));
    assert.equal(await next(), "Click: Left hip");
    await settled();
    assert.equal(await fact("Clicked"), "12 joints");
    assert.match(await fact("Off the clicks"), /^\d+\.\d px$/);
    assert.match(await fact("Camera distance"), /^± \d+ cm$/);
    assert.match(await page.locator(".fit-notes").innerText(), /One view/);
    assert.ok((await page.getByRole("radio", { name: "best" }).count()) <= 1);
    await page.mouse.move(...(await place("neck")));
    await page.waitForTimeout(400);
    await picture("click-one-view");

    assert.ok(Number((await fact("Off the clicks")).replace(" px", "")) < 20, "the pose does not fit the clicks");

    // dragging moves a joint and the pose with it; one undo takes the whole drag back
    const wrist = await page.evaluate(() => window.__app.clicks.cam1.left_wrist);
    const from = await place("left_wrist");
    await page.mouse.move(...from);
    await page.mouse.down();
    await page.mouse.move(from[0] + 14, from[1] - 22, { steps: 4 });
    await page.mouse.up();
    const dragged = await page.evaluate(() => window.__app.clicks.cam1.left_wrist);
    assert.ok(dragged.x > wrist.x + 2 && dragged.y < wrist.y - 4);
    await settled();
    await page.keyboard.press("Control+z");
    assert.deepEqual(await page.evaluate(() => window.__app.clicks.cam1.left_wrist), wrist);
    await page.keyboard.press("Control+Shift+z");
    assert.deepEqual(await page.evaluate(() => window.__app.clicks.cam1.left_wrist), dragged);
    await page.keyboard.press("u");

    // hidden joints, removed joints, and the keyboard alone
    await joint("Right wrist").click();
    await page.keyboard.press("o");
    assert.equal(await page.locator("[data-joint=right_wrist]").getAttribute("data-placed"), "hidden");
    await page.keyboard.press("Delete");
    assert.equal(await page.locator("[data-joint=right_wrist]").getAttribute("data-placed"), "no");
    await canvas.focus();
    await canvas.press("ArrowLeft");
    await canvas.press("Enter");
    assert.equal(await page.locator("[data-joint=right_wrist]").getAttribute("data-placed"), "yes");
    await page.keyboard.press("u");
    await page.keyboard.press("u");
    await settled();
    assert.equal(await fact("Clicked"), "12 joints");

    // a closed tab loses nothing
    const kept = await page.evaluate(() => window.__app.clicks);
    await page.reload({ waitUntil: "commit" });
    await page.waitForFunction(() => window.__app?.clicks?.cam1);
    assert.deepEqual(await page.evaluate(() => window.__app.clicks), kept);
    await settled();

    // kept as a start that the tracker of one camera reads
    await page.getByLabel("Name", { exact: true }).fill("first");
    await page.getByRole("button", { name: "Save", exact: true }).click();
    await page.getByText("Saved as starts/first.json").waitFor();
    const file = join(folder, "walk", "starts", "first.json");
    assert.ok(existsSync(file));
    const saved = JSON.parse(readFileSync(file, "utf-8"));
    assert.equal(saved.camera, "cam1");
    assert.equal(saved.frame, 0);
    assert.ok(Object.keys(saved.joints).length >= 6);

    // a second camera makes the distance known
    await page.keyboard.press("2");
    await page.waitForFunction(() => document.querySelector("[data-camera=cam2]").getAttribute("aria-checked") === "true");
    for (const name of ["head_top", "neck", "right_shoulder", "right_elbow"]) await page.mouse.click(...(await place(name)));
    await page.waitForFunction(() => window.__app.clicks.cam2?.right_elbow);
    await settled();
    assert.equal(await fact("Clicked"), "16 joints");
    assert.equal(await fact("Camera distance"), "from several views");
    await picture("click-two-views");

    // what is clicked in the third camera is what is tracked from, after the page was closed and opened as well
    await page.keyboard.press("3");
    for (const name of Object.keys(figure).slice(0, 8)) await page.mouse.click(...(await place(name)));
    await page.waitForFunction(() => window.__app.clicks.cam3?.left_wrist);
    await page.reload({ waitUntil: "commit" });
    await page.waitForFunction(() => window.__app?.clicks?.cam3);
    await settled();
    assert.equal(await page.locator("[data-camera=cam3]").getAttribute("aria-checked"), "true");
    const asked = page.waitForRequest((r) => r.url().endsWith("/api/jobs") && r.method() === "POST");
    await page.route("**/api/jobs", (route) => route.fulfill({ status: 201, json: { id: "0", title: "Track walk" } }));
    await page.getByRole("button", { name: "Track from here" }).click();
    assert.equal((await asked).postDataJSON().options.camera, "cam3");
    assert.equal((await asked).postDataJSON().options.start, "clicks:frame-0");
    assert.equal(JSON.parse(readFileSync(join(folder, "walk", "starts", "frame-0.json"), "utf-8")).camera, "cam3");
    await page.waitForFunction(() => location.hash.startsWith("#/setup/"));
    await page.unroute("**/api/jobs");

    // and a pose that was tracked is corrected
    await page.goto(`${page.url().split("#")[0]}#/click`);
    await page.getByRole("link", { name: "Correct default" }).first().click();
    await page.waitForFunction(() => location.hash.split("/").length === 5 && window.__app.pictures > 0);
    await page.mouse.click(...(await place("head_top")));
    await settled();
    assert.match(await fact("Off the clicks"), /px$/);

    // of any frame, in any view
    for (const frame of [1, 2, 3]) {
      await page.keyboard.press(".");
      await page.waitForFunction((n) => location.hash.split("/")[3] === n && window.__app.pictures > 0, String(frame));
    }
    await page.keyboard.press("3");
    await page.waitForFunction(() => document.querySelector("[data-camera=cam3]").getAttribute("aria-checked") === "true");
    await page.mouse.click(...(await place("right_wrist")));
    await page.waitForFunction(() => Object.keys(window.__app.clicks.cam3 ?? {}).length === 1);
    await settled();
    assert.equal(await fact("Clicked"), "1 joint");
    await page.getByRole("button", { name: "Track again from here" }).waitFor();
  },
  { at: "#/click" },
);
