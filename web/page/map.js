"use strict";
// Draws a map: one colour for each triangle, the outline, the electrodes, the 95 % region of the load and hot spots.

class SheetMap {
  constructor(canvas, bar) {
    this.canvas = canvas;
    this.bar = bar;
    this.colours = null;
    this.geometry = null;
    this.values = null;
    this.frame = null;
    this.top = 1;
    // whether values below zero are shown too
    this.signed = false;
    this.showNumbers = true;
    this.showRegion = true;
    this.waiting = false;
    // named regions: { name, corners_mm }; and the corners of one that is being drawn
    this.regions = [];
    this.drawn = [];
  }

  // nodes, triangles and electrodes in mm, y upwards
  setGeometry(geometry) {
    this.geometry = geometry;
    const xs = [], ys = [];
    for (let i = 0; i < geometry.outline.length; i += 2) { xs.push(geometry.outline[i]); ys.push(geometry.outline[i + 1]); }
    this.low = [Math.min(...xs), Math.min(...ys)];
    this.high = [Math.max(...xs), Math.max(...ys)];
    this.values = null;
  }

  setMap(values, frame, top) {
    this.values = values;
    this.frame = frame;
    this.top = top;
    this.request();
  }

  request() {
    if (this.waiting) return;
    this.waiting = true;
    requestAnimationFrame(() => { this.waiting = false; this.draw(); });
  }

  layout() {
    const pixels = Math.max(1, window.devicePixelRatio || 1);
    const width = Math.round(this.canvas.clientWidth * pixels);
    const margin = 22 * pixels;
    const [w, h] = [this.high[0] - this.low[0], this.high[1] - this.low[1]];
    const scale = (width - 2 * margin) / w;
    const height = Math.round(h * scale + 2 * margin);
    if (this.canvas.width !== width || this.canvas.height !== height) {
      this.canvas.width = width;
      this.canvas.height = height;
    }
    this.pixels = pixels;
    this.scale = scale;
    this.margin = margin;
  }

  x(mm) { return this.margin + (mm - this.low[0]) * this.scale; }
  y(mm) { return this.canvas.height - this.margin - (mm - this.low[1]) * this.scale; }

  draw() {
    if (!this.geometry || !this.colours) return;
    this.layout();
    const ink = getComputedStyle(document.body).color;
    const at = this.canvas.getContext("2d");
    at.clearRect(0, 0, this.canvas.width, this.canvas.height);
    const { nodes, triangles } = this.geometry;
    if (this.values) {
      at.lineWidth = 1;
      for (let t = 0; t < this.values.length; t++) {
        const [r, g, b] = this.colour(this.values[t] / this.top);
        at.fillStyle = at.strokeStyle = `rgb(${r},${g},${b})`;
        at.beginPath();
        for (let k = 0; k < 3; k++) {
          const n = 2 * triangles[3 * t + k];
          const [x, y] = [this.x(nodes[n]), this.y(nodes[n + 1])];
          if (k === 0) at.moveTo(x, y); else at.lineTo(x, y);
        }
        at.closePath();
        at.fill();
        at.stroke();
      }
    }
    at.strokeStyle = ink;
    at.lineWidth = this.pixels;
    let from = 0;
    for (const length of this.geometry.outline_lengths) {
      at.beginPath();
      for (let i = 0; i < length; i++) {
        const p = 2 * (from + i);
        const [x, y] = [this.x(this.geometry.outline[p]), this.y(this.geometry.outline[p + 1])];
        if (i === 0) at.moveTo(x, y); else at.lineTo(x, y);
      }
      at.closePath();
      at.stroke();
      from += length;
    }
    for (const region of this.regions) this.polygon(at, ink, region.corners_mm, region.name);
    if (this.drawn.length) this.polygon(at, "#c02020", this.drawn, "");
    if (this.showNumbers) this.electrodes(at, ink);
    this.marks(at, ink);
  }

  polygon(at, colour, corners, name) {
    at.strokeStyle = at.fillStyle = colour;
    at.lineWidth = this.pixels;
    at.setLineDash([2 * this.pixels, 2 * this.pixels]);
    at.beginPath();
    for (const [x, y] of corners) at.lineTo(this.x(x), this.y(y));
    at.closePath();
    at.stroke();
    at.setLineDash([]);
    at.font = `${11 * this.pixels}px system-ui, sans-serif`;
    at.textAlign = "left";
    at.textBaseline = "top";
    const [left, top] = [Math.min(...corners.map(corner => corner[0])), Math.max(...corners.map(corner => corner[1]))];
    at.fillText(name, this.x(left) + 3 * this.pixels, this.y(top) + 3 * this.pixels);
  }

