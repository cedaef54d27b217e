"use strict";
// Draws the charts of a page by uPlot, each when it is scrolled to, and all before printing.
(() => {
  const { columns, charts: held } = JSON.parse(document.getElementById("chart-data").textContent);
  const HIGH = 200, SOME = 300;  // Pixels: height, and width where none is known.
  const paper = (div) => div.closest(".joint") ? 215 : 330;  // Three abreast on a page, or two.
  const kept = [];
  // A column: 16 bits between its ends, the last number stands for what is missing.
  function column(k) {
    if (!kept[k]) {
      const { low: [low], high: [high], data } = columns[k];
      const bytes = Uint8Array.from(atob(data), (c) => c.charCodeAt(0)).buffer;
      kept[k] = Array.from(new Uint16Array(bytes), (s) => s === 65535 ? null : low + (high - low) * s / 65534);
    }
    return kept[k];
  }
  const powers = (values) => values.map((v) => v === null ? null : 10 ** v);
  const root = document.documentElement;
  const color = (name) => getComputedStyle(root).getPropertyValue(`--chart-${name}`).trim();
  const told = (v) => v === null || v === undefined ? "–" : v === 0 ? "0" : String(+v.toPrecision(4)).replace("-", "−");
  const places = [...document.querySelectorAll("[data-chart]")];
  const looks = new Map(places.map((div) => [div, JSON.parse(div.dataset.look)]));
  const drawn = new Map();
  let zoom = null;  // Of all charts over time.

  function options(chart, look, wide) {
    const { logarithmic = "" } = look, [logX, logY] = [logarithmic.includes("x"), logarithmic.includes("y")];
    const named = (name) => logY ? powers(column(chart[name])) : column(chart[name]);
    const x = logX ? powers(column(chart.x)) : column(chart.x);
    const curves = [], series = [{ label: look.x, value: (u, v) => told(v) }], bands = [];
    const marks = [["", ""]];  // Border and ground of the legend's.
    const add = (values, own, ground, one) => {
      curves.push(values);
      marks.push([`var(--chart-${own})`, ground ? `var(--chart-${own})` : "transparent"]);
      return series.push(one) - 1;
    };
    const points = { show: false }, spanGaps = Boolean(look.dots);
    if (look.dots) {
      add(null, "blue", true, { label: "measured", stroke: () => color("blue"), paths: () => null, value: (u, v) => told(v),
        points: { show: true, size: 3, width: 0, fill: () => color("blue") + "90" } });
    }
    // A band ends at two columns, or so far from one, or from zero.
    const { name: band, color: own, about, half, ends = ["low", "high"] } = look.band || {};
    if (band && (half || ends[0]) in chart) {
      const h = half && column(chart[half]), middle = about ? column(chart[about]) : null;
      const end = (side) => half ? h.map((v, k) => v === null ? null : (middle ? middle[k] : 0) + (2 * side - 1) * v) :
        column(chart[ends[side]]);
      const shown = { points, spanGaps, stroke: "transparent", width: 0 };
      const low = add(end(0), own, true, { ...shown, class: "hidden" });
      const high = add(end(1), own, true, { ...shown, label: band,
        value: (u, v, s, k) => k === null || k === undefined ? "–" : `${told(u.data[low][k])} … ${told(v)}` });
      bands.push({ series: [high, low], fill: () => color(own) + "40" });
    }
    for (const [name, own, kind] of look.lines) {
      if (!(name in chart)) continue;
      add(named(name), own, false, { label: name, stroke: () => color(own), width: kind === "wide" ? 1.6 : 1, spanGaps,
        dash: kind === "dashed" ? [5, 3] : undefined, points: kind === "points" ? { show: true, size: 4 } : points,
        value: (u, v) => told(v) });
    }
    // Dots have their own places; lines run through between theirs.
    const data = look.dots ? uPlot.join([look.dots.map(named), [x, ...curves.slice(1)]]) : [x, ...curves];
    const axis = { stroke: () => color("ink"), font: "11px system-ui, sans-serif", labelFont: "11px system-ui, sans-serif",
      grid: { stroke: () => color("grid"), width: 1 }, ticks: { show: false } };
    const short = (u, every) => every.map((v) => v === null ? "" : v !== 0 && (Math.abs(v) < 1e-3 || Math.abs(v) >= 1e5) ?
      v.toExponential().replace("e+", "e") : String(+v.toPrecision(10)));
    const y = { ...(chart.range ? { range: chart.range } : {}), ...(logY ? { distr: 3 } : {}),
      ...(chart.linear_to ? { distr: 4, asinh: chart.linear_to } : {}) };
    return [{ width: wide, height: HIGH, series, bands,
      scales: { x: { time: false, ...(logX ? { distr: 3 } : {}) }, y },
      axes: [{ ...axis, label: look.x, labelSize: 16, size: 24, gap: 3, ...(logX ? { values: short } : {}) },
        { ...axis, size: 46, gap: 3, values: short }],
      legend: { markers: { width: 2, stroke: (u, k) => marks[k][0], fill: (u, k) => marks[k][1] } },
      cursor: { y: false, points: { size: 6 }, drag: { x: true, y: false },
        sync: look.linked ? { key: "time", scales: ["x", null], filters: { pub: (type) => type === "mousemove" || type === "mouseleave" } } : {} },
      hooks: {
        drawAxes: [(u) => shade(u, chart.shaded, logarithmic)],
        setCursor: look.linked ? [instant] : [],
        setScale: look.linked ? [(u, key) => { if (key === "x") together(u); }] : [],
        ready: [pinch],
      } }, data];
  }

  // Stretches that are shaded, and the line at zero.
  function shade(u, shaded, logarithmic) {
    const { ctx, bbox: box } = u, inside = (v, low, size) => Math.min(Math.max(v, low), low + size);
    ctx.save();
    ctx.globalAlpha = 0.5;
    ctx.fillStyle = color("shade");
    for (const [low, high] of shaded) {
      const [a, b] = [low, high].map((v) => inside(u.valToPos(v, "x", true), box.left, box.width));
      if (b > a) ctx.fillRect(a, box.top, b - a, box.height);
    }
    const zero = logarithmic ? NaN : u.valToPos(0, "y", true);
    if (zero > box.top && zero < box.top + box.height) {
      ctx.globalAlpha = 1;
      ctx.fillStyle = color("gray");
      ctx.fillRect(box.left, zero, box.width, 1);
    }
    ctx.restore();
  }

  // What else the page shows may follow the cursor.
  function instant(u) {
    const detail = u.cursor.left >= 0 ? u.posToVal(u.cursor.left, "x") : null;
    dispatchEvent(new CustomEvent("chart-time", { detail }));
  }

  // One zoom for all charts over time.
  function together(u) {
    const { min, max } = u.scales.x;
    if (zoom && zoom.min === min && zoom.max === max) return;
    if (min === null || max === null || !drawn.size) return;
    zoom = { min, max };
    for (const [div, other] of drawn) {
      if (other !== u && looks.get(div).linked) other.setScale("x", zoom);
    }
  }

  // Two fingers zoom; a double tap shows the whole again.
  function pinch(u) {
    let held = null;
    const fingers = (e) => [...e.touches].map((t) => t.clientX - u.over.getBoundingClientRect().left);
    u.over.addEventListener("touchstart", (e) => {
      if (e.touches.length !== 2) return;
      e.preventDefault();
      held = fingers(e).map((place) => u.posToVal(place, "x"));
    }, { passive: false });
    u.over.addEventListener("touchmove", (e) => {
      if (!held || e.touches.length !== 2) return;
      e.preventDefault();
      const [a, b] = fingers(e), x = u.data[0], slope = (held[1] - held[0]) / (b - a);
      const min = Math.max(held[0] - slope * a, x[0]), max = Math.min(held[0] + slope * (u.over.clientWidth - a), x[x.length - 1]);
      if (max > min) u.setScale("x", { min, max });
    }, { passive: false });
    u.over.addEventListener("touchend", () => { held = null; });
  }

  function draw(div, wide = div.clientWidth) {
    const look = looks.get(div), old = drawn.get(div);
    if (old) old.destroy();
    drawn.delete(div);
    const [made, data] = options(held[div.dataset.chart], look, wide || SOME);
    const u = new uPlot(made, data, div);
    if (look.linked && zoom) u.setScale("x", zoom);
    drawn.set(div, u);
    return u;
  }

  const seen = new IntersectionObserver((entries) => {
    for (const { isIntersecting, target } of entries) {
      if (isIntersecting && !drawn.has(target)) draw(target);
    }
  }, { rootMargin: "300px" });
  const sized = new ResizeObserver((entries) => {
    if (root.classList.contains("on-paper")) return;
    for (const { target } of entries) {
      const u = drawn.get(target);
      if (u && target.clientWidth && u.width !== target.clientWidth) u.setSize({ width: target.clientWidth, height: HIGH });
    }
  });
  for (const div of places) { seen.observe(div); sized.observe(div); }
  const again = () => { for (const div of [...drawn.keys()]) draw(div); };
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", again);
  addEventListener("beforeprint", () => {
    root.classList.add("on-paper");
    for (const div of places) draw(div, paper(div));
  });
  addEventListener("afterprint", () => { root.classList.remove("on-paper"); again(); });
})();
