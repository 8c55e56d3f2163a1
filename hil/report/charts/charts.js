"use strict";
// Replaces the still picture of each figure that has data by a chart: drag to zoom, buttons for the keyboard.
(function () {
  const MISSING = 65535;

  function unpacked(packed) {
    const bytes = Uint8Array.from(atob(packed.data), (one) => one.charCodeAt(0));
    const counts = new DataView(bytes.buffer);
    return Array.from({ length: bytes.length / 2 }, (_, at) => {
      const count = counts.getUint16(2 * at, true);
      return count === MISSING ? null : packed.low + packed.step * count;
    });
  }

  function colours() {
    const style = getComputedStyle(document.documentElement);
    const named = (name) => style.getPropertyValue(name).trim();
    return { ink: named("--ink"), grid: named("--line"), soft: named("--soft"), first: named("--first"), error: named("--error") };
  }

  function options(panel, chart, width, palette, group, isLast) {
    const axis = { stroke: palette.ink, grid: { stroke: palette.grid, width: 1 }, ticks: { stroke: palette.grid } };
    return {
      width: width,
      height: panel.lines.length > 1 ? 300 : 170,
      scales: { x: { time: false } },
      cursor: { sync: { key: group, setSeries: true, scales: ["x", null] }, drag: { x: true, y: false } },
      axes: [isLast ? { ...axis, label: chart.label } : axis, { ...axis, label: panel.label, size: 64 }],
      series: [
        { label: chart.label, value: (_, value) => (value === null ? "" : value.toPrecision(5)) },
        ...panel.lines.map((line) => ({
          label: line.name, stroke: palette[line.colour], width: 1, spanGaps: false,
          value: (_, value) => (value === null ? "" : value.toPrecision(4)),
        })),
      ],
    };
  }

  function build(place) {
    const name = place.dataset.chart;
    const chart = JSON.parse(document.getElementById("chart-" + name).textContent);
    const x = unpacked(chart.x), data = chart.panels.map((panel) => panel.lines.map(unpacked));
    const shown = place.querySelector(".range");
    let made = [];

    function say(low, high) {
      shown.textContent = chart.label + ": " + low.toPrecision(4) + " to " + high.toPrecision(4);
    }

    function draw() {
      const range = made.length ? [made[0].scales.x.min, made[0].scales.x.max] : null;
      made.forEach((one) => one.destroy());
      const palette = colours(), last = chart.panels.length - 1;
      made = chart.panels.map((panel, at) => {
        const setup = options(panel, chart, place.clientWidth, palette, name, at === last);
        if (at === 0) setup.hooks = { setScale: [(one, key) => key === "x" && say(one.scales.x.min, one.scales.x.max)] };
        return new uPlot(setup, [x, ...data[at]], place.querySelector(".panels"));
      });
      if (range) show(range[0], range[1]);
    }

    function show(low, high) {
      const first = x[0], last = x[x.length - 1];
      made.forEach((one) => one.setScale("x", { min: Math.max(low, first), max: Math.min(high, last) }));
    }

    function act(kind) {
      const low = made[0].scales.x.min, high = made[0].scales.x.max, span = high - low;
      const first = x[0], last = x[x.length - 1];
      if (kind === "whole") show(first, last);
      if (kind === "closer") show(low + span / 4, high - span / 4);
      if (kind === "wider") show(low - span / 2, high + span / 2);
      if (kind === "earlier") show(Math.max(low - span / 2, first), Math.max(high - span / 2, first + span));
      if (kind === "later") show(Math.min(low + span / 2, last - span), Math.min(high + span / 2, last));
    }

    place.hidden = false;
    draw();
    place.querySelectorAll("button").forEach((button) => button.addEventListener("click", () => act(button.value)));
    let waiting = 0;
    window.addEventListener("resize", () => { clearTimeout(waiting); waiting = setTimeout(draw, 150); });
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
    place.closest("figure").classList.add("live");
  }

  document.querySelectorAll("[data-chart]").forEach(build);
})();
