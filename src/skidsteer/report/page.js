"use strict";
(() => {
  const byId = (id) => document.getElementById(id);
  const page = JSON.parse(byId("data").textContent);
  const root = document.documentElement;
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const coarse = matchMedia("(pointer: coarse)").matches;
  let printing = false;

  // Theme

  const isDark = () => (root.dataset.theme ? root.dataset.theme === "dark" : dark.matches);
  const colour = (name) => getComputedStyle(root).getPropertyValue(`--${name}`).trim();
  const SEQUENTIAL = {
    light: [[0, "#d3e3ee"], [0.25, "#8fb9d8"], [0.5, "#3f88bf"], [0.75, "#0c5590"], [1, "#06264a"]],
    dark: [[0, "#26384a"], [0.25, "#2f6a9c"], [0.5, "#4f9fd6"], [0.75, "#9ccdf0"], [1, "#f3f9fd"]],
  };
  const DIVERGING = {
    light: [[0, "#b84a00"], [0.5, "#f4f5f6"], [1, "#0063a5"]],
    dark: [[0, "#c2622a"], [0.5, "#22272c"], [1, "#2f7dbd"]],
  };
  const scale = (scales) => scales[isDark() ? "dark" : "light"];

  function themed(value) {
    if (typeof value === "string" && value[0] === "$") {
      if (value === "$sequential") return scale(SEQUENTIAL);
      if (value === "$diverging") return scale(DIVERGING);
      return colour(value.slice(1));
    }
    if (Array.isArray(value)) return value.length && typeof value[0] === "number" ? value : value.map(themed);
    if (value && typeof value === "object") return Object.fromEntries(Object.entries(value).map(([k, v]) => [k, themed(v)]));
    return value;
  }

  function layout(own) {
    const narrow = innerWidth < 760;
    const axis = { gridcolor: "$grid", linecolor: "$line", zerolinecolor: "$grid", tickcolor: "$line", automargin: true, ticks: "" };
    const base = {
      paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)",
      font: { family: getComputedStyle(document.body).fontFamily, size: narrow ? 12 : 13, color: "$ink" },
      margin: { l: 8, r: 8, t: 10, b: 8 }, dragmode: coarse ? false : "zoom", hovermode: "closest",
      hoverlabel: { bgcolor: "$card", bordercolor: "$line", font: { color: "$ink" } },
    };
    const merged = { ...base, ...own };
    for (const name of ["xaxis", "yaxis"]) {
      merged[name] = { ...axis, ...own[name] };
      if (own[name]?.title) merged[name].title = { standoff: 8, ...own[name].title, font: { color: "$muted", size: base.font.size } };
    }
    merged.legend = { bgcolor: "rgba(0,0,0,0)", ...own.legend };
    return themed(merged);
  }

  // On paper the width is that of the paper, not of the window.
  const PAPER = 670;
  const onPaper = (place) => {
    if (!printing) return {};
    const half = place.closest(".pair")?.children.length > 1;
    return { autosize: false, width: half ? PAPER / 2 - 12 : PAPER, height: place.clientHeight };
  };
  const CONFIG = { displayModeBar: false, responsive: true, displaylogo: false };
  const tooSmall = (name, data) => innerWidth < 760 && name === "correlation" && data[0].x.length > 6;
  const fitting = (name, data) => (tooSmall(name, data) ? [{ ...data[0], texttemplate: "" }] : data);
  const draw = (id, data, own) => Plotly.react(byId(id), themed(data), { ...layout(own), ...onPaper(byId(id)) }, CONFIG);

  function drawAll() {
    for (const [name, chart] of Object.entries(page.charts)) draw(`chart-${name}`, fitting(name, chart.data), chart.layout);
    if (page.tracks.length) showTrack();
    const button = byId("theme");
    button.textContent = isDark() ? "Light" : "Dark";
  }

  // Dead reckoning: poses are [x, y, yaw], each an array over time

  const STYLE = {
    reference: { name: "reference", dash: "solid", width: 1.6 },
    nominal: { name: "nominal", dash: "dot", width: 1.8 },
    shipped: { name: "as shipped", dash: "dash", width: 1.8 },
    calibrated: { name: "calibrated", dash: "solid", width: 2.2 },
  };
  const at = (poses, i) => [poses[0][i], poses[1][i], poses[2][i]];
  const compose = (a, b) => {
    const c = Math.cos(a[2]), s = Math.sin(a[2]);
    return [a[0] + c * b[0] - s * b[1], a[1] + s * b[0] + c * b[1], a[2] + b[2]];
  };
  const invert = (a) => {
    const c = Math.cos(a[2]), s = Math.sin(a[2]);
    return [-c * a[0] - s * a[1], s * a[0] - c * a[1], -a[2]];
  };
  const wrapped = (angle) => Math.atan2(Math.sin(angle), Math.cos(angle));

  // First and last index of the stretches of a track that begin anew every so many seconds; 0: with each piece only.
  function stretches(track, every) {
    const out = [];
    let first = 0;
    for (let i = 1; i <= track.t.length; i++) {
      const ends = i === track.t.length || track.piece[i] !== track.piece[first];
      if (ends) {
        out.push([first, i - 1]);
        first = i;
      } else if (every > 0 && track.t[i] - track.t[first] >= every - 1e-6) {
        out.push([first, i]);
        first = i;
      }
    }
    return out.filter(([a, b]) => b > a);
  }

  // The motion that brings a stretch of dead reckoning to where the reference begins; without headings, to where it fits.
  function placing(track, poses, a, b) {
    const reference = track.poses.reference;
    if (track.sees === "pose") return compose(at(reference, a), invert(at(poses, a)));
    let n = 0, mx = 0, my = 0, ux = 0, uy = 0;
    for (let i = a; i <= b; i++) { n++; mx += poses[0][i]; my += poses[1][i]; ux += reference[0][i]; uy += reference[1][i]; }
    mx /= n; my /= n; ux /= n; uy /= n;
    let along = 0, across = 0;
    for (let i = a; i <= b; i++) {
      const x = poses[0][i] - mx, y = poses[1][i] - my, u = reference[0][i] - ux, v = reference[1][i] - uy;
      along += x * u + y * v; across += x * v - y * u;
    }
    const yaw = Math.atan2(across, along), c = Math.cos(yaw), s = Math.sin(yaw);
    return [ux - c * mx + s * my, uy - s * mx - c * my, yaw];
  }

  const LONG = 2400; // poses in one stretch
  const state = { drive: 0, every: 0, share: 1 };

  const isWindows = (track) => new Set(track.piece).size > 20;

  // The moment of the slider: a time of the drive; of a drive in windows, the end of one of them.
  function moment(track, parts) {
    if (isWindows(track)) return parts[Math.min(Math.floor(state.share * parts.length), parts.length - 1)][1];
    const wanted = track.t[0] + state.share * (track.t[track.t.length - 1] - track.t[0]);
    let low = 0, high = track.t.length - 1;
    while (low < high) { const middle = (low + high + 1) >> 1; if (track.t[middle] <= wanted + 1e-9) low = middle; else high = middle - 1; }
    return low;
  }

  function showTrack() {
    const track = page.tracks[state.drive], parts = stretches(track, state.every), now = moment(track, parts);
    const windows = isWindows(track);
    let current = parts.findIndex(([a, b]) => a <= now && now <= b);
    if (current < 0) current = 0;
    const models = Object.keys(track.poses).filter((name) => name !== "reference");
    const home = windows ? invert(at(track.poses.reference, parts[current][0])) : [0, 0, 0];
    const traces = [], readings = [];

    const line = (name, points, faint, legend) => {
      const style = STYLE[name];
      traces.push({
        type: "scatter", mode: "lines", name: style.name, legendgroup: name, showlegend: legend, x: points.map((p) => p[0]), y: points.map((p) => p[1]),
        line: { color: `$${name}`, dash: faint ? "solid" : style.dash, width: faint ? 1 : style.width + 1.2 }, opacity: faint ? (name === "reference" ? 0.5 : 0.35) : 1, hoverinfo: "skip",
      });
    };
    const gap = [null, null, null];
    const references = [];
    for (const [a, b] of windows ? parts : stretches(track, 0)) {
      const from = windows ? invert(at(track.poses.reference, a)) : [0, 0, 0];
      for (let i = a; i <= b; i++) references.push(compose(from, at(track.poses.reference, i)));
      references.push(gap);
    }
    if (!windows) for (const name of models) {
      const points = [];
      for (const [a, b] of parts) {
        const move = placing(track, track.poses[name], a, b);
        for (let i = a; i <= b; i++) points.push(compose(move, at(track.poses[name], i)));
        points.push(gap);
      }
      line(name, points, true, false);
    }
    line("reference", references, true, false);
    const [first, last] = parts[current], end = Math.min(now, last);
    const tail = last - first > LONG ? Math.max(first, end - LONG / 4) : first; // of a long drive the last part stands out
    const heads = { x: [], y: [], angle: [], color: [] };
    const truth = compose(home, at(track.poses.reference, end));
    for (const name of [...models, "reference"]) {
      const move = name === "reference" ? [0, 0, 0] : placing(track, track.poses[name], first, last);
      const points = [];
      for (let i = tail; i <= end; i++) points.push(compose(home, compose(move, at(track.poses[name], i))));
      line(name, points, false, true);
      const pose = points[points.length - 1];
      heads.x.push(pose[0]); heads.y.push(pose[1]); heads.color.push(`$${name}`); heads.angle.push(90 - (pose[2] * 180) / Math.PI);
      if (name !== "reference") {
        const off = Math.hypot(pose[0] - truth[0], pose[1] - truth[1]);
        const turned = track.sees === "pose" ? `, ${Math.abs(wrapped(pose[2] - truth[2]) * 180 / Math.PI).toFixed(1)}°` : "";
        readings.push([name, `${STYLE[name].name}: ${off.toFixed(off < 1 ? 3 : 2)} m${turned} off`]);
      }
    }
    traces.push({
      type: "scatter", mode: "markers", x: heads.x, y: heads.y, showlegend: false, hoverinfo: "skip",
      marker: { symbol: track.sees === "pose" ? "arrow" : "circle", size: track.sees === "pose" ? 19 : 9, angle: heads.angle, color: heads.color, line: { color: "$paper", width: 1 } },
    });
    fitHeight(traces, `${state.drive} ${state.every}`);
    draw("chart-track", traces, {
      xaxis: { title: { text: "x [m]" }, scaleanchor: "y" }, yaxis: { title: { text: "y [m]" } },
      legend: { orientation: "h", y: 1.02, yanchor: "bottom", x: 0, traceorder: "reversed" }, uirevision: `${state.drive} ${state.every} ${windows ? current : 0}`,
    });
    const since = track.t[end] - track.t[first];
    const time = `t = ${(track.begin + track.t[end]).toFixed(1)} s`;
    byId("clock").textContent = windows ? `window ${current + 1} of ${parts.length}` : time;
    byId("readout").replaceChildren(...[["", `${windows ? `${time}, ` : ""}${since.toFixed(1)} s after the start of the stretch`], ...readings].map(([name, text]) => {
      const span = document.createElement("span");
      span.className = name ? `is-${name}` : "";
      span.textContent = text;
      return span;
    }));
  }

  // As high as equal scales need, within what the page has room for.
  let fitted = "";
  function fitHeight(traces, of) {
    const place = byId("chart-track"), wide = printing ? PAPER : place.clientWidth, key = `${of} ${wide}`;
    if (key === fitted) return;
    fitted = key;
    const extent = (axis) => {
      let low = Infinity, high = -Infinity;
      for (const trace of traces) for (const v of trace[axis]) if (v !== null) { low = Math.min(low, v); high = Math.max(high, v); }
      return Math.max(high - low, 1e-3);
    };
    const most = Math.min(0.7 * innerHeight, 640), wanted = 120 + (1.1 * wide * extent("y")) / extent("x");
    place.style.height = `${Math.round(Math.max(Math.min(wanted, most), 280))}px`;
  }

  // Beginnings anew that are shorter than what lies between shown poses, or longer than every piece, make no sense.
  function offer(track) {
    const gaps = [], lengths = stretches(track, 0).map(([a, b]) => track.t[b] - track.t[a]);
    for (let i = 1; i < track.t.length; i++) if (track.piece[i] === track.piece[i - 1]) gaps.push(track.t[i] - track.t[i - 1]);
    gaps.sort((a, b) => a - b);
    const usual = gaps[Math.floor(0.9 * gaps.length)] || 0, longest = Math.max(...lengths);
    for (const input of document.querySelectorAll("#restart input")) {
      const every = Number(input.value);
      input.disabled = every > 0 && (every < 2 * usual || every >= longest);
      if (every === 0) input.nextElementSibling.textContent = isWindows(track) ? "each window" : "whole drive";
    }
    if (document.querySelector("#restart input:checked").disabled) {
      document.querySelector('#restart input[value="0"]').checked = true;
      state.every = 0;
    }
  }

  function control() {
    const slider = byId("time");
    let waiting = false;
    slider.addEventListener("input", () => {
      state.share = slider.value / slider.max;
      if (waiting) return;
      waiting = true;
      requestAnimationFrame(() => { waiting = false; showTrack(); });
    });
    for (const input of document.querySelectorAll("#restart input")) input.addEventListener("change", () => {
      state.every = Number(input.value);
      showTrack();
    });
    byId("drive")?.addEventListener("change", (event) => {
      state.drive = Number(event.target.value);
      offer(page.tracks[state.drive]);
      showTrack();
    });
    offer(page.tracks[0]);
  }

  // Copying

  async function copy(text) {
    try {
      await navigator.clipboard.writeText(text);
      return true;
    } catch {
      const area = document.createElement("textarea");
      area.value = text;
      document.body.append(area);
      area.select();
      const done = document.execCommand("copy");
      area.remove();
      return done;
    }
  }

  for (const button of document.querySelectorAll("[data-copy]")) button.addEventListener("click", async () => {
    byId("copied").textContent = (await copy(byId(button.dataset.copy).textContent)) ? "Copied." : "Could not copy: select the text and copy it.";
  });

  byId("theme").addEventListener("click", () => { root.dataset.theme = isDark() ? "light" : "dark"; drawAll(); });
  dark.addEventListener("change", drawAll);
  let width = innerWidth;
  addEventListener("resize", () => { if (innerWidth !== width) { width = innerWidth; drawAll(); } });
  let chosen;
  addEventListener("beforeprint", () => {
    chosen = root.dataset.theme;
    printing = true;
    root.dataset.theme = "light";
    drawAll();
  });
  addEventListener("afterprint", () => {
    printing = false;
    if (chosen) root.dataset.theme = chosen;
    else delete root.dataset.theme;
    drawAll();
  });
  if (page.tracks.length) control();
  drawAll();
  root.dataset.ready = "true";
})();
