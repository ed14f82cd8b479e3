"use strict";
// Plays a recorded session: a quick map while the position moves, the exact one when it rests.

// time without a move after which the exact map is asked for
const REST_MS = 250;
const CURVES = ["load", "contact", "ppi", "unrelieved"];
// quantities that need all frames before: the largest of the minute is shown
const OF_MINUTE = ["speed", "dose", "unrelieved", "unrelieved-area"];
const map = new SheetMap(byId("map"), byId("bar"));
const other = new SheetMap(byId("other-map"), byId("bar"));
const difference = new SheetMap(byId("difference"), byId("difference-bar"));
difference.signed = true;
const charts = CURVES.map(() => new CourseChart(byId("curves"), ms => seek(ms)));
new RegionDrawing(map, byId("draw"), byId("drawn"));
const axis = new TimeAxis(byId("axis"));
// session: overview; course: rows; at: position, ms; shown: header of the map on the canvas; pinned: the compared moment
let session = null, course = null, at = 0, shown = null, pinned = null;
let playing = false, before = null, busy = false, wanted = null, resting = null;

const uncertainty = new Uncertainty(map, {
  box: byId("uncertainty"), legend: byId("uncertainty-legend"), details: byId("uncertainty-as-table"), table: byId("uncertainty-table"),
}, async () => {
  const found = await unpacked(await ask(mapAddress(session, "deviation", "frame", shown.sequence)));
  if (found.head.sequence !== shown.sequence) throw new Error("another frame is shown now");
  return found;
});

const mapAddress = (of, kind, by, number) => `/api/sessions/${encodeURIComponent(of.id)}/maps/${kind}/${by}/${number}`;
const moment = ms => new Date(ms).toLocaleString();

async function begin() {
  try {
    const colours = await (await ask("/api/colours")).json();
    for (const sheet of [map, other, difference]) sheet.colours = colours;
    const { sessions, left_out: leftOut } = await (await ask("/api/sessions")).json();
    byId("left-out").hidden = !leftOut.length;
    byId("left-out").textContent = leftOut.length ? `Not in the list: ${leftOut.join("; ")}` : "";
    byId("sessions").replaceChildren(...sessions.map(entry => {
      const option = document.createElement("option");
      option.value = entry.id;
      option.textContent = `${moment(entry.started_ms)}, ${entry.frames} frames${entry.closed ? "" : ", not closed"}${entry.note ? `, ${entry.note}` : ""} (${entry.id})`;
      return option;
    }));
    const named = new URLSearchParams(location.search).get("session");
    // one of the archive is not in the list
    if (named && !sessions.some(entry => entry.id === named)) byId("sessions").prepend(new Option(named, named));
    if (named) byId("sessions").value = named;
    else if (!sessions.length) return trouble("no session is recorded here; tactus start records one");
    await open(byId("sessions").value || sessions[0].id);
  } catch (error) {
    trouble(error.message);
  }
}

async function open(id) {
  play(false);
  session = course = shown = pinned = wanted = null;
  pin(null);
  trouble("opening the session");
  // one of the archive is fetched for minutes: another may have been chosen since
  const isChosen = () => byId("sessions").value === id;
  try {
    const opened = await (await ask(`/api/sessions/${encodeURIComponent(id)}`)).json();
    if (!isChosen()) return;
    trouble("");
    session = opened.overview;
    for (const sheet of [map, other, difference]) {
      sheet.setGeometry(opened.geometry);
      sheet.regions = session.regions;
    }
    byId("simulated").hidden = !session.simulated;
    byId("position").min = session.first_ms;
    byId("position").max = Math.max(session.last_ms, session.first_ms + 1);
    byId("region").replaceChildren();
    showEvents();
    seek(session.first_ms);
    followCourse(session);
  } catch (error) {
    if (isChosen()) trouble(error.message);
  }
}

// rows of quantities, again until the whole session was followed
async function followCourse(of) {
  while (session === of) {
    try {
      course = await (await ask(`/api/sessions/${encodeURIComponent(of.id)}/course`)).json();
    } catch (error) {
      return trouble(error.message);
    }
    if (session !== of) return;
    const share = course.progress < 1 ? `; the baseline has been tracked through ${Math.floor(100 * course.progress)} % of the session` : "";
    byId("course").textContent = course.failed ? `not known: ${course.failed}` : `Quantities ${course.source}, rows of ${course.span_s} s${share}. Red: not known.`;
    setRegionNames(byId("region"), [...new Set(course.rows.map(row => row.region))]);
    setCurves();
    if (course.failed || course.progress >= 1) {
      // what was refused before can be answered now
      rest();
      return;
    }
    await new Promise(resume => setTimeout(resume, 2000));
  }
}

