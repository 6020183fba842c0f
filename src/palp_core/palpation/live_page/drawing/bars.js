// Shares as bars, each with its words; readable as a list.
export default {
  template: `<ul class="rig-bars" :aria-label="words"><li v-for="row in rows" :class="{ most: row.most }">
    <span class="rig-bar-name">{{ row.label }}</span>
    <span class="rig-bar" aria-hidden="true"><span :style="{ width: 100 * row.share + '%' }"></span></span>
    <span class="rig-bar-share">{{ row.text }}</span></li></ul>`,
  props: { rows: Array, words: String },
};
