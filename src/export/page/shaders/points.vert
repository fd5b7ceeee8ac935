#version 300 es
// Points, lines and triangles in metres; the colour of a point may depend on its depth.
uniform mat4 matrix;
uniform float pointSize, least;
uniform vec2 nearFar;
in vec3 position;
in float lit;
out vec3 place;
out float shade, light;
void main() {
  gl_Position = matrix * vec4(position, 1.0);
  gl_PointSize = clamp(pointSize / gl_Position.w, least, 8.0 * least);
  place = position;
  light = lit;
  shade = clamp((position.z - nearFar.x) / (nearFar.y - nearFar.x), 0.0, 1.0);
}
