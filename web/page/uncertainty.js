"use strict";
// The uncertainty of a map: standard deviations as lines over the map, a legend, and a table.

// fields of the table on each side
const UNCERTAINTY_GRID = 6;

// box: switches it on; legend, details, table: places for it; load: () => { sequence, unit } and values, or an error with the reason
class Uncertainty {
  constructor(map, { box, legend, details, table }, load) {
    Object.assign(this, { map, box, legend, details, table, load });
    // whether one is on its way, and whether it is for a frame that is gone
    [this.loading, this.again] = [false, false];
    this.of = null;
    box.addEventListener("change", () => this.refresh());
    details.addEventListener("toggle", () => this.tabulate());
    this.clear();
  }

  get on() { return this.box.checked; }

  // of no frame any more
  clear(why = "") {
    this.of = null;
    this.map.setDeviations(null);
    this.legend.replaceChildren(this.on ? why || "Uncertainty: being computed" : "");
    this.legend.hidden = this.details.hidden = !this.on;
    this.table.replaceChildren();
  }

  // asks for those of the frame that is shown now; one request at a time
  async refresh() {
    if (!this.on) return this.clear();
    if (this.loading) { this.again = true; return; }
    [this.loading, this.again] = [true, false];
    try {
      if (!this.of) this.clear();
      const { head, values } = await this.load();
      if (!this.on) this.clear(); else if (!this.again) this.show(head, values);
    } catch (error) {
      this.clear(`Uncertainty not known: ${error.message}`);
    } finally {
      this.loading = false;
    }
    if (this.again) this.refresh();
  }

  show(head, values) {
    this.of = head;
    const known = values.filter(value => !Number.isNaN(value));
    const [least, most] = known.reduce(([least, most], value) => [Math.min(least, value), Math.max(most, value)], [Infinity, 0]);
    const bounds = [1, 2, 3].map(step => known.length ? least + step * (most - least) / 4 : 0);
    this.map.setDeviations(values, bounds);
    const part = (kind, text) => {
      const swatch = document.createElement("span");
      swatch.className = `swatch ${kind}`;
      return [swatch, text];
    };
    this.legend.replaceChildren(
      `Uncertainty of frame ${head.sequence}, standard deviation of ${head.unit}: no lines to ${rounded(bounds[0])}, `,
      ...part("few", ` to ${rounded(bounds[1])}, `), ...part("some", ` to ${rounded(bounds[2])}, `), ...part("many", ` to ${rounded(most)}, `),
      ...part("nothing", " not determined by this frame"));
    this.legend.hidden = this.details.hidden = false;
    this.tabulate();
  }

  // the same for those who cannot see it
  tabulate() {
    if (!this.of || !this.details.open) return;
    const cell = value => ({ number: value === undefined ? "\u2013" : Number.isNaN(value) ? "in part unknown" : rounded(value) });
    this.table.replaceChildren(...gridRows(this.map.grid(UNCERTAINTY_GRID, this.map.deviations), cell));
  }

  // what it says of a place of the map, for the line below it
  at(place) {
    if (!this.of || place.deviation === undefined) return "";
    return Number.isNaN(place.deviation) ? "; not determined by this frame" : `; standard deviation of ${this.of.unit} ${rounded(place.deviation)}`;
  }
}

// length of the JSON, the JSON, values in single precision
async function unpacked(answer) {
  const bytes = await answer.arrayBuffer();
  const length = new DataView(bytes).getUint32(0, true);
  return { head: JSON.parse(new TextDecoder().decode(new Uint8Array(bytes, 4, length))), values: new Float32Array(bytes, 4 + length) };
}
