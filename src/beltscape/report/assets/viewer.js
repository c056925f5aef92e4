// A viewer of clouds, surfaces, lines and labels in millimetres, z upwards. Everything is in the page.
const scene = JSON.parse(document.getElementById("scene").textContent);
const $ = id => document.getElementById(id);
const canvas = $("view"), over = $("over"), gl = canvas.getContext("webgl", { antialias: true });
if (!gl) $("sorry").hidden = false; else start();

function start() {
const bytes = text => Uint8Array.from(atob(text), c => c.charCodeAt(0));
const rgb = hex => [1, 3, 5].map(i => parseInt(hex.slice(i, i + 2), 16) / 255);

// ---- programs
const program = (vertex, fragment) => {
  const made = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text); gl.compileShader(shader); gl.attachShader(made, shader);
  }
  gl.linkProgram(made);
  const uniform = {};
  for (let i = 0; i < gl.getProgramParameter(made, gl.ACTIVE_UNIFORMS); i++) {
    const { name } = gl.getActiveUniform(made, i);
    uniform[name] = gl.getUniformLocation(made, name);
  }
  return { made, uniform, at: name => gl.getAttribLocation(made, name) };
};
const points = program(`
attribute vec3 place; attribute vec4 normal; attribute vec4 colour;
uniform mat4 view; uniform vec3 low, step_mm, light, ramp[17]; uniform float size, mode; uniform vec2 heights;
varying vec3 shown;
vec3 along(float t) {
  float at = 16. * clamp(t, 0., 1.); int i = int(min(at, 15.));
  return mix(ramp[i], ramp[i + 1], at - float(i));
}
void main() {
  vec3 at = low + step_mm * place;
  gl_Position = view * vec4(at, 1.);
  gl_PointSize = clamp(size / gl_Position.w, 1., 24.);
  float known = step(.01, dot(normal.xyz, normal.xyz));
  float lit = mix(1., .32 + .78 * max(dot(normalize(normal.xyz + vec3(0., 0., 1e-4)), light), 0.), known);
  if (mode < .5) shown = colour.rgb * mix(1., lit, .55);
  else if (mode < 1.5) shown = along((at.z - heights.x) / (heights.y - heights.x)) * lit;
  else if (mode < 2.5) shown = along(colour.a);
  else shown = vec3(.86, .84, .8) * lit;
}`, `precision mediump float; varying vec3 shown;
void main() { vec2 d = gl_PointCoord - .5; if (dot(d, d) > .25) discard; gl_FragColor = vec4(shown, 1.); }`);
const plain = program(`attribute vec3 place; attribute vec4 colour; uniform mat4 view; varying vec4 shown;
void main() { gl_Position = view * vec4(place, 1.); shown = colour; }`,
`precision mediump float; varying vec4 shown; void main() { gl_FragColor = shown; }`);

const buffer = data => {
  const made = gl.createBuffer();
  gl.bindBuffer(gl.ARRAY_BUFFER, made); gl.bufferData(gl.ARRAY_BUFFER, data, gl.STATIC_DRAW);
  return made;
};
const feed = (where, data, count, kind, normalized) => {
  if (where < 0) return;
  gl.bindBuffer(gl.ARRAY_BUFFER, data);
  gl.enableVertexAttribArray(where);
  gl.vertexAttribPointer(where, count, kind, normalized, 0, 0);
};

// ---- content: clouds are unpacked when first shown
const clouds = scene.frames.map(frame => ({ ...frame, ready: null }));
const unpack = cloud => cloud.ready ??= {
  place: buffer(new Uint16Array(bytes(cloud.place).buffer)),
  normal: buffer(new Int8Array(bytes(cloud.normal).buffer)),
  colour: buffer(bytes(cloud.colour)),
};
const layers = {};
for (const { layer, colour, line } of scene.lines) {
  const own = layers[layer] ??= { lines: [], faces: [], labels: [], on: true };
  for (let i = 1; i < line.length; i++) own.lines.push([line[i - 1], [...rgb(colour), 1]], [line[i], [...rgb(colour), 1]]);
}
for (const { layer, colour, triangles } of scene.surfaces) {
  const own = layers[layer] ??= { lines: [], faces: [], labels: [], on: true };
  for (const corner of triangles) own.faces.push([corner, [...rgb(colour), .42]]);
}
for (const { layer, text, at } of scene.labels) (layers[layer] ??= { lines: [], faces: [], labels: [], on: true }).labels.push([text, at]);
for (const own of Object.values(layers)) for (const kind of ["lines", "faces"]) {
  const data = own[kind];
  own[kind] = { count: data.length, place: buffer(new Float32Array(data.flatMap(v => v[0]))), colour: buffer(new Float32Array(data.flatMap(v => v[1]))) };
}

