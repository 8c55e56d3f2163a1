"use strict";
// The plots of the page: lines over time and loops, drawn by uPlot; and the store of the newest rows of a run.
const Plots = (function () {
  const colours = () => {
    const style = getComputedStyle(document.documentElement);
    return Object.fromEntries(["ink", "line", "soft", "first", "error", "good", "warning"].map((name) => [name, style.getPropertyValue("--" + name).trim()]));
  };
  const digits = (_, splits) => splits.map((one) => (one === null ? "" : String(Number(one.toPrecision(8))).replace("-", "\u2212")));

  // The ends of an axis that show all values with a margin; a NaN, of a lost reply, is left out.
  function ends(arrays, fixed) {
    let low = Infinity, high = -Infinity;
    for (const values of arrays) for (const one of values) { if (one < low) low = one; if (one > high) high = one; }
    if (!(low <= high)) return [-1, 1];
    const margin = high > low ? 0.06 * (high - low) : 0.05 * Math.abs(high) || 1;
    return fixed ? [low, high] : [low - margin, high + margin];
  }

  const axes = (xLabel, yLabel, palette) => [xLabel, yLabel].map((label, at) => ({
    label, labelSize: 20, size: at ? 68 : 34, values: digits, stroke: palette.ink, grid: { stroke: palette.line, width: 1 }, ticks: { stroke: palette.line },
  }));

  // A plot that is made anew where its place has another width, or the colours change.
  class Plot {
    constructor(place, height) {
      this.place = document.getElementById(place);
      this.height = height;
      this.plot = null;
      new ResizeObserver(() => { if (this.plot && this.plot.width !== this.width) this.remake(); }).observe(this.place);
      matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.remake());
    }
    get width() { return Math.max(200, Math.floor(this.place.clientWidth)); }
    remake() {
      if (this.plot) this.plot.destroy();
      this.plot = null;
      this.draw();
    }
    clear() {
      if (this.plot) this.plot.destroy();
      this.plot = this.data = null;
    }
  }

  // Lines over time. names: of the lines; selected: called with the window that is dragged over.
  class Time extends Plot {
    constructor(place, yLabel, names, selected) {
      super(place, 230);
      Object.assign(this, { yLabel, names, selected, data: null });
    }
    show(data, names) {
      if (names && String(names) !== String(this.names)) { this.names = names; this.clear(); }
      this.data = data;
      this.draw();
    }
    draw() {
      if (!this.data || !this.width || this.place.offsetParent === null) return;
      if (this.plot) { this.plot.setData(this.data); return; }
      const palette = colours(), shades = ["first", "error", "good", "warning", "soft"];
      const hooks = this.selected ? { setSelect: [(plot) => plot.select.width > 3 && this.selected(plot.posToVal(plot.select.left, "x"), plot.posToVal(plot.select.left + plot.select.width, "x"))] } : {};
      this.plot = new uPlot({
        width: this.width, height: this.height, hooks,
        scales: { x: { time: false, range: (plot) => ends([plot.data[0]], true) }, y: { range: (plot) => ends(plot.data.slice(1)) } },
        legend: { show: this.names.length > 1, live: false },
        cursor: { show: Boolean(this.selected), drag: { x: Boolean(this.selected), y: false, setScale: false } },
        axes: axes("time [s]", this.yLabel, palette),
        series: [{}, ...this.names.map((label, at) => ({ label, stroke: palette[shades[at % shades.length]], width: 1, points: { show: false } }))],
      }, this.data, this.place);
    }
  }

  // Torque over deflection: each loop a line through samples that follow each other.
  class Loop extends Plot {
    constructor(place) { super(place, 320); this.data = null; }
    show(loops) { this.data = loops; this.draw(); }
    draw() {
      if (!this.data || this.place.offsetParent === null) return;
      const frame = [ends(this.data.map(([x]) => x)), ends(this.data.map(([, y]) => y))];
      if (this.plot) { this.plot.setData(frame); return; }
      const palette = colours(), shades = ["first", "error", "good", "warning", "soft"];
      const stroke = (plot) => {
        const context = plot.ctx;
        context.save();
        context.beginPath();
        context.rect(plot.bbox.left, plot.bbox.top, plot.bbox.width, plot.bbox.height);
        context.clip();
        context.lineWidth = devicePixelRatio;  // a line of one pixel costs a third of one of 1.2 without a graphics card
        this.data.forEach(([x, y], at) => {
          context.strokeStyle = palette[shades[at % shades.length]];
          context.beginPath();
          for (let row = 0; row < x.length; row += 1) context.lineTo(plot.valToPos(x[row], "x", true), plot.valToPos(y[row], "y", true));
          context.stroke();
        });
        context.restore();
      };
      this.plot = new uPlot({
        width: this.width, height: this.height, legend: { show: false }, cursor: { show: false },
        scales: { x: { time: false, range: (plot) => [plot.data[0][0], plot.data[0][1]] }, y: { range: (plot) => [plot.data[1][0], plot.data[1][1]] } },
        axes: axes("deflection [rad]", "torque [N m]", palette),
        series: [{}, { stroke: "transparent", points: { show: false } }],
        hooks: { draw: [stroke] },
      }, frame, this.place);
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

  return { Time, Loop, Store, unpacked };
})();
