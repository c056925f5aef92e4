// The belt in 3-D: a fixed grid of points whose heights a shader reads from the ring buffer of rows, so that no geometry
// is rebuilt while the belt runs. x is along the belt with the newest row at 0, y upwards, z across; all in metres.
import * as THREE from "../vendor/three/three.module.min.js";
import { RING } from "./belt_rows.js";
import { create_table } from "./viridis.js";

const VERTEX = `
precision highp usampler2D;
uniform usampler2D rows;
uniform int first, begin, end, columns;
uniform float cell, shift, low_z, across, step_m, offset_m;
out float height; out float filled; out float unknown; out vec3 normal_; out vec2 place;

uint at(int row, int column) {
  if (row < begin || row >= end) return 65535u;
  return texelFetch(rows, ivec2(clamp(column, 0, columns - 1), row & ${RING - 1}), 0).r;
}
float metres(uint count) { return float(count & 32767u) * step_m + offset_m; }
float beside(uint count, float own) { return count == 65535u ? own : metres(count); }

void main() {
  int column = int(position.x), row = first + int(position.y);
  uint count = at(row, column);
  unknown = count == 65535u ? 1.0 : 0.0;
  filled = count >= 32768u ? 1.0 : 0.0;
  height = unknown > 0.5 ? 0.0 : metres(count);
  float along = beside(at(row + 1, column), height) - beside(at(row - 1, column), height);
  float over = beside(at(row, column + 1), height) - beside(at(row, column - 1), height);
  normal_ = normalize(vec3(-along / (2.0 * cell), 1.0, -over / (2.0 * across)));
  vec3 p = vec3((float(int(position.y)) - shift) * cell, height, low_z + float(column) * across);
  place = vec2(float(row) * cell, p.z);
  gl_Position = projectionMatrix * modelViewMatrix * vec4(p, 1.0);
}`;

const FRAGMENT = `
precision highp float;
uniform sampler2D map; uniform float high; uniform vec3 sun, belt_tone, gap_tone;
in float height; in float filled; in float unknown; in vec3 normal_; in vec2 place;
out vec4 colour;
void main() {
  if (unknown > 0.01) discard;
  vec3 tone = texture(map, vec2(clamp(height / high, 0.0, 1.0), 0.5)).rgb;
  tone = mix(belt_tone, tone, smoothstep(0.002, 0.012, height));
  if (filled > 0.5) {
    float stripe = fract((place.x + place.y) / 0.06);
    tone = mix(tone * 0.75 + gap_tone * 0.25, gap_tone, step(stripe, 0.45));
  }
  vec3 n = normalize(normal_);
  float light = 0.62 + 0.5 * max(dot(n, sun), 0.0) - 0.12 * (1.0 - n.y);
  colour = linearToOutputTexel(vec4(tone * light, 1.0));
}`;

// the belt itself, with a moving scale in metres along both edges
const SLAB_VERTEX = `out vec2 at; void main() { at = position.xz; gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0); }`;
const SLAB_FRAGMENT = `
precision highp float;
uniform float travelled, half_width, middle, fade; uniform vec3 rubber, mark, gap_tone;
in vec2 at; out vec4 colour;
void main() {
  float side = abs(at.y - middle) - half_width, metre = fract((at.x + travelled));
  float tenth = fract((at.x + travelled) * 10.0);
  vec3 tone = mix(rubber, gap_tone, 0.16 * step(fract((at.x + travelled + at.y) / 0.06), 0.3));
  if (side > 0.0) {
    tone = rubber;
    if (side > 0.03 && side < 0.055 && metre < 0.5) tone = mark;
    else if (side < 0.018 && tenth < 0.14) tone = mark;
  }
  colour = linearToOutputTexel(vec4(tone, smoothstep(fade, fade + 0.6, at.x)));
}`;

/** Return whether WebGL runs in software, without a graphics card. */
function is_software(gl) {
  const more = gl.getExtension("WEBGL_debug_renderer_info");
  return /swiftshader|llvmpipe|software|basic render/i.test(String(gl.getParameter(more ? more.UNMASKED_RENDERER_WEBGL : gl.RENDERER)));
}