// ---- the eye: it looks at `middle` from `reach` away
const home = { turn: scene.home.turn, tilt: scene.home.tilt, reach: scene.home.reach, middle: scene.home.middle };
let eye = { ...home, middle: [...home.middle] }, mode = scene.frames.length && scene.modes.length ? scene.modes[0].mode : 0, shown = 0;
const multiply = (a, b) => { // column-major 4 × 4
  const out = new Float32Array(16);
  for (let c = 0; c < 4; c++) for (let r = 0; r < 4; r++) for (let k = 0; k < 4; k++) out[4 * c + r] += a[4 * k + r] * b[4 * c + k];
  return out;
};
const axes = () => {
  const [ct, st, cp, sp] = [Math.cos(eye.turn), Math.sin(eye.turn), Math.cos(eye.tilt), Math.sin(eye.tilt)];
  const back = [st * cp, -ct * cp, sp], right = [ct, st, 0], up = [-st * sp, ct * sp, cp];
  return { right, up, back };
};
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const FOCAL = 2.2;
const matrix = () => {
  const { right, up, back } = axes(), from = eye.middle.map((m, i) => m + eye.reach * back[i]);
  const near = eye.reach * .02, far = eye.reach + 4 * home.reach, aspect = canvas.width / canvas.height;
  const look = new Float32Array([right[0], up[0], back[0], 0, right[1], up[1], back[1], 0, right[2], up[2], back[2], 0,
    -dot(right, from), -dot(up, from), -dot(back, from), 1]);
  const lens = new Float32Array([FOCAL / Math.max(aspect, 1), 0, 0, 0, 0, FOCAL * Math.min(aspect, 1), 0, 0,
    0, 0, (far + near) / (near - far), -1, 0, 0, 2 * far * near / (near - far), 0]);
  if (aspect > 1) { lens[0] = FOCAL / aspect; lens[5] = FOCAL; }
  return multiply(lens, look);
};
const pixel = (view, p) => {
  const [x, y, w] = [0, 1, 3].map(r => view[r] * p[0] + view[4 + r] * p[1] + view[8 + r] * p[2] + view[12 + r]);
  return w > 0 ? [(x / w + 1) / 2 * over.clientWidth, (1 - y / w) / 2 * over.clientHeight, w] : null;
};

