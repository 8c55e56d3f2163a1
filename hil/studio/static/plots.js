"use strict";
// The plots of the page: lines over time and loops, drawn by uPlot; and the store of the newest rows of a run.
const Plots = (function () {
  const PREFIXES = [[1e9, "G"], [1e6, "M"], [1e3, "k"], [1, ""], [1e-3, "m"], [1e-6, "\u00b5"], [1e-9, "n"]];
  const SHADES = ["first", "second", "third", "fourth", "fifth"];
  const colours = () => {
    const style = getComputedStyle(document.documentElement);
    return Object.fromEntries(["ink", "soft", "line", ...SHADES].map((name) => [name, style.getPropertyValue("--" + name).trim()]));
  };
  const digits = (_, splits) => splits.map((one) => (one === null ? "" : String(Number(one.toPrecision(8))).replace("-", "\u2212")));

  function engineering(value, unit, figures) {
    if (value === null || value === undefined || !Number.isFinite(value)) return "\u2013";
    const [factor, prefix] = value === 0 ? [1, ""] : PREFIXES.find(([one]) => Math.abs(value) >= 0.9995 * one) || PREFIXES[PREFIXES.length - 1];
    return `${(value / factor).toPrecision(figures || 3).replace("-", "\u2212")} ${prefix}${unit}`;
  }

  // The ends of an axis that show all values with a margin; a NaN, of a lost reply, is left out.
  function ends(arrays, fixed) {
    let low = Infinity, high = -Infinity;
    for (const values of arrays) for (const one of values) { if (one !== null && one < low) low = one; if (one !== null && one > high) high = one; }
    if (!(low <= high)) return [-1, 1];
    const margin = high > low ? 0.06 * (high - low) : 0.05 * Math.abs(high) || 1;
    return fixed ? [low, high] : [low - margin, high + margin];
  }

  const axes = (xLabel, yLabel, palette) => [xLabel, yLabel].map((label, at) => ({
    label, labelSize: 20, size: at ? 68 : 34, values: digits, stroke: palette.ink, grid: { stroke: palette.line, width: 1 }, ticks: { stroke: palette.line },
  }));

  // A plot that is made anew where its place has another size, or the colours change. hint: what stands in it before there is data.
  class Plot {
    constructor(place, hint) {
      this.place = document.getElementById(place);
      this.place.dataset.hint = hint;
      this.plot = this.data = null;
      new ResizeObserver(() => { if (this.plot && this.plot.width !== this.width) this.remake(); }).observe(this.place);
      matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.remake());
    }
    get width() { return Math.max(200, Math.floor(this.place.clientWidth)); }
    get hidden() { return !this.data || this.place.offsetParent === null; }
    clear() { if (this.plot) this.plot.destroy(); this.plot = this.data = null; }
    remake() { const { data } = this; this.clear(); this.data = data; this.draw(); }
    begin(options, data) { this.plot = new uPlot({ width: this.width, height: this.place.clientHeight - (this.legend || 0), ...options }, data, this.place); }
  }

  // Lines over time. names: of the lines. selected: called with the window that is dragged over, or with nothing after a double click.
  class Time extends Plot {
    constructor(place, hint, yLabel, unit, selected) {
      super(place, hint);
      Object.assign(this, { yLabel, unit, selected, names: [], span: null, legend: 30 });
    }
    show(data, names) {
      if (String(names) !== String(this.names)) { this.clear(); this.names = names; }
      this.data = data;
      this.draw();
    }
    // Show the window [low, high], s; null: all.
    zoom(span) {
      this.span = span;
      if (this.plot) { this.plot.setSelect({ left: 0, width: 0, top: 0, height: 0 }, false); this.plot.setData(this.data); }
    }
    draw() {
      if (this.hidden) return;
      if (this.plot) { this.plot.setData(this.data); return; }
      const palette = colours(), value = (unit) => (_, one) => (one === null || one === undefined ? "\u2013" : engineering(one, unit));
      const drag = (plot) => { const [low, width] = [plot.select.left, plot.select.width]; if (width > 3) this.selected(plot.posToVal(low, "x"), plot.posToVal(low + width, "x")); };
      const rows = (plot) => { const [low, high] = this.span || [-Infinity, Infinity], time = plot.data[0]; return [time.findIndex((one) => one >= low), time.findLastIndex((one) => one <= high) + 1]; };
      this.begin({
        hooks: { setSelect: [drag] },
        scales: {
          x: { time: false, range: (plot) => this.span || ends([plot.data[0]], true) },
          y: { range: (plot) => { const [from, to] = this.span ? rows(plot) : [0]; return ends(plot.data.slice(1).map((one) => (to ? one.slice(from, to) : one))); } },
        },
        legend: { show: true, live: true },
        cursor: { sync: { key: this.place.parentElement.parentElement.parentElement.id }, points: { size: 6 }, drag: { x: true, y: false, setScale: false }, bind: { dblclick: () => () => { this.selected(); return null; } } },
        axes: axes("time [s]", this.yLabel, palette),
        series: [{ label: "time", value: value("s") }, ...this.names.map((label, at) => ({ label, value: value(this.unit), stroke: palette[SHADES[at % SHADES.length]], width: 1, points: { show: false } }))],
      }, this.data);
    }
  }

  // Torque over deflection: each loop a line through samples that follow each other.
  class Loop extends Plot {
    show(loops) { this.data = loops; this.draw(); }
    draw() {
      if (this.hidden) return;
      const frame = [ends(this.data.map(([x]) => x)), ends(this.data.map(([, y]) => y))];
      if (this.plot) { this.plot.setData(frame); return; }
      const palette = colours();
      const stroke = (plot) => {
        const context = plot.ctx;
        context.save();
        context.beginPath();
        context.rect(plot.bbox.left, plot.bbox.top, plot.bbox.width, plot.bbox.height);
        context.clip();
        context.lineWidth = devicePixelRatio;  // a line of one pixel costs a third of one of 1.2 without a graphics card
        this.data.forEach(([x, y], at) => {
          context.strokeStyle = palette[SHADES[at % SHADES.length]];
          context.beginPath();
          for (let row = 0; row < x.length; row += 1) context.lineTo(plot.valToPos(x[row], "x", true), plot.valToPos(y[row], "y", true));
          context.stroke();
        });
        context.restore();
      };
      this.begin({
        legend: { show: false }, cursor: { show: false },
        scales: { x: { time: false, range: (plot) => [plot.data[0][0], plot.data[0][1]] }, y: { range: (plot) => [plot.data[1][0], plot.data[1][1]] } },
        axes: axes("deflection [rad]", "torque [N m]", palette),
        series: [{}, { stroke: "transparent", points: { show: false } }],
        hooks: { draw: [stroke] },
      }, frame);
    }
  }

  const CHANNELS = 4, HEAD = 16;
  // A frame of the server: first row, number of rows, time of the first; then time, command, torque, deflection.
  function unpacked(buffer) {
    const view = new DataView(buffer), count = view.getUint32(4, true), begin = view.getFloat64(8, true);
    const values = new Float32Array(buffer, HEAD, CHANNELS * count);
    return { first: view.getUint32(0, true), begin, count, channels: Array.from({ length: CHANNELS }, (_, at) => values.subarray(at * count, (at + 1) * count)) };
  }
  // The newest rows of a run: one array a channel that is never made anew, its second half moved to its beginning where it is full.
  class Store {
    constructor(rows) { this.rows = rows; this.end = 0; this.channels = Array.from({ length: CHANNELS }, () => new Float64Array(2 * rows)); }
    add(frame) {
      if (this.end + frame.count > 2 * this.rows) {
        const kept = Math.min(this.rows, this.end);
        this.channels.forEach((one) => one.copyWithin(0, this.end - kept, this.end));
        this.end = kept;
      }
      const count = Math.min(frame.count, 2 * this.rows - this.end);
      this.channels.forEach((one, at) => one.set(frame.channels[at].subarray(0, count), this.end));
      for (let row = this.end; row < this.end + count; row += 1) this.channels[0][row] += frame.begin;
      this.end += count;
    }
    newest(rows) { const from = Math.max(0, this.end - rows); return this.channels.map((one) => one.subarray(from, this.end)); }
  }
  return { Time, Loop, Store, unpacked, engineering };
})();
