// A source of the page as a module for Node, so that what needs no browser is tested without one.
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";
import * as esbuild from "esbuild";

const web = join(dirname(fileURLToPath(import.meta.url)), "..");

/** The exports of a file of web/src. */
export async function load(path) {
  const built = await esbuild.build({
    absWorkingDir: web, entryPoints: [path], bundle: true, format: "esm", platform: "node", write: false, loader: { ".css": "empty" },
  });
  return import(`data:text/javascript;base64,${Buffer.from(built.outputFiles[0].contents).toString("base64")}`);
}
