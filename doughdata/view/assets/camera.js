// A camera that orbits a point: mouse, touch and keyboard. Azimuth and elevation as on the contact sheet.

const FIELD_OF_VIEW = (28 * Math.PI) / 180; // from top to bottom

class OrbitCamera {
  /** `target` [m] is looked at; a ball of `radius` [m] around it fills the picture. */
  constructor({ target, radius, azimuth, elevation }) {
    this.home = { target: [...target], azimuth, elevation };
    this.radius = radius;
    this.aspect = 1;
    this.reset();
  }

  reset() {
    Object.assign(this, { ...this.home, target: [...this.home.target], zoom: 1 });
  }

  /** Straight from above, +y up. */
  fromAbove() {
    this.reset();
    this.azimuth = -Math.PI / 2;
    this.elevation = Math.PI / 2;
  }

  /** [m] from the target; a narrow picture is seen from farther away. */
  get distance() {
    const half = Math.atan(Math.tan(FIELD_OF_VIEW / 2) * Math.min(this.aspect, 1));
    return this.radius / Math.sin(half) / this.zoom;
  }

  /** Unit vectors in the world: right, up, towards the viewer. */
  get axes() {
    const [ca, sa] = [Math.cos(this.azimuth), Math.sin(this.azimuth)];
    const [ce, se] = [Math.cos(this.elevation), Math.sin(this.elevation)];
    return { right: [-sa, ca, 0], up: [-se * ca, -se * sa, ce], towards: [ce * ca, ce * sa, se] };
  }

  get eye() {
    const { towards } = this.axes;
    return this.target.map((value, k) => value + this.distance * towards[k]);
  }

  /** Values for the shaders: world -> clip space (column by column) and its parts. */
  uniforms() {
    const { right, up, towards } = this.axes;
    const eye = this.eye;
    const focal = 1 / Math.tan(FIELD_OF_VIEW / 2);
    const [near, far] = [this.distance * 0.02, this.distance * 2 + this.radius * 20];
    const [a, b] = [(far + near) / (near - far), (2 * far * near) / (near - far)];
    const dot = (u, v) => u[0] * v[0] + u[1] * v[1] + u[2] * v[2];
    const row = (axis, scale) => [...axis.map((value) => value * scale), -dot(axis, eye) * scale];
    const rows = [row(right, focal / this.aspect), row(up, focal), row(towards, a), row(towards, -1)];
    rows[2][3] += b;
    const matrix = new Float32Array(16);
    rows.forEach((values, r) => values.forEach((value, c) => (matrix[4 * c + r] = value)));
    return { viewProjection: matrix, right, up, towards, depthRow: [a, b], focal };
  }

  turn(azimuth, elevation) {
    this.azimuth += azimuth;
    this.elevation = Math.max(-Math.PI / 2, Math.min(Math.PI / 2, this.elevation + elevation));
  }

  /** Move the target across the picture, by parts of the picture's height. */
  shift(across, upwards) {
    const { right, up } = this.axes;
    const metres = 2 * this.distance * Math.tan(FIELD_OF_VIEW / 2);
    this.target = this.target.map((value, k) => value + metres * (across * right[k] + upwards * up[k]));
  }

  magnify(factor) {
    this.zoom = Math.max(0.2, Math.min(20, this.zoom * factor));
  }

  /** Drag to turn; right button, shift or two fingers to shift; wheel or pinch to zoom. */
  listen(canvas, changed) {
    const pointers = new Map();
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      pointers.set(event.pointerId, [event.clientX, event.clientY]);
    });
    for (const name of ["pointerup", "pointercancel"]) {
      canvas.addEventListener(name, (event) => pointers.delete(event.pointerId));
    }
    canvas.addEventListener("pointermove", (event) => {
      const before = pointers.get(event.pointerId);
      if (!before) return;
      const height = canvas.clientHeight;
      const [dx, dy] = [(event.clientX - before[0]) / height, (event.clientY - before[1]) / height];
      const others = [...pointers].filter(([id]) => id !== event.pointerId).map(([, at]) => at);
      if (others.length) {
        const apart = (at) => Math.hypot(at[0] - others[0][0], at[1] - others[0][1]) || 1;
        this.magnify(apart([event.clientX, event.clientY]) / apart(before));
        this.shift(-dx / 2, dy / 2);
      } else if (event.shiftKey || event.buttons & 2) {
        this.shift(-dx, dy);
      } else {
        this.turn(-dx * 4, dy * 4);
      }
      pointers.set(event.pointerId, [event.clientX, event.clientY]);
      changed();
    });
    const onWheel = (event) => {
      event.preventDefault();
      this.magnify(Math.exp(-event.deltaY * (event.deltaMode ? 0.05 : 0.0015)));
      changed();
    };
    canvas.addEventListener("wheel", onWheel, { passive: false });
  }

  /** Keys while the picture has the focus; true if the key meant something. */
  key(event) {
    const turns = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] };
    if (event.key in turns && event.shiftKey) this.turn(...turns[event.key]);
    else if (event.key === "+" || event.key === "=") this.magnify(1.15);
    else if (event.key === "-") this.magnify(1 / 1.15);
    else if (event.key === "r") this.reset();
    else if (event.key === "t") this.fromAbove();
    else return false;
    return true;
  }
}
