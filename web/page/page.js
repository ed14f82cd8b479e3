"use strict";
// Follows /api/events and shows the state.

const SPAN_MS = 10 * 60 * 1000;
const map = new SheetMap(byId("map"), byId("bar"));
const charts = ["load", "contact", "ppi", "unrelieved"].map(name => {
  const quantity = QUANTITIES.find(quantity => quantity[0] === name);
  return { quantity, chart: new StripChart(byId("charts"), quantity[1], SPAN_MS) };
});
let shownSession = null, shownSequence = null, fetching = false, latest = null;

const drawing = new RegionDrawing(map, byId("draw"), byId("drawn"));

// a command; what the daemon answers is shown
async function send(command) {
  const answer = await fetch("/api/control", {
    method: "POST",
    headers: { Authorization: `Bearer ${secret}`, "Content-Type": "application/json" },
    body: JSON.stringify(command),
  });
  byId("answer").textContent = answer.ok ? "" : `${command.call}: ${(await answer.text()).trim()}`;
}
const alarmList = new AlarmList(byId("alarms"), send);

// events as they come; the connection is opened again when it ends
async function follow() {
  for (;;) {
    try {
      const reader = (await ask("/api/events")).body.pipeThrough(new TextDecoderStream()).getReader();
      let text = "";
      for (;;) {
        const { value, done } = await reader.read();
        if (done) break;
        text += value;
        let end;
        while ((end = text.indexOf("\n\n")) >= 0) {
          const data = text.slice(0, end).split("\n").filter(line => line.startsWith("data: ")).map(line => line.slice(6)).join("\n");
          text = text.slice(end + 2);
          if (data) show(JSON.parse(data));
        }
      }
      trouble("the connection to tactus web ended; trying again");
    } catch (error) {
      trouble(`no connection to tactus web (${error.message}); trying again`);
    }
    await new Promise(resume => setTimeout(resume, 2000));
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
  alarmList.show(state.alarms, state.control);
  byId("control").hidden = !state.control;
  byId("pressing").hidden = !simulated;
  showState(state);
  showEvents(state.events);
  if (state.frame) {
    showVerdict(state.frame);
    showQuantities(state.frame);
    if (state.frame.map) showMap(state);
  }
}

function showVerdict(frame) {
  const at = byId("verdict");
  const { tracked, quality, quantities } = frame;
  let [text, kind] = ["", "good"];
  if (!frame.map) [text, kind] = ["no map of this frame yet", "warn"];
  else if (quantities && quantities.reason) [text, kind] = [`not known: ${quantities.reason}`, "bad"];
  else if (tracked && !tracked.known) [text, kind] = [`not known: ${tracked.text || tracked.reason}`, "bad"];
  else if (quality && quality.verdict !== "sound") {
    [text, kind] = [`${quality.verdict}: ${(quality.reasons || []).map(reason => reason.text).join("; ")}`, quality.verdict === "doubtful" ? "warn" : "bad"];
  } else text = tracked ? `known to be true; the sheet is ${tracked.judgement}` : "nothing speaks against this map";
  at.textContent = text;
  at.className = kind;
}

async function showMap(state) {
  const { frame, session } = state;
  if (fetching || (session && shownSession === session.id && shownSequence === frame.sequence)) return;
  fetching = true;
  try {
    if (!map.colours) {
      map.colours = await (await ask("/api/colours")).json();
      map.drawBar();
    }
    if (!map.geometry || (session && shownSession !== session.id)) map.setGeometry(await (await ask("/api/geometry")).json());
    const values = new Float32Array(await (await ask(`/api/map/${frame.sequence}`)).arrayBuffer());
    shownSession = session ? session.id : shownSession;
    shownSequence = frame.sequence;
    const fixed = parseFloat(byId("fixed").value);
    const largest = values.reduce((most, value) => Math.max(most, value), 0);
    const noise = (session && frame.unit !== "kPa" && session.map_noise) || 0;
    const top = fixed > 0 ? fixed : Math.max(largest, noise) || 1;
    map.setMap(values, frame, top);
    byId("high").textContent = rounded(top);
    byId("unit").textContent = frame.unit + (largest <= noise ? ", nothing above the noise" : "");
    document.body.dataset.sequence = frame.sequence;
  } catch (error) {
    // the map has been replaced by a newer one, or the session has ended
  } finally {
    fetching = false;
  }
  // a newer one may have come meanwhile
  if (latest && latest.frame && latest.frame.map && latest.frame.sequence !== shownSequence && latest !== state) showMap(latest);
}

function showQuantities(frame) {
  const quantities = frame.quantities;
  const pressure = quantities && quantities.unit === "pressure";
  const regions = quantities ? quantities.regions : [];
  for (const { quantity, chart } of charts) {
    if (!frame.map) break;
    const value = regions.length ? regions[0].values[quantity[0]] : undefined;
    chart.add(frame.wall_ms, value === undefined ? null : value, quantity[pressure ? 2 : 3]);
  }
  if (!quantities) return;
  const rows = [row(["", ...regions.map(region => ({ number: region.name })), "unit"], true)];
  for (const [name, words, calibrated, plain] of QUANTITIES) {
    const values = regions.map(region => region.values[name]);
    if (values.every(value => value === undefined)) continue;
    rows.push(row([words, ...values.map(value => ({ number: value === undefined ? "\u2013" : rounded(value) })), pressure ? calibrated : plain]));
  }
  if (rows.length === 1) rows.push(row([quantities.reason || "not known", "", ""]));
  byId("quantities").replaceChildren(...rows);
  const spots = [row(["number", { number: "x, mm" }, { number: "y, mm" }, { number: pressure ? "kPa" : "lost share" }, { number: "mm\u00b2" }, { number: "age, s" }], true)];
  for (const spot of quantities.spots) {
    spots.push(row([`${spot.number}`, ...[spot.centre_mm[0], spot.centre_mm[1], spot.peak, spot.area_mm2, spot.age_s].map(value => ({ number: rounded(value) }))]));
  }
  byId("spots").replaceChildren(...spots);
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
    add("baseline", daemon.baseline && `${daemon.baseline}${daemon.baseline_age_s ? `, ${rounded(daemon.baseline_age_s / 3600)} h old` : ""}`);
    add("method", daemon.method);
    add("disk full in", daemon.disk_days && `${rounded(daemon.disk_days)} days`);
    add("last error", daemon.last_error);
  }
  if (session) {
    add("session", `${session.kind}, ${session.state}`);
    add("frames", `${session.frames}, ${session.failed} failed, ${session.dropped} missed`);
    add("no map because", session.last_error);
  }
  byId("state").replaceChildren(...rows);
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

byId("map").addEventListener("pointermove", event => {
  const at = map.valueAt(event.offsetX, event.offsetY);
  byId("pointer").textContent = at ? `(${at.x.toFixed(1)}, ${at.y.toFixed(1)}) mm: ${withUnit(at.value, latest.frame.unit)}` : "";
});
byId("numbers").addEventListener("change", event => { map.showNumbers = event.target.checked; map.request(); });
byId("region-lines").addEventListener("change", event => { map.showRegion = event.target.checked; map.request(); });
byId("fixed").addEventListener("input", () => { shownSequence = null; if (latest && latest.frame && latest.frame.map) showMap(latest); });
byId("start").addEventListener("click", () => send({ call: "start", every_s: parseFloat(byId("every").value) || 0 }));
byId("stop").addEventListener("click", () => send({ call: "stop" }));
byId("baseline").addEventListener("click", () => send({ call: "baseline" }));
byId("release").addEventListener("click", () => send({ call: "release" }));
byId("map").addEventListener("click", event => {
  const at = !drawing.active && byId("press").checked && !byId("control").hidden && map.valueAt(event.offsetX, event.offsetY);
  if (at) send({ call: "press", x_m: at.x / 1000, y_m: at.y / 1000, size_m: 0.03, loss: 0.3 });
});
window.addEventListener("resize", () => { map.request(); for (const { chart } of charts) chart.draw(); });
follow();
