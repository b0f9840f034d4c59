// Plots of one agent from the history of the server: minutes, or since the arming.

import uPlot from "../vendor/uPlot.esm.js";
import { getJson } from "./api.js";
import { el, setText } from "./dom.js";
import { historyProblem, store, utcNow } from "./store.js";
import { clock } from "./words.js";

const EVERY_MS = 5000;
const RANGES = [["5", "5 min"], ["15", "15 min"], ["60", "1 h"], ["armed", "since arming"]];
const RADIO = ["rssi", "remrssi", "noise", "remnoise", "txbuf"];
const LOAD = ["cpu", "memory", "temperature"];
const HEIGHT = 130;
let state = null;

/** Fill `place` with the plots of this agent, and keep them current until `stopPlots`. */
export function startPlots(place, name) {
  const note = el("p", { class: "quiet", role: "status" });
  const area = el("div", { class: "plots" });
  const ranges = el("div", { class: "ranges", role: "group", "aria-label": "Range of the plots" });
  const mine = { name, range: "5", plots: new Map(), area, note, ranges, kinds: null };
  state = mine;
  for (const [range, text] of RANGES) {
    ranges.append(el("button", { type: "button", "data-range": range, text, "aria-pressed": String(range === mine.range), on: { click: () => choose(mine, range) } }));
  }
  place.replaceChildren(ranges, note, area);
  mine.timer = setInterval(() => draw(mine), EVERY_MS);
  mine.watch = new ResizeObserver(() => resize(mine));
  mine.watch.observe(area);
  draw(mine);
}

export function stopPlots() {
  if (!state) return;
  clearInterval(state.timer);
  state.watch.disconnect();
  for (const plot of state.plots.values()) plot.chart.destroy();
  state = null;
}

function choose(mine, range) {
  mine.range = range;
  for (const one of mine.ranges.children) one.setAttribute("aria-pressed", String(one.dataset.range === range));
  draw(mine);
}

async function draw(mine) {
  if (store.link !== "live" || document.hidden || mine.busy) return;
  mine.busy = true;
  try {
    const wanted = await kinds(mine);
    const flight = mine.range === "armed" ? await getJson("api/history/flight", { agent: mine.name }) : null;
    mine.area.hidden = flight?.since === null;
    setText(mine.note, [flight ? flightWords(flight) : "", wanted.length ? "" : "No values yet.", missing(wanted), historyProblem()].filter(Boolean).join(" "));
    if (!mine.area.hidden) for (const kind of wanted) if (state === mine) await drawOne(mine, kind, flight);
  } catch (error) {
    setText(mine.note, error.status === 404 ? "There is no history: nothing to plot." : `No plots: ${error.message}. ${historyProblem()}`);
  } finally {
    mine.busy = false;
  }
}

/** What has no values until an operator requests it, in words. A replay and an agent's own page have no requests. */
function missing(wanted) {
  if (store.ground.page !== "gcs") return "";
  const names = [["load", (kind) => LOAD.includes(kind)], ["topic rates", (kind) => kind.startsWith("topic ")]]
    .filter(([, fits]) => !wanted.some(({ kind }) => fits(kind))).map(([name]) => name);
  return names.length ? `Plotted once requested (see Requests): ${names.join(", ")}.` : "";
}

function flightWords(flight) {
  if (flight.since === null) return "No arming of this autopilot is known.";
  const begin = `Armed ${flight.seen ? "" : "before "}${clock(flight.since)}`;
  return flight.until === null ? `${begin.replace("Armed", "Armed since")} UTC.` : `${begin} to ${clock(flight.until)} UTC.`;
}

async function kinds(mine) {
  const own = (await getJson("api/history/kinds", { agent: mine.name })).kinds.map((kind) => ({ ...kind, agent: mine.name }));
  const link = store.agents.get(mine.name)?.link;
  if (!link) return own;
  try {
    const radio = (await getJson("api/history/kinds", { agent: `link:${link}` })).kinds;
    return [...own, ...radio.filter((kind) => RADIO.includes(kind.kind)).map((kind) => ({ ...kind, agent: `link:${link}` }))];
  } catch {
    return own;
  }
}

async function drawOne(mine, kind, flight) {
  const utc = utcNow();
  if (utc === null) return;
  const [since, until] = flight ? [flight.since, flight.until ?? Math.max(utc, flight.since)] : [Math.round(utc - 60 * Number(mine.range)), utc];
  const points = (await getJson("api/history/series", { agent: kind.agent, kind: kind.kind, since, until, points: 400 })).points;
  if (state !== mine) return;
  const data = [[], [], []];
  for (const point of points) {
    if (point === null) continue;
    data[0].push(point[0]);
    data[1].push(point[1]);
    data[2].push(point[2] ?? point[1]);
  }
  const id = `${kind.agent} ${kind.kind}`;
  let plot = mine.plots.get(id);
  if (!plot) mine.plots.set(id, (plot = make(mine, kind)));
  plot.range = [since, until];
  plot.chart.setData(data);
  const newest = data[1].findLast((value) => value !== null);
  setText(plot.value, newest === undefined ? "no values" : `${Number(newest.toPrecision(4))} ${kind.unit}`);
}

function make(mine, kind) {
  const style = getComputedStyle(document.documentElement);
  const colour = (name) => style.getPropertyValue(name).trim();
  const plot = { range: [0, 1], value: el("strong") };
  const holder = el("div", { "aria-hidden": "true" });
  mine.area.append(el("figure", {}, el("figcaption", {}, `${kind.label} `, plot.value), holder));
  const axis = { stroke: colour("--muted"), grid: { stroke: colour("--line"), width: 1 }, ticks: { show: false }, font: "12px system-ui, sans-serif" };
  plot.chart = new uPlot({
    width: Math.max(200, holder.clientWidth), height: HEIGHT, legend: { show: false }, cursor: { drag: { x: false, y: false } },
    scales: { x: { time: true, range: () => plot.range }, y: { range: (_, low, high) => span(kind, low, high) } },
    axes: [{ ...axis, size: 26, space: 70, values: (_, at) => at.map((utc) => new Date(utc * 1000).toISOString().slice(11, 19)) }, { ...axis, size: 46 }],
    series: [{}, { stroke: colour("--plot"), width: 2, spanGaps: false, points: { show: false } },
      { stroke: colour("--plot-max"), width: 1, spanGaps: false, points: { show: false } }],
  }, [[], [], []], holder);
  plot.holder = holder;
  return plot;
}

function span(kind, low, high) {
  if (low === null || low === undefined) return [0, 1];
  if (kind.kind === "level") return [0, 3];
  if (kind.unit === "%") return [0, 100];
  const room = Math.max((high - low) * 0.1, Math.abs(high) * 0.02, 0.1);
  return [low >= 0 ? Math.max(0, low - room) : low - room, high + room];
}

function resize(mine) {
  for (const plot of mine.plots.values()) plot.chart.setSize({ width: Math.max(200, plot.holder.clientWidth), height: HEIGHT });
}
