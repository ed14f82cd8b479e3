"use strict";
// Follows /api/state and shows it.

// least time between two updates of the tables: people and screen readers read them
const TABLES_MS = 250;
// step of the cursor on the map, mm, and with Shift
const STEP_MM = 5, FINE_STEP_MM = 1;
// fields of the map's table on each side
const GRID = 6;
const map = new SheetMap(byId("map"), byId("bar"));
map.showTracks = true;
const charts = new Charts({
  charts: byId("charts"), axis: byId("axis"), note: byId("charts-note"), span: byId("span"), region: byId("chart-region"), choices: byId("chart-choices"),
});
let shownSession = null, shownMap = null, fetching = false, latest = null, tablesDue = null;

const uncertainty = new Uncertainty(map, {
  box: byId("uncertainty"), legend: byId("uncertainty-legend"), details: byId("uncertainty-as-table"), table: byId("uncertainty-table"),
}, async () => {
  const found = await unpacked(await ask("/api/deviation"));
  if (found.head.session !== sessionOf(latest)) throw new Error("another session runs now");
  return found;
});
// the server computes no more than one in two seconds
const UNCERTAINTY_MS = 2000;
let uncertaintyAsked = 0;

const drawing = new RegionDrawing(map, byId("draw"), byId("drawn"));

function showAnswer(call, text, kind) {
  byId("answer").className = kind;
  byId("answer").textContent = `${call}: ${text}`;
}

// a command; what the daemon answers is shown
async function send(command) {
  showAnswer(command.call, "sent", "");
  let [text, kind] = ["done", ""];
  try {
    const answer = await fetch("/api/control", {
      method: "POST",
      headers: { Authorization: `Bearer ${secret}`, "Content-Type": "application/json" },
      body: JSON.stringify(command),
    });
    if (!answer.ok) [text, kind] = [(await answer.text()).trim(), "bad"];
  } catch (error) {
    [text, kind] = [`not known whether it was received (${error.message})`, "bad"];
  }
  showAnswer(command.call, text, kind);
}
const alarmList = new AlarmList(byId("alarms"), send);

// the next state when the last one has arrived
async function follow() {
  let version = null;
  for (;;) {
    try {
      const state = await (await ask(version === null ? "/api/state" : `/api/state/${version}`)).json();
      version = state.version;
      show(state);
    } catch (error) {
      version = null;
      trouble(`no connection to tactus web (${error.message}); trying again`);
      await new Promise(resume => setTimeout(resume, 2000));
    }
  }
}

function show(state) {
  latest = state;
  trouble(state.trouble && (state.daemon ? state.trouble : `no daemon: ${state.trouble}`));
  const simulated = (state.frame && state.frame.simulated) || (state.daemon && state.daemon.simulated);
  byId("simulated").hidden = !simulated;
  byId("session").textContent = state.session
    ? `${state.session.id}, ${state.session.state}${state.frame ? `, frame ${state.frame.sequence}, ${clock(state.frame.wall_ms)}` : ""}`
    : "no session runs";
  const calling = alarmList.show(state.alarms, state.control);
  document.title = calling.length ? `ALARM ${calling.join(", ")} - Tactus` : "Tactus";
  byId("control").hidden = !state.control;
  byId("pressing").hidden = !simulated;
  keepCertain(state);
  if (state.session && map.values && shownSession !== state.session.id) clearMap();
  if (state.frame) {
    if (state.frame.map) showMap(state);
    charts.count(sessionOf(state), state.frame);
    if (state.frame.map && !state.frame.provisional) charts.add(state.frame);
    showVerdict(state.frame);
  }
  if (tablesDue === null) tablesDue = setTimeout(showTables, TABLES_MS);
}

function showTables() {
  tablesDue = null;
  showState(latest);
  showEvents(latest.events);
  if (latest.frame) showQuantities(latest.frame);
  if (byId("map-as-table").open) showGrid();
}

