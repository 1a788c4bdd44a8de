// Draws the plots of a drive's report with uPlot. drive_charts.py and drive_maps.py make their
// data; each is drawn into the element that names it by data-plot.
"use strict";
(() => {
  const plots = JSON.parse(document.getElementById("plots").textContent);
  const NO_VALUE = -32768, MIDDLE = 32767;
  const FONT = "12px system-ui, sans-serif";
  const drawn = [];

  let palette = {};
  const readPalette = () => {
    const style = getComputedStyle(document.documentElement);
    palette = new Proxy({}, { get: (_, name) => style.getPropertyValue("--" + name).trim() });
  };

  const unpack = ({ low, step, levels }) => {
    const bytes = Uint8Array.from(atob(levels), (c) => c.charCodeAt(0));
    const view = new DataView(bytes.buffer);
    return Array.from({ length: bytes.length / 2 }, (_, i) => {
      const level = view.getInt16(2 * i, true);
      return level === NO_VALUE ? null : low + (level + MIDDLE) * step;
    });
  };

  const two = (n) => String(n).padStart(2, "0");
  const clock = (s, tenths) => {
    const sign = s < 0 ? "-" : "", all = Math.abs(s), whole = Math.floor(all);
    const h = Math.floor(whole / 3600), m = Math.floor(whole / 60) % 60;
    const text = h ? `${h}:${two(m)}:${two(whole % 60)}` : `${m}:${two(whole % 60)}`;
    return sign + text + (tenths ? "." + Math.floor(10 * (all - whole)) : "");
  };
  const signed = (v, digits) => (v < 0 ? "−" : "+") + Math.abs(v).toFixed(digits);
  const number = (v, digits) => (v == null ? "" : v.toFixed(digits).replace("-", "−"));

  const axis = (label, more) => ({
    label, labelSize: 18, labelFont: FONT, font: FONT, labelGap: 0,
    stroke: () => palette.muted, grid: { stroke: () => palette.grid, width: 1 },
    ticks: { show: false }, values: (_, ticks) => ticks.map((v) => String(v).replace("-", "−")),
    ...more,
  });
  const timeAxis = () => axis("time, h:min:s", {
    size: 28, space: 70, values: (_, ticks) => ticks.map((s) => clock(s, s % 1 !== 0)),
    incrs: [0.1, 0.2, 0.5, 1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 14400,
      43200, 86400, 864000],
  });
  const sideAxis = (label) => axis(label, {
    size: (_, texts) => Math.max(46, ...(texts || []).map((text) => 7 * text.length + 12)),
  });
  const timeSeries = { label: "time", value: (_, s) => (s == null ? "" : clock(s, true)) };
  const asGiven = (_, low, high) => [low, high];

  // Plots over time of one drive share their zoom and cursor.
  const follow = (group) => (u, key) => {
    if (key !== "x") return;
    const { min, max } = u.scales.x;
    if (group.shown[0] !== min || group.shown[1] !== max) {
      group.shown = [min, max];
      group.tell(min, max);
      for (const other of group.routes) other.redraw(false);
    }
    for (const other of group.members) {
      const x = other.scales.x;
      if (other !== u && (x.min !== min || x.max !== max)) other.setScale("x", { min, max });
    }
  };
  // Without a zoom, uPlot asks with the ends of the data: then the whole drive is shown.
  const wholeOr = (group) => (u, low, high) => {
    const times = u.data[0];
    const chosen = low !== times[0] || high !== times[times.length - 1];
    return chosen ? [low, high] : [0, group.duration];
  };
  const overTime = (group, height) => ({
    height,
    cursor: {
      sync: { key: group.key, scales: ["x", null], setSeries: false,
        filters: { pub: (type) => type !== "mousedown" && type !== "mouseup" && type !== "dblclick" } },
      drag: { x: true, y: false }, points: { size: 5 },
    },
    scales: { x: { time: false, range: wholeOr(group) } },
    hooks: { setScale: [follow(group)], drawAxes: [(u) => context(u, group)] },
  });
  // uPlot leaves its last style behind, and counts on finding it again.
  const tidy = (ctx, work) => { ctx.save(); ctx.lineCap = "butt"; work(); ctx.restore(); };

  // Behind the curves: shaded parts, and a line for each event.
  const context = (u, group) => tidy(u.ctx, () => {
    const { left, top, width, height } = u.bbox, ratio = devicePixelRatio;
    u.ctx.beginPath(); u.ctx.rect(left, top, width, height); u.ctx.clip();
    u.ctx.fillStyle = palette.shade;
    for (const [begin, end] of group.shaded) {
      const from = u.valToPos(begin, "x", true);
      u.ctx.fillRect(from, top, u.valToPos(end, "x", true) - from, height);
    }
    u.ctx.strokeStyle = palette.event; u.ctx.lineWidth = ratio; u.ctx.setLineDash([3 * ratio, 3 * ratio]);
    for (const time of group.events) {
      const x = Math.floor(u.valToPos(time, "x", true)) + 0.5;
      u.ctx.beginPath(); u.ctx.moveTo(x, top); u.ctx.lineTo(x, top + height); u.ctx.stroke();
    }
  });

  const curves = (spec, group) => {
    const x = Array.from({ length: spec.count }, (_, i) => spec.start + i * spec.step);
    const data = [x, ...spec.series.map((s) =>
      s.values ? unpack(s.values) : new Array(spec.count).fill(s.value))];
    const at = (role) => 1 + spec.series.findIndex((s) => s.role === role);
    const low = at("low"), high = at("high"), digits = spec.decimals;
    const between = (u, i) => (u.data[high][i] == null ? ""
      : ` (${number(u.data[low][i], digits)} to ${number(u.data[high][i], digits)})`);
    const series = spec.series.map(({ label, role }) => {
      const edge = role === "low" || role === "high", share = role === "share";
      return {
        label, scale: share ? "share" : "y", spanGaps: false, points: { show: false },
        class: edge ? "unlisted" : "listed",
        width: edge || share ? 0 : { measured: 1.8, truth: 1, error: 0.8 }[role] || 1.2,
        stroke: () => (edge ? "transparent" : palette[role]),
        dash: { truth: [6, 4], other: [2, 3] }[role],
        ...(share ? { paths: () => null } : {}),
        value: (u, v, _, i) => (v == null ? "" : share ? v.toFixed(0) + " %"
          : number(v, digits) + (role === "predicted" && low ? between(u, i) : "")),
      };
    });
    const options = overTime(group, spec.height || 230);
    options.axes = [timeAxis(), sideAxis(spec.axis)];
    options.scales.share = { range: [0, 100] };
    options.series = [timeSeries, ...series];
    if (low) options.bands = [{ series: [high, low], fill: () => palette.band }];
    return [options, data];
  };

  // A row for each parameter, its colour the share of the prior at that time.
  const strips = (spec, group) => {
    const rows = spec.series.length;
    const x = Array.from({ length: spec.count }, (_, i) => spec.start + i * spec.step);
    const data = [x, ...spec.series.map((s) => unpack(s.values))];
    const options = overTime(group, 60 + 26 * rows);
    options.cursor.points = { show: false };
    options.cursor.y = false;
    options.scales.y = { range: [0, rows] };
    options.axes = [timeAxis(), axis(null, {
      size: 62, labelSize: 0, grid: { show: false },
      splits: () => spec.series.map((_, i) => rows - i - 0.5),
      values: () => spec.series.map((s) => s.label),
    })];
    options.series = [timeSeries, ...spec.series.map(({ label }) => ({
      label, paths: () => null, points: { show: false }, stroke: () => palette.told,
      value: (_, v) => (v == null ? "" : v.toFixed(0) + " %"),
    }))];
    options.hooks.drawAxes.unshift((u) => tidy(u.ctx, () => {
      const { left, top, width, height } = u.bbox, each = height / rows;
      for (let pixel = 0; pixel < width; pixel++) {
        const i = Math.round((u.posToVal(left + pixel, "x", true) - spec.start) / spec.step);
        for (let row = 0; row < rows; row++) {
          const share = data[row + 1][i];
          if (share == null) continue;
          u.ctx.globalAlpha = 1 - 0.92 * Math.min(Math.max(share / 100, 0), 1);
          u.ctx.fillStyle = palette.told;
          u.ctx.fillRect(left + pixel, top + row * each + 1, 1, each - 2);
        }
      }
    }));
    return [options, data];
  };

  // Energy of each part: the band of its forecast, and a line at the measured energy.
  const outcome = (spec, group) => {
    const { parts } = spec;
    const data = [parts.map((p) => (p[0] + p[1]) / 2), parts.map((p) => p[3] - p[4]),
      parts.map((p) => p[3] + p[4]), parts.map((p) => p[3]), parts.map((p) => p[2])];
    const options = overTime(group, 240);
    options.scales.y = { range: (_, low, high) => [Math.min(0, low * 1.05), Math.max(0, high * 1.05)] };
    options.axes = [timeAxis(), sideAxis(spec.axis)];
    const mute = { paths: () => null, points: { show: false } };
    const shown = (label, color, value) => ({ label, ...mute, stroke: () => palette[color],
      value: value || ((_, v) => number(v, 0)) });
    options.series = [{ ...timeSeries, label: "part",
      value: (u, v, _, i) => (i == null ? "" : clock(parts[i][0]) + " to " + clock(parts[i][1])) },
    { ...mute, class: "unlisted" }, { ...mute, class: "unlisted" },
    shown("forecast", "predicted", (_, v, __, i) =>
      (v == null ? "" : `${number(v, 0)} ± ${number(parts[i][4], 0)}`)), shown("measured", "measured")];
    options.cursor.points = { show: false };
    options.hooks.draw = [(u) => tidy(u.ctx, () => {
      const ratio = devicePixelRatio, { left, top, width, height } = u.bbox;
      u.ctx.beginPath(); u.ctx.rect(left, top, width, height); u.ctx.clip();
      const x = (s) => u.valToPos(s, "x", true), y = (e) => u.valToPos(e, "y", true);
      const level = (from, to, energy, color) => {
        u.ctx.strokeStyle = palette[color]; u.ctx.lineWidth = 2 * ratio; u.ctx.beginPath();
        u.ctx.moveTo(from, y(energy)); u.ctx.lineTo(to, y(energy)); u.ctx.stroke();
      };
      for (const [begin, end, measured, forecast, half] of parts) {
        const from = x(begin) + 2 * ratio, to = x(end) - 2 * ratio;
        u.ctx.fillStyle = palette.band;
        u.ctx.fillRect(from, y(forecast + half), to - from, y(forecast - half) - y(forecast + half));
        level(from, to, forecast, "predicted");
        level(from, to, measured, "measured");
      }
    })];
    return [options, data];
  };

  // Errors: single moments as dots, the median and 90 % of each bin as a line in its band.
  const spread = (spec) => {
    const rows = spec.bins.map(([x, low, middle, high]) => [x, low, middle, high, null]);
    const x = unpack(spec.x), y = unpack(spec.y);
    x.forEach((value, i) => rows.push([value, null, null, null, y[i]]));
    rows.sort((a, b) => a[0] - b[0]);
    const data = [0, 1, 2, 3, 4].map((column) => rows.map((row) => row[column]));
    const line = { spanGaps: true, points: { show: false } };
    const value = (_, v) => (v == null ? "" : signed(v, 2) + " kW");
    return [{
      height: 250, cursor: { drag: { x: true, y: false }, points: { size: 5 } },
      scales: { x: { time: false } },
      axes: [axis(spec.axes[0], { size: 28, space: 50 }), sideAxis(spec.axes[1])],
      series: [{ label: spec.axes[0].split(",")[0], value: (_, v) => number(v, 1) },
        { ...line, class: "unlisted", width: 0 },
        { ...line, label: "median", stroke: () => palette.predicted, width: 2, value },
        { ...line, class: "unlisted", width: 0 },
        { label: "moment", paths: () => null, stroke: () => palette.share, value,
          points: { show: true, size: 2.5, width: 0, fill: () => palette.share } }],
      bands: [{ series: [3, 1], fill: () => palette.band }],
    }, data];
  };

  // Energy over distance: bars as measured, and the line of a steady speed in its band.
  const bySpeed = (spec) => {
    const middle = unpack(spec.middle), x = middle.map((_, i) => spec.start + i);
    const measured = new Map(spec.bars.map((bar) => [bar[0], bar]));
    const barAt = (v) => measured.get(Math.floor(v / spec.width) * spec.width);
    const bars = x.map((v) => (barAt(v) || [])[1]);
    const within = (wanted) => middle.map((v, i) => ((x[i] <= spec.driven) === wanted ? v : null));
    const data = [x, unpack(spec.low), within(true), unpack(spec.high), bars, within(false)];
    const interval = (u, v, _, i) => (v == null ? ""
      : `${digits(v)} (${digits(u.data[1][i])} to ${digits(u.data[3][i])})`);
    const [distance] = spec.axes[1].split("/").slice(1), digits = (v) => number(v, 0);
    const hidden = { class: "unlisted", width: 0, points: { show: false } };
    const draw = (u) => tidy(u.ctx, () => {
      u.ctx.fillStyle = palette.bar;
      for (const [begin, energy] of spec.bars) {
        const from = u.valToPos(begin, "x", true), to = u.valToPos(begin + spec.width, "x", true);
        const top = u.valToPos(energy, "y", true), foot = u.valToPos(0, "y", true);
        u.ctx.fillRect(from + 1, Math.min(top, foot), to - from - 2, Math.abs(foot - top));
      }
    });
    return [{
      height: 270, cursor: { drag: { x: true, y: false }, points: { size: 5 } },
      scales: { x: { time: false, range: (_, low, high) => [low === x[0] ? 0 : low, high] },
        y: { range: (_, low, high) => [Math.min(0, low * 1.05), high * 1.05] } },
      axes: [axis(spec.axes[0], { size: 28, space: 50 }), sideAxis(spec.axes[1])],
      series: [{ label: "speed", value: (_, v) => (v == null ? "" : digits(v)) }, hidden,
        { label: "steady, flat", stroke: () => palette.predicted, width: 2, points: { show: false },
          value: interval },
        hidden, { label: "measured", paths: () => null, points: { show: false },
          stroke: () => palette.bar, value: (u, v, _, i) => (v == null ? ""
            : `${digits(v)}, over ${number(barAt(x[i])[2], 1)} ${distance}`) },
        { label: "faster than driven", stroke: () => palette.other, width: 2, dash: [3, 5],
          points: { show: false }, value: interval }],
      bands: [{ series: [3, 1], fill: () => palette.band }],
      hooks: { drawAxes: [draw] },
    }, data];
  };

  // Cells of speed and acceleration, coloured by their value.
  const cells = (spec) => {
    const values = unpack(spec.values), [columns, rows] = spec.shape;
    const [width, height] = spec.cell, [x0, y0] = spec.first;
    const used = values.flatMap((v, k) => (v == null ? [] : [k % rows]));
    const low = used.reduce((a, b) => Math.min(a, b), rows), high = used.reduce((a, b) => Math.max(a, b), -1);
    const paint = (v) => (spec.of === "seconds"
      ? ["told", 0.12 + 0.88 * Math.log1p(v) / Math.log1p(spec.full)]
      : [v < 0 ? "cold" : "hot", 0.06 + 0.94 * Math.min(Math.abs(v) / spec.full, 1)]);
    const draw = (u) => tidy(u.ctx, () => {
      const { left, top, width: w, height: h } = u.bbox;
      u.ctx.beginPath(); u.ctx.rect(left, top, w, h); u.ctx.clip();
      values.forEach((v, k) => {
        if (v == null) return;
        const i = Math.floor(k / rows), j = k % rows;
        const from = u.valToPos(x0 + i * width, "x", true), to = u.valToPos(x0 + (i + 1) * width, "x", true);
        const top = u.valToPos(y0 + (j + 1) * height, "y", true), end = u.valToPos(y0 + j * height, "y", true);
        const [color, alpha] = paint(v);
        u.ctx.globalAlpha = alpha; u.ctx.fillStyle = palette[color];
        u.ctx.fillRect(from + 0.5, top + 0.5, Math.max(to - from - 1, 1), Math.max(end - top - 1, 1));
      });
    });
    const tell = (u) => {
      const { left, top } = u.cursor, readout = u.root.parentNode.nextElementSibling;
      if (left == null || left < 0) { readout.textContent = readout.dataset.rest; return; }
      const i = Math.floor((u.posToVal(left, "x") - x0) / width);
      const j = Math.floor((u.posToVal(top, "y") - y0) / height);
      const v = i < 0 || i >= columns || j < 0 || j >= rows ? null : values[i * rows + j];
      const here = `${i * width} to ${(i + 1) * width} ${spec.axes[0].split(", ")[1]}, ` +
        `${number(y0 + j * height, 2)} to ${number(y0 + (j + 1) * height, 2)} m/s²: `;
      readout.textContent = here + (v == null ? "no data"
        : spec.of === "seconds" ? v.toFixed(1) + " s" : signed(v, 2) + " kW");
    };
    return [{
      height: 290, legend: { show: false },
      cursor: { drag: { x: true, y: true, uni: 20 }, points: { show: false } },
      scales: { x: { time: false, range: asGiven }, y: { range: asGiven } },
      axes: [axis(spec.axes[0], { size: 28, space: 50 }), sideAxis(spec.axes[1])],
      series: [{}, { paths: () => null, points: { show: false } }],
      hooks: { drawAxes: [draw], setCursor: [tell] },
    }, [[x0, x0 + columns * width], high < 0 ? [-1, 1] : [y0 + low * height, y0 + (high + 1) * height]]];
  };

  // A finger that moves sideways zooms like the mouse; up and down it scrolls the page.
  const touch = (over) => {
    const send = (type, event) => {
      const { clientX, clientY } = event.changedTouches[0];
      // uPlot ignores a mouse event without a movement.
      over.dispatchEvent(new MouseEvent(type, { clientX, clientY, movementX: 1, bubbles: true }));
    };
    over.addEventListener("touchstart", (e) => { send("mousemove", e); send("mousedown", e); }, { passive: true });
    over.addEventListener("touchmove", (e) => send("mousemove", e), { passive: true });
    over.addEventListener("touchend", (e) => send("mouseup", e), { passive: true });
  };

  // The road, coloured by power: pale for the whole drive, strong for the shown part.
  const route = (spec, group) => {
    const [time, east, north, power] = ["time", "east", "north", "power"].map((k) => unpack(spec[k]));
    const side = (values) => {
      const low = Math.min(...values), high = Math.max(...values);
      return { middle: (low + high) / 2, span: Math.max(high - low, 0.05) };
    };
    const x = side(east), y = side(north);
    // Equal scales to the east and to the north, without the space of axes and padding.
    const inside = (u) => [Math.max(u.width - 76, 100), Math.max(u.height - 60, 100)];
    const range = (of, index) => (u) => {
      const sizes = inside(u), scale = 1.06 * Math.max(x.span / sizes[0], y.span / sizes[1]);
      return [of.middle - scale * sizes[index] / 2, of.middle + scale * sizes[index] / 2];
    };
    const place = (u, i) => [u.valToPos(east[i], "x", true), u.valToPos(north[i], "y", true)];
    const stroke = (u, i, color, alpha, wide) => {
      u.ctx.globalAlpha = alpha; u.ctx.strokeStyle = palette[color];
      u.ctx.lineWidth = wide * devicePixelRatio; u.ctx.beginPath();
      u.ctx.moveTo(...place(u, i - 1)); u.ctx.lineTo(...place(u, i)); u.ctx.stroke();
    };
    const draw = (u) => tidy(u.ctx, () => {
      const [begin, end] = group.shown;
      power.forEach((v, i) => {
        if (i === 0) return;
        const strength = time[i] > begin && time[i - 1] < end ? 1 : 0.2;
        stroke(u, i, "share", 0.35 * strength, 2);
        const full = v == null ? 0 : Math.min(Math.abs(v) / spec.full, 1);
        if (v != null) stroke(u, i, v < 0 ? "cold" : "hot", strength * (0.12 + 0.88 * full), 5);
      });
      u.ctx.globalAlpha = 1; u.ctx.fillStyle = palette.text;
      u.ctx.beginPath(); u.ctx.arc(...place(u, 0), 4 * devicePixelRatio, 0, 7); u.ctx.fill();
    });
    const tell = (u) => {
      const { left, top } = u.cursor, readout = u.root.parentNode.nextElementSibling;
      const far = (i) => Math.hypot(u.valToPos(east[i], "x") - left, u.valToPos(north[i], "y") - top);
      const near = left == null || left < 0 ? null : time.reduce((best, _, i) => (far(i) < far(best) ? i : best), 0);
      readout.textContent = near == null || far(near) > 30 ? readout.dataset.rest
        : `${clock(time[near])}: ` + (power[near] == null ? "not measured" : number(power[near], 1) + " kW");
    };
    const drag = { x: false, y: false };
    return [{
      height: 380, legend: { show: false }, cursor: { drag, points: { show: false } },
      scales: { x: { time: false, range: range(x, 0) }, y: { range: range(y, 1) } },
      axes: [axis(spec.axes[0], { size: 28, space: 60 }), axis(spec.axes[1], { size: 46 })],
      series: [{}, { paths: () => null, points: { show: false } }],
      hooks: { drawAxes: [draw], setCursor: [tell] },
    }, [[x.middle - x.span, x.middle + x.span], [y.middle, y.middle]]];
  };

  // Figures of the shown part of a drive.
  const teller = (section, drive) => {
    const { step, ...totals } = drive.totals, { units } = drive;
    const [distance, recorded, known, energy] = ["distance", "seconds", "known", "energy"]
      .map((k) => unpack(totals[k]));
    const part = (values, begin, end) => {
      const at = (s) => {
        const place = Math.min(Math.max(s / step, 0), values.length - 1), i = Math.floor(place);
        return values[i] + (place - i) * ((values[i + 1] ?? values[i]) - values[i]);
      };
      return at(end) - at(begin);
    };
    const ends = (name, begin, end) => {
      const chart = drive.charts[name];
      if (!chart) return [];
      const values = unpack(chart.series[0].values).filter((v, i) => {
        const s = chart.start + i * chart.step;
        return v != null && s >= begin && s <= end;
      });
      return values.length ? [values[0], values[values.length - 1]] : [];
    };
    const consumption = (joules, metres) => (units.rate.startsWith("kWh")
      ? `${number(joules / metres / units.rate_joules, 1)} ${units.rate}`
      : joules > 0 ? `${number(metres / units.metres / (joules / 3.6e6), 1)} ${units.distance}/kWh` : "-");
    const place = section.querySelector(".stretch");
    return (begin, end) => {
      const far = part(distance, begin, end), measured = part(known, begin, end);
      const joules = part(energy, begin, end), seconds = Math.max(part(recorded, begin, end), 1e-9);
      const [low, high] = ends("height", begin, end), [from, to] = ends("charge", begin, end);
      const texts = [
        `${clock(begin)} to ${clock(end)}`, `${number(far / units.metres, 2)} ${units.distance}`,
        `${number(far / seconds * 3600 / units.metres, 0)} ${units.speed}`,
        measured > 0 && `${number(joules / 3.6e6, 3)} kWh`,
        measured >= 50 && consumption(joules, measured),
        low != null && `${signed(high - low, 0)} ${units.height}`,
        from != null && `charge ${number(from, 1)} to ${number(to, 1)} %`,
      ];
      place.replaceChildren(...texts.filter(Boolean).map((text) => {
        const span = document.createElement("span");
        span.textContent = text;
        return span;
      }));
    };
  };

  const OVER_TIME = ["time", "strips", "outcome"];
  const KINDS = { time: curves, strips, outcome, spread, cells, bySpeed, route };
  const draw = (node, spec, group) => {
    const [options, data] = KINDS[spec.kind](spec, group);
    const overall = { width: Math.max(node.clientWidth - 12, 200), padding: [10, 14, 0, 0] };
    const u = new uPlot({ ...overall, ...options }, data, node);
    drawn.push([u, node]);
    touch(u.over);
    return u;
  };

  const drawDrive = (section) => {
    if (section.dataset.drawn) return;
    section.dataset.drawn = "yes";
    const drive = plots[Number(section.dataset.drive)];
    const group = { key: "drive" + section.dataset.drive, members: [],
      duration: Math.max(drive.duration, 1), events: drive.events, shaded: drive.shaded,
      tell: teller(section, drive), routes: [] };
    group.shown = [0, group.duration];
    group.tell(0, group.duration);
    for (const node of section.querySelectorAll("[data-plot]")) {
      const spec = drive.charts[node.dataset.plot];
      const u = draw(node, spec, group);
      if (spec.kind === "route") group.routes.push(u);
      if (OVER_TIME.includes(spec.kind)) group.members.push(u);
    }
    for (const button of section.querySelectorAll("button")) {
      button.addEventListener("click", () => {
        for (const u of group.members) u.setScale("x", { min: 0, max: group.duration });
      });
    }
  };

  readPalette();
  for (const section of document.querySelectorAll("[data-drive]")) {
    if (section.open !== false) drawDrive(section);
    section.addEventListener("toggle", () => { if (section.open) drawDrive(section); });
  }
  const fit = () => {
    for (const [u, node] of drawn) {
      const width = Math.max(node.clientWidth - 12, 200);
      if (width !== u.width) u.setSize({ width, height: u.height });
    }
  };
  new ResizeObserver(fit).observe(document.body);
  const repaint = () => { readPalette(); for (const [u] of drawn) u.redraw(false); };
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", repaint);
  for (const [moment, printing] of [["beforeprint", true], ["afterprint", false]]) {
    addEventListener(moment, () => {
      document.documentElement.classList.toggle("printing", printing);
      for (const closed of document.querySelectorAll("details:not([data-drive])")) closed.open = printing;
      repaint();
    });
  }
})();
