"use strict";
// Draws a report's plots with BokehJS, so that they can be zoomed, when they come near the window. Without scripts, and
// on paper, the page shows their still pictures.
(() => {
  const touch = matchMedia("(pointer: coarse)").matches;
  const NARROW = 640; // px: one column
  const SIX_DIGITS = "{" + "%.6g}"; // in one piece it would be a tag of the template language
  const FONT = "system-ui, sans-serif";
  const WORDS = { text_font: FONT, text_font_size: "13px", text_font_style: "normal" };
  const DASHES = { solid: [], dashed: [6, 4], dotted: [2, 3], dashdot: [6, 3, 2, 3] };

  const numbers = ({ middle, data }) => {
    const bytes = Uint8Array.from(atob(data), (c) => c.charCodeAt(0));
    return Float64Array.from(new Float32Array(bytes.buffer), (value) => value + middle);
  };

  // The edges of columns, which are equally wide on the axis: of each both, and its value there.
  const edges = ({ first, last, count }, scale) => Float64Array.from({ length: 2 * count }, (_, k) => {
    const place = first + (last - first) * Math.ceil(k / 2) / count;
    return scale === "log" ? 10 ** place : place;
  });
  const twice = (values) => Float64Array.from({ length: 2 * values.length }, (_, k) => values[k >> 1]);

  const axisStyle = (axis) => {
    Object.assign(axis, {
      axis_label_text_font: FONT, axis_label_text_font_size: "13px", axis_label_text_font_style: "normal",
      major_label_text_font: FONT, major_label_text_font_size: "12px", axis_line_color: "#555555",
      major_tick_line_color: "#555555", minor_tick_line_color: null,
    });
  };

  const setTicks = (axis, at, labels) => {
    axis.ticker = new Bokeh.FixedTicker({ ticks: at });
    axis.major_label_overrides = new Map(at.map((place, k) => [place, labels[k]]));
  };

  const newFigure = (options) => {
    const figure = new Bokeh.Plotting.Figure({
      tools: [], toolbar_location: null, sizing_mode: "stretch_width", min_border_right: 12, outline_line_color: null,
      ...options,
    });
    figure.axes.forEach(axisStyle);
    figure.grids.forEach((grid) => (grid.grid_line_color = "#e3e6e9"));
    figure.title && Object.assign(figure.title, WORDS);
    return figure;
  };

  // Fills what lies between two curves; where they have no values there is a gap.
  const addArea = (figure, x, low, high, look) => {
    const data = { x: [], y: [] };
    for (let start = 0, end; start < x.length; start = end + 1) {
      for (end = start; end < x.length && isFinite(low[end] + high[end]);) end++;
      if (end === start) continue;
      data.x.push(...x.slice(start, end), ...x.slice(start, end).reverse(), NaN);
      data.y.push(...low.slice(start, end), ...high.slice(start, end).reverse(), NaN);
    }
    return figure.patch({ field: "x" }, { field: "y" }, { source: new Bokeh.ColumnDataSource({ data }), ...look });
  };

  // Returns the renderers of a mark, and those that tell their values under the pointer.
  const addMark = (figure, mark, scale) => {
    const line = { line_color: mark.colour, line_width: 1.3 * (mark.width || 0.8), line_dash: DASHES[mark.dash] };
    if (mark.kind === "level") {
      const span = new Bokeh.Span({ location: mark.at, dimension: mark.upright ? "height" : "width", ...line });
      figure.add_layout(span);
      return { all: [span], told: [] };
    }
    if (mark.kind === "extent") {
      const x = edges(mark.columns, scale);
      const [low, high] = [mark.low, mark.high].map((values) => twice(numbers(values)));
      const area = addArea(figure, x, low, high, { fill_color: mark.colour, ...line, line_dash: [] });
      const told = [["least", low], ["largest", high]].map(([which, y]) => figure.line({ field: "x" }, { field: "y" },
        { source: new Bokeh.ColumnDataSource({ data: { x, y } }), ...line, name: mark.label + ", " + which }));
      return { all: [area, ...told], told };
    }
    const x = numbers(mark.x);
    const shown = mark.shown_x ? numbers(mark.shown_x) : x;
    if (mark.kind === "band") {
      const look = { fill_color: mark.colour, fill_alpha: 0.35, line_color: null };
      return { all: [addArea(figure, shown, numbers(mark.low), numbers(mark.high), look)], told: [] };
    }
    const y = numbers(mark.y);
    const source = new Bokeh.ColumnDataSource({ data: { shown, x, y } });
    const at = [{ field: "shown" }, { field: "y" }];
    const all = [];
    if (mark.kind === "curve") all.push(figure.line(...at, { source, ...line, name: mark.label }));
    if (mark.kind === "dots" || mark.dots) {
      const dots = { source, size: 5, fill_color: mark.colour, line_color: null, name: mark.label };
      all.push(figure.scatter(...at, dots));
    }
    const told = [...all];
    if (mark.error) {
      const error = numbers(mark.error);
      const data = { shown, low: y.map((value, k) => value - error[k]), high: y.map((value, k) => value + error[k]) };
      const bars = new Bokeh.ColumnDataSource({ data });
      all.push(figure.segment({ field: "shown" }, { field: "low" }, { field: "shown" }, { field: "high" },
        { source: bars, ...line }));
    }
    return { all, told };
  };

  const panelFigure = (panel, height, share, entries) => {
    const range = ([start, end]) => new Bokeh.Range1d({ start, end });
    const figure = newFigure({
      height: height + (panel.title ? 16 : 0) + (panel.x_label ? 16 : 0),
      title: panel.title || null, x_axis_label: panel.x_label, y_axis_label: panel.y_label,
      x_axis_type: panel.x_scale, y_axis_type: panel.y_scale,
      x_range: share || range(panel.x_range), y_range: range(panel.y_range),
    });
    if (panel.ticks) setTicks(figure.xaxes[0], panel.ticks.at, panel.ticks.labels);
    const told = [];
    for (const mark of panel.marks) {
      const made = addMark(figure, mark, panel.x_scale);
      told.push(...made.told);
      if (!mark.label) continue;
      const entry = entries.get(mark.label) || { colour: mark.colour, dash: mark.dash, renderers: [] };
      entry.renderers.push(...made.all);
      entries.set(mark.label, entry);
    }
    const tooltips = [["", "$name"], [panel.x_label || "x", "@x" + SIX_DIGITS], [panel.y_label || "y", "@y" + SIX_DIGITS]];
    figure.add_tools(new Bokeh.HoverTool({
      renderers: told, tooltips, formatters: { "@x": "printf", "@y": "printf" }, line_policy: "nearest",
    }));
    return figure;
  };

  const colourOf = (value) => {
    const full = value < 0 ? [33, 102, 172] : [178, 24, 43];
    return "rgb(" + full.map((part) => Math.round(247 + (part - 247) * Math.abs(value))).join(",") + ")";
  };

  const heatFigure = ({ names, values, title }) => {
    const count = names.length;
    const data = { x: [], y: [], first: [], second: [], value: [], colour: [] };
    values.forEach((row, i) => row.forEach((value, j) => {
      if (value === null) return;
      data.x.push(j); data.y.push(count - 1 - i); data.first.push(names[i]); data.second.push(names[j]);
      data.value.push(value); data.colour.push(colourOf(value));
    }));
    const range = () => new Bokeh.Range1d({ start: -0.5, end: count - 0.5 });
    const figure = newFigure({ title: title || null, x_range: range(), y_range: range(), aspect_ratio: 1,
                               max_width: count > 12 ? 900 : 420 });
    const source = new Bokeh.ColumnDataSource({ data });
    figure.rect({ field: "x" }, { field: "y" }, 1, 1,
      { source, fill_color: { field: "colour" }, line_color: null });
    const places = names.map((_, k) => k);
    setTicks(figure.xaxes[0], places, names);
    setTicks(figure.yaxes[0], places, [...names].reverse());
    const small = (count > 30 ? 6 : count > 12 ? 8 : 11) + "px";
    figure.axes.forEach((axis) => (axis.major_label_text_font_size = small));
    figure.xaxes[0].major_label_orientation = "vertical";
    figure.grids.forEach((grid) => (grid.grid_line_color = null));
    const tooltips = [["", "@first"], ["", "@second"], ["correlation", "@value" + SIX_DIGITS]];
    figure.add_tools(new Bokeh.HoverTool({ tooltips, formatters: { "@value": "printf" } }));
    return figure;
  };

  // A button for each label, which hides and shows what bears it in all panels.
  const fillLegend = (legend, entries) => {
    for (const [label, entry] of entries) {
      const button = document.createElement("button");
      const swatch = document.createElement("i");
      swatch.style.borderTop = "3px " + (entry.dash && entry.dash !== "solid" ? "dashed " : "solid ") + entry.colour;
      button.append(swatch, label);
      button.setAttribute("aria-pressed", "true");
      button.addEventListener("click", () => {
        const visible = button.getAttribute("aria-pressed") !== "true";
        button.setAttribute("aria-pressed", String(visible));
        entry.renderers.forEach((renderer) => (renderer.visible = visible));
      });
      legend.append(button);
    }
  };

  const draw = async (place) => {
    const plot = JSON.parse(place.querySelector("script").textContent);
    const columns = place.clientWidth < NARROW ? 1 : plot.columns;
    const share = plot.share && new Bokeh.Range1d({ start: plot.share[0], end: plot.share[1] });
    const entries = new Map();
    const figures = plot.panels.map((panel) =>
      panel.kind === "heat" ? heatFigure(panel) : panelFigure(panel, plot.height, share, entries));
    const together = (make) => new Bokeh.ToolProxy({ tools: figures.map((figure) => {
      const tool = make();
      figure.add_tools(tool);
      return tool;
    }) });
    const zoom = together(() => new Bokeh.BoxZoomTool());
    const tools = [zoom, together(() => new Bokeh.PanTool()), together(() => new Bokeh.WheelZoomTool()),
                   together(() => new Bokeh.ResetTool())];
    // Nothing takes the wheel, nor a finger, until its tool is chosen: the page must scroll.
    const toolbar = new Bokeh.Toolbar({ tools, logo: null, active_drag: touch ? null : zoom, active_scroll: null });
    const children = figures.map((figure, k) => [figure, Math.floor(k / columns), k % columns]);
    const grid = new Bokeh.GridPlot({ children, toolbar, toolbar_location: "above", sizing_mode: "stretch_width" });
    place.figures = figures; // for tests and for those who look with the browser's tools
    fillLegend(place.querySelector(".legend"), entries);
    const counts = plot.panels.flatMap((panel) => (panel.marks || []).map((mark) => mark.columns ? mark.columns.count : 0));
    const most = Math.max(...counts);
    if (most) {
      const note = document.createElement("p");
      note.className = "soft";
      note.textContent = "A curve drawn as an area reaches from its least to its largest value in each of " +
        most + " parts of the axis.";
      place.append(note);
    }
    place.classList.add("drawn");
    await Bokeh.Plotting.show(grid, place.querySelector(".live"));
    place.dataset.state = "drawn";
  };

  const seen = new IntersectionObserver((entries) => {
    for (const entry of entries) {
      if (!entry.isIntersecting) continue;
      seen.unobserve(entry.target);
      draw(entry.target);
    }
  }, { rootMargin: "600px" });
  document.querySelectorAll("figure.plot").forEach((place) => seen.observe(place));
})();
