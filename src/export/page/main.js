// Assembles the page.

function trouble(text) {
  $("trouble").textContent = text;
  $("trouble").hidden = false;
}

async function layersOf(found, box) {
  const { points, truth_points: truthPoints } = data;
  const layer = (name, positions, more) => ({ name, positions, shown: true, ...more });
  const frame = { positions: boxLines(box.low, box.high), lines: true, tint: [0.62, 0.67, 0.75, 0.5], shown: true };
  const layers = [frame, layer("Planes of the slices", new Float32Array(), { lines: true, tint: [1, 1, 1, 0.75], shown: false })];
  const cell = Math.max(data.maps ? Math.min(data.maps.x.pitch, data.maps.y.pitch) : 0.01, 1e-4);
  const [name, scene] = points?.reflectors.shown ? ["Reflectors of the scene", points.reflectors] : ["True surfaces", truthPoints];
  if (scene?.shown) layers.push(layer(name, await floats(scene.data), { tint: [0.36, 0.83, 0.77, 0.55], size: 0.25 * cell, least: 1.4 }));
  if (found) layers.push(layer("Depths found", found.positions, { lit: found.lit, tint: [1, 1, 1, 0.95], byDepth: true, size: 0.7 * cell, least: 2.2, shown: false }));
  if (points?.microphones.shown)
    layers.push(layer("Microphones", await floats(points.microphones.data), { tint: [0.45, 0.68, 1, 0.9], size: 0.012, least: 2 }));
  if (points?.speaker) layers.push(layer("Speaker", new Float32Array(points.speaker), { tint: [1, 0.6, 0.2, 1], size: 0.04, least: 7 }));
  return layers;
}

// The corners of every layer's bounding box.
function around(layers) {
  return layers.filter((l) => l.positions.length).flatMap(({ positions }) => {
    const [low, high] = [[Infinity, Infinity, Infinity], [-Infinity, -Infinity, -Infinity]];
    positions.forEach((value, i) => {
      low[i % 3] = Math.min(low[i % 3], value);
      high[i % 3] = Math.max(high[i % 3], value);
    });
    return corners({ low, high });
  });
}

const boxOf = ({ x, y, z }) => ({ low: [x, y, z].map((a) => edges(a)[0]), high: [x, y, z].map((a) => edges(a)[1]) });

async function loadMaps() {
  if (!data.maps) return null;
  const loaded = { ...data.maps };
  for (const key of ["depth", "truth", "error", "confidence"]) if (loaded[key]) loaded[key] = await floats(loaded[key]);
  for (const key of ["amplitude", "shading", "true_shading"]) if (loaded[key]) loaded[key] = await bytes(loaded[key]);
  return loaded;
}

function range(...lists) {
  let [low, high] = [Infinity, -Infinity];
  for (const list of lists) for (const v of list ?? []) if (v === v) [low, high] = [Math.min(low, v), Math.max(high, v)];
  if (low > high) return [0, 1];
  return high - low > 1e-6 ? [low, high] : [low - 0.005, high + 0.005];
}

// The point of a map's pixel at a depth: the axes are in metres, or slopes if the rays start at the origin.
const placed = ({ x, y, view }, ix, iy, z) => [x, y].map((axis, k) => position(axis, [ix, iy][k]) * (view === "perspective" ? z : 1)).concat(z);

// The points of a depth map, and how bright each is drawn.
function cloud(loaded) {
  const list = [], lit = [];
  const { x, depth, shading } = loaded;
  depth.forEach((z, i) => {
    if (z !== z) return;
    list.push(...placed(loaded, i % x.count, Math.floor(i / x.count), z));
    lit.push(shading ? shading[i] / 255 : 1);
  });
  return { positions: new Float32Array(list), lit: new Float32Array(lit) };
}

