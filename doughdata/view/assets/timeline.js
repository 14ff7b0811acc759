// The time line: runs of equal topology, events, frames in doubt and frames with depth, over the slider.

const SHORT = { merge: "M", split: "S", self_merge: "m", self_split: "s" };
const LANES = 3;

/** An element with a class and attributes; text is never read as markup. */
function element(tag, className, attributes = {}, text = "") {
  const made = document.createElement(tag);
  if (className) made.className = className;
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  made.textContent = text;
  return made;
}

/** "0, 1" of a list, "none" of an empty one. */
function listed(values) {
  return values.length ? values.join(", ") : "none";
}

class Timeline {
  /** `choose(frame)` is called when a mark is clicked. */
  constructor(root, store, choose) {
    this.root = root;
    this.store = store;
    this.choose = choose;
    this.tip = document.getElementById("tip");
    this.addRuns();
    this.addDoubts();
    this.addDepth();
    this.addEvents();
    document.addEventListener("keydown", (event) => event.key === "Escape" && this.hideTip());
  }

  /** Left edge of a mark: the slider's thumb is as wide as the margin on both sides together. */
  left(frame) {
    const part = frame / Math.max(this.store.numFrames - 1, 1);
    const inside = Math.max(0, Math.min(1, part));
    return `calc(var(--thumb) / 2 + (100% - var(--thumb)) * ${inside})`;
  }

  /** A bar over the key frames first..last, half a frame more on both sides. */
  bar(row, className, first, last) {
    const made = element("div", className);
    made.style.left = this.left(first - 0.5);
    const ends = [first - 0.5, last + 0.5].map((f) => Math.max(0, Math.min(this.store.numFrames - 1, f)));
    const part = (ends[1] - ends[0]) / Math.max(this.store.numFrames - 1, 1);
    made.style.width = `calc((100% - var(--thumb)) * ${part})`;
    this.root.querySelector(row).append(made);
    return made;
  }

  /** Runs [first, last, value] of equal values. */
  runs(values) {
    const runs = [];
    values.forEach((value, frame) => {
      const last = runs[runs.length - 1];
      if (last && last.value === value) last.last = frame;
      else runs.push({ value, first: frame, last: frame });
    });
    return runs;
  }

  addRuns() {
    const { genus } = this.store.header;
    if (!genus) return;
    this.runs(genus.map((g) => `c ${g.length} \u00b7 g ${listed(g)}`)).forEach((run, number) => {
      const bar = this.bar(".runs", number % 2 ? "run odd" : "run", run.first, run.last);
      bar.append(element("span", "", {}, run.value));
      this.explain(bar, () => [run.value, this.span(run)]);
    });
  }

  addDoubts() {
    for (const run of this.runs(this.store.header.ambiguous)) {
      if (!run.value) continue;
      const bar = this.bar(".runs", "doubt", run.first, run.last);
      bar.tabIndex = 0;
      bar.setAttribute("role", "note");
      bar.setAttribute("aria-label", `ambiguous, ${this.span(run)}: ${run.value}`);
      const { genus } = this.store.header;
      this.explain(bar, () => ["ambiguous", run.value, this.span(run), `c ${genus[run.first].length} \u00b7 g ${listed(genus[run.first])}`]);
    }
  }

  addDepth() {
    for (const frame of this.store.depthFrames ?? []) {
      const tick = element("div", "tick");
      tick.style.left = this.left(frame);
      this.root.querySelector(".ticks").append(tick);
    }
  }

  /** A badge per key frame with events; badges that would touch go into another lane. */
  addEvents() {
    const byFrame = new Map();
    for (const event of this.store.header.events) {
      if (!byFrame.has(event.frame)) byFrame.set(event.frame, []);
      byFrame.get(event.frame).push(event);
    }
    const row = this.root.querySelector(".events");
    const ends = new Array(LANES).fill(-Infinity); // frame of the last badge of each lane
    const apart = (this.store.numFrames * 26) / 800; // frames a badge is wide on a line of 800 px
    for (const [frame, events] of [...byFrame].sort((a, b) => a[0] - b[0])) {
      let lane = ends.findIndex((end) => frame - end >= apart);
      if (lane < 0) lane = ends.indexOf(Math.min(...ends));
      ends[lane] = frame;
      const kinds = [...new Set(events.map((event) => event.kind))];
      const badge = element("button", `event ${kinds.length > 1 ? "mixed" : kinds[0]}`, { type: "button" });
      badge.textContent = kinds.map((kind) => SHORT[kind] ?? "?").join("");
      badge.style.left = this.left(frame);
      badge.style.setProperty("--lane", lane);
      const lines = [`key frame ${frame}`, ...events.map((event) => this.told(event))];
      badge.setAttribute("aria-label", lines.join("; "));
      badge.addEventListener("click", () => this.choose(frame));
      this.explain(badge, () => lines);
      row.append(badge);
    }
    row.style.setProperty("--lanes", Math.max(1, ends.filter((end) => end > -Infinity).length));
  }

  /** One line about an event. */
  told(event) {
    const margin = event.margin === null ? "\u2013" : event.margin.toFixed(2);
    const change = `${listed(event.components_before)} \u2192 ${listed(event.components_after)}`;
    return `${event.kind.replace("_", "-")}: components ${change}, margin ${margin}`;
  }

  span({ first, last }) {
    return first === last ? `key frame ${first}` : `key frames ${first}\u2013${last}`;
  }

  /** Show lines in the tooltip while the pointer or the focus is on an element. */
  explain(target, lines) {
    const show = () => {
      this.tip.replaceChildren(...lines().map((line, k) => element("div", k ? "" : "first", {}, line)));
      this.tip.hidden = false;
      const [at, size] = [target.getBoundingClientRect(), this.tip.getBoundingClientRect()];
      const left = at.left + at.width / 2 - size.width / 2;
      this.tip.style.left = `${Math.max(6, Math.min(innerWidth - size.width - 6, left))}px`;
      this.tip.style.top = `${at.top - size.height - 8}px`;
    };
    for (const name of ["pointerenter", "focus"]) target.addEventListener(name, show);
    for (const name of ["pointerleave", "blur"]) target.addEventListener(name, () => this.hideTip());
  }

  hideTip() {
    this.tip.hidden = true;
  }
}
