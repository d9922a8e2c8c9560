// The connection to the node: one WebSocket, reopened when it closes.

const PROTOCOL = "wm.view.v1";
const SOURCES = ["camera", "predicted", "plan", "candidates", "goal", "subgoals"];
const TYPES = ["image/jpeg", "image/png"];
const HEADER = 28;
const FIRST_WAIT = 250;
const LONGEST_WAIT = 2000;

/** Takes the token from the address and hides it there; otherwise returns the stored one. */
function readToken() {
  const given = new URLSearchParams(location.hash.slice(1)).get("token");
  if (given) {
    sessionStorage.setItem("token", given);
    history.replaceState(null, "", location.pathname);
  }
  return sessionStorage.getItem("token");
}

/** A picture's message: version, source, format and k in a byte each, then stamp, observation and arrival. */
export function parsePicture(buffer) {
  const data = new DataView(buffer);
  if (data.byteLength < HEADER || data.getUint8(0) !== 1) return null;
  const source = SOURCES[data.getUint8(1)];
  const type = TYPES[data.getUint8(2)];
  if (!source || !type) return null;
  const stamp = (at) => data.getBigInt64(at, true).toString();
  const label = { source, k: data.getUint8(3), stamp: stamp(4), observed: stamp(12) };
  return { label, blob: new Blob([new Uint8Array(buffer, HEADER)], { type }) };
}

export class Connection {
  /** `on` has message(json), picture({label, blob}), failed(text), state(text) and refused(status, text). */
  constructor(on) {
    this.on = on;
    this.wait = FIRST_WAIT;
    this.answers = new Map();
    this.number = 0;
    this.token = readToken();
    this.open();
  }

  get headers() {
    return this.token ? { Authorization: `Bearer ${this.token}` } : {};
  }

  use(token) {
    sessionStorage.setItem("token", token);
    this.token = token;
    this.open();
  }

  async open() {
    try {
      // Browsers hide why a socket could not be opened; this request shows it.
      const access = await fetch("/access", { headers: this.headers });
      if (!access.ok) {
        this.on.refused(access.status, await access.text());
        return;
      }
    } catch {
      this.again();
      return;
    }
    const protocols = this.token ? [PROTOCOL, `wm.token.${this.token}`] : [PROTOCOL];
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    const socket = new WebSocket(`${scheme}://${location.host}/socket`, protocols);
    socket.binaryType = "arraybuffer";
    socket.onmessage = ({ data }) => {
      if (typeof data !== "string") {
        const picture = parsePicture(data);
        if (picture) this.on.picture(picture);
        return;
      }
      const message = JSON.parse(data);
      if (message.op === "answer") {
        // A reply without a number belongs to an invalid message.
        if (!message.done) this.on.failed(message.text);
        this.answers.get(message.number)?.(message);
        this.answers.delete(message.number);
        return;
      }
      if (message.op === "hello") this.wait = FIRST_WAIT;
      this.on.message(message);
    };
    socket.onclose = () => {
      this.socket = null;
      for (const answer of this.answers.values()) answer({ done: false, text: "the connection was lost" });
      this.answers.clear();
      this.again();
    };
    this.socket = socket;
  }

  again() {
    this.on.state("connecting");
    setTimeout(() => this.open(), this.wait);
    this.wait = Math.min(2 * this.wait, LONGEST_WAIT);
  }

  /** Sends a command; returns its reply. */
  ask(command) {
    if (this.socket?.readyState !== WebSocket.OPEN) return Promise.resolve({ done: false, text: "not connected" });
    const number = ++this.number;
    this.socket.send(JSON.stringify({ number, command }));
    return new Promise((resolve) => this.answers.set(number, resolve));
  }
}
