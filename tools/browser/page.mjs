// A client of View for browsers, written from proto/ alone: Follow by gRPC-web over fetch, Steer beside it.
//
// It keeps the patches by handle, applies each difference as view.proto says, and compares count and hash. What it saw is in the
// object that `follow` returns, which goes on being filled.

import { blake3 } from '@noble/hashes/blake3.js';

const hex = (bytes) => [...bytes].map((b) => b.toString(16).padStart(2, '0')).join('');

/// A gRPC-web call: yields the messages, and throws the status if it is not OK.
async function* call(server, path, bytes, token, signal) {
  const body = new Uint8Array(5 + bytes.length);
  new DataView(body.buffer).setUint32(1, bytes.length);
  body.set(bytes, 5);
  const headers = { 'content-type': 'application/grpc-web+proto', 'x-grpc-web': '1' };
  if (token) headers.authorization = `Bearer ${token}`;
  const response = await fetch(`${server}/${path}`, { method: 'POST', headers, body, signal });
  const refuse = (status, message) => {
    if (status !== '0') throw new Error(`${path}: status ${status}: ${decodeURIComponent(message ?? '')}`);
  };
  if (!response.ok) throw new Error(`${path}: HTTP ${response.status}`);
  const early = response.headers.get('grpc-status');
  if (early !== null) refuse(early, response.headers.get('grpc-message'));
  let held = new Uint8Array(0);
  let ended = early !== null;
  for await (const chunk of chunks(response.body)) {
    const joined = new Uint8Array(held.length + chunk.length);
    joined.set(held);
    joined.set(chunk, held.length);
    held = joined;
    while (held.length >= 5) {
      const length = new DataView(held.buffer, held.byteOffset).getUint32(1);
      if (held.length < 5 + length) break;
      const frame = held.slice(5, 5 + length);
      if (held[0] & 0x80) {
        const trailers = new Map(
          new TextDecoder().decode(frame).split('\r\n').filter(Boolean)
            .map((l) => [l.slice(0, l.indexOf(':')).toLowerCase(), l.slice(l.indexOf(':') + 1).trim()]),
        );
        ended = true;
        refuse(trailers.get('grpc-status') ?? '2', trailers.get('grpc-message'));
      } else {
        yield frame;
      }
      held = held.slice(5 + length);
    }
  }
  if (!ended) throw new Error(`${path}: broken off`);
}

async function* chunks(stream) {
  const reader = stream.getReader();
  for (;;) {
    const { done, value } = await reader.read();
    if (done) return;
    yield value;
  }
}

/// The set that a view holds.
class Set_ {
  constructor() {
    this.number = 0;
    this.patches = new Map();
    this.parts = [];
  }

  /// Takes in a message; at the end of a difference returns what it did, else nothing.
  take(reply) {
    this.parts.push(reply);
    if (reply.more) return undefined;
    const parts = this.parts;
    this.parts = [];
    const from = Number(reply.from);
    if (from === 0) this.patches.clear();
    else if (from !== this.number) throw new Error(`difference from ${from}, but ${this.number} is held`);
    const did = { from, to: Number(reply.to), answers: Number(reply.answers), version: Number(reply.version) };
    did.added = did.removed = did.changed = did.bytes = 0;
    for (const part of parts) {
      for (const handle of part.removed) {
        if (!this.patches.delete(handle)) throw new Error(`handle ${handle} leaves and is not there`);
        did.removed += 1;
      }
    }
    for (const part of parts) {
      for (const p of part.added) {
        if (this.patches.has(p.handle)) throw new Error(`handle ${p.handle} comes and is there`);
        this.patches.set(p.handle, { id: hex(p.id), survey: p.survey, top: p.topM });
        did.added += 1;
        did.bytes += p.payload.length;
      }
      for (const c of part.changed) {
        const patch = this.patches.get(c.handle);
        if (!patch) throw new Error(`handle ${c.handle} changes and is not there`);
        patch.top = c.topM;
        did.changed += 1;
      }
    }
    this.number = did.to;
    if (this.patches.size !== Number(reply.patches)) {
      throw new Error(`${this.patches.size} patches, the server says ${reply.patches}`);
    }
    const ids = [...this.patches.values()].map((p) => p.id).sort();
    const all = Uint8Array.from(ids.flatMap((id) => id.match(/../g).map((b) => parseInt(b, 16))));
    const hash = hex(blake3(all).slice(0, 16));
    if (hash !== hex(reply.hash)) throw new Error(`difference ${did.to}: hash ${hash}, the server says ${hex(reply.hash)}`);
    did.patches = this.patches.size;
    did.surveys = [...new Set([...this.patches.values()].map((p) => p.survey))].sort();
    return did;
  }
}

/// Follows a view whose camera moves `steps` times, one each `every` milliseconds, along `camera(k)`.
export async function follow({ server, token, steps, every, path }) {
  const root = new protobuf.Root();
  root.resolvePath = (_, target) => `/proto/${target.replace(/^\/?(proto\/)?/, '')}`;
  await root.load('terraquilt/v1/view.proto');
  const type = (name) => root.lookupType(`terraquilt.v1.${name}`);
  const [open, reply, steer, steered] = ['OpenView', 'ViewReply', 'SteerRequest', 'SteerReply'].map(type);
  const bytes = (t, object) => {
    const wrong = t.verify(object);
    if (wrong) throw new Error(wrong);
    return t.encode(t.fromObject(object)).finish();
  };
  const question = (number) => {
    const share = steps ? number / steps : 0;
    const at = path.from.map((v, k) => v + share * (path.to[k] - v));
    const [x, y, z] = at;
    const camera = {
      eyeX: x, eyeY: y, eyeZ: z, lookAtX: x + path.look[0], lookAtY: y + path.look[1], lookAtZ: z + path.look[2],
      fovDeg: 45, viewportWidth: 1280, viewportHeight: 720, pixels: path.pixels,
    };
    return { number, tolerance: { camera } };
  };
  const held = new Set_();
  const seen = { differences: [], problem: null, newest: 0, patches: 0, steers: 0, done: false };
  const stop = new AbortController();
  seen.stop = () => stop.abort();
  window.seen = seen;
  let session;
  const opened = new Promise((resolve) => (seen.opened = resolve));
  (async () => {
    try {
      const asked = bytes(open, { question: question(0) });
      for await (const frame of call(server, 'terraquilt.v1.View/Follow', asked, token, stop.signal)) {
        const message = reply.decode(frame);
        if (message.session.length) {
          session = message.session;
          seen.opened();
        }
        const did = held.take(message);
        if (did) {
          seen.differences.push(did);
          seen.newest = Math.max(seen.newest, did.answers);
          document.getElementById('told').textContent += `${JSON.stringify(did)}\n`;
        }
      }
    } catch (e) {
      if (!stop.signal.aborted) seen.problem = String(e);
      seen.opened();
    }
    seen.done = true;
  })();
  await opened;
  for (let k = 1; k <= steps && !seen.problem; k += 1) {
    await new Promise((resolve) => setTimeout(resolve, every));
    const asked = bytes(steer, { session, question: question(k) });
    for await (const frame of call(server, 'terraquilt.v1.View/Steer', asked, token)) {
      steered.decode(frame);
      seen.steers += 1;
    }
  }
  return true;
}