// ---- drawing
let waiting = false;
const draw = () => { if (!waiting) { waiting = true; requestAnimationFrame(paint); } };
function paint() {
  waiting = false;
  const ratio = window.devicePixelRatio || 1;
  for (const one of [canvas, over]) {
    const [w, h] = [Math.round(one.clientWidth * ratio), Math.round(one.clientHeight * ratio)];
    if (one.width !== w || one.height !== h) { one.width = w; one.height = h; }
  }
  const view = matrix(), { right, up, back } = axes();
  gl.viewport(0, 0, canvas.width, canvas.height);
  gl.clearColor(.082, .094, .11, 1); gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
  gl.enable(gl.DEPTH_TEST); gl.depthMask(true); gl.disable(gl.BLEND);
  if (clouds.length && cloudOn) {
    const cloud = clouds[shown], data = unpack(cloud), u = points.uniform;
    gl.useProgram(points.made);
    gl.uniformMatrix4fv(u.view, false, view);
    gl.uniform3fv(u.low, cloud.low); gl.uniform3fv(u.step_mm, cloud.step);
    const light = [0, 1, 2].map(i => .55 * back[i] - .35 * right[i] + .45 * up[i] + (i === 2 ? .35 : 0)), long = Math.hypot(...light);
    gl.uniform3fv(u.light, light.map(v => v / long));
    gl.uniform1f(u.size, +$("size").value * cloud.spacing * FOCAL * Math.min(canvas.height, canvas.width) / 2 * 1.15);
    gl.uniform1f(u.mode, mode); gl.uniform2fv(u.heights, scene.heights);
    const ramp = scene.modes.find(one => one.mode === mode)?.ramp;
    if (ramp) gl.uniform3fv(u["ramp[0]"], ramp.flat().map(level => level / 255));
    feed(points.at("place"), data.place, 3, gl.UNSIGNED_SHORT, false);
    feed(points.at("normal"), data.normal, 4, gl.BYTE, true);
    feed(points.at("colour"), data.colour, 4, gl.UNSIGNED_BYTE, true);
    gl.drawArrays(gl.POINTS, 0, cloud.count);
  }
  gl.useProgram(plain.made);
  gl.uniformMatrix4fv(plain.uniform.view, false, view);
  const set = data => { feed(plain.at("place"), data.place, 3, gl.FLOAT, false); feed(plain.at("colour"), data.colour, 4, gl.FLOAT, false); };
  for (const own of Object.values(layers)) if (own.on && own.lines.count) { set(own.lines); gl.drawArrays(gl.LINES, 0, own.lines.count); }
  gl.enable(gl.BLEND); gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA); gl.depthMask(false);
  for (const own of Object.values(layers)) if (own.on && own.faces.count) { set(own.faces); gl.drawArrays(gl.TRIANGLES, 0, own.faces.count); }
  label(view, ratio, { right, up });
}
function label(view, ratio, { right, up }) {
  const g = over.getContext("2d"), [w, h] = [over.clientWidth, over.clientHeight];
  g.setTransform(ratio, 0, 0, ratio, 0, 0); g.clearRect(0, 0, w, h);
  g.font = "600 12px system-ui, sans-serif"; g.textBaseline = "middle"; g.lineWidth = 3; g.strokeStyle = "rgba(21,24,28,.85)"; g.fillStyle = "#e9ecef";
  for (const own of Object.values(layers)) if (own.on) for (const [text, at] of own.labels) {
    const p = pixel(view, at);
    if (p) { g.strokeText(text, p[0] + 7, p[1] - 7); g.fillText(text, p[0] + 7, p[1] - 7); }
  }
  // a scale bar of a round length, true in the plane through the middle
  const per = FOCAL * Math.min(h, w) / 2 / eye.reach, want = 150 / per, power = 10 ** Math.floor(Math.log10(want));
  const length = [1, 2, 5].map(f => f * power).filter(v => v <= want).pop(), wide = length * per, x = w - 28 - wide, y = h - 34;
  g.strokeStyle = "#e9ecef"; g.lineWidth = 2; g.beginPath();
  g.moveTo(x, y - 5); g.lineTo(x, y); g.lineTo(x + wide, y); g.lineTo(x + wide, y - 5); g.stroke();
  g.textAlign = "center"; g.fillText(length >= 1000 ? `${length / 1000} m` : `${length} mm`, x + wide / 2, y - 14); g.textAlign = "left";
  const [ox, oy] = [w - 74, h - 110];
  scene.axes.forEach(([text, colour], i) => {
    const ex = ox + 38 * right[i], ey = oy - 38 * up[i];
    g.strokeStyle = g.fillStyle = colour; g.lineWidth = 2.5; g.beginPath(); g.moveTo(ox, oy); g.lineTo(ex, ey); g.stroke();
    g.fillText(text, ex + 5 * Math.sign(right[i]) - 3, ey - 7 * Math.sign(up[i]));
  });
}

