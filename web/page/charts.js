"use strict";
// Charts of chosen quantities of a region: of the last ten minutes from the frames that arrive, of a longer time from the rows that
// are stored with the sessions.

const LIVE_MS = 10 * 60 * 1000;
// longest list of frames for the last minutes
const LIVE_FRAMES = 12000;
// least time between two drawings of the last minutes, and between two requests of stored rows
const LIVE_DRAW_MS = 250;
const STORED_MS = 60 * 1000;
// what a chart can show: quantities, and the health of the measurement
const CHARTED = [
  ...QUANTITIES,
  ["gradient", "Largest gradient", "kPa/mm", "lost share/mm"],
  ["hot-spots", "Hot spots", "", ""],
  ["known", "Known to be true, share of frames", "", ""],
  ["frames", "Frames a minute", "1/min", "1/min"],
];
// rows are stored of the frames that get a map: with map_every, not of all
const STORED_FRAMES = "Frames a minute that get a map";
const FIRST_CHARTS = ["load", "contact", "ppi", "unrelieved", "known"];
const CHOICE = "tactus-charts";

// A chart of points { timeMs, value }: for each pixel column the smallest and the largest value. A value that is null is not known.
class StripChart {
  constructor(parent, name) {
    this.name = name;
    Object.assign(this, figureIn(parent));
  }

  draw(points, unit, from, to) {
    const empty = cleared(this.canvas, 64);
    if (!empty) return;
    const { context: at, width, height, pixels } = empty;
    const top = points.reduce((most, point) => Math.max(most, point.value ?? 0), 0) || 1;
    const columns = new Map();
    for (const point of points) {
      const column = Math.min(width - 1, Math.max(0, Math.round((point.timeMs - from) / (to - from) * (width - 1))));
      const seen = columns.get(column) || { low: Infinity, high: -Infinity, unknown: false };
      if (point.value === null) seen.unknown = true;
      else { seen.low = Math.min(seen.low, point.value); seen.high = Math.max(seen.high, point.value); }
      columns.set(column, seen);
    }
    const y = value => height - 2 - Math.max(0, value) / top * (height - 6);
    let before = null;
    at.strokeStyle = getComputedStyle(document.body).color;
    for (const [column, seen] of [...columns].sort((a, b) => a[0] - b[0])) {
      if (seen.unknown) {
        at.fillStyle = "rgba(160, 0, 0, 0.35)";
        at.fillRect(column, 0, Math.max(1, pixels), height);
      }
      if (seen.high === -Infinity) { before = null; continue; }
      at.lineWidth = pixels;
      at.beginPath();
      if (before) at.moveTo(before[0], before[1]); else at.moveTo(column, y(seen.low));
      at.lineTo(column, y(seen.high));
      at.lineTo(column, y(seen.low) + 0.5);
      at.stroke();
      before = [column, y(seen.low)];
    }
    const last = points.length ? points[points.length - 1].value : null;
    const now = last === null ? "not known" : withUnit(last, unit);
    this.caption.textContent = `${this.name}: ${now}; scale up to ${withUnit(top, unit)}`;
    this.canvas.setAttribute("aria-label", this.caption.textContent);
  }
}

// All charts of the page. parts: elements { charts, axis, note, span, region, choices }.
class Charts {
  constructor(parts) {
    Object.assign(this, parts);
    // those with a map
    this.frames = [];
    // all, with or without a map
    this.arrived = [];
    // whether the newest values are pressures
    this.pressure = false;
    this.drawn = [];
    this.stored = null;
    this.lastDraw = 0;
    this.time = new TimeAxis(this.axis);
    const kept = (localStorage.getItem(CHOICE) || "").split(",").filter(name => CHARTED.some(charted => charted[0] === name));
    const chosen = kept.length ? kept : FIRST_CHARTS;
    for (const [name, words] of CHARTED) {
      const label = document.createElement("label");
      const box = document.createElement("input");
      Object.assign(box, { type: "checkbox", value: name, checked: chosen.includes(name) });
      box.addEventListener("change", () => { localStorage.setItem(CHOICE, this.names().join()); this.build(); });
      label.append(box, ` ${words}`);
      this.choices.append(label);
    }
    this.span.addEventListener("change", () => this.build());
    this.region.addEventListener("change", () => this.build());
    setInterval(() => { if (this.hours()) this.refresh(); }, STORED_MS);
    this.build();
  }

  names() { return [...this.choices.querySelectorAll("input:checked")].map(box => box.value); }

  // hours back; 0: the last minutes
  hours() { return parseInt(this.span.value, 10); }

  setRegions(names) {
    if (names.length) setRegionNames(this.region, names);
  }

  build() {
    this.charts.replaceChildren();
    const long = this.hours() > 0;
    this.drawn = this.names().map(name => {
      const charted = CHARTED.find(charted => charted[0] === name);
      return { charted, chart: long ? new CourseChart(this.charts, null) : new StripChart(this.charts, charted[1]) };
    });
    if (long) this.refresh(); else this.draw(true);
  }

