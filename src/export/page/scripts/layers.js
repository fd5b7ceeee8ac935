// What is drawn over the volume: points, lines and the scene's mesh.

// The colours of the mesh's parts, in turn.
const PARTS = [[0.74, 0.72, 0.68], [0.55, 0.71, 0.85], [0.87, 0.65, 0.45], [0.6, 0.76, 0.58], [0.8, 0.63, 0.75], [0.85, 0.8, 0.5], [0.5, 0.75, 0.75], [0.78, 0.55, 0.52]];

// More parts than this have one layer for all but the largest.
const MOST_PARTS = 12;

async function layersOf(found, box) {
  const { points, truth_points: truthPoints } = data;
  const layer = (name, positions, more) => ({ name, positions, shown: true, cut: true, ...more });
  const lines = (tint, more) => ({ positions: new Float32Array(), kind: "lines", tint, shown: false, ...more });
  const named = {
    frame: lines([0.62, 0.67, 0.75, 0.5], { positions: boxLines(box), shown: true }),
    section: lines([1, 0.75, 0.35, 0.9]),
    slices: lines([1, 1, 1, 0.75], { name: "Planes of the slices" }),
  };
  const layers = [named.frame, named.section, ...(data.volume ? [named.slices] : [])];
  const cell = Math.max(data.maps ? Math.min(data.maps.x.pitch, data.maps.y.pitch) : 0.01, 1e-4);
  const [name, scene] = points?.reflectors.shown ? ["Reflectors of the scene", points.reflectors] : ["True surfaces", truthPoints];
  if (scene?.shown) layers.push(layer(name, await floats(scene.data), { tint: [0.36, 0.83, 0.77, 0.55], size: 0.25 * cell, least: 1.4 }));
  if (points?.bounces?.shown)
    layers.push(layer("Multipath, where it is seen", await floats(points.bounces.data), { tint: [0.95, 0.4, 0.75, 0.45], size: 0.25 * cell, least: 1.4 }));
  if (found) layers.push((named.found = layer("Depths found", found.positions, { lit: found.lit, tint: [1, 1, 1, 0.95], byDepth: true, size: 0.7 * cell, least: 2.2, shown: false })));
  const ofArray = { cut: false, ofArray: true };
  if (points?.microphones.shown)
    layers.push(layer("Microphones", await floats(points.microphones.data), { ...ofArray, tint: [0.45, 0.68, 1, 0.9], size: 0.012, least: 2 }));
  if (points?.speaker) layers.push(layer("Speaker", new Float32Array(points.speaker), { ...ofArray, tint: [1, 0.6, 0.2, 1], size: 0.04, least: 7 }));
  for (const [k, { name, positions }] of (await parts()).entries())
    layers.push(layer(name, positions, { kind: "solid", tint: [...PARTS[k % PARTS.length], 0.7], shown: false }));
  return { layers, named };
}

// The names of the mesh's parts, and the corners of their triangles, m.
async function parts() {
  const { mesh } = data;
  if (!mesh) return [];
  const { low, high } = mesh;
  const shares = new Uint16Array(await unpack(mesh.vertices));
  const vertices = Float32Array.from(shares, (share, i) => low[i % 3] + (share / 65535) * (high[i % 3] - low[i % 3]));
  const corners = new Uint32Array(await unpack(mesh.triangles));
  const runs = [];
  let first = 0;
  for (const { name, triangles } of mesh.parts) {
    if (triangles) runs.push({ name, corners: corners.subarray(3 * first, 3 * (first + triangles)) });
    first += triangles;
  }
  runs.sort((a, b) => b.corners.length - a.corners.length);
  const rest = runs.length > MOST_PARTS ? runs.splice(MOST_PARTS - 1) : [];
  if (rest.length) runs.push({ name: `${rest.length} smaller parts`, corners: Uint32Array.from(rest.flatMap((run) => [...run.corners])) });
  return runs.map(({ name, corners }) => {
    const positions = new Float32Array(3 * corners.length);
    corners.forEach((vertex, i) => positions.set(vertices.subarray(3 * vertex, 3 * vertex + 3), 3 * i));
    return { name: runs.length > 1 || name ? `Mesh: ${name || "unnamed"}` : "Mesh", positions };
  });
}

// The corners of the bounding box of every layer but the mesh, which may reach far beyond what is imaged.
function around(layers) {
  return layers.filter((l) => l.positions.length && l.kind !== "solid").flatMap(({ positions }) => {
    const [low, high] = [[Infinity, Infinity, Infinity], [-Infinity, -Infinity, -Infinity]];
    positions.forEach((value, i) => {
      low[i % 3] = Math.min(low[i % 3], value);
      high[i % 3] = Math.max(high[i % 3], value);
    });
    return corners({ low, high });
  });
}

const boxOf = ({ x, y, z }) => ({ low: [x, y, z].map((a) => edges(a)[0]), high: [x, y, z].map((a) => edges(a)[1]) });

// The points of a map's surface, and how bright each is drawn.
function cloud(loaded, { depth, shading }) {
  const list = [], lit = [];
  const { x } = loaded;
  depth.forEach((z, i) => {
    if (z !== z) return;
    list.push(...placed(loaded, i % x.count, Math.floor(i / x.count), z));
    lit.push(shading ? shading[i] / 255 : 1);
  });
  return { positions: new Float32Array(list), lit: new Float32Array(lit) };
}
