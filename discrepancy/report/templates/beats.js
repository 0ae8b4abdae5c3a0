"use strict";
// Beats of one channel: drawn as SVG, chosen by list, link (#channel=CA.P&view=difference) or z map; read by mouse or arrows.
(() => {
  const beats = JSON.parse(document.getElementById("beats").textContent);
  const plot = document.getElementById("plot");
  const readout = document.getElementById("readout");
  const select = document.getElementById("channel");
  const boxes = { before: document.getElementById("show-before"), after: document.getElementById("show-after") };
  const views = document.querySelectorAll("input[name=view]");
  const CURVES = [
    { key: "measured", colour: "#000000", dash: "", text: "measured" },
    { key: "before", colour: "#D55E00", dash: "7 4", text: "before" },
    { key: "after", colour: "#0072B2", dash: "2 3", text: "after" },
  ];
  const EDGE = { left: 64, right: 14, top: 12, bottom: 42 };
  const named = (name) => beats.channels.find((c) => c.name === name);
  let state = { channel: named(beats.first), view: "beat", at: null };

  const element = (name, attributes, text) => {
    const made = document.createElementNS("http://www.w3.org/2000/svg", name);
    for (const key in attributes) made.setAttribute(key, attributes[key]);
    if (text !== undefined) made.textContent = text;
    return made;
  };

  const ticks = (low, high, wanted) => {
    const raw = (high - low) / wanted;
    const power = 10 ** Math.floor(Math.log10(raw));
    const step = [1, 2, 5, 10].map((f) => f * power).find((s) => s >= raw);
    const found = [];
    for (let i = Math.ceil(low / step); i * step <= high * (1 + 1e-12); i++) found.push(i * step);
    return { found, digits: Math.max(0, -Math.floor(Math.log10(step) + 1e-9)) };
  };

  const minus = (text) => text.replace("-", "\u2212");

  // the curves of the view: the beats themselves, or model minus measured
  const curves = () => {
    const channel = state.channel;
    const difference = state.view === "difference";
    return CURVES.filter((c) => channel[c.key] && (c.key === "measured" ? !difference : boxes[c.key].checked)).map((c) => ({
      ...c,
      values: channel[c.key].map((v, i) => (difference ? v - channel.measured[i] : v)),
    }));
  };

  const band = () =>
    state.channel.band.map((sd, i) => {
      const middle = state.view === "difference" ? 0 : state.channel.measured[i];
      return [middle - 2 * sd, middle + 2 * sd];
    });

  const scales = (drawn, edges) => {
    const values = drawn.flatMap((c) => c.values).concat(edges.flat()).filter(Number.isFinite);
    let low = Math.min(...values), high = Math.max(...values);
    const margin = 0.05 * (high - low) || 1;
    low -= margin;
    high += margin;
    const width = plot.clientWidth || 900, height = plot.clientHeight || 380;
    const end = beats.time[beats.time.length - 1];
    const x = (t) => EDGE.left + (t / end) * (width - EDGE.left - EDGE.right);
    const y = (v) => EDGE.top + ((high - v) / (high - low)) * (height - EDGE.top - EDGE.bottom);
    return { x, y, low, high, width, height, end };
  };

  const axes = (s) => {
    const bottom = s.height - EDGE.bottom;
    const vertical = ticks(s.low, s.high, 6), horizontal = ticks(0, s.end, 8);
    for (const v of vertical.found) {
      plot.append(element("line", { x1: EDGE.left, x2: s.width - EDGE.right, y1: s.y(v), y2: s.y(v), stroke: "#e3e3e3" }));
      plot.append(element("text", { x: EDGE.left - 8, y: s.y(v) + 4, "text-anchor": "end" }, minus(v.toFixed(vertical.digits))));
    }
    for (const t of horizontal.found) {
      plot.append(element("line", { x1: s.x(t), x2: s.x(t), y1: bottom, y2: bottom + 5, stroke: "#1a1a1a" }));
      plot.append(element("text", { x: s.x(t), y: bottom + 19, "text-anchor": "middle" }, t.toFixed(horizontal.digits)));
    }
    plot.append(element("line", { x1: EDGE.left, x2: s.width - EDGE.right, y1: bottom, y2: bottom, stroke: "#1a1a1a" }));
    plot.append(element("text", { x: (EDGE.left + s.width) / 2, y: s.height - 5, "text-anchor": "middle" }, "time [s]"));
    const name = `${state.channel.name} [${state.channel.unit}]`;
    const middle = (EDGE.top + bottom) / 2;
    plot.append(element("text", { x: 14, y: middle, transform: `rotate(-90 14 ${middle})`, "text-anchor": "middle" }, name));
  };

  const path = (values, s) => values.map((v, i) => `${i ? "L" : "M"}${s.x(beats.time[i]).toFixed(1)},${s.y(v).toFixed(1)}`).join("");

  const draw = () => {
    const drawn = curves(), edges = band(), s = scales(drawn, edges);
    plot.replaceChildren();
    plot.setAttribute("viewBox", `0 0 ${s.width} ${s.height}`);
    const words = state.view === "difference" ? "model minus measured" : "mean beat";
    plot.setAttribute("aria-label", `${state.channel.name}, ${words}: ${drawn.map((c) => c.text).join(", ")}`);
    axes(s);
    const outline = edges.map((e, i) => [beats.time[i], e[1]]).concat(edges.map((e, i) => [beats.time[i], e[0]]).reverse());
    const points = outline.map(([t, v]) => `${s.x(t).toFixed(1)},${s.y(v).toFixed(1)}`).join(" ");
    plot.append(element("polygon", { points, fill: "#56B4E9", "fill-opacity": 0.55 }));
    if (state.view === "difference") {
      plot.append(element("line", { x1: EDGE.left, x2: s.width - EDGE.right, y1: s.y(0), y2: s.y(0), stroke: "#000" }));
    }
    for (const c of drawn) {
      const look = { d: path(c.values, s), fill: "none", stroke: c.colour, "stroke-width": 2, "data-curve": c.key };
      plot.append(element("path", c.dash ? { ...look, "stroke-dasharray": c.dash } : look));
    }
    read(drawn, s);
  };

  const read = (drawn, s) => {
    if (state.at === null) {
      readout.textContent = "Point at the plot, or focus it and use the arrow keys, to read values.";
      return;
    }
    const t = beats.time[state.at];
    plot.append(element("line", { x1: s.x(t), x2: s.x(t), y1: EDGE.top, y2: s.height - EDGE.bottom, stroke: "#555", "stroke-dasharray": "3 3" }));
    for (const c of drawn) {
      plot.append(element("circle", { cx: s.x(t), cy: s.y(c.values[state.at]), r: 4, fill: c.colour }));
    }
    const values = drawn.map((c) => `${c.text} ${minus(c.values[state.at].toPrecision(4))}`);
    const sd = state.channel.band[state.at].toPrecision(2);
    readout.textContent = `${t.toFixed(3)} s: ${values.join(", ")} ${state.channel.unit} (sd of the mean ${sd})`;
  };

  const choose = (change) => {
    state = { ...state, ...change };
    select.value = state.channel.name;
    for (const view of views) view.checked = view.value === state.view;
    boxes.after.disabled = !state.channel.after;
    draw();
  };

  const follow = () => {
    const wanted = new URLSearchParams(location.hash.slice(1));
    const channel = named(wanted.get("channel"));
    if (!channel) return;
    choose({ channel, view: wanted.get("view") === "difference" ? "difference" : state.view, at: null });
    document.getElementById("beats-heading").scrollIntoView();
  };

  for (const c of beats.channels) select.append(new Option(c.name, c.name));
  select.addEventListener("change", () => choose({ channel: named(select.value), at: null }));
  for (const view of views) view.addEventListener("change", () => choose({ view: view.value }));
  for (const box of Object.values(boxes)) box.addEventListener("change", draw);
  plot.addEventListener("pointermove", (event) => {
    const inside = event.clientX - plot.getBoundingClientRect().left - EDGE.left;
    const part = inside / (plot.clientWidth - EDGE.left - EDGE.right);
    const t = part * beats.time[beats.time.length - 1];
    let nearest = 0;
    beats.time.forEach((each, i) => {
      if (Math.abs(each - t) < Math.abs(beats.time[nearest] - t)) nearest = i;
    });
    choose({ at: nearest });
  });
  plot.addEventListener("pointerleave", () => choose({ at: null }));
  plot.addEventListener("keydown", (event) => {
    const last = beats.time.length - 1;
    const moves = { ArrowRight: 1, ArrowLeft: -1, PageUp: 10, PageDown: -10, Home: -last, End: last };
    if (!(event.key in moves)) return;
    event.preventDefault();
    choose({ at: Math.min(last, Math.max(0, (state.at ?? 0) + moves[event.key])) });
  });
  addEventListener("hashchange", follow);
  addEventListener("resize", draw);
  choose({});
  follow();
})();