// The controls next to the volume.
function control(view, slices) {
  const state = { maximum: 25, surface: 15, mode: "maximum" };
  const threshold = $("threshold");
  const apply = () => {
    state[state.mode] = -Number(threshold.value);
    const surface = state.mode === "surface";
    const share = 1 - state[state.mode] / data.range_db;
    const opacity = Number($("opacity").value);
    view?.draw(true);
    if (view) Object.assign(view.settings, { surface, threshold: share, opacity: opacity / 100, colours: $("colours").value });
    $("threshold-name").textContent = surface ? "Level" : "Threshold";
    $("threshold-value").textContent = `−${fixed(state[state.mode], 1)} dB`;
    $("opacity-value").textContent = `${opacity} %`;
    const [near, far] = view?.depths ?? [0, 1];
    if (surface) bar($("view-bar"), maps.viridis, [`${metres(near)} m`, "depth z", `${metres(far)} m`]);
    else bar($("view-bar"), maps[$("colours").value], [`−${fixed(state.maximum, 1)}`, "dB below the peak", "0"]);
    slices?.(1 - state.maximum / data.range_db, $("colours").value, state.maximum);
  };
  const mode = (name) => {
    state.mode = name;
    document.querySelector(`[name=mode][value=${name}]`).checked = true;
    [threshold.min, threshold.max, threshold.value] = [-data.range_db, -1, -state[name]];
    apply();
  };
  for (const radio of document.getElementsByName("mode")) radio.addEventListener("change", () => mode(radio.value));
  for (const id of ["threshold", "opacity", "colours"]) $(id).addEventListener("input", apply);
  mode("maximum");
  if (!view) return;
  for (const layer of view.layers.filter((l) => l.name)) {
    const box = element("input", { type: "checkbox", checked: layer.shown });
    box.addEventListener("change", () => ((layer.shown = box.checked), view.draw()));
    const dot = element("i");
    dot.style.background = layer.byDepth ? "linear-gradient(#fde725, #21918c, #440154)" : `rgb(${layer.tint.slice(0, 3).map((c) => 255 * c)})`;
    $("layers").append(element("label", {}, box, dot, layer.name));
  }
  const frame = (everything) => {
    $("frame").setAttribute("aria-pressed", everything);
    view.frame(everything);
  };
  const extent = (points) => Math.max(...points.map((p) => Math.hypot(...p.map((x, i) => x - points[0][i]))));
  frame(extent(corners(view.box)) > 0.65 * extent(view.whole));
  $("frame").addEventListener("click", () => frame($("frame").getAttribute("aria-pressed") !== "true"));
  for (const button of document.querySelectorAll("[data-view]")) button.addEventListener("click", () => view.look(button.dataset.view));
  $("labels").addEventListener("keydown", (e) => {
    const act = {
      ArrowLeft: () => view.turn(0.1, 0), ArrowRight: () => view.turn(-0.1, 0), ArrowUp: () => view.turn(0, 0.1), ArrowDown: () => view.turn(0, -0.1),
      "+": () => view.magnify(1.15), "=": () => view.magnify(1.15), "-": () => view.magnify(1 / 1.15),
      Home: () => (view.look("home"), frame($("frame").getAttribute("aria-pressed") === "true")),
      1: () => view.look("front"), 2: () => view.look("above"), 3: () => view.look("side"),
      m: () => mode(state.mode === "surface" ? "maximum" : "surface"), f: () => $("frame").click(),
    }[e.key.length === 1 ? e.key.toLowerCase() : e.key];
    if (!act || e.ctrlKey || e.metaKey || e.altKey) return;
    e.preventDefault();
    act();
  });
}

// Three orthogonal slices through one point; returns functions that repaint them and move the point.
function showSlices(volume, moved) {
  const { x, y, z, codes } = volume;
  const axes = [x, y, z];
  let best = 0;
  codes.forEach((code, i) => code > codes[best] && (best = i));
  const at = [best % x.count, Math.floor(best / x.count) % y.count, Math.floor(best / (x.count * y.count))];
  const look = { floor: 0, colours: "inferno" };
  const code = ([ix, iy, iz]) => codes[(iz * y.count + iy) * x.count + ix];
  const read = (voxel) => {
    const [a, b, c] = voxel.map((i, axis) => metres(position(axes[axis], i)));
    $("slice-read").textContent = `x ${a}, y ${b}, z ${c} m: ${decibels(code(voxel))}`;
  };
  const length = (axis) => edges(axis)[1] - edges(axis)[0];
  const plots = [];
  const sliders = [];
  const update = (next, repaint = true) => {
    next.forEach((i, axis) => (at[axis] = i));
    for (const { plot, across, along, normal } of plots) {
      plot.mark(at[across], at[along]);
      if (repaint) plot.refresh();
      sliders[normal].value = at[normal];
      const words = `${"xyz"[normal]} = ${metres(position(axes[normal], at[normal]))} m`;
      sliders[normal].setAttribute("aria-valuetext", words);
      plot.note.textContent = words;
    }
    moved(at.map((i, axis) => position(axes[axis], i)));
    read(at);
  };
  const choose = (axis, i) => update(at.map((old, a) => (a === axis ? i : old)));
  for (const [title, across, along, normal, upward] of [["From the front", 0, 1, 2, false], ["From above", 0, 2, 1, true], ["From the side", 2, 1, 0, false]]) {
    const voxel = (ix, iy) => {
      const v = [...at];
      [v[across], v[along]] = [ix, iy];
      return v;
    };
    const plot = new Plot($("slice-plots"), {
      title, tallest: length(y) / length(x), x: axes[across], y: axes[along], xLabel: `${"xyz"[across]} / m`, yLabel: `${"xyz"[along]} / m`, upward,
      paint: (ix, iy) => colour(maps[look.colours], (code(voxel(ix, iy)) / 255 - look.floor) / (1 - look.floor)),
      point: (ix, iy, chosen) => {
        if (chosen) return update(voxel(ix, iy));
        read(voxel(ix, iy));
      },
    });
    plots.push({ plot, across, along, normal });
    const slider = element("input", { type: "range", min: 0, max: axes[normal].count - 1, step: 1, id: `slice-${"xyz"[normal]}` });
    slider.setAttribute("aria-label", `${title}: position of the slice along ${"xyz"[normal]}`);
    slider.addEventListener("input", () => choose(normal, Number(slider.value)));
    sliders[normal] = slider;
    plot.figure.append(element("div", { className: "slider" }, slider));
  }
  return {
    repaint: (floor, colours, level) => {
      Object.assign(look, { floor, colours });
      bar($("slice-bar"), maps[colours], [`−${fixed(level, 1)} or less`, "dB below the peak", "0"]);
      update(at);
    },
    goTo: (p) => update(p.map((value, axis) => nearest(axes[axis], value))),
  };
}