function showVerdict(frame) {
  const at = byId("verdict");
  const { tracked, quality, quantities } = frame;
  let [text, kind] = ["", "good"];
  if (!frame.map) [text, kind] = ["no map of this frame yet", "warn"];
  else if (frame.provisional) [text, kind] = [frame.provisional, "soft"];
  else if (quantities && quantities.reason) [text, kind] = [`not known: ${quantities.reason}`, "bad"];
  else if (tracked && !tracked.known) [text, kind] = [`not known: ${tracked.text || tracked.reason}`, "bad"];
  else if (quality && quality.verdict !== "sound") {
    [text, kind] = [`${quality.verdict}: ${(quality.reasons || []).map(reason => reason.text).join("; ")}`, quality.verdict === "doubtful" ? "warn" : "bad"];
  } else text = tracked ? `known to be true; the sheet is ${tracked.judgement}` : "no check has found a fault in this map";
  // the same sentence again would be read aloud again
  if (at.textContent !== text) at.textContent = text;
  at.className = kind;
}

const sessionOf = state => state?.session?.id ?? "";

// nothing of an earlier session stays under the name of a new one
function clearMap() {
  [shownSession, shownMap, map.values, map.frame] = [null, null, null, null];
  map.tracks.clear();
  uncertainty.clear();
  byId("verdict").textContent = "";
}

// the map of a frame, which has another name while it is provisional
const mapName = frame => `${frame.provisional ? "provisional" : "map"}/${frame.sequence}`;

async function showMap(state) {
  const { frame, session } = state;
  if (fetching || (session && shownSession === session.id && shownMap === mapName(frame))) return;
  fetching = true;
  // an answer of another session, which began since: the state that names it is on its way
  const askOf = async path => {
    const answer = await ask(path);
    if ((answer.headers.get("Tactus-Session") || "") !== sessionOf(state)) throw new Error("another session");
    return answer;
  };
  try {
    const isNew = !map.geometry || (session && shownSession !== session.id);
    const [colours, geometry, values] = await Promise.all([
      map.colours || ask("/api/colours").then(answer => answer.json()),
      isNew && askOf("/api/geometry").then(answer => answer.json()),
      askOf(`/api/${mapName(frame)}`).then(answer => answer.arrayBuffer()).then(bytes => new Float32Array(bytes)),
    ]);
    if (sessionOf(latest) !== sessionOf(state)) throw new Error("another session");
    if (!map.colours) {
      map.colours = colours;
      map.drawBar();
    }
    if (geometry) map.setGeometry(geometry);
    shownSession = session ? session.id : shownSession;
    shownMap = mapName(frame);
    const fixed = parseFloat(byId("fixed").value);
    const largest = values.reduce((most, value) => Math.max(most, value), 0);
    const noise = (session && frame.unit !== "kPa" && session.map_noise) || 0;
    const top = fixed > 0 ? fixed : Math.max(largest, noise) || 1;
    map.setMap(values, frame, top);
    byId("high").textContent = rounded(top);
    byId("unit").textContent = frame.unit + (largest <= noise ? ", nothing above the noise" : "");
    document.body.dataset.sequence = frame.sequence;
    document.body.dataset.kind = frame.provisional ? "provisional" : "exact";
    if (uncertainty.on && performance.now() - uncertaintyAsked >= UNCERTAINTY_MS) {
      uncertaintyAsked = performance.now();
      uncertainty.refresh();
    }
  } catch (error) {
    // the map has been replaced by a newer one, or the session by another
  } finally {
    fetching = false;
  }
  // a newer one may have come meanwhile
  if (latest && latest.frame && latest.frame.map && mapName(latest.frame) !== shownMap && latest !== state) showMap(latest);
}

// Standard deviations of quantities and widths of hot spots, by name and number: the daemon computes them once a second of frames,
// and they change little from one frame to the next.
const CERTAIN_MS = 2000;
let certain = { atMs: 0, session: null, deviations: {}, spots: new Map() };

