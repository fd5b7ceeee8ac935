#version 300 es
precision highp float;
uniform vec4 tint;
uniform vec4 section;        // normal, towards the side that is kept, and distance from the origin, m
uniform vec3 towards;        // where the light is, which shades the faces of solids
uniform sampler2D colours;
uniform bool byDepth, round, solid;
in vec3 place;
in float shade, light;
out vec4 colour;
void main() {
  if (dot(section.xyz, place) < section.w) discard;
  if (round && length(gl_PointCoord - 0.5) > 0.5) discard;
  vec3 rgb = byDepth ? texture(colours, vec2((shade * 255.0 + 0.5) / 256.0, 0.5)).rgb : tint.rgb;
  float lit = solid ? 0.3 + 0.7 * abs(dot(normalize(cross(dFdx(place), dFdy(place))), towards)) : light;
  colour = vec4(rgb * lit * tint.a, tint.a);
}
