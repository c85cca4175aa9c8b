import "./style.css";
import "./ui/over.css";
import { route } from "./router";
import { click } from "./click/screen";
import { gesture } from "./gesture/screen";
import { live } from "./live/screen";
import { setup } from "./setup/screen";
import { view } from "./view/screen";
import { suitCanvases } from "./lib/software";
import { startTheme } from "./ui/theme";

suitCanvases();
startTheme();
const root = document.getElementById("app");
if (root) route(root, { view, gesture, click, setup, live }, "view");