function setCurves() {
  if (!course) return;
  const region = byId("region").value;
  const of = name => course.rows.filter(row => row.region === region && row.quantity === name);
  const spanMs = 1000 * course.span_s;
  const unknown = of("known").filter(row => row.mean < 1).map(row => 1000 * row.begin_s);
  charts.forEach((chart, index) => {
    const [name, words, calibrated, plain] = QUANTITIES.find(quantity => quantity[0] === CURVES[index]);
    const rows = of(name).map(row => ({ ...row, begin: 1000 * row.begin_s }));
    chart.setRows(words, rows.length && rows[0].of === "pressure" ? calibrated : plain, rows, unknown, spanMs, session.events);
  });
  drawCurves();
}

function drawCurves() {
  if (!session) return;
  axis.draw(session.first_ms, session.last_ms);
  if (course) for (const chart of charts) chart.draw(session.first_ms, session.last_ms, at, pinned && pinned.head.wall_ms);
}

// moves to a time
function seek(ms) {
  if (!session) return;
  at = Math.max(session.first_ms, Math.min(session.last_ms, ms));
  byId("position").value = at;
  show("ms", Math.round(at));
}

function step(frames) {
  play(false);
  if (shown) show("frame", Math.max(session.first_frame, Math.min(session.last_frame, shown.sequence + frames)));
}

// asks for a quick map; while one is on its way only the last wish is kept
function show(by, number) {
  wanted = { by, number };
  clearTimeout(resting);
  resting = null;
  next();
}

async function next() {
  if (busy || !wanted) return;
  const { by, number } = wanted;
  wanted = null;
  busy = true;
  try {
    await load(byId("view").value === "load" ? "quick" : "unrelieved", by, number);
    // meanwhile a later move may have set the time, or another session been chosen: then no frame of it is shown yet
    if (by === "frame" && !wanted && shown) { at = shown.wall_ms; byId("position").value = at; }
    trouble("");
  } catch (error) {
    byId("verdict").textContent = error.message;
    byId("verdict").className = "warn";
  } finally {
    busy = false;
  }
  drawCurves();
  if (wanted) next(); else if (!playing) resting = setTimeout(rest, REST_MS);
}

// the exact map of the frame that is shown
async function rest() {
  if (busy || playing || !shown || !session) return;
  if (byId("view").value !== "load") return show("frame", shown.sequence);
  if (!shown.provisional) return;
  const of = session;
  busy = true;
  try {
    await load("exact", "frame", shown.sequence);
  } catch (error) {
    byId("verdict").textContent = error.message;
    byId("verdict").className = "warn";
    // the background has not come so far yet
    if (session === of && course && course.progress < 1) resting = setTimeout(rest, 1000);
  } finally {
    busy = false;
  }
  if (wanted) next();
}

async function load(kind, by, number) {
  const of = session;
  const { head, values } = await unpacked(await ask(mapAddress(of, kind, by, number)));
  if (session !== of) return;
  shown = head;
  // that of another frame
  if (uncertainty.of && uncertainty.of.sequence !== head.sequence) uncertainty.clear();
  draw(head, values);
  if (kind === "exact") uncertainty.refresh();
}

function draw(head, values) {
  const fixed = parseFloat(byId("fixed").value);
  const largest = values.reduce((most, value) => Math.max(most, value), 0);
  const noise = head.noise || 0;
  const top = fixed > 0 ? fixed : Math.max(largest, noise, pinned && pinned.head.unit === head.unit ? pinned.largest : 0) || 1;
  map.setMap(values, head, top);
  map.drawBar();
  byId("high").textContent = head.unit === "s" ? duration(top) : rounded(top);
  byId("unit").textContent = (head.unit === "s" ? "" : head.unit) + (largest <= noise ? " nothing above the noise" : "");
  byId("moment").textContent = `${moment(head.wall_ms)}, frame ${head.sequence} of ${session.last_frame}`;
  byId("position").setAttribute("aria-valuetext", byId("moment").textContent);
  document.body.dataset.sequence = head.sequence;
  document.body.dataset.kind = head.provisional ? "provisional" : "exact";
  showVerdict(head);
  showQuantities(head);
  if (pinned) {
    other.setMap(pinned.values, pinned.head, top);
    const comparable = pinned.head.unit === head.unit;
    const less = values.map((value, triangle) => comparable ? value - pinned.values[triangle] : NaN);
    const most = less.reduce((most, value) => Math.max(most, Math.abs(value) || 0), 0) || 1;
    difference.setMap(less, null, most);
    difference.drawBar();
    byId("difference-low").textContent = `-${rounded(most)}`;
    byId("difference-high").textContent = `${rounded(most)} ${head.unit}`;
  }
}

function showVerdict(head) {
  const { tracked, provisional, quantities } = head;
  let [text, kind] = [`${head.method}: exact`, "good"];
  if (provisional) [text, kind] = [`${provisional}`, "soft"];
  else if (quantities && quantities.reason) [text, kind] = [`not known: ${quantities.reason}`, "bad"];
  else if (tracked && !tracked.known) [text, kind] = [`not known: ${tracked.text || tracked.reason}`, "bad"];
  else if (tracked) text = `known to be true; the sheet is ${tracked.judgement} (${head.method})`;
  byId("verdict").textContent = text;
  byId("verdict").className = kind;
}

