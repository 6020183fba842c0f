// Events on a time axis, a lane for each node. All that is shown comes as text: Vue escapes what stands in {{ }}.
export default {
  template: `<div class="timeline" role="group" aria-label="events over time">
      <div v-for="lane in lanes" :key="lane.name" class="lane">
        <span class="lane-name">{{ lane.name }}</span>
        <span class="lane-line">
          <button v-for="mark in lane.marks" :key="mark.rows[0]" type="button" :style="{ left: mark.at + '%' }"
            :class="['mark', mark.level, { chosen: chosen.includes(mark.rows[0]) }]" :aria-label="lane.name + ', ' + mark.words"
            :title="mark.words" @click="$emit('chosen', mark.rows)">{{ mark.sign }}</button>
        </span>
      </div>
      <div class="lane axis" aria-hidden="true"><span class="lane-name">s</span><span class="lane-line">
        <span v-for="tick in ticks" :key="tick.text" class="tick" :style="{ left: tick.at + '%' }">{{ tick.text }}</span>
      </span></div>
    </div>`,
  props: { lanes: Array, ticks: Array, chosen: Array },
};
