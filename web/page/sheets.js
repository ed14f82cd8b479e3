"use strict";
// All machines of the archive's catalogue: who is silent, whose alarms are active, whose maps are not known; sessions to play.

const REFRESH_MS = 30000;
// least share of frames whose map is known to be true
const KNOWN = 0.9;
let machines = [], chosen = null;

const when = text => text ? new Date(text).toLocaleString() : "\u2013";
const named = machine => `${machine.site}/${machine.daq}`;

// seconds as the largest unit that fits
function ago(seconds) {
  if (seconds === null) return "not known";
  for (const [unit, length] of [["d", 86400], ["h", 3600], ["min", 60]]) if (seconds >= 2 * length) return `${Math.floor(seconds / length)} ${unit}`;
  return `${Math.max(0, Math.round(seconds))} s`;
}

// what is wrong with a machine, the worst first
function problems(machine) {
  const found = [];
  const limit = parseFloat(byId("limit").value);
  if (machine.alarms.length) found.push({ bad: true, text: `ALARM ${machine.alarms.join(", ")}` });
  if (machine.invalid_alarms.length) found.push({ text: `cannot be judged: ${machine.invalid_alarms.join(", ")}` });
  if (machine.silent_s === null || machine.silent_s > limit) found.push({ text: `silent for ${machine.silent_s === null ? "an unknown time" : ago(machine.silent_s)}` });
  if (machine.clock_ahead_s !== null) found.push({ text: `its clock is ${ago(machine.clock_ahead_s)} ahead` });
  if (machine.known !== null && machine.known < KNOWN) found.push({ text: `maps known in ${Math.floor(100 * machine.known)} % of the last ten minutes` });
  return found;
}

const kind = found => !found.length ? "good" : found[0].bad ? "bad" : "warn";

async function refresh() {
  try {
    machines = await (await ask("/api/sheets")).json();
    // bed2 before bed10
    machines.sort((a, b) => named(a).localeCompare(named(b), undefined, { numeric: true }));
    trouble("");
    byId("read").textContent = `read at ${clock(Date.now())}; alarms and events come with closed parts, quantities each minute`;
    draw();
  } catch (error) {
    trouble(error.message);
  }
}

function draw() {
  const judged = machines.map(machine => ({ machine, found: problems(machine) }));
  const count = name => judged.filter(({ found }) => kind(found) === name).length;
  byId("counts").textContent = `${machines.length} machine${machines.length === 1 ? "" : "s"}: ${count("bad")} with an active alarm, ${count("warn")} with another problem, ${count("good")} without problems`;
  const sites = [...new Set(machines.map(machine => machine.site))];
  byId("sites").replaceChildren(...sites.map(site => {
    const line = document.createElement("p");
    line.className = "site";
    const name = document.createElement("strong");
    name.textContent = site;
    const of_site = judged.filter(({ machine }) => machine.site === site);
    line.append(name, ...of_site.map(({ machine, found }) => {
      // the table below has the same for those who do not see
      const square = document.createElement("span");
      square.className = `machine ${kind(found)}`;
      square.title = `${named(machine)}: ${found.map(problem => problem.text).join("; ") || "no problem"}`;
      square.setAttribute("aria-hidden", "true");
      square.addEventListener("click", () => choose(machine));
      return square;
    }));
    return line;
  }));
  const only = byId("filter").value === "attention";
  const order = ["bad", "warn", "good"];
  const shown = judged.filter(({ found }) => !only || found.length).sort((a, b) => order.indexOf(kind(a.found)) - order.indexOf(kind(b.found)));
  const rows = shown.map(({ machine, found }) => {
    const tr = row(["", found.map(problem => problem.text).join("; ") || "no problem", when(machine.last_quantity), when(machine.last_archived),
      { number: machine.frames.toLocaleString() }, `${machine.session || "\u2013"}${machine.simulated ? " (SIMULATED)" : ""}`]);
    const button = document.createElement("button");
    button.className = "link";
    button.textContent = named(machine);
    button.addEventListener("click", () => choose(machine));
    tr.firstChild.replaceChildren(button);
    tr.className = kind(found);
    return tr;
  });
  const head = row(["Machine", "State", "Last minute with quantities", "Last part archived", { number: "Frames" }, "Newest session"], true);
  const none = machines.length ? "no machine needs attention" : "the archive has no machine that this role may see";
  byId("machines").replaceChildren(head, ...(rows.length ? rows : [row([none, "", "", "", "", ""])]));
}

async function choose(machine) {
  chosen = named(machine);
  byId("machine-section").hidden = false;
  byId("machine-title").textContent = `Sessions of ${chosen}`;
  byId("machine-sessions").replaceChildren(row(["reading the catalogue"]));
  try {
    const of = chosen;
    const sessions = await (await ask(`/api/sheets/${encodeURIComponent(machine.site)}/${encodeURIComponent(machine.daq)}`)).json();
    if (chosen !== of) return;
    const rows = sessions.map(session => {
      const tr = row(["", `${session.kind}${session.simulated ? " (SIMULATED)" : ""}`, when(session.started), when(session.last_frame),
        { number: session.frames.toLocaleString() }, session.complete ? session.reason : "continues, or parts are missing", session.note]);
      if (session.kind === "measurement" && session.frames) {
        const link = document.createElement("a");
        link.href = `/playback?session=${encodeURIComponent(`archive:${of}/${session.id}`)}`;
        link.textContent = session.id;
        tr.firstChild.replaceChildren(link);
      } else tr.firstChild.textContent = session.id;
      return tr;
    });
    const head = row(["Session", "Kind", "Started", "Last frame", { number: "Frames" }, "Ended", "Note"], true);
    byId("machine-sessions").replaceChildren(head, ...(rows.length ? rows : [row(["no part is archived yet", "", "", "", "", "", ""])]));
    byId("machine-section").scrollIntoView({ block: "nearest" });
  } catch (error) {
    byId("machine-sessions").replaceChildren(row([error.message]));
  }
}

byId("limit").addEventListener("change", draw);
byId("filter").addEventListener("change", draw);
refresh();
setInterval(refresh, REFRESH_MS);
