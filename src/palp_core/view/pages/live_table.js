// A table from plain data. Texts come as text: Vue escapes whatever stands between {{ and }}.
export default {
  template: `
    <div class="table-box" tabindex="0"><table class="plain">
      <thead><tr><th v-for="title in titles">{{ title }}</th></tr></thead>
      <tbody>
        <tr v-for="row in rows">
          <td v-for="cell in row"><a v-if="cell.length > 1" class="nicegui-link" :href="base + cell[1]">{{ cell[0] }}</a
            ><template v-else>{{ cell[0] }}</template></td>
        </tr>
      </tbody>
    </table></div>`,
  props: { titles: Array, rows: Array },
  computed: {
    base: () => `/${location.pathname.split("/")[1]}`,
  },
};
