"use strict";
// A quantity over a whole session: the band from the smallest to the largest value of each span, where it is not known, events,
// and the moment that is shown.

class CourseChart {
  // seek: called with a time in ms
  constructor(parent, seek) {
    const figure = document.createElement("figure");
    this.caption = document.createElement("figcaption");
    this.canvas = document.createElement("canvas");
    this.canvas.setAttribute("role", "img");
    figure.append(this.caption, this.canvas);
    parent.append(figure);
    this.rows = [];
    const go = event => {
      const share = event.offsetX / this.canvas.clientWidth;
      seek(this.from + Math.max(0, Math.min(1, share)) * (this.to - this.from));
    };
    this.canvas.addEventListener("pointerdown", event => { this.canvas.setPointerCapture(event.pointerId); go(event); });
    this.canvas.addEventListener("pointermove", event => { if (event.buttons) go(event); });
  }

  // times in ms; rows of one quantity and region, unknown: begins of spans in which not all is known
  setRows(name, unit, rows, unknown, spanMs, events) {
    Object.assign(this, { name, unit, rows, unknown, spanMs, events });
  }

  draw(from, to, at, compared) {
    Object.assign(this, { from, to });
    const pixels = Math.max(1, window.devicePixelRatio || 1);
    const [width, height] = [Math.round(this.canvas.clientWidth * pixels), Math.round(64 * pixels)];
    if (!width) return;
    this.canvas.width = width;
    this.canvas.height = height;
    const context = this.canvas.getContext("2d");
    const x = ms => (ms - from) / Math.max(1, to - from) * width;
    const top = this.rows.reduce((most, row) => Math.max(most, row.max), 0) || 1;
    const y = value => height - 1 - Math.max(0, value) / top * (height - 8 * pixels);
    const ink = getComputedStyle(document.body).color;
    context.fillStyle = "rgba(160, 0, 0, 0.3)";
    for (const begin of this.unknown) context.fillRect(x(begin), 0, Math.max(pixels, x(begin + this.spanMs) - x(begin)), height);
    context.fillStyle = "rgba(70, 120, 190, 0.45)";
    for (const row of this.rows) {
      const [left, right] = [x(row.begin), x(row.begin + this.spanMs)];
      context.fillRect(left, y(row.max), Math.max(pixels, right - left), Math.max(pixels, y(row.min) - y(row.max)));
    }
    context.strokeStyle = ink;
    context.lineWidth = pixels;
    context.beginPath();
    let before = null;
    for (const row of this.rows) {
      const middle = x(row.begin + this.spanMs / 2);
      // no line over a gap
      if (before !== null && row.begin - before <= 2 * this.spanMs) context.lineTo(middle, y(row.mean)); else context.moveTo(middle, y(row.mean));
      before = row.begin;
    }
    context.stroke();
    for (const event of this.events) {
      context.fillStyle = event.kind === "alarm-active" ? "#c00000" : ink;
      context.fillRect(x(event.wall_ms), 0, pixels, 6 * pixels);
    }
    for (const [ms, colour] of [[compared, "#8a4b00"], [at, "#1a73e8"]]) {
      if (ms === null) continue;
      context.fillStyle = colour;
      context.fillRect(x(ms) - pixels, 0, 2 * pixels, height);
    }
    const here = this.rows.find(row => row.begin <= at && at < row.begin + this.spanMs);
    const now = here ? `${rounded(here.mean)} (${rounded(here.min)} to ${rounded(here.max)}) ${this.unit}` : "not known here";
    this.caption.textContent = `${this.name}: ${now}; up to ${rounded(top)} ${this.unit}`;
    this.canvas.setAttribute("aria-label", this.caption.textContent);
  }
}
