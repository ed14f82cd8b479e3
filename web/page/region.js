"use strict";
// Draws a region with the mouse: a drag makes a rectangle; clicks make the corners of a polygon, a double click its last one. The
// page cannot change config.toml: it shows the lines to add.

class RegionDrawing {
  constructor(map, button, output) {
    Object.assign(this, { map, button, output, active: false, from: null });
    button.addEventListener("click", () => this.begin(!this.active));
    const canvas = map.canvas;
    canvas.addEventListener("pointerdown", event => {
      if (!this.active || !map.scale) return;
      canvas.setPointerCapture(event.pointerId);
      this.from = map.place(event.offsetX, event.offsetY);
    });
    canvas.addEventListener("pointermove", event => {
      if (!this.active || !this.from) return;
      const to = map.place(event.offsetX, event.offsetY);
      if (Math.hypot(to[0] - this.from[0], to[1] - this.from[1]) < 3) return;
      const [[x, y], [right, top]] = [this.from, to];
      map.drawn = [[x, y], [right, y], [right, top], [x, top]];
      this.dragged = true;
      map.request();
    });
    canvas.addEventListener("pointerup", () => {
      if (!this.active || !this.from) return;
      if (this.dragged) this.end(true); else { map.drawn = [...map.drawn, this.from]; map.request(); }
      this.from = null;
      this.dragged = false;
    });
    // its two clicks have set two corners at one place
    canvas.addEventListener("dblclick", () => {
      if (!this.active) return;
      map.drawn = map.drawn.slice(0, -1);
      this.end(false);
    });
    document.addEventListener("keydown", event => { if (event.key === "Escape" && this.active) this.begin(false); });
  }

  begin(on) {
    this.active = on;
    this.from = null;
    this.dragged = false;
    this.map.drawn = [];
    this.button.setAttribute("aria-pressed", String(on));
    this.output.hidden = !on;
    this.output.textContent = on ? "Drag a rectangle, or click corners and double-click the last one; Escape ends it." : "";
    this.map.request();
  }

  end(rectangle) {
    const corners = this.map.drawn.map(([x, y]) => [x.toFixed(1), y.toFixed(1)]);
    this.active = false;
    this.button.setAttribute("aria-pressed", "false");
    if (!rectangle && corners.length < 3) {
      this.output.textContent = "A region needs three corners.";
      return;
    }
    const of = axis => corners.map(corner => parseFloat(corner[axis]));
    const [xs, ys] = [of(0), of(1)];
    const shape = rectangle
      ? `rectangle_mm = [${[Math.min(...xs), Math.min(...ys), Math.max(...xs), Math.max(...ys)].map(mm => mm.toFixed(1)).join(", ")}]`
      : `polygon_mm = [${corners.map(([x, y]) => `[${x}, ${y}]`).join(", ")}]`;
    this.output.hidden = false;
    this.output.textContent = `Add this to config.toml, and give it a name:\n\n[[region]]\nname = "region-1"\n${shape}`;
    this.map.request();
  }
}
