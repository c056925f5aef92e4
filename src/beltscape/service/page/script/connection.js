// The line to the measuring system: opens by itself, opens again by itself, notices when nothing comes any more.
import { store } from "./store.js";

const SILENT_MS = 4000;
const LONGEST_MS = 5000;
let socket = null;
let last_ms = -Infinity;
let wait_ms = 500;
let timer = 0;
let ever = false;

export function connect() {
  clearTimeout(timer);
  close();
  const opened = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/api/live`);
  socket = opened;
  opened.binaryType = "arraybuffer";
  opened.onopen = () => { last_ms = performance.now(); store.tell("opened"); };
  opened.onmessage = (event) => { if (opened === socket) take(event.data); };
  opened.onclose = (event) => { if (opened === socket) again(event.code); };
  last_ms = performance.now();
}

function close() {
  const old = socket;
  socket = null;
  if (old) { old.onclose = null; old.close(); }
}

async function again(code) {
  socket = null;
  judge();
  if (code === 4401 || await signed_out()) {
    store.tell("signed_out");
    return;
  }
  timer = setTimeout(connect, wait_ms * (0.8 + 0.4 * Math.random()));
  wait_ms = Math.min(wait_ms * 1.6, LONGEST_MS);
}

/** Whether the server answers, and wants to know who we are. */
async function signed_out() {
  try {
    return (await fetch("/api/page", { signal: AbortSignal.timeout(3000) })).status === 401;
  } catch {
    return false;
  }
}

export function retry() {
  wait_ms = 500;
  connect();
}

function take(data) {
  last_ms = performance.now();
  wait_ms = 500;
  ever = true;
  if (typeof data === "string") {
    const message = JSON.parse(data);
    if (message.kind === "state") {
      store.state = message;
      store.heard_ms = last_ms;
      store.clock_ms = message.wall_ms - Date.now();
    }
    judge();
    store.tell(message.kind, message);
    return;
  }
  const length = new DataView(data).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length)));
  store.tell(header.kind, { ...header, counts: new Uint16Array(data, 4 + length) });
}

/** What the page may claim: live, stale (connected, but nothing new is measured), lost, waiting. */
function judge() {
  const silent = !socket || socket.readyState !== WebSocket.OPEN || performance.now() - last_ms > SILENT_MS;
  const age = store.age_s;
  const stale_s = store.page?.stale_s ?? 5;
  const link = silent ? (ever ? "lost" : "waiting") : age == null || age > stale_s ? "stale" : "live";
  if (link !== store.link) {
    store.link = link;
    document.body.dataset.link = link;
    store.tell("link", link);
  }
}

setInterval(() => {
  if (socket && performance.now() - last_ms > SILENT_MS) {
    close();
    again(0);
  }
  judge();
  store.tell("tick");
}, 500);
