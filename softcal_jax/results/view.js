// The body of a page in three dimensions: one shaded surface by WebGL 2, and what must
// keep its size on the screen, marks and names, by a canvas above it.
//
// A library would take over the surface and the pointer alone, a fifth of this file:
// three.js, bundled into the one file that a page is, would add 0.5 MB to each page,
// vtk.js 0.9 MB, k3d 2.6 MB.
"use strict";
(() => {
  const byId = (id) => document.getElementById("view-" + id);
  const figure = document.getElementById("view");
  const area = byId("area"), over = byId("over");
  const gl = area.getContext("webgl2", { antialias: true, alpha: true });
  if (!gl) return; // the pictures stay
  const data = JSON.parse(byId("data").textContent);

  // ---- Packed arrays
  const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  const shorts = (text) => new Uint16Array(bytes(text).buffer);
  const indices = (text) => data.wide ? new Uint32Array(bytes(text).buffer) : shorts(text);
  const places = (text) =>
    Float32Array.from(shorts(text), (v, i) => data.low[i % 3] + data.step * v);
  const NONE = 65535, colours = bytes(data.map), paint = data.colours;
  const triangles = indices(data.triangles), edges = indices(data.edges);
  const rest = places(data.rest), rigid = bytes(data.rigid);
  const nTriangles = triangles.length / 3, nPoints = rest.length / 3;
  for (const configuration of data.configurations) {
    configuration.x = places(configuration.points);
    configuration.lines = places(configuration.fibres);
    configuration.walls = configuration.walls && bytes(configuration.walls);
  }

  // ---- Vectors
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const sum = (a, b, s) => [a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]];
  const cross = (a, b) =>
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const unit = (a) => sum([0, 0, 0], a, 1 / (Math.hypot(...a) || 1));
  const turned = (v, axis, angle) => {
    const c = Math.cos(angle), s = Math.sin(angle), w = cross(axis, v);
    const along = dot(axis, v) * (1 - c);
    return [0, 1, 2].map((i) => c * v[i] + s * w[i] + along * axis[i]);
  };

  // ---- Programs
  const VERTEX = `#version 300 es
    uniform mat3 frame; uniform vec3 centre; uniform vec4 scale;
    in vec3 x, normal; in float value;
    out vec3 n; out float v;
    void main() {
      vec3 p = frame * (x - centre);
      n = frame * normal; v = value;
      gl_Position = vec4(p.xy * scale.xy + scale.zw, -p.z * DEPTH, 1.0);
    }`;
  const BODY = `#version 300 es
    precision highp float;
    uniform sampler2D map; uniform vec3 grey; uniform float cover;
    in vec3 n; in float v; out vec4 colour;
    void main() {
      vec3 base = v < 0.0 ? grey : texture(map, vec2(v, 0.5)).rgb;
      vec3 m = normalize(n);
      if (m.z < 0.0) m = -m;
      float light = 0.74 + 0.3 * max(dot(m, normalize(vec3(-0.3, 0.5, 0.8))), 0.0);
      colour = vec4(base * light, 1.0) * cover;
    }`;
  const PLAIN = `#version 300 es
    precision highp float;
    uniform vec4 flat_colour; in vec3 n; in float v; out vec4 colour;
    void main() { colour = vec4(flat_colour.rgb, 1.0) * flat_colour.a; }`;
  const program = (fragment) => {
    const made = gl.createProgram();
    const vertex = VERTEX.replace("DEPTH", (1 / data.farthest).toExponential(6));
    for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      gl.attachShader(made, shader);
    }
    ["x", "normal", "value"].forEach((name, k) => gl.bindAttribLocation(made, k, name));
    gl.linkProgram(made);
    return gl.getProgramParameter(made, gl.LINK_STATUS) ? made : null;
  };
  const body = program(BODY), plain = program(PLAIN);
  if (!body || !plain) return;
  const at = (made, name) => gl.getUniformLocation(made, name);
  const buffer = () => gl.createBuffer();
  const fill = (into, values, target = gl.ARRAY_BUFFER) => {
    gl.bindBuffer(target, into);
    gl.bufferData(target, values, gl.STATIC_DRAW);
  };
  const attribute = (source, k, size) => {
    gl.bindBuffer(gl.ARRAY_BUFFER, source);
    gl.enableVertexAttribArray(k);
    gl.vertexAttribPointer(k, size, gl.FLOAT, false, 0, 0);
  };
  const corners = buffer(), normals = buffer(), values = buffer();
  const solid = gl.createVertexArray();
  gl.bindVertexArray(solid);
  attribute(corners, 0, 3);
  attribute(normals, 1, 3);
  attribute(values, 2, 1);
  const indexed = (x, list) => { // points that share an index
    const mesh = { array: gl.createVertexArray(), x: buffer(), list: buffer() };
    gl.bindVertexArray(mesh.array);
    if (x) fill(mesh.x, x);
    attribute(mesh.x, 0, 3);
    fill(mesh.list, list, gl.ELEMENT_ARRAY_BUFFER);
    return mesh;
  };
  const atRest = indexed(rest, edges), lines = indexed(null, edges);
  const walls = indexed(null, new Uint16Array(0));
  const shapes = data.shapes.map((shape) => {
    const points = new Float32Array(bytes(shape.points).buffer);
    const list = new Uint32Array(bytes(shape.triangles).buffer);
    const mesh = indexed(points, list), n = buffer();
    fill(n, new Float32Array(bytes(shape.normals).buffer));
    attribute(n, 1, 3);
    const fits = points.every((x) => 2 * Math.abs(x) <= NONE * data.step);
    return { ...mesh, points, size: list.length, fits }; // not larger than the robot
  });
  const pointsOf = ({ shape, at: origin, axes }) => { // some of them
    const { points } = shapes[shape], step = 3 * Math.ceil(points.length / 600);
    const some = [];
    for (let k = 0; k < points.length; k += step)
      some.push(axes.reduce((x, axis, j) => sum(x, axis, points[k + j]), origin));
    return some;
  };
  gl.bindVertexArray(null);
  const texture = gl.createTexture();
  gl.bindTexture(gl.TEXTURE_2D, texture);
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB8, 256, 1, 0, gl.RGB, gl.UNSIGNED_BYTE, colours);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE);

  // ---- What is shown
  const state = { pose: 0, field: 0, zoom: 1, shift: [0, 0] };
  const on = (name) => { const box = byId(name); return Boolean(box && box.checked); };
  const pose = () => data.configurations[state.pose];
  const field = () => data.fields[state.field];
  const ofPose = (list) => list[list.length > 1 ? state.pose : 0];

  // Normals of points, averaged where the triangles around one hardly turn.
  const around = (() => {
    const first = new Uint32Array(nPoints + 1);
    for (const p of triangles) first[p + 1]++;
    for (let p = 0; p < nPoints; p++) first[p + 1] += first[p];
    const list = new Uint32Array(triangles.length), next = first.slice();
    triangles.forEach((p, k) => { list[next[p]++] = Math.floor(k / 3); });
    return { first, list };
  })();
  const smooth = (x) => {
    const n = new Float32Array(3 * nTriangles), size = new Float32Array(nTriangles);
    for (let t = 0; t < nTriangles; t++) {
      const [a, b, c] = [0, 1, 2].map((k) => 3 * triangles[3 * t + k]);
      const u = [x[b] - x[a], x[b + 1] - x[a + 1], x[b + 2] - x[a + 2]];
      const v = [x[c] - x[a], x[c + 1] - x[a + 1], x[c + 2] - x[a + 2]];
      const w = cross(u, v);
      n.set(w, 3 * t);
      size[t] = Math.hypot(...w) || 1;
    }
    const averaged = new Float32Array(9 * nTriangles);
    for (let k = 0; k < triangles.length; k++) {
      const tri = Math.floor(k / 3), p = triangles[k], all = [0, 0, 0];
      for (let i = around.first[p]; i < around.first[p + 1]; i++) {
        const t = around.list[i];
        const turn = n[3 * tri] * n[3 * t] + n[3 * tri + 1] * n[3 * t + 1]
          + n[3 * tri + 2] * n[3 * t + 2];
        if (turn < 0.866 * size[tri] * size[t]) continue;
        for (let j = 0; j < 3; j++) all[j] += n[3 * t + j];
      }
      averaged.set(all, 3 * k);
    }
    return averaged;
  };
  const setPose = () => {
    const shown = pose(), all = new Float32Array(9 * nTriangles);
    triangles.forEach((p, k) => all.set(shown.x.subarray(3 * p, 3 * p + 3), 3 * k));
    shown.normals ||= smooth(shown.x);
    fill(corners, all);
    fill(normals, shown.normals);
    fill(lines.x, shown.x);
    if (shown.walls) {
      const list = [];
      triangles.forEach((p, k) => {
        if (shown.walls[Math.floor(k / 3 / data.perFace)]) list.push(p);
      });
      fill(walls.x, shown.x);
      gl.bindVertexArray(walls.array);
      fill(walls.list, data.wide ? Uint32Array.from(list) : Uint16Array.from(list),
        gl.ELEMENT_ARRAY_BUFFER);
      gl.bindVertexArray(null);
      shown.nWalls = list.length;
    }
    setField();
  };
  const setField = () => {
    const scalar = field(), all = new Float32Array(3 * nTriangles).fill(-1);
    const packed = pose().drawn && scalar.place !== "marker" ? ofPose(scalar.values) : null;
    if (packed) {
      const of = shorts(packed), alone = scalar.range[0] === scalar.range[1];
      for (let k = 0; k < all.length; k++) {
        const face = Math.floor(k / 3 / data.perFace);
        const raw = of[scalar.place === "face" ? face : triangles[k]];
        if (raw !== NONE && !rigid[face]) all[k] = alone ? 0.5 : (raw + 0.5) / NONE;
      }
    }
    fill(values, all);
  };

  // ---- The camera: a parallel projection, and one size for all configurations
  let frame, upright, centre, fitted;
  const AXES = { x: [1, 0, 0], y: [0, 1, 0], z: [0, 0, 1] };
  const look = () => {
    const words = byId("direction").selectedOptions[0].textContent.match(/([+-])([xyz])$/);
    if (!words) {
      frame = [data.view.right, data.view.up, data.view.towards];
      upright = Math.abs(frame[1][2]) > 0.5 ? AXES.z : frame[1];
    } else {
      const towards = sum([0, 0, 0], AXES[words[2]], words[1] === "+" ? 1 : -1);
      upright = words[2] === "z" ? AXES.y : AXES.z;
      frame = [cross(upright, towards), upright, towards];
    }
    state.zoom = 1;
    state.shift = [0, 0];
    fit();
  };
  const fit = () => {
    const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
    const see = (x, y, z) => frame.forEach((axis, i) => {
      const t = axis[0] * x + axis[1] * y + axis[2] * z;
      if (t < low[i]) low[i] = t;
      if (t > high[i]) high[i] = t;
    });
    for (const x of [rest, ...data.configurations.map((c) => c.x)])
      for (let k = 0; k < x.length; k += 3) see(x[k], x[k + 1], x[k + 2]);
    for (const configuration of data.configurations)
      for (const mark of configuration.markers)
        for (const p of [mark.measured, mark.simulated]) if (p) see(...p);
    data.view.more.forEach((p) => see(...p));
    for (const { obstacles } of data.configurations)
      for (const obstacle of obstacles)
        if (shapes[obstacle.shape].fits) pointsOf(obstacle).forEach((p) => see(...p));
    centre = [0, 1, 2].map((i) =>
      frame.reduce((t, axis, k) => t + axis[i] * 0.5 * (low[k] + high[k]), 0));
    fitted = [high[0] - low[0] || 1, high[1] - low[1] || 1];
  };
  const perMm = () => {
    const w = area.clientWidth, h = area.clientHeight, margin = Math.min(56, 0.12 * w);
    const fits = Math.min((w - 2 * margin) / fitted[0], (h - 2 * margin - 20) / fitted[1]);
    return fits * state.zoom;
  };
  const project = (p) => {
    const d = sum(p, centre, -1), s = perMm();
    return [
      0.5 * area.clientWidth + s * dot(frame[0], d) + state.shift[0],
      0.5 * area.clientHeight - s * dot(frame[1], d) + state.shift[1],
    ];
  };
  const turn = (right, up) => {
    frame = frame.map((axis) => turned(axis, upright, -right));
    frame = frame.map((axis) => turned(axis, frame[0], up));
    frame = [unit(frame[0]), unit(frame[1]), unit(frame[2])];
    draw();
  };
  const nearer = (by) => {
    state.zoom = Math.min(40, Math.max(0.3, state.zoom * by));
    draw();
  };
  const move = (x, y) => {
    state.shift = [state.shift[0] + x, state.shift[1] + y];
    draw();
  };

  // ---- Drawing
  let asked = false;
  const draw = () => {
    figure.querySelectorAll("[data-of]").forEach((entry) => {
      entry.hidden = !entry.dataset.of.split(" ").some(on);
    });
    if (asked) return;
    asked = true;
    requestAnimationFrame(() => { asked = false; render(); });
  };
  const numbers = (hex) => [1, 3, 5].map((k) => parseInt(hex.slice(k, k + 2), 16) / 255);
  const render = () => {
    const w = area.clientWidth, h = area.clientHeight, dpr = window.devicePixelRatio || 1;
    if (!w || !h) return;
    for (const canvas of [area, over]) {
      canvas.width = Math.round(w * dpr);
      canvas.height = Math.round(h * dpr);
    }
    gl.viewport(0, 0, area.width, area.height);
    gl.clearColor(1, 1, 1, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    const s = perMm(), type = data.wide ? gl.UNSIGNED_INT : gl.UNSIGNED_SHORT;
    const shift = [2 * state.shift[0] / w, -2 * state.shift[1] / h];
    const place = (made, rows, middle) => {
      const columns = [0, 1, 2].flatMap((k) => rows.map((axis) => axis[k]));
      gl.uniformMatrix3fv(at(made, "frame"), false, columns);
      gl.uniform3fv(at(made, "centre"), middle);
    };
    for (const made of [body, plain]) {
      gl.useProgram(made);
      place(made, frame, centre);
      gl.uniform4f(at(made, "scale"), 2 * s / w, 2 * s / h, ...shift);
    }
    const flat = (hex, strength) => {
      gl.useProgram(plain);
      gl.uniform4f(at(plain, "flat_colour"), ...numbers(hex), strength);
    };
    const nRest = data.sharp || edges.length / 2;
    const drawRest = (strength) => {
      gl.disable(gl.DEPTH_TEST);
      flat(paint["at rest"], strength);
      gl.bindVertexArray(atRest.array);
      gl.drawElements(gl.LINES, 2 * nRest, type, 0);
    };
    if (on("rest")) drawRest(1);
    gl.enable(gl.DEPTH_TEST);
    gl.useProgram(body);
    const bare = field().place === "marker" || !pose().drawn;
    gl.uniform3fv(at(body, "grey"), numbers(bare ? "#e4e4e4" : paint["rigid body"]));
    gl.uniform1f(at(body, "cover"), 1);
    gl.bindVertexArray(solid);
    gl.enable(gl.POLYGON_OFFSET_FILL);
    gl.polygonOffset(1, 1);
    gl.drawArrays(gl.TRIANGLES, 0, 3 * nTriangles);
    gl.disable(gl.POLYGON_OFFSET_FILL);
    gl.bindVertexArray(lines.array);
    if (on("mesh")) {
      flat("#000000", 0.35);
      gl.drawElements(gl.LINES, edges.length, type, 0);
    }
    flat("#000000", 0.6);
    gl.drawElements(gl.LINES, 2 * data.sharp, type, 0);
    if (on("obstacles")) drawObstacles(place);
    gl.disable(gl.DEPTH_TEST);
    if (pose().nWalls && on("robot")) {
      flat(paint["wall under pressure"], 0.25);
      gl.bindVertexArray(walls.array);
      gl.drawElements(gl.TRIANGLES, pose().nWalls, type, 0);
    }
    if (on("rest")) drawRest(0.45);
    gl.bindVertexArray(null);
    mark(w, h, dpr, s);
  };

  const drawObstacles = (place) => {
    gl.useProgram(body);
    gl.uniform3fv(at(body, "grey"), numbers(paint.obstacle));
    gl.uniform1f(at(body, "cover"), 0.5);
    gl.vertexAttrib1f(2, -1); // without a value: grey
    // First their depth alone, so that only what is in front covers the robot.
    for (const visible of [false, true]) {
      gl.colorMask(visible, visible, visible, visible);
      gl.depthFunc(gl.LEQUAL);
      for (const { shape, at: origin, axes } of pose().obstacles) {
        const inFrame = (v) => axes.map((axis) => dot(axis, v));
        place(body, frame.map(inFrame), inFrame(sum(centre, origin, -1)));
        gl.bindVertexArray(shapes[shape].array);
        gl.drawElements(gl.TRIANGLES, shapes[shape].size, gl.UNSIGNED_INT, 0);
      }
    }
    gl.depthFunc(gl.LESS);
  };
  const besideOf = (obstacle, w, h) => {
    // Where it is seen farthest up and right, since a name goes on to the right; what is
    // larger than the robot, farthest from the middle.
    const { fits } = shapes[obstacle.shape];
    const score = ([right, down]) =>
      fits ? right - down : Math.hypot(right - w / 2, down - h / 2);
    const seen = pointsOf(obstacle).map(project).filter(([right, down]) =>
      right > 20 && right < w - 90 && down > 20 && down < h - 110);
    seen.sort((a, b) => score(b) - score(a));
    return seen[0] ?? project(obstacle.at);
  };

  // ---- Marks and names
  const mark = (w, h, dpr, s) => {
    const pen = over.getContext("2d"), shown = pose(), names = [];
    pen.setTransform(dpr, 0, 0, dpr, 0, 0);
    pen.clearRect(0, 0, w, h);
    pen.lineCap = "round";
    pen.lineJoin = "round";
    pen.textBaseline = "middle";
    const path = (points, colour, width, dash = [], rim = 3) => {
      pen.beginPath();
      points.forEach((p, k) => (k ? pen.lineTo(...p) : pen.moveTo(...p)));
      pen.setLineDash([]);
      if (rim) {
        pen.strokeStyle = "rgba(255, 255, 255, 0.85)";
        pen.lineWidth = width + rim;
        pen.stroke();
      }
      pen.setLineDash(dash);
      pen.strokeStyle = colour;
      pen.lineWidth = width;
      pen.stroke();
      pen.setLineDash([]);
    };
    const arrow = (start, end, colour) => {
      const along = Math.hypot(end[0] - start[0], end[1] - start[1]);
      pen.fillStyle = colour;
      if (along < 6) { // it points at the reader, or away
        pen.beginPath();
        pen.arc(...end, 5, 0, 2 * Math.PI);
      } else {
        const d = [(end[0] - start[0]) / along, (end[1] - start[1]) / along];
        const back = (f, g) =>
          [end[0] - f * d[0] - g * d[1], end[1] - f * d[1] + g * d[0]];
        path([start, back(8, 0)], colour, 2.5);
        path([end, back(11, 5), back(11, -5), end], colour, 1, [], 2);
      }
      pen.fill();
    };
    const arrows = (kind) => {
      for (const { tip, towards, name } of shown.arrows.filter((a) => a.kind === kind)) {
        const start = project(sum(tip, towards, -46 / s));
        arrow(start, project(tip), paint.force);
        names.push([name, start]);
      }
    };
    if (shown.drawn && on("fibres")) {
      pen.beginPath();
      for (let k = 0; k < shown.lines.length; k += 6) {
        pen.moveTo(...project(shown.lines.subarray(k, k + 3)));
        pen.lineTo(...project(shown.lines.subarray(k + 3, k + 6)));
      }
      pen.strokeStyle = paint.fibre;
      pen.lineWidth = 1.3;
      pen.stroke();
    }
    if (on("robot")) {
      for (const cable of shown.cables) {
        let longest = [0, null];
        for (const segment of cable.segments) {
          const ends = segment.map(project);
          path(ends, paint.cable, 2.5, cable.slack ? [2, 5] : []);
          const length = Math.hypot(ends[0][0] - ends[1][0], ends[0][1] - ends[1][1]);
          const middle = [0, 1].map((i) => 0.5 * (ends[0][i] + ends[1][i]));
          if (length >= longest[0]) longest = [length, middle];
        }
        names.push([cable.name, longest[1]]);
      }
      shown.wallNames.forEach((wall) => names.push([wall.name, project(wall.at)]));
      for (const motor of shown.motors) {
        const ends = [-30, 30].map((t) => project(sum(motor.at, motor.axis, t / s)));
        path(ends, paint.motor, 2.5, [8, 3, 2, 3]);
        names.push([motor.name, project(motor.at)]);
      }
      arrows("force");
    }
    if (on("loads")) arrows("load");
    if (on("obstacles"))
      for (const o of shown.obstacles) names.push([o.name, besideOf(o, w, h)]);
    if (on("frames"))
      for (const f of shown.frames) {
        const colour = paint[f.kind];
        const dash = f.kind === "frame of a rigid body" ? [4, 4] : [];
        f.axes.forEach((axis) =>
          path([project(f.at), project(sum(f.at, axis, 26 / s))], colour, 2, dash));
        if (f.name) names.push([f.name, project(f.at)]);
      }
    const [marks, points] = on("markers") ? drawMarkers(pen, path) : [[], []];
    corner(pen, path, arrow, w, h, s);
    if (on("names")) write(pen, [...points, ...names], marks, w, h);
  };
  const drawMarkers = (pen, path) => {
    const names = [], marks = [];
    const scalar = field(), of = scalar.place === "marker" && ofPose(scalar.values);
    const shares = of ? shorts(of) : null;
    pose().markers.forEach((marker, k) => {
      const a = marker.measured && project(marker.measured);
      const b = marker.simulated && project(marker.simulated);
      if (a && b) path([a, b], paint.measured, 2, [], 2);
      if (a) {
        const filled = shares && shares[k] !== NONE;
        for (const [width, colour] of [[5, "#ffffff"], [2.2, paint.measured]]) {
          pen.beginPath();
          pen.arc(...a, filled ? 8 : 6, 0, 2 * Math.PI);
          pen.lineWidth = width;
          pen.strokeStyle = colour;
          pen.stroke();
        }
        if (filled) {
          const c = Math.round(255 * shares[k] / (NONE - 1));
          pen.fillStyle = `rgb(${colours.subarray(3 * c, 3 * c + 3).join()})`;
          pen.fill();
        }
      }
      if (b)
        for (const [width, colour] of [[5, "#ffffff"], [2.2, paint.simulated]]) {
          pen.beginPath();
          pen.moveTo(b[0] - 6, b[1]);
          pen.lineTo(b[0] + 6, b[1]);
          pen.moveTo(b[0], b[1] - 6);
          pen.lineTo(b[0], b[1] + 6);
          pen.lineWidth = width;
          pen.strokeStyle = colour;
          pen.stroke();
        }
      let name = marker.name;
      if (shares && shares[k] !== NONE) {
        const [low, high] = scalar.range;
        const value = low + (high - low) * shares[k] / (NONE - 1);
        name += `: ${digits(value, high - low)} ${scalar.unit}`;
      }
      const place = a || b;
      if (place) marks.push(place);
      if (place && (shares || pose().markers.length <= 16)) names.push([name, place]);
    });
    return [marks, names];
  };
  const FONT = '13px system-ui, "Segoe UI", Roboto, Arial, sans-serif';
  const letter = (pen, text, x, y, colour = "#1a1a1a") => {
    pen.strokeStyle = "rgba(255, 255, 255, 0.9)";
    pen.lineWidth = 4;
    pen.strokeText(text, x, y);
    pen.fillStyle = colour;
    pen.fillText(text, x, y);
  };
  const write = (pen, names, marks, w, h) => {
    // Move names up or down until none covers another, or what is in the corners.
    const taken = marks.map(([x, y]) => [x - 7, y, 12]);
    pen.font = FONT;
    const written = new Set();
    for (const [whole, place] of names) {
      // Where there is little room, a table says what drives an actuator.
      const name = w < 480 && field().place !== "marker" ? whole.split(":")[0] : whole;
      // A body is often named as what drives it, or as its marker.
      if (!name || !place || written.has(name)) continue;
      if (place[0] < 0 || place[0] > w || place[1] < 0 || place[1] > h) continue;
      written.add(name).add(name.split(":")[0]);
      const long = pen.measureText(name).width;
      const x = Math.max(4, Math.min(place[0] + 13, w - long - 4));
      const isRight = x + long > w - 30 - Math.min(140, 0.3 * w);
      const lowest = h - (x < 150 ? 74 : isRight ? 42 : 8);
      const free = (y) => y > 8 && y < lowest && taken.every((t) =>
        x > t[0] + t[2] + 4 || x + long + 4 < t[0] || Math.abs(y - t[1]) > 15);
      const ways = [-11, 11, -27, 27, -43, 43, -59, 59].map((d) => place[1] + d);
      const y = ways.find(free) ?? ways[0];
      taken.push([x, y, long]);
      letter(pen, name, x, y);
    }
  };
  const corner = (pen, path, arrow, w, h, s) => {
    // The axes, gravity, and a length.
    const from = [44, h - 40], seen = ([right, up]) => [right, -up];
    const axes = [0, 1, 2].map((k) => seen([frame[0][k], frame[1][k]]));
    pen.font = "bold " + FONT;
    pen.textAlign = "center";
    ["#c0392b", "#1e8449", "#1f4fa0"].forEach((colour, k) => {
      const d = axes[k], long = Math.hypot(...d);
      // The letter of an axis that points at the reader stands opposite to the others.
      const others = [0, 1].map((i) => axes[0][i] + axes[1][i] + axes[2][i] - d[i]);
      const off = long > 0.15 ? 22 + 9 / long : 0;
      const [x, y] = off ? [off * d[0], off * d[1]] : [-8 * others[0], -8 * others[1]];
      path([from, [from[0] + 22 * d[0], from[1] + 22 * d[1]]], colour, 2.2, [], 2);
      letter(pen, "xyz"[k], from[0] + x, from[1] + y, colour);
    });
    if (on("loads") && pose().gravity) {
      const g = seen([dot(frame[0], pose().gravity), dot(frame[1], pose().gravity)]);
      const [start, end] = [-15, 15].map((t) => [112 + t * g[0], h - 36 + t * g[1]]);
      arrow(start, end, paint.gravity);
      letter(pen, "g", 138, h - 36, paint.gravity);
    }
    const room = Math.min(140, 0.3 * w) / s, power = 10 ** Math.floor(Math.log10(room));
    const length = [5, 2, 1].map((k) => k * power).find((l) => l <= room);
    const right = w - 16, left = right - length * s, y = h - 16;
    for (const [a, b] of [[[left, -4], [left, 4]], [[right, -4], [right, 4]],
      [[left, 0], [right, 0]]])
      path([[a[0], y + a[1]], [b[0], y + b[1]]], "#1a1a1a", 2, [], 2);
    pen.font = FONT;
    letter(pen, `${Number(length.toPrecision(3))} mm`, 0.5 * (left + right), y - 13);
    pen.textAlign = "left";
  };

  // ---- Words
  const digits = (value, range) => { // with as many decimals as tell the range apart
    const decimals = 2 - Math.floor(Math.log10(Math.abs(range) || 1));
    return value.toFixed(Math.min(8, Math.max(0, decimals)));
  };
  const tell = () => {
    const scalar = field(), [low, high] = scalar.range, unit = scalar.unit && " " + scalar.unit;
    const constant = high === low, name = scalar.label.replace(/ \[[^\]]*\]$/, "");
    const stops = [0, 32, 64, 96, 128, 160, 192, 224, 255].map((c) =>
      `rgb(${colours.subarray(3 * c, 3 * c + 3).join()})`);
    byId("colours").style.background =
      constant ? stops[4] : `linear-gradient(to right, ${stops.join()})`;
    byId("title").textContent = constant ? `${name}: ${digits(low, low)}${unit}` : scalar.label;
    [...byId("ticks").children].forEach((tick, k) => {
      tick.textContent = constant ? "" : digits(low + 0.25 * k * (high - low), high - low);
    });
    byId("ticks").hidden = constant;
    const range = constant ? `${digits(low, low)}${unit} everywhere`
      : `${digits(low, high - low)} to ${digits(high, high - low)}${unit}`;
    byId("scale").setAttribute("aria-label", `Colours: ${name}, ${range}`);
    const words = document.querySelectorAll("#view-words > p:not([role])");
    words.forEach((p, k) => { p.hidden = k !== state.pose; });
    let text = "";
    if (pose().drawn) {
      const largest = ofPose(scalar.largest);
      text = scalar.note;
      if (!constant && largest !== null)
        text = `Up to ${digits(largest, high - low)}${unit} here. ${text}`;
      if (scalar.values.length > 1 && data.configurations.length > 1)
        text += " The colours mean the same in all configurations.";
    }
    document.querySelector("#view-words > [role]").textContent = text;
    byId("scale").hidden = !pose().drawn;
    const shown = byId("configuration").selectedOptions[0].textContent;
    area.setAttribute("aria-label", `Three-dimensional view of ${shown}, coloured by ${name}`);
  };

  // ---- Controls
  const choose = () => {
    state.pose = byId("configuration").selectedIndex;
    state.field = byId("field").selectedIndex;
    setPose();
    tell();
    draw();
  };
  byId("configuration").addEventListener("change", choose);
  byId("field").addEventListener("change", choose);
  byId("direction").addEventListener("change", () => { look(); draw(); });
  figure.querySelectorAll("input").forEach((box) => box.addEventListener("change", draw));
  const STEP = Math.PI / 18;
  const ACTIONS = {
    left: () => turn(-STEP, 0),
    right: () => turn(STEP, 0),
    up: () => turn(0, STEP),
    down: () => turn(0, -STEP),
    nearer: () => nearer(1.25),
    farther: () => nearer(0.8),
    reset: () => { look(); draw(); },
  };
  for (const [name, act] of Object.entries(ACTIONS))
    byId(name).addEventListener("click", act);
  const KEYS = { ArrowLeft: "left", ArrowRight: "right", ArrowUp: "up", ArrowDown: "down",
    "+": "nearer", "=": "nearer", "-": "farther", Home: "reset" };
  const MOVES = { ArrowLeft: [-30, 0], ArrowRight: [30, 0], ArrowUp: [0, -30],
    ArrowDown: [0, 30] };
  area.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.altKey || event.metaKey) return;
    if (event.shiftKey && MOVES[event.key]) move(...MOVES[event.key]);
    else if (KEYS[event.key]) ACTIONS[KEYS[event.key]]();
    else return;
    event.preventDefault();
  });
  const fingers = new Map();
  area.addEventListener("pointerdown", (event) => {
    fingers.set(event.pointerId, [event.clientX, event.clientY]);
    area.setPointerCapture(event.pointerId);
  });
  area.addEventListener("pointermove", (event) => {
    const last = fingers.get(event.pointerId);
    if (!last) return;
    const now = [event.clientX, event.clientY], d = [now[0] - last[0], now[1] - last[1]];
    const other = [...fingers].find(([id]) => id !== event.pointerId);
    if (other) {
      const apart = (p) => Math.hypot(p[0] - other[1][0], p[1] - other[1][1]) || 1;
      move(0.5 * d[0], 0.5 * d[1]);
      nearer(apart(now) / apart(last));
    } else if (event.shiftKey) move(...d);
    else turn(0.01 * d[0], -0.01 * d[1]);
    fingers.set(event.pointerId, now);
  });
  for (const end of ["pointerup", "pointercancel"])
    area.addEventListener(end, (event) => fingers.delete(event.pointerId));
  area.addEventListener("wheel", (event) => {
    if (document.activeElement !== area) return; // the page scrolls
    event.preventDefault();
    nearer(Math.exp(-0.0015 * event.deltaY));
  }, { passive: false });
  const here = document.documentElement;
  area.addEventListener("webglcontextlost", () => {
    figure.hidden = true;
    here.classList.remove("has-view"); // back to the pictures
  });

  look();
  choose();
  figure.hidden = false;
  here.classList.add("has-view");
  new ResizeObserver(draw).observe(area);
})();
