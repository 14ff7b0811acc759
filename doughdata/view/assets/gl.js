// Thin layer over WebGL 2: programs, buffers that are filled anew for a key frame, and drawing.

class Painter {
  constructor(canvas) {
    const gl = canvas.getContext("webgl2", { antialias: true, alpha: false });
    if (!gl) throw new Error("this browser has no WebGL 2, which the 3D view needs");
    this.gl = gl;
    this.canvas = canvas;
    this.programs = {};
    this.shared = {};
    for (const [name, source] of Object.entries(SHADERS)) this.programs[name] = this.program(name, source);
  }

  /** Compile and link one program; its active uniforms and attributes by name. */
  program(name, { vertex, fragment }) {
    const { gl } = this;
    const handle = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      gl.attachShader(handle, shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS) && !gl.isContextLost()) {
        throw new Error(`shader ${name}: ${gl.getShaderInfoLog(shader)}`);
      }
    }
    gl.linkProgram(handle);
    const uniforms = {};
    for (let i = 0; i < gl.getProgramParameter(handle, gl.ACTIVE_UNIFORMS); i++) {
      const { name: full, type, size } = gl.getActiveUniform(handle, i);
      uniforms[full.replace("[0]", "")] = { at: gl.getUniformLocation(handle, full), type, size };
    }
    return { handle, uniforms };
  }

  /**
   * A thing to draw: `attributes` name -> {data, size}, `count` vertices, and optional `indices`.
   * Integers reach the shader as they are, not scaled to 0..1.
   */
  thing(program, mode, count, attributes, indices) {
    const { gl } = this;
    const array = gl.createVertexArray();
    const buffers = [];
    gl.bindVertexArray(array);
    const fill = (target, data) => {
      const buffer = gl.createBuffer();
      buffers.push(buffer);
      gl.bindBuffer(target, buffer);
      gl.bufferData(target, data, gl.STATIC_DRAW);
    };
    const types = { Float32Array: gl.FLOAT, Uint16Array: gl.UNSIGNED_SHORT, Uint8Array: gl.UNSIGNED_BYTE };
    for (const [name, { data, size }] of Object.entries(attributes)) {
      const at = gl.getAttribLocation(this.programs[program].handle, name);
      fill(gl.ARRAY_BUFFER, data);
      gl.enableVertexAttribArray(at);
      gl.vertexAttribPointer(at, size, types[data.constructor.name], false, 0, 0);
    }
    if (indices) fill(gl.ELEMENT_ARRAY_BUFFER, indices);
    gl.bindVertexArray(null);
    return { program, mode, count: indices ? indices.length : count, array, buffers, indexed: Boolean(indices) };
  }

  /** Give the memory of a thing back. */
  drop(thing) {
    if (!thing) return;
    for (const buffer of thing.buffers) this.gl.deleteBuffer(buffer);
    this.gl.deleteVertexArray(thing.array);
  }

  /** Draw a thing with its own values beside the shared ones. */
  draw(thing, values = {}) {
    if (!thing || thing.count === 0) return;
    const { gl } = this;
    const { handle, uniforms } = this.programs[thing.program];
    gl.useProgram(handle);
    const given = { ...this.shared, ...values };
    for (const [name, uniform] of Object.entries(uniforms)) this.set(name, uniform, given[name]);
    gl.bindVertexArray(thing.array);
    if (thing.indexed) gl.drawElements(thing.mode, thing.count, gl.UNSIGNED_INT, 0);
    else gl.drawArrays(thing.mode, 0, thing.count);
  }

  set(name, { at, type }, value) {
    const { gl } = this;
    if (value === undefined) throw new Error(`uniform ${name} has no value`);
    if (type === gl.FLOAT) gl.uniform1f(at, value);
    else if (type === gl.FLOAT_VEC2) gl.uniform2fv(at, value);
    else if (type === gl.FLOAT_VEC3) gl.uniform3fv(at, value);
    else if (type === gl.FLOAT_VEC4) gl.uniform4fv(at, value);
    else gl.uniformMatrix4fv(at, false, value);
  }
}

/** Corners of thick lines: two triangles for every pair of points. */
function lineAttributes(points) {
  const segments = points.length / 6;
  const position = new Float32Array(segments * 18);
  const other = new Float32Array(segments * 18);
  const side = new Float32Array(segments * 6);
  // [which end, side of the line]; seen from the far end the sides are swapped.
  const corners = [[0, 1], [0, -1], [1, 1], [1, 1], [0, -1], [1, -1]];
  for (let segment = 0; segment < segments; segment++) {
    corners.forEach(([end, sign], k) => {
      const at = segment * 6 + k;
      for (let axis = 0; axis < 3; axis++) {
        position[3 * at + axis] = points[6 * segment + 3 * end + axis];
        other[3 * at + axis] = points[6 * segment + 3 * (1 - end) + axis];
      }
      side[at] = end ? -sign : sign;
    });
  }
  return { position: { data: position, size: 3 }, other: { data: other, size: 3 }, side: { data: side, size: 1 } };
}
