// An arm that was spoilt on purpose: seen by `n`, put right by dragging it in the pictures, tracked again around; kept,
// reopened, undone. FOLDER/expected.json: {"first", "row", "joints": {camera: {joint: [x, y]}}}, where the joints truly are.
import assert from "node:assert/strict";
import { copyFileSync, existsSync, readFileSync } from "node:fs";
import { join } from "node:path";
import { staysCutOff, walk } from "./harness.mjs";

await walk(
  async ({ page, folder, picture }) => {
    const { first, joints } = JSON.parse(readFileSync(join(folder, "expected.json"), "utf-8"));
    const { results } = await (await fetch(new URL("api/state", process.env.STUDIO))).json();
    const spoilt = results.find((r) => r.path.endsWith("results/default")).id;
    await page.evaluate((id) => (location.hash = `#/view/${id}`), spoilt);
    await page.waitForFunction(() => window.hypose?.pictureRow() === 0);
    // the assessment is read first, in words
    assert.match(await page.locator(".view-assessment").innerText(), /^Look at frames? .*left elbow, left wrist may be wrong there/s);
    assert.equal(await page.locator(".doubts").innerText(), "");
    const colours = () => page.evaluate(() => {
      const { space, data } = window.hypose.view;
      const all = space.sticks.balls.instanceColor.array;
      const of = (name) => [...all.slice(3 * data.header.joint_names.indexOf(name), 3 * data.header.joint_names.indexOf(name) + 3)];
      return { wrong: of("left_wrist"), right: of("left_knee") };
    });
    const calm = await colours();
    assert.deepEqual(calm.wrong, calm.right);
    await picture("correct-good-frame");

    let actions = 0;
    const did = () => actions++;
    await page.keyboard.press("n");
    did();
    await page.waitForFunction((row) => window.hypose.row() === row && window.hypose.pictureRow() === row, first);
    await page.getByText("May be wrong here: left elbow, left wrist").waitFor();
    const alarmed = await colours();
    assert.notDeepEqual(alarmed.wrong, calm.wrong);
    assert.deepEqual(alarmed.right, calm.right);
    // red on the line of time and on the curves, which have their bands
    const red = (selector) => page.evaluate((s) => {
      const canvas = document.querySelector(s);
      const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
      let n = 0;
      for (let i = 0; i < data.length; i += 4) if (data[i] > 200 && data[i + 1] < 120 && data[i + 2] < 130 && data[i + 3] > 200) n++;
      return n;
    }, selector);
    assert.ok((await red(".timeline canvas")) > 20, "no red on the line of time");
    await page.getByRole("tab", { name: "Arms" }).click();
    await page.waitForFunction(() => document.querySelectorAll(".plot-area canvas").length === 3);
    await page.waitForTimeout(600);
    assert.ok((await red(".plot-area canvas")) > 20, "no red on the curve of the arm");
    const bands = await page.evaluate(() => window.hypose.view.plots.plots.map((p) => p.chart.bands.length));
    assert.deepEqual(bands, [2, 2, 2]);
    await picture("correct-seen");

    // what was dragged is shown as the pose that fits; Escape takes it all back
    await page.keyboard.press("e");
    did();
    await page.getByText(/Correcting frame \d+ of default: drag the joints/).waitFor();
    const drag = async (camera, joint) => {
      const at = await page.evaluate(([camera, joint]) => {
        const { cameras, data } = window.hypose.view;
        const overlay = cameras.overlayOf(camera);
        const pixels = overlay.pixelsOf(window.hypose.row());
        const j = data.header.joint_names.indexOf(joint);
        const tile = cameras.tiles.find((t) => t.overlay === overlay);
        const box = tile.canvas.getBoundingClientRect();
        const [x, y] = tile.zoom.toScreen([-0.5, -0.5]);
        return { x: box.x + x, y: box.y + y, scale: tile.zoom.scale, from: [pixels[2 * j], pixels[2 * j + 1]] };
      }, [camera, joint]);
      const screen = ([x, y]) => [at.x + (x + 0.5) * at.scale, at.y + (y + 0.5) * at.scale];
      await page.mouse.move(...screen(at.from));
      await page.mouse.down();
      await page.mouse.move(...screen(joints[camera][joint]), { steps: 5 });
      await page.mouse.up();
      await page.waitForFunction(() => !window.hypose.view.corrector.asking && window.hypose.view.corrector.fit);
    };
    const [one, two] = Object.keys(joints);
    await drag(one, "left_wrist");
    did();
    await page.getByText(/left wrist \d+ cm in one picture/).waitFor();
    await drag(two, "left_wrist");
    did();
    await drag(one, "left_elbow");
    did();
    await page.getByText(/left wrist \d+ cm, left elbow \d+ cm/).waitFor();
    await picture("correct-dragged");
    assert.deepEqual(await staysCutOff(page), []);
    await page.getByRole("button", { name: "Track again from here" }).click();
    did();
    assert.ok(actions <= 6, `${actions} actions`);
    await page.getByText(/are tracked again; default stays as it was/).waitFor();
    await page.waitForFunction((old) => location.hash.startsWith("#/view/") && !location.hash.includes(old), spoilt);
    await page.getByText("Corrected").first().waitFor();
    await page.waitForFunction((row) => window.hypose?.pictureRow() === row, first);
    await picture("correct-done");
    const made = join(folder, "walk", "results", "default-corrected");
    copyFileSync(join(made, "motion.npz"), join(folder, "corrected.npz"));
    assert.ok(existsSync(join(folder, "walk", "starts", `default-frame-${first}.json`)));

    // the correction is listed, can be opened again with its drags, and undone
    await page.getByRole("button", { name: "Corrected" }).click();
    await page.getByRole("menuitem", { name: new RegExp(`Frame ${first}`) }).click();
    await page.getByText(/Correcting frame \d+ of default: left wrist \d+ cm/).waitFor();
    await page.keyboard.press("Escape");
    await page.getByText(/Correcting frame/).waitFor({ state: "hidden" });
    await page.goBack();
    await page.getByRole("button", { name: "Corrected" }).click();
    page.once("dialog", (dialog) => dialog.accept());
    await page.getByRole("menuitem", { name: /Undo/ }).click();
    await page.waitForFunction((old) => location.hash.includes(old), spoilt);
    await page.waitForFunction(() => window.hypose?.view.player.rows > 0);
    assert.ok(!existsSync(join(made, "motion.npz")));
  },
  { at: "#/view", colorScheme: "dark", viewport: { width: 1440, height: 900 } },
);
