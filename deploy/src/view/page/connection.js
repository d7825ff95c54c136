// The WebSocket to `skein view`: it reconnects for as long as the page is open.

const FIRST_RETRY_MS = 500;
const LONGEST_RETRY_MS = 5000;
const MAGIC = 0x4e454b53;
const HEADER_BYTES = 16;

/**
 * Opens `/live` and hands every message to `handlers`: `message(object)` for JSON, `crowd(crowd)` for the binary positions
 * of a large swarm, `open()`, `closed(retry_s)`.
 */
export class Connection {
  constructor(handlers, address = liveAddress()) {
    this.handlers = handlers;
    this.address = address;
    this.retry_ms = FIRST_RETRY_MS;
    this.open();
  }

  open() {
    const socket = new WebSocket(this.address);
    socket.binaryType = "arraybuffer";
    this.socket = socket;
    socket.addEventListener("open", () => {
      this.retry_ms = FIRST_RETRY_MS;
      this.handlers.open();
    });
    socket.addEventListener("message", ({ data }) => this.receive(data));
    socket.addEventListener("close", () => this.again());
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

function liveAddress() {
  const scheme = location.protocol === "https:" ? "wss:" : "ws:";
  return `${scheme}//${location.host}/live`;
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
