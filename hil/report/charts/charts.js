"use strict";
// Draws the charts of a page with uPlot: drag to zoom, double click for all of it, buttons for the keyboard.
(function () {
  const MISSING = 65535, NARROW = 560, SCALES = { linear: 1, log: 3, symlog: 4 };
  const known = (values) => values.filter((one) => one !== null && Number.isFinite(one));

  function unpacked(packed) {
    if (Array.isArray(packed)) return packed;
    const bytes = Uint8Array.from(atob(packed.data), (one) => one.charCodeAt(0));
    const counts = new DataView(bytes.buffer);
    return Array.from({ length: bytes.length / 2 }, (_, at) => {
      const count = counts.getUint16(2 * at, true);
      if (count === MISSING) return null;
      const value = packed.low + packed.step * count;
      return packed.logarithm ? 10 ** value : value;
    });
  }

  function colours() {
    const style = getComputedStyle(document.documentElement);
    const names = { ink: "--ink", grid: "--line", soft: "--pale", first: "--first", error: "--error", good: "--good" };
    return Object.fromEntries(Object.entries(names).map(([name, variable]) => [name, style.getPropertyValue(variable).trim()]));
  }

  function shade(value, limit, low, high, twoSided) {
    if (value === null) return "transparent";
    if (!twoSided) return `hsl(212 70% ${25 + 65 * (high > low ? (value - low) / (high - low) : 0)}%)`;
    const size = limit > 0 ? Math.abs(value) / limit : 0;
    return `hsl(${value < 0 ? 5 : 212} 75% ${95 - 50 * size}%)`;
  }

  function extent(some) {
    let low = Infinity, high = -Infinity;
    for (const one of some) { low = Math.min(low, one); high = Math.max(high, one); }
    return [low, high];
  }

  // What a legend tells of a line: its value under the cursor; without a cursor its range.
  function tell(plot, value, line, index) {
    if (index === null || index === undefined) return extent(known(plot.data[line])).map((one) => one.toPrecision(4)).join(" to ");
    return value === null || value === undefined ? "none" : value.toPrecision(5);
  }

  // The ends of an axis [low, high] that show all of a panel, with a margin; of a logarithmic axis in decades.
  function ends(values, scale) {
    const some = known(values).filter((one) => scale !== "log" || one > 0);
    if (!some.length) return [0, 1];
    const [low, high] = extent(some);
    if (scale === "log") return [low / 1.3, high * 1.3];
    const margin = high > low ? 0.05 * (high - low) : 0.05 * Math.abs(high) || 1;
    return [low - margin, high + margin];
  }

  function clipped(plot, draw) {
    const context = plot.ctx;
    context.save();
    context.beginPath();
    context.rect(plot.bbox.left, plot.bbox.top, plot.bbox.width, plot.bbox.height);
    context.clip();
    draw(context, (x) => plot.valToPos(x, "x", true), (y) => plot.valToPos(y, "y", true));
    context.restore();
  }

  function drawBelow(panel, palette) {
    return (plot) => clipped(plot, (context, atX, atY) => {
      if (panel.heat) {
        const [left, right, bottom, top] = panel.heat.extent, rows = panel.heat.rows;
        const all = known(rows.flat()), limit = Math.max(...all.map(Math.abs)), low = Math.min(...all), high = Math.max(...all);
        const width = (right - left) / rows[0].length, height = (top - bottom) / rows.length;
        rows.forEach((row, i) => row.forEach((value, j) => {
          const x = atX(left + j * width), y = atY(bottom + (i + 1) * height);
          context.fillStyle = shade(value, limit, low, high, panel.heat.twoSided);
          context.fillRect(x, y, atX(left + (j + 1) * width) - x + 1, atY(bottom + i * height) - y + 1);
        }));
      }
      context.fillStyle = palette.soft;
      context.globalAlpha = 0.25;
      panel.bands.forEach((band) => context.fillRect(plot.bbox.left, atY(band.high), plot.bbox.width, atY(band.low) - atY(band.high)));
    });
  }

  function drawLine(line, x, y, palette, ratio) {
    return (context, atX, atY) => {
      context.strokeStyle = context.fillStyle = palette[line.colour];
      context.lineWidth = line.width * ratio;
      if (line.dashed) context.setLineDash([6 * ratio, 4 * ratio]);
      const isThere = (at) => x[at] !== null && y[at] !== null;
      if (line.ends) x.forEach((place, at) => {
        if (place === null || line.ends[0][at] === null || line.ends[1][at] === null) return;
        context.beginPath();
        context.moveTo(atX(place), atY(line.ends[0][at]));
        context.lineTo(atX(place), atY(line.ends[1][at]));
        context.stroke();
      });
      if (line.mark) x.forEach((place, at) => {
        if (!isThere(at)) return;
        context.beginPath();
        context.arc(atX(place), atY(y[at]), 3.5 * ratio, 0, 2 * Math.PI);
        if (line.mark === "dot") context.fill(); else context.stroke();
      });
      if (line.mark) return;
      context.beginPath();
      x.forEach((place, at) => {
        if (!isThere(at)) return;
        if (at > 0 && isThere(at - 1)) context.lineTo(atX(place), atY(y[at])); else context.moveTo(atX(place), atY(y[at]));
      });
      context.stroke();
    };
  }

  function axes(panel, palette) {
    const axis = { stroke: palette.ink, grid: { stroke: palette.grid, width: 1 }, ticks: { stroke: palette.grid } };
    const named = panel.names.length && {
      splits: () => panel.names.map((_, at) => at), values: () => panel.names, rotate: -35, size: 30 + 5 * Math.max(...panel.names.map((one) => one.length)),
    };
    const digits = (_, splits) => splits.map((one) => (one === null ? "" : String(Number(one.toPrecision(8))).replace("-", "\u2212")));
    return [
      { ...axis, label: panel.xLabel || undefined, labelSize: 22, size: 36, values: digits, ...(named || {}) },
      { ...axis, label: panel.label, size: 68, values: digits },
    ];
  }

  // uPlot's own lines where all share one increasing x: they tell the values under the cursor. Everything else is drawn here.
  function options(chart, panel, arrays, width, palette, group) {
    const lines = panel.lines.map((line) => [line, arrays[line.x], arrays[line.y]]);
    const [left, right, bottom, top] = panel.heat ? panel.heat.extent : [];
    const xs = panel.heat ? [left, right] : lines.flatMap(([, x]) => x);
    const ys = [
      ...lines.flatMap(([line, , y]) => [...y, ...(line.ends ? line.ends.flat() : [])]), ...panel.bands.flatMap((band) => [band.low, band.high]),
    ];
    const wide = panel.heat ? [left, right] : panel.names.length ? [-0.5, panel.names.length - 0.5] : ends(xs, panel.xScale);
    const tall = panel.heat ? [bottom, top] : ends(ys, panel.scale);
    const series = panel.shared
      ? panel.lines.map((line) => ({ label: line.name || panel.label, stroke: palette[line.colour], width: line.width, dash: line.dashed ? [6, 4] : undefined, value: tell, points: { show: false } }))
      : [{ show: true, stroke: "transparent", points: { show: false } }];
    const setup = {
      width: width, height: chart.columns === 1 && panel.shared && panel.lines.length === 1 ? 220 : 300, title: panel.title || undefined,
      scales: { x: { time: false, distr: SCALES[panel.xScale] }, y: { distr: SCALES[panel.scale], ...(panel.shared ? {} : { range: () => tall }) } },
      legend: { show: panel.shared && chart.columns === 1 },
      cursor: { sync: chart.common ? { key: group, setSeries: true, scales: ["x", null] } : undefined, drag: panel.shared ? { x: true, y: false } : { x: true, y: true, uni: 20 } },
      axes: axes(panel, palette),
      series: [{ label: panel.xLabel, value: tell }, ...series],
      hooks: { drawClear: [drawBelow(panel, palette)], draw: [] },
    };
    if (!panel.shared) setup.hooks.draw.push((plot) => lines.forEach(([line, x, y]) => clipped(plot, drawLine(line, x, y, palette, devicePixelRatio))));
    const data = panel.shared ? [lines[0][1], ...lines.map(([, , y]) => y)] : [wide, tall];
    return { setup, data, wide: panel.shared ? [lines[0][1][0], lines[0][1][lines[0][1].length - 1]] : wide };
  }

  function shades(heat) {
    const all = known(heat.rows.flat()), low = Math.min(...all).toPrecision(3), high = Math.max(...all).toPrecision(3);
    return heat.label + (heat.twoSided ? `: red ${low}, white 0, blue ${high}` : `: dark ${low}, light ${high}`);
  }

  function names(panel, palette) {
    const shown = document.createElement("p");
    shown.className = "names";
    const entries = [...panel.lines.filter((line) => line.name).map((line) => [line.name, palette[line.colour]]), ...panel.bands.filter((band) => band.name).map((band) => [band.name, palette.grid])];
    if (panel.heat) entries.push([shades(panel.heat), "transparent"]);
    entries.forEach(([text, colour]) => {
      const one = document.createElement("span"), sign = document.createElement("i");
      sign.style.background = colour;
      one.append(sign, text);
      shown.append(one);
    });
    return entries.length ? shown : null;
  }

  function build(place) {
    const name = place.dataset.chart;
    const chart = JSON.parse(document.getElementById("chart-" + name).textContent);
    const arrays = chart.arrays.map(unpacked), shown = place.querySelector(".range"), below = place.querySelector(".panels");
    let made = [];

    function draw() {
      const ranges = made.map((one) => [one.plot.scales.x.min, one.plot.scales.x.max]);
      made.forEach((one) => one.plot.destroy());
      below.replaceChildren();
      const palette = colours(), columns = place.clientWidth < NARROW ? 1 : chart.columns;
      made = chart.panels.map((panel) => {
        const cell = document.createElement("div"), width = Math.floor(place.clientWidth / columns) - 4;
                cell.style.width = width + "px";
        below.append(cell);
        const { setup, data, wide } = options(chart, panel, arrays, width, palette, name);
        const plot = new uPlot(setup, data, cell), named = setup.legend.show ? null : names(panel, palette);
        if (named) cell.append(named);
        return { plot, wide };
      });
      if (made.length) made[0].plot.hooks.setScale = [(one, key) => key === "x" && say(one)];
      ranges.forEach(([low, high], at) => made[at] && made[at].plot.setScale("x", { min: low, max: high }));
      if (made.length && !ranges.length) say(made[0].plot);
    }

    function say(plot) {
      const { min, max } = plot.scales.x, label = chart.panels[0].xLabel;
      if (label && Number.isFinite(min) && Number.isFinite(max)) shown.textContent = label + ": " + min.toPrecision(4) + " to " + max.toPrecision(4);
    }

    function act(kind) {
      made.forEach(({ plot, wide: [first, last] }) => {
        const low = plot.scales.x.min, high = plot.scales.x.max, span = high - low;
        const to = { whole: [first, last], closer: [low + span / 4, high - span / 4], wider: [low - span / 2, high + span / 2], earlier: [low - span / 2, high - span / 2], later: [low + span / 2, high + span / 2] }[kind];
        let [left, right] = to;
        if (kind === "earlier" && left < first) [left, right] = [first, first + span];
        if (kind === "later" && right > last) [left, right] = [last - span, last];
        plot.setScale("x", { min: Math.max(left, first), max: Math.min(right, last) });
        if (kind === "whole" && !chart.panels[made.findIndex((one) => one.plot === plot)].shared) plot.setData(plot.data);
      });
    }

    draw();
    place.querySelectorAll("button").forEach((button) => button.addEventListener("click", () => act(button.value)));
    let waiting = 0;
    window.addEventListener("resize", () => { clearTimeout(waiting); waiting = setTimeout(draw, 150); });
    ["(prefers-color-scheme: dark)", "print"].forEach((query) => matchMedia(query).addEventListener("change", draw));
  }

  function open(place) {
    if (!place.dataset.built) { place.dataset.built = "yes"; build(place); }
  }

  document.querySelectorAll("[data-chart]").forEach((place) => {
    const folded = place.closest("details");
    if (!folded) open(place); else folded.addEventListener("toggle", () => folded.open && open(place));
  });
  // a link to a folded part, and printing, unfold it
  function unfold() { const part = location.hash && document.getElementById(location.hash.slice(1)); if (part instanceof HTMLDetailsElement) part.open = true; }
  window.addEventListener("hashchange", unfold);
  unfold();
  window.addEventListener("beforeprint", () => document.querySelectorAll("details").forEach((one) => { one.open = true; one.querySelectorAll("[data-chart]").forEach(open); }));
})();
