// Torque against the stage's position: the sweep under way over the bands of what training taught.
import { echarts } from "nicegui-echart";

const COLOURS = ["--plot-0", "--plot-1", "--plot-2", "--plot-3", "--plot-4", "--plot-5"];
const DASHES = ["solid", "dashed", "dotted"];

export default {
  template: `<div class="rig-chart" role="img" :aria-label="words"></div>`,
  props: { bands: Array, from: Number, to: Number, words: String },
  mounted() {
    this.points = [];
    this.chart = echarts.init(this.$el);
    this.resizer = new ResizeObserver(() => this.chart.resize());
    this.resizer.observe(this.$el);
    this.looks = new MutationObserver(() => this.restart()); // light and dark
    this.looks.observe(document.body, { attributes: true, attributeFilter: ["class"] });
    this.restart();
  },
  beforeUnmount() {
    this.resizer.disconnect();
    this.looks.disconnect();
    this.chart.dispose();
  },
  watch: {
    bands() { this.restart(); },
    from() { this.restart(); },
    to() { this.restart(); },
  },
  methods: {
    colour(name) { return getComputedStyle(document.body).getPropertyValue(name).trim(); },
    restart() {
      if (!this.chart) return;
      const ink = this.colour("--ink");
      const label = { color: ink, fontSize: 13 };
      const axis = { type: "value", axisLabel: label, nameTextStyle: label, nameLocation: "middle", axisLine: { onZero: false, lineStyle: { color: ink } },
        splitLine: { lineStyle: { color: this.colour("--line"), opacity: 0.5 } } };
      const series = [];
      this.bands.forEach((band, i) => {
        const colour = this.colour(COLOURS[i % COLOURS.length]);
        const edge = { type: "line", symbol: "none", silent: true, stack: "band" + i, stackStrategy: "all",
          lineStyle: { color: colour, width: 1.5, type: DASHES[i % DASHES.length] } };
        series.push({ ...edge, data: band.places.map((x, k) => [x, band.low[k]]) });
        series.push({ ...edge, name: band.label, itemStyle: { color: colour }, areaStyle: { color: colour, opacity: 0.22 },
          data: band.places.map((x, k) => [x, band.high[k] - band.low[k]]) });
      });
      series.push({ id: "sweep", name: "this sweep", type: "line", symbol: "none", z: 5, sampling: "minmax",
        lineStyle: { color: ink, width: 2.5 }, itemStyle: { color: ink }, data: this.points });
      this.chart.setOption({
        animation: false,
        legend: { data: [...this.bands.map((band) => band.label), "this sweep"], top: 0, textStyle: label },
        grid: { left: 62, right: 18, top: this.bands.length > 3 || this.$el.clientWidth < 480 ? 74 : 40, bottom: 48 },
        xAxis: { ...axis, name: "stage position, mm", nameGap: 28, min: Math.min(this.from, this.to), max: Math.max(this.from, this.to) },
        yAxis: { ...axis, name: "torque, N mm", nameGap: 42, scale: true },
        series,
      }, true);
    },
    begin(points, number) {
      this.$emit("taken", number);
      this.points = [...points];
      this.wanted();
    },
    add(points, number) {
      this.$emit("taken", number);
      this.points.push(...points);
      this.wanted();
    },
    wanted() {
      if (this.asked) return;
      this.asked = true;
      requestAnimationFrame(() => {
        this.asked = false;
        this.chart.setOption({ series: [{ id: "sweep", data: this.points }] });
        this.$el.dataset.points = this.points.length;
      });
    },
  },
};
