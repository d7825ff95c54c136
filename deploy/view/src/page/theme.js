// Colours. They are declared once, in the style sheet, for dark and light; the canvases read them from there.

const NAMES = [
  "ground", "panel", "line", "text", "muted", "faint", "accent", "ok", "warn", "bad", "band", "ring", "field",
  "age-1", "age-2", "age-3", "age-4", "age-5", "age-ink",
];
const VEHICLE_COLOURS = 8;
const STORED = "skein.theme";

/**
 * The colours of the present theme, by name; `vehicles` differ for the colour-blind too (after Okabe and Ito). `rem` is the
 * size of the text in units of drawing, `unit` the size of that unit in CSS pixels.
 */
export const colours = { vehicles: [], ages: [], rem: 14, unit: 1 };

/** Reads the colours from the style sheet. */
export function readColours() {
  const style = getComputedStyle(document.documentElement);
  const read = (name) => style.getPropertyValue(`--${name}`).trim();
  for (const name of NAMES) colours[name.replace("-", "_")] = read(name);
  colours.vehicles = Array.from({ length: VEHICLE_COLOURS }, (_, at) => read(`vehicle-${at + 1}`));
  colours.ages = [null, 1, 2, 3, 4, 5].map((kind) => (kind === null ? null : read(`age-${kind}`)));
  colours.unit = parseFloat(style.fontSize) / colours.rem;
}

/** Colour of the vehicle at this place of the list; large swarms have one colour, or one for each team. */
export function vehicleColour(swarm, index) {
  const { teams, vehicles } = swarm;
  if (teams.length > 1) {
    const team = swarm.teamIndex[index];
    return colours.vehicles[team % VEHICLE_COLOURS];
  }
  return vehicles.length <= VEHICLE_COLOURS ? colours.vehicles[index] : colours.vehicles[0];
}

/** A font of so many rem. */
export function font(size, weight = 400) {
  return `${weight} ${(size * colours.rem).toFixed(1)}px system-ui, "Segoe UI", Roboto, "DejaVu Sans", sans-serif`;
}

/** Follows the system's theme until the user chooses one, and calls `changed` after each change. */
export function startTheme(button, changed) {
  const system = window.matchMedia("(prefers-color-scheme: dark)");
  const apply = (theme) => {
    if (theme) document.documentElement.dataset.theme = theme;
    readColours();
    changed();
  };
  const toggle = () => {
    const present = document.documentElement.dataset.theme ?? (system.matches ? "dark" : "light");
    const next = present === "dark" ? "light" : "dark";
    store(next);
    apply(next);
  };
  system.addEventListener("change", () => apply(null));
  window.addEventListener("resize", () => apply(null));
  button.addEventListener("click", toggle);
  apply(stored());
  return toggle;
}

// A browser may forbid storage: the choice then lasts until the page is closed.
function stored() {
  try {
    const theme = localStorage.getItem(STORED);
    return theme === "dark" || theme === "light" ? theme : null;
  } catch {
    return null;
  }
}

function store(theme) {
  try {
    localStorage.setItem(STORED, theme);
  } catch {
    // The theme is applied all the same.
  }
}
