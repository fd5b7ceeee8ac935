// The volume in three dimensions: rays through a texture in WebGL2, points and lines over it, labels on a canvas above.

function shader(gl, vertex, fragment) {
  const program = gl.createProgram();
  for (const [kind, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const part = gl.createShader(kind);
    gl.shaderSource(part, source);
    gl.compileShader(part);
    if (!gl.getShaderParameter(part, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(part));
    gl.attachShader(program, part);
  }
  gl.bindAttribLocation(program, 0, "position");
  gl.bindAttribLocation(program, 1, "lit");
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
  const at = {};
  for (let i = 0; i < gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS); i++) {
    const { name } = gl.getActiveUniform(program, i);
    at[name] = gl.getUniformLocation(program, name);
  }
  return { program, at };
}

const VIEWS = { home: [0.62, 0.42], front: [0, 0], above: [0, 1.5707], side: [-1.5707, 0] };

// `box` is { low, high } in m, `whole` the corners of everything; `layers` are { positions, lit, lines, tint, size, byDepth, shown }.
class View {
  constructor(canvas, labels, box, whole, volume, layers, depths) {
    Object.assign(this, { canvas, labels, box, whole, volume, layers, depths });
    const gl = (this.gl = canvas.getContext("webgl2", { antialias: true, premultipliedAlpha: true, alpha: true }));
    if (!gl) throw new Error("no WebGL 2");
    this.pen = labels.getContext("2d");
    this.rays = shader(gl, SHADERS.rays, SHADERS.volume);
    this.marks = shader(gl, SHADERS.points, SHADERS.marks);
    this.settings = { surface: false, threshold: 0.4, opacity: 1, colours: "inferno" };
    this.fine = 1; // share of the full resolution while things move
    for (const layer of layers) {
      layer.buffer = this.upload(layer.positions);
      if (layer.lit) layer.light = this.upload(layer.lit);
    }
    this.textures = {};
    for (const [name, map] of Object.entries(maps)) this.textures[name] = this.texture2d(map);
    if (volume) this.texture3d(volume);
    this.look("home");
    this.frame(false);
    this.listen();
    new ResizeObserver(() => ((this.distance = null), this.draw())).observe(canvas.parentElement);
    canvas.addEventListener("webglcontextlost", () => trouble("The graphics processor stopped; reload the page."));
  }

  upload(positions, buffer = this.gl.createBuffer()) {
    const { gl } = this;
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
    gl.bufferData(gl.ARRAY_BUFFER, positions, gl.STATIC_DRAW);
    return buffer;
  }

  replace(layer, positions) {
    layer.positions = positions;
    layer.buffer = this.upload(positions, layer.buffer);
    if (layer.shown) this.draw();
  }

  texture2d(map) {
    const { gl } = this;
    const texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB8, 256, 1, 0, gl.RGB, gl.UNSIGNED_BYTE, map);
    for (const [key, value] of [["MIN_FILTER", gl.LINEAR], ["MAG_FILTER", gl.LINEAR], ["WRAP_S", gl.CLAMP_TO_EDGE], ["WRAP_T", gl.CLAMP_TO_EDGE]])
      gl.texParameteri(gl.TEXTURE_2D, gl[`TEXTURE_${key}`], value);
    return texture;
  }

  texture3d({ codes, x, y, z }) {
    const { gl } = this;
    gl.bindTexture(gl.TEXTURE_3D, gl.createTexture());
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    gl.texImage3D(gl.TEXTURE_3D, 0, gl.R8, x.count, y.count, z.count, 0, gl.RED, gl.UNSIGNED_BYTE, codes);
    for (const key of ["MIN_FILTER", "MAG_FILTER"]) gl.texParameteri(gl.TEXTURE_3D, gl[`TEXTURE_${key}`], gl.LINEAR);
    for (const key of "STR") gl.texParameteri(gl.TEXTURE_3D, gl[`TEXTURE_WRAP_${key}`], gl.CLAMP_TO_EDGE);
  }

  look(name) {
    [this.yaw, this.pitch] = VIEWS[name];
    this.distance = null;
    this.draw();
  }

  // Centres the volume, or everything.
  frame(everything) {
    this.framed = everything ? this.whole : corners(this.box);
    const ends = (pick) => [0, 1, 2].map((i) => pick(...this.framed.map((p) => p[i])));
    const [low, high] = [ends(Math.min), ends(Math.max)];
    this.centre = low.map((a, i) => (a + high[i]) / 2);
    this.radius = Math.hypot(...low.map((a, i) => high[i] - a)) / 2 || 1;
    this.zoom = 1;
    this.distance = null;
    this.draw();
  }

  turn(yaw, pitch) {
    this.yaw += yaw;
    this.pitch = Math.min(1.5707, Math.max(-1.5707, this.pitch + pitch));
    this.draw(true);
  }

  magnify(factor) {
    this.zoom = Math.min(20, Math.max(0.2, this.zoom * factor));
    this.draw(true);
  }

  listen() {
    const pointers = new Map();
    const { labels } = this;
    labels.addEventListener("pointerdown", (e) => {
      labels.setPointerCapture(e.pointerId);
      pointers.set(e.pointerId, e);
    });
    labels.addEventListener("pointermove", (e) => {
      const before = pointers.get(e.pointerId);
      if (!before) return;
      if (pointers.size === 1) {
        this.turn(-(e.clientX - before.clientX) * 0.008, (e.clientY - before.clientY) * 0.008);
      } else {
        const other = [...pointers.values()].find((p) => p.pointerId !== e.pointerId);
        const span = (p) => Math.hypot(p.clientX - other.clientX, p.clientY - other.clientY);
        this.magnify(span(e) / Math.max(1, span(before)));
      }
      pointers.set(e.pointerId, e);
    });
    for (const end of ["pointerup", "pointercancel"]) labels.addEventListener(end, (e) => pointers.delete(e.pointerId));
    labels.addEventListener("wheel", (e) => {
      // The wheel scrolls the page until the view has been clicked; pinching on a touchpad sets ctrl.
      if (document.activeElement !== labels && !e.ctrlKey) return;
      e.preventDefault();
      this.magnify(Math.exp(-e.deltaY * 0.0015));
    }, { passive: false });
  }

  // Draws at the next frame: coarsely while the view moves, finely when it stops.
  draw(moving = false) {
    clearTimeout(this.rest);
    this.moving = moving;
    if (moving) this.rest = setTimeout(() => this.draw(), 160);
    this.pending ??= requestAnimationFrame((now) => {
      this.pending = null;
      if (this.moving && this.last) this.fine = Math.min(1, Math.max(0.3, this.fine * (now - this.last > 45 ? 0.8 : 1.08)));
      this.last = this.moving ? now : null;
      this.paint();
    });
  }

  camera(aspect) {
    const [c, s, C, S] = [Math.cos(this.yaw), Math.sin(this.yaw), Math.cos(this.pitch), Math.sin(this.pitch)];
    const forward = [s * C, S, c * C], right = [c, 0, -s], down = [-s * S, C, -c * S];
    const half = Math.tan(0.26); // of the lesser side's field of view
    const [w, h] = aspect > 1 ? [half * aspect, half] : [half, half / aspect];
    // While it is turned the picture may shrink, so that nothing is clipped, but not grow.
    if (this.zoom === 1) this.distance = Math.max(this.distance ?? 0, this.fit({ forward, right, down }, w, h));
    this.distance ??= 3 * this.radius;
    const distance = this.distance / this.zoom;
    const eye = this.centre.map((m, i) => m - distance * forward[i]);
    const near = distance / 200, far = distance * 4 + 4 * this.radius;
    const terms = [(far + near) / (far - near), (-2 * far * near) / (far - near)];
    const row = (v, f) => [...v.map((x) => x * f), -f * v.reduce((sum, x, i) => sum + x * eye[i], 0)];
    const [X, Y, Z] = [row(right, 1 / w), row(down, -1 / h), row(forward, 1)];
    const matrix = [0, 1, 2, 3].flatMap((i) => [X[i], Y[i], Z[i] * terms[0] + (i === 3 ? terms[1] : 0), Z[i]]);
    return { eye, forward, right: right.map((x) => x * w), down: down.map((x) => x * h), terms, matrix, distance, half };
  }

  // The distance at which everything framed fits into the picture, with space for the labels.
  fit({ forward, right, down }, w, h) {
    const away = (p, axis) => p.reduce((sum, x, i) => sum + (x - this.centre[i]) * axis[i], 0);
    const reach = (p) => Math.max(Math.abs(away(p, right)) / w, Math.abs(away(p, down)) / h) / 0.84 - away(p, forward);
    return Math.max(...this.framed.map(reach));
  }

  paint() {
    const { gl, canvas, settings } = this;
    const ratio = Math.min(2, devicePixelRatio || 1) * (this.moving ? this.fine : 1);
    const [w, h] = [canvas.clientWidth, canvas.clientHeight];
    if (!w || !h) return;
    const [width, height] = [Math.round(w * ratio), Math.round(h * ratio)];
    if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
    const camera = this.camera(w / h);
    gl.viewport(0, 0, width, height);
    gl.clearColor(0, 0, 0, 0);
    gl.enable(gl.DEPTH_TEST);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    if (this.volume) this.paintVolume(camera);
    this.paintLayers(camera, height);
    this.write(camera, w, h);
    document.documentElement.dataset.drawn = Number(document.documentElement.dataset.drawn ?? 0) + 1;
  }

  paintVolume(camera) {
    const { gl, rays: { program, at }, box, volume, settings } = this;
    gl.useProgram(program);
    gl.depthMask(true);
    gl.depthFunc(gl.LEQUAL);
    for (const key of ["eye", "right", "down", "forward"]) gl.uniform3fv(at[key], camera[key]);
    gl.uniform3fv(at.low, box.low);
    gl.uniform3fv(at.size, box.low.map((a, i) => box.high[i] - a));
    gl.uniform3fv(at.voxels, [volume.x.count, volume.y.count, volume.z.count]);
    gl.uniform2fv(at.depthTerms, camera.terms);
    gl.uniform2fv(at.nearFar, this.depths);
    gl.uniform1f(at.threshold, settings.threshold);
    gl.uniform1f(at.opacity, settings.opacity);
    gl.uniform1f(at.rate, this.moving ? 0.9 : 1.8);
    gl.uniform1i(at.surface, settings.surface);
    gl.uniform1i(at.volume, 0);
    gl.uniform1i(at.colours, 1);
    gl.activeTexture(gl.TEXTURE1);
    gl.bindTexture(gl.TEXTURE_2D, this.textures[settings.surface ? "viridis" : settings.colours]);
    gl.activeTexture(gl.TEXTURE0);
    gl.disableVertexAttribArray(0);
    gl.disableVertexAttribArray(1);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  paintLayers(camera, height) {
    const { gl, marks: { program, at } } = this;
    gl.useProgram(program);
    gl.depthMask(false);
    gl.uniformMatrix4fv(at.matrix, false, camera.matrix);
    gl.uniform2fv(at.nearFar, this.depths);
    gl.uniform1i(at.colours, 1);
    gl.activeTexture(gl.TEXTURE1);
    gl.bindTexture(gl.TEXTURE_2D, this.textures.viridis);
    gl.enableVertexAttribArray(0);
    const ratio = this.canvas.width / this.canvas.clientWidth;
    for (const layer of this.layers.filter((l) => l.shown && l.positions.length)) {
      gl.bindBuffer(gl.ARRAY_BUFFER, layer.buffer);
      gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 0, 0);
      if (layer.light) {
        gl.bindBuffer(gl.ARRAY_BUFFER, layer.light);
        gl.enableVertexAttribArray(1);
        gl.vertexAttribPointer(1, 1, gl.FLOAT, false, 0, 0);
      } else {
        gl.disableVertexAttribArray(1);
        gl.vertexAttrib1f(1, 1);
      }
      gl.uniform4fv(at.tint, layer.tint);
      gl.uniform1i(at.byDepth, layer.byDepth ?? false);
      gl.uniform1i(at.round, !layer.lines);
      gl.uniform1f(at.pointSize, ((layer.size ?? 0) * height) / 2 / camera.half);
      gl.uniform1f(at.least, (layer.least ?? 1.5) * ratio);
      gl.drawArrays(layer.lines ? gl.LINES : gl.POINTS, 0, layer.positions.length / 3);
    }
  }

  // Ticks and names of the axes, on the outermost edges of the box.
  write(camera, w, h) {
    const { pen, labels, box: { low, high } } = this;
    const ratio = devicePixelRatio || 1;
    [labels.width, labels.height] = [Math.round(w * ratio), Math.round(h * ratio)];
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.font = "12px system-ui, sans-serif";
    pen.textAlign = "center";
    pen.textBaseline = "middle";
    const halo = (text, x, y) => {
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
      pen.fillStyle = pen.strokeStyle = "#b9c0cb";
      for (const { value, text } of ticks(low[axis], high[axis], Math.max(3, Math.min(7, Math.floor(length / 42))))) {
        const [x, y] = project(edge.corner.map((c, i) => (i === axis ? value : c)));
        pen.beginPath();
        pen.moveTo(x, y);
        pen.lineTo(x + 5 * out[0], y + 5 * out[1]);
        pen.stroke();
        halo(text, x + 20 * out[0], y + 14 * out[1]);
      }
      pen.fillStyle = "#f0f2f5";
      halo(`${"xyz"[axis]} / m`, edge.x + 58 * out[0], edge.y + 34 * out[1]);
    }
  }
}

// The frames of three slices through a point of a box.
function sliceLines(low, high, point) {
  const lines = [];
  for (const normal of [0, 1, 2]) {
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
function boxLines(low, high) {
  const lines = [];
  for (const axis of [0, 1, 2])
    for (let k = 0; k < 4; k++) {
      const others = [0, 1, 2].filter((i) => i !== axis);
      const at = (end) => [0, 1, 2].map((i) => (i === axis ? end[i] : (k >> others.indexOf(i)) & 1 ? high[i] : low[i]));
      lines.push(...at(low), ...at(high));
    }
  return new Float32Array(lines);
}
