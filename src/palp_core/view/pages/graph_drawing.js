// The graph as SVG. Names and words come as text: Vue escapes whatever stands between {{ and }}.
export default {
  template: `
    <div class="drawing graph">
      <svg :viewBox="'0 0 ' + width + ' ' + height" :width="width" :style="{ minWidth: 0.8 * width + 'px' }" role="group" aria-label="graph">
        <defs><marker id="arrow" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="8" markerHeight="8" orient="auto">
          <path d="M0 0 L8 4 L0 8" /></marker></defs>
        <g v-for="wire in wires" :key="wire.key" :class="['wire', wire.health]">
          <title>{{ wire.why }}</title>
          <path :d="wire.path" marker-end="url(#arrow)" />
          <text v-for="(line, i) in wire.lines" :x="wire.x" :y="wire.y + 13 * i" class="small" text-anchor="middle"
            >{{ line }}</text>
        </g>
        <g v-for="node in nodes" :key="node.name" :class="['node', node.health, node.resting ? 'resting' : '']"
          :data-node="node.name" tabindex="0" role="link" :aria-label="node.name + ': ' + node.why"
          @click="$emit('chosen', node.name)" @keyup.enter="$emit('chosen', node.name)">
          <title>{{ node.name }}: {{ node.why }}</title>
          <rect :x="node.x" :y="node.y" :width="node.width" :height="node.height" rx="8" />
          <text :x="node.x + node.width / 2" :y="node.y + 19" class="name" text-anchor="middle">{{ node.label }}</text>
          <text :x="node.x + node.width / 2" :y="node.y + 35" class="small" text-anchor="middle">{{ node.state }}</text>
          <text :x="node.x + node.width / 2" :y="node.y + 49" class="small" text-anchor="middle">{{ node.figures }}</text>
        </g>
      </svg>
    </div>`,
  props: { nodes: Array, wires: Array, width: Number, height: Number },
};
