"use strict";
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const at = (name) => document.getElementById(name);
  const rad = Math.PI / 180;
  const direction = (theta, phi) => [
    Math.sin(theta * rad) * Math.cos(phi * rad), Math.sin(theta * rad) * Math.sin(phi * rad), Math.cos(theta * rad)];
  const DASHES = ["dash", "dashdot", "longdash", "dot"];
  const FONT = { family: "system-ui, sans-serif", size: 12, color: data.colours.ink };
  const NO_CONTOURS = { x: { highlight: false }, y: { highlight: false }, z: { highlight: false } };
  const CONFIG = { displaylogo: false, responsive: true, modeBarButtonsToRemove: ["select2d", "lasso2d"] };

  const options = (name, words) => words.forEach((text, k) => at(name).add(new Option(text, k)));
  options("channel", data.channels);
  options("order", data.order_words);
  at("incidence").max = data.incidences.length - 1;
  Object.entries(data.start).forEach(([name, k]) => { at(name).value = k; });

  const state = () => ({
    incidence: Number(at("incidence").value), channel: Number(at("channel").value),
    order: Number(at("order").value), logarithmic: at("radius").value === "logarithmic",
  });

  // --- The lobe: a closed surface whose radius is the light sent into a direction -------------------------------

  const brightest = (s) => Math.max(...data.lobes.values[s.incidence][s.order][s.channel].map((v) => v ?? 0)) || 1;

  function shape(s) {
    const { theta, dphi, values } = data.lobes;
    const flat = values[s.incidence][s.order][s.channel];
    const peak = brightest(s);
    const radius = (v) => v === null ? null
      : s.logarithmic ? Math.max(0, 1 + Math.log10(Math.max(v, 1e-300) / peak) / 3) : Math.max(0, v) / peak;
    const colour = (v) => v === null ? null : s.logarithmic ? Math.log10(Math.max(v, peak * 1e-3)) : v;
    const grid = { x: [], y: [], z: [], colour: [], text: [] };
    theta.forEach((t, row) => {
      const line = { x: [], y: [], z: [], colour: [], text: [] };
      for (let k = 0; k <= dphi.length; k += 1) {
        const v = flat[row * dphi.length + (k % dphi.length)];
        const r = radius(v);
        const [x, y, z] = direction(t, dphi[k % dphi.length]);
        line.x.push(r === null ? null : r * x);
        line.y.push(r === null ? null : r * y);
        line.z.push(r === null ? null : r * z);
        line.colour.push(colour(v));
        line.text.push(`theta_o ${t}°, dphi ${dphi[k % dphi.length]}°: ${v} /sr`);
      }
      Object.keys(grid).forEach((name) => grid[name].push(line[name]));
    });
    return grid;
  }

  function line3d(points, colour, width) {
    return { type: "scatter3d", mode: "lines", hoverinfo: "skip", showlegend: false, line: { color: colour, width },
      x: points.map((p) => p[0]), y: points.map((p) => p[1]), z: points.map((p) => p[2]) };
  }

  function guides(s) {
    const { incident, specular } = data.colours;
    const theta = data.incidences[s.incidence].theta;
    const around = Array.from({ length: 73 }, (_, k) => 5 * k);
    const rings = [30, 60, 90].map((t) =>
      line3d(around.map((a) => direction(90, a).map((c) => c * Math.sin(t * rad))), "#b9b9b4", 2));
    // Surfaces and lines alone: every other kind of trace takes a graphics card a while to prepare for.
    const disc = [0, 1].map((r) => around.map((a) => direction(90, a).map((c) => r * c)));
    const part = (k) => disc.map((row) => row.map((point) => point[k]));
    const plane = { type: "surface", x: part(0), y: part(1), z: disc.map((row) => row.map(() => -0.012)), hoverinfo: "skip",
      showscale: false, colorscale: [[0, data.colours.paper], [1, data.colours.paper]],
      lighting: { ambient: 1, diffuse: 0, specular: 0, fresnel: 0 }, contours: NO_CONTOURS };
    const arc = line3d(around.slice(0, 37).map((a) => direction(a - 90, 0)), "#8a8a86", 2);
    const ray = (phi, colour) => line3d([0, 1.3].map((r) => direction(theta, phi).map((c) => r * c)), colour, 5);
    return [plane, ...rings, arc, ray(0, incident), ray(180, specular)];
  }

  function names(theta) {
    const { incident, specular } = data.colours;
    const apart = theta < 4 ? 0.15 : 0;
    return [["incident", 0, apart, incident], ["specular", 180, -apart, specular]].map(([text, phi, aside, color]) => {
      const [x, y, z] = direction(theta, phi).map((c) => 1.4 * c);
      return { x: x + aside, y, z, text, showarrow: false, font: { ...FONT, color } };
    });
  }

  function bar(s, peak) {
    const title = { text: "BRDF · cos θₒ (1/sr)", side: "right" };
    const common = { thickness: 12, len: 0.7, title, x: 1, exponentformat: "power", showexponent: "all" };
    if (!s.logarithmic) return { colorbar: common, cmin: 0, cmax: peak };
    const top = Math.log10(peak);
    const marks = [0, 1, 2, 3].map((k) => top - k);
    return { cmin: top - 3, cmax: top,
      colorbar: { ...common, tickvals: marks, ticktext: marks.map((m) => (10 ** m).toPrecision(2)) } };
  }

  function drawLobe(s) {
    const lobe = shape(s);
    const surface = { type: "surface", x: lobe.x, y: lobe.y, z: lobe.z, surfacecolor: lobe.colour, text: lobe.text,
      hoverinfo: "text", colorscale: "Viridis", connectgaps: false, ...bar(s, brightest(s)),
      lighting: { ambient: 0.65, diffuse: 0.6, specular: 0.08, roughness: 0.7 },
      contours: NO_CONTOURS };
    const axis = (range) => ({ visible: false, range, showspikes: false });
    const eye = { x: 1.35 * data.camera[0], y: 1.35 * data.camera[1], z: 1.35 * data.camera[2] };
    const layout = { margin: { l: 0, r: 0, t: 0, b: 0 }, font: FONT, uirevision: "kept", paper_bgcolor: "#fff",
      scene: { annotations: names(data.incidences[s.incidence].theta), xaxis: axis([-1.45, 1.45]), yaxis: axis([-1.45, 1.45]), zaxis: axis([-0.1, 1.45]),
        aspectmode: "manual", aspectratio: { x: 2.2, y: 2.2, z: 1.176 },
        camera: { eye, center: { x: 0, y: 0, z: -0.03 }, projection: { type: "orthographic" } } } };
    Plotly.react("lobe", [surface, ...guides(s)], layout, CONFIG);
  }

  // --- The slice: the plane of incidence, with two standard errors ----------------------------------------------

  const positive = (v) => (v !== null && v > 0 ? v : null);

  function measured(s) {
    const cut = data.slices[s.incidence];
    const value = cut.value[s.order][s.channel].map(positive);
    const error = cut.error[s.order][s.channel];
    const colour = data.hues[s.channel];
    const name = "measured";
    const known = value.some((v, k) => v !== null && error[k] !== null);
    const template = "theta_o %{x}°: %{y:.4g} /sr<extra></extra>";
    if (!data.curves) {
      const bars = known ? { error_y: { type: "data", array: error.map((e) => 2 * e), thickness: 1, width: 3 } } : {};
      return [{ x: cut.angle, y: value, mode: "markers", marker: { color: colour, size: 7 }, name,
        hovertemplate: template, ...bars }];
    }
    const lone = value.length === 1 ? "lines+markers" : value.some((v, k) =>
      v !== null && (value[k - 1] ?? null) === null && (value[k + 1] ?? null) === null) ? "lines+markers" : "lines";
    const curve = { x: cut.angle, y: value, mode: lone, line: { color: colour, width: 2.2 }, marker: { size: 4 }, name,
      hovertemplate: template };
    if (!known) return [curve];
    const low = Math.min(...value.filter((v) => v !== null)) / 100;
    // A band of its own for every unbroken run of values.
    const x = [], y = [];
    let run = [];
    const close = () => {
      run.forEach((k) => { x.push(cut.angle[k]); y.push(value[k] + 2 * error[k]); });
      run.reverse().forEach((k) => { x.push(cut.angle[k]); y.push(Math.max(value[k] - 2 * error[k], low)); });
      if (run.length) { x.push(null); y.push(null); }
      run = [];
    };
    value.forEach((v, k) => { if (v === null || error[k] === null) close(); else run.push(k); });
    close();
    return [{ x, y, mode: "lines", fill: "toself", line: { width: 0 }, fillcolor: `${colour}40`, hoverinfo: "skip",
      name: "± 2 standard errors" }, curve];
  }

  function modelled(s) {
    const angle = data.slices[s.incidence].angle;
    return data.models.map((model, k) => {
      const { models } = data.colours;
      const [colour, dash] = [models[k % models.length], DASHES[k % DASHES.length]];
      const other = model.order !== data.orders[s.order];
      const words = data.order_words[data.orders.indexOf(model.order)];
      return { x: angle, y: model.values[s.incidence][s.channel].map(positive), mode: data.curves ? "lines" : "markers",
        name: other ? `${model.name} (${words})` : model.name, opacity: other ? 0.55 : 1,
        line: { color: colour, dash, width: 1.8 }, marker: { color: colour, symbol: "diamond-open", size: 8 },
        hovertemplate: "theta_o %{x}°: %{y:.4g} /sr<extra></extra>" };
    });
  }

  function drawSlice(s) {
    const theta = data.incidences[s.incidence].theta;
    const traces = [...measured(s), ...modelled(s)];
    const values = data.slices[s.incidence].value[s.order][s.channel].filter((v) => v !== null && v > 0);
    const top = Math.log10(Math.max(...values, 1e-12)) + 0.25;
    const bottom = values.length ? Math.log10(Math.min(...values)) - 0.25 : top - 1;
    const mark = (angle, colour) => ({ type: "line", x0: angle, x1: angle, y0: 0, y1: 1, yref: "paper", layer: "below",
      line: { color: colour, width: 1.5 } });
    const name = (text, angle, colour, side) => ({ text, x: angle, y: 1, yref: "paper", yanchor: "bottom",
      xanchor: side, showarrow: false, font: { ...FONT, color: colour } });
    const { incident, specular } = data.colours;
    const margin = { l: 64, r: 12, t: 48, b: 66 + 19 * traces.length };
    const height = at("slice").clientHeight - margin.t - margin.b;
    const decades = top - bottom > 1.5;
    const sides = at("slice").clientWidth < 420 ? "" : ", incident side < 0 < specular side";
    const layout = { margin, font: FONT, hovermode: "closest", paper_bgcolor: "#fff",
      plot_bgcolor: "#fff",
      legend: { orientation: "h", x: 0, y: -58 / height, yanchor: "top", font: { ...FONT, size: 11 } }, showlegend: true,
      xaxis: { range: [-90, 90], dtick: 30, title: { text: `theta_o (degrees)${sides}` },
        gridcolor: "#dddddd", zeroline: false },
      yaxis: { type: "log", range: [Math.max(bottom, top - data.decades), top], title: { text: "BRDF (1/sr)" },
        // Powers of ten are written a quarter larger than what is asked for.
        gridcolor: "#dddddd", exponentformat: "power", dtick: decades ? 1 : "D1", tickfont: { size: decades ? 9.6 : 12 } },
      shapes: [mark(-theta, incident), mark(theta, specular)],
      annotations: [name("incident", -theta, incident, theta < 20 ? "right" : "center"),
        name("specular", theta, specular, theta < 20 ? "left" : "center")] };
    Plotly.react("slice", traces, layout, CONFIG);
  }

  // --- Both -----------------------------------------------------------------------------------------------------

  function tell(s) {
    const { theta, phi } = data.incidences[s.incidence];
    const words = `theta_i ${theta}°, phi_i ${phi}°`;
    at("incidence-value").textContent = words;
    at("incidence").setAttribute("aria-valuetext", words);
    const parts = data.lobes === null ? [] : [`Outer arc of the lobe at ${brightest(s).toPrecision(3)} /sr`];
    if (data.choice) parts.push(`${data.choice} are kept here`);
    at("shown").textContent = parts.join("; ");
    const others = data.models.some((model) => model.order !== data.orders[s.order]);
    at("models-note").textContent = others
      ? "Fainter models speak of other light than what is shown, as their names tell: choose it to compare." : "";
  }

  function show() {
    const s = state();
    tell(s);
    drawSlice(s);
    if (data.lobes !== null) drawLobe(s);
  }

  if (data.incidences.length === 1) at("incidence").hidden = true;
  if (data.lobes === null) at("radius").parentElement.hidden = true;
  if (data.orders.length === 1) at("order").parentElement.hidden = true;
  document.querySelector(".controls").addEventListener("submit", (event) => event.preventDefault());

  function start() {
    // Until here the library was mere text, so that reading it kept nobody waiting.
    const library = document.createElement("script");
    library.textContent = at("plotly").textContent;
    document.head.append(library);
    ["incidence", "channel", "order", "radius"].forEach((name) => at(name).addEventListener("input", show));
    let resizing = 0;
    window.addEventListener("resize", () => { clearTimeout(resizing); resizing = setTimeout(show, 150); });
  }

  // The words first, then the slice, then the lobe, for which a browser needs longest.
  const soon = (work) => requestAnimationFrame(() => setTimeout(work));
  tell(state());
  soon(() => {
    start();
    drawSlice(state());
    soon(() => {
      if (data.lobes !== null) drawLobe(state());
      performance.mark("drawn");
    });
  });
})();
