"use strict";
// What both pages need: the token, requests, tables, numbers as text. The token comes from the address (after #) and is kept for
// this tab.

// name of a quantity: words, unit with a calibration, unit without
const QUANTITIES = [
  ["load", "Load", "N", "mm\u00b2 lost"],
  ["contact", "Contact area", "mm\u00b2", "mm\u00b2"],
  ["ppi", "Peak pressure index", "kPa", "lost share"],
  ["mean", "Mean over the contact", "kPa", "lost share"],
  ["peak", "Peak of one triangle", "kPa", "lost share"],
  ["dispersion", "Dispersion index", "%", "%"],
  ["variation", "Coefficient of variation", "%", "%"],
  ["centre-x", "Centre of pressure, x", "mm", "mm"],
  ["centre-y", "Centre of pressure, y", "mm", "mm"],
  ["speed", "Speed of the centre", "mm/s", "mm/s"],
  ["dose", "Largest dose", "kPa s", "lost share s"],
  ["unrelieved", "Longest unrelieved time", "s", "s"],
  ["unrelieved-area", "Unrelieved area", "mm\u00b2", "mm\u00b2"],
];
const byId = id => document.getElementById(id);

function token() {
  const given = new URLSearchParams(location.hash.slice(1)).get("token");
  if (given) {
    sessionStorage.setItem("token", given);
    history.replaceState(null, "", location.pathname);
  }
  return sessionStorage.getItem("token") || "";
}
const secret = token();

async function ask(path) {
  const answer = await fetch(path, { headers: { Authorization: `Bearer ${secret}` }, cache: "default" });
  if (!answer.ok) throw new Error((await answer.text()).trim() || `${path}: ${answer.status}`);
  return answer;
}

function trouble(text) {
  byId("trouble").hidden = !text;
  byId("trouble").textContent = text || "";
}

const clock = ms => new Date(ms).toLocaleTimeString();

function row(cells, head) {
  const tr = document.createElement("tr");
  for (const [index, cell] of cells.entries()) {
    const at = document.createElement(head || index === 0 ? "th" : "td");
    if (head) at.scope = "col"; else if (index === 0) at.scope = "row";
    if (cell && cell.number !== undefined) { at.className = "number"; at.textContent = cell.number; } else at.textContent = cell;
    tr.append(at);
  }
  return tr;
}

// a figure with a caption and a canvas, at the end of an element
function figureIn(parent) {
  const [figure, caption, canvas] = ["figure", "figcaption", "canvas"].map(name => document.createElement(name));
  canvas.setAttribute("role", "img");
  figure.append(caption, canvas);
  parent.append(figure);
  return { caption, canvas };
}

// an empty canvas of this height, CSS pixels, in pixels of the screen; null while it has no width
function cleared(canvas, cssHeight) {
  const pixels = Math.max(1, window.devicePixelRatio || 1);
  const [width, height] = [Math.round(canvas.clientWidth * pixels), Math.round(cssHeight * pixels)];
  if (!width) return null;
  Object.assign(canvas, { width, height });
  return { context: canvas.getContext("2d"), width, height, pixels };
}

// the names in a list of regions; the chosen one stays chosen
function setRegionNames(list, names) {
  if (names.join() === [...list.options].map(option => option.value).join()) return;
  const chosen = list.value;
  list.replaceChildren(...names.map(name => new Option(name, name)));
  if (names.includes(chosen)) list.value = chosen;
}

// rows of a table of values at places of the map
const gridRows = ({ columns, rows }, cell) => [
  row(["y, mm \u2193  x, mm \u2192", ...columns.map(mm => ({ number: mm.toFixed(0) }))], true),
  ...rows.map(({ mm, values }) => row([mm.toFixed(0), ...Array.from(values, cell)])),
];

// a value with its standard deviation, where that is known
function withDeviation(value, deviation) {
  return rounded(value) + (deviation ? ` \u00b1 ${rounded(deviation)}` : "");
}

// three digits, without an exponent
function rounded(value) {
  const size = Math.abs(value);
  if (size >= 100 || size === 0) return value.toFixed(0);
  if (size >= 10) return value.toFixed(1);
  return value.toFixed(size >= 1 ? 2 : 3);
}

// h:min:s
function duration(seconds) {
  const two = number => String(number).padStart(2, "0");
  const whole = Math.round(seconds);
  return `${Math.floor(whole / 3600)}:${two(Math.floor(whole / 60) % 60)}:${two(whole % 60)}`;
}

// a value with its unit; times as h:min:s
const withUnit = (value, unit) => unit === "s" ? duration(value) : `${rounded(value)} ${unit}`.trim();
