// A button whose press is a request of its own: it needs no socket, is sent again until it is answered, and the
// space bar presses it wherever one is but in a field.
const AGAIN_MS = 250; // after a request that did not come through
const GIVE_UP_MS = 20000;
const LATE_MS = 1000; // without an answer: then somebody should know
const TYPED = "input:not([type=checkbox]):not([type=radio]):not([type=range]):not([type=button]), textarea, select, [contenteditable=true]";

export default {
  template: `<span class="urgent">
      <button type="button" class="urgent-button" :disabled="!!refusal" @click="press"
        :aria-label="label + ' (space bar)'" :title="refusal || 'one click, or the space bar'">{{ label }}</button>
      <span role="alert" :class="level">{{ words }}</span>
    </span>`,
  props: { name: String, label: String, refusal: { type: String, default: "" }, done: { type: String, default: "ok" } },
  data: () => ({ words: "", level: "" }),
  mounted() {
    document.addEventListener("keydown", this.down, true);
    document.addEventListener("keyup", this.up, true);
  },
  beforeUnmount() {
    document.removeEventListener("keydown", this.down, true);
    document.removeEventListener("keyup", this.up, true);
  },
  methods: {
    isSpace(event) {
      const plain = event.key === " " && !event.ctrlKey && !event.altKey && !event.metaKey;
      return plain && !(event.target instanceof Element && event.target.closest(TYPED));
    },
    down(event) {
      if (this.refusal || !this.isSpace(event)) return;
      event.preventDefault(); // it neither scrolls nor presses what has the focus
      event.stopImmediatePropagation();
      if (!event.repeat) this.press();
    },
    up(event) {
      if (this.refusal || !this.isSpace(event)) return;
      event.preventDefault();
      event.stopImmediatePropagation();
    },
    async press() {
      const begun = performance.now();
      const address = `/${location.pathname.split("/")[1]}/press/${encodeURIComponent(this.name)}`;
      this.show(this.label + " is sent ...", "warn");
      while (performance.now() - begun < GIVE_UP_MS) {
        const late = setTimeout(() => this.show(this.label + " is sent and not answered: use the emergency stop", "error"), LATE_MS);
        try {
          const answer = await fetch(address, { method: "POST", keepalive: true, cache: "no-store" });
          this.show(await answer.text(), answer.ok ? this.done : "error");
          return;
        } catch {
          this.show(this.label + " has not arrived, it is sent again: use the emergency stop", "error");
          await new Promise((go) => setTimeout(go, AGAIN_MS));
        } finally {
          clearTimeout(late);
        }
      }
      this.show(this.label + " HAS NOT ARRIVED: palp view does not answer; use the emergency stop", "error");
    },
    show(words, level) {
      this.words = words;
      this.level = level;
    },
  },
};
