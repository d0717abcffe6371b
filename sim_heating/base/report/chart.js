"use strict";
// Draws the charts of a page with uPlot: panels over one time axis, zoomed together, with keys that show the values at
// the cursor and hide curves. Data: the JSON element of each figure (chart.py). Texts are only ever set as text.
// A page whose data grow draws by `simHeatingCharts`: `draw`, `refresh` and `remove`, with data that are read already.
(() => {
  const SOFT = "#5b6876", GRID = "#e3e7eb", FONT = "12px system-ui, 'Segoe UI', Roboto, Arial, sans-serif";
  const charts = [];
  let linked = true;

  const button = (parent, text, label, act) => {
    const made = element("button", parent, { type: "button", text, "aria-label": label, title: label });
    made.addEventListener("click", act);
    return made;
  };

  // Data ------------------------------------------------------------------------------------------------------------

  const summed = ({ step, y }) => {
    let now = 0;
    const scale = 1 / step;  // 12345 * 0.01 is not 123.45, 12345 / 100 is
    const whole = Math.abs(scale - Math.round(scale)) < 1e-9 * scale;
    return y.map((d) => (d === null ? null : ((now += d), whole ? now / Math.round(scale) : now * step)));
  };
  const places = (deltas) => {
    let now = 0;
    return deltas.map((d) => (now += d));
  };
  const decoded = (times, c) => {
    const all = times[c.t];
    return { t: c.i ? places(c.i).map((i) => all[i]) : all, y: summed(c) };
  };
  const read = (data) => {
    const times = data.times.map(summed);
    for (const panel of data.panels) {
      for (const c of panel.curves) {
        Object.assign(c, { digits: Math.max(0, Math.min(6, -Math.round(Math.log10(c.step)))) });
        c.bands = (c.band || []).map((b) => decoded(times, b));
        Object.assign(c, decoded(times, c));
      }
    }
    const known = times.flat().filter((t) => t !== null);
    data.whole = known.length ? [known.reduce((a, b) => Math.min(a, b)), known.reduce((a, b) => Math.max(a, b))] : [0, 1];
    if (data.whole[0] === data.whole[1]) data.whole = [data.whole[0] - 0.5, data.whole[1] + 0.5];
    data.view = data.view || data.whole;
    data.whole = [Math.min(data.whole[0], data.view[0]), Math.max(data.whole[1], data.view[1])];
    return data;
  };

  // Index of the sample nearest to a time; -1 where there is none within the curve.
  const nearest = (c, time) => {
    if (!c.t.length) return -1;
    let low = 0, high = c.t.length - 1;
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (c.t[middle] <= time) low = middle; else high = middle;
    }
    const i = time - c.t[low] <= c.t[high] - time ? low : high;
    const span = c.t[c.t.length - 1] - c.t[0];
    return c.y[i] === null || time < c.t[0] - 0.01 * span || time > c.t[c.t.length - 1] + 0.01 * span ? -1 : i;
  };

  // View ------------------------------------------------------------------------------------------------------------

  const alike = (chart) => charts.filter((other) => other.data.time === chart.data.time);
  const affected = (chart) => (linked ? alike(chart) : [chart]);
  const show = (chart, from, to) => {
    const [first, last] = chart.data.whole;
    const width = Math.min(Math.max(to - from, (last - first) * 1e-4), last - first);
    const start = Math.min(Math.max(from, first), last - width);
    chart.range = [start, start + width];
    for (const plot of chart.plots) plot.setScale("x", { min: start, max: start + width });
    const home = Math.abs(start - chart.data.view[0]) + Math.abs(start + width - chart.data.view[1]) < 1e-6 * (last - first);
    chart.home = home;
    chart.reset.disabled = home;
  };
  const zoomTo = (chart, from, to) => {
    for (const other of affected(chart)) {
      const overlap = Math.min(to, other.data.whole[1]) - Math.max(from, other.data.whole[0]);
      if (other === chart || overlap > 0) show(other, from, to);
    }
  };
  const zoomed = (chart, from, to) => {  // by a drag in one panel; what `show` itself has set comes here later, too
    if (Math.abs(from - chart.range[0]) + Math.abs(to - chart.range[1]) > 1e-6 * (to - from)) zoomTo(chart, from, to);
  };
  const reset = (chart) => {
    for (const other of affected(chart)) show(other, ...other.data.view);
  };
  const zoomBy = (chart, factor, about) => {
    const [from, to] = chart.range;
    const middle = about === undefined ? 0.5 * (from + to) : about;
    zoomTo(chart, middle - (middle - from) * factor, middle + (to - middle) * factor);
  };
  const pan = (chart, share) => {
    const [from, to] = chart.range;
    const [first, last] = chart.data.whole;
    const by = Math.min(Math.max(share * (to - from), first - from), last - to);
    zoomTo(chart, from + by, to + by);
  };

  // Cursor ----------------------------------------------------------------------------------------------------------

  // Index of the last value of a curve; -1 where it has none.
  const latest = (c) => {
    let i = c.y.length - 1;
    while (i >= 0 && c.y[i] === null) i--;
    return i;
  };
  const readout = (chart, time) => {
    chart.cursor = time;
    chart.clock.textContent = time === null ? "" : `${chart.data.time.split(",")[0]} ${time.toFixed(2)}${unitOf(chart.data.time)}`;
    for (const key of chart.keys) {
      const i = time !== null ? nearest(key.curve, time) : chart.data.growing && !key.curve.aside ? latest(key.curve) : -1;
      key.value.textContent = i < 0 ? "" : `${key.curve.y[i].toFixed(key.curve.digits)}`;
    }
  };
  const unitOf = (label) => (label.includes(", ") ? ` ${label.split(", ").slice(1).join(", ")}` : "");
  const point = (chart, time) => {
    for (const plot of chart.plots) plot.setCursor({ left: plot.valToPos(time, "x"), top: 10 }, true, false);
    readout(chart, time);
  };
  const pointAll = (chart, time) => {
    for (const other of affected(chart)) if (time >= other.range[0] && time <= other.range[1]) point(other, time);
  };

  // Drawing ---------------------------------------------------------------------------------------------------------

  const shade = (data) => (u) => {
    const { ctx, bbox } = u;
    ctx.save();
    ctx.beginPath();
    ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
    ctx.clip();
    for (const [from, to, , color] of data.spans) {
      const left = u.valToPos(from, "x", true), right = u.valToPos(to, "x", true);
      ctx.fillStyle = color;
      ctx.fillRect(left, bbox.top, right - left, bbox.height);
    }
    ctx.restore();
  };
  const bars = (u, c) => {  // of dots, from one bound to the other
    const { ctx } = u, [low, high] = c.bands;
    ctx.strokeStyle = `${c.color}88`;
    ctx.lineWidth = uPlot.pxRatio;
    ctx.beginPath();
    c.t.forEach((t, i) => {
      if (low.y[i] === null || high.y[i] === null) return;
      const x = u.valToPos(t, "x", true);
      ctx.moveTo(x, u.valToPos(low.y[i], "y", true));
      ctx.lineTo(x, u.valToPos(high.y[i], "y", true));
    });
    ctx.stroke();
  };
  const marks = (panel) => (u) => {
    const { ctx, bbox } = u, ratio = uPlot.pxRatio;
    const { min, max } = u.scales.y, [from, to] = [u.scales.x.min, u.scales.x.max];
    ctx.save();
    ctx.beginPath();  // marks at the upper and lower edge stand inside
    ctx.rect(bbox.left - 6 * ratio, bbox.top, bbox.width + 12 * ratio, bbox.height);
    ctx.clip();
    if (panel.zero && min < 0 && max > 0) {
      const y = Math.round(u.valToPos(0, "y", true)) + 0.5;
      ctx.strokeStyle = "#4d4d4d";
      ctx.lineWidth = ratio;
      ctx.beginPath();
      ctx.moveTo(bbox.left, y);
      ctx.lineTo(bbox.left + bbox.width, y);
      ctx.stroke();
    }
    for (const c of panel.curves) {
      if (c.hidden) continue;
      if (c.bars) bars(u, c);
      ctx.fillStyle = c.color;
      c.y.forEach((y, i) => {
        if (y === null || (y <= max && y >= min) || c.t[i] < from || c.t[i] > to) return;
        const x = u.valToPos(c.t[i], "x", true), up = y > max, s = 4 * ratio;
        const at = up ? bbox.top : bbox.top + bbox.height;
        ctx.beginPath();
        ctx.moveTo(x, at);
        ctx.lineTo(x - s, at + (up ? 1.6 : -1.6) * s);
        ctx.lineTo(x + s, at + (up ? 1.6 : -1.6) * s);
        ctx.fill();
      });
    }
    ctx.restore();
  };
  const range = (chart, panel) => (u, least, greatest) => {
    if (panel.limits && chart.home) return panel.limits;
    if (least === null || least === undefined) return panel.limits || [0, 1];
    const margin = 0.06 * (greatest - least) || 0.05 * Math.abs(greatest) || 1;
    return [least - margin, greatest + margin];
  };
  const axes = (panel, last, time) => [
    {
      stroke: SOFT, font: FONT, grid: { stroke: GRID, width: 1 }, ticks: { stroke: GRID, size: last ? 6 : 0 },
      size: last ? 44 : 8, label: last ? time : undefined, labelSize: last ? 18 : 0, labelFont: FONT, labelGap: 0, gap: last ? 4 : 0,
      values: (u, all) => all.map((v) => (last ? String(Number(v.toPrecision(10))) : "")),
    },
    {
      stroke: SOFT, font: FONT, grid: { stroke: GRID, width: 1 }, ticks: { stroke: GRID, size: 6 }, size: 60,
      space: (u) => Math.max(16, Math.min(30, u.bbox.height / uPlot.pxRatio / 4)),  // low panels have three numbers, too
      values: (u, all) => all.map((v) => String(Number(v.toPrecision(6)))),
    },
  ];
  const tables = (panel) => panel.curves.flatMap((c) => [
    [c.t, c.y], ...c.bands.map((b) => [b.t, b.y]),
  ]);
  const joined = (panel) => {
    const all = tables(panel);
    return uPlot.join(all, all.map(() => [1, 1]));
  };
  const series = (panel) => {
    const found = [{}], bands = [];
    for (const c of panel.curves) {
      found.push({
        label: c.label, stroke: c.color, width: 1.6, dash: c.dash, spanGaps: false, auto: !c.aside,
        points: c.points ? { show: true, size: c.size || 3, width: 0, fill: c.color, stroke: c.color } : { show: false },
        ...(c.points ? { paths: () => null } : {}),
      });
      if (c.bands.length) {
        if (!c.bars) bands.push({ series: [found.length + 1, found.length], fill: `${c.color}33` });
        for (const _ of c.bands) found.push({ label: "", stroke: "transparent", width: 0, points: { show: false } });
      }
    }
    return { found, bands };
  };
  const height = (panel) => Math.round(Math.max(110, 230 * panel.height));

  const drawPanel = (chart, panel, k, place) => {
    const last = k === chart.data.panels.length - 1;
    const bar = element("div", place, { class: "bar", role: "group", "aria-label": `${panel.label}: curves` });
    element("span", bar, { text: panel.label });
    const { found, bands } = series(panel);
    const only = ["mousemove", "mouseleave"];
    const refine = (u, number, index, time) => {
      // curves have samples of their own: the nearest one that this curve has
      const own = u.data[number];
      for (let d = 0; d < 200; d++) {
        if (own[index - d] !== null && own[index - d] !== undefined) return index - d;
        if (own[index + d] !== null && own[index + d] !== undefined) return index + d;
      }
      return index;
    };
    const box = element("div", place);
    const plot = new uPlot({
      width: Math.max(240, box.clientWidth), height: height(panel) + (last ? 44 : 8), legend: { show: false }, series: found, bands,
      scales: { x: { time: false }, y: { range: range(chart, panel) } }, axes: axes(panel, last, chart.data.time),
      padding: [8, 18, 0, 0],
      cursor: {
        drag: { x: true, y: false, dist: 6 }, dataIdx: refine,
        points: { size: 6 },
        bind: { dblclick: () => () => { reset(chart); return null; } },
        sync: { key: chart.data.time, scales: ["x", null], filters: {
          pub: (type) => only.includes(type),
          sub: (type, source) => only.includes(type) && (linked || chart.plots.includes(source)),
        } },
      },
      hooks: {
        drawClear: [shade(chart.data)],
        draw: [marks(panel)],
        setScale: [(u, name) => { if (name === "x" && chart.ready) zoomed(chart, u.scales.x.min, u.scales.x.max); }],
        setCursor: [(u) => {
          const { left } = u.cursor;
          readout(chart, left === undefined || left < 0 ? null : u.posToVal(left, "x"));
        }],
      },
    }, joined(panel), box);
    box.addEventListener("mouseleave", () => { for (const other of affected(chart)) readout(other, null); });
    touch(chart, plot);
    chart.plots.push(plot);
    panel.curves.forEach((c) => key(chart, panel, c, bar));
    if (panel.curves.length > 6) {
      button(bar, "all", `${panel.label}: show all curves`, () => setAll(chart, panel, false));
      button(bar, "none", `${panel.label}: hide all curves`, () => setAll(chart, panel, true));
    }
  };

  // Keys: one for each curve; a curve of the same name in other panels and charts goes with it.
  const key = (chart, panel, c, bar) => {
    const made = element("button", bar, { type: "button", class: `key${c.points ? " points" : ""}${c.dash ? " dashed" : ""}`, "aria-pressed": "true" });
    made.style.setProperty("--color", c.color);
    const alone = panel.curves.length === 1 && panel.label.startsWith(c.label);  // the panel's name says it
    element("span", made, { text: alone ? "" : c.label });
    if (alone) made.setAttribute("aria-label", c.label);
    const value = element("b", made);
    made.addEventListener("click", () => setHidden(chart, [named(c)], !c.hidden));
    chart.keys.push({ curve: c, button: made, value });
  };
  const named = (c) => c.label.split(", RMSE")[0];  // the error is that of one record
  const setHidden = (chart, labels, hidden) => {
    for (const other of charts) {
      other.data.panels.forEach((panel, k) => {
        let number = 0, changed = false;
        for (const c of panel.curves) {
          number += 1;
          const first = number;
          number += c.bands.length;
          if (!labels.includes(named(c)) || Boolean(c.hidden) === hidden) continue;
          c.hidden = hidden;
          changed = true;
          for (let i = first; i <= number; i++) other.plots[k].setSeries(i, { show: !hidden });
        }
        if (changed) other.plots[k].redraw();
      });
      for (const made of other.keys) made.button.setAttribute("aria-pressed", String(!made.curve.hidden));
    }
  };
  const setAll = (chart, panel, hidden) => setHidden(chart, panel.curves.map(named), hidden);

  // Fingers: one moves the cursor, two zoom.
  const touch = (chart, plot) => {
    const fingers = new Map();
    let start = null;
    const x = (e) => e.clientX - plot.over.getBoundingClientRect().left;
    plot.over.addEventListener("pointerdown", (e) => {
      if (e.pointerType !== "touch") return;
      fingers.set(e.pointerId, x(e));
      start = fingers.size === 2 ? { range: [...chart.range], at: [...fingers.values()].sort((a, b) => a - b) } : null;
      if (fingers.size === 1) pointAll(chart, plot.posToVal(x(e), "x"));
    });
    plot.over.addEventListener("pointermove", (e) => {
      if (!fingers.has(e.pointerId)) return;
      fingers.set(e.pointerId, x(e));
      if (fingers.size === 1) { pointAll(chart, plot.posToVal(x(e), "x")); return; }
      const now = [...fingers.values()].sort((a, b) => a - b);
      if (!start || now[1] - now[0] < 10) return;
      const width = plot.over.clientWidth, [from, to] = start.range;
      const was = start.at.map((p) => from + (p / width) * (to - from));
      const slope = (was[1] - was[0]) / (now[1] - now[0]);
      zoomTo(chart, was[0] - now[0] * slope, was[0] + (width - now[0]) * slope);
    });
    const lift = (e) => { fingers.delete(e.pointerId); start = null; };
    for (const kind of ["pointerup", "pointercancel", "pointerleave"]) plot.over.addEventListener(kind, lift);
  };

  const keyboard = (chart) => (e) => {
    if (e.target.closest("button") && (e.key === "Enter" || e.key === " ")) return;
    if (e.ctrlKey || e.metaKey || e.altKey) return;
    const [from, to] = chart.range, step = (to - from) / 100;
    const at = chart.cursor === null ? 0.5 * (from + to) : chart.cursor;
    const acts = {
      "+": () => zoomBy(chart, 0.5, at), "=": () => zoomBy(chart, 0.5, at), "-": () => zoomBy(chart, 2, at), "0": () => reset(chart),
      Escape: () => reset(chart),
      ArrowLeft: () => (e.shiftKey ? pan(chart, -0.25) : pointAll(chart, Math.max(from, at - step))),
      ArrowRight: () => (e.shiftKey ? pan(chart, 0.25) : pointAll(chart, Math.min(to, at + step))),
    };
    if (!acts[e.key]) return;
    e.preventDefault();
    acts[e.key]();
  };

  const draw = (figure, data) => {
    const place = figure.querySelector(".plot");
    figure.classList.add("drawn");  // before drawing, as a hidden element has no width
    const chart = { figure, data, plots: [], keys: [], range: data.view, home: true, cursor: null, ready: false };
    if (figure.parentElement.classList.contains("several")) element("h3", place, { text: data.title });
    const bar = element("div", place, { class: "bar", role: "group", "aria-label": `${data.title}: view` });
    button(bar, "\u2212", "Zoom out", () => zoomBy(chart, 2, chart.cursor === null ? undefined : chart.cursor));
    button(bar, "+", "Zoom in", () => zoomBy(chart, 0.5, chart.cursor === null ? undefined : chart.cursor));
    button(bar, "\u25c2", "Earlier", () => pan(chart, -0.25));
    button(bar, "\u25b8", "Later", () => pan(chart, 0.25));
    const back = data.reset || "Reset zoom";
    chart.reset = button(bar, back, back, () => reset(chart));
    chart.link = button(bar, "Together", "Zoom all charts of the page together", () => link(!linked));
    chart.clock = element("output", bar);
    place.setAttribute("tabindex", "0");
    place.setAttribute("role", "group");
    place.setAttribute("aria-label", `Chart ${data.title}: ${data.panels.map((p) => p.label).join("; ")} against ${data.time}. `
      + "Left and right arrows move the cursor, with Shift the view; plus and minus zoom, 0 resets the zoom.");
    place.addEventListener("keydown", keyboard(chart));
    charts.push(chart);
    data.panels.forEach((panel, k) => drawPanel(chart, panel, k, place));
    show(chart, ...data.view);
    chart.ready = true;
    chart.resized = new ResizeObserver(() => {
      const width = place.clientWidth;
      chart.plots.forEach((plot, k) => { if (width > 0 && plot.width !== width) plot.setSize({ width, height: plot.height }); });
    });
    chart.resized.observe(place);
    return chart;
  };
  const link = (on) => {
    linked = on;
    for (const chart of charts) {
      chart.link.setAttribute("aria-pressed", String(on));
      chart.link.textContent = on ? "Together" : "Apart";
      chart.link.hidden = alike(chart).length < 2;
    }
  };

  // New samples of a chart: `panels` as [[{t, y, bands}]], and where they change `view`, `whole` and `spans`. A reader
  // who has zoomed keeps the view. Without a cursor the keys of a chart that is `growing` show the latest values.
  const refresh = (chart, { panels, ...rest }) => {
    const { home } = chart;
    Object.assign(chart.data, rest);
    chart.data.panels.forEach((panel, k) => {
      panel.curves.forEach((c, i) => Object.assign(c, panels[k][i]));
      chart.plots[k].setData(joined(panel), false);
    });
    show(chart, ...(home ? chart.data.view : chart.range));
    if (chart.cursor !== null || chart.data.growing) readout(chart, chart.cursor);
  };
  const remove = (chart) => {
    chart.resized.disconnect();
    for (const plot of chart.plots) plot.destroy();
    const place = chart.figure.querySelector(".plot");
    place.replaceWith(place.cloneNode(false));  // without its listeners, which hold the chart
    charts.splice(charts.indexOf(chart), 1);
  };

  for (const figure of document.querySelectorAll("figure.chart:has(> script)")) {
    try {
      draw(figure, read(JSON.parse(figure.querySelector("script").textContent)));
    } catch (error) {  // the picture stays
      figure.classList.remove("drawn");
      console.error(error);
    }
  }
  const views = charts.map((c) => c.data.view);
  const common = views.length && Math.min(...views.map((v) => v[1])) - Math.max(...views.map((v) => v[0]));
  const widest = Math.max(...views.map((v) => v[1] - v[0]));
  link(common > 0.1 * widest);  // flights at other times are not moved together unless a reader asks for it
  document.documentElement.dataset.charts = String(charts.filter((c) => c.figure.classList.contains("drawn")).length);
  window.simHeatingCharts = { draw, refresh, remove, link };
})();
