"use strict";
(() => {
const data = JSON.parse(document.getElementById("data").textContent);
const bytes = name => Uint8Array.from(atob(data[name]), c => c.charCodeAt(0));
const get = id => document.getElementById(id);
const {rows, columns} = data, count = rows * columns;
const heights = new Uint16Array(bytes("height").buffer);
const known = i => heights[i] !== 65535;
const z = i => data.zMin + heights[i] / 65534 * (data.zMax - data.zMin);
const x = i => data.x0 + (i % columns + 0.5) * data.cell;
const y = i => data.y0 + (Math.floor(i / columns) + 0.5) * data.cell;

// Vertices, triangles and normals
const place = new Int32Array(count).fill(-1), cells = [];
for (let i = 0; i < count; i++) if (known(i)) { place[i] = cells.length; cells.push(i); }
const n = cells.length, positions = new Float32Array(3 * n), normals = new Float32Array(3 * n);
cells.forEach((cell, k) => positions.set([x(cell), y(cell), z(cell)], 3 * k));
const faces = [];
for (let r = 0; r + 1 < rows; r++) for (let c = 0; c + 1 < columns; c++) {
  const i = r * columns + c, q = [place[i], place[i + 1], place[i + columns + 1], place[i + columns]];
  if (q[0] >= 0 && q[1] >= 0 && q[2] >= 0) faces.push(q[0], q[1], q[2]);
  else if (q[0] >= 0 && q[1] >= 0 && q[3] >= 0) faces.push(q[0], q[1], q[3]);
  if (q[0] >= 0 && q[2] >= 0 && q[3] >= 0) faces.push(q[0], q[2], q[3]);
  else if (q[1] >= 0 && q[2] >= 0 && q[3] >= 0 && q[0] < 0) faces.push(q[1], q[2], q[3]);
}
const at = (i, step, fallback) => { const j = i + step; return j >= 0 && j < count && known(j) ? z(j) : fallback; };
cells.forEach((cell, k) => {
  const h = z(cell);
  const dx = at(cell, 1, h) - at(cell, -1, h), dy = at(cell, columns, h) - at(cell, -columns, h);
  const length = Math.hypot(dx, dy, 2 * data.cell);
  normals.set([-dx / length, -dy / length, 2 * data.cell / length], 3 * k);
});

// Colours
const ramps = {
  height: [[68,1,84],[59,82,139],[33,145,140],[94,201,98],[253,231,37]],
  sigma: [[13,8,135],[126,3,168],[204,71,120],[248,149,64],[240,249,33]],
  slope: [[0,0,4],[87,16,110],[188,55,84],[249,142,9],[252,255,164]],
  traversability: [[216,116,96],[231,171,127],[246,226,158],[169,192,129],[92,158,100]],
};
const ramp = (name, t) => {
  const stops = ramps[name], p = Math.min(0.9999, Math.max(0, t)) * (stops.length - 1), k = Math.floor(p);
  return stops[k].map((v, c) => v + (stops[k + 1][c] - v) * (p - k));
};
const layers = {};
for (const layer of data.layers) layers[layer.name] = layer;
function colours(name) {
  const out = new Uint8Array(3 * n), layer = layers[name];
  const values = bytes(layer.name === "image" ? "image" : "layer_" + name);
  cells.forEach((cell, k) => {
    if (name === "image") { out.set(values.subarray(3 * cell, 3 * cell + 3), 3 * k); return; }
    out.set(values[cell] === 255 ? [110, 112, 118] : ramp(name, values[cell] / 254), 3 * k);
  });
  return out;
}

// Camera: turns about a target
const centre = data.centre, reach = data.reach;
const behind = Math.atan2(-centre[1], -centre[0]);  // look over the rover's shoulder
const start = {azimuth: behind, elevation: 0.5, distance: 0.95 * reach, target: [...centre], stretch: 1};
let view = structuredClone(start), current = data.layers[0].name;
const canvas = get("view");

function axes() {
  const ca = Math.cos(view.azimuth), sa = Math.sin(view.azimuth), ce = Math.cos(view.elevation), se = Math.sin(view.elevation);
  const back = [ca * ce, sa * ce, se];
  return {back, right: [-sa, ca, 0], up: [-ca * se, -sa * se, ce]};
}
function matrix() {
  const {back, right, up} = axes(), t = [...view.target];
  t[2] = centre[2] + (t[2] - centre[2]) * view.stretch;
  const eye = t.map((v, k) => v + back[k] * view.distance);
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const f = 1 / Math.tan(0.45), aspect = canvas.width / canvas.height, near = view.distance / 200, far = view.distance * 4 + 4 * reach;
  const rows3 = [right, up, back].map(a => [...a, -dot(a, eye)]);
  const [r, u, b] = rows3, k = (far + near) / (near - far), m = 2 * far * near / (near - far);
  const clip = [r.map(v => v * f / aspect), u.map(v => v * f), b.map((v, i) => v * k + (i === 3 ? m : 0)), b.map(v => -v)];
  const out = new Float32Array(16);
  for (let i = 0; i < 4; i++) for (let j = 0; j < 4; j++) out[j * 4 + i] = clip[i][j];
  return out;
}

// Rings on the ground about the rover
function ringLines() {
  const out = [];
  for (let radius = data.ring; radius <= data.farthest; radius += data.ring) {
    let last = null;
    for (let k = 0; k <= 720; k++) {
      const a = k * Math.PI / 360, px = radius * Math.cos(a), py = radius * Math.sin(a);
      const c = Math.floor((px - data.x0) / data.cell), r = Math.floor((py - data.y0) / data.cell), i = r * columns + c;
      const here = c >= 0 && c < columns && r >= 0 && r < rows && known(i) ? [px, py, z(i) + 0.4 * data.cell] : null;
      if (last && here) out.push(...last, ...here);
      last = here;
    }
  }
  return new Float32Array(out);
}
const rings = ringLines();

const vertexSource = `#version 300 es
uniform mat4 m; uniform float stretch, base, light; in vec3 p; in vec3 normal; in vec3 rgb; out vec3 colour;
void main() {
  vec3 q = vec3(p.xy, base + (p.z - base) * stretch);
  gl_Position = m * vec4(q, 1.0);
  vec3 s = normalize(vec3(normal.xy * stretch, normal.z));
  colour = rgb * mix(1.0, 0.35 + 0.75 * max(0.0, dot(s, vec3(0.5, 0.5, 0.7071))), light);
}`;
const fragmentSource = `#version 300 es
precision mediump float; in vec3 colour; out vec4 shown; void main() { shown = vec4(colour, 1.0); }`;

function webgl() {
  const gl = canvas.getContext("webgl2", {antialias: true});
  if (!gl) return null;
  const program = gl.createProgram();
  for (const [kind, source] of [[gl.VERTEX_SHADER, vertexSource], [gl.FRAGMENT_SHADER, fragmentSource]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, source); gl.compileShader(shader); gl.attachShader(program, shader);
  }
  ["p", "normal", "rgb"].forEach((name, k) => gl.bindAttribLocation(program, k, name));
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) return null;
  gl.useProgram(program);
  const buffer = (values, target = gl.ARRAY_BUFFER) => { const b = gl.createBuffer(); gl.bindBuffer(target, b); gl.bufferData(target, values, gl.STATIC_DRAW); return b; };
  const point = buffer(positions), normal = buffer(normals), line = buffer(rings), paint = gl.createBuffer();
  buffer(new Uint32Array(faces), gl.ELEMENT_ARRAY_BUFFER);
  const uniform = name => gl.getUniformLocation(program, name);
  gl.enable(gl.DEPTH_TEST); gl.clearColor(0.086, 0.094, 0.114, 1);
  const use = (b, k, type, scaled) => { gl.bindBuffer(gl.ARRAY_BUFFER, b); gl.enableVertexAttribArray(k); gl.vertexAttribPointer(k, 3, type, scaled, 0, 0); };
  return {
    paint(values) { gl.bindBuffer(gl.ARRAY_BUFFER, paint); gl.bufferData(gl.ARRAY_BUFFER, values, gl.STATIC_DRAW); },
    draw() {
      gl.viewport(0, 0, canvas.width, canvas.height); gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
      gl.uniformMatrix4fv(uniform("m"), false, matrix());
      gl.uniform1f(uniform("stretch"), view.stretch); gl.uniform1f(uniform("base"), centre[2]);
      gl.uniform1f(uniform("light"), current === "image" ? 0 : 1);
      use(point, 0, gl.FLOAT, false); use(normal, 1, gl.FLOAT, false); use(paint, 2, gl.UNSIGNED_BYTE, true);
      gl.drawElements(gl.TRIANGLES, faces.length, gl.UNSIGNED_INT, 0);
      if (get("rings").checked) {
        use(line, 0, gl.FLOAT, false); gl.disableVertexAttribArray(1); gl.disableVertexAttribArray(2);
        gl.vertexAttrib3f(1, 0, 0, 1); gl.vertexAttrib3f(2, 1, 1, 1); gl.uniform1f(uniform("light"), 0);
        gl.drawArrays(gl.LINES, 0, rings.length / 3);
      }
    },
  };
}
function flat() {  // without WebGL: points, the farthest first
  const paper = canvas.getContext("2d"), step = Math.max(1, Math.ceil(n / 40000));
  let shown = null;
  return {
    paint(values) { shown = values; },
    draw() {
      const m = matrix(), todo = [];
      paper.fillStyle = "#16181d"; paper.fillRect(0, 0, canvas.width, canvas.height);
      for (let k = 0; k < n; k += step) {
        const px = positions[3 * k], py = positions[3 * k + 1], pz = centre[2] + (positions[3 * k + 2] - centre[2]) * view.stretch;
        const w = m[3] * px + m[7] * py + m[11] * pz + m[15];
        if (w > 0) todo.push([w, (m[0] * px + m[4] * py + m[8] * pz + m[12]) / w, (m[1] * px + m[5] * py + m[9] * pz + m[13]) / w, k]);
      }
      todo.sort((a, b) => b[0] - a[0]);
      for (const [w, u, v, k] of todo) {
        const side = Math.max(1.5, Math.sqrt(step) * data.cell * canvas.height / w);
        paper.fillStyle = `rgb(${shown[3 * k]},${shown[3 * k + 1]},${shown[3 * k + 2]})`;
        paper.fillRect((u + 1) / 2 * canvas.width - side / 2, (1 - v) / 2 * canvas.height - side / 2, side, side);
      }
    },
  };
}
const painter = webgl() || flat();

let waiting = false;
function draw() {
  if (waiting) return;
  waiting = true;
  requestAnimationFrame(() => { waiting = false; painter.draw(); });
}
function resize() {
  const ratio = window.devicePixelRatio || 1;
  canvas.width = Math.max(1, Math.round(innerWidth * ratio)); canvas.height = Math.max(1, Math.round(innerHeight * ratio));
  draw();
}
function choose(name) {
  if (!layers[name]) return;
  current = name; get("colour").value = name;
  painter.paint(colours(name));
  const layer = layers[name], bar = get("bar");
  bar.style.background = name === "image" ? "none" : `linear-gradient(90deg, ${ramps[name].map(c => `rgb(${c})`).join(",")})`;
  get("low").textContent = name === "image" ? "" : layer.low; get("high").textContent = name === "image" ? "" : layer.high;
  get("note").textContent = layer.note;
  draw();
}
function turn(da, de) { view.azimuth += da; view.elevation = Math.min(1.55, Math.max(-0.2, view.elevation + de)); draw(); }
function zoom(factor) { view.distance = Math.min(8 * reach, Math.max(0.02 * reach, view.distance * factor)); draw(); }
function move(dx, dy) {
  const {right} = axes(), s = view.distance, ahead = [-Math.cos(view.azimuth), -Math.sin(view.azimuth), 0];
  view.target = view.target.map((v, k) => v + s * (dx * right[k] + dy * ahead[k])); draw();
}
function reset() { view = structuredClone(start); get("stretch").value = 1; get("factor").textContent = "1"; draw(); }

const held = new Map();
let apart = 0;
canvas.addEventListener("pointerdown", e => { canvas.setPointerCapture(e.pointerId); held.set(e.pointerId, e); apart = 0; });
for (const kind of ["pointerup", "pointercancel"]) canvas.addEventListener(kind, e => { held.delete(e.pointerId); apart = 0; });
canvas.addEventListener("pointermove", e => {
  const before = held.get(e.pointerId);
  if (!before) return;
  const dx = (e.clientX - before.clientX) / innerHeight, dy = (e.clientY - before.clientY) / innerHeight;
  held.set(e.pointerId, e);
  if (held.size === 2) {
    const [a, b] = [...held.values()], gap = Math.hypot(a.clientX - b.clientX, a.clientY - b.clientY);
    if (apart) zoom(apart / gap);
    apart = gap; move(-dx / 2, dy / 2);
  } else if (e.buttons & 2 || e.shiftKey) move(-dx, dy); else turn(-3 * dx, 3 * dy);
});
canvas.addEventListener("contextmenu", e => e.preventDefault());
canvas.addEventListener("wheel", e => { e.preventDefault(); zoom(Math.exp(Math.sign(e.deltaY) * Math.min(0.3, Math.abs(e.deltaY) / 500))); }, {passive: false});
const names = data.layers.map(layer => layer.name);
const keys = {
  ArrowLeft: () => turn(0.08, 0), ArrowRight: () => turn(-0.08, 0), ArrowUp: () => turn(0, 0.06), ArrowDown: () => turn(0, -0.06),
  "+": () => zoom(0.9), "=": () => zoom(0.9), "-": () => zoom(1.1), w: () => move(0, 0.04), s: () => move(0, -0.04),
  a: () => move(-0.04, 0), d: () => move(0.04, 0), r: reset,
};
addEventListener("keydown", e => {
  if (e.ctrlKey || e.metaKey || e.altKey || (e.target !== canvas && e.target !== document.body)) return;
  const key = e.key.length === 1 ? e.key.toLowerCase() : e.key, number = Number(key);
  if (keys[key]) keys[key](); else if (number >= 1 && number <= names.length) choose(names[number - 1]); else return;
  e.preventDefault();
});
data.layers.forEach((layer, k) => get("colour").add(new Option(`${k + 1} ${layer.title}`, layer.name)));
get("colour").addEventListener("change", e => choose(e.target.value));
get("stretch").addEventListener("input", e => { view.stretch = Number(e.target.value); get("factor").textContent = e.target.value; draw(); });
get("rings").addEventListener("change", draw);
get("reset").addEventListener("click", reset);
get("ring").textContent = data.ring;
get("size").textContent = data.size;
addEventListener("resize", resize);
resize(); choose(current); painter.draw();
})();
