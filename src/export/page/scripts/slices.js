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
    moved(at.map((i, axis) => position(axes[axis], i)), at);
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
    choose,
  };
}
