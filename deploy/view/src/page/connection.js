// The WebSocket to `skein view`: it reconnects for as long as the page is open.

const FIRST_RETRY_MS = 500;
const LONGEST_RETRY_MS = 5000;
const MAGIC = 0x4e454b53;
const HEADER_BYTES = 16;

/**
 * Opens `live` beside the page and hands every message to `handlers`: `message(object)` for JSON, `crowd(crowd)` for the binary
 * positions of a large swarm, `open()`, `closed(retry_s)`, and `refused(problem)` with `{ text, remedy }` if the server or a proxy
 * refuses the connection, or `null` if no server answers.
 */
export class Connection {
  constructor(handlers, address = liveAddress(document.baseURI)) {
    this.handlers = handlers;
    this.address = address;
    this.retry_ms = FIRST_RETRY_MS;
    this.open();
  }

  open() {
    const socket = new WebSocket(this.address);
    socket.binaryType = "arraybuffer";
    this.socket = socket;
    let wasOpen = false;
    socket.addEventListener("open", () => {
      wasOpen = true;
      this.retry_ms = FIRST_RETRY_MS;
      this.handlers.open();
    });
    socket.addEventListener("message", ({ data }) => this.receive(data));
    socket.addEventListener("close", () => {
      this.again();
      if (!wasOpen) this.explain();
    });
  }

  /** Asks the server why it refuses: a browser keeps the answer to a WebSocket to itself. */
  async explain() {
    let problem = null;
    try {
      const response = await fetch(this.address.replace(/^ws/, "http"), { method: "POST", cache: "no-store" });
      problem = reasonOf(response.status, await response.text());
    } catch {
      // No server answers: the page tries again.
    }
    if (this.socket?.readyState !== WebSocket.OPEN) this.handlers.refused(problem);
  }

  again() {
    this.socket = null;
    this.handlers.closed(this.retry_ms / 1000);
    setTimeout(() => this.open(), this.retry_ms);
    this.retry_ms = Math.min(LONGEST_RETRY_MS, this.retry_ms * 2);
  }

  receive(data) {
    if (data instanceof ArrayBuffer) {
      const crowd = readCrowd(data);
      if (crowd) this.handlers.crowd(crowd);
      return;
    }
    let message;
    try {
      message = JSON.parse(data);
    } catch {
      return; // Not a message of this protocol.
    }
    this.handlers.message(message);
  }

  /** Gives up the connection, which opens anew: for a server that is silent though it should send. */
  restart() {
    this.socket?.close();
  }

  /** Sends a message, if connected. */
  send(message) {
    if (this.socket?.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(message));
  }
}

/** Address of the WebSocket of a page at this address: beside the page, so that a proxy may serve both in a folder of its own. */
export function liveAddress(page) {
  const address = new URL("live", page);
  address.protocol = address.protocol === "https:" ? "wss:" : "ws:";
  return address.href;
}

/** Why a WebSocket is refused, by the answer to a request for the reason; `null` if the answer does not tell. */
export function reasonOf(status, text) {
  if (status === 403 || status === 421) return { text: "skein view refuses this page.", remedy: text.trim() };
  if (status !== 204) return null;
  return {
    text: "skein view can be reached, but not its WebSocket.",
    remedy: "A proxy between this page and skein view has to pass the headers Upgrade and Connection on.",
  };
}

/** Positions of all vehicles of a large swarm, in the order of the swarm's list; `null` for other bytes. */
export function readCrowd(buffer) {
  if (buffer.byteLength < HEADER_BYTES) return null;
  const view = new DataView(buffer);
  const length = view.getUint32(4, true);
  if (view.getUint32(0, true) !== MAGIC || buffer.byteLength !== HEADER_BYTES + 17 * length) return null;
  // The arrays of floats begin at a multiple of four bytes, and every browser's platform is little-endian.
  const floats = (at) => new Float32Array(buffer, HEADER_BYTES + 4 * length * at, length);
  return {
    t_s: view.getFloat64(8, true),
    north: floats(0),
    east: floats(1),
    altitude: floats(2),
    heading: floats(3),
    flags: new Uint8Array(buffer, HEADER_BYTES + 16 * length, length),
  };
}
