// The path of a command, from the ground to the autopilot, with its first broken hop.

import { el, said, svg } from "./dom.js";

const TITLES = {
  ground: "Ground", radio: "Radio", computer: "Computer", container: "Container", node: "Node", autopilot: "Autopilot",
};
const WORDS = { ok: "works", broken: "BROKEN", perhaps: "BROKEN?", unknown: "unknown" };
const ICONS = {
  ground: "M3 17h18M6 17V7h12v10M9 20h6",
  radio: "M12 21V11M8 7a5.6 5.6 0 0 1 8 0M5 4a9.9 9.9 0 0 1 14 0M12 10v.5",
  computer: "M6 6h12v12H6zM9 3v3M15 3v3M9 18v3M15 18v3M3 9h3M3 15h3M18 9h3M18 15h3",
  container: "M3 8l9-4 9 4v8l-9 4-9-4zM3 8l9 4 9-4M12 12v8",
  node: "M12 4v5M7 20l3.5-6M17 20l-3.5-6M12 14a2.5 2.5 0 1 0 0-5 2.5 2.5 0 0 0 0 5z",
  autopilot: "M12 3l7 18-7-4-7 4z",
};
const MARKS = {
  ok: "M-5 0l3.5 4L5-4", broken: "M-4-4L4 4M4-4L-4 4", perhaps: "M-3-3a3 3 0 1 1 4 3q-1 .6-1 2M0 5v.1", unknown: "M-4 0H4",
};
const STEP = 112;

/** The drawing and its reason in words. hops: of the row of an agent. */
export function path(hops) {
  const broken = hops.find((hop) => hop.state === "broken" || hop.state === "perhaps");
  const words = hops.map((hop) => `${TITLES[hop.name] ?? hop.name} ${WORDS[hop.state] ?? hop.state}`).join(", ");
  const width = STEP * hops.length;
  const drawing = svg("svg", { viewBox: `0 0 ${width} 104`, class: "path", role: "img", "aria-label": `Path of a command: ${words}` });
  hops.forEach((hop, at) => {
    const middle = STEP * at + STEP / 2;
    if (at) drawing.append(wire(middle, hop.state, Boolean(broken) && hops.indexOf(broken) < at));
    drawing.append(station(hop, middle));
  });
  const reasons = hops.filter((hop) => hop.text);
  return el("div", { class: "hops" }, drawing, broken ? null : el("p", { class: "quiet", text: "No broken hop is known." }),
    ...reasons.map((hop) => el("p", { class: `reason h-${hop.state}` },
      el("strong", { text: `${TITLES[hop.name] ?? hop.name} ${WORDS[hop.state] ?? ""}: ` }), said(hop.text))));
}

function wire(middle, state, after) {
  const broken = state === "broken" || state === "perhaps";
  const from = middle - STEP + 30;
  const to = middle - 30;
  const group = svg("g", { class: `wire w-${state} ${after ? "after" : ""}` });
  if (!broken) return fillWire(group, [[from, to]]);
  const gap = (from + to) / 2;
  fillWire(group, [[from, gap - 9], [gap + 9, to]]);
  group.append(svg("path", { class: "cut", d: `M${gap - 6} 27l12 18M${gap + 6} 27l-12 18` }));
  return group;
}

function fillWire(group, parts) {
  for (const [from, to] of parts) group.append(svg("line", { x1: from, x2: to, y1: 36, y2: 36 }));
  return group;
}

function station(hop, middle) {
  return svg("g", { class: `hop h-${hop.state}`, transform: `translate(${middle} 36)` },
    svg("rect", { x: -26, y: -26, width: 52, height: 52, rx: 12 }),
    svg("path", { class: "icon", d: ICONS[hop.name] ?? ICONS.node, transform: "translate(-15 -15) scale(1.25)" }),
    svg("circle", { class: "badge", cx: 24, cy: -22, r: 11 }),
    svg("path", { class: "mark", d: MARKS[hop.state] ?? MARKS.unknown, transform: "translate(24 -22)" }),
    svg("text", { y: 46, class: "title", text: TITLES[hop.name] ?? hop.name }),
    svg("text", { y: 62, class: "word", text: WORDS[hop.state] ?? hop.state }));
}
