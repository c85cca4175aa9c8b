// What is seen can be looked at from everywhere with keys alone: the 3D picture, the plots, an enlarged picture.
import assert from "node:assert/strict";
import { barriers, other, resting, staysCutOff, walk } from "./harness.mjs";

await walk(
  async ({ page, picture }) => {
    const { results } = await (await fetch(new URL("api/state", process.env.STUDIO))).json();
    await page.evaluate((id) => (location.hash = `#/view/${id}`), results.find((r) => r.path.endsWith("walk/results/default")).id);
    await page.waitForFunction(() => window.hypose?.pictureRow() === 0);
    const row = () => page.evaluate(() => window.hypose.row());
    const eye = () => page.evaluate(() => [...window.hypose.view.space.stage.camera.position, ...window.hypose.view.space.stage.controls.target]);
    const far = (a, b) => Math.hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]);

    // 3D: turned, moved, closer; the frame stays
    const space = page.getByRole("application", { name: /The person in three dimensions/ });
    await space.focus();
    const first = await eye();
    await page.keyboard.press("ArrowLeft");
    await page.keyboard.press("ArrowUp");
    const turned = await eye();
    assert.ok(far(first, turned) > 0.2 && far(first.slice(3), turned.slice(3)) < 1e-6);
    assert.ok(Math.abs(far(first, first.slice(3)) - far(turned, turned.slice(3))) < 1e-3);
    await page.keyboard.press("+");
    const near = await eye();
    assert.ok(far(near, near.slice(3)) < 0.95 * far(turned, turned.slice(3)));
    await page.keyboard.press("Shift+ArrowRight");
    const moved = await eye();
    assert.ok(far(moved.slice(3), near.slice(3)) > 0.1, JSON.stringify([near, moved]));
    assert.equal(await row(), 0);
    // a click into it gives the keys back to the frames
    await space.click({ position: { x: 20, y: 20 } });
    await page.keyboard.press("ArrowRight");
    assert.equal(await row(), 1);

    // plots tell their values, and the keys move through the frames
    const plot = page.locator(".plots").getByRole("slider").first();
    await plot.focus();
    await page.waitForFunction(() => document.activeElement.getAttribute("aria-valuenow") === "1");
    const told = await plot.getAttribute("aria-valuetext");
    assert.match(told, /^0:00\.\d+: left -?\d+\.\d, right -?\d+\.\d °$/);
    await page.keyboard.press("ArrowRight");
    await page.waitForFunction(() => document.activeElement.getAttribute("aria-valuenow") === "2");
    assert.match(await plot.getAttribute("aria-label"), /°\): left from/);

    // an enlarged picture: closer with keys and wheel, moved with keys and the pointer
    await page.keyboard.press("2");
    const tile = page.getByRole("img", { name: "Picture of cam2" });
    const shot = () => tile.screenshot();
    const seen = async () => (await page.waitForFunction(() => window.hypose.pictureRow() === window.hypose.row()), resting(shot));
    const whole = await seen();
    await page.keyboard.press("+");
    await page.keyboard.press("+");
    await page.keyboard.press("+");
    await other(shot, whole, "the picture is not enlarged further");
    const closer = await seen();
    await tile.focus();
    await page.keyboard.press("ArrowRight");
    await other(shot, closer, "keys do not move the picture");
    assert.equal(await row(), 2);
    const box = await tile.boundingBox();
    await page.mouse.move(box.x + box.width / 2, box.y + box.height / 2);
    const before = await seen();
    await page.mouse.wheel(0, -400);
    await other(shot, before, "the wheel does not enlarge the picture");
    const large = await seen();
    await page.mouse.down();
    await page.mouse.move(box.x + box.width / 2 - 60, box.y + box.height / 2 - 30, { steps: 4 });
    await page.mouse.up();
    await other(shot, large, "the pointer does not move the picture");
    await picture("view-enlarged");
    assert.deepEqual(await staysCutOff(page), []);
    assert.deepEqual(await barriers(page), []);
    await page.keyboard.press("Escape");
    await page.getByRole("img", { name: "Picture of cam1" }).waitFor();
    await page.keyboard.press("2");
    assert.equal(await page.evaluate(() => window.hypose.view.cameras.tiles[1].zoom.times), 1, "enlarged again it is whole");
  },
  { at: "#/view", colorScheme: "dark" },
);