function keepCertain({ frame, session }) {
  if (!frame || !frame.quantities || !session) return;
  const { regions, spots } = frame.quantities;
  const some = regions.some(region => Object.keys(region.deviations).length);
  const recent = session.id === certain.session && Math.abs(frame.wall_ms - certain.atMs) <= CERTAIN_MS;
  // without a load there is nothing uncertain
  if (!some && recent && regions[0].values.load > 0) return;
  const deviations = {};
  for (const [name] of QUANTITIES) deviations[name] = regions.map(region => region.deviations[name]);
  const wide = spots.filter(spot => spot.uncertainty).map(spot => [spot.number, spot.uncertainty]);
  certain = { atMs: frame.wall_ms, session: session.id, deviations, spots: new Map(wide) };
}

function showSpots(quantities, pressure) {
  const load = pressure ? "load, N" : "load, mm\u00b2 lost";
  const heads = ["x, mm", "y, mm", "within (95 %), mm", pressure ? "kPa" : "lost share", load, "95 %", "area, mm\u00b2", "age, s"];
  const rows = [row(["number", ...heads.map(number => ({ number }))], true)];
  for (const spot of quantities.spots) {
    const wide = certain.spots.get(spot.number);
    const between = wide ? wide.load_interval.map(rounded).join(" to ") : "\u2013";
    const within = wide ? rounded(wide.half_axes_mm[0]) : "\u2013";
    const [x, y] = spot.centre_mm.map(rounded);
    const texts = [x, y, within, rounded(spot.peak), rounded(spot.load), between, rounded(spot.area_mm2), rounded(spot.age_s)];
    rows.push(row([`${spot.number}`, ...texts.map(number => ({ number }))]));
  }
  byId("spots").replaceChildren(...rows);
}

function showQuantities(frame) {
  const quantities = frame.quantities;
  const pressure = quantities && quantities.unit === "pressure";
  const regions = quantities ? quantities.regions : [];
  // those of the last map stay, dimmed
  byId("quantities").classList.toggle("old", !quantities);
  if (!quantities) return;
  const rows = [row(["", ...regions.map(region => ({ number: region.name })), "unit"], true)];
  for (const [name, words, calibrated, plain] of QUANTITIES) {
    const values = regions.map(region => region.values[name]);
    if (values.every(value => value === undefined)) continue;
    const sds = certain.deviations[name] || [];
    const cells = values.map((value, index) => ({ number: value === undefined ? "\u2013" : withDeviation(value, sds[index]) }));
    rows.push(row([words, ...cells, pressure ? calibrated : plain]));
  }
  if (rows.length === 1) rows.push(row([quantities.reason || "not known", "", ""]));
  byId("quantities").replaceChildren(...rows);
  showSpots(quantities, pressure);
}

function showState(state) {
  const { daemon, session } = state;
  const rows = [];
  const add = (name, value) => { if (value !== null && value !== undefined && value !== "") rows.push(row([name, `${value}`])); };
  if (daemon) {
    add("daemon", `${daemon.state}, version ${daemon.version}`);
    add("current source", daemon.source_state);
    add("rig lost", daemon.lost);
    add("instruments", daemon.instruments.join("; "));
    add("troubles", daemon.troubles.join("; ") || "none");
    add("baseline", daemon.baseline && `${daemon.baseline}${daemon.baseline_age_s ? `, ${duration(daemon.baseline_age_s)} (h:min:s) old` : ""}`);
    add("baseline, warning", daemon.baseline_remarks.join("; "));
    add("method", daemon.method);
    add("disk full in", daemon.disk_days && `${rounded(daemon.disk_days)} days`);
    add("electrodes", electrodesInWords(state.frame));
    add("last error", daemon.last_error);
  }
  if (session) {
    add("session", `${session.kind}, ${session.state}`);
    add("frames", `${session.frames}, ${session.failed} failed, ${session.dropped} missed`);
    add("no map because", session.last_error);
  }
  byId("state").replaceChildren(...rows);
}

function electrodesInWords(frame) {
  if (!map.geometry || !frame) return null;
  const count = map.geometry.electrodes.length / 2;
  const words = [...electrodeStates(frame)].sort((a, b) => a[0] - b[0]).map(([number, { state, text }]) => `${number} ${state === "left_out" ? "left out" : "doubtful"} (${text})`);
  return `${count}${words.length ? `: ${words.join("; ")}; the others are used` : ", all used"}`;
}

