// Decodes and encodes by sparkplug-payload, a line of JSON for each line of JSON.
const path = require("path");
const readline = require("readline");
const sparkplug = require(path.join(process.argv[2], "node_modules", "sparkplug-payload")).get("spBv1.0");

const plain = (key, value) => (value && typeof value === "object" && "low" in value ? (value.low >>> 0) + value.high * 2 ** 32 : value);

readline.createInterface({ input: process.stdin }).on("line", (line) => {
  const asked = JSON.parse(line);
  const answer = "hex" in asked
    ? sparkplug.decodePayload(Buffer.from(asked.hex, "hex"))
    : Buffer.from(sparkplug.encodePayload(asked)).toString("hex");
  process.stdout.write(JSON.stringify(answer, plain) + "\n");
});
