#version 300 es
// One ray per pixel through the volume: its maximum amplitude, or the surface where it crosses a level.
precision highp float;
precision highp sampler3D;
uniform sampler3D volume;    // 0 = floor of the scale, 1 = the peak, linear in dB
uniform sampler3D bounds;    // the maximum around each block, as far as a run of samples that is centred in it extends
uniform sampler2D colours;
uniform vec3 eye, right, down, forward; // right and down extend to the edges of the picture at distance 1
uniform vec3 low, size;      // the box, m
uniform vec3 voxels;
uniform vec4 section;        // normal, towards the side that is kept, and distance from the origin, m
uniform vec2 depthTerms;
uniform float threshold, opacity;
uniform float rate;          // samples per voxel, at least
uniform vec2 nearFar;        // depths of the first and the last colour of a surface, m
uniform bool surface;
const int run = 8;           // samples that are skipped or taken together
in vec2 place;
out vec4 colour;

vec3 paint(float t) { return texture(colours, vec2((clamp(t, 0.0, 1.0) * 255.0 + 0.5) / 256.0, 0.5)).rgb; }

vec3 normal(vec3 p) {
  vec3 h = 1.0 / voxels;
  vec3 rise = vec3(
    texture(volume, p + vec3(h.x, 0, 0)).r - texture(volume, p - vec3(h.x, 0, 0)).r,
    texture(volume, p + vec3(0, h.y, 0)).r - texture(volume, p - vec3(0, h.y, 0)).r,
    texture(volume, p + vec3(0, 0, h.z)).r - texture(volume, p - vec3(0, 0, h.z)).r);
  return -normalize(rise * voxels / size + 1e-9);
}

void main() {
  vec3 ray = normalize(forward + place.x * right - place.y * down);
  vec3 a = (low - eye) / ray, b = (low + size - eye) / ray;
  vec3 nearer = min(a, b), farther = max(a, b);
  float from = max(max(nearer.x, max(nearer.y, nearer.z)), 0.0);
  float to = min(farther.x, min(farther.y, farther.z));
  colour = vec4(0);
  gl_FragDepth = 1.0;
  float along = dot(section.xyz, ray), away = section.w - dot(section.xyz, eye);
  bool cut = along > 0.0 && away > from * along;
  if (cut) from = away / along;
  if (along < 0.0) to = min(to, away / along);
  if (from >= to || (along == 0.0 && away > 0.0)) return;
  vec3 start = (eye + from * ray - low) / size, way = (to - from) * ray / size;
  int runs = (int(clamp(length(way * voxels) * rate, 8.0, 800.0)) + run - 1) / run;
  int steps = runs * run;
  vec3 stride = way / float(steps);
  vec3 middle = start + 0.5 * float(run) * stride;
  if (!surface) {
    float most = threshold;
    for (int first = 0; first < steps; first += run) {
      if (texture(bounds, middle + float(first) * stride).r <= most) continue;
      for (int i = first; i < first + run; i++) most = max(most, texture(volume, start + (float(i) + 0.5) * stride).r);
    }
    float t = (most - threshold) / (1.0 - threshold);
    if (t <= 0.0) return;
    float alpha = opacity * smoothstep(0.0, 0.25, t);
    colour = vec4(paint(t) * alpha, alpha);
    return;
  }
  // A section through what is above the level is a surface, too.
  bool capped = cut && texture(volume, start).r >= threshold;
  float before = cut ? 0.0 : 1.0;
  float passed = 1.0;
  for (int first = 0; first < steps && passed > 0.02; first += run) {
    if (texture(bounds, middle + float(first) * stride).r < threshold) {
      before = 0.0;
      continue;
    }
    for (int i = first; i < first + run && passed > 0.02; i++) {
      float here = texture(volume, start + (float(i) + 0.5) * stride).r;
      if (before < threshold && here >= threshold) {
        float inside = float(i) + 0.5, outside = max(inside - 1.0, 0.0);
        for (int halving = 0; halving < 5; halving++) {
          float between = 0.5 * (inside + outside);
          if (texture(volume, start + between * stride).r >= threshold) inside = between; else outside = between;
        }
        bool cap = capped && i == 0;
        vec3 p = start + (cap ? 0.0 : inside) * stride;
        vec3 metres = low + p * size;
        vec3 n = cap ? section.xyz : normal(p);
        float light = 0.32 + 0.68 * abs(dot(n, normalize(-forward + 0.35 * normalize(-down) - 0.25 * normalize(right))));
        vec3 shade = paint((metres.z - nearFar.x) / (nearFar.y - nearFar.x)) * light + 0.12 * pow(max(dot(n, -ray), 0.0), 24.0);
        if (passed == 1.0) gl_FragDepth = 0.5 + 0.5 * (depthTerms.x + depthTerms.y / dot(metres - eye, forward));
        colour += passed * opacity * vec4(shade, 1.0);
        passed *= 1.0 - opacity;
      }
      before = here;
    }
  }
}
