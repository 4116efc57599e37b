// Decodes a GTB file, and its first BYTES, with the WebAssembly module; prints a line for each prefix as `native decode` does.
//
//   node decode.mjs MODULE.wasm FILE [BYTES...]
//
// What a page does is the same: it needs WebAssembly, and nothing that is Node's but reading files and the hash.
import { readFileSync } from "node:fs";
import { createHash } from "node:crypto";

const [wasm, file, ...cuts] = process.argv.slice(2);
const module = new WebAssembly.Module(readFileSync(wasm));
const wanted = WebAssembly.Module.imports(module);
if (wanted.length > 0) {
  throw new Error(`the module wants ${JSON.stringify(wanted)} of its host; a browser would have to bring that`);
}
const gtb = new WebAssembly.Instance(module).exports;
const bytes = readFileSync(file);
const memory = (at, length) => new Uint8Array(gtb.memory.buffer, at, length);
const room = gtb.gtb_room(bytes.length); // may grow the memory: asked before its buffer is named
memory(room, bytes.length).set(bytes);

const seed = 1;

function print(length) {
  const failed = gtb.gtb_decode(length, seed);
  const answer = memory(gtb.gtb_answer(), gtb.gtb_answer_len());
  if (failed) return console.log(`${length} bytes: ${new TextDecoder().decode(answer)}`);
  const [cols, rows, , used, complete, bound, , , cells] = [0, 1, 2, 3, 4, 5, 6, 7, 8].map((k) => gtb.gtb_number(k));
  const hash = createHash("sha256").update(answer).update(memory(gtb.gtb_picture(), 3 * cells * cells)).digest("hex");
  console.log(
    `${length} bytes: ${cols} x ${rows}, ${used} used, complete ${complete === 1}, bound ${bound}, ` +
      `${cells} cells a side, sha256 ${hash}`,
  );
}

for (const cut of cuts) print(Math.min(Number(cut), bytes.length));
gtb.gtb_decode(bytes.length, seed); // so that the engine has compiled what is timed
const begun = performance.now();
gtb.gtb_decode(bytes.length, seed);
console.error(`wasm:   ${((performance.now() - begun) / 1000).toFixed(4)} s`);
print(bytes.length);
