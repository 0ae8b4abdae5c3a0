// The beat on the first page: sliders, and pressure and flow at two sites, redrawn beat by beat until they repeat.
"use strict";
(() => {
  const { Arteries } = globalThis;
  const QUANTITIES = [{ key: "P", title: "Pressure [mmHg]", unit: 133.322387415 }, { key: "Q", title: "Flow [mL/s]", unit: 1e-6 }];
  const REPEATS = 1e-3; // of the pulse: less is not seen
  const MOST = 60; // beats after a slider was moved: elastic walls may never settle
  const LEFT = 40, RIGHT = 6, TOP = 8, BOTTOM = 22;

  function make(parent, tag, attributes = {}, text = "") {
    const made = tag === "svg" || parent.namespaceURI.endsWith("svg")
      ? document.createElementNS("http://www.w3.org/2000/svg", tag) : document.createElement(tag);
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    made.textContent = text;
    return parent.appendChild(made);
  }

  // --- a plot -------------------------------------------------------------------------------------------------------

  // Round numbers from low to high, some five of them.
  function ticks(low, high) {
    const rough = (high - low) / 5, power = 10 ** Math.floor(Math.log10(rough));
    const step = [1, 2, 5, 10].map((x) => x * power).find((x) => x >= rough);
    const from = Math.floor(low / step + 1e-9), to = Math.ceil(high / step - 1e-9);
    return Array.from({ length: to - from + 1 }, (_, i) => Number(((from + i) * step).toPrecision(6)));
  }

  class Plot {
    constructor(parent, title) {
      const figure = make(parent, "figure");
      make(figure, "figcaption", {}, title);
      this.svg = make(figure, "svg", { role: "img", "aria-label": `${title} over time [s] at two sites` });
    }

    // curves : {kind, T, values}, each a beat that is repeated until the end.
    draw(curves, end) {
      const { clientWidth: width, clientHeight: height } = this.svg, all = curves.flatMap((curve) => curve.values);
      const levels = ticks(Math.min(...all), Math.max(...all)), times = ticks(0, end).filter((t) => t <= end * 1.0001);
      const [low, high, latest] = [levels[0], levels.at(-1), times.at(-1)];
      const x = (t) => LEFT + (t / end) * (width - LEFT - RIGHT);
      const y = (value) => TOP + ((high - value) / (high - low)) * (height - TOP - BOTTOM);
      this.svg.replaceChildren();
      for (const level of levels) {
        make(this.svg, "line", { x1: LEFT, x2: width - RIGHT, y1: y(level), y2: y(level), class: level ? "grid" : "zero" });
        make(this.svg, "text", { x: LEFT - 5, y: y(level) + 4, "text-anchor": "end" }, String(level));
      }
      for (const t of times) {
        const anchor = t > 0.97 * end ? "end" : "middle";
        make(this.svg, "text", { x: x(t), y: height - 6, "text-anchor": anchor }, t === latest ? `${t} s` : String(t));
      }
      for (const { kind, T, values } of curves) {
        const h = T / values.length, points = [];
        for (let k = 0; k * h <= end * 1.0001; k++) {
          const value = values[(k + values.length - 1) % values.length]; // the first is at the end of the first step
          points.push(`${x(k * h).toFixed(1)} ${y(value).toFixed(1)}`);
        }
        make(this.svg, "path", { d: `M${points.join("L")}`, class: kind });
      }
    }
  }

  // --- a slider -----------------------------------------------------------------------------------------------------

  const SIGNED = new Intl.NumberFormat("en", { signDisplay: "exceptZero", minimumFractionDigits: 2, maximumFractionDigits: 2 });
  const SHOWN = {
    factor: (x) => `× ${x.toFixed(2)}`,
    shift: (x) => SIGNED.format(x),
    rate: (x) => `${x.toFixed(0)} /min`,
  };
  const NEUTRAL = { factor: 1, shift: 0 };

  class Slider {
    constructor(parent, about, changed) {
      const { label, kind, low, high, log, first = NEUTRAL[kind] } = about;
      const [to, from] = log ? [Math.log, Math.exp] : [(x) => x, (x) => x];
      const row = make(parent, "label");
      make(row, "span", {}, label);
      const shown = make(row, "output");
      const attributes = { type: "range", min: to(low), max: to(high), step: kind === "rate" ? 1 : (to(high) - to(low)) / 200 };
      this.input = make(row, "input", attributes);
      this.show = () => {
        this.value = from(Number(this.input.value));
        shown.textContent = SHOWN[kind](this.value);
        this.input.setAttribute("aria-valuetext", shown.textContent);
      };
      this.reset = () => {
        this.input.value = to(first);
        this.show();
        this.value = first;
      };
      this.moved = () => about.start.map((x) => (kind === "factor" ? x * this.value : x + this.value));
      this.about = about;
      this.reset();
      this.input.addEventListener("input", () => { this.show(); changed(); });
    }
  }

  // --- the page -----------------------------------------------------------------------------------------------------

  // The series of channels in the next beat, of a period T.
  function beatOf(arteries, T, channels) {
    const rows = arteries.beat(T, channels);
    return { T, series: channels.map((_, i) => rows.map((row) => row[i])) };
  }

  class Live {
    constructor(parent, data) {
      this.engine = Arteries.engine(data.engine);
      const choice = make(parent, "div", { class: "networks", role: "group", "aria-label": "Network" });
      this.buttons = data.networks.map((network) => {
        const button = make(choice, "button", { type: "button" }, network.title);
        button.addEventListener("click", () => this.open(network));
        return button;
      });
      this.back = make(choice, "button", { type: "button", class: "reset", disabled: "" }, "Reset"); // until a network is open
      this.back.addEventListener("click", () => this.reset());
      this.legend = make(parent, "div", { class: "legend" });
      const plots = make(parent, "div", { class: "plots" });
      this.plots = QUANTITIES.map(({ title }) => new Plot(plots, title));
      this.panel = make(parent, "div", { class: "sliders" });
      this.problem = make(parent, "p", { class: "problem", role: "alert" });
      this.state = make(parent, "p", { class: "state" });
      new ResizeObserver(() => this.beat && this.draw()).observe(plots);
    }

    // Show a network. Until its first beat is there, and where it fails, the one before stays.
    async open(network) {
      const asked = this.asked = {};
      this.problem.textContent = "";
      try {
        const arteries = await Arteries.open(await this.engine, network);
        if (this.asked === asked) this.show(network, arteries); // else another one was chosen meanwhile
      } catch (error) {
        if (this.asked === asked) this.problem.textContent = `${network.title} cannot be shown: ${error.message}`;
      }
    }

    show(network, arteries) {
      const channels = QUANTITIES.flatMap(({ key }) => network.sites.map((site) => site[key]));
      const published = beatOf(arteries, network.T, channels);
      Object.assign(this, { network, arteries, channels, published, beat: published });
      for (const button of this.buttons) button.setAttribute("aria-pressed", button.textContent === network.title);
      this.back.disabled = false;
      this.legend.replaceChildren();
      this.labels = network.sites.map((_, i) => make(this.legend, "span", { class: `site${i}` }));
      make(this.legend, "span", { class: "published" }, "as in the network file");
      this.panel.replaceChildren();
      const first = 60 / network.T, [low, high] = network.rates;
      this.rate = new Slider(this.panel, { label: "Heart rate", kind: "rate", low, high, first }, () => this.run());
      this.sliders = network.sliders.map((about) => new Slider(this.panel, about, () => this.run()));
      this.run();
    }

    reset() {
      for (const slider of [this.rate, ...this.sliders]) slider.reset();
      this.run();
    }

    // From here on a beat a frame, until they repeat.
    run() {
      this.settled = false;
      this.beats = 0;
      this.go();
    }

    go() {
      if (!this.waiting) this.waiting = requestAnimationFrame(() => this.frame());
    }

    frame() {
      this.waiting = 0;
      const begin = performance.now(), before = this.beat;
      try {
        for (const slider of this.sliders) this.arteries.write(slider.about.vr, slider.moved());
        this.beat = beatOf(this.arteries, 60 / this.rate.value, this.channels);
      } catch (error) {
        this.state.textContent = error.message;
        this.arteries.begin(); // with the network's own values; sliders count again when they are moved
        return;
      }
      this.draw();
      this.beats += 1;
      this.settled = this.beats >= MOST || (before.T === this.beat.T && this.change(before) < REPEATS);
      const took = performance.now() - begin;
      this.state.textContent = `A beat in ${this.network.inflow.length} steps, computed and drawn in ${took.toFixed(0)} ms.`;
      if (!this.settled) this.go();
    }

    // The largest difference to a beat before, in parts of the pulse.
    change(before) {
      return Math.max(...this.beat.series.map((now, i) => {
        const off = Math.max(...now.map((value, k) => Math.abs(value - before.series[i][k])));
        return off / (Math.max(...now) - Math.min(...now));
      }));
    }

    draw() {
      this.network.sites.forEach(({ label }, i) => {
        const pressures = this.beat.series[i].map((value) => value / QUANTITIES[0].unit);
        const [high, low] = [Math.max, Math.min].map((most) => most(...pressures).toFixed(0));
        this.labels[i].textContent = `${label}: ${high}/${low} mmHg`;
      });
      const of = ({ T, series }, kind, q, unit) => this.network.sites.map((_, i) => (
        { kind: `${kind} site${i}`, T, values: series[q * this.network.sites.length + i].map((value) => value / unit) }));
      QUANTITIES.forEach(({ unit }, q) => {
        const curves = [...of(this.published, "published", q, unit), ...of(this.beat, "now", q, unit)];
        this.plots[q].draw(curves, 2 * this.network.T);
      });
    }
  }

  for (const parent of document.querySelectorAll(".arterial-live")) {
    parent.live = new Live(parent, globalThis.arterialLive);
    parent.live.open(globalThis.arterialLive.networks[0]);
  }
})();
