// A viewer of clouds, surfaces, lines and labels in millimetres, z upwards. Everything is in the page, three.js too.
const $ = id => document.getElementById(id);
const bytes = text => Uint8Array.from(atob(text), c => c.charCodeAt(0));

/** Unpack a library of the page and return its address; `names` maps the modules that it imports to theirs. */
async function unpack(id, names = {}) {
  const packed = new Blob([bytes($(id).textContent)]).stream().pipeThrough(new DecompressionStream("gzip"));
  let text = await new Response(packed).text();
  for (const [name, address] of Object.entries(names)) text = text.replaceAll(`"${name}"`, `"${address}"`).replaceAll(`'${name}'`, `'${address}'`);
  return URL.createObjectURL(new Blob([text], { type: "text/javascript" }));
}
const three = await unpack("three", { "./three.core.min.js": await unpack("three-core") });
const THREE = await import(three);
const { OrbitControls } = await import(await unpack("orbit", { three }));

const content = JSON.parse($("scene").textContent);
const canvas = $("view"), over = $("over");
let renderer;
try { renderer = new THREE.WebGLRenderer({ canvas, antialias: true }); } catch (error) { $("sorry").hidden = false; throw error; }
THREE.ColorManagement.enabled = false; // colours are those of the screen from end to end
renderer.outputColorSpace = THREE.LinearSRGBColorSpace;
const FOCAL = 2.2; // of the shorter side's half

// ---- content: clouds are unpacked when first shown
const world = new THREE.Scene();
const look = { light: { value: new THREE.Vector3() }, ramp: { value: [] }, size: { value: 1 }, mode: { value: 0 },
  heights: { value: new THREE.Vector2(...content.heights) } };
const material = new THREE.ShaderMaterial({ uniforms: look, vertexShader: `
attribute vec4 facing, colour;
uniform vec3 light, ramp[17]; uniform float size, mode; uniform vec2 heights;
varying vec3 shown;
vec3 along(float t) {
  float at = 16. * clamp(t, 0., 1.); int i = int(min(at, 15.));
  return mix(ramp[i], ramp[i + 1], at - float(i));
}
void main() {
  vec4 at = modelMatrix * vec4(position, 1.);
  gl_Position = projectionMatrix * viewMatrix * at;
  gl_PointSize = clamp(size / gl_Position.w, 1., 24.);
  float known = step(.01, dot(facing.xyz, facing.xyz));
  float lit = mix(1., .32 + .78 * max(dot(normalize(facing.xyz + vec3(0., 0., 1e-4)), light), 0.), known);
  if (mode < .5) shown = colour.rgb * mix(1., lit, .55);
  else if (mode < 1.5) shown = along((at.z - heights.x) / (heights.y - heights.x)) * lit;
  else if (mode < 2.5) shown = along(colour.a);
  else shown = vec3(.86, .84, .8) * lit;
}`, fragmentShader: `
varying vec3 shown;
void main() { vec2 d = gl_PointCoord - .5; if (dot(d, d) > .25) discard; gl_FragColor = vec4(shown, 1.); }` });
const clouds = content.frames.map(frame => ({ ...frame, points: null }));
function create_points(cloud) {
  const shape = new THREE.BufferGeometry();
  shape.setAttribute("position", new THREE.BufferAttribute(new Uint16Array(bytes(cloud.place).buffer), 3));
  shape.setAttribute("facing", new THREE.BufferAttribute(new Int8Array(bytes(cloud.normal).buffer), 4, true));
  shape.setAttribute("colour", new THREE.BufferAttribute(bytes(cloud.colour), 4, true));
  const points = new THREE.Points(shape, material);
  points.position.fromArray(cloud.low);
  points.scale.fromArray(cloud.step);
  world.add(points);
  return points;
}
const layers = {};
const layer_of = name => {
  if (!layers[name]) world.add((layers[name] = { group: new THREE.Group(), labels: [] }).group);
  return layers[name];
};
const shape_of = places => new THREE.BufferGeometry().setAttribute("position", new THREE.Float32BufferAttribute(places.flat(), 3));
for (const { layer, colour, line } of content.lines) layer_of(layer).group.add(
  new THREE.Line(shape_of(line), new THREE.LineBasicMaterial({ color: colour })));