// ---- the panel
let cloudOn = true;
const button = (where, text, on, click) => {
  const made = document.createElement("button");
  made.textContent = text; made.classList.toggle("on", on);
  made.addEventListener("click", () => { click(made); draw(); });
  where.append(made);
  return made;
};
const colours = scene.modes.map(one => button($("colours"), one.text, one.mode === mode, made => {
  mode = one.mode;
  colours.forEach(other => other.classList.toggle("on", other === made));
  legend();
}));
const along = (ramp, share) => { // as the shader does
  const at = 16 * share, i = Math.min(Math.floor(at), 15);
  return `rgb(${ramp[i].map((low, k) => Math.round(low + (ramp[i + 1][k] - low) * (at - i)))})`;
};
function legend() {
  const own = scene.modes.find(one => one.mode === mode);
  $("legend").hidden = !own || !own.range;
  $("legend").style.display = own && own.range ? "" : "none";
  if (!own || !own.range) return;
  const g = $("bar").getContext("2d");
  for (let i = 0; i < 256; i++) { g.fillStyle = along(own.ramp, i / 255); g.fillRect(i, 0, 1, 1); }
  $("low").textContent = own.range[0]; $("high").textContent = own.range[1]; $("what").textContent = own.what;
}
legend();
if (clouds.length) button($("layers"), "cloud", true, made => { cloudOn = made.classList.toggle("on"); });
for (const [name, own] of Object.entries(layers)) button($("layers"), name, true, made => { own.on = made.classList.toggle("on"); });
const sides = { top: [0, Math.PI / 2], front: [0, .12], side: [Math.PI / 2, .12] };
for (const made of document.querySelectorAll("#sides button")) made.addEventListener("click", () => {
  const side = sides[made.dataset.side];
  eye = side ? { ...eye, turn: side[0], tilt: side[1] } : { ...home, middle: [...home.middle] };
  draw();
});
$("size").addEventListener("input", draw);

// ---- hands
const touches = new Map();
const move = (dx, dy) => {
  const { right, up } = axes(), per = 2 * eye.reach / FOCAL / Math.min(over.clientHeight, over.clientWidth);
  eye.middle = eye.middle.map((m, i) => m - per * (dx * right[i] - dy * up[i]));
};
const zoom = factor => { eye.reach = Math.min(Math.max(eye.reach * factor, home.reach * .01), home.reach * 6); };
over.addEventListener("contextmenu", event => event.preventDefault());
over.addEventListener("pointerdown", event => { over.setPointerCapture(event.pointerId); touches.set(event.pointerId, [event.clientX, event.clientY]); });
for (const end of ["pointerup", "pointercancel"]) over.addEventListener(end, event => touches.delete(event.pointerId));
over.addEventListener("pointermove", event => {
  const was = touches.get(event.pointerId);
  if (!was) return;
  const now = [event.clientX, event.clientY], [dx, dy] = [now[0] - was[0], now[1] - was[1]];
  if (touches.size === 2) {
    const other = [...touches].find(([id]) => id !== event.pointerId)[1];
    zoom(Math.hypot(was[0] - other[0], was[1] - other[1]) / Math.max(Math.hypot(now[0] - other[0], now[1] - other[1]), 1));
    move(dx / 2, dy / 2);
  } else if (event.buttons & 2 || event.shiftKey) move(dx, dy);
  else {
    eye.turn -= dx * .006;
    eye.tilt = Math.min(Math.max(eye.tilt + dy * .006, -Math.PI / 2), Math.PI / 2);
  }
  touches.set(event.pointerId, now);
  draw();
});
over.addEventListener("wheel", event => { event.preventDefault(); zoom(Math.exp(event.deltaY * .001)); draw(); }, { passive: false });
over.addEventListener("dblclick", event => { // the nearest of the points under the pointer
  if (!clouds.length) return;
  const cloud = clouds[shown], place = cloud.own ??= new Uint16Array(bytes(cloud.place).buffer), view = matrix();
  let best = null, score = Infinity;
  for (let i = 0; i < cloud.count; i++) {
    const at = [0, 1, 2].map(k => cloud.low[k] + cloud.step[k] * place[3 * i + k]), p = pixel(view, at);
    if (!p) continue;
    const off = Math.hypot(p[0] - event.offsetX, p[1] - event.offsetY);
    if (off < 8 && p[2] + 4 * off < score) { score = p[2] + 4 * off; best = at; }
  }
  if (best) { eye.middle = best; draw(); }
});
window.addEventListener("resize", draw);

// ---- frames
if (clouds.length > 1) {
  $("frames").hidden = false;
  $("frame").max = clouds.length - 1;
  let clock = null;
  const show = i => { shown = i; $("frame").value = i; $("name").textContent = clouds[i].name; draw(); };
  $("frame").addEventListener("input", () => show(+$("frame").value));
  $("play").addEventListener("click", () => {
    if (clock) { clearInterval(clock); clock = null; } else clock = setInterval(() => show((shown + 1) % clouds.length), 350);
    $("play").textContent = clock ? "❚❚" : "▶";
  });
  show(0);
}
draw();
}
