// The data of the page: the report, and arrays as zlib in base64.

const parse = (id) => JSON.parse(document.getElementById(id).textContent);
const data = parse("page-data");
const report = parse("report");
const $ = (id) => document.getElementById(id);

async function unpack(text) {
  const packed = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Response(stream).arrayBuffer();
}
// Little-endian, as on all machines with a browser.
const bytes = async (text) => new Uint8Array(await unpack(text));
const floats = async (text) => new Float32Array(await unpack(text));

const position = (axis, i) => axis.first + axis.pitch * i;
const nearest = (axis, x) => Math.min(axis.count - 1, Math.max(0, Math.round((x - axis.first) / axis.pitch)));
const edges = (axis) => [axis.first - axis.pitch / 2, axis.first + (axis.count - 0.5) * axis.pitch];

// Formatted numbers, with a true minus sign.
const fixed = (x, digits) => x.toFixed(digits).replace("-", "−").replace(/^−(0\.?0*)$/, "$1");
const metres = (x) => fixed(x, 3);
const decibels = (code) => (code > 0 ? `${fixed((code / 255 - 1) * data.range_db, 1)} dB` : `below −${data.range_db} dB`);
const signed = (x, digits) => (x > 0 ? "+" : "") + fixed(x, digits);

function element(name, attributes = {}, ...children) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    if (key in made) made[key] = value;
    else made.setAttribute(key, value);
  }
  made.append(...children);
  return made;
}

// A colour map is 256 RGB triples; `colour(map, t)` takes t in 0..1.
const maps = {};
const colour = (map, t) => {
  const k = 3 * Math.round(255 * Math.min(1, Math.max(0, t)));
  return [map[k], map[k + 1], map[k + 2]];
};

// Ticks at multiples of 1, 2, 2.5 or 5 times a power of ten: at most `most` of them.
function ticks(low, high, most) {
  const power = 10 ** Math.floor(Math.log10((high - low) / most));
  const step = [1, 2, 2.5, 5, 10, 20].map((f) => f * power).find((s) => Math.floor(high / s + 1e-6) - Math.ceil(low / s - 1e-6) < most);
  const digits = Math.max(0, Math.ceil(-Math.log10(step) - 1e-6) + (Math.abs(step / 2.5 - 10 ** Math.round(Math.log10(step / 2.5))) < 1e-9 * step ? 1 : 0));
  const list = [];
  for (let i = Math.ceil(low / step - 1e-6); i * step <= high + 1e-6 * step; i++) list.push({ value: i * step, text: fixed(i * step, digits) });
  return list;
}

// A colour bar with labels below.
function bar(place, map, words) {
  const stops = Array.from({ length: 33 }, (_, i) => `rgb(${colour(map, i / 32)})`);
  const strip = element("i");
  strip.style.background = `linear-gradient(90deg, ${stops})`;
  place.replaceChildren(strip, element("div", {}, ...words.map((word) => element("span", {}, word))));
}
