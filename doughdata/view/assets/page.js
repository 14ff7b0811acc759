// The page: reads its data, fills the texts, and joins controls, time line and stage.

const SPEEDS = [1 / 16, 1 / 8, 1 / 4, 1 / 2, 1, 2];
const REST = 0.7; // [s], at the last key frame while playing
const ABOUT = {
  particles: "Particles", mesh: "Component meshes", tools: "Gripper", depth: "Depth cloud", graph: "Scene graph",
};
const MISSING_AS = { mesh: "mesh", depth: "depth", graph: "topology" };
const byId = (id) => document.getElementById(id);

/** A theme colour as three numbers 0..1; the browser resolves light and dark. */
function cssColour(name) {
  const probe = byId("probe");
  probe.style.color = `var(${name})`;
  return getComputedStyle(probe).color.match(/[\d.]+/g).slice(0, 3).map((part) => part / 255);
}

class Page {
  constructor(store) {
    this.store = store;
    this.stage = new Stage(byId("stage"), store);
    this.slider = byId("frame");
    this.slider.max = store.numFrames - 1;
    this.timeline = new Timeline(byId("timeline"), store, (frame) => this.setFrame(frame));
    this.fillTexts();
    this.addToggles();
    this.addSpeeds();
    this.listen();
    this.recolour();
    this.setFrame(0);
  }

  fillTexts() {
    const { scene, missing, toolNames } = this.store.header;
    byId("title").textContent = scene.id;
    const tools = [...new Set(this.store.header.tools.used.map((tool) => toolNames[tool]))];
    const facts = { scene: scene.index, family: scene.family, split: scene.split, region: scene.region, seed: scene.seed };
    facts.tool = tools.join(", ");
    facts.particles = this.store.numParticles;
    for (const [name, value] of Object.entries(facts)) {
      const fact = element("span", "fact");
      fact.append(element("b", "", {}, name), ` ${value}`);
      byId("facts").append(fact);
    }
    for (const [layer, reason] of Object.entries(missing)) {
      const line = element("li");
      line.append(element("b", "", {}, layer), `: ${reason}`);
      byId("missing").append(line);
    }
    byId("missing").hidden = Object.keys(missing).length === 0;
  }

  /** Meshes are shown first where there are some, else particles. */
  addToggles() {
    const first = new Set(["tools", this.stage.has("mesh") ? "mesh" : "particles", "graph"]);
    LAYERS.forEach((layer, number) => {
      const there = this.stage.has(layer);
      const label = element("label", there ? "toggle" : "toggle off");
      const box = element("input", "", { type: "checkbox", id: `show-${layer}` });
      const sensor = layer === "depth" && there ? ` (${this.store.header.sensor})` : "";
      label.append(box, element("span", "", {}, ABOUT[layer] + sensor), element("kbd", "", {}, `${number + 1}`));
      box.disabled = !there;
      if (!there) label.title = this.store.header.missing[MISSING_AS[layer]] ?? "not in this scene";
      box.checked = there && first.has(layer);
      if (box.checked) this.stage.visible.add(layer);
      box.addEventListener("change", () => {
        this.stage.show(layer, box.checked);
        this.tellDepth();
      });
      byId("layers").append(label);
    });
  }

  /** The speed that plays the scene in about six seconds is chosen. */
  addSpeeds() {
    const { timestamps } = this.store.header;
    const wanted = (timestamps[timestamps.length - 1] - timestamps[0]) / 6;
    const apart = (speed) => Math.abs(Math.log(speed / Math.max(wanted, 1e-9)));
    const best = SPEEDS.reduce((a, b) => (apart(b) < apart(a) ? b : a));
    for (const speed of SPEEDS) {
      const name = speed < 1 ? `1/${1 / speed}` : `${speed}`;
      const option = element("option", "", { value: speed }, `${name}\u00d7`);
      option.selected = speed === best;
      byId("speed").append(option);
    }
  }

