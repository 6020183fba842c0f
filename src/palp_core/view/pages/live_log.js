// A log from plain data. Texts come as text: Vue escapes whatever stands between {{ and }}.
export default {
  template: `
    <div class="log" role="log" tabindex="0" @scroll="follow">
      <div v-for="record in records" :class="record.look"><span>{{ record.text }} </span
        ><span v-if="record.count > 1" class="pill often">{{ record.count }} times, this is the latest</span></div>
    </div>`,
  props: { records: Array },
  data: () => ({ following: true }),
  mounted() {
    this.show();
  },
  watch: {
    records() {
      this.$nextTick(() => this.show());
    },
  },
  methods: {
    show() { // the latest stays in sight, unless somebody has scrolled to an older one
      if (this.following) this.$el.scrollTop = this.$el.scrollHeight;
    },
    follow() {
      this.following = this.$el.scrollHeight - this.$el.scrollTop - this.$el.clientHeight < 20;
    },
  },
};
