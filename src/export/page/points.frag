#version 300 es
precision highp float;
uniform vec4 tint;
uniform sampler2D colours;
uniform bool byDepth, round;
in float shade, light;
out vec4 colour;
void main() {
  if (round && length(gl_PointCoord - 0.5) > 0.5) discard;
  vec3 rgb = byDepth ? texture(colours, vec2((shade * 255.0 + 0.5) / 256.0, 0.5)).rgb : tint.rgb;
  colour = vec4(rgb * light * tint.a, tint.a);
}
