// What stands on the stage: the layers of one key frame, drawn when something has changed.

const LAYERS = ["particles", "mesh", "tools", "depth", "graph"];
const MARK = { node: 9, nodeMore: 11, rim: 1.6, edge: 2.2, finger: 1.4 }; // [px]
const BALL = { whole: 0.62, inGlass: 0.34, shadow: 1.1 }; // radius in particle spacings

class Stage {
  constructor(canvas, store) {
    this.canvas = canvas;
    this.store = store;
    this.painter = new Painter(canvas);
    this.visible = new Set();
    this.things = {};
    this.colours = {};
    const { low, high } = this.extent();
    const middle = low.map((value, k) => (value + high[k]) / 2);
    const radius = 0.66 * Math.hypot(...high.map((value, k) => value - low[k])) + 0.004;
    const { azimuth, elevation, palette, crumb, light, ramp } = store.header.style;
    this.camera = new OrbitCamera({ target: middle, radius, azimuth, elevation });
    this.painter.shared = {
      light, crumb, palette: palette.flat(), ramp: ramp.flat(), middle,
      reach: 3.2 * radius, low: store.header.box.low, unit: store.header.box.step,
    };
    const corner = { data: new Float32Array([-1, -1, 1, -1, -1, 1, 1, 1]), size: 2 };
    this.table = this.painter.thing("table", this.painter.gl.TRIANGLE_STRIP, 4, { corner });
    canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
    canvas.addEventListener("webglcontextrestored", () => location.reload());
  }

  /** Lowest and highest corner [m] of all dough in all key frames. */
  extent() {
    const { low, step } = this.store.header.box;
    const steps = this.store.arrays.positions;
    const [least, most] = [[65535, 65535, 65535], [0, 0, 0]];
    for (let i = 0; i < steps.length; i++) {
      least[i % 3] = Math.min(least[i % 3], steps[i]);
      most[i % 3] = Math.max(most[i % 3], steps[i]);
    }
    return { low: low.map((v, k) => v + step * least[k]), high: low.map((v, k) => v + step * most[k]) };
  }

  /** Which layers the scene has. */
  has(layer) {
    const { header } = this.store;
    if (layer === "mesh") return Boolean(header.meshes);
    if (layer === "graph") return Boolean(header.graph);
    if (layer === "depth") return Boolean(header.depth && header.depth.windows.length);
    return true;
  }

  show(layer, on) {
    if (on) this.visible.add(layer);
    else this.visible.delete(layer);
    this.fill();
  }

  setFrame(frame) {
    this.frame = frame;
    for (const name of Object.keys(this.things)) this.forget(name);
    this.fill();
  }

  /** Colours [0..1] that depend on the theme: stage, table, grid, shadow, ink. */
  setColours(colours) {
    this.colours = colours;
    this.request();
  }

  forget(name) {
    this.painter.drop(this.things[name]);
    delete this.things[name];
  }

  /** Make what the visible layers need of this key frame and have not got. */
  fill() {
    if (!this.things.particles) this.things.particles = this.particles();
    if (this.visible.has("mesh") && !this.things.mesh) this.things.mesh = this.mesh();
    if (this.visible.has("tools") && !this.things.fingerFaces) this.addFingers();
    if (this.visible.has("depth") && !this.things.cloud) this.things.cloud = this.cloud();
    if (this.visible.has("graph") && !this.things.nodes) this.addGraph();
    this.request();
  }

  particles() {
    // Copies: a view into the whole scene cannot be given to every browser's bufferData as it is.
    const steps = { data: this.store.particleSteps(this.frame).slice(), size: 3 };
    const component = { data: this.store.labels(this.frame).slice(), size: 1 };
    return this.painter.thing("spheres", this.painter.gl.POINTS, this.store.numParticles, { steps, component });
  }

  mesh() {
    const { vertices, normals, components, faces } = this.store.mesh(this.frame);
    const attributes = {
      position: { data: vertices, size: 3 },
      normal: { data: normals, size: 3 },
      component: { data: components, size: 1 },
    };
    return this.painter.thing("surface", this.painter.gl.TRIANGLES, 0, attributes, faces);
  }

  addFingers() {
    const { faces, edges } = this.store.fingers(this.frame);
    const { gl } = this.painter;
    const position = { data: faces, size: 3 };
    this.things.fingerFaces = this.painter.thing("flat", gl.TRIANGLES, faces.length / 3, { position });
    this.things.fingerEdges = this.lines(edges);
  }

