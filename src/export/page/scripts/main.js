// Assembles the page.

function trouble(text) {
  $("trouble").textContent = text;
  $("trouble").hidden = false;
}

function range(...lists) {
  let [low, high] = [Infinity, -Infinity];
  for (const list of lists) for (const v of list ?? []) if (v === v) [low, high] = [Math.min(low, v), Math.max(high, v)];
  if (low > high) return [0, 1];
  return high - low > 1e-6 ? [low, high] : [low - 0.005, high + 0.005];
}

function describe() {
  const parts = [];
  const { volume, points, truth_points: truthPoints, mesh } = data;
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
  if (points?.bounces) share("of the strongest bounced echoes", points.bounces);
  const drawn = mesh?.parts.reduce((sum, part) => sum + part.triangles, 0);
  if (drawn < report.scene?.triangles) parts.push(`The mesh is drawn with ${drawn} of its ${report.scene.triangles} triangles: corners that are close to one another are merged.`);
  $("volume-note").textContent = parts.join(" ");
}

async function main() {
  showNumbers();
  for (const [name, text] of Object.entries(data.colours)) maps[name] = await bytes(text);
  const volume = data.volume && { ...data.volume, codes: await bytes(data.volume.data) };
  const loaded = await loadMaps();
  describe();
  const depths = loaded ? range(loaded.truth?.some((z) => z === z) ? loaded.truth : loaded.surfaces[0].depth) : volume ? edges(volume.z) : [0, 1];
  let view = null, section = null, named = {};
  const slices = volume && showSlices(volume, (point, voxel) => {
    view?.replace(named.slices, sliceLines(view.box, point));
    section?.follow(voxel);
  });
  if (!volume) $("slices").hidden = true;
  if (loaded)
    showMaps(loaded, depths, slices, (surface) => {
      const { positions, lit } = cloud(loaded, surface);
      view?.replace(named.found, positions, lit);
    });
  else $("maps").hidden = true;
  const far = loaded?.view === "perspective" ? depths[1] : 1;
  const width = (axis) => ({ first: axis.first * far, pitch: axis.pitch * far, count: axis.count });
  const { x, y } = loaded ?? { x: { first: 0, pitch: 1, count: 1 }, y: { first: 0, pitch: 1, count: 1 } };
  const box = volume ? boxOf(volume) : boxOf({ x: width(x), y: width(y), z: { first: depths[0], pitch: depths[1] - depths[0], count: 1 } });
  try {
    const made = await layersOf(loaded && cloud(loaded, loaded.surfaces[0]), box);
    named = made.named;
    view = new View($("scene"), $("labels"), box, around(made.layers), volume, made.layers, depths);
    section = sectionControl(view, named.section, volume, slices);
  } catch (error) {
    $("section").disabled = true;
    trouble(`The 3-D view cannot be drawn here (${error.message}); the slices below show the same volume.`);
  }
  control(view, slices?.repaint, section);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => Plot.all.forEach((plot) => plot.draw()));
  document.documentElement.dataset.ready = "true";
}

main().catch((error) => {
  trouble(`This page cannot be shown: ${error.message}. A browser of 2023 or later is needed.`);
  console.error(error);
});
