// Kerf maps: the chosen controllers side by side, each kerf in as many strokes as the scale has shades.
(function () {
  const element = document.getElementById("kerfs");
  if (!element) return;
  const SHADES = 40, colouring = element.querySelector("select[name=quantity]");
  let chooser = null, found = {}, one = null, turn = 0;

  async function update(fresh) {
    const mine = ++turn, { run, scenario, quantities } = chooser;
    if (fresh) {
      found = {};
      const before = colouring.value;
      colouring.replaceChildren(...Object.keys(run.limits).map(q => new Option(quantities[q].title, q)));
      colouring.value = before in run.limits ? before : run.first in run.limits ? run.first : colouring.value;
    }
    const here = found;
    for (const name of chooser.names()) here[name] ||= await unpack(run.controllers[name]);
    if (mine !== turn) return;
    one ||= show(element, spec);
    if (one.width) await one.draw();
    element.dataset.shown = [scenario.name, run.seed, colouring.value, ...chooser.names()].join(" ");
  }

  const shade = (colours, u) => {
    const at = Math.min(Math.max(u, 0), 1) * (colours.length - 1), i = Math.min(Math.floor(at), colours.length - 2);
    return "rgb(" + colours[i].map((c, k) => Math.round(c + (at - i) * (colours[i + 1][k] - c))).join() + ")";
  };

  // Strokes of one panel: rapids, the edge of what is cut through and of what is not, and a stroke for every shade.
  function strokes(part, channels, quantity, colours, [low, high], axes, label) {
    const [x, y, cutting, through] = channels, values = channels[4 + part.quantities.indexOf(quantity)];
    const lines = Array.from({ length: SHADES + 3 }, () => ({ x: [], y: [], text: [] }));
    for (let i = 0; i + 1 < x.length; i++) {
      const to = cutting[i] < 0.5 ? [SHADES] : [Math.max(0, Math.min(SHADES - 1, Math.floor(SHADES * (values[i] - low) / (high - low))))];
      if (cutting[i] > 0.5) to.push(through[i] < 0.5 ? SHADES + 2 : SHADES + 1);
      for (const k of to) {
        lines[k].x.push(x[i], x[i + 1], null);
        lines[k].y.push(y[i], y[i + 1], null);
        lines[k].text.push(values[i], values[i], null);
      }
    }
    const style = k => [{ color: "#c3c8cd", width: 0.8 }, { color: "#8b9198", width: 7 }, { color: "#1a1d20", width: 9.5 }][k - SHADES] ||
      { color: shade(colours, (k + 0.5) / SHADES), width: 5.5 };
    const unit = chooser.quantities[quantity].unit;
    return [SHADES, SHADES + 1, SHADES + 2, ...Array(SHADES).keys()].filter(k => lines[k].x.length).map(k => ({
      type: "scatter", mode: "lines", x: lines[k].x, y: lines[k].y, customdata: lines[k].text, line: style(k), ...axes, showlegend: false,
      hoverinfo: k < SHADES ? undefined : "skip", name: label,
      hovertemplate: k < SHADES ? `%{customdata:.3~g} ${unit} at (%{x:.1f}, %{y:.1f}) mm<extra></extra>` : undefined,
    }));
  }

  function spec(width) {
    const { run, labels, quantities } = chooser, quantity = colouring.value;
    const { colours, unit, title } = quantities[quantity], limits = run.limits[quantity];
    const names = chooser.names().filter(name => found[name]);
    const across = Math.min(names.length || 1, width < 600 ? 1 : width < 1000 ? 2 : 4), down = Math.ceil(names.length / across);
    let x0 = Infinity, x1 = -Infinity, y0 = Infinity, y1 = -Infinity;
    for (const name of names) for (const [k, v] of found[name][0].entries()) {
      const w = found[name][1][k];
      x0 = Math.min(x0, v); x1 = Math.max(x1, v); y0 = Math.min(y0, w); y1 = Math.max(y1, w);
    }
    const rim = 0.04 * Math.max(x1 - x0, y1 - y0), each = (width - 20) / across - 24;
    const tall = Math.min(Math.max(each * (y1 - y0 + 2 * rim) / (x1 - x0 + 2 * rim), 120), 460), height = down * (tall + 40) + 96;
    const plot = height - 96, data = [], layout = { annotations: [], hovermode: "closest", margin: { t: 6, b: 90, l: 34, r: 10 }, showlegend: false };
    names.forEach((name, i) => {
      const n = i ? i + 1 : "", column = i % across, row = Math.floor(i / across);
      const left = column / across, top = 1 - row * (tall + 40) / plot - 24 / plot;
      layout["xaxis" + n] = { domain: [left, left + 1 / across - 0.03], anchor: "y" + n, range: [x0 - rim, x1 + rim], matches: i ? "x" : undefined,
                              nticks: 5, showgrid: false, automargin: false, constrain: "domain" };
      layout["yaxis" + n] = { domain: [Math.max(0, top - tall / plot), top], anchor: "x" + n, range: [y0 - rim, y1 + rim], scaleanchor: i ? undefined : "x",
                              matches: i ? "y" : undefined, nticks: 5, showgrid: false, automargin: false, constrain: "domain" };
      layout.annotations.push({ text: labels[name], x: left, y: top, xref: "paper", yref: "paper", xanchor: "left", yanchor: "bottom", showarrow: false,
                                font: { size: 13 } });
      data.push(...strokes(run.controllers[name], found[name], quantity, colours, limits, { xaxis: "x" + n, yaxis: "y" + n }, labels[name]));
    });
    data.push({
      type: "scatter", mode: "markers", x: [null], y: [null], showlegend: false, hoverinfo: "skip",
      marker: { color: [limits[0]], cmin: limits[0], cmax: limits[1], showscale: true,
                colorscale: colours.map((c, i) => [i / (colours.length - 1), `rgb(${c})`]),
                colorbar: { orientation: "h", thickness: 10, len: width < 600 ? 1 : 0.4, x: 0, xanchor: "left", y: 0, yanchor: "top", ypad: 34, outlinewidth: 0,
                            title: { text: `${title} (${unit})`, side: "top", font: { size: 12 } }, tickfont: { size: 11 } } },
    });
    return { data, layout, height };
  }

  chooser = new Chooser(element, update);
  colouring.addEventListener("change", () => update(false));
  update(true);
})();
