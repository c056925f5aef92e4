// The state of the page and its listeners. Subjects: state, flow, records, section, belt, link, texts, theme, page.
const listeners = new Map();

export const store = {
  page: null,       // GET /api/page
  state: null,      // the newest state
  received_ms: 0,      // performance.now() at its arrival
  link: "waiting",  // waiting, live, stale, lost
  clock_ms: 0,      // the measuring machine's clock minus this one's

  on(subject, listener) {
    if (!listeners.has(subject)) listeners.set(subject, new Set());
    listeners.get(subject).add(listener);
  },

  emit(subject, detail) {
    for (const listener of listeners.get(subject) ?? []) listener(detail);
  },

  /** Seconds from which frames and records are not current; it follows the interval of the frames. */
  get stale_s() {
    return this.state?.stale_s ?? this.page?.stale_s ?? 5;
  },

  /** Seconds since the last measured record, from the newest state; null: there was none. */
  get flow_age_s() {
    const age = this.state?.flow.age_s;
    return age == null ? null : age + (performance.now() - this.received_ms) / 1000;
  },

  /** Seconds since the last frame, from the newest state; null: there was none. */
  get age_s() {
    const age = this.state?.frames.age_s;
    return age == null ? null : age + (performance.now() - this.received_ms) / 1000;
  },
};
