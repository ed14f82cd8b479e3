"use strict";
// Strip charts of the last minutes: for each pixel column the smallest and the largest value.

class StripChart {
  constructor(parent, name, spanMs) {
    this.name = name;
    this.spanMs = spanMs;
    this.points = [];
    const figure = document.createElement("figure");
    this.caption = document.createElement("figcaption");
    this.canvas = document.createElement("canvas");
    this.canvas.setAttribute("role", "img");
    figure.append(this.caption, this.canvas);
    parent.append(figure);
  }

  // value null: not known
  add(timeMs, value, unit) {
    const last = this.points[this.points.length - 1];
    if (last && timeMs < last.timeMs) this.points = [];
    if (last && timeMs === last.timeMs) this.points.pop();
    this.points.push({ timeMs, value });
    while (this.points.length && this.points[0].timeMs < timeMs - this.spanMs) this.points.shift();
    this.unit = unit;
    this.draw();
  }

  draw() {
    const pixels = Math.max(1, window.devicePixelRatio || 1);
    const [width, height] = [Math.round(this.canvas.clientWidth * pixels), Math.round(70 * pixels)];
    this.canvas.width = width;
    this.canvas.height = height;
    const at = this.canvas.getContext("2d");
    const end = this.points.length ? this.points[this.points.length - 1].timeMs : 0;
    const known = this.points.filter(point => point.value !== null);
    const top = Math.max(...known.map(point => point.value), 0) || 1;
    const columns = new Map();
    for (const point of this.points) {
      const column = Math.min(width - 1, Math.max(0, Math.round(width - 1 - (end - point.timeMs) / this.spanMs * (width - 1))));
      const seen = columns.get(column) || { low: Infinity, high: -Infinity, unknown: false };
      if (point.value === null) seen.unknown = true;
      else { seen.low = Math.min(seen.low, point.value); seen.high = Math.max(seen.high, point.value); }
      columns.set(column, seen);
    }
    const y = value => height - 2 - value / top * (height - 6);
    let before = null;
    for (const [column, seen] of [...columns].sort((a, b) => a[0] - b[0])) {
      if (seen.unknown) {
        at.fillStyle = "rgba(160, 0, 0, 0.35)";
        at.fillRect(column, 0, Math.max(1, pixels), height);
      }
      if (seen.high < 0) { before = null; continue; }
      at.strokeStyle = getComputedStyle(document.body).color;
      at.lineWidth = pixels;
      at.beginPath();
      if (before) at.moveTo(before[0], before[1]); else at.moveTo(column, y(seen.low));
      at.lineTo(column, y(seen.high));
      at.lineTo(column, y(seen.low) + 0.5);
      at.stroke();
      before = [column, y(seen.low)];
    }
    const last = this.points.length ? this.points[this.points.length - 1].value : null;
    const now = last === null ? "not known" : `${rounded(last)} ${this.unit}`;
    this.caption.textContent = `${this.name}: ${now} (up to ${rounded(top)} ${this.unit || ""})`;
    this.canvas.setAttribute("aria-label", this.caption.textContent);
  }
}
