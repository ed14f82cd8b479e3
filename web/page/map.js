"use strict";
// Draws a map: one colour for each triangle, the outline, the electrodes, the 95 % ellipse of the load, hot spots and their tracks.

// states of electrodes: colours that differ for the colour-blind too, and a sign
const ELECTRODE_STATES = {
  used: { colour: "#1a73e8", sign: "" },
  doubtful: { colour: "#e69f00", sign: "?" },
  left_out: { colour: "#d00000", sign: "\u2717" },
};
// time that tracks of hot spots show, and the least way between two points of one
// lines of the uncertainty: their colour, the distance between them and their widths, CSS pixels
const LINE_COLOUR = 0xff707070, LINE_STEP = 8, LINE_WIDTHS = [0, 1, 2, 3, LINE_STEP];
const TRACK_MS = 10 * 60 * 1000;
const TRACK_STEP_MM = 1;

// numbers of the electrodes that are not just used, with the reason: { state, text }
function electrodeStates(frame) {
  const states = new Map();
  for (const reason of (frame && frame.quality && frame.quality.reasons) || []) {
    if (reason.electrode) states.set(reason.electrode, { state: "doubtful", text: reason.text });
  }
  for (const number of (frame && frame.tracked && frame.tracked.masked) || []) states.set(number, { state: "left_out", text: "faulty" });
  return states;
}

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
    this.showTracks = false;
    this.waiting = false;
    // standard deviations, NaN where nothing is known; and the width of the lines in each triangle, from 1, as the raster counts
    this.deviations = null;
    this.lines = null;
    // number of a hot spot: points [x, y, time]
    this.tracks = new Map();
    // place of the keyboard's cursor, mm
    this.cursor = null;
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
    this.setDeviations(null);
    this.raster = null;
    this.regions = geometry.regions || [];
    this.tracks.clear();
  }

  setMap(values, frame, top) {
    this.values = values;
    this.frame = frame;
    this.top = top;
    if (this.showTracks) this.track(frame);
    this.request();
  }

  // draws lines over the map, the wider, the larger the deviation is: none up to the first of three bounds, all where it is NaN
  setDeviations(deviations, bounds) {
    this.deviations = deviations;
    this.lines = deviations && new Uint8Array(deviations.length + 1);
    if (deviations) deviations.forEach((value, t) => { this.lines[t + 1] = Number.isNaN(value) ? 4 : bounds.filter(bound => value > bound).length; });
    this.request();
  }

  track(frame) {
    const spots = (frame.quantities && frame.quantities.spots) || [];
    const kept = new Set(spots.map(spot => spot.number));
    for (const number of this.tracks.keys()) if (!kept.has(number)) this.tracks.delete(number);
    for (const { number, centre_mm: [x, y] } of spots) {
      const points = this.tracks.get(number) || [];
      const last = points[points.length - 1];
      if (!last || Math.hypot(x - last[0], y - last[1]) >= TRACK_STEP_MM) points.push([x, y, frame.wall_ms]);
      while (points.length > 1 && points[1][2] < frame.wall_ms - TRACK_MS) points.shift();
      this.tracks.set(number, points);
    }
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
    if (this.values) this.drawValues(at);
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
    if (this.cursor) this.cross(at);
  }

  // the triangle of each pixel, from 1; 0 beside the map. It changes with the size only, so that a map is one pass over the pixels
  rasterise() {
    const { width, height } = this.canvas;
    if (this.raster && this.raster.length === width * height && this.rasterWidth === width) return;
    this.raster = new Int32Array(width * height);
    this.rasterWidth = width;
    this.image = new ImageData(width, height);
    const { nodes, triangles } = this.geometry;
    for (let t = 0; 3 * t < triangles.length; t++) {
      const corners = [0, 1, 2].map(k => 2 * triangles[3 * t + k]).map(n => [this.x(nodes[n]), this.y(nodes[n + 1])]);
      const ys = corners.map(corner => corner[1]);
      const [low, high] = [Math.min(...ys), Math.max(...ys)];
      const [first, last] = [Math.max(0, Math.floor(low - 0.5)), Math.min(height - 1, Math.ceil(high - 0.5))];
      for (let row = first; row <= last; row++) {
        // the side of a pixel at the border counts, so that no line between two triangles stays empty
        const y = Math.min(Math.max(row + 0.5, low), high);
        let [left, right] = [Infinity, -Infinity];
        for (let k = 0; k < 3; k++) {
          const [[x0, y0], [x1, y1]] = [corners[k], corners[(k + 1) % 3]];
          if ((y - y0) * (y - y1) > 0) continue;
          const x = y0 === y1 ? x0 : x0 + (x1 - x0) * (y - y0) / (y1 - y0);
          left = Math.min(left, x, y0 === y1 ? x1 : x);
          right = Math.max(right, x, y0 === y1 ? x1 : x);
        }
        const [from, to] = [Math.max(0, Math.floor(left)), Math.min(width - 1, Math.floor(right))];
        for (let column = from; column <= to; column++) this.raster[row * width + column] = t + 1;
      }
    }
  }

  drawValues(at) {
    this.rasterise();
    const { values, top, raster } = this;
    const palette = new Uint32Array(values.length + 1);
    // red is the lowest byte
    const packed = colours => Uint32Array.from(colours, ([red, green, blue]) => (0xff << 24 | blue << 16 | green << 8 | red) >>> 0);
    const loads = packed(this.colours.loads), gains = this.signed ? packed(this.colours.gains) : null;
    for (let t = 0; t < values.length; t++) {
      const share = values[t] / top;
      if (Number.isNaN(share)) continue;
      const step = Math.round(255 * Math.min(1, Math.abs(share)));
      palette[t + 1] = share >= 0 ? loads[step] : gains ? gains[step] : loads[0];
    }
    const pixels = new Uint32Array(this.image.data.buffer), count = pixels.length;
    for (let i = 0; i < count; i++) pixels[i] = palette[raster[i]];
    if (this.lines) this.drawLines(pixels);
    at.putImageData(this.image, 0, 0);
  }

  drawLines(pixels) {
    const step = Math.round(LINE_STEP * this.pixels), width = this.rasterWidth;
    const widths = LINE_WIDTHS.map(wide => wide * this.pixels);
    for (let i = 0, y = 0; i < pixels.length; y++) {
      for (let x = 0; x < width; x++, i++) {
        const level = this.lines[this.raster[i]];
        if (level && (x + y) % step < widths[level]) pixels[i] = LINE_COLOUR;
      }
    }
  }

  cross(at) {
    const [x, y] = [this.x(this.cursor[0]), this.y(this.cursor[1])];
    const size = 9 * this.pixels;
    for (const [colour, width] of [["#fff", 4], ["#000", 1.5]]) {
      at.strokeStyle = colour;
      at.lineWidth = width * this.pixels;
      at.beginPath();
      at.moveTo(x - size, y); at.lineTo(x + size, y);
      at.moveTo(x, y - size); at.lineTo(x, y + size);
      at.stroke();
    }
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
    const states = electrodeStates(this.frame);
    const [cx, cy] = [(this.low[0] + this.high[0]) / 2, (this.low[1] + this.high[1]) / 2];
    at.font = `${11 * this.pixels}px system-ui, sans-serif`;
    at.textAlign = "center";
    at.textBaseline = "middle";
    for (let e = 0; 2 * e < this.geometry.electrodes.length; e++) {
      const [x, y] = [this.geometry.electrodes[2 * e], this.geometry.electrodes[2 * e + 1]];
      const away = Math.hypot(x - cx, y - cy) || 1;
      const out = 17 * this.pixels;
      const { colour, sign } = ELECTRODE_STATES[(states.get(e + 1) || { state: "used" }).state];
      at.fillStyle = colour;
      at.beginPath();
      at.arc(this.x(x), this.y(y), 3 * this.pixels, 0, 2 * Math.PI);
      at.fill();
      at.fillStyle = sign ? colour : ink;
      at.fillText(`${e + 1}${sign}`, this.x(x) + out * (x - cx) / away, this.y(y) - out * (y - cy) / away);
    }
  }

  marks(at, ink) {
    const frame = this.frame;
    const place = frame && frame.tracked && frame.tracked.place;
    // the region of a load that is unlike a disc or an ellipse may not hold
    if (this.showRegion && place && place.accepted) {
      at.strokeStyle = ink;
      at.setLineDash([4 * this.pixels, 3 * this.pixels]);
      at.beginPath();
      at.ellipse(this.x(place.centre_mm[0]), this.y(place.centre_mm[1]), place.half_axes_mm[0] * this.scale,
        place.half_axes_mm[1] * this.scale, -place.angle_deg * Math.PI / 180, 0, 2 * Math.PI);
      at.stroke();
      at.setLineDash([]);
    }
    at.strokeStyle = ink;
    at.lineWidth = 1.5 * this.pixels;
    for (const points of this.showTracks ? this.tracks.values() : []) {
      at.beginPath();
      for (const [x, y] of points) at.lineTo(this.x(x), this.y(y));
      at.stroke();
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
    return this.valueAtPlace(this.place(cssX, cssY));
  }

  // the same at a place in mm
  valueAtPlace([x, y]) {
    if (!this.values || !this.raster) return null;
    const [column, row] = [Math.floor(this.x(x)), Math.floor(this.y(y))];
    if (column < 0 || column >= this.rasterWidth || row < 0 || row >= this.canvas.height) return null;
    const triangle = this.raster[row * this.rasterWidth + column];
    return triangle ? { x, y, value: this.values[triangle - 1], deviation: this.deviations ? this.deviations[triangle - 1] : undefined } : null;
  }

  // the largest value in each field of a grid over the sheet, upper row first: { columns: [mm], rows: [{ mm, values }] }; undefined
  // where no triangle's centre lies
  grid(count, of = this.values) {
    const { nodes, triangles } = this.geometry;
    const width = [0, 1].map(axis => (this.high[axis] - this.low[axis]) / count);
    const middle = (axis, k) => this.low[axis] + (k + 0.5) * width[axis];
    const rows = Array.from({ length: count }, (_, k) => ({ mm: middle(1, count - 1 - k), values: new Array(count) }));
    for (let t = 0; t < of.length; t++) {
      const [column, row] = [0, 1].map(axis => {
        const centre = [0, 1, 2].reduce((sum, k) => sum + nodes[2 * triangles[3 * t + k] + axis], 0) / 3;
        return Math.max(0, Math.min(count - 1, Math.floor((centre - this.low[axis]) / width[axis])));
      });
      const { values } = rows[count - 1 - row];
      // NaN if one of them is
      values[column] = Math.max(values[column] ?? -Infinity, of[t]);
    }
    return { columns: Array.from({ length: count }, (_, k) => middle(0, k)), rows };
  }
}
