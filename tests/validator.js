// Answers each GLB on standard input, its length in four bytes before it, with a line: a JSON list of what
// the official glTF-Validator calls an error or a warning. The argument is the folder of the package.
"use strict";
const { validateBytes } = require(process.argv[2]);

async function judged(bytes) {
  const { issues } = await validateBytes(bytes, { maxIssues: 1000 });
  const bad = issues.messages.filter(({ severity }) => severity < 2);
  return bad.map(({ code, message, pointer }) => `${code}: ${message} (${pointer})`);
}

async function main() {
  let held = Buffer.alloc(0);
  for await (const piece of process.stdin) {
    held = Buffer.concat([held, piece]);
    while (held.length >= 4 && held.length - 4 >= held.readUInt32LE()) {
      const end = 4 + held.readUInt32LE();
      console.log(JSON.stringify(await judged(new Uint8Array(held.subarray(4, end)))));
      held = held.subarray(end);
    }
  }
}
main();
