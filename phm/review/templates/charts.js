
// A separate block: uPlot before it has its own names.
{
const charts = JSON.parse(document.getElementById("data").textContent);
const place = document.getElementById("plots");
const element = (tag, text, kind) => { const made = document.createElement(tag); if (text !== undefined) made.textContent = text; if (kind) made.className = kind; return made; };
const hue = (number) => `hsl(${Math.round(number * 137.5 + 210) % 360} 60% 48%)`;
const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
const shown = [];

function marked(marks) {
  return (plot) => {
    const { ctx: pen } = plot, { left, top, width, height } = plot.bbox, ratio = devicePixelRatio || 1;
    pen.save(); pen.strokeStyle = pen.fillStyle = colour("warn"); pen.lineWidth = ratio; pen.font = `${11 * ratio}px system-ui, sans-serif`; pen.textAlign = "right";
    // Names are above the plot, where they hide no point.
    marks.forEach(([name, x], number) => {
      const px = plot.valToPos(x, "x", true); if (px < left || px > left + width) return;
      pen.beginPath(); pen.moveTo(px, top); pen.lineTo(px, top + height); pen.stroke(); pen.fillText(name, px + 4 * ratio, top - (4 + number * 14) * ratio);
    });
    pen.restore();
  };
}
function look(chart, number, one) {
  const stroke = hue(number);
  if (chart.kind === "dots") return { label: one.name, stroke, paths: () => null, points: { show: true, size: 7, width: 0, fill: stroke } };
  const paths = chart.kind === "steps" ? { paths: uPlot.paths.stepped({ align: 1 }) } : {};
  return { label: one.name, stroke, width: chart.kind === "steps" ? 2 : 1.3, spanGaps: true, points: { show: false }, ...paths };
}
function draw(chart) {
  const box = element("div", undefined, "plot"), rows = chart.rows || [];
  box.append(element("h3", `${chart.title}${chart.unit ? ` (${chart.unit})` : ""}`)); place.append(box);
  const axis = { stroke: colour("dim"), grid: { stroke: colour("line"), width: 1 }, ticks: { stroke: colour("line") } };
  const x = chart.log ? { time: false, distr: 3, range: chart.log } : { time: false };
  const y = rows.length ? { range: [-0.5, rows.length - 0.5], dir: -1 } : {};
  const named = rows.length ? { size: 250, splits: () => rows.map((_, number) => number), values: (_, all) => all.map((number) => rows[number] ?? "") } : { size: 62 };
  const above = 8 + 14 * (chart.marks || []).filter(([name]) => name).length;
  const joined = chart.kind === "dots" ? [chart.series[0].x, chart.series[0].y] : uPlot.join(chart.series.map((one) => [one.x, one.y]));
  shown.push(new uPlot({
    width: Math.max(280, box.clientWidth - 14), height: above + (rows.length ? 90 + 18 * rows.length : 230), padding: [above, null, null, null], scales: { x, y },
    series: [{ label: "at" }, ...chart.series.map((one, number) => look(chart, number, one))],
    axes: [{ ...axis, label: chart.x, labelSize: 18 }, { ...axis, ...named }],
    legend: { show: chart.series.length > 1 && chart.series.length <= 12 }, hooks: { draw: chart.marks?.length ? [marked(chart.marks)] : [] },
  }, joined, box));
}
function redraw() { for (const plot of shown.splice(0)) plot.destroy(); place?.replaceChildren(); charts.forEach(draw); }
redraw();
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
document.documentElement.dataset.ready = "yes";
}
