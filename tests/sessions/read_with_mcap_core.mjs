// Prints what the reference reader for the web finds in an MCAP file: node read_with_mcap_core.mjs FILE MODULE
import { open } from "node:fs/promises";
import { createRequire } from "node:module";

const [file, core] = process.argv.slice(2);
const { McapIndexedReader } = createRequire(import.meta.url)(core);

const handle = await open(file, "r");
const readable = {
  size: async () => BigInt((await handle.stat()).size),
  read: async (offset, length) => {
    const buffer = new Uint8Array(Number(length));
    const { bytesRead } = await handle.read(buffer, 0, buffer.length, Number(offset));
    return buffer.subarray(0, bytesRead);
  },
};
const reader = await McapIndexedReader.Initialize({ readable });
const topics = {};
for (const channel of reader.channelsById.values()) {
  const schema = reader.schemasById.get(channel.schemaId);
  topics[channel.topic] = {
    type: schema.name,
    encoding: schema.encoding,
    schema: new TextDecoder().decode(schema.data),
    message: channel.messageEncoding,
    hash: channel.metadata.get("topic_type_hash"),
    count: Number(reader.statistics.channelMessageCounts.get(channel.id)),
  };
}
const messages = [];
for await (const message of reader.readMessages({ validateCrcs: true })) {
  const topic = reader.channelsById.get(message.channelId).topic;
  messages.push([topic, String(message.logTime), Buffer.from(message.data).toString("hex")]);
}
let metadata = {};
for await (const record of reader.readMetadata({ name: "rosbag2" })) {
  metadata = Object.fromEntries(record.metadata);
}
await handle.close();
console.log(JSON.stringify({ profile: reader.header.profile, topics, messages, metadata }));
