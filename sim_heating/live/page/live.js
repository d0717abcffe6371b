"use strict";
// The page of a live link. States come over a WebSocket; the past of the control point that is shown is fetched once.
// A link is seen as stalled by the page's own clock, too, as no state may come any more. Texts are only set as text.
(() => {
  const { draw, refresh, remove, link } = window.simHeatingCharts;
  const STALLED_MS = 1500, SILENT_MS = 6000, TICK_MS = 200, MOST_SAMPLES = 4800, CURVE_MS = 1000, BIN_DEG = 0.1;
  const WINDOWS = [["30 s", 30], ["2 min", 120], ["10 min", 600], ["all", Infinity]];
  const FUTURES = [["nominal", "#0072B2"], ["held", "#E69F00", [7, 4]], ["planned", "#CC79A7", [2, 3]]];
  const SURFACE = "#D55E00", BONDLINE = "#0072B2", LIMIT = "#000000", TABLE = "#4d4d4d", MANY = ["#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#7F7F7F"];
  const LEVELS = [[200, "#0072B2", "above 200 K"], [100, "#56B4E9", "100 to 200 K"], [50, "#E69F00", "50 to 100 K"], [0, "#D55E00", "0 to 50 K"], [-Infinity, "#000000", "limit passed"]];
  const UNKNOWN = ["#b8c2cc", "no limit"];
  const DANGER = 0.05;  // probability of passing a limit that is marked

  const $ = (id) => document.getElementById(id);
  const known = (v) => v !== null && v !== undefined;
  const number = (v, digits = 1) => (known(v) ? v.toFixed(digits) : "\u2013");
  const interval = (v, sigma, digits = 1) => (known(v) ? `${v.toFixed(digits)}${known(sigma) ? ` \u00b1 ${(2 * sigma).toFixed(digits)}` : ""}` : "\u2013");
  const percent = (p) => (!known(p) ? "\u2013" : p > 0 && p < 0.001 ? "< 0.1 %" : p < 1 && p > 0.999 ? "> 99.9 %" : `${(100 * p).toFixed(1)} %`);
  const write = (node, text) => { if (node.textContent !== text) node.textContent = text; };
  const mark = (node, name, value) => { if (node.dataset[name] !== value) node.dataset[name] = value; };
  const json = async (path) => (await fetch(path)).json();
  const address = (path, point) => `${path}?point=${encodeURIComponent(point)}`;

  let fixed = { title: "", points: {} };  // static.json
  let state = null, received = 0, connected = false, opened = false;
  let shown = null, past = null, curve = { alpha_deg: [], ratio: [] };
  let span = 120, charts = {}, dirty = false;

  // What comes in -----------------------------------------------------------------------------------------------------

  let socket = null, delay = 250, tried = 0;
  const connect = () => {
    const own = new WebSocket(`${location.protocol === "https:" ? "wss:" : "ws:"}//${location.host}/page`);
    socket = own;
    tried = performance.now();
    own.onopen = () => {
      connected = opened = true;
      delay = 250;
      if (shown !== null) own.send(shown);
    };
    own.onmessage = ({ data }) => { if (own === socket) take(JSON.parse(data)); };
    own.onclose = () => {
      if (own !== socket) return;
      connected = false;
      setTimeout(connect, delay);
      delay = Math.min(2 * delay, 4000);
    };
  };
  const take = (next) => {
    const before = state === null ? -1 : state.sequence;
    state = next;
    dirty = true;
    if (next.sequence !== before) received = performance.now();  // the same again is no news
    if (before < 0 || next.sequence < before) restart();
    else append();
  };
  const restart = async () => {
    try {
      fixed = await json("static.json");
      write($("title"), fixed.title);
      buildPoints();
      const wanted = [shown, decodeURIComponent(location.hash.slice(1)), ...Object.keys(state.points)];
      const found = wanted.find((name) => name in state.points);
      if (found !== undefined) await show(found);
    } catch (error) {  // the link has gone again: the next state begins anew
      state = null;
    }
  };
  const show = async (point) => {
    shown = point;
    past = null;
    if (socket.readyState === WebSocket.OPEN) socket.send(point);
    write($("shown"), point);
    write($("ahead-of"), `Ahead of ${point}`);
    write($("ratio-of"), `Heating ratio of ${point}`);
    write($("shown-title"), (fixed.points[point] || {}).title || "");
    history.replaceState(null, "", `#${point}`);
    await Promise.all([fetchPast(), fetchCurve()]);
  };
  const choose = (point) => show(point).catch(() => {});
  let fetching = false;
  const fetchPast = async () => {  // bounded by the server, which thins what is long past
    const point = shown;
    fetching = true;
    try {
      const columns = await json(address("history.json", point));
      if (point === shown) {
        past = increasing(columns);
        if (builtFor !== structure()) buildCharts();
        dirty = true;
      }
    } finally {
      fetching = false;
    }
  };
  const fetchCurve = async () => {
    const point = shown;
    if (point === null || !(fixed.points[point] || {}).table) { curve = { alpha_deg: [], ratio: [] }; return; }
    const found = await json(address("curve.json", point));
    if (point === shown) curve = found;
  };

  // The past of the point that is shown ---------------------------------------------------------------------------------

  // A clock that went back: what it had counted before is dropped, so that times increase.
  const increasing = (columns) => {
    const times = columns.time_s || [], kept = [];
    times.forEach((t, i) => {
      while (kept.length && times[kept[kept.length - 1]] >= t) kept.pop();
      kept.push(i);
    });
    return Object.fromEntries(Object.entries(columns).map(([name, all]) => [name, kept.map((i) => all[i])]));
  };
  const row = (point) => ({
    time_s: state.time_s, alpha_deg: state.conditions.alpha_deg, mach: state.conditions.mach, ...point,
    ...Object.fromEntries(Object.entries(point.sensors).flatMap(([name, own]) => Object.entries(own).map(([key, v]) => [`sensors.${name}.${key}`, v]))),
  });
  const append = () => {
    const point = state.points[shown];
    if (shown === null && Object.keys(state.points).length) { restart(); return; }
    if (past === null || !point || !known(state.time_s)) return;
    if (!past.time_s || Object.keys(past).length === 0 || Object.keys(point.sensors).some((name) => !(`sensors.${name}.predicted_K` in past))) {
      if (!fetching) fetchPast().catch(() => {});
      return;
    }
    const last = past.time_s.length - 1;
    if (last >= 0 && state.time_s === past.time_s[last]) return;
    if (last >= 0 && state.time_s < past.time_s[last]) {
      const keep = past.time_s.filter((t) => t < state.time_s).length;
      for (const column of Object.values(past)) column.length = keep;
    }
    const values = row(point);
    for (const [name, column] of Object.entries(past)) column.push(known(values[name]) ? values[name] : null);
    if (past.time_s.length > MOST_SAMPLES && !fetching) fetchPast().catch(() => {});
  };

  // Charts ----------------------------------------------------------------------------------------------------------------

  const plain = (label, color, rest = {}) => ({ label, color, digits: 1, t: [], y: [], bands: [], ...rest });
  const banded = (label, color, rest = {}) => plain(label, color, { bands: [{ t: [], y: [] }, { t: [], y: [] }], ...rest });
  const limitOf = (name) => (state.points[shown].limits || {})[name];
  const dashedLimit = (name) => plain(known(limitOf(name)) ? `limit ${limitOf(name).toFixed(0)} K` : "no limit", LIMIT, { dash: [7, 4], aside: true });
  const band = (t, y, sigma) => [-2, 2].map((k) => ({ t, y: y.map((v, i) => (known(v) && known(sigma[i]) ? v + k * sigma[i] : null)) }));
  const make = (id, time, panels, growing = false) => {
    if (charts[id]) remove(charts[id]);
    const data = { title: "", time, growing, panels: panels.map((p) => ({ height: 1, zero: false, limits: null, ...p })), spans: [], view: [0, 1], whole: [0, 1], reset: "Follow" };
    charts[id] = draw($(id), data);
  };
  const sensorsNear = (place) => {
    const about = (fixed.points[shown] || {}).sensors || {};
    const names = Object.keys((state.points[shown] || { sensors: {} }).sensors);
    return names.filter((name) => ((about[name] || {}).near || "surface") === place);
  };
  const sensorCurves = (place) => sensorsNear(place).flatMap((name, i) => {
    const color = MANY[i % MANY.length];
    return [banded(name, color), plain(`${name} measured`, color, { points: true })];
  });
  let builtFor = "";
  const structure = () => JSON.stringify([shown, Object.keys((state.points[shown] || {}).sensors || {}), (state.points[shown] || {}).limits]);
  const buildCharts = () => {
    if (!state || !state.points[shown]) return;
    builtFor = structure();
    const within = sensorCurves("within"), tall = window.innerWidth >= 1700 ? 1.3 : 1;
    make("strips", "time, s", [
      { label: "surface, K", height: 0.9 * tall, curves: [banded("surface", SURFACE), dashedLimit("surface_K"), ...sensorCurves("surface")] },
      ...(within.length ? [{ label: "in depth, K", height: 0.5 * tall, curves: within }] : []),
      { label: "bondline, K", height: 0.5 * tall, curves: [banded("bondline", BONDLINE), dashedLimit("bondline_K"), ...sensorCurves("bondline")] },
      { label: "angle of attack, deg", height: 0.5, curves: [plain("angle of attack", "#000000", { digits: 2 })] },
    ], true);
    charts.strips.within = within.length > 0;
    const futures = (rest) => FUTURES.map(([name, color, dash]) => banded(name, color, { dash, ...rest }));
    make("ahead", "time from now, s", [
      { label: "surface, K", height: 0.7, curves: [...futures(), dashedLimit("surface_K")] },
      { label: "bondline, K", height: 0.5, curves: [...futures(), dashedLimit("bondline_K")] },
    ]);
    make("ratio", "angle of attack, deg", [
      { label: "heating ratio", height: 0.9, curves: [
        plain("declared, at present", TABLE, { dash: [7, 4], digits: 4 }),
        plain("declared, as flown", "#9aa4ae", { points: true, digits: 4 }),
        banded("estimate", "#0072B2", { points: true, bars: true, digits: 4 }),
        plain("now", SURFACE, { points: true, size: 8, digits: 4 }),
      ] },
    ]);
    link(true);
  };
  const column = (name) => past[name] || past.time_s.map(() => null);
  const limitLine = (name, [from, to]) => (known(limitOf(name)) ? { t: [from, to], y: [limitOf(name), limitOf(name)] } : { t: [], y: [] });
  const measured = (name) => {  // a reading stays in the states until the next one
    const at = column(`sensors.${name}.measured_s`), read = column(`sensors.${name}.measured_K`), t = [], y = [];
    at.forEach((s, i) => {
      if (!known(s) || !known(read[i]) || (t.length && s <= t[t.length - 1])) return;
      t.push(s);
      y.push(read[i]);
    });
    return { t, y };
  };
  const paintStrips = () => {
    const t = past.time_s, end = t[t.length - 1], first = Number.isFinite(span) ? Math.min(t[0], end - span) : t[0];
    const whole = [first, end > first ? end : first + 1];
    const view = [Number.isFinite(span) ? whole[1] - span : first, whole[1]];
    const main = (name) => {
      const y = column(`${name}_K`);
      return { t, y, bands: band(t, y, column(`${name}_sigma_K`)) };
    };
    const sensors = (place) => sensorsNear(place).flatMap((name) => {
      const y = column(`sensors.${name}.predicted_K`);
      return [{ t, y, bands: band(t, y, column(`sensors.${name}.sigma_K`)) }, measured(name)];
    });
    refresh(charts.strips, { view, whole, panels: [
      [main("surface"), limitLine("surface_K", whole), ...sensors("surface")],
      ...(charts.strips.within ? [sensors("within")] : []),
      [main("bondline"), limitLine("bondline_K", whole), ...sensors("bondline")],
      [{ t, y: column("alpha_deg") }],
    ] });
  };
  const paintAhead = () => {
    const { ahead, knock_off_by_s: by } = state.points[shown];
    const now = state.time_s;
    const times = (name) => ((ahead[name] || {}).time_s || []).map((s) => s - now);
    const end = Math.max(1, ...FUTURES.map(([name]) => (ahead[name] || {}).horizon_s || 0));
    const whole = [0, end];
    const curves = (what) => FUTURES.map(([name]) => {
      const own = ahead[name] || {}, t = times(name), y = own[`${what}_K`] || [];
      return { t, y, bands: band(t, y, own[`${what}_sigma_K`] || []) };
    });
    const left = known(by) ? by - now : null;
    const spans = left !== null && left >= 0 && left <= end ? [[left - 0.003 * end, left + 0.003 * end, "knock it off by", SURFACE]] : [];
    refresh(charts.ahead, { view: whole, whole, spans, panels: ["surface", "bondline"].map((what) => [...curves(what), limitLine(`${what}_K`, whole)]) });
  };
  const paintFutures = () => {
    const point = state.points[shown];
    cells($("ahead-rows"), FUTURES.filter(([name]) => point.ahead[name]).map(([name]) => {
      const own = point.ahead[name], left = known(own.peak_at_s) ? own.peak_at_s - state.time_s : null;
      return [name, number(own.peak_surface_K, 0), number(left, 0), number(own.margin_K, 0), percent(own.probability)];
    }), []);
    write($("ahead-text"), knockText(shown, point) || (Object.keys(point.ahead).length ? "" : "No look-ahead."));
  };
  const paintRatio = () => {
    const alpha = column("alpha_deg"), ratio = column("ratio"), sigma = column("ratio_sigma");
    const declared = column("ratio_declared"), bins = new Map();  // the latest estimate at each angle
    alpha.forEach((a, i) => { if (known(a) && known(ratio[i])) bins.set(Math.round(a / BIN_DEG), i); });
    const order = [...bins.values()].sort((i, j) => alpha[i] - alpha[j]);
    const [t, y, s, flown] = [alpha, ratio, sigma, declared].map((all) => order.map((i) => all[i]));
    const now = state.conditions.alpha_deg, own = state.points[shown];
    const seen = [...t, ...(known(now) ? [now] : [])];
    const low = seen.length ? Math.min(...seen) : 0, high = seen.length ? Math.max(...seen) : 1;
    const pad = Math.max(1.5, 3 - 0.5 * (high - low));
    const view = [low - pad, high + pad];
    const whole = [Math.min(view[0], ...curve.alpha_deg.slice(0, 1)), Math.max(view[1], ...curve.alpha_deg.slice(-1))];
    refresh(charts.ratio, { view, whole, panels: [[
      { t: curve.alpha_deg, y: curve.ratio },
      { t, y: flown },
      { t, y, bands: band(t, y, s) },
      known(now) && known(own.ratio) ? { t: [now], y: [own.ratio] } : { t: [], y: [] },
    ]] });
  };
  const paintRatioText = () => {
    const own = state.points[shown], now = state.conditions.alpha_deg;
    const off = known(own.ratio) && own.ratio_declared ? `, ${(100 * (own.ratio / own.ratio_declared - 1)).toFixed(1)} % off the declared one` : "";
    write($("ratio-text"), known(own.ratio) ? `${interval(own.ratio, own.ratio_sigma, 4)}${off}, at ${number(now, 2)}\u00b0; bars are 2 sigma.` : "Not estimated yet.");
  };

  // Numbers -----------------------------------------------------------------------------------------------------------------

  const list = (place, pairs) => {
    while (place.children.length < pairs.length) {
      const box = element("div", place);
      element("dt", box);
      element("dd", box);
    }
    pairs.forEach(([name, text], i) => {
      write(place.children[i].children[0], name);
      write(place.children[i].children[1], text);
    });
  };
  const lines = (place, texts) => {
    while (place.children.length > texts.length) place.lastChild.remove();
    while (place.children.length < texts.length) element("li", place);
    texts.forEach((text, i) => write(place.children[i], text));
  };
  const head = (place, names) => {
    place.replaceChildren();
    const tr = element("tr", place);
    for (const [text, kind] of names) element("th", tr, { text, scope: "col", ...(kind ? { class: kind } : {}) });
  };
  const cells = (place, rows, kinds) => {
    while (place.children.length > rows.length) place.lastChild.remove();
    while (place.children.length < rows.length) element("tr", place);
    rows.forEach((texts, i) => {
      const tr = place.children[i];
      while (tr.children.length < texts.length) element("td", tr, kinds[tr.children.length] ? { class: kinds[tr.children.length] } : {});
      texts.forEach((text, k) => write(tr.children[k], text));
    });
  };

  const knockText = (name, { knock_off: what, knock_off_by_s: by }) => {
    if (what === "too late") return `Too late to keep the limits at ${name}.`;
    if (what === "by" && known(by)) return `Knock it off by ${by.toFixed(1)} s at ${name}: ${Math.max(0, by - state.time_s).toFixed(0)} s left.`;
    if (what === "never needed") return "No need to knock it off within the horizon.";
    return "";
  };
  const paintLines = () => {
    const all = Object.entries(state.points);
    const late = all.filter(([, p]) => p.knock_off === "too late"), by = all.filter(([, p]) => p.knock_off === "by" && known(p.knock_off_by_s));
    by.sort((a, b) => a[1].knock_off_by_s - b[1].knock_off_by_s);
    const needed = late.length ? late : by;
    const quiet = all.length && all.every(([, p]) => p.knock_off === "never needed");
    const others = needed.length > 1 ? ` Also ${needed.slice(1, 4).map(([name]) => name).join(", ")}${needed.length > 4 ? ` and ${needed.length - 4} more` : ""}.` : "";
    write($("knock"), needed.length ? `${knockText(...needed[0])}${others}` : quiet ? "No need to knock it off within the horizon." : "No look-ahead yet.");
    mark($("knock"), "level", late.length ? "bad" : by.length ? (by[0][1].knock_off_by_s - state.time_s < 10 ? "bad" : "care") : quiet ? "good" : "none");
    const { missing } = state;
    const could = (missing.candidates || []).map(({ what, probability }) => `${what} ${percent(probability)}`).join(", ");
    const rate = known(missing.false_alarms_per_hour) ? ` (statistic ${number(missing.statistic, 1)} of ${number(missing.threshold, 1)}, ${missing.false_alarms_per_hour} false alarms an hour)` : "";
    const about = missing.text ? missing.text[0].toUpperCase() + missing.text.slice(1) : "";
    write($("missing"), `${about}${could ? `: ${could}` : ""}${rate}`);
    mark($("missing"), "level", missing.alarm ? "care" : known(missing.statistic) ? "good" : "none");
  };
  const levelOf = (margin) => (known(margin) ? LEVELS.find(([least]) => margin >= least) : [null, ...UNKNOWN]);
  const extremes = (point) => {
    const futures = Object.values(point.ahead || {});
    const margins = futures.map((f) => f.margin_K).filter(known), chances = futures.map((f) => f.probability).filter(known);
    return [margins.length ? Math.min(...margins) : null, chances.length ? Math.max(...chances) : null];
  };

  let rows = new Map(), spots = new Map();
  const buildPoints = () => {
    head($("points-head"), [["point"], ["surface, K"], ["bondline, K"], ["margin, K"], ["ahead, K"], ["limit passed"], ["over declared", "wide"]]);
    $("points").replaceChildren();
    rows = new Map();
    for (const name of Object.keys(state.points)) {
      const tr = element("tr", $("points"));
      const first = element("td", tr);
      const swatch = element("span", first, { class: "swatch" });
      const button = element("button", first, { type: "button", text: name, title: (fixed.points[name] || {}).title || name });
      button.addEventListener("click", () => choose(name));
      const texts = ["", "", "", "", "", "wide"].map((kind) => element("td", tr, kind ? { class: kind } : {}));
      rows.set(name, { tr, swatch, texts });
    }
    buildMap();
  };
  const paintPoints = () => {
    for (const [name, point] of Object.entries(state.points)) {
      const own = rows.get(name);
      if (!own) { buildPoints(); return; }
      const [margin, chance] = extremes(point), color = levelOf(point.margin_K)[1];
      own.swatch.style.setProperty("--color", color);
      const selected = String(name === shown);
      if (own.tr.getAttribute("aria-selected") !== selected) own.tr.setAttribute("aria-selected", selected);
      const over = known(point.ratio) && point.ratio_declared ? (point.ratio / point.ratio_declared).toFixed(3) : "\u2013";
      [interval(point.surface_K, point.surface_sigma_K, 1), interval(point.bondline_K, point.bondline_sigma_K, 1), number(point.margin_K, 0), number(margin, 0), percent(chance), over]
        .forEach((text, k) => write(own.texts[k], text));
      for (const spot of spots.get(name) || []) {
        spot.circle.setAttribute("fill", color);
        const kind = `point${name === shown ? " selected" : ""}${chance > DANGER ? " danger" : ""}`;
        if (spot.group.getAttribute("class") !== kind) spot.group.setAttribute("class", kind);
      }
    }
  };

  // Map: the vehicle from above and from the side, x aft to the right ------------------------------------------------------

  const svg = (tag, parent, attributes = {}, text) => {
    const made = document.createElementNS("http://www.w3.org/2000/svg", tag);
    for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
    if (text !== undefined) made.textContent = text;
    parent.appendChild(made);
    return made;
  };
  const buildMap = () => {
    $("map").replaceChildren();
    spots = new Map();
    const placed = Object.keys(state.points).map((name) => [name, (fixed.points[name] || {}).position_m]).filter(([, at]) => at);
    $("map").hidden = !placed.length;
    if (!placed.length) return;
    const WIDTH = 560, EDGE = 26, ROOM = 80;
    const x = placed.map(([, at]) => at[0]), least = Math.min(...x, 0), length = Math.max(1, Math.max(...x) - least);
    const scale = (WIDTH - EDGE - ROOM) / length;
    let top = 18;
    const picture = svg("svg", $("map"), { role: "group", "aria-label": "Control points on the vehicle, coloured by their margin" });
    for (const [axis, title] of [[1, "from above, nose at the left"], [2, "from the side"]]) {
      const across = placed.map(([, at]) => at[axis]), high = Math.max(...across, 0), low = Math.min(...across, 0);
      svg("text", picture, { x: 0, y: top - 6 }, title);
      const place = (at) => [EDGE + (at[0] - least) * scale, top + 16 + (high - at[axis]) * scale];
      const [, zero] = place([0, 0, 0]);
      svg("line", picture, { x1: 0, x2: WIDTH, y1: zero, y2: zero });
      const taken = placed.map(([, at]) => { const [u, v] = place(at); return [u - 7, v - 7, u + 7, v + 7]; });
      for (const [name, at] of placed) {
        const [u, v] = place(at), group = svg("g", picture, { class: "point" });
        svg("circle", group, { class: "ring", cx: u, cy: v, r: 10 });
        const circle = svg("circle", group, { class: "spot", cx: u, cy: v, r: 6.5 });
        svg("title", circle, {}, `${name}: ${(fixed.points[name] || {}).title || ""}`);
        circle.addEventListener("click", () => choose(name));
        label(picture, taken, name, u, v, WIDTH);
        spots.set(name, [...(spots.get(name) || []), { group, circle }]);
      }
      top += (high - low) * scale + 56;
    }
    picture.setAttribute("viewBox", `0 0 ${WIDTH} ${Math.round(top - 18)}`);
  };
  const label = (picture, taken, name, u, v, width) => {  // where it covers nothing; else its spot tells the name
    const w = 8.4 * name.length, h = 13;
    for (const [left, base] of [[u + 13, v + 4], [u - 13 - w, v + 4], [u - w / 2, v - 11], [u - w / 2, v + 21]]) {
      const box = [left, base - h + 2, left + w, base + 2];
      if (box[0] < 0 || box[2] > width || taken.some((b) => box[0] < b[2] && box[2] > b[0] && box[1] < b[3] && box[3] > b[1])) continue;
      taken.push(box);
      svg("text", picture, { class: "name", x: left, y: base }, name);
      return;
    }
  };

  const paintSensors = () => {
    const point = state.points[shown];
    const deviation = (own) => (known(own.measured_K) && known(own.predicted_K) && own.sigma_K ? ((own.measured_K - own.predicted_K) / own.sigma_K).toFixed(1) : "\u2013");
    cells($("sensors"), Object.entries(point.sensors).map(([name, own]) => [
      name, number(own.measured_K), interval(own.predicted_K, own.sigma_K), deviation(own), own.used ? "used" : own.why || "not used",
    ]), ["", "", "", "", "words"]);
    cells($("parameters"), Object.entries(point.parameters).map(([name, own]) => [name, own.value.toPrecision(4), own.sigma.toPrecision(2), own.unit]), ["", "", "", "words"]);
  };
  const paintHealth = () => {
    const own = state.link;
    list($("health"), [
      ["frames", `${number(own.frames_Hz)} Hz`], ["readings", `${number(own.readings_Hz)} Hz`], ["lateness", `${number(own.lateness_s, 2)} s`],
      ...["late", "too_late", "doubled", "damaged", "lost", "jumps"].map((name) => [name.replace("_", " "), String(own[name])]),
    ]);
    lines($("messages"), own.messages.slice(-8).reverse());
    lines($("removed"), state.removed.length ? state.removed.map((r) => `${r.point}, ${r.sensor}: since ${number(r.since_s)} s, ${r.why}`) : ["nothing"]);
  };
  const paintFacts = () => {
    const { altitude_m: altitude, velocity_m_s: speed, mach, alpha_deg: alpha } = state.conditions;
    list($("facts"), [["time", `${number(state.time_s)} s`], ["Mach", number(mach)], ["angle of attack", `${number(alpha, 2)}\u00b0`],
      ["altitude", `${number(known(altitude) ? altitude / 1000 : null)} km`], ["speed", `${number(speed, 0)} m/s`]]);
  };

  // The clock of the page -----------------------------------------------------------------------------------------------------

  const NAMES = { connecting: "connecting", disconnected: "no connection", live: "live", waiting: "waiting", stalled: "stalled", ended: "ended" };
  const paintPhase = () => {
    const silent = performance.now() - received;
    const over = state !== null && state.link.state === "ended";
    let phase = !connected ? (opened && !over ? "disconnected" : over ? "ended" : "connecting") : state === null ? "waiting" : state.link.state;
    if (connected && !over && silent > STALLED_MS) phase = "stalled";
    const since = state === null ? silent / 1000 : silent / 1000 + state.link.since_s;
    write($("phase"), phase === "stalled" ? `${NAMES[phase]} for ${since.toFixed(0)} s` : NAMES[phase]);
    mark($("phase"), "phase", phase);
    document.body.classList.toggle("stale", ["stalled", "disconnected"].includes(phase));
    const title = `${NAMES[phase]} \u2013 ${fixed.title || "sim-heating live"}`;
    if (document.title !== title) document.title = title;
    if (connected && !over && silent > SILENT_MS && performance.now() - tried > SILENT_MS) {
      socket.close();  // a network that went away tells nobody
      connect();
    }
  };
  const paint = (whole = false) => {  // whole: what is not on the screen, too
    if (!dirty || state === null || document.hidden) return;
    dirty = false;
    paintFacts();
    paintLines();
    paintPoints();
    paintHealth();
    if (!state.points[shown]) return;
    paintSensors();
    paintFutures();
    paintRatioText();
    if (past === null || !past.time_s || !past.time_s.length || !charts.strips) return;
    for (const [id, work] of [["strips", paintStrips], ["ahead", paintAhead], ["ratio", paintRatio]]) if (whole || visible.has($(id))) work();
    document.documentElement.dataset.drawn = String(state.sequence);
  };
  const visible = new Set();
  const observer = new IntersectionObserver((seen) => {
    for (const { target, isIntersecting } of seen) visible[isIntersecting ? "add" : "delete"](target);
    dirty = true;
  }, { rootMargin: "200px" });

  for (const [text, seconds] of WINDOWS) {
    const made = element("button", $("window"), { type: "button", text, "aria-pressed": String(seconds === span) });
    made.addEventListener("click", () => {
      span = seconds;
      for (const other of $("window").children) other.setAttribute("aria-pressed", String(other === made));
      if (charts.strips) charts.strips.home = true;
      dirty = true;
    });
  }
  for (const [, color, text] of [...LEVELS, [null, ...UNKNOWN]]) {
    const item = element("li", $("scale"));
    element("span", item, { class: "swatch" }).style.setProperty("--color", color);
    item.append(text);
  }
  head($("ahead-head"), [["future"], ["peak surface, K"], ["in, s"], ["margin, K"], ["limit passed"]]);
  head($("sensors-head"), [["sensor"], ["measured, K"], ["predicted, K"], ["off, sigma"], ["", "words"]]);
  head($("parameters-head"), [["parameter"], ["value"], ["sigma"], ["unit", "words"]]);
  for (const id of ["strips", "ahead", "ratio"]) observer.observe($(id));
  document.addEventListener("visibilitychange", () => { dirty = true; });
  window.addEventListener("beforeprint", () => { dirty = true; paint(true); });
  setInterval(() => { paintPhase(); paint(); }, TICK_MS);
  setInterval(() => { if (!document.hidden) fetchCurve().then(() => { dirty = true; }, () => {}); }, CURVE_MS);
  connect();
})();
