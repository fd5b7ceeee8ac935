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

// Rays skip runs of eight samples of which the maximum of a block of voxels says that they are of no use. A block has BLOCK
// voxels along an edge; a run that is centred in it reads voxels up to REACH outside, at the lesser rate.
const [BLOCK, REACH] = [4, 5];
// Samples per voxel while the view moves, and when it is at rest.
const [MOVING, RESTING] = [0.9, 1.8];

// A view this close to that from the front, as a cosine, has the array between the eye and the scene.
const FRONTAL = 0.9;

// Nothing is cut away.
const WHOLE = [0, 0, 0, -1];

// `box` is { low, high } in m, `whole` the corners of everything; `layers` are { positions, lit, kind, tint, size, byDepth,
// shown, cut, ofArray }, of which `kind` is points (the default), lines or solid, `cut` says whether a section cuts it, and
// those `ofArray` are hidden in the view from the front, and where the volume alone is framed, unless the user has `chosen`
// otherwise.
class View {
  constructor(canvas, labels, box, whole, volume, layers, depths) {
    Object.assign(this, { canvas, labels, box, whole, volume, layers, depths });
    const gl = (this.gl = canvas.getContext("webgl2", { antialias: true, premultipliedAlpha: true, alpha: true }));
    if (!gl) throw new Error("no WebGL 2");
    this.pen = labels.getContext("2d");
    this.rays = shader(gl, SHADERS.rays, SHADERS.volume);
    this.marks = shader(gl, SHADERS.points, SHADERS.marks);
    this.settings = { surface: false, threshold: 0.4, opacity: 1, colours: "inferno", section: WHOLE };
    this.fine = 1; // share of the full resolution while things move
    for (const layer of layers) {
      layer.buffer = this.upload(layer.positions);
      if (layer.lit) layer.light = this.upload(layer.lit);
    }
    this.textures = {};
    for (const [name, map] of Object.entries(maps)) this.textures[name] = this.texture2d(map);
    if (volume) {
      this.textures.volume = this.texture3d(volume.codes, [volume.x, volume.y, volume.z].map((axis) => axis.count), gl.LINEAR);
      this.textures.bounds = this.texture3d(...blockMaxima(volume), gl.NEAREST);
    }
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

  replace(layer, positions, lit) {
    layer.positions = positions;
    layer.buffer = this.upload(positions, layer.buffer);
    if (lit) layer.light = this.upload(lit, layer.light);
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

  texture3d(codes, counts, filter) {
    const { gl } = this;
    const texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_3D, texture);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    gl.texImage3D(gl.TEXTURE_3D, 0, gl.R8, ...counts, 0, gl.RED, gl.UNSIGNED_BYTE, codes);
    for (const key of ["MIN_FILTER", "MAG_FILTER"]) gl.texParameteri(gl.TEXTURE_3D, gl[`TEXTURE_${key}`], filter);
    for (const key of "STR") gl.texParameteri(gl.TEXTURE_3D, gl[`TEXTURE_WRAP_${key}`], gl.CLAMP_TO_EDGE);
    return texture;
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
    const upperLeft = forward.map((x, i) => -x - 0.35 * down[i] - 0.25 * right[i]);
    const light = upperLeft.map((x) => x / Math.hypot(...upperLeft));
    return { eye, forward, right: right.map((x) => x * w), down: down.map((x) => x * h), terms, matrix, distance, half, light };
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
    gl.depthFunc(gl.LEQUAL);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    if (this.volume) this.paintVolume(camera);
    this.paintLayers(camera, height);
    writeAxes(this, camera, w, h);
    document.documentElement.dataset.drawn = Number(document.documentElement.dataset.drawn ?? 0) + 1;
  }

  paintVolume(camera) {
    const { gl, rays: { program, at }, box, volume, settings } = this;
    gl.useProgram(program);
    gl.depthMask(true);
    for (const key of ["eye", "right", "down", "forward"]) gl.uniform3fv(at[key], camera[key]);
    gl.uniform3fv(at.low, box.low);
    gl.uniform3fv(at.size, box.low.map((a, i) => box.high[i] - a));
    gl.uniform3fv(at.voxels, [volume.x.count, volume.y.count, volume.z.count]);
    gl.uniform2fv(at.depthTerms, camera.terms);
    gl.uniform2fv(at.nearFar, this.depths);
    gl.uniform1f(at.threshold, settings.threshold);
    gl.uniform1f(at.opacity, settings.opacity);
    gl.uniform1f(at.rate, this.moving ? MOVING : RESTING);
    gl.uniform1i(at.surface, settings.surface);
    gl.uniform4fv(at.section, settings.section);
    const { textures } = this;
    const bound = [["volume", gl.TEXTURE_3D, textures.volume], ["bounds", gl.TEXTURE_3D, textures.bounds], ["colours", gl.TEXTURE_2D, textures[settings.surface ? "viridis" : settings.colours]]];
    bound.forEach(([name, kind, texture], unit) => {
      gl.uniform1i(at[name], unit);
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(kind, texture);
    });
    gl.disableVertexAttribArray(0);
    gl.disableVertexAttribArray(1);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  paintLayers(camera, height) {
    const { gl, settings, marks: { program, at } } = this;
    gl.useProgram(program);
    gl.uniformMatrix4fv(at.matrix, false, camera.matrix);
    gl.uniform2fv(at.nearFar, this.depths);
    gl.uniform3fv(at.towards, camera.light);
    gl.uniform1i(at.colours, 0);
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, this.textures.viridis);
    gl.enableVertexAttribArray(0);
    const ratio = this.canvas.width / this.canvas.clientWidth;
    for (const layer of this.layers) {
      if (layer.ofArray && !layer.chosen) layer.shown = this.framed === this.whole && camera.forward[2] < FRONTAL;
      if (layer.check) layer.check.checked = layer.shown;
    }
    const drawn = this.layers.filter((l) => l.shown && l.positions.length);
    const solids = drawn.filter((l) => l.kind === "solid");
    const draw = (layer) => {
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
      const { kind = "points" } = layer;
      gl.uniform4fv(at.tint, layer.tint);
      gl.uniform4fv(at.section, layer.cut ? settings.section : WHOLE);
      gl.uniform1i(at.byDepth, layer.byDepth ?? false);
      gl.uniform1i(at.round, kind === "points");
      gl.uniform1i(at.solid, kind === "solid");
      gl.uniform1f(at.pointSize, ((layer.size ?? 0) * height) / 2 / camera.half);
      gl.uniform1f(at.least, (layer.least ?? 1.5) * ratio);
      gl.drawArrays({ points: gl.POINTS, lines: gl.LINES, solid: gl.TRIANGLES }[kind], 0, layer.positions.length / 3);
    };
    // Of solids, which are translucent, only what is in front: their depths first, then their colours.
    gl.depthMask(true);
    gl.colorMask(false, false, false, false);
    solids.forEach(draw);
    gl.colorMask(true, true, true, true);
    gl.depthMask(false);
    solids.forEach(draw);
    drawn.filter((l) => l.kind !== "solid").forEach(draw);
  }
}

// The maximum of each block of voxels and of those within its reach, axis by axis; with the numbers of blocks.
function blockMaxima({ codes, x, y, z }) {
  const counts = [x, y, z].map((axis) => axis.count);
  let maxima = codes;
  let stride = 1;
  for (const axis of [0, 1, 2]) {
    const n = counts[axis];
    const blocks = (counts[axis] = Math.ceil(n / BLOCK));
    const rows = maxima.length / (stride * n);
    const next = new Uint8Array(rows * blocks * stride);
    for (let row = 0; row < rows; row++)
      for (let block = 0; block < blocks; block++) {
        const to = (row * blocks + block) * stride;
        for (let i = Math.max(0, block * BLOCK - REACH); i < Math.min(n, (block + 1) * BLOCK + REACH); i++) {
          const from = (row * n + i) * stride;
          for (let k = 0; k < stride; k++) if (maxima[from + k] > next[to + k]) next[to + k] = maxima[from + k];
        }
      }
    maxima = next;
    stride *= blocks;
  }
  return [maxima, counts];
}
