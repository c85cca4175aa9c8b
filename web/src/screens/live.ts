export { live } from "../live/screen";
