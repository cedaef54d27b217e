"use strict";
// Plays the moving arm on a canvas: convex shapes, painted from far to near. It loads nothing.
(() => {
  const scene = JSON.parse(document.getElementById("scene").textContent);
  const canvas = document.getElementById("arm"), pen = canvas.getContext("2d");
  const get = (id) => document.getElementById(id);
  const slider = get("arm-time"), button = get("arm-play"), pace = get("arm-pace");
  const told = get("arm-told");
  const { rate, count, poses, q } = scene.frames;
  const colors = ["#8d99a6", "#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00"];
  const home = { yaw: -0.9, pitch: 0.42, distance: 2.7 * scene.size, at: scene.center.slice() };
  let eye = { ...home, at: home.at.slice() };
  let time = 0, playing = false, before = null, wanted = true;

  // Placement of a link at a time: between two samples position and quaternion are blended.
  function placement(link, when) {
    if (link < 0) return [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0];
    const x = Math.min(when * rate, count - 1), k = Math.min(Math.floor(x), count - 2), s = x - k;
    const a = poses[k][link], b = poses[k + 1][link];
    const sign = a[3] * b[3] + a[4] * b[4] + a[5] * b[5] + a[6] * b[6] < 0 ? -1 : 1;
    const v = a.map((each, i) => (1 - s) * each + s * (i > 2 ? sign : 1) * b[i]);
    const n = Math.hypot(v[3], v[4], v[5], v[6]);
    const [i, j, l, w] = [v[3] / n, v[4] / n, v[5] / n, v[6] / n];
    return [1 - 2 * (j * j + l * l), 2 * (i * j - l * w), 2 * (i * l + j * w), v[0],
      2 * (i * j + l * w), 1 - 2 * (i * i + l * l), 2 * (j * l - i * w), v[1],
      2 * (i * l - j * w), 2 * (j * l + i * w), 1 - 2 * (i * i + j * j), v[2]];
  }
  const moved = (m, p) => [m[0] * p[0] + m[1] * p[1] + m[2] * p[2] + m[3],
    m[4] * p[0] + m[5] * p[1] + m[6] * p[2] + m[7],
    m[8] * p[0] + m[9] * p[1] + m[10] * p[2] + m[11]];

  // From the room to the screen: x to the right, y down, and the distance from the eye.
  function lens() {
    const [cy, sy] = [Math.cos(eye.yaw), Math.sin(eye.yaw)];
    const [cp, sp] = [Math.cos(eye.pitch), Math.sin(eye.pitch)];
    const wide = canvas.width, high = canvas.height, zoom = 1.6 * Math.min(wide, high);
    return (p) => {
      const [x, y, z] = [p[0] - eye.at[0], p[1] - eye.at[1], p[2] - eye.at[2]];
      const across = -sy * x + cy * y, toward = cy * x + sy * y;
      const depth = eye.distance - (cp * toward + sp * z), up = cp * z - sp * toward;
      const scale = zoom / Math.max(depth, 0.05 * scene.size);
      return [0.5 * wide + scale * across, 0.5 * high - scale * up, depth];
    };
  }

  function line(points, style, width) {
    pen.beginPath();
    points.forEach((p, k) => (k ? pen.lineTo(p[0], p[1]) : pen.moveTo(p[0], p[1])));
    pen.strokeStyle = style;
    pen.lineWidth = width * (window.devicePixelRatio || 1);
    pen.stroke();
  }

  function shaded(color, light) {
    const n = parseInt(color.slice(1), 16), f = 0.45 + 0.55 * light;
    return `rgb(${[n >> 16, (n >> 8) & 255, n & 255].map((c) => Math.round(c * f)).join(",")})`;
  }

  function draw() {
    const onScreen = lens(), faces = [];
    pen.fillStyle = "#f4f6f8";
    pen.fillRect(0, 0, canvas.width, canvas.height);
    for (const each of scene.planes) {
      pen.beginPath();
      each.outline.map(onScreen).forEach((p, k) => (k ? pen.lineTo(p[0], p[1]) : pen.moveTo(p[0], p[1])));
      pen.fillStyle = "rgba(160,140,110,0.18)";
      pen.fill();
      for (const ends of each.lines) line(ends.map(onScreen), "rgba(120,100,70,0.25)", 1);
    }
    scene.shapes.forEach((shape) => {
      const m = placement(shape.link, time);
      const corners = shape.points.map((p) => moved(m, p)), seen = corners.map(onScreen);
      const color = shape.obstacle ? "#b8a888" : colors[(shape.link + 1) % colors.length];
      for (const [a, b, c] of shape.faces) {
        const [p, u, v] = [seen[a], seen[b], seen[c]];
        // Faces that look away are hidden by those that do not: shapes are convex.
        const turn = (u[0] - p[0]) * (v[1] - p[1]) - (u[1] - p[1]) * (v[0] - p[0]);
        if (turn >= 0 && !shape.hollow) continue;
        const [o, d, e] = [corners[a], corners[b], corners[c]];
        const s = [d[0] - o[0], d[1] - o[1], d[2] - o[2]], t = [e[0] - o[0], e[1] - o[1], e[2] - o[2]];
        const n = [s[1] * t[2] - s[2] * t[1], s[2] * t[0] - s[0] * t[2], s[0] * t[1] - s[1] * t[0]];
        const light = (0.35 * n[0] + 0.25 * n[1] + 0.9 * n[2]) / (Math.hypot(...n) || 1);
        faces.push([p[2] + u[2] + v[2], shaded(color, Math.max(0, 0.5 + 0.5 * light)), p, u, v]);
      }
    });
    for (const trace of scene.traces) line(trace.map(onScreen), "rgba(31,41,51,0.35)", 1);
    faces.sort((a, b) => b[0] - a[0]);
    for (const [, style, p, u, v] of faces) {
      pen.beginPath();
      pen.moveTo(p[0], p[1]);
      pen.lineTo(u[0], u[1]);
      pen.lineTo(v[0], v[1]);
      pen.closePath();
      pen.fillStyle = pen.strokeStyle = style;
      pen.lineWidth = 0.7;
      pen.fill();
      pen.stroke();
    }
    for (const bone of scene.bones) {
      const ends = bone.map((k) => { const m = placement(k, time); return onScreen([m[3], m[7], m[11]]); });
      line(ends, "rgba(31,41,51,0.8)", scene.shapes.length ? 1 : 5);
    }
    tell();
  }

  function tell() {
    const k = Math.min(Math.round(time * rate), count - 1);
    let text = `${time.toFixed(2)} s of ${scene.duration.toFixed(1)} s`;
    if (scene.distances) {
      const [pair, distance] = scene.distances.frames[k];
      text += ` · nearest: ${scene.distances.pairs[pair]}, ${(1000 * distance).toFixed(0)} mm`;
    }
    told.textContent = text;
    slider.value = String(time);
    slider.setAttribute("aria-valuetext", text);
    document.querySelectorAll("[data-joint]").forEach((cell) => {
      cell.textContent = q[k][Number(cell.dataset.joint)].toFixed(3).replace("-", "−");
    });
  }

  function step(now) {
    if (playing && before !== null) {
      time += ((now - before) / 1000) * Number(pace.value);
      if (time > scene.duration) time %= scene.duration;
      wanted = true;
    }
    before = playing ? now : null;
    if (wanted) draw();
    wanted = false;
    window.requestAnimationFrame(step);
  }

  function play(on) {
    playing = on;
    button.textContent = on ? "Pause" : "Play";
  }

  function fit() {
    const ratio = window.devicePixelRatio || 1;
    canvas.width = Math.max(1, Math.round(canvas.clientWidth * ratio));
    canvas.height = Math.max(1, Math.round(canvas.clientHeight * ratio));
    wanted = true;
  }

  function zoom(factor) {
    eye.distance = Math.min(Math.max(eye.distance * factor, 0.6 * scene.size), 20 * scene.size);
    wanted = true;
  }

  canvas.addEventListener("pointerdown", (event) => canvas.setPointerCapture(event.pointerId));
  canvas.addEventListener("pointermove", (event) => {
    if (!canvas.hasPointerCapture(event.pointerId)) return;
    const [x, y] = [event.movementX, event.movementY];
    if (event.shiftKey || event.buttons === 2) {
      const far = eye.distance / (1.6 * Math.min(canvas.clientWidth, canvas.clientHeight));
      eye.at[0] += far * x * Math.sin(eye.yaw);
      eye.at[1] -= far * x * Math.cos(eye.yaw);
      eye.at[2] += far * y;
    } else {
      eye.yaw -= 0.01 * x;
      eye.pitch = Math.min(Math.max(eye.pitch + 0.01 * y, -1.5), 1.5);
    }
    wanted = true;
  });
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoom(Math.exp(0.001 * event.deltaY));
  }, { passive: false });
  canvas.addEventListener("keydown", (event) => {
    const turns = { ArrowLeft: -0.1, ArrowRight: 0.1 };
    const tilts = { ArrowUp: 0.1, ArrowDown: -0.1 };
    if (event.key === " ") play(!playing);
    else if (event.key in turns) eye.yaw += turns[event.key];
    else if (event.key in tilts) eye.pitch += tilts[event.key];
    else if (event.key === "+") zoom(0.9);
    else if (event.key === "-") zoom(1.1);
    else return;
    event.preventDefault();
    wanted = true;
  });
  button.addEventListener("click", () => play(!playing));
  get("arm-home").addEventListener("click", () => {
    eye = { ...home, at: home.at.slice() };
    wanted = true;
  });
  slider.max = String(scene.duration);
  slider.addEventListener("input", () => {
    play(false);
    time = Number(slider.value);
    wanted = true;
  });
  window.addEventListener("resize", fit);
  fit();
  play(!window.matchMedia("(prefers-reduced-motion: reduce)").matches);
  window.requestAnimationFrame(step);
})();