const rgb = (hex) => new THREE.Color(hex);

export class BeltScene {
  /** Throws if there is no WebGL 2. */
  constructor(canvas, window_m) {
    this.window_m = window_m;
    this.canvas = canvas;
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: true, alpha: true, powerPreference: "low-power" });
    this.software = is_software(this.renderer.getContext());
    this.renderer.setPixelRatio(this.software ? 1 : Math.min(devicePixelRatio, 2));
    this.camera = new THREE.PerspectiveCamera(28, 1, 0.05, 80);
    this.scene = new THREE.Scene();
    this.map = new THREE.DataTexture(create_table(256), 256, 1);
    this.map.colorSpace = THREE.SRGBColorSpace;
    this.map.magFilter = this.map.minFilter = THREE.LinearFilter;
    this.map.needsUpdate = true;
    this.tones = { belt_tone: { value: rgb("#5c6670") }, gap_tone: { value: rgb("#9aa5ad") }, rubber: { value: rgb("#4a535b") }, mark: { value: rgb("#dfe5e9") } };
  }

  set_theme(dark) {
    const tones = dark ? ["#46515a", "#8d99a3", "#2f3941", "#8fa1ae"] : ["#78838c", "#c3cbd1", "#56616a", "#e3e9ed"];
    ["belt_tone", "gap_tone", "rubber", "mark"].forEach((name, i) => this.tones[name].value.set(tones[i]));
  }

  /** Build the grid for the rows of another belt. */
  build_surface(rows) {
    this.surface?.geometry.dispose();
    this.surface?.material.dispose();
    this.slab?.geometry.dispose();
    this.texture?.dispose();
    this.scene.clear();
    this.counts = rows.counts;
    const cell = rows.cell_mm / 1000;
    this.rows_shown = Math.min(Math.round(this.window_m / cell), RING - 8);
    const [columns, count] = [rows.columns, this.rows_shown + 1];
    this.texture = new THREE.DataTexture(rows.counts, columns, RING, THREE.RedIntegerFormat, THREE.UnsignedShortType);
    this.texture.internalFormat = "R16UI";
    this.texture.unpackAlignment = 2;
    this.texture.needsUpdate = true;
    const [low, high] = rows.x_mm.map((mm) => mm / 1000);
    this.width_m = high - low;
    this.middle_m = (high + low) / 2;
    this.surface = new THREE.Mesh(create_grid(columns, count), new THREE.ShaderMaterial({
      glslVersion: THREE.GLSL3, vertexShader: VERTEX, fragmentShader: FRAGMENT, side: THREE.DoubleSide,
      uniforms: { rows: { value: this.texture }, first: { value: 0 }, begin: { value: 0 }, end: { value: 0 }, columns: { value: columns }, cell: { value: cell }, shift: { value: 0 },
        low_z: { value: low }, across: { value: columns > 1 ? this.width_m / (columns - 1) : cell }, step_m: { value: rows.step_mm / 1000 }, offset_m: { value: rows.offset_mm / 1000 },
        map: { value: this.map }, high: { value: 0.1 }, sun: { value: new THREE.Vector3(-0.45, 0.75, 0.48).normalize() }, ...this.tones },
    }));
    this.surface.frustumCulled = false;
    this.scene.add(this.surface, this.make_slab());
  }

  make_slab() {
    const geometry = new THREE.PlaneGeometry(this.window_m, this.width_m + 0.14).rotateX(-Math.PI / 2).translate(-this.window_m / 2, -0.012, this.middle_m);
    this.slab = new THREE.Mesh(geometry, new THREE.ShaderMaterial({
      glslVersion: THREE.GLSL3, vertexShader: SLAB_VERTEX, fragmentShader: SLAB_FRAGMENT, transparent: true, side: THREE.DoubleSide,
      uniforms: { travelled: { value: 0 }, half_width: { value: this.width_m / 2 }, middle: { value: this.middle_m }, fade: { value: -this.window_m }, ...this.tones },
    }));
    return this.slab;
  }

  refresh() { if (this.texture) this.texture.needsUpdate = true; }

  resize() {
    const [width, height] = [this.canvas.clientWidth, this.canvas.clientHeight];
    if (width && height) this.renderer.setSize(width, height, false);
    this.camera.aspect = width / Math.max(height, 1);
    this.camera.updateProjectionMatrix();
  }

  /** Draw with the belt's newest edge at row `at`, which may lie between rows. */
  draw(rows, at, high_mm, { turn, rise, scale }) {
    if (this.counts !== rows.counts) this.build_surface(rows);
    const uniforms = this.surface.material.uniforms;
    const last = Math.floor(at);
    uniforms.first.value = last - this.rows_shown;
    uniforms.shift.value = this.rows_shown + (at - last);
    uniforms.begin.value = Math.max(rows.begin, rows.end - RING + 2);
    uniforms.end.value = rows.end;
    uniforms.high.value = high_mm / 1000;
    this.slab.material.uniforms.travelled.value = (at * rows.cell_mm / 1000) % 1000;
    this.fit_camera(turn, rise, scale);
    this.renderer.render(this.scene, this.camera);
  }

  /** Place the camera in the given direction so that the whole length of the belt fills the view. */
  fit_camera(turn, rise, scale) {
    const direction = new THREE.Vector3(Math.cos(rise) * Math.sin(turn), Math.sin(rise), Math.cos(rise) * Math.cos(turn));
    const target = new THREE.Vector3(-this.window_m / 2, 0.05, this.middle_m);
    let distance = this.window_m * 2;
    for (let i = 0; i < 6; i++) {
      this.place_camera(target, direction, distance);
      const projected = this.list_corners().map((corner) => corner.project(this.camera));
      const [low_x, high_x] = [Math.min(...projected.map((p) => p.x)), Math.max(...projected.map((p) => p.x))];
      const [low_y, high_y] = [Math.min(...projected.map((p) => p.y)), Math.max(...projected.map((p) => p.y))];
      const half = Math.tan((this.camera.fov * Math.PI) / 360) * distance;
      const e = this.camera.matrixWorld.elements;
      target.addScaledVector(new THREE.Vector3(e[0], e[1], e[2]), ((low_x + high_x) / 2) * half * this.camera.aspect);
      target.addScaledVector(new THREE.Vector3(e[4], e[5], e[6]), ((low_y + high_y) / 2) * half);
      distance *= Math.max((high_x - low_x) / 1.94, (high_y - low_y) / 1.86);
    }
    this.place_camera(target, direction, distance * scale);
  }

  place_camera(target, direction, distance) {
    this.camera.position.copy(target).addScaledVector(direction, distance);
    this.camera.lookAt(target);
    this.camera.updateMatrixWorld();
  }

  list_corners() {
    const [low, high] = [this.middle_m - this.width_m / 2 - 0.07, this.middle_m + this.width_m / 2 + 0.07];
    return [0, -this.window_m].flatMap((x) => [low, high].flatMap((z) => [-0.02, 0.12].map((y) => new THREE.Vector3(x, y, z))));
  }
}

/** Return a grid of columns × count points: x the column, y the row. */
function create_grid(columns, count) {
  const points = new Float32Array(columns * count * 3);
  const index = new Uint32Array((columns - 1) * (count - 1) * 6);
  for (let i = 0; i < columns * count; i++) points.set([i % columns, Math.floor(i / columns), 0], i * 3);
  let n = 0;
  for (let row = 0; row + 1 < count; row++)
    for (let column = 0; column + 1 < columns; column++) {
      const a = row * columns + column;
      index.set([a, a + 1, a + columns, a + 1, a + columns + 1, a + columns], n);
      n += 6;
    }
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.BufferAttribute(points, 3));
  geometry.setIndex(new THREE.BufferAttribute(index, 1));
  return geometry;
}
