"use strict";
// Draws the page's figures with Plotly: each panel is a plot of its own, placed by the page's style.
const Charts = (() => {
  const PER_INCH = 104, SCALE = 1.33; // pixels per inch on paper, and per point
  const DASHES = { "-": "solid", "--": "dash", "-.": "dashdot", ":": "dot" };
  const SYMBOLS = {
    dot: "circle", ring: "circle-open", x: "x-thin", "+": "cross-thin", "|": "line-ns", diamond: "diamond-open", square: "square",
  };
  const GLYPHS = { dot: "●", ring: "○", x: "×", "+": "+", "|": "|", diamond: "◇", square: "■" };
  const INK = "#1b1c1f", GRID = "#d3d4d8", PAPER = "#f5f5f7", FONT = 'system-ui, -apple-system, "Segoe UI", Roboto, "DejaVu Sans", sans-serif';

  const plain = (words) => words.replaceAll("&", "&amp;").replaceAll("<", "&lt;"); // Plotly interprets HTML tags in texts
  const numbers = (packed) => {
    if (!packed) return [];
    const bytes = Uint8Array.from(atob(packed.f4), (char) => char.charCodeAt(0));
    return Array.from(new Float32Array(bytes.buffer), (value) => (Number.isFinite(value) ? value : null));
  };
  const faded = (colour, opacity) => {
    const part = (k) => parseInt(colour.slice(k, k + 2), 16);
    return `rgba(${part(1)}, ${part(3)}, ${part(5)}, ${opacity})`;
  };
  const shades = (scale) => ({ colorscale: "Cividis", cmin: scale.low, cmax: scale.high });

  const hoverText = (panel, label, names) => {
    const where = panel.rows ? "%{x:.4~g}" : panel.linked ? "%{y:.4~g}" : "%{x:.4~g}, %{y:.4~g}";
    return `${names ? "%{text}: " : ""}${where} ${plain(label ?? "").replaceAll("%{", "% {")}<extra></extra>`;
  };

  const outline = (x, low, high) => { // each known interval of a band as a closed path
    const xs = [], ys = [];
    for (let start = 0, end; start < x.length; start = end + 1) {
      for (end = start; end < x.length && low[end] !== null && high[end] !== null;) end += 1;
      if (end === start) continue;
      xs.push(...x.slice(start, end), ...x.slice(start, end).reverse(), x[start], null);
      ys.push(...low.slice(start, end), ...high.slice(start, end).reverse(), low[start], null);
    }
    return { x: xs, y: ys };
  };

  // Plotly traces and shapes for each kind of item.
  const drawn = {
    Line: (item, panel) => ({
      mode: "lines", x: numbers(item.x), y: numbers(item.y), opacity: item.opacity ?? 1, name: plain(item.label ?? ""),
      line: { color: item.colour, width: SCALE * (item.width ?? 1.1), dash: DASHES[item.dash ?? "-"] },
      hovertemplate: hoverText(panel, item.label),
    }),
    Band: (item) => ({
      ...outline(numbers(item.x), numbers(item.low), numbers(item.high)),
      mode: "none", fill: "toself", fillcolor: faded(item.colour, item.opacity ?? 0.25), hoverinfo: "skip",
    }),
    Points: (item, panel) => {
      const symbol = item.symbol ?? "dot", size = SCALE * (item.size ?? 4);
      const stroke = { color: item.colour, width: symbol === "dot" || symbol === "square" ? 0 : 1.6 };
      const half = item.half && { array: numbers(item.half), color: item.colour, thickness: 1.2, width: 3 };
      return {
        mode: "markers", x: numbers(item.x), y: numbers(item.y), name: plain(item.label ?? ""), cliponaxis: false,
        marker: { color: item.colour, symbol: SYMBOLS[symbol], size, line: stroke }, error_x: half ?? { visible: false },
        text: (item.names ?? []).map(plain), hovertemplate: hoverText(panel, item.label, item.names),
      };
    },
    Heat: (item, panel, scale) => ({
      mode: "markers", x: numbers(item.x), y: numbers(item.y), hovertemplate: "%{marker.color:.3~g}<extra></extra>",
      marker: { // an edge keeps the darkest shade visible on a dark page
        color: numbers(item.value), symbol: "square", size: SCALE * (item.size ?? 4.5), line: { color: INK, width: 0.7 }, ...shades(scale),
      },
    }),
    Bars: (item) => {
      const low = numbers(item.low), high = numbers(item.high);
      return {
        type: "bar", orientation: "h", y: numbers(item.row), base: low, x: high.map((end, k) => end - low[k]),
        width: item.thick ?? 0.7, marker: { color: item.colours, opacity: numbers(item.opacity) },
        text: (item.names ?? []).map(plain), textposition: "none", hoverinfo: item.names ? "text" : "skip",
      };
    },
    Text: (item) => ({
      mode: "text", x: [item.x], y: [item.y], text: [`\u2003${plain(item.words)}`], textposition: "middle right", hoverinfo: "skip",
    }),
  };
  const shaped = {
    Spans: (item) => {
      const end = numbers(item.end);
      return numbers(item.start).map((start, k) => ({
        type: "rect", x0: start, x1: end[k], y0: 0, y1: 1, yref: "paper", layer: "below",
        fillcolor: item.colour, opacity: item.opacity ?? 0.5, line: { width: 0 },
      }));
    },
    Rule: (item) => {
      const across = item.axis === "x" ? { x0: item.at, x1: item.at, y0: 0, y1: 1, yref: "paper" }
        : { y0: item.at, y1: item.at, x0: 0, x1: 1, xref: "paper" };
      return [{ type: "line", ...across, line: { color: item.colour, width: SCALE * (item.width ?? 0.5), dash: DASHES[item.dash ?? "-"] } }];
    },
  };

  const axis = (title, range) => ({
    title: { text: plain(title ?? ""), standoff: 6, font: { size: 12 } }, gridcolor: GRID, zeroline: false, showline: true,
    linecolor: INK, hoverformat: ".4~g", spikecolor: "#6b6e75", spikethickness: 1, ticks: "outside", ticklen: 3, tickcolor: INK, nticks: 7, ...(range ? { range } : {}),
  });
  const layout = (panel, wide, names) => { // names: width of the row names in pixels, 0 to omit them
    const x = axis(panel.x, panel.x_range), y = axis(panel.y, panel.y_range);
    Object.assign(x, { nticks: Math.max(3, Math.min(8, Math.round(wide / 60))), tickangle: 0 });
    if (panel.x_ticks) Object.assign(x, { tickvals: panel.x_ticks.map(([at]) => at), ticktext: panel.x_ticks.map(([, words]) => plain(words)) });
    if (panel.linked && !panel.x) x.showticklabels = false;
    if (panel.rows) {
      const own = panel.rows.map((name) => (names ? plain(name) : ""));
      Object.assign(y, {
        tickvals: own.map((_, k) => k), ticktext: own, range: [own.length - 0.4, -0.6], showgrid: false, ticks: "",
        ...(own.length > 20 ? { tickfont: { size: 10 } } : {}),
      });
    }
    if (panel.equal) Object.assign(y, { scaleanchor: "x", scaleratio: 1 });
    return {
      xaxis: x, yaxis: y, showlegend: false, barmode: "overlay", hovermode: panel.linked ? "x unified" : "closest", hoverdistance: 30,
      hoverlabel: { bgcolor: PAPER, bordercolor: GRID, font: { color: INK, family: FONT, size: 11 } },
      margin: { l: panel.rows ? names || 18 : 62, r: 14, t: 6, b: panel.x ? 40 : x.showticklabels === false ? 8 : 24 },
      shapes: panel.items.flatMap((item) => shaped[item.is]?.(item) ?? []),
      paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", font: { color: INK, family: FONT, size: 11 },
      modebar: { bgcolor: "rgba(0,0,0,0)", color: "#6b6e75", activecolor: "#0072b2" },
      dragmode: matchMedia("(pointer: coarse)").matches ? false : "zoom", // on touch screens, dragging scrolls the page
    };
  };
  const CONFIG = {
    displaylogo: false, responsive: true, showTips: false, displayModeBar: true, // shown by the page's style sheet
    doubleClickDelay: 500, // ms, as most systems have it; Plotly's own 300 are too few on a busy computer
    modeBarButtons: [["zoom2d", "pan2d", "resetScale2d", "toImage"]],
  };

  const element = (tag, name, words = "") => {
    const made = document.createElement(tag);
    made.className = name;
    made.textContent = words;
    return made;
  };
  const legend = (figure, plots) => { // one entry per name; a click hides or shows its curves
    const list = element("ul", "legend"), items = figure.lines.flat().flatMap((panel) => panel.items).filter((item) => item.label);
    for (const item of new Map(items.toReversed().map((one) => [one.label, one])).values()) {
      const entry = element("li", ""), key = element("button", ""), mark = element("span", "mark", item.is === "Line" ? "" : GLYPHS[item.is === "Key" ? "square" : item.symbol ?? "dot"]);
      key.type = "button";
      key.setAttribute("aria-pressed", "true");
      mark.style.setProperty("--key", item.colour);
      if (item.is === "Line") mark.style.borderTop = `3px ${{ "-": "solid", ":": "dotted" }[item.dash ?? "-"] ?? "dashed"} var(--key)`;
      mark.dataset.colour = item.colour;
      key.append(mark, item.label);
      if (item.is === "Key") key.disabled = true;
      key.addEventListener("click", () => {
        const shown = key.getAttribute("aria-pressed") !== "true";
        key.setAttribute("aria-pressed", String(shown));
        for (const plot of plots) {
          const own = plot.data.flatMap((trace, k) => (trace.name === plain(item.label) ? [k] : []));
          if (own.length) Plotly.restyle(plot, { visible: shown }, own);
        }
      });
      entry.append(key);
      list.prepend(entry);
    }
    return list;
  };
  const bar = (scale) => {
    const made = element("div", "scale");
    made.append(element("span", "", `${scale.low.toPrecision(2)}`), element("i", ""), element("span", "", `${scale.high.toPrecision(2)} ${scale.label}`));
    return made;
  };
  const linked = (plots) => { // zooming one time axis zooms all
    let busy = false;
    for (const plot of plots) {
      plot.on("plotly_relayout", async (change) => {
        if (busy || !Object.keys(change).some((key) => key.startsWith("xaxis."))) return;
        busy = true;
        const { range } = plot.layout.xaxis;
        const first = change["xaxis.autorange"] ? { "xaxis.autorange": true } : { "xaxis.range": [...range] };
        await Promise.all(plots.filter((other) => other !== plot).map((other) => Plotly.relayout(other, first)));
        busy = false;
      });
    }
  };

  const view = (turn, tilt) => { // unit vectors across and up a view, from its angles in degrees
    const a = (turn * Math.PI) / 180, e = (tilt * Math.PI) / 180;
    return [[Math.cos(a), 0, -Math.sin(a)], [-Math.sin(a) * Math.sin(e), Math.cos(e), -Math.cos(a) * Math.sin(e)]];
  };
  const turnable = async (plot, panel) => { // dragging or the arrow keys turn a panel of three coordinates
    const points = panel.items.map((item) => [item.x, item.y, item.z].map(numbers));
    let [turn, tilt] = panel.view;
    const show = () => {
      const seen = view(turn, tilt);
      const along = ([u, v, w]) => points.map(([x, y, z]) => x.map((one, k) => (one === null ? null : u * one + v * y[k] + w * z[k])));
      return Plotly.restyle(plot, { x: along(seen[0]), y: along(seen[1]) });
    };
    const by = (across, up) => {
      turn += across;
      tilt = Math.max(-90, Math.min(90, tilt + up));
      show();
    };
    await Plotly.relayout(plot, { dragmode: false });
    plot.style.touchAction = "pan-y";
    plot.tabIndex = 0;
    plot.addEventListener("pointermove", (event) => { if (event.buttons & 1) by(-event.movementX / 2, event.movementY / 2); });
    plot.addEventListener("keydown", (event) => {
      const step = { ArrowLeft: [5, 0], ArrowRight: [-5, 0], ArrowUp: [0, 5], ArrowDown: [0, -5] }[event.key];
      if (!step) return;
      event.preventDefault();
      by(...step);
    });
    await show();
  };

  // Draw a figure into an element and return the plots of its panels in order.
  const draw = async (into, figure) => {
    const cells = figure.lines.map((line) => {
      const row = element("div", "line");
      row.style.setProperty("--panels", line.length);
      into.append(row);
      return line.map((panel) => {
        const cell = element("div", "panel"), plot = element("div", "plot");
        if (panel.title) cell.append(element("div", "title", panel.title));
        plot.style.height = `${Math.round(PER_INCH * (panel.height ?? 2.1))}px`;
        cell.append(plot);
        row.append(cell);
        return { panel, cell, plot };
      });
    });
    const panels = figure.lines.flat(), pen = document.createElement("canvas").getContext("2d");
    pen.font = `11px ${FONT}`;
    const longest = Math.max(0, ...panels.flatMap((panel) => panel.rows ?? []).map((name) => pen.measureText(name).width));
    const names = panels.some((panel) => panel.linked) ? 62 : 14 + longest; // align the time axes
    const plots = [];
    for (const { panel, cell, plot } of cells.flat()) {
      const named = cell.offsetLeft === cell.parentElement.firstElementChild.offsetLeft;
      const traces = panel.items.flatMap((item) => {
        const made = drawn[item.is]?.(item, panel, figure.scale);
        return made ? [{ type: "scatter", ...made, ...(panel.view && item.is === "Line" ? { hoverinfo: "skip", hovertemplate: "" } : {}) }] : [];
      });
      plots.push(await Plotly.newPlot(plot, traces, layout(panel, cell.clientWidth, named ? names : 0), CONFIG));
      if (panel.view) await turnable(plot, panel);
    }
    linked(plots.filter((_, k) => cells.flat()[k].panel.linked));
    into.prepend(legend(figure, plots), ...(figure.scale ? [bar(figure.scale)] : []));
    return plots;
  };
  return { draw, view };
})();

(async () => {
  const drawings = JSON.parse(document.getElementById("figure-data").textContent);
  for (const one of drawings.all) {
    const into = document.querySelector(`[data-figure="${one.name}"]`);
    if (!into) continue;
    into.replaceChildren();
    await Charts.draw(into, one.figure);
    into.dataset.ready = "yes";
  }
})();
