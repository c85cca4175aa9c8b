export { gesture } from "../gesture/screen";
