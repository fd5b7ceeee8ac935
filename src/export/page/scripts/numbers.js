// Tables of metrics, timings and parameters, warnings, and the tiles at the top.

const measure = (name, x) => (/(error|distance)$|^rmse$/.test(name) ? `${fixed(1e3 * x, 2)} mm` : `${fixed(100 * x, 1)} %`);
// The metrics at the top.
const LEADING = ["completeness", "false_returns", "median_error"];
// The units of the report's numbers: [keys, unit, factor].
const UNITS = [
  [/^(range_resolution|lateral_resolution_.*|wavelength|alias_free_pitch|reflector_spacing)$/, "mm", 1e3],
  [/^(unambiguous_path|path_bounds|low|high|size)$/, "m", 1],
  [/_bytes$/, "MB", 1e-6],
  [/^area$/, "m²", 1],
  [/^size_wavelengths$/, "λ", 1],
  [/^grid_shape$/, "(z, y, x)", 1],
];
const words = (name) => name.replaceAll("_", " ");

function plain(value) {
  if (value === null || value === undefined) return "–";
  if (typeof value === "number") return Number.isInteger(value) ? String(value).replace("-", "−") : String(Number(value.toPrecision(4))).replace("-", "−");
  if (Array.isArray(value)) return value.length ? value.map(plain).join(", ") : "none";
  if (typeof value === "object") return Object.entries(value).map(([k, v]) => `${words(k)} ${plain(v)}`).join(", ");
  return String(value);
}

function withUnit(name, value) {
  const [, unit, factor] = UNITS.find(([keys]) => keys.test(name)) ?? [null, "", 1];
  if (value === null || !unit) return plain(value);
  const short = (x) => (typeof x === "number" ? Number((x * factor).toPrecision(4)) : x);
  return `${plain(Array.isArray(value) ? value.map(short) : short(value))} ${unit}`;
}

function table(rows) {
  const body = element("tbody");
  for (const [name, value, kind = ""] of rows) {
    const cells = [element("th", { scope: "row", className: kind, colSpan: value === undefined ? 2 : 1 }, name)];
    if (value !== undefined) cells.push(value instanceof Node ? value : element("td", {}, value));
    body.append(element("tr", {}, ...cells));
  }
  return element("table", {}, body);
}

// Nested parameters: tables become headings, their keys rows.
function parameters(tree) {
  const rows = [];
  for (const [name, value] of Object.entries(tree)) {
    if (value !== null && typeof value === "object" && !Array.isArray(value)) {
      if (!Object.keys(value).length) continue;
      rows.push([`[${name}]`, undefined, "group"]);
      for (const [key, inner] of Object.entries(value)) rows.push([key, plain(inner), "deep"]);
    } else if (Array.isArray(value) && value.some((v) => v !== null && typeof v === "object")) {
      rows.push([words(name), undefined, "group"]);
      for (const item of value) rows.push([item.name || "(unnamed)", plain({ ...item, name: undefined }).replace(/^name –, /, ""), "deep"]);
    } else rows.push([words(name), withUnit(name, value)]);
  }
  return table(rows);
}

function card(title, content, folded) {
  if (!folded) return element("div", {}, element("h3", {}, title), content);
  return element("details", {}, element("summary", {}, title), content);
}

function showNumbers() {
  const { metrics, timings = {}, warnings = [], plan = {}, run = {}, scene } = report;
  const seconds = Object.values(timings).reduce((sum, s) => sum + s, 0);
  const known = Object.entries(metrics ?? {}).filter(([, x]) => x !== null);
  const tiles = [];
  const tile = (name, value, unit) => tiles.push(element("div", {}, element("dt", {}, name), element("dd", {}, value, " ", element("small", {}, unit))));
  for (const [name, x] of known.filter(([name]) => LEADING.includes(name))) tile(words(name), ...measure(name, x).split(" "));
  if (plan.range_resolution) tile("range resolution", fixed(1e3 * plan.range_resolution, 1), "mm");
  if (plan.lateral_resolution_near?.[0] && plan.lateral_resolution_far?.[0])
    tile("across, near to far", `${fixed(1e3 * plan.lateral_resolution_near[0], 0)}–${fixed(1e3 * plan.lateral_resolution_far[0], 0)}`, "mm");
  tile("pixels with a return", String(report.accepted ?? "–"), `of ${report.pixels ?? "–"}`);
  tile("computed in", fixed(seconds, seconds < 10 ? 2 : 0), "s");
  $("tiles").replaceChildren(...tiles);

  const lead = [];
  if (plan.grid_shape) lead.push(`${[...plan.grid_shape].reverse().join(" × ")} voxels`);
  if (plan.microphones) lead.push(`${plan.microphones} microphones`);
  if (plan.frequencies) lead.push(`${plan.frequencies} frequencies`);
  if (report.reflectors) lead.push(`${report.reflectors} reflectors`);
  if (scene?.triangles) lead.push(`${scene.triangles} triangles`);
  $("lead").textContent = lead.join(" · ");

  if (warnings.length) {
    $("warnings").hidden = $("warning-link").hidden = false;
    $("warning-link").textContent = warnings.length === 1 ? "1 warning" : `${warnings.length} warnings`;
    $("warning-list").replaceChildren(...warnings.map((w) => element("li", {}, w)));
  }

  const most = Math.max(...Object.values(timings), 1e-9);
  const timing = ([stage, s]) => {
    const strip = element("i");
    strip.style.backgroundSize = `${(100 * s) / most}% 100%`;
    return [stage, element("td", { className: "measure" }, `${fixed(s, 3)} s`, strip)];
  };
  const cards = [];
  if (known.length) cards.push(card("Against the truth", table(known.map(([name, x]) => [words(name), measure(name, x)]))));
  const groups = [...Object.entries(report.materials ?? {}), ...(report.surfaces ?? []).map((values, k) => [`surface ${k + 1} from the front`, values])];
  const parted = groups.map(([name, values]) => [name, Object.entries(values).filter(([, x]) => x !== null)]).filter(([, values]) => values.length);
  if (parted.length > 2)
    cards.push(card("By material and by surface", table(parted.flatMap(([name, values]) => [[name, undefined, "group"], ...values.map(([key, x]) => [words(key), measure(key, x), "deep"])])), true));
  cards.push(card("Time", table([...Object.entries(timings).map(timing), ["total", `${fixed(seconds, 3)} s`]])));
  const image = { method: report.method, peak_amplitude: report.peak_amplitude, error_bound: report.error_bound, correlation: report.correlation, motion: report.motion, coding: report.coding, ...plan, warnings: undefined };
  cards.push(card("Plan and reconstruction", parameters(Object.fromEntries(Object.entries(image).filter(([, v]) => v !== undefined)))));
  if (scene) cards.push(card("Scene", parameters(scene)));
  cards.push(card("Run file, resolved", parameters(run), true));
  if (report.files) cards.push(card("Files", table(report.files.map((name) => [name])), true));
  $("tables").replaceChildren(...cards);
  $("footer").textContent = `${report.program ?? "holosonar"}. This page is self-contained and loads nothing. Axes: x right, y down, z from the array into the scene, in metres.`;
}
