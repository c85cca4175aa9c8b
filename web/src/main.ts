import "./style.css";
import "./ui/over.css";
import { route } from "./router";
import { click } from "./screens/click";
import { gesture } from "./screens/gesture";
import { live } from "./screens/live";
import { setup } from "./screens/setup";
import { view } from "./screens/view";
import { takeDrops } from "./setup/dropped";
import { suitCanvases } from "./lib/software";
import { startTheme } from "./ui/theme";

suitCanvases();
startTheme();
takeDrops();
const root = document.getElementById("app");
if (root) route(root, { view, gesture, click, setup, live }, "view");
