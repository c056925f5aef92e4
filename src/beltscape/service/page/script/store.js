// What the page knows, and who wants to hear of it. Subjects: state, flow, records, section, belt, link, texts, theme, page.
const listeners = new Map();

export const store = {
  page: null,       // GET /api/page
  state: null,      // the newest state
  heard_ms: 0,      // performance.now() when it came
  link: "waiting",  // waiting, live, stale, lost
  clock_ms: 0,      // the measuring machine's clock minus this one's

  on(subject, listener) {
    if (!listeners.has(subject)) listeners.set(subject, new Set());
    listeners.get(subject).add(listener);
  },

  tell(subject, detail) {
    for (const listener of listeners.get(subject) ?? []) listener(detail);
  },

  /** Seconds since the last frame, as far as this page knows; null: there was none. */
  get age_s() {
    const age = this.state?.frames.age_s;
    return age == null ? null : age + (performance.now() - this.heard_ms) / 1000;
  },
};