function showQuantities(head) {
  const regions = head.quantities ? head.quantities.regions : null;
  const minute = name => region => {
    const row = course && course.rows.find(row => row.region === region && row.quantity === name && 1000 * row.begin_s <= head.wall_ms && head.wall_ms < 1000 * (row.begin_s + course.span_s));
    return row && row.max;
  };
  // while the position moves the numbers of the frame stay, dimmed
  byId("quantities").classList.toggle("old", !regions);
  if (!regions) return;
  const pressure = head.quantities.unit === "pressure";
  const rows = [row(["", ...regions.map(region => ({ number: region.name })), "unit"], true)];
  for (const [name, words, calibrated, plain] of QUANTITIES) {
    const of_minute = OF_MINUTE.includes(name);
    const values = regions.map(region => of_minute ? minute(name)(region.name) : region.values[name]);
    if (values.every(value => value === undefined)) continue;
    const unit = pressure ? calibrated : plain;
    const text = (value, region) => {
      if (value === undefined) return "\u2013";
      if (unit === "s") return duration(value);
      return withDeviation(value, !of_minute && region.deviations && region.deviations[name]);
    };
    const cells = values.map((value, index) => ({ number: text(value, regions[index]) }));
    rows.push(row([words + (of_minute ? " (minute)" : ""), ...cells, unit === "s" ? "h:min:s" : unit]));
  }
  if (rows.length === 1) rows.push(row([head.quantities.reason || "not known", "", ""]));
  byId("quantities").replaceChildren(...rows);
}

function showEvents() {
  byId("events").replaceChildren(...session.events.map(event => {
    const item = document.createElement("li");
    const button = document.createElement("button");
    button.className = "link";
    button.textContent = moment(event.wall_ms);
    button.addEventListener("click", () => { play(false); seek(event.wall_ms); });
    item.append(button, ` ${event.kind}: ${event.text}`);
    return item;
  }));
}

function play(on) {
  playing = on;
  before = null;
  byId("play").textContent = on ? "Pause" : "Play";
  if (on) requestAnimationFrame(tick); else if (shown) rest();
}

function tick(now) {
  if (!playing) return;
  if (before !== null && !busy) {
    const to = at + (now - before) * parseFloat(byId("speed").value);
    before = now;
    if (to >= session.last_ms) { seek(session.last_ms); return play(false); }
    seek(to);
  } else if (before === null) before = now;
  requestAnimationFrame(tick);
}

// the moment that is shown becomes the one that others are compared with; null: none
function pin(head) {
  pinned = head && { head, values: map.values, largest: map.values.reduce((most, value) => Math.max(most, value), 0) };
  byId("other").hidden = !pinned;
  byId("compare").textContent = pinned ? "Stop comparing" : "Compare with this moment";
  byId("compare").setAttribute("aria-pressed", String(Boolean(pinned)));
  if (pinned) {
    byId("other-moment").textContent = `${moment(head.wall_ms)}, frame ${head.sequence}${head.provisional ? `, ${head.provisional}` : ""}`;
    draw(shown, map.values);
  }
  drawCurves();
}

byId("sessions").addEventListener("change", event => open(event.target.value));
byId("position").addEventListener("input", event => { play(false); seek(parseFloat(event.target.value)); });
byId("play").addEventListener("click", () => play(!playing));
byId("back").addEventListener("click", () => step(-1));
byId("forward").addEventListener("click", () => step(1));
byId("region").addEventListener("change", setCurves);
byId("view").addEventListener("change", () => { pin(null); if (shown) show("frame", shown.sequence); });
byId("compare").addEventListener("click", () => pin(pinned ? null : shown));
byId("fixed").addEventListener("input", () => { if (shown && map.values) draw(shown, map.values); });
byId("map").addEventListener("pointermove", event => {
  const here = shown && map.valueAt(event.offsetX, event.offsetY);
  byId("pointer").textContent = here ? `(${here.x.toFixed(1)}, ${here.y.toFixed(1)}) mm: ${withUnit(here.value, shown.unit)}${uncertainty.at(here)}` : "";
});
document.addEventListener("keydown", event => {
  if (["INPUT", "SELECT", "BUTTON"].includes(event.target.tagName) || !session) return;
  const page = (session.last_ms - session.first_ms) / 100;
  const moves = { " ": () => play(!playing), ArrowLeft: () => step(-1), ArrowRight: () => step(1), PageUp: () => seek(at - page),
    PageDown: () => seek(at + page), Home: () => seek(session.first_ms), End: () => seek(session.last_ms) };
  if (!moves[event.key]) return;
  event.preventDefault();
  moves[event.key]();
});
window.addEventListener("resize", () => { for (const sheet of [map, other, difference]) sheet.request(); drawCurves(); });
begin();
