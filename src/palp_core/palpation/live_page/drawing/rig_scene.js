// Stage, probe, ring and phantom to scale, from the side; 1 unit is 1 mm. What is asked for is gone to within a look.
export default {
  template: `<div class="drawing rig-scene"><svg :viewBox="box" role="img" :aria-label="words">
    <rect class="floor" :x="left" :y="size.slab" :width="wide" height="4"/>
    <rect class="gel" :x="left + 8" y="0" :width="wide - 16" :height="size.slab" rx="1"/>
    <g v-if="bead > 0" data-what="bead">
      <circle class="bead" cx="0" :cy="bead + size.bead" :r="size.bead"/>
      <text x="11" :y="bead + size.bead + 2" class="label">bead, {{ bead }} mm deep</text>
    </g>
    <line class="path" :x1="size.from" :x2="size.to" :y1="size.slab + 9" :y2="size.slab + 9"/>
    <line v-for="end in [size.from, 0, size.to]" class="path" :x1="end" :x2="end" :y1="size.slab + 7" :y2="size.slab + 11"/>
    <text v-for="end in [size.from, 0, size.to]" class="label middle" :x="end" :y="size.slab + 18">{{ end }}</text>
    <text class="label" :x="Math.max(size.from, size.to) + 9" :y="size.slab + 18">mm</text>
    <g :transform="'translate(' + at.y + ' ' + lowest + ')'" data-what="probe">
      <rect class="stage" x="-14" :y="-arm - 12" width="28" height="9" rx="1.5"/>
      <text class="label" :class="{ end: at.y > 0 }" :x="at.y > 0 ? -17 : 17" :y="-arm - 5">{{ known.y ? "stage " + at.y.toFixed(0) + " mm" : "stage: unknown" }}</text>
      <rect class="sensor" x="-7" :y="-arm - 3" width="14" height="5"/>
      <line class="link" x1="0" x2="0" :y1="-arm + 2" :y2="-size.tip"/>
      <g :transform="'rotate(' + at.lean + ' 0 ' + -size.tip + ')'">
        <line class="link" x1="0" x2="0" :y1="-size.tip" :y2="-size.ball"/>
        <circle class="ball" cx="0" :cy="-size.ball" :r="size.ball"/>
        <line class="pivot" :x1="-size.pivot" :x2="size.pivot" :y1="-size.tip" :y2="-size.tip"/>
      </g>
      <line class="spring" :x1="0" :x2="-ends.x" :y1="-size.tip - at.ring" :y2="-size.tip - ends.y"/>
      <line class="spring" :x1="0" :x2="ends.x" :y1="-size.tip - at.ring" :y2="-size.tip + ends.y"/>
      <rect class="ring" x="-9" :y="-size.tip - at.ring - 1.5" width="18" height="3" rx="1.5"/>
      <text class="label" :class="{ end: at.y > 0 }" :x="at.y > 0 ? -13 : 13" :y="-size.tip - at.ring + 1">{{ known.ring ? "ring " + at.ring.toFixed(1) + " mm" : "ring: unknown" }}</text>
      <circle class="joint" cx="0" :cy="-size.tip" r="1.8"/>
    </g>
  </svg></div>`,
  props: { size: Object, bead: { type: Number, default: 0 }, words: String },
  data() { return { at: { y: this.size.from, ring: 0, lean: 0, lift: this.size.lift }, known: {} }; },
  computed: {
    arm() { return this.size.base + this.size.tip; },
    left() { return Math.min(this.size.from, this.size.to) - 54; }, // the tip leans as far out
    wide() { return Math.abs(this.size.to - this.size.from) + 108; },
    box() { return `${this.left} ${-this.arm - 36} ${this.wide + 12} ${this.arm + this.size.slab + 58}`; },
    lowest() { return this.size.indentation - this.at.lift; },
    ends() {
      const turned = (this.at.lean * Math.PI) / 180;
      return { x: this.size.pivot * Math.cos(turned), y: this.size.pivot * Math.sin(turned) };
    },
  },
  beforeUnmount() { cancelAnimationFrame(this.frame); },
  methods: {
    go(goal, withinMs, number) {
      this.$emit("taken", number);
      for (const name of Object.keys(goal)) this.known[name] = true;
      const from = { ...this.at }, begun = performance.now();
      cancelAnimationFrame(this.frame);
      const step = (now) => {
        const share = Math.min(Math.max((now - begun) / withinMs, 0), 1); // a frame may have begun before
        for (const name of Object.keys(goal)) this.at[name] = from[name] + share * (goal[name] - from[name]);
        this.$el.dataset.frames = Number(this.$el.dataset.frames || 0) + 1;
        if (share < 1) this.frame = requestAnimationFrame(step);
      };
      this.frame = requestAnimationFrame(step);
    },
  },
};
