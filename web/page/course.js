"use strict";
// A quantity over a whole session: the band from the smallest to the largest value of each span, where it is not known, events,
// and the moment that is shown.

class CourseChart {
  // seek: called with a time in ms; null for a chart that only shows
  constructor(parent, seek) {
    Object.assign(this, figureIn(parent));
    this.rows = [];
    if (!seek) return;
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
    const empty = cleared(this.canvas, 64);
    if (!empty) return;
    const { context, width, height, pixels } = empty;
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
    const band = here && here.max > here.min ? ` (${withUnit(here.min, this.unit)} to ${withUnit(here.max, this.unit)})` : "";
    const now = here ? withUnit(here.mean, this.unit) + band : "not known here";
    this.caption.textContent = `${this.name}: ${now}; scale up to ${withUnit(top, this.unit)}`;
    this.canvas.setAttribute("aria-label", this.caption.textContent);
  }
}

// Times below the curves.
class TimeAxis {
  constructor(canvas) { this.canvas = canvas; }

  draw(from, to) {
    const empty = cleared(this.canvas, 18);
    if (!empty) return;
    const { context, width, height, pixels } = empty;
    context.font = `${11 * pixels}px system-ui, sans-serif`;
    context.fillStyle = getComputedStyle(document.body).color;
    // whole steps of local time, at most one each 90 px
    const most = Math.max(2, this.canvas.clientWidth / 90);
    const minute = 60000, day = 1440 * minute;
    const steps = [1000, 5000, 15000, minute, 5 * minute, 15 * minute, 30 * minute, 60 * minute, 180 * minute, 360 * minute, day, 7 * day, 30 * day];
    const step = steps.find(step => (to - from) / step <= most) || (to - from) / most;
    const zone = new Date(from).getTimezoneOffset() * minute;
    for (let at = Math.ceil((from - zone) / step) * step + zone; at <= to; at += step) {
      const when = new Date(at);
      const text = step >= day ? when.toLocaleDateString() : when.toLocaleTimeString([], { hour: "2-digit", minute: "2-digit", second: step < minute ? "2-digit" : undefined });
      const x = (at - from) / Math.max(1, to - from) * width;
      context.fillRect(x, 0, pixels, 4 * pixels);
      context.fillText(text, Math.min(x, width - context.measureText(text).width), height - 3 * pixels);
    }
  }
}
