// GLSL of the five kinds of things on the stage. Light and colours are those of the contact sheet.

const LIGHTING = `
uniform vec3 light, towards;  // unit vectors in the world: to the lamp, to the viewer
vec3 lit(vec3 colour, vec3 normal) {
  float diffuse = clamp(dot(normal, light), 0.0, 1.0);
  float gloss = pow(clamp(dot(normal, normalize(light + towards)), 0.0, 1.0), 24.0);
  return clamp(colour * (0.45 + 0.62 * diffuse) + 0.22 * gloss, 0.0, 1.0);
}`;

const PALETTE = `
uniform vec3 palette[8], crumb;
vec3 colourOf(float component) {
  return component > 254.5 ? crumb : palette[int(component + 0.5) % 8];
}`;

const COMMON = `#version 300 es
precision highp float;
uniform mat4 viewProjection;`;

const SHADERS = {
  // A sphere per particle, drawn on a square that faces the viewer, with its own depth; the shadow
  // is the same without height.
  spheres: {
    vertex: `${COMMON}
${PALETTE}
uniform vec3 low;
uniform float unit, radius, pixels, flatten;
in vec3 steps;
in float component;
out vec3 colour;
out float viewDepth;
void main() {
  vec3 world = low + unit * steps;
  world.z *= 1.0 - flatten;
  gl_Position = viewProjection * vec4(world, 1.0);
  gl_PointSize = max(radius * pixels / gl_Position.w, 1.5);
  colour = colourOf(component);
  viewDepth = gl_Position.w;
}`,
    fragment: `#version 300 es
precision highp float;
${LIGHTING}
uniform float radius, flatten;
uniform vec2 depthRow;  // third row of the projection
uniform vec3 right, up, shadow;
in vec3 colour;
in float viewDepth;
out vec4 pixel;
void main() {
  vec2 at = vec2(gl_PointCoord.x, 1.0 - gl_PointCoord.y) * 2.0 - 1.0;
  float square = dot(at, at);
  if (square > 1.0) discard;
  float height = sqrt(1.0 - square);
  vec3 normal = at.x * right + at.y * up + height * towards;
  float z = -(viewDepth - radius * height);
  gl_FragDepth = 0.5 - 0.5 * (depthRow.x * z + depthRow.y) / z;
  pixel = flatten > 0.5 ? vec4(shadow, 1.0) : vec4(lit(colour, normal), 1.0);
}`,
  },
  // Triangles with smooth normals; seen from inside they are lit as from outside.
  surface: {
    vertex: `${COMMON}
${PALETTE}
in vec3 position, normal;
in float component;
out vec3 colour, direction;
void main() {
  gl_Position = viewProjection * vec4(position, 1.0);
  colour = colourOf(component);
  direction = normal;
}`,
    fragment: `#version 300 es
precision highp float;
${LIGHTING}
uniform float alpha;
in vec3 colour, direction;
out vec4 pixel;
void main() {
  vec3 normal = normalize(direction);
  pixel = vec4(lit(colour, gl_FrontFacing ? normal : -normal), alpha);
}`,
  },
  // One colour: the faces of the fingers.
  flat: {
    vertex: `${COMMON}
in vec3 position;
void main() { gl_Position = viewProjection * vec4(position, 1.0); }`,
    fragment: `#version 300 es
precision highp float;
uniform vec4 ink;
out vec4 pixel;
void main() { pixel = ink; }`,
  },
  // Line segments of a width in pixels: each corner knows its own end, the other end and its side.
  lines: {
    vertex: `${COMMON}
uniform vec2 viewport;
uniform float width;
in vec3 position, other;
in float side;
void main() {
  vec4 here = viewProjection * vec4(position, 1.0);
  vec4 there = viewProjection * vec4(other, 1.0);
  vec2 along = normalize((there.xy / there.w - here.xy / here.w) * viewport + vec2(1e-6, 0.0));
  here.xy += side * width / viewport * vec2(-along.y, along.x) * here.w;
  gl_Position = here;
}`,
    fragment: `#version 300 es
precision highp float;
uniform vec4 ink;
out vec4 pixel;
void main() { pixel = ink; }`,
  },
  // Round marks: graph nodes (by component, with a rim, sized in pixels) and depth points (by ramp,
  // sized in metres, so that they close up when seen from near).
  marks: {
    vertex: `${COMMON}
${PALETTE}
uniform vec3 ramp[17];
uniform float ramped, pixels;
in vec3 position;
in float value, size;
out vec3 colour;
out float diameter;
void main() {
  gl_Position = viewProjection * vec4(position, 1.0);
  float at = clamp(value, 0.0, 1.0) * 16.0;
  int stop = min(int(at), 15);
  colour = ramped > 0.5 ? mix(ramp[stop], ramp[stop + 1], at - float(stop)) : colourOf(value);
  diameter = ramped > 0.5 ? max(0.5 * size * pixels / gl_Position.w, 2.0) : size;
  gl_PointSize = diameter;
}`,
    fragment: `#version 300 es
precision highp float;
uniform float rim;  // [px]
uniform vec3 rimColour;
in vec3 colour;
in float diameter;
out vec4 pixel;
void main() {
  float at = length(gl_PointCoord * 2.0 - 1.0);
  if (at > 1.0) discard;
  pixel = vec4(rim > 0.0 && at > 1.0 - 2.0 * rim / diameter ? rimColour : colour, 1.0);
}`,
  },
  // The table: a grid of 10 mm that fades away from the dough.
  table: {
    vertex: `${COMMON}
uniform vec3 middle;
uniform float reach;
in vec2 corner;
out vec2 world, offset;
void main() {
  offset = corner;
  world = middle.xy + reach * corner;
  gl_Position = viewProjection * vec4(world, 0.0, 1.0);
}`,
    fragment: `#version 300 es
precision highp float;
uniform vec3 tableColour, gridColour;
in vec2 world, offset;
out vec4 pixel;
float grid(float spacing) {
  vec2 at = world / spacing;
  vec2 away = abs(fract(at - 0.5) - 0.5) / fwidth(at);
  return 1.0 - min(min(away.x, away.y), 1.0);
}
void main() {
  float fade = 1.0 - smoothstep(0.55, 1.0, length(offset));
  float line = max(0.45 * grid(0.01), 0.9 * grid(0.05));
  pixel = vec4(mix(tableColour, gridColour, line), fade);
}`,
  },
};
