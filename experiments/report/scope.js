// The oscilloscope: signals of the chosen controllers over each other, one time axis for all panels.
(function () {
  const element = document.getElementById("oscilloscope");
  if (!element) return;
  const signed = ["true", "reported", "contour", "command", "speed"];
  let chooser = null, traces = {}, range = null, one = null, turn = 0;

  async function update(fresh) {
    const mine = ++turn, { run, scenario } = chooser;
    if (fresh) {
      traces = {};
      range = run.window;
    }
    const here = traces;
    for (const name of chooser.names()) here[name] ||= await unpack(run.controllers[name]);
    if (run.shared) here.shared ||= await unpack(run.shared);
    if (mine !== turn) return;
    one ||= show(element, spec);
    if (one.width) await one.draw();
    element.dataset.shown = [scenario.name, run.seed, ...chooser.names()].join(" ");
  }

  // Limits that a few extreme values, what is not scored and what follows an alarm do not stretch.
  function limits(values, alarm, good) {
    const { run } = chooser;
    for (let i = 0; i < values.length; i++) {
      const t = run.start + i * run.step;
      if (!Number.isFinite(values[i]) || (alarm !== null && t >= alarm)) continue;
      if (range && (t < range[0] || t > range[1])) continue;
      if (!run.idle.some(([a, b]) => t >= a && t < b)) good.push(values[i]);
    }
  }
  function robust(good) {
    if (!good.length) return undefined;
    good.sort((a, b) => a - b);
    const at = q => good[Math.min(good.length - 1, Math.floor(q * good.length))];
    let low = at(0.003), high = at(0.997);
    if (good[good.length - 1] - good[0] < 1.7 * (high - low)) [low, high] = [good[0], good[good.length - 1]];
    const room = 0.08 * Math.max(high - low, 1e-3);
    return [low - room, high + room];
  }

  function spec(width) {
    const { run, looks, labels, signals, scenario } = chooser;
    const names = chooser.names().filter(name => traces[name]);
    const has = key => key === "sheet" ? run.shared : names.some(n => run.controllers[n].signals.includes(key));
    const keys = Object.keys(signals).filter(has);
    const narrow = width < 600, total = keys.reduce((sum, key) => sum + signals[key].weight, 0), gap = narrow ? 0.035 : 0.018;
    const data = [], layout = {
      hovermode: "x", showlegend: false, uirevision: [scenario.name, run.seed, range].join(),
      margin: { t: narrow ? 20 : 8, b: 44, l: narrow ? 42 : 68 }, annotations: [],
      shapes: run.idle.map(([x0, x1]) => ({ type: "rect", xref: "x", yref: "paper", x0, x1, y0: 0, y1: 1, fillcolor: "#eceef0",
                                            line: { width: 0 }, layer: "below" })),
      xaxis: { title: { text: "time (s)" }, range: range || undefined, automargin: false, showspikes: true, spikemode: "across",
               spikethickness: 1, spikecolor: "#9aa1a8", spikedash: "solid" },
    };
    let top = 1;
    keys.forEach((key, i) => {
      const panel = signals[key], n = i ? i + 1 : "", y = "y" + n, good = [];
      const bottom = i === keys.length - 1 ? 0 : top - (panel.weight / total) * (1 - gap * (keys.length - 1));
      for (const name of key === "sheet" ? ["shared"] : names) {
        const part = name === "shared" ? run.shared : run.controllers[name], channel = part.signals.indexOf(key);
        if (channel < 0) continue;
        const values = traces[name][channel], [colour, dash] = name === "shared" ? ["#1a1d20", "solid"] : looks[name];
        data.push({
          type: "scatter", mode: "lines", x0: run.start, dx: run.step, y: values, yaxis: y, line: { color: colour, dash, width: 1.4 },
          name: labels[name] || key, hovertemplate: `%{y:.4~g} ${panel.unit} ${labels[name] || ""}<extra></extra>`,
        });
        limits(values, part.alarm ?? null, good);
        if (key === "true" && part.alarm != null) data.push({
          type: "scatter", mode: "markers", x: [part.alarm], y: [0], yaxis: y, hovertemplate: `alarm: ${labels[name]}<extra></extra>`,
          marker: { symbol: "x", size: 10, color: colour, line: { color: "#1a1d20", width: 1 } },
        });
      }
      layout["yaxis" + n] = {
        domain: [bottom, top], anchor: "x",
        title: narrow ? undefined : { text: `${panel.title}<br>(${panel.unit})`, font: { size: 11 }, standoff: 4 },
        automargin: false, range: robust(good), nticks: panel.weight < 1 ? 3 : 5, zeroline: signed.includes(key), zerolinecolor: "#9aa1a8",
      };
      if (narrow) layout.annotations.push({
        text: `${panel.title} (${panel.unit})`, x: 0, y: top, xref: "paper", yref: "paper", xanchor: "left", yanchor: "bottom", showarrow: false,
        font: { size: 11 },
      });
      if (i === keys.length - 1) layout.xaxis.anchor = y;
      top = bottom - gap;
    });
    return { data, layout, height: Math.round(60 + (narrow ? 115 : 105) * total) };
  }

  chooser = new Chooser(element, update);
  element.querySelector("button").addEventListener("click", () => { range = null; one.draw(); });
  update(true);
})();
