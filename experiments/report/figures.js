// Plotly's figures: drawn when they come into sight, each with the view that its menu chooses.
const NARROW = 600, PAPER = 680;

const CONFIG = {
  responsive: true, displaylogo: false,
  modeBarButtonsToRemove: ["lasso2d", "select2d", "autoScale2d", "zoomIn2d", "zoomOut2d"],
  toImageButtonOptions: { format: "svg" },
};

const AXIS = {
  automargin: true, zeroline: false, gridcolor: "#e1e4e8", linecolor: "#5f666d", ticks: "outside", ticklen: 4,
  tickcolor: "#5f666d", title: { standoff: 8 },
};

function merged(base, over) {
  if (over === undefined) return base;
  if (base === null || typeof base !== "object" || Array.isArray(base) || typeof over !== "object" ||
      over === null || Array.isArray(over) || ArrayBuffer.isView(over)) return over;
  const out = { ...base };
  for (const key in over) out[key] = merged(base[key], over[key]);
  return out;
}

function laidOut({ layout, data }, width, height) {
  const narrow = width < NARROW, named = data.filter(t => t.name && t.showlegend !== false && t.type !== "heatmap").length;
  if (narrow && layout.showlegend !== false && named > 3) height += 11 * named;  // its lines would eat the plot
  const base = {
    width, height, paper_bgcolor: "#fff", plot_bgcolor: "#fff", dragmode: "zoom",
    font: { family: getComputedStyle(document.body).fontFamily, size: narrow ? 11 : 13, color: "#1a1d20" },
    margin: { l: 10, r: narrow ? 10 : 20, t: 12, b: 10, pad: 2 },
    hoverlabel: { bgcolor: "#fff", bordercolor: "#d5d9dd", font: { color: "#1a1d20", size: 12 }, namelength: -1 },
    legend: { orientation: "h", x: 0, xanchor: "left", y: 1.02, yanchor: "bottom", font: { size: narrow ? 11 : 12 },
              itemwidth: narrow ? 30 : 40, tracegroupgap: 0 },
  };
  const out = merged(base, layout);
  for (const key of Object.keys(layout).concat("xaxis", "yaxis"))
    if (/^[xy]axis\d*$/.test(key)) out[key] = merged(AXIS, layout[key] || {});
  return out;
}

class Drawn {
  constructor(element, spec) {
    this.element = element;
    this.canvas = element.querySelector(".canvas");
    this.spec = spec;
    this.width = 0;
  }
  room(paper) {
    const least = Number(this.element.dataset.least) || 0;
    return paper ? PAPER : Math.max(this.canvas.parentElement.clientWidth, least);
  }
  draw(paper = false) {
    this.width = this.room(paper);
    this.canvas.style.width = this.width + "px";
    const view = this.spec(this.width);
    const layout = laidOut(view, this.width, view.height || Number(this.element.dataset.height));
    if (paper && !view.height) layout.height = Math.round(0.8 * layout.height);  // two on a page
    if (this.width < NARROW)  // groups of one are packed as closely as their names allow
      for (const trace of view.data) if (trace.name) trace.legendgroup ??= trace.name;
    for (const trace of view.data)  // numbers of a map must fit their cells
      if (trace.type === "heatmap") trace.textfont = { size: Math.min(12, (this.width - 210) / trace.x.length / 3.6) };
    this.canvas.style.height = layout.height + "px";
    this.element.dataset.drawn = "yes";
    return Plotly.react(this.canvas, view.data, layout, { ...CONFIG, responsive: false });
  }
  fit() { if (this.width && Math.abs(this.room(false) - this.width) > 1) this.draw(); }
}

const drawn = [];

// Draws `figure` once it comes near the screen.
const sight = new IntersectionObserver(entries => {
  for (const entry of entries)
    if (entry.isIntersecting) {
      sight.unobserve(entry.target);
      drawn.find(d => d.element === entry.target).draw();
    }
}, { rootMargin: "500px 0px" });

function show(element, spec) {
  const one = new Drawn(element, spec);
  drawn.push(one);
  sight.observe(element);
  return one;
}

for (const element of document.querySelectorAll("figure.plot")) {
  const data = element.querySelector("script[type='application/json']");
  let parsed = null;
  const menu = element.querySelector("select");
  const one = show(element, () => (parsed ||= JSON.parse(data.textContent)).views[menu ? menu.selectedIndex : 0]);
  if (menu) menu.addEventListener("change", () => one.draw());
}

let waiting = 0;
addEventListener("resize", () => { clearTimeout(waiting); waiting = setTimeout(() => drawn.forEach(d => d.fit()), 150); });
addEventListener("beforeprint", () => {
  document.querySelectorAll("details:not(.record details)").forEach(d => { d.dataset.was = d.open; d.open = true; });
  drawn.forEach(d => d.draw(true));
});
addEventListener("afterprint", () => {
  document.querySelectorAll("details[data-was]").forEach(d => { d.open = d.dataset.was === "true"; });
  drawn.forEach(d => d.draw());
});
for (const details of document.querySelectorAll("details"))
  details.addEventListener("toggle", () => drawn.forEach(d => details.contains(d.element) && d.width && d.fit()));
