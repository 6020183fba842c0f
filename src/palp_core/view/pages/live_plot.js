// A plot that is given points as they come: it keeps those of its window and draws at most once a frame.
import uPlot from "palp-uplot";

const MOST = 8000; // points of a series in the browser
const COLUMNS = 600; // of the window: of each the lowest and the highest point are drawn
const STILL_MS = 300; // after the last points the time axis goes on for so long
const FRAME_MS = 30; // between two drawings for the sake of the time axis alone
const SLOW_MS = 12; // a browser that takes longer to draw draws new points only
const UNSEEN_MS = 1000; // a page that nobody sees takes points so often
const COLOURS = ["--plot-0", "--plot-1", "--plot-2", "--plot-3", "--plot-4", "--plot-5"];

// Of each column the lowest and the highest, as they came, and a gap, a point without a value, if there is one.
// Columns stand still while the window moves on.
export function thinned(points, span) {
  if (points.length <= 2 * COLUMNS || !span) return points;
  const found = [];
  const width = span / COLUMNS;
  let low, high, gap, column = NaN;
  const put = () => {
    if (low === undefined) return;
    if (low === high) found.push(low);
    else if (low[0] <= high[0]) found.push(low, high);
    else found.push(high, low);
    low = high = undefined;
  };
  for (const point of points) {
    const at = Math.floor(point[0] / width);
    if (at !== column) {
      put();
      column = at;
      gap = false;
    }
    if (point[1] === null) {
      put();
      if (!gap) found.push(point);
      gap = true;
    } else if (low === undefined) low = high = point;
    else if (point[1] < low[1]) low = point;
    else if (point[1] > high[1]) high = point;
  }
  put();
  return found;
}

export const tidy = (value) => String(Number(value.toPrecision(10))); // of 0.9999999999998999

// Columns for uPlot: all times, and of each series its values at them. Null ends a line, undefined does not.
export function aligned(lists) {
  const columns = lists.map((list) => [list.map((point) => point[0]), list.map((point) => point[1])]);
  return columns.length > 1 ? uPlot.join(columns) : columns[0] || [[]];
}

