// Prints what the Khronos glTF validator has to say about GLB files. Exit 0: no errors; 1: errors; 2: usage.
//
//     npm install && node validate.mjs FILE.glb...
import { readFile } from "node:fs/promises";
import validator from "gltf-validator";

const files = process.argv.slice(2);
if (files.length === 0) {
  console.error("usage: node validate.mjs FILE.glb...");
  process.exit(2);
}
const severities = ["error", "warning", "info", "hint"];
let errors = 0;
for (const file of files) {
  try {
    const report = await validator.validateBytes(new Uint8Array(await readFile(file)), {
      uri: file,
      maxIssues: 100,
    });
    const { issues, info } = report;
    for (const { severity, code, message, pointer } of issues.messages) {
      console.log(`${file}: ${severities[severity]}: ${code} ${pointer ?? ""}: ${message}`);
    }
    console.log(
      `${file}: ${issues.numErrors} errors, ${issues.numWarnings} warnings, ${issues.numInfos} infos, ` +
        `${issues.numHints} hints; ${info?.totalVertexCount ?? 0} vertices, ${info?.totalTriangleCount ?? 0} triangles`,
    );
    errors += issues.numErrors;
  } catch (problem) {
    console.log(`${file}: error: ${problem.message ?? problem}`);
    errors += 1;
  }
}
process.exit(errors > 0 ? 1 : 0);
