export { click } from "../click/screen";
