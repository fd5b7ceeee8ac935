// The controls next to the volume.
function control(view, slices, section) {
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
    box.addEventListener("change", () => ((layer.shown = box.checked), (layer.chosen = true), view.draw()));
    layer.check = box;
    const dot = element("i");
    dot.style.background = layer.byDepth ? "linear-gradient(#fde725, #21918c, #440154)" : `rgb(${layer.tint.slice(0, 3).map((c) => 255 * c)})`;
    $("layers").append(element("label", {}, box, dot, layer.name));
  }
  const frame = (everything) => {
    $("frame").setAttribute("aria-pressed", everything);
    view.frame(everything);
  };
  const extent = (points) => Math.max(...points.map((p) => Math.hypot(...p.map((x, i) => x - points[0][i]))));
  frame(extent(corners(view.box)) > 0.8 * extent(view.whole));
  $("frame").addEventListener("click", () => frame($("frame").getAttribute("aria-pressed") !== "true"));
  for (const button of document.querySelectorAll("[data-view]")) button.addEventListener("click", () => view.look(button.dataset.view));
  $("labels").addEventListener("keydown", (e) => {
    const act = {
      ArrowLeft: () => view.turn(0.1, 0), ArrowRight: () => view.turn(-0.1, 0), ArrowUp: () => view.turn(0, 0.1), ArrowDown: () => view.turn(0, -0.1),
      "+": () => view.magnify(1.15), "=": () => view.magnify(1.15), "-": () => view.magnify(1 / 1.15),
      Home: () => (view.look("home"), frame($("frame").getAttribute("aria-pressed") === "true")),
      1: () => view.look("front"), 2: () => view.look("above"), 3: () => view.look("side"),
      x: () => section.choose(0), y: () => section.choose(1), z: () => section.choose(2),
      ",": () => section.move(-1), ".": () => section.move(1), s: () => section.turn(),
      m: () => mode(state.mode === "surface" ? "maximum" : "surface"), f: () => $("frame").click(),
    }[e.key.length === 1 ? e.key.toLowerCase() : e.key];
    if (!act || e.ctrlKey || e.metaKey || e.altKey) return;
    e.preventDefault();
    act();
  });
}

// The plane that cuts the view; with slices it is in one of them, and moves with it.
function sectionControl(view, outline, volume, slices) {
  const { low, high } = view.box;
  const axes = volume ? [volume.x, volume.y, volume.z] : low.map((first, i) => ({ first, pitch: (high[i] - first) / 100, count: 101 }));
  const at = axes.map((axis) => axis.count >> 1);
  const [slider, turned] = [$("section-at"), $("section-turned")];
  const radios = [...document.getElementsByName("section")];
  let axis = null;
  const apply = () => {
    const chosen = axis !== null;
    for (const control of [slider, turned]) control.disabled = !chosen;
    radios.forEach((radio) => (radio.checked = radio.value === (chosen ? "xyz"[axis] : "none")));
    view.settings.section = WHOLE;
    $("section-value").textContent = "everything";
    outline.shown = chosen;
    if (chosen) {
      const place = position(axes[axis], at[axis]);
      const side = turned.checked ? -1 : 1;
      view.settings.section = [0, 1, 2].map((i) => (i === axis ? side : 0)).concat(side * place);
      [slider.max, slider.value] = [axes[axis].count - 1, at[axis]];
      $("section-value").textContent = `${"xyz"[axis]} ${turned.checked ? "≤" : "≥"} ${metres(place)} m`;
      slider.setAttribute("aria-valuetext", $("section-value").textContent);
      view.replace(outline, sliceLines(view.box, low.map((_, i) => position(axes[i], at[i])), [axis]));
    }
    view.draw(true);
  };
  const moveTo = (i) => {
    if (axis === null) return;
    at[axis] = Math.min(axes[axis].count - 1, Math.max(0, i));
    if (slices) slices.choose(axis, at[axis]);
    else apply();
  };
  const choose = (next) => {
    axis = next === axis ? null : next;
    apply();
  };
  radios.forEach((radio) => radio.addEventListener("change", () => choose(radio.value === "none" ? null : "xyz".indexOf(radio.value))));
  slider.addEventListener("input", () => moveTo(Number(slider.value)));
  turned.addEventListener("change", apply);
  apply();
  return {
    choose,
    move: (steps) => moveTo(at[axis] + steps),
    turn: () => axis !== null && turned.click(),
    follow: (place) => {
      place.forEach((i, k) => (at[k] = i));
      if (axis !== null) apply();
    },
  };
}