function showMaps(loaded, depths, slices) {
  const { x, y, depth, truth, error, amplitude, confidence, shading, true_shading: trueShading } = loaded;
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
        const v = values[iy * x.count + ix];
        const light = lit && shaded.checked ? lit[iy * x.count + ix] / 255 : 1;
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
  add("Found", "grey: no return", maps.viridis, ...depths, depth, ends, shading);
  if (truth) add("True", "grey: no surface", maps.viridis, ...depths, truth, ends, trueShading);
  $("shading").hidden = !shading && !trueShading;
  shaded.addEventListener("change", () => plots.forEach((plot) => plot.refresh()));
  if (error) add("Error: found − true", "grey: not compared", maps.diverging, -limit / 1e3, limit / 1e3, error, [`−${bound} mm`, "too near · too far", `+${bound} mm`]);
  $("map-read").textContent = "Point at a map, or use the arrow keys on it, to read depths; click to move the slices there.";
  const reduced = loaded.reduced > 1 ? `The maps show every ${loaded.reduced}th pixel along x and y. ` : "";
  $("map-note").textContent = reduced + (truth ? "Found and true depth share their colours. Errors are relative to the nearest true surface of the pixel; errors beyond the ends of the bar have the last colour." : "There is no truth to compare with.");
}

function describe() {
  const parts = [];
  const { volume, points, truth_points: truthPoints } = data;
  if (volume) {
    parts.push(`On this page the volume is quantised to 8 bits: steps of ${fixed(data.range_db / 255, 2)} dB from −${data.range_db} to 0 dB, where 0 dB is the peak of ${Number(volume.peak.toPrecision(3))}; weaker values are not shown.`);
    const [fx, fy, fz] = volume.reduced;
    if (fx * fy * fz > 1) parts.push(`It is reduced from ${volume.voxels.join(" × ")} to ${[volume.x, volume.y, volume.z].map((a) => a.count).join(" × ")} voxels, each the maximum of ${fx} × ${fy} × ${fz}.`);
    parts.push("The files next to this page contain the exact numbers.");
  } else parts.push("The folder contains no volume; only maps and points are shown.");
  const share = (name, { shown, of }) => shown < of && parts.push(`${shown} of ${of} ${name} are drawn.`);
  if (points?.reflectors.of) share("reflectors", points.reflectors);
  else if (truthPoints?.shown) parts.push("The folder contains no reflectors; the true surfaces are drawn instead.");
  if (points) share("microphones", points.microphones);
  $("volume-note").textContent = parts.join(" ");
}

async function main() {
  showNumbers();
  for (const [name, text] of Object.entries(data.colours)) maps[name] = await bytes(text);
  const volume = data.volume && { ...data.volume, codes: await bytes(data.volume.data) };
  const loaded = await loadMaps();
  describe();
  const depths = loaded ? range(loaded.truth?.some((z) => z === z) ? loaded.truth : loaded.depth) : volume ? edges(volume.z) : [0, 1];
  let slices = null, view = null;
  const planes = (point) => view?.replace(view.layers[1], sliceLines(view.box.low, view.box.high, point));
  if (volume) slices = showSlices(volume, planes);
  else $("slices").hidden = true;
  if (loaded) showMaps(loaded, depths, slices);
  else $("maps").hidden = true;
  const far = loaded?.view === "perspective" ? depths[1] : 1;
  const width = (axis) => ({ first: axis.first * far, pitch: axis.pitch * far, count: axis.count });
  const { x, y } = loaded ?? { x: { first: 0, pitch: 1, count: 1 }, y: { first: 0, pitch: 1, count: 1 } };
  const box = volume ? boxOf(volume) : boxOf({ x: width(x), y: width(y), z: { first: depths[0], pitch: depths[1] - depths[0], count: 1 } });
  try {
    const layers = await layersOf(loaded && cloud(loaded), box);
    view = new View($("scene"), $("labels"), box, around(layers), volume, layers, depths);
  } catch (error) {
    trouble(`The 3-D view cannot be drawn here (${error.message}); the slices below show the same volume.`);
  }
  control(view, slices?.repaint);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => Plot.all.forEach((plot) => plot.draw()));
  document.documentElement.dataset.ready = "true";
}

main().catch((error) => {
  trouble(`This page cannot be shown: ${error.message}. A browser of 2023 or later is needed.`);
  console.error(error);
});