  // a frame with or without a map. States that replace each other leave frames out: their numbers count them
  count(session, { sequence, wall_ms }) {
    const last = this.arrived[this.arrived.length - 1];
    const same = last && last.session === session;
    // the map of a frame that later ones overtook
    if (same && sequence <= last.sequence) return;
    if (last && wall_ms < last.wall_ms) this.arrived = [];
    this.arrived.push({ session, sequence, wall_ms, number: same ? last.number + sequence - last.sequence : (last ? last.number : 0) + 1 });
    this.dropOld(this.arrived);
    if (!this.hours()) this.draw(false);
  }

  // for each of these frames the number of frames in the minute up to it
  perMinute() {
    let first = 0;
    return this.arrived.map(({ wall_ms, number }) => {
      while (this.arrived[first].wall_ms < wall_ms - 60000) first += 1;
      return { timeMs: wall_ms, value: number - this.arrived[first].number + 1 };
    });
  }

  dropOld(frames) {
    const gone = frames.findIndex(of => of.wall_ms >= frames[frames.length - 1].wall_ms - LIVE_MS);
    frames.splice(0, Math.max(gone, frames.length - LIVE_FRAMES));
  }

  // a frame with its map
  add(frame) {
    const { quantities, wall_ms } = frame;
    const last = this.frames[this.frames.length - 1];
    if (last && wall_ms <= last.wall_ms) { if (wall_ms === last.wall_ms) return; this.frames = []; }
    const values = new Map((quantities ? quantities.regions : []).map(region => [region.name, region.values]));
    // null where there are no values
    const pressure = quantities ? quantities.unit === "pressure" : null;
    this.pressure = pressure ?? this.pressure;
    this.frames.push({ wall_ms, values, pressure });
    this.dropOld(this.frames);
    if (quantities) this.setRegions(quantities.regions.map(region => region.name));
    if (!this.hours()) this.draw(false);
  }

  draw(now) {
    if (this.hours()) return this.drawStored();
    if (!now && performance.now() - this.lastDraw < LIVE_DRAW_MS) return;
    this.lastDraw = performance.now();
    const newest = [this.frames, this.arrived].filter(frames => frames.length).map(frames => frames[frames.length - 1].wall_ms);
    const to = newest.length ? Math.max(...newest) : Date.now();
    const region = this.region.value || "sheet";
    // values in another unit cannot stand on the same curve
    const ofUnit = this.frames.filter(frame => frame.pressure === null || frame.pressure === this.pressure);
    for (const { charted: [name, , calibrated, plain], chart } of this.drawn) {
      const points = name === "frames"
        ? this.perMinute()
        : ofUnit.map(frame => ({ timeMs: frame.wall_ms, value: (frame.values.get(region) || {})[name] ?? null }));
      chart.draw(points, this.pressure ? calibrated : plain, to - LIVE_MS, to);
    }
    this.time.draw(to - LIVE_MS, to);
    const others = this.frames.length - ofUnit.length;
    const leftOut = others ? ` ${others} frames in another unit than the newest are left out.` : "";
    this.note.textContent = `From the frames since this page was opened, ten minutes at most. Red: not known.${leftOut}`;
  }

  // rows of the sessions of a longer time
  async refresh() {
    const [hours, region] = [this.hours(), this.region.value || "sheet"];
    try {
      const stored = await (await ask(`/api/history/${hours}/${encodeURIComponent(region)}`)).json();
      if (this.hours() !== hours || (this.region.value || "sheet") !== region) return;
      this.stored = stored;
      this.setRegions([...new Set(["sheet", ...stored.regions])]);
    } catch (error) {
      this.stored = null;
      this.note.textContent = error.message;
    }
    this.drawStored();
  }

  drawStored() {
    const { stored } = this;
    if (!stored) return;
    const spanMs = 1000 * stored.span_s;
    const of = name => stored.rows.filter(row => row.quantity === name).map(row => ({ ...row, begin: 1000 * row.begin_s }));
    const known = of("known");
    // of all quantities: one that has no row in the newest span is not known there
    const newest = stored.rows.length ? 1000 * Math.max(...stored.rows.map(row => row.begin_s)) : null;
    const unknown = known.filter(row => row.mean < 1).map(row => row.begin);
    for (const { charted: [name, words, calibrated, plain], chart } of this.drawn) {
      const minutes = stored.span_s / 60;
      const rows = name === "frames" ? known.map(row => ({ ...row, min: row.frames / minutes, mean: row.frames / minutes, max: row.frames / minutes })) : of(name);
      chart.setRows(name === "frames" ? STORED_FRAMES : words, rows.length && rows[0].of === "pressure" ? calibrated : plain, rows, unknown, spanMs, []);
      chart.draw(stored.from_ms, stored.to_ms, newest, null);
    }
    this.time.draw(stored.from_ms, stored.to_ms);
    const leftOut = [[stored.damaged, "damaged rows"], [stored.other_unit, "rows in another unit than the newest"]]
      .filter(([count]) => count).map(([count, what]) => ` ${count} ${what} are left out.`).join("");
    this.note.textContent = stored.rows.length
      ? `Smallest, mean and largest value of each ${duration(stored.span_s)} (h:min:s), stored with the sessions; the newest row is that of the last minute that ended. Red: not all frames are known. White: no frames.${leftOut}`
      : `No rows are stored in this time.${leftOut}`;
  }
}