// the map as a table, for those who cannot see it
function showGrid() {
  if (!map.values || !map.geometry) return;
  const cell = value => ({ number: value === undefined ? "\u2013" : rounded(value) });
  byId("map-table").replaceChildren(...gridRows(map.grid(GRID), cell));
}

function showEvents(events) {
  byId("events").replaceChildren(...events.map(event => {
    const item = document.createElement("li");
    const time = document.createElement("time");
    time.dateTime = new Date(event.wall_ms).toISOString();
    time.textContent = `${clock(event.wall_ms)} `;
    item.append(time, `${event.kind}: ${event.text}`);
    return item;
  }));
}

function showPlace(at) {
  byId("pointer").textContent = at ? `(${at.x.toFixed(1)}, ${at.y.toFixed(1)}) mm: ${withUnit(at.value, map.frame.unit)}${uncertainty.at(at)}` : "";
}

const pressing = () => !drawing.active && byId("press").checked && !byId("control").hidden && !byId("pressing").hidden;
// a disc at a place of the map
function press(at) {
  const [size, loss] = ["press-size", "press-loss"].map(name => byId(name).valueAsNumber);
  if (isNaN(size) || isNaN(loss)) return showAnswer("press", "size and loss must be numbers", "bad");
  send({ call: "press", x_m: at.x / 1000, y_m: at.y / 1000, size_m: size / 1000, loss: loss / 100 });
}

byId("map").addEventListener("pointermove", event => showPlace(map.valueAt(event.offsetX, event.offsetY)));
// the arrow keys move a cursor, Enter presses
byId("map").addEventListener("keydown", event => {
  const moves = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowDown: [0, -1], ArrowUp: [0, 1] };
  if (!map.geometry || !(moves[event.key] || event.key === "Enter")) return;
  event.preventDefault();
  const from = map.cursor || [0, 1].map(axis => (map.low[axis] + map.high[axis]) / 2);
  if (event.key === "Enter") {
    const at = map.cursor && map.valueAtPlace(map.cursor);
    if (at && pressing()) press(at);
    return;
  }
  const step = event.shiftKey ? FINE_STEP_MM : STEP_MM;
  map.cursor = [0, 1].map(axis => Math.max(map.low[axis], Math.min(map.high[axis], from[axis] + step * moves[event.key][axis])));
  byId("pointer").setAttribute("aria-live", "polite");
  showPlace(map.valueAtPlace(map.cursor));
  map.request();
});
byId("map").addEventListener("blur", () => { map.cursor = null; byId("pointer").setAttribute("aria-live", "off"); map.request(); });
byId("map-as-table").addEventListener("toggle", showGrid);
byId("tracks").addEventListener("change", event => { map.showTracks = event.target.checked; map.tracks.clear(); map.request(); });
byId("numbers").addEventListener("change", event => { map.showNumbers = event.target.checked; map.request(); });
byId("region-lines").addEventListener("change", event => { map.showRegion = event.target.checked; map.request(); });
byId("fixed").addEventListener("input", () => { shownMap = null; if (latest && latest.frame && latest.frame.map) showMap(latest); });
byId("start").addEventListener("click", () => {
  const every = byId("every");
  // an empty field leaves the configured time; a text that is no number has an empty value too
  if (every.validity.badInput) return showAnswer("start", "the time between frames must be a number", "bad");
  send(every.value === "" ? { call: "start" } : { call: "start", every_s: every.valueAsNumber });
});
byId("stop").addEventListener("click", () => send({ call: "stop" }));
byId("baseline").addEventListener("click", () => send({ call: "baseline" }));
byId("release").addEventListener("click", () => send({ call: "release" }));
byId("map").addEventListener("click", event => {
  const at = pressing() && map.valueAt(event.offsetX, event.offsetY);
  if (at) press(at);
});
window.addEventListener("resize", () => { map.request(); charts.draw(true); });
follow();
