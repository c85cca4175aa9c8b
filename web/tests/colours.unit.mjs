// Curves in one plot are told apart by who sees no red, no green or no blue too, in both themes.
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";

const LEAST = 15; // difference in CIE L*a*b*; 2 is just seen side by side
const SEEN_BY = {
  everybody: [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
  // Machado, Oliveira & Fernandes 2009, A physiologically-based model for simulation of color vision deficiency
  "who lacks red": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
  "who lacks green": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.01182, 0.04294, 0.968881]],
  "who lacks blue": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.3039]],
};
const TOGETHER = [["first", "second", "third"], ["left", "right", "beside"]];

const css = readFileSync(join(dirname(fileURLToPath(import.meta.url)), "..", "src", "ui", "theme.css"), "utf-8");
const blocks = [...css.matchAll(/:root([^{]*)\{([^}]*)\}/g)];
const colours = (theme) =>
  Object.fromEntries(blocks.filter(([, which]) => !which.includes("data-theme") || which.includes(theme)).flatMap(([, , body]) => [...body.matchAll(/--([\w-]+): (#[0-9a-f]{6});/g)].map(([, name, value]) => [name, value])));

const times = (m, v) => m.map((row) => row.reduce((sum, x, i) => sum + x * v[i], 0));
const linear = (hex) => [1, 3, 5].map((i) => parseInt(hex.slice(i, i + 2), 16) / 255).map((c) => (c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4));
const lab = (rgb) => {
  const xyz = times([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]], rgb.map((c) => Math.min(1, Math.max(0, c))));
  const [x, y, z] = [xyz[0] / 0.9505, xyz[1], xyz[2] / 1.089].map((c) => (c > 0.008856 ? Math.cbrt(c) : 7.787 * c + 16 / 116));
  return [116 * y - 16, 500 * (x - y), 200 * (y - z)];
};
const luminance = (hex) => times([[0.2126, 0.7152, 0.0722]], linear(hex))[0];

for (const theme of ["dark", "light"]) {
  const all = colours(theme);
  for (const names of TOGETHER) {
    for (const [who, m] of Object.entries(SEEN_BY)) {
      const seen = names.map((n) => lab(times(m, linear(all[n]))));
      for (let i = 0; i < seen.length; i++) for (let j = 0; j < i; j++) {
        const apart = Math.hypot(...seen[i].map((v, k) => v - seen[j][k]));
        assert.ok(apart > LEAST, `${theme}: ${names[i]} and ${names[j]} are ${apart.toFixed(0)} apart for ${who}`);
      }
    }
    for (const name of names) {
      const [a, b] = [luminance(all[name]), luminance(all.panel)].sort((x, y) => y - x);
      assert.ok((a + 0.05) / (b + 0.05) > 3, `${theme}: ${name} on the panel`); // WCAG 1.4.11, graphics
    }
  }
}
