// The box of the volume: its edges as lines, and its labels on a canvas.

// Ticks and names of the axes, on the outermost edges of the box.
function writeAxes({ pen, labels, box: { low, high } }, camera, w, h) {
  const ratio = devicePixelRatio || 1;
  [labels.width, labels.height] = [Math.round(w * ratio), Math.round(h * ratio)];
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.font = "12px system-ui, sans-serif";
  pen.textAlign = "center";
  pen.textBaseline = "middle";
  const taken = [];
  // Writes a word unless it would cover another one.
  const halo = (text, x, y) => {
    const half = pen.measureText(text).width / 2 + 2;
    if (taken.some((other) => Math.abs(other.x - x) < other.half + half && Math.abs(other.y - y) < 13)) return;
    taken.push({ x, y, half });
    pen.save();
    pen.strokeStyle = "#0d0f14";
    pen.lineWidth = 3;
    pen.strokeText(text, x, y);
    pen.fillText(text, x, y);
    pen.restore();
  };
  const project = (p) => {
    const m = camera.matrix;
    const [x, y, q] = [0, 1, 3].map((r) => m[r] * p[0] + m[r + 4] * p[1] + m[r + 8] * p[2] + m[r + 12]);
    return [((x / q + 1) * w) / 2, ((1 - y / q) * h) / 2];
  };
  const middle = project(low.map((a, i) => (a + high[i]) / 2));
  const chosen = [];
  for (const axis of [0, 1, 2]) {
    const others = [0, 1, 2].filter((i) => i !== axis);
    // Of the four edges along this axis, the lowest one of the silhouette, with one visible and one hidden face.
    const candidates = [0, 1, 2, 3].map((k) => {
      const corner = [0, 0, 0];
      others.forEach((o, i) => (corner[o] = (k >> i) & 1 ? high[o] : low[o]));
      const seen = others.filter((o, i) => ((k >> i) & 1 ? camera.eye[o] > high[o] : camera.eye[o] < low[o])).length;
      const at = corner.slice();
      at[axis] = (low[axis] + high[axis]) / 2;
      const [x, y] = project(at);
      return { corner, seen, rank: y + 0.2 * x, x, y };
    });
    const edge = candidates.filter((c) => c.seen === 1).sort((a, b) => b.rank - a.rank)[0] ?? candidates[3];
    const ends = [low, high].map((end) => project(edge.corner.map((c, i) => (i === axis ? end[i] : c))));
    const length = Math.hypot(ends[1][0] - ends[0][0], ends[1][1] - ends[0][1]);
    if (length < 24) continue;
    // Outwards: across the edge, away from the middle of the box.
    let out = [-(ends[1][1] - ends[0][1]) / length, (ends[1][0] - ends[0][0]) / length];
    if (out[0] * (edge.x - middle[0]) + out[1] * (edge.y - middle[1]) < 0) out = out.map((x) => -x);
    pen.fillStyle = "#f0f2f5";
    halo(`${"xyz"[axis]} / m`, edge.x + 58 * out[0], edge.y + 34 * out[1]);
    chosen.push({ axis, edge, length, out });
  }
  pen.fillStyle = pen.strokeStyle = "#b9c0cb";
  for (const { axis, edge, length, out } of chosen) {
    for (const { value, text } of ticks(low[axis], high[axis], Math.max(3, Math.min(7, Math.floor(length / 42))))) {
      const [x, y] = project(edge.corner.map((c, i) => (i === axis ? value : c)));
      pen.beginPath();
      pen.moveTo(x, y);
      pen.lineTo(x + 5 * out[0], y + 5 * out[1]);
      pen.stroke();
      halo(text, x + 20 * out[0], y + 14 * out[1]);
    }
  }
}

// The frames of slices through a point of a box, of all three or of those with these normals.
function sliceLines({ low, high }, point, normals = [0, 1, 2]) {
  const lines = [];
  for (const normal of normals) {
    const [a, b] = [0, 1, 2].filter((i) => i !== normal);
    const at = (u, v) => {
      const p = [...point];
      [p[a], p[b]] = [u, v];
      return p;
    };
    const corners = [at(low[a], low[b]), at(high[a], low[b]), at(high[a], high[b]), at(low[a], high[b])];
    corners.forEach((corner, i) => lines.push(...corner, ...corners[(i + 1) % 4]));
  }
  return new Float32Array(lines);
}

const corners = ({ low, high }) => Array.from({ length: 8 }, (_, k) => low.map((a, i) => ((k >> i) & 1 ? high[i] : a)));

// The twelve edges of a box, as a list of lines.
function boxLines({ low, high }) {
  const lines = [];
  for (const axis of [0, 1, 2])
    for (let k = 0; k < 4; k++) {
      const others = [0, 1, 2].filter((i) => i !== axis);
      const at = (end) => [0, 1, 2].map((i) => (i === axis ? end[i] : (k >> others.indexOf(i)) & 1 ? high[i] : low[i]));
      lines.push(...at(low), ...at(high));
    }
  return new Float32Array(lines);
}
