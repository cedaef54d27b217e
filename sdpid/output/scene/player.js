"use strict";
// Plays a robot on a page, drawn by WebGL: links, inertia ellipsoids and lines. It loads nothing.
// Without WebGL it leaves the picture that stands in the page.
(() => {
  const get = (id) => document.getElementById(id);
  const scene = JSON.parse(get("scene-data").textContent);
  const whole = get("scene"), canvas = get("scene-view"), slider = get("scene-time");
  const button = get("scene-play"), pace = get("scene-pace"), told = get("scene-told");
  const gl = canvas.getContext("webgl2", { antialias: true, preserveDrawingBuffer: true });
  if (!gl) return;

  // ---- what the page holds -------------------------------------------------------------------
  const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer;
  function unpacked({ low, high, data }) {
    const steps = new Uint16Array(bytes(data)), n = low.length;
    return Float32Array.from(steps, (s, k) => low[k % n] + ((high[k % n] - low[k % n]) * s) / 65534);
  }
  const { rate, count } = scene.frames, poses = unpacked(scene.frames.poses);
  const q = unpacked(scene.frames.q), links = poses.length / (7 * count);
  const width = q.length / count, duration = (count - 1) / rate;
  const instants = scene.frames.instants && unpacked(scene.frames.instants);
  const groups = Object.fromEntries(scene.groups.map((each) => [each.key, { ...each, shown: true }]));
  const paint = (color) => [1, 3, 5].map((k) => parseInt(color.slice(k, k + 2), 16) / 255);

  // ---- vectors and matrices, these column by column --------------------------------------------
  const minus = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const unit = (a) => { const n = Math.hypot(...a) || 1; return [a[0] / n, a[1] / n, a[2] / n]; };
  const still = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1];

  // Placement of a link at a time: between two frames position and quaternion are blended.
  function placement(link, when) {
    if (link < 0) return still;
    const x = Math.min(when * rate, count - 1), k = Math.min(Math.floor(x), Math.max(count - 2, 0));
    const s = x - k, a = 7 * (k * links + link), b = count > 1 ? a + 7 * links : a;
    let near = 0;
    for (let i = 3; i < 7; i++) near += poses[a + i] * poses[b + i];
    const v = [0, 1, 2, 3, 4, 5, 6].map(
      (i) => (1 - s) * poses[a + i] + s * (i > 2 && near < 0 ? -1 : 1) * poses[b + i]);
    const n = Math.hypot(v[3], v[4], v[5], v[6]) || 1;
    const [i, j, l, w] = [v[3] / n, v[4] / n, v[5] / n, v[6] / n];
    return [1 - 2 * (j * j + l * l), 2 * (i * j + l * w), 2 * (i * l - j * w), 0,
      2 * (i * j - l * w), 1 - 2 * (i * i + l * l), 2 * (j * l + i * w), 0,
      2 * (i * l + j * w), 2 * (j * l - i * w), 1 - 2 * (i * i + j * j), 0, v[0], v[1], v[2], 1];
  }
  const moved = (m, p) => [0, 1, 2].map((i) => m[i] * p[0] + m[4 + i] * p[1] + m[8 + i] * p[2] + m[12 + i]);

  // ---- what is drawn ---------------------------------------------------------------------------
  // Triangles with a normal at each corner: that of the faces around it that meet at less than 45°.
  function faceted(points, faces) {
    const at = (k) => [points[3 * k], points[3 * k + 1], points[3 * k + 2]], around = new Map();
    const normals = [];
    for (let f = 0; f < faces.length; f += 3) {
      const [a, b, c] = [at(faces[f]), at(faces[f + 1]), at(faces[f + 2])];
      const n = cross(minus(b, a), minus(c, a)), size = Math.hypot(...n) || 1;
      normals.push([n[0] / size, n[1] / size, n[2] / size, size]);
      for (let k = 0; k < 3; k++) {
        if (!around.has(faces[f + k])) around.set(faces[f + k], []);
        around.get(faces[f + k]).push(normals.length - 1);
      }
    }
    const out = new Float32Array(6 * faces.length);
    faces.forEach((corner, k) => {
      const own = normals[Math.floor(k / 3)], sum = [0, 0, 0];
      for (const f of around.get(corner)) {
        const other = normals[f];
        if (dot(own, other) > 0.7) for (let i = 0; i < 3; i++) sum[i] += other[3] * other[i];
      }
      out.set(at(corner), 6 * k);
      out.set(unit(sum), 6 * k + 3);
    });
    return out;
  }

  // A ball of triangles, stretched: corners, and normals, which stretch the other way.
  function ellipsoid({ center, axes, lengths }) {
    const out = [], rows = 20, columns = 32;
    const corner = (r, c) => {
      const [t, u] = [(Math.PI * r) / rows, (2 * Math.PI * c) / columns];
      const s = [Math.sin(t) * Math.cos(u), Math.sin(t) * Math.sin(u), Math.cos(t)];
      const sum = (by) => [0, 1, 2].map((i) => axes.reduce((v, axis, k) => v + axis[i] * by(s[k], lengths[k]), 0));
      const p = sum((x, a) => x * a), n = unit(sum((x, a) => x / a));
      out.push(p[0] + center[0], p[1] + center[1], p[2] + center[2], ...n);
    };
    for (let r = 0; r < rows; r++) {
      for (let c = 0; c < columns; c++) {
        [[0, 0], [1, 0], [1, 1], [0, 0], [1, 1], [0, 1]].forEach(([i, j]) => corner(r + i, c + j));
      }
    }
    return Float32Array.from(out);
  }

  // The ellipses in the planes of its axes, as pairs of points.
  function rings({ center, axes, lengths }) {
    const out = [], parts = 64;
    for (let plane = 0; plane < 3; plane++) {
      const [a, b] = [(plane + 1) % 3, (plane + 2) % 3];
      for (let k = 0; k < 2 * parts; k++) {
        const t = (2 * Math.PI * Math.ceil(k / 2)) / parts;
        const [x, y] = [lengths[a] * Math.cos(t), lengths[b] * Math.sin(t)];
        out.push(...[0, 1, 2].map((i) => center[i] + x * axes[a][i] + y * axes[b][i]));
      }
    }
    return bare(Float32Array.from(out));
  }

  // Lines have no normal.
  function bare(points) {
    const out = new Float32Array(2 * points.length);
    for (let k = 0; k < points.length; k += 3) out.set(points.subarray(k, k + 3), 2 * k);
    return out;
  }

  function shader(kind, text) {
    const made = gl.createShader(kind);
    gl.shaderSource(made, `#version 300 es\nprecision highp float;\n${text}`);
    gl.compileShader(made);
    return made;
  }
  const program = gl.createProgram();
  gl.attachShader(program, shader(gl.VERTEX_SHADER, `
    layout(location = 0) in vec3 place; layout(location = 1) in vec3 normal;
    uniform mat4 lens, model; out vec3 p, n;
    void main() {
      p = (model * vec4(place, 1.0)).xyz;
      n = mat3(model) * normal;
      gl_Position = lens * vec4(p, 1.0);
    }`));
  // Light from above and from the eye; what is seen through is denser at its rim.
  gl.attachShader(program, shader(gl.FRAGMENT_SHADER, `
    in vec3 p, n; uniform vec3 eye; uniform vec4 color; uniform float rim; out vec4 shown;
    void main() {
      if (dot(n, n) < 0.1) { shown = color; return; }
      vec3 v = normalize(eye - p), m = normalize(n);
      if (dot(v, m) < 0.0) m = -m;
      float c = dot(v, m), light = 0.42 + 0.36 * c + 0.22 * (0.5 + 0.5 * m.z);
      shown = vec4(light * color.rgb, color.a + rim * (1.0 - color.a) * smoothstep(0.5, 0.1, c));
    }`));
  gl.linkProgram(program);
  gl.useProgram(program);
  const knob = Object.fromEntries(["lens", "model", "eye", "color", "rim"].map(
    (name) => [name, gl.getUniformLocation(program, name)]));

  function kept(values, mode) {
    const array = gl.createVertexArray();
    gl.bindVertexArray(array);
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, values, gl.STATIC_DRAW);
    for (const k of [0, 1]) {
      gl.enableVertexAttribArray(k);
      gl.vertexAttribPointer(k, 3, gl.FLOAT, false, 24, 12 * k);
    }
    return { array, mode, count: values.length / 6 };
  }
  const surfaces = scene.surfaces.map((each) => ({ ...each, rgb: paint(each.color || groups[each.group].color),
    ...kept(faceted(unpacked(each.points), new Uint32Array(bytes(each.faces))), gl.TRIANGLES) }));
  const ellipsoids = scene.ellipsoids.map((each) => {
    const own = { ...each, rgb: paint(groups[each.group].color) };
    return { solid: { ...own, ...kept(ellipsoid(each), gl.TRIANGLES) },
      rings: { ...own, ...kept(rings(each), gl.LINES) }, ...each };
  });
  const lines = scene.lines.map((each) => ({ link: -1, rgb: [0.5, 0.5, 0.5],
    ...kept(bare(unpacked(each.points)), each.pairs ? gl.LINES : gl.LINE_STRIP) }));

  // ---- the view --------------------------------------------------------------------------------
  const [yaw, pitch, distance] = scene.eye;
  const home = () => ({ yaw, pitch, distance, at: scene.center.slice() });
  let eye = home(), time = 0, playing = false, before = null, wanted = true, seen = true;

  const dark = window.matchMedia("(prefers-color-scheme: dark)");
  dark.addEventListener("change", () => { wanted = true; });

  function middle() {
    if (!scene.follow) return eye.at;
    const [a, b] = [placement(0, 0), placement(0, time)];
    return eye.at.map((x, i) => x + b[12 + i] - a[12 + i]);
  }

  function lens() {
    const [cy, sy, cp, sp] = [Math.cos(eye.yaw), Math.sin(eye.yaw), Math.cos(eye.pitch), Math.sin(eye.pitch)];
    const right = [-sy, cy, 0], up = [-sp * cy, -sp * sy, cp], back = [cp * cy, cp * sy, sp];
    const at = middle(), from = at.map((x, i) => x + eye.distance * back[i]);
    const less = Math.min(canvas.width, canvas.height);
    const [fx, fy] = [(3.2 * less) / canvas.width, (3.2 * less) / canvas.height];
    const near = 0.02 * scene.size, far = 60 * scene.size;
    const [z, shift] = [-(far + near) / (far - near), (-2 * far * near) / (far - near)];
    const out = [];
    for (let i = 0; i < 3; i++) out.push(fx * right[i], fy * up[i], z * back[i], -back[i]);
    out.push(-fx * dot(right, from), -fy * dot(up, from), shift - z * dot(back, from), dot(back, from));
    return { matrix: out, from, back };
  }

  function put(each, places, opacity, rim) {
    gl.uniformMatrix4fv(knob.model, false, places(each.link));
    // On a dark page colors are lighter.
    const white = dark.matches ? 0.3 : 0;
    gl.uniform4f(knob.color, ...each.rgb.map((c) => c + white * (1 - c)), opacity);
    gl.uniform1f(knob.rim, rim);
    gl.bindVertexArray(each.array);
    gl.drawArrays(each.mode, 0, each.count);
  }

  function draw() {
    const { matrix, from, back } = lens(), known = new Map();
    const places = (link) => {
      if (!known.has(link)) known.set(link, placement(link, time));
      return known.get(link);
    };
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    gl.depthFunc(gl.LEQUAL);
    gl.enable(gl.BLEND);
    gl.blendFuncSeparate(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA, gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    gl.uniformMatrix4fv(knob.lens, false, matrix);
    gl.uniform3f(knob.eye, ...from);
    for (const each of lines) put(each, places, 0.5, 0);
    const shown = scene.groups.filter((each) => groups[each.key].shown);
    const of = (group) => surfaces.filter((each) => each.group === group.key);
    for (const group of shown) if (group.opacity === 1) for (const each of of(group)) put(each, places, 1, 0);
    // Of links that are seen through, the nearest side.
    for (const group of shown.filter((each) => each.opacity < 1)) {
      gl.colorMask(false, false, false, false);
      for (const each of of(group)) put(each, places, 1, 0);
      gl.colorMask(true, true, true, true);
      for (const each of of(group)) put(each, places, group.opacity, 0.5);
    }
    // Ellipsoids before all that, from far to near, each seen through.
    const depth = (each) => dot(moved(places(each.link), each.center), back);
    gl.disable(gl.DEPTH_TEST);
    gl.enable(gl.CULL_FACE);
    ellipsoids.filter((each) => groups[each.group].shown).sort((a, b) => depth(a) - depth(b))
      .forEach((each) => {
        put(each.solid, places, groups[each.group].filled, 1);
        put(each.rings, places, 0.8, 0);
      });
    gl.disable(gl.CULL_FACE);
    tell();
  }

  function tell() {
    const k = Math.min(Math.round(time * rate), count - 1);
    let text = `${time.toFixed(2)} s of ${duration.toFixed(1)} s`;
    if (scene.distances) {
      const [pair, gap] = scene.distances.frames[k];
      text += ` · nearest: ${scene.distances.pairs[pair]}, ${(1000 * gap).toFixed(0)} mm`;
    }
    told.textContent = text;
    slider.value = String(time);
    slider.setAttribute("aria-valuetext", text);
    document.querySelectorAll("[data-joint]").forEach((cell) => {
      cell.textContent = q[k * width + Number(cell.dataset.joint)].toFixed(3).replace("-", "−");
    });
  }

  // ---- controls --------------------------------------------------------------------------------
  function step(now) {
    if (playing && seen && before !== null) {
      time += ((now - before) / 1000) * Number(pace.value);
      if (time > duration) time %= duration || 1;
      wanted = true;
    }
    before = playing ? now : null;
    if (wanted && !gl.isContextLost()) draw();
    wanted = false;
    window.requestAnimationFrame(step);
  }

  function play(on) {
    playing = on && count > 1;
    button.textContent = playing ? "Pause" : "Play";
  }

  function fit() {
    const ratio = window.devicePixelRatio || 1;
    canvas.width = Math.max(1, Math.round(canvas.clientWidth * ratio));
    canvas.height = Math.max(1, Math.round(canvas.clientHeight * ratio));
    wanted = true;
  }

  function zoom(factor) {
    eye.distance = Math.min(Math.max(eye.distance * factor, 0.2 * scene.size), 20 * scene.size);
    wanted = true;
  }

  function turn(x, y) {
    eye.yaw -= x;
    eye.pitch = Math.min(Math.max(eye.pitch + y, -1.5), 1.5);
    wanted = true;
  }

  function shift(x, y) {
    const far = eye.distance / (1.6 * Math.min(canvas.clientWidth, canvas.clientHeight));
    eye.at[0] += far * x * Math.sin(eye.yaw);
    eye.at[1] -= far * x * Math.cos(eye.yaw);
    eye.at[2] += far * y;
    wanted = true;
  }

  // One finger or the mouse turns; two fingers shift and zoom.
  const fingers = new Map();
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, [event.clientX, event.clientY]);
  });
  for (const kind of ["pointerup", "pointercancel"]) {
    canvas.addEventListener(kind, (event) => fingers.delete(event.pointerId));
  }
  canvas.addEventListener("pointermove", (event) => {
    const last = fingers.get(event.pointerId);
    if (!last) return;
    const now = [event.clientX, event.clientY], [x, y] = [now[0] - last[0], now[1] - last[1]];
    const other = [...fingers].filter(([id]) => id !== event.pointerId).map(([, place]) => place)[0];
    if (other) {
      const apart = (a) => Math.hypot(a[0] - other[0], a[1] - other[1]) || 1;
      zoom(apart(last) / apart(now));
      shift(0.5 * x, 0.5 * y);
    } else if (event.shiftKey || event.buttons === 2) shift(x, y);
    else turn(0.01 * x, 0.01 * y);
    fingers.set(event.pointerId, now);
  });
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  // The wheel scrolls the page until the picture is clicked.
  canvas.addEventListener("wheel", (event) => {
    if (document.activeElement !== canvas && !event.ctrlKey) return;
    event.preventDefault();
    zoom(Math.exp(0.001 * event.deltaY));
  }, { passive: false });
  const reset = () => { eye = home(); wanted = true; };
  const keys = { " ": () => play(!playing), "+": () => zoom(0.9), "-": () => zoom(1.1), 0: reset,
    ArrowLeft: () => turn(0.1, 0), ArrowRight: () => turn(-0.1, 0),
    ArrowUp: () => turn(0, 0.1), ArrowDown: () => turn(0, -0.1) };
  canvas.addEventListener("keydown", (event) => {
    if (!Object.hasOwn(keys, event.key) || event.ctrlKey || event.metaKey || event.altKey) return;
    keys[event.key]();
    event.preventDefault();
  });
  button.addEventListener("click", () => play(!playing));
  get("scene-home").addEventListener("click", reset);
  slider.addEventListener("input", () => {
    play(false);
    time = Number(slider.value);
    wanted = true;
  });
  document.querySelectorAll("[data-group]").forEach((box) => box.addEventListener("change", () => {
    groups[box.dataset.group].shown = box.checked;
    wanted = true;
  }));
  // The cursor of a chart over time shows the robot at that instant, beside the chart.
  window.addEventListener("chart-time", ({ detail: instant }) => {
    let frame = instant === null ? -1 : instant * rate;
    if (instants && frame >= 0) frame = instants.findIndex((each) => each >= instant);
    const { top, bottom } = canvas.parentElement.getBoundingClientRect();
    const beside = frame >= 0 && frame <= count - 1 && (bottom < 0 || top > window.innerHeight);
    if (whole.classList.toggle("beside", beside) !== (canvas.clientWidth < canvas.parentElement.clientWidth)) fit();
    if (frame < 0 || frame > count - 1) return;
    play(false);
    time = frame / rate;
    wanted = true;
  });
  canvas.addEventListener("webglcontextlost", () => whole.classList.remove("live"));
  window.addEventListener("resize", fit);
  // Out of sight nothing moves.
  new IntersectionObserver(([entry]) => { seen = entry.isIntersecting; }).observe(canvas);
  whole.classList.add("live");
  fit();
  play(!window.matchMedia("(prefers-reduced-motion: reduce)").matches);
  window.requestAnimationFrame(step);
})();
