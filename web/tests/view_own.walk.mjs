// Results made for this: what the page computes is what Python computes; flags; two runs side by side.
// FOLDER/expected.json: {"row", "vertices", "cameras": [{"points", "pixels"}], "joints": [J][3], "regions": [J][3][3]}, m^2.
import assert from "node:assert/strict";
import { readFile } from "node:fs/promises";
import { join } from "node:path";
import { walk } from "./harness.mjs";

const opened = (page) => page.waitForFunction(() => window.hypose && document.querySelector(".where")?.textContent);

await walk(
  async ({ page, folder, picture }) => {
    const { results } = await (await fetch(new URL("api/state", process.env.STUDIO))).json();
    const result = (path) => results.find((r) => r.path.endsWith(path)).id;

    // ---- parity with Python
    const expected = JSON.parse(await readFile(join(folder, "expected.json"), "utf8"));
    await page.evaluate((id) => (location.hash = `#/view/${id}`), result("walk/results/flagged"));
    await opened(page);
    const found = await page.evaluate(({ row, cameras }) => {
      const { cameras: pane } = window.hypose.view;
      pane.skin.pose(row);
      const pixels = cameras.map(({ points }, i) => {
        const out = new Float32Array((points.length / 3) * 2);
        pane.tiles[i].overlay.projector.project(Float32Array.from(points), out);
        return [...out];
      });
      return { vertices: [...pane.skin.vertices], pixels };
    }, expected);
    const worst = (a, b) => Math.max(...a.map((v, i) => Math.abs(v - b[i])));
    assert.equal(found.vertices.length, expected.vertices.length);
    assert.ok(worst(found.vertices, expected.vertices) < 1e-4, "skinning");
    expected.cameras.forEach((c, i) => assert.ok(worst(found.pixels[i], c.pixels) < 0.02, `projection ${i}`));

    // ---- what is drawn around a joint is its own region of 90 %, not a ball
    await page.keyboard.press("u");
    await page.getByRole("button", { name: "Uncertainty", pressed: true }).waitFor();
    const regions = await page.evaluate((row) => {
      window.hypose.view.go(row);
      window.hypose.view.space.show(row);
      const { mesh } = window.hypose.view.space.spread;
      return Array.from({ length: mesh.count }, (_, j) => [...mesh.instanceMatrix.array.slice(16 * j, 16 * (j + 1))]);
    }, expected.row);
    regions.forEach((m, j) => {
      assert.ok(worst(m.slice(12, 15), expected.joints[j]) < 1e-4, `centre of region ${j}`);
      // the columns of the matrix span the ellipsoid
      const squared = [0, 1, 2].map((a) => [0, 1, 2].map((b) => [0, 1, 2].reduce((sum, k) => sum + m[4 * k + a] * m[4 * k + b], 0)));
      const size = Math.max(...expected.regions[j].flat());
      assert.ok(worst(squared.flat(), expected.regions[j].flat()) < 1e-3 * size, `region ${j}`);
    });
    await page.keyboard.press("Home");

    // ---- flags
    assert.match(await page.locator(".view-head").innerText(), /2 lost\s+1 extrapolated/);
    await page.keyboard.press("n");
    await page.waitForFunction(() => window.hypose.row() === 3);
    await page.keyboard.press("n");
    await page.waitForFunction(() => window.hypose.row() === 6);
    await page.keyboard.press("p");
    await page.waitForFunction(() => window.hypose.row() === 3);

    // ---- one camera: the other poses that it leaves open
    await page.evaluate((id) => (location.hash = `#/view/${id}`), result("walk/results/monocular"));
    await page.getByText("3 poses, the one shown 62 %").waitFor();
    const others = () => page.evaluate(() => window.hypose.view.space.rivals.group.children.map((c) => c.visible && c.parent.visible));
    assert.deepEqual(await others(), [true, true]);
    await picture("view-poses");
    await page.keyboard.press("o");
    await page.getByRole("button", { name: "Other poses", pressed: false }).waitFor();
    assert.deepEqual(await others(), [false, false]);
    await page.keyboard.press("o");
    await page.keyboard.press("End");
    await page.getByText("one pose", { exact: true }).waitFor();
    assert.deepEqual(await others(), [false, false]);
    await page.getByRole("tab", { name: "Quality" }).click();
    await page.getByText("Weight of the pose shown").waitFor();
    await page.getByRole("tab", { name: "Legs" }).click();

    // ---- another run of the same recording beside it
    await page.evaluate((id) => (location.hash = `#/view/${id}`), result("walk/results/flagged"));
    // the result shown before, which is there until this one is loaded, can be compared as well
    await page.locator(".view-head", { hasText: /2 lost/ }).waitFor();
    await page.getByLabel("Compare with another run").selectOption({ label: "default" });
    await page.getByRole("tab", { name: "Difference", selected: true }).waitFor();
    await page.getByRole("tab", { name: "Legs" }).click();
    await page.locator("figcaption .dashed").first().waitFor();
    await picture("view-compare");
  },
  { at: "#/view" },
);