  // a point of the canvas, in CSS pixels, as mm
  place(cssX, cssY) {
    return [(cssX * this.pixels - this.margin) / this.scale + this.low[0], (this.canvas.height - this.margin - cssY * this.pixels) / this.scale + this.low[1]];
  }

  electrodes(at, ink) {
    const faulty = new Set((this.frame && this.frame.tracked && this.frame.tracked.masked) || []);
    const [cx, cy] = [(this.low[0] + this.high[0]) / 2, (this.low[1] + this.high[1]) / 2];
    at.font = `${11 * this.pixels}px system-ui, sans-serif`;
    at.textAlign = "center";
    at.textBaseline = "middle";
    for (let e = 0; 2 * e < this.geometry.electrodes.length; e++) {
      const [x, y] = [this.geometry.electrodes[2 * e], this.geometry.electrodes[2 * e + 1]];
      const away = Math.hypot(x - cx, y - cy) || 1;
      const out = 17 * this.pixels;
      at.fillStyle = faulty.has(e + 1) ? "#d00000" : ink;
      const label = faulty.has(e + 1) ? `${e + 1}\u2717` : `${e + 1}`;
      at.fillText(label, this.x(x) + out * (x - cx) / away, this.y(y) - out * (y - cy) / away);
    }
  }

  marks(at, ink) {
    const frame = this.frame;
    const place = frame && frame.tracked && frame.tracked.place;
    if (this.showRegion && place) {
      at.strokeStyle = ink;
      at.setLineDash([4 * this.pixels, 3 * this.pixels]);
      at.beginPath();
      at.ellipse(this.x(place.centre_mm[0]), this.y(place.centre_mm[1]), place.half_axes_mm[0] * this.scale,
        place.half_axes_mm[1] * this.scale, -place.angle_deg * Math.PI / 180, 0, 2 * Math.PI);
      at.stroke();
      at.setLineDash([]);
    }
    const spots = (frame && frame.quantities && frame.quantities.spots) || [];
    at.font = `bold ${12 * this.pixels}px system-ui, sans-serif`;
    for (const spot of spots) {
      const [x, y] = [this.x(spot.centre_mm[0]), this.y(spot.centre_mm[1])];
      at.fillStyle = "#fff";
      at.strokeStyle = "#000";
      at.lineWidth = this.pixels;
      at.beginPath();
      at.arc(x, y, 9 * this.pixels, 0, 2 * Math.PI);
      at.fill();
      at.stroke();
      at.fillStyle = "#000";
      at.fillText(`${spot.number}`, x, y);
    }
  }

  // share of the scale: a load is positive; a value below zero has a colour only in a map with two signs
  colour(share) {
    const step = Math.round(255 * Math.min(1, Math.abs(share)));
    if (share >= 0) return this.colours.loads[step];
    return this.signed ? this.colours.gains[step] : this.colours.loads[0];
  }

  drawBar() {
    const at = this.bar.getContext("2d");
    for (let i = 0; i < 256; i++) {
      const [r, g, b] = this.colour(this.signed ? (i - 127.5) / 127.5 : i / 255);
      at.fillStyle = `rgb(${r},${g},${b})`;
      at.fillRect(i, 0, 1, this.bar.height);
    }
  }

  // value under a point of the canvas, in CSS pixels; null beside the map
  valueAt(cssX, cssY) {
    if (!this.values || !this.geometry || !this.scale) return null;
    const [x, y] = this.place(cssX, cssY);
    const { nodes, triangles } = this.geometry;
    for (let t = 0; t < this.values.length; t++) {
      const [a, b, c] = [0, 1, 2].map(k => 2 * triangles[3 * t + k]);
      const side = (p, q) => (nodes[q] - nodes[p]) * (y - nodes[p + 1]) - (nodes[q + 1] - nodes[p + 1]) * (x - nodes[p]);
      const [s, u, v] = [side(a, b), side(b, c), side(c, a)];
      if ((s >= 0 && u >= 0 && v >= 0) || (s <= 0 && u <= 0 && v <= 0)) return { x, y, value: this.values[t] };
    }
    return null;
  }
}
