// The WebSocket to the measuring system: it reconnects automatically and detects a silent connection.
import { store } from "./store.js";

const SILENT_MS = 4000;
const MAX_WAIT_MS = 5000;
let socket = null;
let last_message_ms = -Infinity;
let wait_ms = 500;
let timer = 0;
let has_connected = false;

export function connect() {
  clearTimeout(timer);
  close();
  const address = new URL("api/live", document.baseURI);
  address.protocol = location.protocol === "https:" ? "wss:" : "ws:";
  const opened = new WebSocket(address);
  socket = opened;
  opened.binaryType = "arraybuffer";
  opened.onopen = () => { last_message_ms = performance.now(); store.emit("opened"); };
  opened.onmessage = (event) => { if (opened === socket) handle_message(event.data); };
  opened.onclose = (event) => { if (opened === socket) schedule_reconnect(event.code); };
  last_message_ms = performance.now();
}

function close() {
  const old = socket;
  socket = null;
  if (old) { old.onclose = null; old.close(); }
}

async function schedule_reconnect(code) {
  socket = null;
  update_link();
  if (code === 4401 || await is_signed_out()) {
    store.emit("signed_out");
    return;
  }
  timer = setTimeout(connect, wait_ms * (0.8 + 0.4 * Math.random()));
  wait_ms = Math.min(wait_ms * 1.6, MAX_WAIT_MS);
}

/** Return whether the server answers and requires a login. */
async function is_signed_out() {
  try {
    return (await fetch("api/page", { signal: AbortSignal.timeout(3000) })).status === 401;
  } catch {
    return false;
  }
}

export function retry() {
  wait_ms = 500;
  connect();
}

function handle_message(data) {
  last_message_ms = performance.now();
  wait_ms = 500;
  has_connected = true;
  if (typeof data === "string") {
    const message = JSON.parse(data);
    if (message.kind === "state") {
      store.state = message;
      store.received_ms = last_message_ms;
      store.clock_ms = message.wall_ms - Date.now();
    }
    update_link();
    store.emit(message.kind, message);
    return;
  }
  const length = new DataView(data).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length)));
  store.emit(header.kind, { ...header, counts: new Uint16Array(data, 4 + length) });
}

const is_older = (age_s) => age_s == null || age_s > store.stale_s;

/** Return whether no frame is newer than the allowed age. */
export const is_frame_stale = () => is_older(store.age_s);

/** Return whether no measured record is newer than the allowed age, although the belt moves and is measured. */
function is_record_stale() {
  const { frames, maintenance } = store.state ?? {};
  const is_stopped = frames?.speed_m_s != null && Math.abs(frames.speed_m_s) < 0.001;
  return !is_stopped && !maintenance && is_older(store.flow_age_s);
}

/** Set the link state: live, stale (connected, but nothing new is measured), lost or waiting. */
function update_link() {
  const is_silent = !socket || socket.readyState !== WebSocket.OPEN || performance.now() - last_message_ms > SILENT_MS;
  const link = is_silent ? (has_connected ? "lost" : "waiting") : is_frame_stale() || is_record_stale() ? "stale" : "live";
  if (link !== store.link) {
    store.link = link;
    document.body.dataset.link = link;
    store.emit("link", link);
  }
}

setInterval(() => {
  if (socket && performance.now() - last_message_ms > SILENT_MS) {
    close();
    schedule_reconnect(0);
  }
  update_link();
  store.emit("tick");
}, 500);
