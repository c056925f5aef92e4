// Turning a view with mouse, finger or keys. Wheel and pinch zoom; a finger that moves up or down still scrolls the page.
const LOW = 0.12, HIGH = Math.PI / 2 - 0.01;

export class Orbit {
  constructor(canvas, home, changed) {
    this.home = home;
    this.changed = changed;
    this.canvas = canvas;
    this.fingers = new Map();
    this.reset();
    canvas.addEventListener("pointerdown", (event) => { canvas.setPointerCapture(event.pointerId); this.fingers.set(event.pointerId, event); });
    for (const over of ["pointerup", "pointercancel"]) canvas.addEventListener(over, (event) => this.fingers.delete(event.pointerId));
    canvas.addEventListener("pointermove", (event) => this.move(event));
    canvas.addEventListener("wheel", (event) => {
      if (document.activeElement !== canvas && !event.ctrlKey) return; // the page scrolls until the belt is chosen
      event.preventDefault();
      this.zoom(Math.exp(event.deltaY * 0.001));
    }, { passive: false });
    canvas.addEventListener("keydown", (event) => this.key(event));
  }

  reset() { this.look(this.home); }
  top() { this.look({ turn: 0, rise: HIGH, zoom: 1 }); }

  look({ turn, rise, zoom }) {
    Object.assign(this, { turn, rise, scale: zoom });
    this.changed();
  }

  by(turn, rise) {
    this.turn += turn;
    this.rise = Math.min(Math.max(this.rise + rise, LOW), HIGH);
    this.changed();
  }

  zoom(factor) {
    this.scale = Math.min(Math.max(this.scale * factor, 0.3), 2.5);
    this.changed();
  }

  move(event) {
    const before = this.fingers.get(event.pointerId);
    if (!before) return;
    if (this.fingers.size === 2) {
      const other = [...this.fingers.values()].find((finger) => finger.pointerId !== event.pointerId);
      const away = (finger) => Math.hypot(finger.clientX - other.clientX, finger.clientY - other.clientY);
      this.zoom(away(before) / Math.max(away(event), 1));
    } else {
      this.by((before.clientX - event.clientX) * 0.006, (event.clientY - before.clientY) * 0.006);
    }
    this.fingers.set(event.pointerId, event);
  }

  key(event) {
    const actions = { ArrowLeft: () => this.by(-0.1, 0), ArrowRight: () => this.by(0.1, 0), ArrowUp: () => this.by(0, 0.08), ArrowDown: () => this.by(0, -0.08),
      "+": () => this.zoom(0.88), "=": () => this.zoom(0.88), "-": () => this.zoom(1.14), r: () => this.reset(), R: () => this.reset() };
    if (event.ctrlKey || event.metaKey || event.altKey || !(event.key in actions)) return;
    event.preventDefault();
    event.stopPropagation();
    actions[event.key]();
  }
}
