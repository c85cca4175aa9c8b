// Builds the studio's page into hypose/app/studio/static. `node build.mjs [--watch] [--out FOLDER]`
// Needs the packages of package-lock.json (`npm ci`); the wheel's build (hatch_build.py) does both.
import { copyFile, mkdir, rm } from "node:fs/promises";
import { existsSync } from "node:fs";
import { dirname, join, resolve } from "node:path";
import { fileURLToPath } from "node:url";
import * as esbuild from "esbuild";

const here = dirname(fileURLToPath(import.meta.url));
const at = process.argv.indexOf("--out");
const out = at > 0 ? resolve(process.argv[at + 1]) : join(here, "..", "hypose", "app", "studio", "static");
const watch = process.argv.includes("--watch");

const common = {
  absWorkingDir: here,
  bundle: true,
  minify: !watch,
  sourcemap: watch ? "inline" : false,
  target: ["es2022"],
  charset: "utf8",
  legalComments: "eof", // the libraries' licences stay in the bundle
  logLevel: "warning",
};
// The page itself, and the same viewer as one script without imports, which `hypose report` writes into a file that
// is opened from disk (file:// allows no modules).
const builds = [{ ...common, entryPoints: { studio: "src/main.ts" }, format: "esm", outdir: out }];
if (existsSync(join(here, "src", "report.ts"))) {
  builds.push({ ...common, entryPoints: { report: "src/report.ts" }, format: "iife", outdir: out });
}

if (!watch) await rm(out, { recursive: true, force: true });
await mkdir(out, { recursive: true });
await copyFile(join(here, "index.html"), join(out, "index.html"));
for (const options of builds) {
  if (watch) await (await esbuild.context(options)).watch();
  else await esbuild.build(options);
}
