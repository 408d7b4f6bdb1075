"use strict";
// Moves the drawing of the arm along its line: play, pause, scrub. Without scripts, and on paper, it stands still.
(() => {
  const place = document.querySelector("figure.player");
  const data = JSON.parse(place.querySelector("script").textContent);
  const views = new Float32Array(Uint8Array.from(atob(data.views), (c) => c.charCodeAt(0)).buffer);
  const arm = place.querySelector(".arm");
  const polygons = [...arm.children].sort((a, b) => a.dataset.shape - b.dataset.shape);
  const [trail, tip, mark] = [".trail", ".tip", ".mark"].map((name) => place.querySelector(name));
  const marks = place.querySelector(".error").getAttribute("points").split(" ").map((point) => point.split(","));
  const [button, slider, text] = ["button", "input", "output"].map((name) => place.querySelector(name));
  const frames = data.times.length;
  const each = views.length / frames;
  let frame = data.still;
  let started = null; // when playing: the clock at time 0, ms

  const turn = (a, b, c) => (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);

  // The convex hull of points in the plane (Andrew's monotone chain).
  const outline = (points) => {
    const sorted = [...points].sort((a, b) => a[0] - b[0] || a[1] - b[1]);
    const half = (ordered) => {
      const chain = [];
      for (const point of ordered) {
        while (chain.length > 1 && turn(chain.at(-2), chain.at(-1), point) <= 0) chain.pop();
        chain.push(point);
      }
      return chain.slice(0, -1);
    };
    return [...half(sorted), ...half(sorted.reverse())];
  };

  const seen = ({ frame: joint, corners }) => {
    const row = frame * each + 12 * (joint < 0 ? each / 12 + joint : joint);
    return corners.map((corner) => [0, 4, 8].map((at) =>
      corner[0] * views[row + at] + corner[1] * views[row + at + 1] + corner[2] * views[row + at + 2] + views[row + at + 3]));
  };

  const show = () => {
    const shapes = data.shapes.map((shape, k) => {
      const points = seen(shape);
      return { k, points, depth: points.reduce((sum, point) => sum + point[2], 0) / points.length };
    });
    shapes.sort((a, b) => a.depth - b.depth);
    for (const { k, points } of shapes) {
      const corners = outline(points.map(([x, y]) => [x, -y])).map(([x, y]) => x.toFixed(1) + "," + y.toFixed(1));
      polygons[k].setAttribute("points", corners.join(" "));
      arm.append(polygons[k]);
    }
    trail.setAttribute("points", data.trail.slice(0, frame + 1).join(" "));
    tip.setAttribute("cx", data.trail[frame][0]);
    tip.setAttribute("cy", data.trail[frame][1]);
    mark.setAttribute("cx", marks[frame][0]);
    mark.setAttribute("cy", marks[frame][1]);
    slider.value = frame;
    text.textContent = data.times[frame].toFixed(2) + " s, " + data.along[frame].toFixed(1) + " mm, error "
      + data.error[frame].toFixed(4) + " mm";
  };

  const pause = () => {
    started = null;
    button.textContent = "play";
  };

  const tick = (now) => {
    if (started === null) return;
    const time = (now - started) / 1000;
    while (frame < frames - 1 && data.times[frame + 1] <= time) frame += 1;
    show();
    if (frame === frames - 1) pause();
    else requestAnimationFrame(tick);
  };

  button.addEventListener("click", () => {
    if (started !== null) return pause();
    if (frame === frames - 1) frame = 0;
    started = performance.now() - 1000 * data.times[frame];
    button.textContent = "pause";
    requestAnimationFrame(tick);
  });
  slider.addEventListener("input", () => {
    pause();
    frame = Number(slider.value);
    show();
  });
  place.querySelector("div").hidden = false;
  show();
})();
