/** Line icons of 20 x 20, drawn with the colour of the text. */
const PATHS = {
  play: '<path d="M6 4l10 6-10 6z" fill="currentColor" stroke-linejoin="round"/>',
  pause: '<path d="M6.5 4.5v11M13.5 4.5v11" stroke-width="2.6"/>',
  first: '<path d="M5 4.5v11M15 5l-7 5 7 5z"/>',
  last: '<path d="M15 4.5v11M5 5l7 5-7 5z"/>',
  back: '<path d="M12.5 4.5L7 10l5.5 5.5"/>',
  next: '<path d="M7.5 4.5L13 10l-5.5 5.5"/>',
  loop: '<path d="M4 9V8a3 3 0 013-3h8M12.5 2.5L15 5l-2.5 2.5M16 11v1a3 3 0 01-3 3H5M7.5 17.5L5 15l2.5-2.5"/>',
  body: '<circle cx="10" cy="4" r="2"/><path d="M5 8.5c3 .8 7 .8 10 0M10 9v4M10 13l-2.6 5M10 13l2.6 5"/>',
  skeleton: '<circle cx="10" cy="4" r="1.6"/><circle cx="10" cy="11" r="1.6"/><circle cx="5.5" cy="17" r="1.6"/><circle cx="14.5" cy="17" r="1.6"/><path d="M10 5.6v3.8M9 12.3l-2.6 3.4M11 12.3l2.6 3.4"/>',
  spread: '<ellipse cx="10" cy="10" rx="7.5" ry="4.5" transform="rotate(-30 10 10)"/><circle cx="10" cy="10" r="1.6" fill="currentColor"/>',
  rivals: '<circle cx="10" cy="3.8" r="1.7"/><path d="M10 5.500v6M10 11.500l-2.500 6M10 11.500l2.500 6"/><path d="M10 7.500l-6 3M10 7.500l-4.500 6M10 7.500l6 3M10 7.500l4.500 6" stroke-dasharray="1.8 1.400"/>',
  trail: '<path d="M3 15c3-8 5 3 8-3s2-7 6-8"/><circle cx="17" cy="4" r="1.4" fill="currentColor"/>',
  camera: '<path d="M3 6.5h8.5v7H3zM11.5 9.2L17 6.5v7l-5.5-2.7z" stroke-linejoin="round"/>',
  picture: '<rect x="3" y="4" width="14" height="12" rx="1.5"/><path d="M4 14l4-4.5 3 3 2-2 3.5 3.5"/>',
  edge: '<path d="M10 2.6c4 0 6.6 3.4 5.6 7.2-.8 3-2.4 3-2.8 5.2-.4 2.6-5.2 2.6-5.6 0-.4-2.2-2-2.2-2.8-5.2C3.400 6 6 2.600 10 2.600z" stroke-dasharray="2.4 1.8"/>',
  other: '<circle cx="7" cy="10" r="4.4"/><circle cx="13" cy="10" r="4.4" stroke-dasharray="2.2 1.6"/>',
  fit: '<path d="M3 7V3h4M13 3h4v4M17 13v4h-4M7 17H3v-4"/><circle cx="10" cy="10" r="2.2"/>',
  follow: '<circle cx="10" cy="10" r="5"/><path d="M10 2v4M10 14v4M2 10h4M14 10h4"/>',
  help: '<circle cx="10" cy="10" r="7.2"/><path d="M7.800 7.800a2.300 2.300 0 114 1.500c-.900.900-1.700 1.200-1.700 2.500"/><circle cx="10" cy="14.3" r=".6" fill="currentColor"/>',
  sun: '<circle cx="10" cy="10" r="3.4"/><path d="M10 2v2M10 16v2M2 10h2M16 10h2M4.300 4.300l1.400 1.400M14.300 14.300l1.400 1.400M4.300 15.700l1.400-1.400M14.300 5.700l1.400-1.400"/>',
  moon: '<path d="M15.500 12A6.500 6.500 0 018 4.500a6.500 6.500 0 107.500 7.500z" stroke-linejoin="round"/>',
  download: '<path d="M10 3v9M6.500 8.800L10 12.300l3.500-3.500M3.500 16.500h13"/>',
  report: '<path d="M5 2.500h7l3.500 3.500v11.500H5z" stroke-linejoin="round"/><path d="M7.500 9.500h5M7.500 12.500h5"/>',
  doctor: '<path d="M10 3.500v13M3.500 10h13"/><circle cx="10" cy="10" r="8"/>',
  close: '<path d="M5 5l10 10M15 5L5 15"/>',
  folder: '<path d="M2.500 5.500h5l2 2h8v8.500h-15z" stroke-linejoin="round"/>',
  list: '<path d="M4 5.500h12M4 10h12M4 14.500h12"/>',
  more: '<circle cx="10" cy="4.5" r="1.3" fill="currentColor" stroke="none"/><circle cx="10" cy="10" r="1.3" fill="currentColor" stroke="none"/><circle cx="10" cy="15.500" r="1.3" fill="currentColor" stroke="none"/>',
  chevron: '<path d="M5.500 8l4.500 4.500L14.500 8"/>',
  flag: '<path d="M5 17.500V3.500h9l-2 3 2 3H5"/>',
  warning: '<path d="M10 3.300l7.300 12.900H2.700z" stroke-linejoin="round"/><path d="M10 8.300v3.600"/><circle cx="10" cy="14" r=".6" fill="currentColor"/>',
  done: '<path d="M4 10.500l4 4 8-9"/>',
  hand: '<path d="M6.500 10V5a1.200 1.200 0 012.400 0v4-5.500a1.200 1.200 0 012.400 0V9 4.500a1.200 1.200 0 012.400 0V11c0 4-1.700 6.500-4.700 6.500-2.600 0-3.700-1.500-5.500-5 0 0 1.600-1.700 3-.5z" stroke-linejoin="round"/>',
  plus: '<path d="M10 4v12M4 10h12"/>',
  undo: '<path d="M7 4L3.500 7.500 7 11M4 7.500h7.500a4.500 4.500 0 010 9H8"/>',
  sound: '<path d="M3 8v4h3l4 3.500v-11L6 8zM13 7.500a3.500 3.500 0 010 5M15 5a7 7 0 010 10"/>',
  edit: '<path d="M4 16l.8-3.600L13 4.200a1.600 1.600 0 012.300 0l.5.5a1.600 1.600 0 010 2.300L7.600 15.200z" stroke-linejoin="round"/>',
  expand: '<path d="M11.500 3.500h5v5M16 4l-5 5M8.500 16.500h-5v-5M4 16l5-5"/>',
} as const;

export type IconName = keyof typeof PATHS;

export function icon(name: IconName): SVGSVGElement {
  const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  svg.setAttribute("viewBox", "0 0 20 20");
  svg.setAttribute("class", "icon");
  svg.setAttribute("aria-hidden", "true");
  svg.innerHTML = PATHS[name];
  return svg;
}
