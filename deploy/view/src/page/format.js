// Numbers, times and ids as people read them.

/** A number with so many decimals; a dash if there is no number. */
export function number(value, decimals = 0) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  const text = value.toFixed(decimals);
  // No "-0.0", and a minus as wide as a plus.
  return /^-0(\.0*)?$/.test(text) ? text.slice(1) : text.replace("-", "−");
}

/** A number with its sign. */
export function signed(value, decimals = 0) {
  const text = number(value, decimals);
  return value > 0 && Number(text) !== 0 ? `+${text}` : text;
}

/** An age in ms: `180 ms`, `2.4 s`, `3 min`. */
export function age(ms) {
  if (ms === null || ms === undefined || !Number.isFinite(ms)) return "–";
  if (ms < 1000) return `${Math.round(ms)} ms`;
  if (ms < 10_000) return `${(ms / 1000).toFixed(1)} s`;
  if (ms < 120_000) return `${Math.round(ms / 1000)} s`;
  return `${Math.round(ms / 60_000)} min`;
}

/** A time in s: `02:13`, `1:02:13`, with tenths `02:13.4`. */
export function time(seconds, hasTenths = false) {
  if (seconds === null || seconds === undefined || !Number.isFinite(seconds)) return "–";
  const sign = seconds < 0 ? "−" : "";
  const tenths = hasTenths ? Math.floor(Math.abs(seconds) * 10 + 1e-6) : Math.floor(Math.abs(seconds) + 1e-6) * 10;
  const whole = Math.floor(tenths / 10);
  const two = (value) => String(value).padStart(2, "0");
  const hours = Math.floor(whole / 3600);
  const clock = `${two(Math.floor(whole / 60) % 60)}:${two(whole % 60)}`;
  return `${sign}${hours ? `${hours}:` : ""}${clock}${hasTenths ? `.${tenths % 10}` : ""}`;
}

/** A length in m, with a unit that suits it: `12.3 m`, `240 m`, `3.2 km`. */
export function metres(value) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  const size = Math.abs(value);
  if (size >= 10_000) return `${number(value / 1000)} km`;
  if (size >= 1000) return `${number(value / 1000, 1)} km`;
  return `${number(value, size < 100 ? 1 : 0)} m`;
}

/** Ids as text, neighbours joined: `1–4, 7`. At most `limit` pieces are listed. */
export function ids(list, limit = 12) {
  const runs = [];
  for (const id of list) {
    const value = /^\d+$/.test(id) ? Number(id) : null;
    const run = runs.at(-1);
    if (run && value !== null && run.last === value - 1) {
      run.last = value;
      run.to = id;
    } else {
      runs.push({ from: id, to: id, last: value });
    }
  }
  const pieces = runs.flatMap(({ from, to, last }) => {
    if (from === to) return [from];
    return last === Number(from) + 1 ? [from, to] : [`${from}–${to}`];
  });
  const shown = pieces.slice(0, limit);
  return shown.join(", ") + (pieces.length > limit ? ", …" : "");
}

/** `1 vehicle`, `4 vehicles`. */
export function count(amount, noun) {
  return `${amount.toLocaleString("en")} ${noun}${amount === 1 ? "" : "s"}`;
}

/** Steps of an axis of this span with at most so many marks: 1, 2 or 5 times a power of ten. */
export function tickStep(span, marks) {
  const rough = span / Math.max(1, marks);
  const power = 10 ** Math.floor(Math.log10(rough));
  return [1, 2, 5, 10].map((factor) => factor * power).find((step) => step >= rough * 0.999) ?? power * 10;
}