export default {
  template: `<div class="live-plot" role="img" :aria-label="'plot of ' + names.join(', ')"></div>`,
  props: { names: Array, span: Number, paused: Boolean, file: String, slim: Boolean, even: Boolean, title: String, along: String },
  mounted() {
    this.clear();
    document.addEventListener("visibilitychange", this.unseen);
    this.resizer = new ResizeObserver(() => this.fit());
    this.resizer.observe(this.$el);
    this.looks = new MutationObserver(() => this.restart()); // light and dark
    this.looks.observe(document.body, { attributes: true, attributeFilter: ["class"] });
    this.restart();
  },
  beforeUnmount() {
    document.removeEventListener("visibilitychange", this.unseen);
    this.resizer.disconnect();
    this.looks.disconnect();
    this.plot.destroy();
    this.plot = null;
  },
  watch: {
    names(now, before) { // another list is given with every change of anything
      if (String(now) === String(before)) return;
      this.clear();
      this.restart();
    },
    span() { this.zoomed = false; this.wanted(); },
    paused() { this.wanted(); },
  },
  methods: {
    clear() {
      this.points = this.names.map(() => []);
      this.wanted();
    },
    restart() {
      if (this.plot) this.plot.destroy();
      this.zoomed = false;
      this.edge = -Infinity;
      const look = getComputedStyle(document.body), colour = (name) => look.getPropertyValue(name).trim();
      const line = { stroke: colour("--line"), width: 1 }, font = "12px system-ui, sans-serif";
      const axis = { show: this.names.length > 0, stroke: look.color, font, labelFont: font, labelSize: 18, grid: line, ticks: line };
      const units = this.names.map((name) => (name.match(/ \[(.*)\]$/) || ["", ""])[1]);
      const unit = units.every((one) => one === units[0]) ? units[0] : ""; // the legend has each
      const value = (_, one) => (one === null || one === undefined ? "\u2013" : tidy(one));
      const series = this.names.map((name, i) => {
        const stroke = colour(COLOURS[i % COLOURS.length]);
        return { label: name, stroke, value, width: 1.5, points: { show: (plot, at, from, to) => to - from < 12 } };
      });
      const options = {
        ...this.room(),
        scales: { x: { time: false } },
        legend: { show: this.names.length > 0, live: !this.slim },
        cursor: { drag: { x: true, y: false }, bind: { dblclick: () => () => this.unzoom() } },
        axes: [{ ...axis, ...this.titled(this.along), size: 34, values: (_, ticks) => ticks.map(this.points.some((list) => list.length) ? tidy : () => "") },
          { ...axis, ...this.titled(unit), size: 70, space: this.slim ? 14 : 30, values: (_, ticks) => ticks.map(tidy) }],
        series: [{ label: "s", value }, ...series],
        hooks: { setSelect: [(plot) => { this.zoomed = this.zoomed || plot.select.width > 0; }] },
      };
      this.plot = new uPlot(options, [[], ...series.map(() => [])], this.$el);
      this.fit();
      if (this.paused) this.show();
      else this.wanted();
    },
    titled(words) { // of an axis; a slim plot has no room for it
      return words && !this.slim ? { label: words } : {};
    },
    room() {
      const below = this.slim ? 28 : 54; // for the legend, two lines of it at most
      return { width: this.$el.clientWidth || 300, height: Math.max(this.$el.clientHeight - below, 60) };
    },
    fit() {
      const { width, height } = this.room();
      if (this.plot && (width !== this.plot.width || height !== this.plot.height)) this.plot.setSize({ width, height });
    },
    unzoom() {
      this.zoomed = false;
      this.show();
    },
    acknowledge() { // so the server sends what comes next, and never more than what can be drawn
      if (this.given !== undefined) this.$emit("taken", this.given);
      this.given = undefined;
    },
    unseen() { // what nobody sees is kept, and drawn when it is looked at again
      if (document.hidden && !this.waits) this.waits = setTimeout(() => { this.waits = 0; this.acknowledge(); }, UNSEEN_MS);
    },
    add(batches, number) {
      this.given = number;
      this.came = performance.now();
      batches.forEach((batch, i) => {
        const kept = this.points[i];
        if (!kept || !batch.length) return;
        if (kept.length && batch[0][0] < kept[kept.length - 1][0] - 1) this.start_again(kept);
        kept.push(...batch);
        const begin = kept[kept.length - 1][0] - this.span;
        let old = Math.max(kept.length - MOST, 0);
        while (old < kept.length && kept[old][0] < begin) old++;
        if (old) kept.splice(0, old);
      });
      this.wanted();
    },
    start_again(kept) {
      kept.length = 0;
      this.edge = -Infinity;
    },
    wanted() {
      this.unseen();
      if (this.asked) return;
      this.asked = true;
      requestAnimationFrame(() => {
        this.asked = false;
        this.acknowledge();
        if (!this.plot || this.paused) return;
        this.show();
        this.go_on();
      });
    },
    show() {
      const whole = !this.zoomed; // a zoomed plot is drawn point by point
      this.draw(aligned(this.points.map((list) => (whole ? thinned(list, this.span) : list))));
    },
    // Draw, and now rather than in the next frame: then it is known how long that takes.
    draw(data) {
      const newest = Math.max(...this.points.map((list) => (list.length ? list[list.length - 1][0] : -Infinity)));
      this.drawn = performance.now();
      this.plot.batch(() => {
        if (data) this.plot.setData(data, false);
        this.plot.setScale("x", this.zoomed ? this.plot.scales.x : this.window_at(newest));
      });
      this.took_ms = performance.now() - this.drawn;
      this.$el.dataset.newest = newest;
      this.$el.dataset.points = this.points.reduce((sum, list) => sum + list.length, 0);
      this.$el.dataset.frames = Number(this.$el.dataset.frames || 0) + 1;
    },
    // The window ends at the newest point and moves on evenly until the next comes.
    window_at(newest) {
      if (!Number.isFinite(newest)) return { min: 0, max: 1 };
      const since_s = !this.even ? 0 : Math.min(this.drawn - this.came, STILL_MS) / 1000;
      this.edge = Math.max(this.edge, newest + since_s);
      const oldest = Math.min(...this.points.map((list) => (list.length ? list[0][0] : Infinity)));
      const min = Math.max(oldest, this.edge - this.span);
      return { min, max: Math.max(this.edge, min + 1e-3) };
    },
    go_on() {
      if (this.moving || !this.even || this.took_ms > SLOW_MS) return;
      this.moving = true;
      requestAnimationFrame((now) => {
        this.moving = false;
        if (!this.plot || this.paused || this.asked || this.zoomed || now - this.came > STILL_MS) return;
        if (now - this.drawn >= FRAME_MS) this.draw();
        this.go_on();
      });
    },
    save() { // what is drawn, with what it is of and the names of the series above it
      const from = this.plot.ctx.canvas, line = 24 * devicePixelRatio, head = (this.title ? 2 : 1) * line, look = getComputedStyle(document.body);
      const whole = Object.assign(document.createElement("canvas"), { width: from.width, height: from.height + head });
      const ink = whole.getContext("2d");
      ink.fillStyle = look.backgroundColor;
      ink.fillRect(0, 0, whole.width, whole.height);
      ink.drawImage(from, 0, head);
      ink.font = `${13 * devicePixelRatio}px system-ui, sans-serif`;
      let x = 70 * devicePixelRatio;
      if (this.title) {
        ink.fillStyle = look.color;
        ink.fillText(`${this.title}, over ${this.along}`, x, 0.75 * line);
      }
      this.names.forEach((name, i) => {
        ink.fillStyle = look.getPropertyValue(COLOURS[i % COLOURS.length]).trim();
        ink.fillText(name, x, head - 0.25 * line);
        x += ink.measureText(name).width + line;
      });
      const link = document.createElement("a");
      link.href = whole.toDataURL("image/png");
      link.download = this.file;
      link.click();
    },
  },
};