for (const { layer, colour, triangles } of content.surfaces) layer_of(layer).group.add(new THREE.Mesh(shape_of(triangles),
  new THREE.MeshBasicMaterial({ color: colour, transparent: true, opacity: .42, depthWrite: false, side: THREE.DoubleSide })));
for (const { layer, text, at } of content.labels) layer_of(layer).labels.push([text, new THREE.Vector3(...at)]);

// ---- the eye
const camera = new THREE.PerspectiveCamera();
camera.up.set(0, 0, 1);
const hands = new OrbitControls(camera, over);
hands.minDistance = content.home.reach * .01; hands.maxDistance = content.home.reach * 6;
const STEEPEST = Math.PI / 2 - 1e-4; // straight down, the direction of up would be unknown
/** Look at the controls' target from an angle about z, an angle above the horizon, and a distance. */
function stand(turn, tilt, reach) {
  const steep = Math.min(tilt, STEEPEST);
  camera.position.set(Math.sin(turn) * Math.cos(steep), -Math.cos(turn) * Math.cos(steep), Math.sin(steep));
  camera.position.multiplyScalar(reach).add(hands.target);
  hands.update();
}
const reach = () => camera.position.distanceTo(hands.target);
function go_home() {
  hands.target.fromArray(content.home.middle);
  stand(content.home.turn, content.home.tilt, content.home.reach);
}

// ---- drawing
let waiting = false, shown = 0, cloud_on = true, mode = clouds.length && content.modes.length ? content.modes[0].mode : 0;
const draw = () => { if (!waiting) { waiting = true; requestAnimationFrame(paint); } };
const style = name => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
function paint() {
  waiting = false;
  const ratio = devicePixelRatio || 1, [w, h] = [over.clientWidth, over.clientHeight];
  if (over.width !== Math.round(w * ratio) || over.height !== Math.round(h * ratio)) {
    over.width = Math.round(w * ratio); over.height = Math.round(h * ratio);
    renderer.setPixelRatio(ratio); renderer.setSize(w, h, false);
  }
  camera.aspect = w / h;
  camera.fov = 2 * Math.atan(1 / (FOCAL * Math.min(camera.aspect, 1))) * 180 / Math.PI;
  camera.near = reach() * .02; camera.far = reach() + 4 * content.home.reach;
  camera.updateProjectionMatrix();
  camera.updateMatrixWorld();
  const [right, up, back] = [new THREE.Vector3(), new THREE.Vector3(), new THREE.Vector3()];
  camera.matrixWorld.extractBasis(right, up, back);
  look.light.value.set(0, 0, .35).addScaledVector(back, .55).addScaledVector(right, -.35).addScaledVector(up, .45).normalize();
  look.mode.value = mode;
  const ramp = content.modes.find(one => one.mode === mode)?.ramp ?? Array(17).fill([0, 0, 0]);
  look.ramp.value = ramp.map(level => new THREE.Vector3(...level).divideScalar(255));
  clouds.forEach((cloud, i) => {
    if (i === shown) cloud.points ??= create_points(cloud);
    if (cloud.points) cloud.points.visible = cloud_on && i === shown;
  });
  if (clouds.length) look.size.value = +$("size").value * clouds[shown].spacing * FOCAL * Math.min(w, h) * ratio / 2 * 1.15;
  renderer.setClearColor(style("--ground"));
  renderer.render(world, camera);
  label(ratio, w, h, right, up);
}
function label(ratio, w, h, right, up) {
  const g = over.getContext("2d"), ink = style("--ink");
  g.setTransform(ratio, 0, 0, ratio, 0, 0); g.clearRect(0, 0, w, h);
  g.font = "600 12px system-ui, sans-serif"; g.textBaseline = "middle"; g.lineWidth = 3; g.strokeStyle = style("--ground"); g.fillStyle = ink;
  for (const own of Object.values(layers)) if (own.group.visible) for (const [text, at] of own.labels) {
    const { x, y, z } = at.clone().project(camera);
    if (z > 1) continue; // behind the eye
    g.strokeText(text, (x + 1) / 2 * w + 7, (1 - y) / 2 * h - 7); g.fillText(text, (x + 1) / 2 * w + 7, (1 - y) / 2 * h - 7);
  }
  // a scale bar of a round length, true in the plane through the target
  const per = FOCAL * Math.min(h, w) / 2 / reach(), want = 150 / per, power = 10 ** Math.floor(Math.log10(want));
  const length = [1, 2, 5].map(f => f * power).filter(v => v <= want).pop(), wide = length * per, x = w - 28 - wide, y = h - 34;
  g.strokeStyle = ink; g.lineWidth = 2; g.beginPath();
  g.moveTo(x, y - 5); g.lineTo(x, y); g.lineTo(x + wide, y); g.lineTo(x + wide, y - 5); g.stroke();
  g.textAlign = "center"; g.fillText(length >= 1000 ? `${length / 1000} m` : `${length} mm`, x + wide / 2, y - 14); g.textAlign = "left";
  const [ox, oy] = [w - 74, h - 110];
  content.axes.forEach(([text, colour], i) => {
    const [rx, uy] = [right.getComponent(i), up.getComponent(i)], [ex, ey] = [ox + 38 * rx, oy - 38 * uy];
    g.strokeStyle = g.fillStyle = colour; g.lineWidth = 2.5; g.beginPath(); g.moveTo(ox, oy); g.lineTo(ex, ey); g.stroke();
    g.fillText(text, ex + 5 * Math.sign(rx) - 3, ey - 7 * Math.sign(uy));
  });
}

