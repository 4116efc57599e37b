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
const room = gtb.gtb_room(bytes.length); // may grow the memory: asked before its buffer is named
new Uint8Array(gtb.memory.buffer, room, bytes.length).set(bytes);

function print(length) {
  const failed = gtb.gtb_decode(length);
  const answer = new Uint8Array(gtb.memory.buffer, gtb.gtb_answer(), gtb.gtb_answer_len());
  if (failed) return console.log(`${length} bytes: ${new TextDecoder().decode(answer)}`);
  const [cols, rows, , used, complete, bound] = [0, 1, 2, 3, 4, 5].map((k) => gtb.gtb_number(k));
  const hash = createHash("sha256").update(answer).digest("hex");
  console.log(
    `${length} bytes: ${cols} x ${rows}, ${used} used, complete ${complete === 1}, bound ${bound}, sha256 ${hash}`,
  );
}

for (const cut of cuts) print(Math.min(Number(cut), bytes.length));
gtb.gtb_decode(bytes.length); // so that the engine has compiled what is timed
const begun = performance.now();
gtb.gtb_decode(bytes.length);
console.error(`wasm:   ${((performance.now() - begun) / 1000).toFixed(4)} s`);
print(bytes.length);
