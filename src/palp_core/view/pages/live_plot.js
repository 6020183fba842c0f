// A plot that is given points as they come: it keeps those of its window and draws at most once a frame.
import { echarts } from "nicegui-echart";

const MOST = 8000; // points of a series in the browser
const COLUMNS = 600; // of the window: of each the lowest and the highest point are drawn
const STILL_MS = 300; // after the last points the time axis goes on for so long
const FRAME_MS = 30; // between two drawings for the sake of the time axis alone
const SLOW_MS = 12; // a browser that takes longer to draw draws new points only
const COLOURS = ["--plot-0", "--plot-1", "--plot-2", "--plot-3", "--plot-4", "--plot-5"];

// Of each column the lowest and the highest, as they came. Columns stand still while the window moves on.
export function thinned(points, span) {
  if (points.length <= 2 * COLUMNS || !span) return points;
  const found = [];
  const width = span / COLUMNS;
  let low, high, column = NaN;
  const put = () => {
    if (low === undefined) return;
    if (low === high) found.push(low);
    else if (low[0] <= high[0]) found.push(low, high);
    else found.push(high, low);
  };
  for (const point of points) {
    const at = Math.floor(point[0] / width);
    if (at !== column) {
      put();
      column = at;
      low = high = point;
    } else if (point[1] < low[1]) low = point;
    else if (point[1] > high[1]) high = point;
  }
  put();
  return found;
}

export const tidy = (value) => String(Number(value.toPrecision(10))); // of 0.9999999999998999

export default {
  template: `<div class="live-plot" role="img" :aria-label="'plot of ' + names.join(', ')"></div>`,
  props: { names: Array, span: Number, paused: Boolean, elements: Boolean, file: String, slim: Boolean, even: Boolean },
  mounted() {
    this.clear();
    this.chart = echarts.init(this.$el);
    this.chart.on("datazoom", () => this.zoomed());
    document.addEventListener("visibilitychange", this.unseen);
    this.resizer = new ResizeObserver(() => this.chart.resize());
    this.resizer.observe(this.$el);
    this.looks = new MutationObserver(() => this.restart()); // light and dark
    this.looks.observe(document.body, { attributes: true, attributeFilter: ["class"] });
    this.restart();
  },
  beforeUnmount() {
    document.removeEventListener("visibilitychange", this.unseen);
    this.resizer.disconnect();
    this.looks.disconnect();
    this.chart.dispose();
  },
  watch: {
    names() { this.clear(); this.restart(); },
    elements() { this.clear(); this.restart(); },
    span() { this.wanted(); },
    paused() { this.wanted(); },
  },
  methods: {
    clear() {
      this.points = this.names.map(() => []);
      this.wanted();
    },
    restart() {
      if (!this.chart) return;
      this.whole = true;
      this.edge = -Infinity;
      const look = getComputedStyle(document.body), ink = look.color;
      const label = { color: ink, showMinLabel: false, showMaxLabel: false };
      const splitLine = { lineStyle: { color: look.getPropertyValue("--line").trim(), opacity: 0.5 } };
      const axis = { scale: true, axisLabel: { color: ink }, nameTextStyle: { color: ink }, splitLine };
      this.chart.setOption({
        animation: false,
        color: COLOURS.map((name) => look.getPropertyValue(name).trim()),
        legend: { data: this.names, top: 0, textStyle: { color: ink } },
        grid: { left: 70, right: 30, top: this.slim ? 30 : 40, bottom: this.slim ? 24 : 80 },
        tooltip: { trigger: "axis", renderMode: "richText" },
        xAxis: { ...axis, axisLabel: this.elements ? axis.axisLabel : label, type: "value", name: this.elements ? "element" : "s" },
        yAxis: { ...axis, axisLabel: { color: ink, formatter: tidy }, type: "value" },
        dataZoom: this.slim ? [] : [{ type: "inside" }, { type: "slider" }],
        series: this.names.map((name, i) => ({ name, type: "line", symbol: "none", sampling: "minmax", data: this.points[i] || [] })),
      }, true);
    },
    zoomed() { // what is looked at closely is drawn point by point
      const { start, end } = this.chart.getOption().dataZoom[0];
      this.whole = end - start > 99;
      this.wanted();
    },
    tell() { // so the server sends what comes next, and never more than what can be drawn
      if (this.given !== undefined) this.$emit("taken", this.given);
      this.given = undefined;
    },
    unseen() { // what nobody sees is kept, and drawn when it is looked at again
      if (document.hidden) this.tell();
    },
    add(batches, number) {
      this.given = number;
      this.came = performance.now();
      batches.forEach((batch, i) => {
        const kept = this.points[i];
        if (!kept || !batch.length) return;
        if (kept.length && batch[0][0] < kept[kept.length - 1][0] - 1) this.begin_anew(kept);
        kept.push(...batch);
        const begin = kept[kept.length - 1][0] - this.span;
        let old = Math.max(kept.length - MOST, 0);
        while (old < kept.length && kept[old][0] < begin) old++;
        if (old) kept.splice(0, old);
      });
      this.wanted();
    },
    put(lists, number) {
      this.given = number;
      this.points = lists.map((list) => list.map((value, i) => [i, value]));
      this.wanted();
    },
    begin_anew(kept) {
      kept.length = 0;
      this.edge = -Infinity;
    },
    wanted() {
      this.unseen();
      if (this.asked) return;
      this.asked = true;
      requestAnimationFrame(() => {
        this.asked = false;
        this.tell();
        if (!this.chart || this.paused) return;
        const drawn = (list) => this.whole && !this.elements ? thinned(list, this.span) : list;
        this.draw({ series: this.points.map((list) => ({ data: drawn(list) })) });
        this.go_on();
      });
    },
    // Draw, and now rather than in the next frame: ECharts would wait for that.
    draw(option) {
      const newest = Math.max(...this.points.map((list) => list.length ? list[list.length - 1][0] : -Infinity));
      this.drawn = performance.now();
      if (!this.elements && Number.isFinite(newest)) option.xAxis = this.window_at(newest);
      this.chart.setOption(option);
      this.chart.getZr().flush();
      this.took_ms = performance.now() - this.drawn;
      this.$el.dataset.newest = newest;
      this.$el.dataset.points = this.points.reduce((sum, list) => sum + list.length, 0);
      this.$el.dataset.frames = Number(this.$el.dataset.frames || 0) + 1;
    },
    // The window ends at the newest point and moves on evenly until the next comes.
    window_at(newest) {
      const since_s = !this.even ? 0 : Math.min(this.drawn - this.came, STILL_MS) / 1000;
      this.edge = Math.max(this.edge, newest + since_s);
      const oldest = Math.min(...this.points.map((list) => list.length ? list[0][0] : Infinity));
      return { min: Math.max(oldest, this.edge - this.span), max: this.edge };
    },
    go_on() {
      if (this.moving || !this.even || this.elements || this.took_ms > SLOW_MS) return;
      this.moving = true;
      requestAnimationFrame((now) => {
        this.moving = false;
        if (!this.chart || this.paused || this.asked || !this.whole || now - this.came > STILL_MS) return;
        if (now - this.drawn >= FRAME_MS) this.draw({});
        this.go_on();
      });
    },
    save() {
      const link = document.createElement("a");
      link.href = this.chart.getDataURL({ type: "png", pixelRatio: 2, backgroundColor: getComputedStyle(document.body).backgroundColor });
      link.download = this.file;
      link.click();
    },
  },
};