// ---- the panel
const button = (where, text, on, click) => {
  const made = document.createElement("button");
  made.textContent = text; made.classList.toggle("on", on);
  made.addEventListener("click", () => { click(made); draw(); });
  where.append(made);
  return made;
};
const colours = content.modes.map(one => button($("colours"), one.text, one.mode === mode, made => {
  mode = one.mode;
  colours.forEach(other => other.classList.toggle("on", other === made));
  legend();
}));
const along = (ramp, share) => { // as the shader does
  const at = 16 * share, i = Math.min(Math.floor(at), 15);
  return `rgb(${ramp[i].map((low, k) => Math.round(low + (ramp[i + 1][k] - low) * (at - i)))})`;
};
function legend() {
  const own = content.modes.find(one => one.mode === mode);
  $("legend").hidden = !own?.range;
  if (!own?.range) return;
  const g = $("bar").getContext("2d");
  for (let i = 0; i < 256; i++) { g.fillStyle = along(own.ramp, i / 255); g.fillRect(i, 0, 1, 1); }
  $("low").textContent = own.range[0]; $("high").textContent = own.range[1]; $("what").textContent = own.what;
}
legend();
if (clouds.length) button($("layers"), "cloud", true, made => { cloud_on = made.classList.toggle("on"); });
for (const [name, own] of Object.entries(layers)) button($("layers"), name, true, made => { own.group.visible = made.classList.toggle("on"); });
const sides = { top: [0, Math.PI / 2], front: [0, .12], side: [Math.PI / 2, .12] };
for (const made of document.querySelectorAll("#sides button")) made.addEventListener("click", () => {
  const side = sides[made.dataset.side];
  if (side) stand(...side, reach()); else go_home();
  draw();
});
$("size").addEventListener("input", draw);

// ---- hands
hands.addEventListener("change", draw);
over.addEventListener("dblclick", event => { // the point under the pointer becomes the middle
  const points = clouds[shown]?.points;
  if (!points) return;
  const [w, h] = [over.clientWidth, over.clientHeight], ray = new THREE.Raycaster();
  ray.params.Points.threshold = 8 * reach() / (FOCAL * Math.min(w, h) / 2); // 8 px at the target
  ray.setFromCamera(new THREE.Vector2(event.offsetX / w * 2 - 1, 1 - event.offsetY / h * 2), camera);
  const [nearest] = ray.intersectObject(points);
  if (!nearest) return;
  const step = new THREE.Vector3().subVectors(nearest.point, hands.target);
  hands.target.add(step); camera.position.add(step);
  hands.update();
});
addEventListener("resize", draw);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);

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
go_home();
draw();
