// The depth maps.

// The arrays of a surface, and how each is unpacked.
const OF_SURFACE = { depth: floats, error: floats, confidence: floats, amplitude: bytes, shading: bytes };
const ORDER = ["First", "Second", "Third"];

async function surfaceOf(packed) {
  const made = {};
  for (const [key, unpacked] of Object.entries(OF_SURFACE)) if (packed[key]) made[key] = await unpacked(packed[key]);
  return made;
}

// The maps; their `surfaces` are the picked return and, where there are several, every return from the front.
async function loadMaps() {
  if (!data.maps) return null;
  const { picked, returns = [], truth, true_shading: trueShading, ...rest } = data.maps;
  const first = await surfaceOf(picked);
  first.name = report.run?.depth?.pick === "first" ? "Picked" : "Strongest";
  const surfaces = [first];
  for (const [k, packed] of returns.entries()) {
    const made = await surfaceOf(packed);
    const same = await bytes(packed.same);
    for (const [key, values] of Object.entries(first)) if (made[key]) same.forEach((is, i) => is && (made[key][i] = values[i]));
    surfaces.push({ ...made, name: ORDER[k] ?? `${k + 1}th` });
  }
  return { ...rest, surfaces, truth: truth && (await floats(truth)), trueShading: trueShading && (await bytes(trueShading)) };
}

// The point of a map's pixel at a depth: the axes are in metres, or slopes if the rays start at the origin.
const placed = ({ x, y, view }, ix, iy, z) => [x, y].map((axis, k) => position(axis, [ix, iy][k]) * (view === "perspective" ? z : 1)).concat(z);

// `chose` is called with the surface that the user chooses.
function showMaps(loaded, depths, slices, chose) {
  const { x, y, truth, trueShading, surfaces } = loaded;
  let shown = surfaces[0], cursor = null;
  const { error } = shown;
  const sizes = Array.from(error ?? []).filter((e) => e === e).map((e) => Math.abs(1e3 * e)).sort((a, b) => a - b);
  const p95 = sizes.length ? Math.max(sizes[Math.min(sizes.length - 1, Math.floor(0.95 * sizes.length))], 1e-3) : 1;
  const power = 10 ** Math.floor(Math.log10(p95));
  const round = [1, 1.5, 2, 3, 4, 5, 6, 8, 10].map((f) => f * power).find((l) => l >= p95 * (1 - 1e-9));
  // As in error.png: beyond twice the resolution an error is a false return.
  const limit = Math.min(round, 2e3 * (report.plan?.range_resolution || Infinity));
  const bound = Number(limit.toPrecision(3));
  const plots = [];
  // The axes of a camera count pixels, so that the maps match a rendered picture.
  const camera = loaded.view === "perspective";
  const [px, py] = [x, y].map((axis) => (camera ? { first: 0, pitch: loaded.reduced, count: axis.count } : axis));
  const point = (ix, iy, chosen) => {
    const i = iy * x.count + ix;
    const { depth, amplitude, confidence, error } = shown;
    cursor = [ix, iy];
    const parts = [camera ? `column ${position(px, ix)}, row ${position(py, iy)}:` : `x ${metres(position(x, ix))}, y ${metres(position(y, iy))} m:`];
    parts.push(depth[i] === depth[i] ? `found ${metres(depth[i])} m at ${decibels(amplitude[i])}` : "no return");
    if (confidence && confidence[i] === confidence[i]) parts.push(`confidence ${fixed(confidence[i], 1)} dB`);
    if (truth) parts.push(truth[i] === truth[i] ? `true ${metres(truth[i])} m` : "no surface");
    if (error && error[i] === error[i]) parts.push(`error ${signed(1e3 * error[i], 1)} mm`);
    $("map-read").textContent = parts.join(" ").replace(": ", ": ").replaceAll(/ (confidence|true|no surface|error)/g, ", $1");
    for (const plot of plots) plot.mark(ix, iy);
    if (chosen && depth[i] === depth[i]) slices?.goTo(placed(loaded, ix, iy, depth[i]));
  };
  const shaded = $("shaded");
  const add = (title, note, map, low, high, values, ends, lit) => {
    const plot = new Plot($("map-plots"), {
      title, note, x: px, y: py, xLabel: camera ? "column / px" : "x / m", yLabel: camera ? "row / px" : "y / m", point,
      paint: (ix, iy) => {
        const i = iy * x.count + ix;
        const v = values()[i];
        const light = shaded.checked ? (lit?.()?.[i] ?? 255) / 255 : 1;
        return v === v ? colour(map, (v - low) / (high - low)).map((c) => c * light) : null;
      },
    });
    const strip = element("div", { className: "bar" });
    bar(strip, map, ends);
    plot.figure.append(strip);
    plot.refresh();
    plots.push(plot);
  };
  const ends = [`${metres(depths[0])} m`, "depth z", `${metres(depths[1])} m`];
  add("Found", "grey: no return", maps.viridis, ...depths, () => shown.depth, ends, () => shown.shading);
  if (truth) add("True", "grey: no surface", maps.viridis, ...depths, () => truth, ends, () => trueShading);
  $("shading").hidden = !shown.shading && !trueShading;
  const repaint = () => plots.forEach((plot) => plot.refresh());
  shaded.addEventListener("change", repaint);
  if (error) add("Error: found − true", "grey: not compared", maps.diverging, -limit / 1e3, limit / 1e3, () => shown.error, [`−${bound} mm`, "too near · too far", `+${bound} mm`]);
  $("returns").hidden = surfaces.length < 2;
  surfaces.forEach((surface, k) => {
    const radio = element("input", { type: "radio", name: "return", value: k, checked: k === 0 });
    radio.addEventListener("change", () => {
      shown = surface;
      repaint();
      if (cursor) point(...cursor);
      chose(surface);
    });
    $("returns").append(element("label", {}, radio, element("span", {}, surface.name)));
  });
  $("map-read").textContent = "Point at a map, or use the arrow keys on it, to read depths; click to move the slices there.";
  const reduced = loaded.reduced > 1 ? `The maps show every ${loaded.reduced}th pixel along x and y. ` : "";
  $("map-note").textContent = reduced + (truth ? "Found and true depth share their colours. Errors are relative to the nearest true surface of the pixel; errors beyond the ends of the bar have the last colour." : "There is no truth to compare with.");
}