  cloud() {
    const { points, depths, sizes } = this.store.cloud(this.store.depthFrame(this.frame));
    const sorted = depths.slice().sort();
    const [low, high] = [0.01, 0.99].map((part) => sorted[Math.floor(part * (sorted.length - 1))] ?? 0);
    const value = depths.map((depth) => (depth - low) / Math.max(high - low, 1e-3));
    return this.marks(points, value, sizes);
  }

  addGraph() {
    const { nodes, components, particles, edges } = this.store.graph(this.frame);
    const segments = [];
    for (const node of edges) segments.push(...nodes.subarray(3 * node, 3 * node + 3));
    const most = particles.reduce((a, b) => Math.max(a, b), 1);
    const sized = (count) => (MARK.node + MARK.nodeMore * Math.sqrt(count / most)) * devicePixelRatio;
    const sizes = Float32Array.from(particles, sized);
    this.things.edges = this.lines(new Float32Array(segments));
    this.things.nodes = this.marks(nodes, Float32Array.from(components), sizes);
  }

  lines(points) {
    return this.painter.thing("lines", this.painter.gl.TRIANGLES, points.length, lineAttributes(points));
  }

  marks(points, value, size) {
    return this.painter.thing("marks", this.painter.gl.POINTS, value.length, {
      position: { data: points, size: 3 },
      value: { data: value, size: 1 },
      size: { data: size, size: 1 },
    });
  }

  /** Draw before the next picture of the browser. */
  request() {
    if (this.waiting || this.frame === undefined || !this.colours.stage) return;
    this.waiting = true;
    requestAnimationFrame(() => {
      this.waiting = false;
      this.draw();
    });
  }

  draw() {
    const { canvas, painter, things, visible, colours } = this;
    const { gl } = painter;
    const ratio = devicePixelRatio;
    const [width, height] = [canvas.clientWidth, canvas.clientHeight].map((size) => Math.max(1, Math.round(size * ratio)));
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    this.camera.aspect = width / height;
    Object.assign(painter.shared, this.camera.uniforms(), { viewport: [width, height] });
    painter.shared.pixels = painter.shared.focal * height;
    gl.viewport(0, 0, width, height);
    gl.clearColor(...colours.stage, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
    gl.depthFunc(gl.LEQUAL);
    this.ground();
    const radius = (visible.has("mesh") ? BALL.inGlass : BALL.whole) * this.store.header.spacing;
    if (visible.has("particles")) painter.draw(things.particles, { radius, flatten: 0, shadow: colours.shadow });
    if (visible.has("depth")) painter.draw(things.cloud, { ramped: 1, rim: 0, rimColour: [0, 0, 0] });
    if (visible.has("mesh")) this.surface(visible.has("particles"));
    if (visible.has("tools")) this.gripper(ratio);
    if (visible.has("graph")) this.skeleton(ratio);
  }

  /** Table and shadow: behind everything, so without depth. */
  ground() {
    const { gl } = this.painter;
    gl.disable(gl.DEPTH_TEST);
    if (this.camera.elevation > 0) {
      this.painter.draw(this.table, { tableColour: this.colours.table, gridColour: this.colours.grid });
    }
    if (this.visible.has("particles") || this.visible.has("mesh")) {
      const radius = BALL.shadow * this.store.header.spacing;
      this.painter.draw(this.things.particles, { radius, flatten: 1, shadow: this.colours.shadow });
    }
    gl.enable(gl.DEPTH_TEST);
    gl.clear(gl.DEPTH_BUFFER_BIT);
  }

  /** Over particles the mesh is glass: its depth first, then only its nearest side. */
  surface(glass) {
    const { gl } = this.painter;
    const { mesh } = this.things;
    if (glass) {
      gl.colorMask(false, false, false, false);
      this.painter.draw(mesh, { alpha: 1 });
      gl.colorMask(true, true, true, true);
    }
    this.painter.draw(mesh, { alpha: glass ? 0.45 : 1 });
  }

  gripper(ratio) {
    const { gl } = this.painter;
    const ink = this.colours.tool;
    gl.depthMask(false);
    this.painter.draw(this.things.fingerFaces, { ink: [...ink, 0.14] });
    this.painter.draw(this.things.fingerEdges, { ink: [...ink, 0.9], width: MARK.finger * ratio });
    gl.depthMask(true);
  }

  /** The scene graph lies inside the dough: it is drawn over everything. */
  skeleton(ratio) {
    const { gl } = this.painter;
    gl.disable(gl.DEPTH_TEST);
    this.painter.draw(this.things.edges, { ink: [...this.colours.ink, 1], width: MARK.edge * ratio });
    this.painter.draw(this.things.nodes, { ramped: 0, rim: MARK.rim * ratio, rimColour: this.colours.ink });
  }
}
