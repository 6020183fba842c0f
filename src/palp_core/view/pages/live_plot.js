// A plot that is given points as they come: it keeps those of its window and draws at most once a frame.
import { echarts } from "nicegui-echart";

const MOST = 8000; // points of a series in the browser
const COLOURS = ["#005f9e", "#b34700", "#00684a", "#8b3a8b", "#7a6000", "#b00020"];

export default {
  template: `<div class="live-plot" role="img" :aria-label="'plot of ' + names.join(', ')"></div>`,
  props: { names: Array, span: Number, paused: Boolean, elements: Boolean, file: String, slim: Boolean },
  mounted() {
    this.clear();
    this.chart = echarts.init(this.$el);
    this.resizer = new ResizeObserver(() => this.chart.resize());
    this.resizer.observe(this.$el);
    this.restart();
  },
  beforeUnmount() {
    this.resizer.disconnect();
    this.chart.dispose();
  },
  watch: {
    names() { this.clear(); this.restart(); },
    elements() { this.clear(); this.restart(); },
    paused() { this.wanted(); },
  },
  methods: {
    clear() {
      this.points = this.names.map(() => []);
      this.wanted();
    },
    restart() {
      if (!this.chart) return;
      const ink = getComputedStyle(document.body).color;
      const axis = { scale: true, axisLabel: { color: ink }, nameTextStyle: { color: ink } };
      this.chart.setOption({
        animation: false,
        color: COLOURS,
        legend: { data: this.names, top: 0, textStyle: { color: ink } },
        grid: { left: 70, right: 30, top: this.slim ? 30 : 40, bottom: this.slim ? 24 : 80 },
        tooltip: { trigger: "axis", renderMode: "richText" },
        xAxis: { ...axis, type: "value", name: this.elements ? "element" : "s" },
        yAxis: { ...axis, type: "value" },
        dataZoom: this.slim ? [] : [{ type: "inside" }, { type: "slider" }],
        series: this.names.map((name) => ({ name, type: "line", symbol: "none", sampling: "minmax", data: [] })),
      }, true);
    },
    add(batches, number) {
      this.$emit("taken", number);
      batches.forEach((batch, i) => {
        const kept = this.points[i];
        if (!kept || !batch.length) return;
        if (kept.length && batch[0][0] < kept[kept.length - 1][0] - 1) kept.length = 0; // time began anew
        kept.push(...batch);
        const begin = kept[kept.length - 1][0] - this.span;
        let old = Math.max(kept.length - MOST, 0);
        while (old < kept.length && kept[old][0] < begin) old++;
        if (old) kept.splice(0, old);
      });
      this.wanted();
    },
    put(lists, number) {
      this.$emit("taken", number);
      this.points = lists.map((list) => list.map((value, i) => [i, value]));
      this.wanted();
    },
    wanted() {
      if (this.asked) return;
      this.asked = true;
      requestAnimationFrame(() => {
        this.asked = false;
        if (!this.chart || this.paused) return;
        this.chart.setOption({ series: this.points.map((data) => ({ data })) });
        this.$el.dataset.newest = Math.max(...this.points.map((list) => list.length ? list[list.length - 1][0] : -Infinity));
        this.$el.dataset.points = this.points.reduce((sum, list) => sum + list.length, 0);
        this.$el.dataset.frames = Number(this.$el.dataset.frames || 0) + 1;
      });
    },
    save() {
      const link = document.createElement("a");
      link.href = this.chart.getDataURL({ type: "png", pixelRatio: 2, backgroundColor: "#fff" });
      link.download = this.file;
      link.click();
    },
  },
};
