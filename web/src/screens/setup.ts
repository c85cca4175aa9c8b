export { setup } from "../setup/screen";
