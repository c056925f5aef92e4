// Orbit control of a view by mouse, touch or keys. Wheel and pinch zoom; vertical touch moves still scroll the page.
const MIN_RISE = 0.12, MAX_RISE = Math.PI / 2 - 0.01;

export class Orbit {
  constructor(canvas, home, changed) {
    this.home = home;
    this.changed = changed;
    this.canvas = canvas;
    this.pointers = new Map();
    this.reset();
    canvas.addEventListener("pointerdown", (event) => { canvas.setPointerCapture(event.pointerId); this.pointers.set(event.pointerId, event); });
    for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, (event) => this.pointers.delete(event.pointerId));
    canvas.addEventListener("pointermove", (event) => this.handle_move(event));
    canvas.addEventListener("wheel", (event) => {
      if (document.activeElement !== canvas && !event.ctrlKey) return; // the wheel scrolls the page unless the belt has the focus
      event.preventDefault();
      this.zoom(Math.exp(event.deltaY * 0.001));
    }, { passive: false });
    canvas.addEventListener("keydown", (event) => this.handle_key(event));
  }

  reset() { this.set_view(this.home); }
  show_top() { this.set_view({ turn: 0, rise: MAX_RISE, zoom: 1 }); }

  set_view({ turn, rise, zoom }) {
    Object.assign(this, { turn, rise, scale: zoom });
    this.changed();
  }

  turn_by(turn, rise) {
    this.turn += turn;
    this.rise = Math.min(Math.max(this.rise + rise, MIN_RISE), MAX_RISE);
    this.changed();
  }

  zoom(factor) {
    this.scale = Math.min(Math.max(this.scale * factor, 0.3), 2.5);
    this.changed();
  }

  handle_move(event) {
    const previous = this.pointers.get(event.pointerId);
    if (!previous) return;
    if (this.pointers.size === 2) {
      const other = [...this.pointers.values()].find((pointer) => pointer.pointerId !== event.pointerId);
      const distance_to_other = (pointer) => Math.hypot(pointer.clientX - other.clientX, pointer.clientY - other.clientY);
      this.zoom(distance_to_other(previous) / Math.max(distance_to_other(event), 1));
    } else {
      this.turn_by((previous.clientX - event.clientX) * 0.006, (event.clientY - previous.clientY) * 0.006);
    }
    this.pointers.set(event.pointerId, event);
  }

  handle_key(event) {
    const actions = { ArrowLeft: () => this.turn_by(-0.1, 0), ArrowRight: () => this.turn_by(0.1, 0), ArrowUp: () => this.turn_by(0, 0.08), ArrowDown: () => this.turn_by(0, -0.08),
      "+": () => this.zoom(0.88), "=": () => this.zoom(0.88), "-": () => this.zoom(1.14), r: () => this.reset(), R: () => this.reset() };
    if (event.ctrlKey || event.metaKey || event.altKey || !(event.key in actions)) return;
    event.preventDefault();
    event.stopPropagation();
    actions[event.key]();
  }
}
