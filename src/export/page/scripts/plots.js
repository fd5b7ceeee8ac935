// Flat maps with axes in metres: the slices, and the depth maps. Pixels are never blended.

// `tallest` is the maximum ratio of height to width: the slices share that of the first, so that they fit in one row.
// `paint(ix, iy)` returns a pixel's colour or null; `point(ix, iy, chosen)` is called when the user points or clicks.
class Plot {
  static all = [];

  constructor(place, { title, note = "", x, y, xLabel, yLabel, upward = false, tallest = Infinity, paint, point }) {
    Plot.all.push(this);
    Object.assign(this, { x, y, xLabel, yLabel, upward, tallest, paintPixel: paint, point, cursor: null });
    this.canvas = element("canvas", { tabIndex: 0 });
    this.canvas.setAttribute("role", "application");
    this.canvas.setAttribute("aria-label", `${title}. Arrow keys move the read-out.`);
    this.note = element("small", {}, note);
    this.figure = element("figure", {}, element("figcaption", {}, element("b", {}, title), this.note), this.canvas);
    place.append(this.figure);
    this.image = document.createElement("canvas");
    [this.image.width, this.image.height] = [x.count, y.count];
    const locate = (e, chosen) => {
      const box = this.canvas.getBoundingClientRect();
      const [u, v] = [e.clientX - box.left, e.clientY - box.top];
      const ix = Math.floor(((u - this.left) / this.width) * x.count);
      const down = Math.floor(((v - this.top) / this.height) * y.count);
      const iy = upward ? y.count - 1 - down : down;
      if (ix >= 0 && iy >= 0 && ix < x.count && iy < y.count) point(ix, iy, chosen);
    };
    this.canvas.addEventListener("pointermove", (e) => locate(e, e.buttons === 1));
    this.canvas.addEventListener("pointerdown", (e) => locate(e, true));
    this.canvas.addEventListener("keydown", (e) => {
      const step = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, upward ? 1 : -1], ArrowDown: [0, upward ? -1 : 1] }[e.key];
      if (!step) return;
      e.preventDefault();
      const [ix, iy] = this.cursor ?? [x.count >> 1, y.count >> 1];
      point(Math.min(x.count - 1, Math.max(0, ix + step[0])), Math.min(y.count - 1, Math.max(0, iy + step[1])), true);
    });
    new ResizeObserver(() => this.draw()).observe(this.figure);
  }

  refresh() {
    const { x, y } = this;
    const pen = this.image.getContext("2d");
    const pixels = pen.createImageData(x.count, y.count);
    for (let iy = 0; iy < y.count; iy++)
      for (let ix = 0; ix < x.count; ix++) {
        const rgb = this.paintPixel(ix, iy);
        if (rgb) pixels.data.set([...rgb, 255], 4 * ((this.upward ? y.count - 1 - iy : iy) * x.count + ix));
      }
    pen.putImageData(pixels, 0, 0);
    this.draw();
  }

  mark(ix, iy) {
    this.cursor = [ix, iy];
    this.draw();
  }

  draw() {
    const style = getComputedStyle(this.figure);
    const room = this.figure.clientWidth - parseFloat(style.paddingLeft) - parseFloat(style.paddingRight);
    if (room <= 0) return;
    const [x0, x1] = edges(this.x), [y0, y1] = edges(this.y);
    const [left, top, right, bottom] = [46, 4, 8, 36];
    const most = Math.min(420, this.tallest * (room - left - right));
    const scale = Math.min((room - left - right) / (x1 - x0), most / (y1 - y0));
    const [width, height] = [(x1 - x0) * scale, Math.max(24, (y1 - y0) * scale)];
    Object.assign(this, { left, top, width, height });
    const [w, h] = [left + width + right, top + height + bottom];
    const ratio = devicePixelRatio || 1;
    const { canvas } = this;
    [canvas.width, canvas.height] = [Math.round(w * ratio), Math.round(h * ratio)];
    [canvas.style.width, canvas.style.height] = [`${w}px`, `${h}px`];
    const pen = canvas.getContext("2d");
    const theme = getComputedStyle(document.documentElement);
    pen.scale(ratio, ratio);
    pen.fillStyle = theme.getPropertyValue("--line");
    pen.fillRect(left, top, width, height);
    pen.imageSmoothingEnabled = false;
    pen.drawImage(this.image, left, top, width, height);
    pen.fillStyle = pen.strokeStyle = theme.getPropertyValue("--soft");
    pen.lineWidth = 1;
    pen.strokeRect(left - 0.5, top - 0.5, width + 1, height + 1);
    pen.font = "11.5px system-ui, sans-serif";
    const across = (value) => left + (value - x0) * scale;
    const along = (value) => (this.upward ? top + height - (value - y0) * scale : top + (value - y0) * scale);
    pen.textAlign = "center";
    pen.textBaseline = "top";
    for (const { value, text } of ticks(x0, x1, Math.max(2, Math.floor(width / 52)))) {
      pen.fillRect(across(value) - 0.5, top + height, 1, 4);
      pen.fillText(text, across(value), top + height + 6);
    }
    pen.fillText(this.xLabel, left + width / 2, top + height + 21);
    pen.textAlign = "right";
    pen.textBaseline = "middle";
    for (const { value, text } of ticks(y0, y1, Math.max(2, Math.floor(height / 36)))) {
      pen.fillRect(left - 4, along(value) - 0.5, 4, 1);
      pen.fillText(text, left - 6, along(value));
    }
    pen.save();
    pen.translate(7, top + height / 2);
    pen.rotate(-Math.PI / 2);
    pen.textAlign = "center";
    pen.fillText(this.yLabel, 0, 0);
    pen.restore();
    if (this.cursor) this.crosshair(pen, across(position(this.x, this.cursor[0])), along(position(this.y, this.cursor[1])));
  }

  crosshair(pen, u, v) {
    const { left, top, width, height } = this;
    for (const [shade, thickness] of [["#000a", 3], ["#fff", 1]]) {
      pen.strokeStyle = shade;
      pen.lineWidth = thickness;
      pen.beginPath();
      for (const [a, b, c, d] of [[left, v, u - 6, v], [u + 6, v, left + width, v], [u, top, u, v - 6], [u, v + 6, u, top + height]]) {
        if (c < a || d < b) continue;
        pen.moveTo(a, b);
        pen.lineTo(c, d);
      }
      pen.globalAlpha = 0.55;
      pen.stroke();
      pen.globalAlpha = 1;
    }
  }
}