  listen() {
    this.slider.addEventListener("input", () => this.setFrame(Number(this.slider.value)));
    byId("play").addEventListener("click", () => this.play(!this.playing));
    byId("theme").addEventListener("click", () => this.turnTheme());
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.recolour());
    new ResizeObserver(() => this.stage.request()).observe(byId("stage"));
    this.stage.camera.listen(byId("stage"), () => this.stage.request());
    document.addEventListener("keydown", (event) => this.key(event));
  }

  key(event) {
    if (event.ctrlKey || event.altKey || event.metaKey || event.target.tagName === "SELECT") return;
    const onSlider = event.target === this.slider;
    const onButton = event.target.tagName === "BUTTON" || event.target.type === "checkbox";
    const layer = LAYERS[Number(event.key) - 1];
    const frames = { ArrowLeft: this.frame - 1, ArrowRight: this.frame + 1, Home: 0, End: this.store.numFrames - 1 };
    if (event.key === " " && !onButton) this.play(!this.playing);
    else if (event.key in frames && !event.shiftKey && !onSlider) this.setFrame(frames[event.key]);
    else if (layer) byId(`show-${layer}`).click();
    else if (event.key === "d") this.turnTheme();
    else if (this.stage.camera.key(event)) this.stage.request();
    else return;
    event.preventDefault();
  }

  setFrame(frame) {
    this.frame = Math.max(0, Math.min(this.store.numFrames - 1, frame));
    this.slider.value = this.frame;
    const { timestamps, opening, genus, ambiguous } = this.store.header;
    this.slider.setAttribute("aria-valuetext", `key frame ${this.frame}, ${timestamps[this.frame].toFixed(2)} s`);
    byId("now-frame").textContent = `${this.frame} / ${this.store.numFrames - 1}`;
    byId("now-time").textContent = `${timestamps[this.frame].toFixed(3)} s`;
    byId("now-opening").textContent = `${(1000 * opening[this.frame]).toFixed(1)} mm`;
    byId("now-c").textContent = genus ? genus[this.frame].length : "\u2013";
    byId("now-g").textContent = genus ? listed(genus[this.frame]) : "\u2013";
    byId("now-doubt").textContent = ambiguous[this.frame] ? `ambiguous: ${ambiguous[this.frame]}` : "";
    this.fillComponents();
    this.tellDepth();
    this.stage.setFrame(this.frame);
    document.documentElement.dataset.frame = this.frame;
  }

  /** A chip per component: its colour, genus and particles; crumbs last. */
  fillComponents() {
    const { genus, style } = this.store.header;
    const counts = new Array(256).fill(0);
    for (const label of this.store.labels(this.frame)) counts[label]++;
    const chip = (colour, text) => {
      const made = element("li", "chip");
      const dot = element("i");
      dot.style.background = `rgb(${colour.map((part) => Math.round(255 * part)).join(" ")})`;
      made.append(dot, text);
      return made;
    };
    const chips = (genus ? genus[this.frame] : []).map((g, k) =>
      chip(style.palette[k % 8], `${k} \u00b7 genus ${g} \u00b7 ${counts[k]} particles`),
    );
    if (genus && counts[255]) chips.push(chip(style.crumb, `crumbs \u00b7 ${counts[255]} particles`));
    byId("components").replaceChildren(...chips);
  }

  tellDepth() {
    const shown = this.stage.visible.has("depth") ? this.store.depthFrame(this.frame) : this.frame;
    const pixels = this.stage.has("depth") ? this.store.header.depth.windows[0].stride : 1;
    const notes = [];
    if (shown !== this.frame) notes.push(`depth of key frame ${shown}`);
    if (this.stage.visible.has("depth") && pixels > 1) notes.push(`one pixel of ${pixels} \u00d7 ${pixels}`);
    byId("now-depth").textContent = notes.join("; ");
  }

  /** Play by the scene's own time, over and over, with a rest at the end. */
  play(on) {
    this.playing = on;
    byId("play").textContent = on ? "\u275a\u275a" : "\u25b6";
    byId("play").setAttribute("aria-label", on ? "pause" : "play");
    if (!on) return;
    const { timestamps } = this.store.header;
    const last = this.store.numFrames - 1;
    let time = timestamps[this.frame === last ? 0 : this.frame];
    let before = performance.now();
    const step = (now) => {
      if (!this.playing) return;
      const speed = Number(byId("speed").value);
      time += (Math.max(0, now - before) / 1000) * speed;
      before = now;
      if (time > timestamps[last] + REST * speed) time = timestamps[0];
      const later = timestamps.findIndex((stamp) => stamp > time);
      const frame = later < 0 ? last : Math.max(0, later - 1);
      if (frame !== this.frame) this.setFrame(frame);
      requestAnimationFrame(step);
    };
    requestAnimationFrame(step);
  }

  turnTheme() {
    const root = document.documentElement;
    const dark = root.dataset.theme ? root.dataset.theme === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
    root.dataset.theme = dark ? "light" : "dark";
    this.recolour();
  }

  recolour() {
    const names = ["stage", "table", "grid", "shadow", "ink", "tool"];
    this.stage.setColours(Object.fromEntries(names.map((name) => [name, cssColour(`--${name}`)])));
  }
}

/** Start; what goes wrong is said on the page. */
async function start() {
  try {
    const header = JSON.parse(byId("header-data").textContent);
    const arrays = await unpackArrays(header.arrays, byId("packed-data").textContent);
    window.doughPage = new Page(new SceneStore(header, arrays));
    document.documentElement.dataset.ready = "yes";
  } catch (error) {
    byId("trouble").textContent = `This page cannot be shown: ${error.message}.`;
    byId("trouble").hidden = false;
    throw error;
  }
}

start();
